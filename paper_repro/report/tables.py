"""Tables 1 to 4 of the paper, filled from the compiled model.

Words of definitions are ours; every number and every name of a status or an action is read out of
the model.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.model import BITS, NONE
from exact_mdp.paper_repro.model_rows import marginal
from exact_mdp.paper_repro.view import View


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of the paper from the model.

    Attributes
    ----------
    place : str
        "Table 3".
    title : str
    headings : tuple of str
    rows : tuple of tuple of str
        The first cell names the row.
    note : str
    """

    place: str
    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str


def all_tables(view: View) -> list[Table]:
    """Return Tables 1 to 4 as the model has them."""
    return [_table_1(view), _table_2(view), _table_3(view), _table_4(view)]


def _table_1(view: View) -> Table:
    scenario, mdp = view.scenario, view.mdp
    tasks = ", ".join(str(size) for size in scenario.tasks)
    steps = {name: view.study.evaluations[name].steps for name in ("optimal", "random")}
    skipped = view.study.evaluations["random"].skip_probability
    rows = (
        ("scenario", "all tasks, from status 0000 to the end", f"{mdp.n_states} states"),
        ("task", "subtasks in a row, with a bonus at the end", f"subtasks of each task: {tasks}"),
        (
            "subtask",
            "is completed by a trial that ends in status 0000, or skipped",
            f"skipped at least once in an episode of random actions: {skipped:.1%}",
        ),
        ("trial", "one attempt at a subtask", f"up to {scenario.trials} in a subtask"),
        (
            "timestep",
            "one assistance and what follows",
            f"expected in an episode: {steps['optimal']:.2f} under the optimal policy, "
            f"{steps['random']:.2f} under random actions",
        ),
    )
    return Table(
        place="Table 1",
        title="Terms, and what they are in the model",
        headings=("term", "in the model", "number"),
        rows=rows,
        note="Expected numbers are exact up to a proven rounding error.",
    )


def _table_2(view: View) -> Table:
    mdp = view.mdp
    rows = []
    for number, action in enumerate(mdp.actions[:4]):
        lowered = [
            f"{name} {float(marginal(mdp, bit, number, bit)):.0%}"
            for name, bit in BITS.items()
            if marginal(mdp, bit, number, bit) != marginal(mdp, bit, NONE, bit)
        ]
        cost = {p.name: p.value for p in mdp.parameters}[f"reward.assist.{action}"]
        rows.append((f"a{number}", action, ", ".join(lowered) or "none", str(cost)))
    return Table(
        place="Table 2",
        title="Assistance types, and what each does",
        headings=("action", "assistance", "statuses that stay with lower probability", "w_assist"),
        rows=tuple(rows),
        note="An absent status that an assistance names stays absent for certain.",
    )


def _table_3(view: View) -> Table:
    mdp, rows = view.mdp, []
    for row in BITS:
        cells = [row, _per_cent(marginal(mdp, 0, NONE, BITS[row]))]
        for column in BITS:
            found = marginal(mdp, BITS[row], NONE, BITS[column])
            if row == column:
                cells.append(_per_cent(found))
            else:
                cells.append("+" + _per_cent(found - marginal(mdp, 0, NONE, BITS[column])))
        rows.append(tuple(cells))
    return Table(
        place="Table 3",
        title="Transition probabilities without assistance",
        headings=("status at t", "base", *(f"{name} at t+1" for name in BITS)),
        rows=tuple(rows),
        note="Marginal probabilities summed up from compiled rows; row to column, the default "
        "reading.",
    )


def _table_4(view: View) -> Table:
    held = {parameter.name: parameter.value for parameter in view.mdp.parameters}
    rows = tuple((weight, str(held[f"reward.{weight}"])) for weight in reported.TABLE_4)
    return Table(
        place="Table 4",
        title="Weights of the reward components",
        headings=("weight", "value"),
        rows=rows,
        note="That every outcome earns what Equation 1 makes of them is the claim equation1.",
    )


def _per_cent(share: Fraction) -> str:
    return f"{float(100 * share):g} %"
