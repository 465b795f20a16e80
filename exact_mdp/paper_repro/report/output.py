"""How a claim is shown: the cells of a table, an entry of `numbers.json`, lines in the terminal."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims import Judged, Verdict
from exact_mdp.paper_repro.claims.claim import READ_OFF_A_PLOT, Kind
from exact_mdp.paper_repro.readings.completions import STANDARD_ERRORS
from exact_mdp.solvers.solution import Bounded, Certified, Estimated


def number(value: float | None, *, unit: str = "") -> str:
    """Return a number for reading: few digits, and a true minus sign; nothing for None.

    >>> number(0.3, unit="%"), number(-2.2253931), number(6000.0)
    ('30 %', '−2.225', '6,000')
    """
    if value is None:
        return ""
    if unit == "%":
        text = f"{100 * value:.4g} %"
    elif value == int(value) and abs(value) < 1e9:
        text = f"{value:z,.0f}"
    else:
        text = f"{value:.3f}" if abs(value) >= 0.01 else f"{value:.2g}"
    return text.replace("-", "−")


def stated(value: float, *, unit: str = "") -> str:
    """Return a number of the paper with the digits that it has there.

    >>> stated(144.3), stated(-1.0), stated(0.3, unit="%")
    ('144.3', '−1', '30 %')
    """
    return number(value, unit=unit) if unit else f"{value:,.10g}".replace("-", "−")


def cells(each: Judged) -> dict[str, str]:
    """Return the cells of a claim by name; its number is the one that the verdict is of."""
    claim, found = each.claim, each.finding.judged or each.finding
    apart, errors = found.difference, found.standard_errors
    sign = "+" if apart is not None and apart > 0 else ""
    paper = "" if claim.paper is None else stated(float(claim.paper), unit=claim.unit)
    plotted = claim.rule == "plotted" or claim.id == "return.optimal"
    return {
        "id": claim.id,
        "source": claim.source,
        "says": claim.says,
        "paper": f"≈ {paper}" if plotted else paper,
        "exact": found.shown or number(found.exact, unit=claim.unit),
        "kind": str(found.claim or ""),
        "difference": sign + number(apart, unit=claim.unit if apart else ""),
        "errors": "" if errors is None else f"{errors:+z.1f}".replace("-", "−"),
        "verdict": str(each.verdict),
        "share": ""
        if each.others is None or each.verdict is not Verdict.DEPENDS
        else f"{each.others.reproduced:,} of {each.others.tried:,}",
        "why": found.why,
        "others": "" if each.others is None else each.others.text,
        "rerun": claim.rerun,
        "rule": claim.rule,
        "sort": claim.kind,
    }


def entry_of(each: Judged) -> dict[str, Any]:
    """Return a claim with all that was found of it, as JSON."""
    claim, found, value = each.claim, each.finding, each.finding.number
    return {
        "name": claim.id,
        "kind": claim.kind,
        "source": claim.source,
        "says": claim.says,
        "paper": None if claim.paper is None else float(claim.paper),
        "exact": found.exact,
        "exact_rational": str(value.value) if isinstance(value, Certified) else None,
        "difference": found.difference,
        "claim": None if found.claim is None else str(found.claim),
        "error_bound": value.error if isinstance(value, Bounded) else None,
        "estimate_standard_error": value.standard_error if isinstance(value, Estimated) else None,
        "standard_error": found.standard_error,
        "judged": None if found.judged is None else found.judged.exact,
        "difference_in_standard_errors": found.standard_errors,
        "approximate": claim.rule == "plotted",
        "rule": claim.rule,
        "verdict": str(each.verdict),
        "verdict_of_default_reading": str(found.verdict),
        "why": found.why,
        "under_other_readings": None if each.others is None else asdict(each.others),
        "rerun": claim.rerun,
        **found.details,
    }


def counts(judged: Sequence[Judged], kind: Kind) -> dict[str, int]:
    """Return how many inputs, or findings, have each verdict."""
    listed = [each.verdict for each in judged if each.claim.kind == kind]
    return {str(v): listed.count(v) for v in Verdict}


def counted(judged: Sequence[Judged]) -> str:
    """Return the counts in words: inputs first, then findings."""
    inputs, findings = counts(judged, "input"), counts(judged, "finding")
    told = ("hold{} only under other readings of the text", "differ{}", "stay{} open")
    same, *others = inputs.values()
    more = "".join(
        f", {n} {each.format('s' * (n == 1))}" for n, each in zip(others, told, strict=True) if n
    )
    yes, some, no, unknown = findings.values()
    return (
        f"{sum(inputs.values())} inputs (numbers, settings, definitions, and what the text says of "
        f"these) were held against the model: {same} agree{more}. Of {sum(findings.values())} "
        f"findings {yes} are reproduced, {some} depend{'s' * (some == 1)} on the reading of the "
        f"text, {no} are not reproduced, and {unknown} cannot be decided here."
    )


# ---- in the terminal ---------------------------------------------------------------------------

# Headings, the cells that stand below them, and the side that they are set to.
Columns = Sequence[tuple[str, str, Literal["left", "right"]]]
STATEMENTS: Columns = (
    ("statement", "id", "left"),
    ("verdict", "verdict", "left"),
    ("why", "why", "left"),
)
NUMBERS: Columns = (
    ("claim", "id", "left"),
    ("paper", "paper", "right"),
    ("exact or estimate", "exact", "right"),
    ("difference", "difference", "right"),
    ("s.e.", "errors", "right"),
    ("kind", "kind", "left"),
    ("verdict", "verdict", "left"),
)
WIDTH = 100  # of a table of numbers, and of the text below it
WIDE = {"statement": 20, "verdict": len(Verdict.DEPENDS)}  # at least, in a table of statements
LINES = {
    "paper": "paper",
    "exact": "exact",
    "kind": "kind",
    "difference": "difference",
    "errors": "in s.e.",
    "verdict": "verdict",
    "why": "why",
    "others": "other readings",
    "rule": "rule",
}


def _console(width: int) -> Any:
    """Return a console as wide as the terminal, or so wide where there is none."""
    from rich import console

    shown = None if sys.stdout.isatty() else width
    return console.Console(width=shown, highlight=False, markup=False)


def print_table(judged: Sequence[Judged]) -> None:
    """Print statements with their verdicts, and paper, exact and difference: inputs, findings.

    Where something else than the difference decides, a line below the table says what.
    """
    from rich import table as rich

    screen = _console(132)
    for kind in ("input", "finding"):
        listed = [each for each in judged if each.claim.kind == kind]
        for title, columns, numbered in (
            ("statements", STATEMENTS, False),
            ("paper / exact / difference", NUMBERS, True),
        ):
            rows = [each for each in listed if (each.finding.exact is not None) == numbered]
            if not rows:
                continue
            table = rich.Table(
                title=f"{kind}s: {title}", title_justify="left", box=None, pad_edge=False
            )
            told = [cells(each) for each in rows]
            columns = [each for each in columns if any(found[each[1]] for found in told)]
            for heading, _, side in columns:
                wide = None if numbered else WIDE.get(heading)
                table.add_column(
                    heading, justify=side, no_wrap=True, overflow="ellipsis", min_width=wide
                )
            notes = []
            for each, found in zip(rows, told, strict=True):
                if numbered and len(found["exact"]) > 16:
                    found["exact"] = f"{each.finding.exact:.4g}"
                if each.claim.rule == "statement" and each.finding.difference:
                    found["verdict"] += " *"
                    notes.append(f"* {each.claim.id} is judged by a sentence: {found['says']}")
                table.add_row(*(found[name] for _, name, _ in columns))
            screen.print(table)
            for note in notes:
                screen.print(note, width=WIDTH)
            screen.print()
    screen.print(counted(judged), soft_wrap=True)
    screen.print(
        f"s.e.: exact standard errors of an average over {reported.EXPERIMENTS:,} experiments, of "
        f"which an average may be {STANDARD_ERRORS:g} off. "
        f"≈: read off a plot by the authors; it may be {READ_OFF_A_PLOT:g} off. The averages are "
        "those of the best joint fit that training ends with, by which they are judged.",
        width=WIDTH,
    )


def print_claim(each: Judged) -> None:
    """Print one claim with everything that was found of it."""
    screen, found = _console(100), cells(each)
    screen.print(f"{found['id']} ({found['source']})")
    screen.print(found["says"])
    exact = "estimate" if found["kind"] == "estimated" else "exact"
    for name, label in (LINES | {"exact": exact}).items():
        if found[name]:
            screen.print(f"  {label + ':':16}{found[name]}", soft_wrap=True)


def print_changes(label: str, pairs: Sequence[tuple[Judged, Judged]], compared: int) -> None:
    """Print the claims whose verdict differs: under the default reading, and under another."""
    from rich import table as rich

    screen = _console(132)
    table = rich.Table(title=label, title_justify="left", box=None, pad_edge=False)
    for heading in ("claim", "default", "changed", "why"):
        table.add_column(heading, no_wrap=heading != "why")
    for was, now in pairs:
        table.add_row(was.claim.id, str(was.verdict), str(now.verdict), now.finding.why)
    if pairs:
        screen.print(table)
    screen.print(f"{len(pairs)} of {compared} verdicts change under {label}", soft_wrap=True)


def print_places(out: Path) -> None:
    """Say where the files are."""
    screen = _console(132)
    screen.print(f"Figures: {out / 'figures'} (SVG and PNG); numbers: {out / 'numbers.json'}")
    screen.print(f"Report: {out / 'report.html'} and {out / 'report.md'}")
    screen.print(f"One page: {out / 'summary.html'}")
