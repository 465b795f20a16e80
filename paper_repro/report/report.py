"""The report: one document, written as Markdown and as a page that needs nothing else.

Both come from templates (`paper_repro/report/templates`) and the same data. In the page figures are
inline SVG pictures (`data:` addresses), styles are inline, and nothing is loaded from anywhere.

Its first page says what was found in words that need no mathematics. A sentence is one of two for
its claim, chosen by the verdict; its numbers are computed. What the words explain besides (that a
hint keeps statuses from setting in, say) rests on the inputs of the model, which are claims of
their own.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from exact_mdp.mdp.lazy import later
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims import Judged, Verdict
from exact_mdp.paper_repro.claims.claim import RULES
from exact_mdp.paper_repro.reading import Reading
from exact_mdp.paper_repro.report.figures import Picture
from exact_mdp.paper_repro.report.output import cells, counted, counts
from exact_mdp.paper_repro.report.tables import Table
from exact_mdp.paper_repro.reported import COMPLETIONS, FIGURES, FINAL, SECTIONS, section_of
from exact_mdp.solvers.solution import Claim

jinja2 = later("jinja2")
TEMPLATES = Path(__file__).parent / "templates"
ENTRIES = ("table", "assistance.", "skip.")  # claims that are single entries of a table
CLAIM_WORDS = {
    Claim.CERTIFIED: "exact rational number, with a proof that a separate checker accepts",
    Claim.BOUNDED: "floating point, with a bound on its error that is proven",
    Claim.ESTIMATED: "from training runs or samples, with its standard error",
}


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of the report from a module of its own: sentences, tables and figures."""

    title: str
    sentences: tuple[str, ...]
    figures: tuple[Picture, ...]
    tables: tuple[Table, ...] = ()


def render(
    out: Path,
    *,
    judged: Sequence[Judged],
    reading: Reading,
    tables: Sequence[Table],
    figures: Sequence[Picture],
    parts: Sequence[Part],
    record: Mapping[str, Any],
    pinned: Sequence[str],
) -> tuple[str, str]:
    """Return the report as Markdown and as HTML; the figures are read from `out`/figures."""
    data = {
        "about": ABOUT,
        "limits": LIMITS,
        "plain": plain(judged, reading),
        "counts": counts(judged, "finding"),
        "counted": counted(judged),
        "groups": _groups(judged),
        "tables": tables,
        "figures": figures,
        "parts": parts,
        "missing": _missing(figures, parts),
        "rules": RULES,
        "claims": {str(kind): words for kind, words in CLAIM_WORDS.items()},
        "readings": dict(reading.scenario.readings),
        "tasks": list(reading.scenario.tasks),
        "discount": str(reading.scenario.discount),
        "completions": _named(reading),
        "final": FINAL,
        "experiments": reported.EXPERIMENTS,
        "record": record,
        "shown": _shown(record),
        "pinned": pinned,
    }
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
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


def _shown(record: Mapping[str, Any]) -> dict[str, object]:
    """Return what of a run record is shown."""
    return {
        "model": f"{record['model']}, {record['model_hash']}",
        "seed": record["seed"],
        "training runs of each schedule": record["training_runs"],
        "simulated episodes behind each check": f"{record['episodes']:,}",
        "versions": ", ".join(f"{name} {v}" for name, v in record["versions"].items()),
        "platform": record["platform"],
        "commit": record["commit"] or "not a checkout",
        "date": record["date"],
    }


def anchor(text: str) -> str:
    """Return text as the name of a place in a page.

    >>> anchor("Section 4.1"), anchor("return.random")
    ('section-4-1', 'return-random')
    """
    return "-".join("".join(c if c.isalnum() else " " for c in text.lower()).split())


def _groups(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return the claims by section; entries of tables apart, because there are many."""
    groups = []
    for section, title in SECTIONS.items():
        inside = [each for each in judged if section_of(each.claim.places[0]) == section]
        if not inside:
            continue
        rows = [cells(each) for each in inside]
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


def _named(reading: Reading) -> dict[str, str]:
    """Return the three completions that numbers here are given for, each in one line."""
    names = ("highest value as written", "highest value swapped", "best joint fit")
    found = reading.averages
    return {
        name: f"{reported.told(COMPLETIONS[number])} (value {found.mean[number, 0]:.2f})"
        for name, number in zip(names, found.named.values(), strict=True)
    }


def _missing(figures: Sequence[Picture], parts: Sequence[Part]) -> list[tuple[str, str, str]]:
    """Return every figure of the paper with the figures here that answer to it."""
    shown = [*figures, *(figure for part in parts for figure in part.figures)]
    return [
        (place, title, ", ".join(f.title for f in shown if f.place == place))
        for place, title in FIGURES.items()
    ]


def _picture(path: Path) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(path.read_bytes()).decode("ascii")


# ---- the first page ----------------------------------------------------------------------------

ABOUT = (
    "The paper lets a simulated robot learn, by trial and error, which kind of spoken help to give "
    "a simulated person living with dementia. The simulation follows fixed probabilities. So the "
    "best possible help can also be computed, without trial and error, and everything that the "
    "paper reports can be held against it. That is done here, claim by claim."
)
LIMITS = (
    "This is about a simulation with invented probabilities, by its authors' own account a "
    "simplification. It says nothing about any person, and it is not medical advice."
)


class Plain(NamedTuple):
    """One finding in plain words, and the claim that it rests on."""

    verdict: Verdict
    text: str
    claim: str


PLAIN_ACTIONS = {
    "none": "no help",
    "supportive": "encouragement",
    "non-directive": "a hint",
    "directive": "clear instruction",
}

# For each claim what to say where it is reproduced, and where it is not.
WORDS: dict[str, tuple[str, str]] = {
    "policy.anger": (
        "When the person is angry, encouragement is best, whatever else is the matter. The paper "
        "says so, and it is exactly right.",
        "When the person is angry, encouragement is not always best, as the paper says it is.",
    ),
    "policy.1100": (
        "When the person is forgetful and confused, but neither angry nor disengaged, clear "
        "instruction is best, as the paper says.",
        "When the person is forgetful and confused, clear instruction is not best, unlike what "
        "the paper says.",
    ),
    "policy.0100": (
        "When the person is confused only, a hint is best, as the paper says.",
        "When the person is confused only, the paper's policy, as its sentence is written, gives a "
        "hint; clear instruction is better. This costs {confused:.1f} of {optimum:.1f} points on "
        "average.",
    ),
    "policy.0000": (
        "When nothing is the matter, a hint is best: it keeps the person from becoming forgetful "
        "or confused. The paper finds this too.",
        "When nothing is the matter, a hint is not best, unlike what the paper finds.",
    ),
    "learning.superior": (
        "What the robot learns is better than help at random in every one of our training runs.",
        "What the robot learns is not always better than help at random.",
    ),
    "return.random": (
        "Help at random earns {random:.0f} points on average, about as the paper's plot shows.",
        "Help at random earns {random:.0f} points on average, where the paper's plot shows about "
        "{plotted}: either the text is to be read otherwise, or the paper's simulation differs "
        "from it.",
    ),
    "return.together": (
        "The three averages that the paper gives agree with exact computation where what the text "
        "leaves open is filled in as fits them best, the best of {ways} ways: with {one} when the "
        "person is forgetful only, {other} when confused only, which is the paper's sentence "
        "{order}.",
        "The three averages that the paper gives do not agree with exact computation, in whichever "
        "of {ways} ways what the text leaves open is filled in, under the reading of the text that "
        "is used here first; other readings are tried below.",
    ),
    "policy.final-is-optimal": (
        "The paper's final policy is the best there is.",
        "The paper's final policy stays {near:.1f} to {far:.1f} points below the best possible "
        "{optimum:.1f}, depending on how “respectively” is read: {reported:.1f} with the sentence "
        "as written, {fitting:.1f} with it {order} and the rest filled in as fits the averages "
        "best. Nothing that the text leaves open closes the gap: {least:.1f} points at least.",
    ),
}


def plain(judged: Sequence[Judged], reading: Reading) -> list[Plain]:
    """Return the findings in plain words, for the claims that were worked out."""
    by_name = {each.claim.id: each for each in judged}
    optimum, random, final = (
        reading.evaluations[name].mean for name in ("optimal", "random", f"reported.{FINAL}")
    )
    found = reading.averages
    fitting, filled = float(found.mean[int(found.fitting), 0]), COMPLETIONS[int(found.fitting)]
    near, far = sorted((optimum - final, optimum - fitting))
    audited = by_name.get("policy.final-is-optimal")
    costs = audited.finding.details["cost_by_status"] if audited else {}
    numbers = {
        "optimum": optimum,
        "random": random,
        "plotted": reported.RANDOM_RETURN,
        "reported": final,
        "fitting": fitting,
        "near": near,
        "far": far,
        "least": optimum - found.range(FINAL)[1],
        "confused": costs.get("0100", 0.0),
        "ways": len(COMPLETIONS),
        "one": PLAIN_ACTIONS[filled["1000"]],
        "other": PLAIN_ACTIONS[filled["0100"]],
        "order": reported.order(filled),
    }
    return [
        Plain(verdict, (no, yes)[verdict is Verdict.REPRODUCED].format(**numbers), name)
        for name, (yes, no) in WORDS.items()
        if name in by_name
        for verdict in [by_name[name].verdict]
    ]
