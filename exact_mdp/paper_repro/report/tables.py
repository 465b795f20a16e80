"""Tables 1 to 4 of the paper, filled from the compiled model.

Words of definitions are ours; every number and every name of a status or an action is read out of
the model.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.model import BITS, NONE, effect, marginal, weights
from exact_mdp.paper_repro.reading import Reading


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of the report; the first cell of a row names it.

    `place` is the table of the paper that it fills, "Table 3", or empty.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str
    place: str = ""


def all_tables(reading: Reading) -> list[Table]:
    """Return Tables 1 to 4 as the model has them."""
    scenario, mdp = reading.scenario, reading.mdp
    optimal, random = (reading.evaluations[name] for name in ("optimal", "random"))
    held = weights(mdp)
    return [
        Table(
            place="Table 1",
            title="Terms, and what they are in the model",
            headings=("term", "in the model", "number"),
            rows=(
                ("scenario", "all tasks, from status 0000 to the end", f"{mdp.n_states} states"),
                (
                    "task",
                    "subtasks in a row, with a bonus at the end",
                    f"subtasks of each task: {', '.join(map(str, scenario.tasks))}",
                ),
                (
                    "subtask",
                    "is completed by a trial that ends in status 0000, or skipped",
                    "skipped at least once in an episode of random actions: "
                    f"{random.skip_probability:.1%}",
                ),
                ("trial", "one attempt at a subtask", f"up to {scenario.trials} in a subtask"),
                (
                    "timestep",
                    "one assistance and what follows",
                    f"expected in an episode: {optimal.steps:.2f} under the optimal policy, "
                    f"{random.steps:.2f} under random actions",
                ),
            ),
            note="Expected numbers are exact up to a proven rounding error.",
        ),
        Table(
            place="Table 2",
            title="Assistance types, and what each does",
            headings=(
                "action",
                "assistance",
                "statuses that stay with lower probability",
                "w_assist",
            ),
            rows=tuple(
                (f"a{number}", action, _lowered(reading, number), str(held[f"assist.{action}"]))
                for number, action in enumerate(mdp.actions[: len(reported.ACTIONS)])
            ),
            note="An absent status that an assistance names stays absent for certain.",
        ),
        Table(
            place="Table 3",
            title="Transition probabilities without assistance",
            headings=("status at t", "base", *(f"{name} at t+1" for name in BITS)),
            rows=tuple(
                (
                    row,
                    _per_cent(marginal(mdp, 0, NONE, row)),
                    *(
                        _per_cent(marginal(mdp, bit, NONE, row))
                        if row == column
                        else "+" + _per_cent(effect(mdp, row, column))
                        for column in BITS
                    ),
                )
                for row, bit in BITS.items()
            ),
            note="Marginal probabilities summed up from compiled rows; row to column, the default "
            "reading.",
        ),
        Table(
            place="Table 4",
            title="Weights of the reward components",
            headings=("weight", "value"),
            rows=tuple((weight, str(held[weight])) for weight in reported.TABLE_4),
            note="That every outcome earns what Equation 1 makes of them is the claim equation1.",
        ),
    ]


def _lowered(reading: Reading, action: int) -> str:
    """Return the statuses that an action makes less likely to stay."""
    stays = {
        status: [marginal(reading.mdp, bit, each, status) for each in (action, NONE)]
        for status, bit in BITS.items()
    }
    listed = [f"{s} {float(helped):.0%}" for s, (helped, alone) in stays.items() if helped != alone]
    return ", ".join(listed) or "none"


def _per_cent(share: Fraction) -> str:
    return f"{float(100 * share):g} %"
