"""What an audit says of each state, as the cells of a map: a page and a figure show the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from exact_mdp.analysis.gate.audit import Audit
from exact_mdp.analysis.gate.disagreements import either
from exact_mdp.analysis.layout import Layout, joined, taken


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One state of a map.

    Attributes
    ----------
    state : int
    kind : "wrong", "idle" or ""
        Not optimal, visited or not; else without a choice or a visit; neither.
    text, small : str
        What the policy does, with "✗" where that is wrong, and the optimal action then.
    name : str
        The state's number or name, where states are only listed; else "".
    title : str
        The state in full, with its numbers.
    shade : float
        Its loss as a share of the costliest state's, which may be infinite.
    """

    state: int
    kind: Literal["wrong", "idle", ""]
    text: str
    small: str
    name: str
    title: str
    shade: float


def cells(audit: Audit, layout: Layout) -> list[list[Cell | None]]:
    """Return the cell at each row and column of the map; None where no state is."""
    mdp, choices = audit.mdp, taken(audit.mdp, audit.chain.chosen)
    sign = dict(zip(mdp.actions, layout.signs, strict=True))
    grid: list[list[Cell | None]] = [[None] * len(layout.columns) for _ in layout.rows]
    wrong = {each.state: each for each in audit.disagreements}
    most = max((each.cost for each in audit.disagreements), default=0.0) or 1.0
    idle = ~mdp.asked | (audit.visits == 0)
    for state in layout.shown.tolist():
        each, label = wrong.get(state), mdp.space.label(state)
        names = [mdp.actions[action] for action in choices[state]]
        text, best = joined([sign[name] for name in names], "mixed"), ""
        said = f"{either(names)}; {audit.visits[state]:.6g} expected visits"
        if mdp.over[state]:
            text, said = "∎", "an episode ends here"
        elif each is not None:
            text, best = f"✗ {text}", joined([sign[name] for name in each.optimal], "tied")
            said = (
                f"yours {each.learned}, optimal {either(each.optimal)}; "
                f"{each.expected_visits:.6g} expected visits, loses {each.cost:.6g}"
            )
        grid[layout.row[state]][layout.column[state]] = Cell(
            state=state,
            kind="wrong" if each is not None else "idle" if idle[state] else "",
            text=text,
            small=best,
            name=label.removeprefix("state ") if layout.listed and len(layout.columns) > 1 else "",
            title=f"{label}: {said}",
            shade=0.0 if each is None else 1.0 if each.cost == most else each.cost / most,
        )
    return grid
