"""The page of an audit: verdict, what is lost, the policy with its wrong states, every table."""

from __future__ import annotations

from dataclasses import replace

from exact_mdp.analysis.gate.audit import Audit
from exact_mdp.analysis.layout import MOST_CELLS, arrange, cells, counts
from exact_mdp.analysis.pages.page import ADVICE, render
from exact_mdp.mdp.report import Report

AT_THE_TOP = ("passed", "checks")  # of the page


def audit_page(
    audit: Audit, report: Report, model: str, policy: str, *, rerun: str, first: int
) -> str:
    """Return the page; `model` and `policy` are what the user named, `first` rows are shown."""
    layout, actions = arrange(audit.mdp), audit.mdp.actions
    grid = cells(audit, layout) if layout.cells <= MOST_CELLS else []
    texts = [text for row in grid for each in row if each for text in (each.text, each.small)]
    legend = [f"{a} {b}" for a, b in zip(layout.signs, actions, strict=True) if a != b]
    legend += counts(texts)
    return render(
        "audit.html.j2",
        model=model,
        policy=policy,
        passed=audit.passed,
        verdict="; ".join(
            f"{'passed' if each.passed else 'failed'}: {each.told}" for each in audit.verdicts
        ),
        facts=[each for each in report.lines().items() if each[0] not in AT_THE_TOP],
        layout=layout,
        cells=grid,
        legend=", ".join(legend),
        tables=[replace(each, first=first) for each in report.shown_tables()],
        notes=[note for note in report.notes if note != ADVICE],  # at the foot of every page
        rerun=rerun,
    )
