"""Parts of the report that come from their own modules: the readings, and the two agents."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.numbers import FINAL
from exact_mdp.paper_repro.readings.statements import method
from exact_mdp.paper_repro.readings.study import ReadingStudy
from exact_mdp.paper_repro.readings.verdict import ReadingVerdict
from exact_mdp.paper_repro.report.report import Part, Shown, anchor
from exact_mdp.paper_repro.report.tables import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Drawing = Callable[[], "Figure"]
LISTED = 10  # readings in the table


def readings_part(study: ReadingStudy) -> tuple[Part, dict[str, Drawing]]:
    """Return what the search over all readings found, and how its figures are drawn."""
    from exact_mdp.paper_repro.readings.figures import FIGURES

    title = "Which reading of the text is it?"
    drawn = {name: partial(draw, study) for name, draw in FIGURES.items()}
    part = Part(
        title=title,
        anchor=anchor(title),
        sentences=tuple(each.text for each in (*method(study.main), *study.sentences)),
        figures=_shown(FIGURES, ""),
        tables=(_ranking(study), _verdicts(study)),
    )
    return part, drawn


def agents_part() -> tuple[Part, dict[str, Drawing]]:
    """Return what can be shown of the two agents, and how its figures are drawn."""
    from exact_mdp.paper_repro.report.section42 import claims, figures

    title, drawn = "The two agents", figures()
    intro = (
        "`python -m paper_repro.agents` plays the two agents, with a scripted language backend or "
        "with a model of yours; the figures below are of the scripted one, and of the decision "
        "model where perception errs."
    )
    part = Part(
        title=title,
        anchor=anchor(title),
        sentences=(intro, *(f"{row.claim} ({row.place}) {row.verdict}." for row in claims())),
        figures=_shown(drawn, "agents_"),
    )
    return part, {f"agents_{name}": draw for name, draw in drawn.items()}


def _shown(figures: Mapping[str, Callable[..., Figure]], prefix: str) -> tuple[Shown, ...]:
    """Describe figures by what their functions say of themselves."""
    shown = []
    for name, draw in figures.items():
        said = inspect.getdoc(draw) or ""
        first, _, rest = said.partition("\n\n")
        title = name.replace("_", " ").capitalize()
        caption = " ".join(first.split())
        more = " ".join(rest.partition("\n\nParameters")[0].split())
        shown.append(
            Shown(
                name=f"{prefix}{name}",
                title=title,
                caption=caption if not more else f"{caption} {more}",
                alt=f"{title}. {caption}",
                place="",
            )
        )
    return tuple(shown)


def _ranking(study: ReadingStudy) -> Table:
    """Return the best supported readings beside what is reported."""
    rows = []
    for each in study.ranking(LISTED):
        mean, filled = each["mean"], each["completion"]
        assert isinstance(mean, Mapping)
        assert isinstance(filled, Mapping)
        rows.append(
            (
                str(each["rank"]),
                str(each["label"]),
                f"{each['weight']:.2%}",
                *(f"{mean[start]:.1f}" for start in reported.AVERAGE_RETURN),
                f"{each['random']:.1f}",
                f"{each['optimum']:.1f}",
                reported.told(filled),
            )
        )
    stated = (str(value) for value in reported.AVERAGE_RETURN.values())
    rows.append(("", "reported", "", *stated, f"≈ {reported.RANDOM_RETURN}", "", ""))
    names = (f"{start} in 0000" for start in reported.AVERAGE_RETURN)
    return Table(
        place="",
        title=f"The {LISTED} best supported readings",
        headings=(
            "rank",
            "differs from the default in",
            "weight",
            *names,
            "random",
            "optimum",
            "1000 and 0100; the open statuses",
        ),
        rows=tuple(rows),
        note="Weights are posterior, from a uniform prior over all readings; readings that nothing "
        "tells apart share a weight. The three averages are those of the completion that fits "
        "best. What training ends with is left out of the weights: it is known for the readings "
        "that were trained alone, by sampling, and through the paper's learning settings as well "
        "as the reading; what it adds is said above.",
    )


def _verdicts(study: ReadingStudy) -> Table:
    rows = []
    for each in study.verdicts:
        chances = (f"{chance.best:.2%}" for chance in each.ranking)
        rows.append(
            (
                each.label,
                reported.told(study.search.completions[each.completion]),
                f"{float(each.value.value):.2f}",
                f"{float(each.optimal.value):.2f}",
                f"{float(each.regret.value):.2f}",
                f"{each.regret_range[0]:.2f} to {each.regret_range[1]:.2f}",
                _costs(each),
                *chances,
            )
        )
    runs = [f"{chance.experiments:,} runs rank so" for chance in study.verdicts[0].ranking]
    return Table(
        place="",
        title="The reported final policy under these readings",
        headings=(
            "reading",
            "1000 and 0100; the open statuses",
            "value",
            "optimum",
            "regret",
            "regret over all completions",
            "where it errs, and the cost",
            *runs,
        ),
        rows=tuple(rows),
        note=f"The policy with {FINAL} assistance in 0000, with the completion that fits the "
        "reported numbers best under each reading, named in the second column. The claims show "
        "the default reading with the order as written beside it. Costs by status add up to the "
        "regret, which is against the best policy that knows subtask and trial. The last columns "
        "give the probability that so many experiments rank the three policies as the paper found.",
    )


def _costs(each: ReadingVerdict) -> str:
    shown = [f"{cost.status} {cost.cost:.2f}" for cost in each.by_status() if cost.cost >= 0.005]
    return ", ".join(shown) or "nowhere"
