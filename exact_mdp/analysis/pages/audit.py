"""The page of an audit: verdict, what is lost, the policy with its wrong states, every table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from exact_mdp.analysis.gate.audit import Audit
from exact_mdp.analysis.gate.cells import cells
from exact_mdp.analysis.layout import arrange
from exact_mdp.analysis.pages.page import render

MOST_CELLS = 4000  # of the map; more are no picture


def audit_page(
    audit: Audit,
    *,
    model: str,
    policy: str,
    facts: Mapping[str, str],
    tables: Sequence[Mapping[str, Any]],
    notes: Sequence[str],
    rerun: str,
) -> str:
    """Return the page; facts and tables are texts, `model` and `policy` what the user named."""
    layout, actions = arrange(audit.mdp), audit.mdp.actions
    drawn = len(layout.rows) * len(layout.columns) <= MOST_CELLS
    legend = [pair for pair in zip(layout.signs, actions, strict=True) if len({*pair}) > 1]
    return render(
        "audit.html.j2",
        model=model,
        policy=policy,
        passed=audit.passed,
        verdict="; ".join(
            f"{'passed' if each.passed else 'failed'}: {each.told}" for each in audit.verdicts
        ),
        facts=facts.items(),
        layout=layout,
        cells=cells(audit, layout) if drawn else [],
        legend=legend,
        tables=tables,
        notes=notes,
        rerun=rerun,
    )
