"""The report: one document, written as Markdown and as a page that needs nothing else.

Both come from templates (`paper_repro/report/templates`) and the same data. In the page figures are
inline SVG pictures (`data:` addresses), styles are inline, and nothing is loaded from anywhere.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims import Judged
from exact_mdp.paper_repro.claims.claim import RULES
from exact_mdp.paper_repro.numbers import FINAL
from exact_mdp.paper_repro.report import summary
from exact_mdp.paper_repro.report.places import FIGURES, PLACES, SECTIONS, section_of
from exact_mdp.paper_repro.report.tables import Table
from exact_mdp.paper_repro.view import View
from exact_mdp.solvers.solution import Claim

TEMPLATES = Path(__file__).parent / "templates"
ENTRIES = ("table", "assistance.", "skip.")  # claims that are single entries of a table
CLAIM_WORDS = {
    Claim.CERTIFIED: "exact rational number, with a proof that a separate checker accepts",
    Claim.BOUNDED: "floating point, with a bound on its error that is proven",
    Claim.ESTIMATED: "from training runs or samples, with its standard error",
}


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A figure as the report shows it."""

    name: str
    title: str
    caption: str
    alt: str
    place: str


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of the report from a module of its own: sentences, tables and figures."""

    title: str
    anchor: str
    sentences: tuple[str, ...]
    figures: tuple[Shown, ...]
    tables: tuple[Table, ...] = ()


def render(
    out: Path,
    *,
    judged: Sequence[Judged],
    view: View,
    tables: Sequence[Table],
    figures: Sequence[Shown],
    parts: Sequence[Part],
    record: Mapping[str, Any],
    pinned: Sequence[str],
) -> tuple[str, str]:
    """Return the report as Markdown and as HTML; the figures are read from `out`/figures."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    data = {
        "about": summary.ABOUT,
        "limits": summary.LIMITS,
        "plain": summary.plain(judged, view),
        "counts": summary.counts(judged, "finding"),
        "counted": summary.counted(judged),
        "groups": _groups(judged),
        "tables": tables,
        "figures": figures,
        "parts": parts,
        "missing": _missing(figures, parts),
        "rules": RULES,
        "claims": {str(kind): words for kind, words in CLAIM_WORDS.items()},
        "readings": dict(view.scenario.readings),
        "tasks": list(view.scenario.tasks),
        "discount": str(view.scenario.discount),
        "completions": _named(view),
        "final": FINAL,
        "experiments": reported.EXPERIMENTS,
        "record": record,
        "pinned": pinned,
        "places": PLACES,
    }
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["anchor"] = anchor
    environment.filters["cell"] = lambda text: str(text).replace("|", "\\|")
    markdown = environment.get_template("report.md.j2").render(data)
    page = environment.overlay(autoescape=True)
    page.filters["picture"] = lambda name: _picture(out / "figures" / f"{name}.svg")
    return markdown, page.get_template("report.html.j2").render(data)


def anchor(text: str) -> str:
    """Return text as the name of a place in a page.

    Examples
    --------
    >>> anchor("Section 4.1"), anchor("return.random")
    ('section-4-1', 'return-random')
    """
    return "-".join("".join(c if c.isalnum() else " " for c in text.lower()).split())


def number(value: float, *, unit: str = "") -> str:
    """Return a number for reading: few digits, and a true minus sign.

    Examples
    --------
    >>> number(0.3, unit="%"), number(-2.2253931), number(6000.0)
    ('30 %', '−2.225', '6,000')
    """
    if unit == "%":
        text = f"{100 * value:.4g} %"
    elif value == int(value) and abs(value) < 1e9:
        text = f"{value:,.0f}"
    else:
        text = f"{value:.3f}" if abs(value) >= 0.01 else f"{value:.2g}"
    return text.replace("-", "−")


def row(each: Judged) -> dict[str, Any]:
    """Return the cells of a claim."""
    claim, found = each.claim, each.finding
    exact = "" if found.exact is None else number(found.exact, unit=claim.unit)
    apart = found.difference
    difference = ""
    if apart is not None:
        difference = "0" if apart == 0 else number(apart, unit=claim.unit)
        difference = f"+{difference}" if apart > 0 else difference
    errors = found.standard_errors
    plotted = "≈ " if claim.rule == "plotted" or claim.id == "return.optimal" else ""
    paper = "" if claim.paper is None else plotted + number(float(claim.paper), unit=claim.unit)
    return {
        "id": claim.id,
        "source": claim.source,
        "says": claim.says,
        "paper": paper,
        "exact": found.shown or exact,
        "kind": "" if found.claim is None else str(found.claim),
        "difference": difference,
        "errors": "" if errors is None else f"{errors:+.1f}".replace("-", "−"),
        "verdict": str(found.verdict),
        "why": found.why,
        "under": "" if each.under is None else each.under.text,
        "rerun": claim.rerun,
        "rule": claim.rule,
        "sort": claim.kind,
    }


def _groups(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return the claims by section; entries of tables apart, because there are many."""
    groups = []
    for section, title in SECTIONS.items():
        inside = [each for each in judged if section_of(each.claim.places[0]) == section]
        if not inside:
            continue
        rows = [row(each) for each in inside]
        entries = [r for r in rows if r["id"].startswith(ENTRIES) and r["rule"] == "entry"]
        groups.append(
            {
                "section": section,
                "title": title,
                "rows": [r for r in rows if r not in entries],
                "entries": entries,
                "entries_reproduced": sum(r["verdict"] == "reproduced" for r in entries),
            }
        )
    return groups


def _named(view: View) -> dict[str, str]:
    """Return the three completions that numbers here are given for, each in one line."""
    found = view.study.completions
    places = {
        "highest value as written": found.best(),
        "highest value swapped": found.best("swapped"),
        "best joint fit": found.fitting,
    }
    return {
        name: f"{reported.told(found.choices[place])} (value {found.mean[FINAL][place]:.2f})"
        for name, place in places.items()
    }


def _missing(figures: Sequence[Shown], parts: Sequence[Part]) -> list[tuple[str, str, str]]:
    """Return every figure of the paper with the figures here that answer to it."""
    shown = [*figures, *(figure for part in parts for figure in part.figures)]
    return [
        (place, title, ", ".join(f.title for f in shown if f.place == place))
        for place, title in FIGURES.items()
    ]


def _picture(path: Path) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
