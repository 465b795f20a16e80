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
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

from exact_mdp.analysis.pages.explorer import explore
from exact_mdp.analysis.pages.page import environment
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims import Judged, Verdict
from exact_mdp.paper_repro.claims.claim import JOINT_LIMIT, RULES
from exact_mdp.paper_repro.claims.policies import optimal_actions
from exact_mdp.paper_repro.reading import Reading
from exact_mdp.paper_repro.readings.evidence import Evidence
from exact_mdp.paper_repro.readings.search import ReadingSearch
from exact_mdp.paper_repro.readings.wording import options_of
from exact_mdp.paper_repro.report.figures import Picture
from exact_mdp.paper_repro.report.output import cells, counted, counts
from exact_mdp.paper_repro.report.tables import Table
from exact_mdp.paper_repro.reported import (
    ANGRY,
    COMPLETIONS,
    FIGURES,
    FINAL,
    NUMBER,
    SECTIONS,
    STATUS_WORDS,
    STATUSES,
    section_of,
)
from exact_mdp.solvers.solution import Claim

WORDS = tomllib.loads((Path(__file__).parent / "first_page.toml").read_text("utf-8"))
TEMPLATES = Path(__file__).parent / "templates"
SIGNS = {
    Verdict.REPRODUCED: "✓",
    Verdict.DEPENDS: "◐",
    Verdict.NOT_REPRODUCED: "✗",
    Verdict.NOT_DETERMINED: "?",
}
NUMBERS = ("learning.converged.", "return.random", "return.reported.")  # of the summary
MOVED = "reward.assist.directive"  # the number that the page's slider moves
CLAIM_WORDS = {
    Claim.CERTIFIED: "exact rational number, with a proof that a separate checker accepts",
    Claim.BOUNDED: "floating point, with a bound on its error that is proven",
    Claim.ESTIMATED: "from training runs or samples, with its standard error",
}


@dataclass(frozen=True, kw_only=True)
class Text:
    """A text that is shown as it is; `place` is the figure of the paper that it answers to."""

    title: str
    body: str
    place: str = ""


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of the report from a module of its own: sentences, tables, figures and texts.

    Of the sentences, those in `more` are folded under a heading.
    """

    title: str
    sentences: tuple[str, ...]
    figures: tuple[Picture, ...]
    tables: tuple[Table, ...] = ()
    texts: tuple[Text, ...] = ()
    more: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


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
    main: Evidence,
) -> tuple[str, str]:
    """Return the report as Markdown and as HTML; the figures are read from `out`/figures."""
    data = _first_page(judged, reading, main) | {
        "outside": WORDS["outside"],
        "verdicts": [str(verdict) for verdict in Verdict],
        "groups": _groups(judged),
        "tables": tables,
        "figures": figures,
        "parts": parts,
        "missing": _missing(figures, parts),
        "rules": RULES,
        "claims": {str(kind): words for kind, words in CLAIM_WORDS.items()},
        "readings": options_of(reading.scenario),
        "completions": _named(reading),
        "filled": WORDS["filled"].format(final=FINAL),
        "standards": WORDS["standards"],
        "experiments": reported.EXPERIMENTS,
        "record": record,
        "shown": _shown(record),
        "pinned": pinned,
    }
    markdown = environment(TEMPLATES, escape=False)
    page = environment(TEMPLATES)
    markdown.filters["cell"] = lambda text: str(text).replace("|", "\\|")
    for each in (markdown, page):
        each.filters["anchor"] = anchor
    page.filters["picture"] = lambda name: _picture(out / "figures" / f"{name}.svg")
    return (
        markdown.get_template("report.md.j2").render(data),
        page.get_template("report.html.j2").render(data, slider=slider(reading)),
    )


def summary(
    judged: Sequence[Judged], reading: Reading, main: Evidence, record: Mapping[str, Any]
) -> str:
    """Return one page of A4 for those who read no more."""
    page = environment(TEMPLATES)
    page.filters["anchor"] = anchor
    numbers = [
        cells(each)
        for each in judged
        if each.claim.id.startswith(NUMBERS) and each.finding.difference is not None
    ]
    data = _first_page(judged, reading, main) | {"numbers": numbers, "shown": _shown(record)}
    return str(page.get_template("summary.html.j2").render(data))


def _first_page(judged: Sequence[Judged], reading: Reading, main: Evidence) -> dict[str, Any]:
    return {
        "paper": reported.PAPER,
        "about": WORDS["about"],
        "bottom": bottom_line(reading, main),
        "conclude": WORDS["conclude"],
        "beyond": WORDS["beyond"],
        "limits": WORDS["limits"],
        "plain": plain(judged, reading, main.search),
        "counts": counts(judged, "finding"),
        "counted": counted(judged),
        "signs": SIGNS,
    }


def slider(reading: Reading) -> str:
    """Return the explorer's page: one weight moves, and the reported policy's regret with it."""
    found = explore(
        reading.scenario,
        MOVED,
        relative="whole",
        policy=reading.policies[f"reported.{FINAL}"],
        said="the reported final policy",
    )
    return found.page(
        rerun=f"exact-mdp explore {reading.scenario.name} --parameter {MOVED} --whole "
        "--html page.html"
    )


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
    """Return the claims by section: what the model was built from, and what was concluded."""
    groups = []
    for section, title in SECTIONS.items():
        inside = [each for each in judged if section_of(each.claim.places[0]) == section]
        kinds: dict[str, list[dict[str, str]]] = {"input": [], "finding": []}
        for each in inside:
            kinds[each.claim.kind].append(cells(each))
        told = {v: n for v, n in counts(inside, "input").items() if n}
        if inside:
            groups.append({"section": section, "title": title, "counts": told, **kinds})
    return groups


def _named(reading: Reading) -> dict[str, str]:
    """Return the completions that numbers here are given for, each in one line."""
    names = (
        "highest value as written",
        "highest value swapped",
        "best joint fit that training ends with",
        "best joint fit of all",
    )
    found = reading.weighed
    return {
        name: f"{reported.told(COMPLETIONS[number])} (value {found.mean[number, 0]:.2f})"
        for name, number in zip(names, found.named.values(), strict=True)
    }


def _missing(figures: Sequence[Picture], parts: Sequence[Part]) -> list[tuple[str, str, str]]:
    """Return every figure of the paper with the figures here that answer to it."""
    shown: list[Picture | Text | Table] = [*figures]
    for part in parts:
        shown += [*part.figures, *part.texts, *part.tables]
    return [
        (place, title, ", ".join(f.title for f in shown if place in f.place.split(", ")))
        for place, title in FIGURES.items()
    ]


def _picture(path: Path) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(path.read_bytes()).decode("ascii")


# ---- the first page ----------------------------------------------------------------------------


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


def bottom_line(reading: Reading, main: Evidence) -> str:
    """Return what was found, in one paragraph, for those who read no more."""
    optimum, random, final = (
        reading.evaluations[name].mean for name in ("optimal", "random", f"reported.{FINAL}")
    )
    advice = {**dict.fromkeys(ANGRY, "supportive"), **reported.STATED, "0000": FINAL}
    wrong, other = (
        [
            f"{STATUS_WORDS[status]} and nothing else, {PLAIN_ACTIONS[action]} is not"
            for status, action in {**advice, **order}.items()
            if not all(NUMBER[action] in best for best in optimal_actions(reading, status))
        ]
        for order in reported.ORDERS.values()
    )
    swapped = _swapped(reading)
    return str(WORDS["bottom"]).format(
        stated=len(advice),
        statuses=len(STATUSES),
        right=len(advice) - len(wrong),
        wrong=_where(wrong),
        other_right=len(advice) - len(other),
        other_wrong=_where(other),
        swapped=swapped,
        swapped_lost=(optimum - swapped) / optimum,
        reported=final,
        optimum=optimum,
        random=random,
        lost=(optimum - final) / optimum,
        perfect=float(perfect(reading)),
        rank=main.rank(),
        readings=len(main.search.space),
        weight=100 * main.weights[0],
    )


def _where(wrong: Sequence[str]) -> str:
    return "".join(f"; where the person is {each}" for each in wrong)


def _swapped(reading: Reading) -> float:
    """Return the final policy's value with the order swapped, the rest filled in at its best."""
    return float(reading.averages.mean[reading.averages.best("swapped"), 0])


def perfect(reading: Reading) -> Fraction:
    """Return what a run earns in which every subtask is done at once, without help.

    >>> from exact_mdp.paper_repro.reading import QUICK, default
    >>> perfect(default(QUICK))
    Fraction(164, 1)
    """
    mdp, (state, _) = reading.mdp, reading.mdp.start[0]
    earned, factor = Fraction(0), Fraction(1)
    while not mdp.terminal[state]:
        here = mdp.space.values("subtask")[state]
        state, gain = next(
            (after, gain)
            for _, after, gain in mdp.table.row(mdp.pair(state, "none"))
            if mdp.terminal[after]
            or (
                mdp.space.values("subtask")[after] > here and mdp.space.values("status")[after] == 0
            )
        )
        earned, factor = earned + factor * gain, factor * mdp.discount_exact
    return earned


def plain(judged: Sequence[Judged], reading: Reading, search: ReadingSearch) -> list[Plain]:
    """Return the findings in plain words, for the claims that were worked out."""
    by_name = {each.claim.id: each for each in judged}
    optimum, random, final = (
        reading.evaluations[name].mean for name in ("optimal", "random", f"reported.{FINAL}")
    )
    found = reading.weighed
    swapped, filled = _swapped(reading), COMPLETIONS[int(found.fitting)]
    near, far = sorted((optimum - final, optimum - swapped))
    audited = by_name.get("policy.final-is-optimal")
    costs = audited.finding.details["cost_by_status"] if audited else {}
    numbers = {
        "optimum": optimum,
        "random": random,
        "plotted": reported.RANDOM_RETURN,
        "reported": final,
        "swapped": swapped,
        "near": near,
        "far": far,
        "kindest": float(search.regret.min()),
        "readings": len(search.space),
        "confused": costs.get("0100", 0.0),
        "chance": 100 * float(found.expected_probability),
        "limit": 100 * JOINT_LIMIT,
        "one": PLAIN_ACTIONS[filled["1000"]],
        "other": PLAIN_ACTIONS[filled["0100"]],
        "order": reported.order(filled),
    }
    sentences = []
    for name, words in WORDS["claims"].items():
        if name in by_name:
            verdict = by_name[name].verdict
            text = words["reproduced" if verdict is Verdict.REPRODUCED else "otherwise"]
            sentences.append(Plain(verdict, text.format(**numbers), name))
    return sentences
