"""What a run writes and prints of its claims: `numbers.json`, `claims.json` and the table."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims import Judged
from exact_mdp.paper_repro.report.report import row
from exact_mdp.paper_repro.report.summary import counted
from exact_mdp.solvers.solution import Bounded, Estimated


def entry_of(each: Judged) -> dict[str, Any]:
    """Return a claim with all that was found of it, as JSON."""
    claim, found = each.claim, each.finding
    number = found.number
    return {
        "name": claim.id,
        "kind": claim.kind,
        "source": claim.source,
        "says": claim.says,
        "paper": None if claim.paper is None else float(claim.paper),
        "exact": found.exact,
        "exact_rational": str(number.value) if found.claim == "certified" and number else None,
        "difference": found.difference,
        "claim": None if found.claim is None else str(found.claim),
        "error_bound": number.error if isinstance(number, Bounded) else None,
        "estimate_standard_error": number.standard_error if isinstance(number, Estimated) else None,
        "standard_error": found.standard_error,
        "difference_in_standard_errors": found.standard_errors,
        "approximate": claim.rule == "plotted",
        "rule": claim.rule,
        "verdict": str(found.verdict),
        "why": found.why,
        "under_other_readings": None if each.under is None else asdict(each.under),
        "rerun": claim.rerun,
        **dict(found.details),
    }


def numbers_of(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return the claims with a number of the paper or of the exact model, for `numbers.json`."""
    return [entry_of(each) for each in judged if each.finding.exact is not None]


def print_table(judged: Sequence[Judged]) -> None:
    """Print statements with their verdicts, and paper, exact and difference: inputs, findings."""
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 132, highlight=False)
    for kind in ("input", "finding"):
        listed = [each for each in judged if each.claim.kind == kind]
        told = Table(title=f"{kind}s: statements", title_justify="left", box=None, pad_edge=False)
        table = Table(
            title=f"{kind}s: paper / exact / difference",
            title_justify="left",
            box=None,
            pad_edge=False,
        )
        for heading in ("statement", "verdict", "why"):
            wide = {"statement": 20, "verdict": len("not determined")}.get(heading)
            told.add_column(heading, no_wrap=True, overflow="ellipsis", min_width=wide)
        for heading in HEADINGS:
            side = "left" if heading in LEFT else "right"
            table.add_column(heading, justify=side, no_wrap=True)
        for each in listed:
            cells = row(each)
            if each.finding.exact is None:
                told.add_row(cells["id"], cells["verdict"], cells["why"])
                continue
            exact = cells["exact"] if len(cells["exact"]) <= 16 else f"{each.finding.exact:.4g}"
            table.add_row(
                cells["id"], cells["paper"], exact, cells["difference"], cells["errors"],
                cells["kind"], cells["verdict"],
            )  # fmt: skip
        for part in (told, table):
            if part.row_count:
                console.print(part)
                console.print()
    console.print(counted(judged), soft_wrap=True)
    console.print(
        f"in s.e.: exact standard errors of an average over {reported.EXPERIMENTS:,} "
        "experiments; ≈: read off a plot by the authors.\nThe averages are shown with "
        "“respectively” as written, and judged by the best joint fit of all completions."
    )


HEADINGS = (
    "claim", "paper", "exact or estimate", "difference", "in s.e.", "kind", "verdict"
)  # fmt: skip
LEFT = ("claim", "kind", "verdict")


def print_claim(each: Judged) -> None:
    """Print one claim with everything that was found of it."""
    from rich.console import Console

    console = Console(width=None if sys.stdout.isatty() else 100, highlight=False, markup=False)
    cells = row(each)
    found = "estimate" if cells["kind"] == "estimated" else "exact"
    console.print(f"{cells['id']} ({cells['source']})")
    console.print(cells["says"])
    for label, name in (
        ("paper", "paper"), (found, "exact"), ("kind", "kind"), ("difference", "difference"),
        ("in s.e.", "errors"), ("verdict", "verdict"), ("why", "why"),
        ("other readings", "under"), ("rule", "rule"),
    ):  # fmt: skip
        if cells[name]:
            console.print(f"  {label + ':':16}{cells[name]}", soft_wrap=True)


def print_places(out: Path) -> None:
    """Say where the files are."""
    from rich.console import Console

    console = Console(width=None if sys.stdout.isatty() else 132, highlight=False)
    console.print(f"Figures: {out / 'figures'} (SVG and PNG); numbers: {out / 'numbers.json'}")
    console.print(f"Report: {out / 'report.html'} and {out / 'report.md'}")
