"""The page of an audit: verdict, what is lost, the policy with its wrong states, every table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from exact_mdp.analysis.gate.check import Audit
from exact_mdp.analysis.layout import Layout, arrange, symbols
from exact_mdp.analysis.pages.page import render

MOST_CELLS = 4000  # of the map; more are no picture


def audit_page(
    audit: Audit,
    *,
    model: str,
    policy: str,
    facts: Mapping[str, str],
    tables: Sequence[Mapping[str, Any]],
    rerun: str,
) -> str:
    """Return the page; facts and tables are texts, `model` and `policy` what the user named."""
    layout = arrange(audit.mdp)
    drawn = len(layout.rows) * len(layout.columns) <= MOST_CELLS
    shown = symbols(audit.mdp.actions)
    return render(
        "audit.html.j2",
        model=model,
        policy=policy,
        passed=audit.passed,
        verdict="; ".join(
            f"{'passed' if each.passed else 'failed'}: {each.name}; {each.text}"
            for each in audit.verdicts
        ),
        facts=facts.items(),
        layout=layout,
        cells=cells(audit, layout, shown) if drawn else [],
        legend=[pair for pair in zip(shown, audit.mdp.actions, strict=True) if len({*pair}) > 1],
        tables=tables,
        rerun=rerun,
    )


def cells(audit: Audit, layout: Layout, shown: Sequence[str]) -> list[list[dict[str, Any] | None]]:
    """Return what stands in each cell of the map; None where no state is."""
    mdp = audit.mdp
    found: list[list[dict[str, Any] | None]] = [[None] * len(layout.columns) for _ in layout.rows]
    sign = dict(zip(mdp.actions, shown, strict=True))
    wrong = {each.state: each for each in audit.disagreements}
    most = max((each.cost for each in audit.disagreements), default=0.0) or 1.0
    idle = mdp.terminal | mdp.forced | (audit.visits == 0)
    taken = audit.chain.chosen > 0
    for state in layout.shown.tolist():
        pairs = np.array(mdp.pairs_of(state))
        yours = [mdp.actions[action] for action in mdp.pair_action[pairs[taken[pairs]]]]
        each, label = wrong.get(state), mdp.space.label(state)
        visits = f"{audit.visits[state]:.6g} expected visits"
        cell: dict[str, Any] = {"kind": "idle" if idle[state] else "", "small": "", "shade": 0.0}
        if mdp.terminal[state]:
            cell |= {"text": "∎", "title": f"{label}: an episode ends here"}
        elif each is None:
            signs, words = (" or ".join(of) for of in ([sign[name] for name in yours], yours))
            cell |= {"text": signs, "title": f"{label}: {words}; {visits}"}
        else:
            cell |= {
                "kind": "wrong",
                "text": "✗ " + "/".join(sign[name] for name in yours),
                "small": "/".join(sign[name] for name in each.optimal),
                "shade": each.cost / most,
                "title": f"{label}: yours {each.learned}, optimal {' or '.join(each.optimal)}; "
                f"{visits}, loses {each.cost:.6g}",
            }
        if layout.listed:
            cell["small"] = f"{cell['small']} {label.removeprefix('state ')}".strip()
        found[layout.row[state]][layout.column[state]] = cell
    return found
