"""The part of the report about the readings: what is supported, what fits, what can hold together.

Figures and tables show a finished `ReadingStudy`; nothing is computed that it does not hold.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from exact_mdp.analysis.readings import OptionSupport, option_label
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.returns import DRAWS
from exact_mdp.paper_repro.reading import SEED, Reading
from exact_mdp.paper_repro.readings.completions import (
    JEFFREYS,
    LEFT_OUT,
    PARTS,
    counted,
    normalised,
)
from exact_mdp.paper_repro.readings.evidence import (
    SHORT,
    STATEMENTS,
    TOGETHER,
    TOLERANCE,
    Joint,
    contradictions,
    largest_possible,
)
from exact_mdp.paper_repro.readings.findings import ReadingStudy, method
from exact_mdp.paper_repro.readings.reported_policy import cost_by_status
from exact_mdp.paper_repro.readings.training import SETTINGS
from exact_mdp.paper_repro.report.figures import Pictures
from exact_mdp.paper_repro.report.report import Part
from exact_mdp.paper_repro.report.tables import Table
from exact_mdp.paper_repro.reported import (
    AVERAGE_RETURN,
    COMPLETIONS,
    FINAL,
    RANDOM_RETURN,
    STARTS,
    UNIQUE_POLICIES,
)

MARKS = dict(zip(STARTS, (("o", "black"), ("s", "0.45"), ("^", "white")), strict=True))
INK: dict[str, Any] = {"mec": "black", "ecolor": "black"}
SHADES = ("0.15", "0.6", "white")
RANKED = 30  # readings in the figure
LISTED = 10  # readings in the table
FOLDED = {  # kinds of sentences that are folded, and the heading that they stand under
    "method": "How the readings are weighed",
    "not identified": "What the numbers leave open",
    "variant": "With other evidence",
    "cannot hold together": "What cannot hold together",
}
PICTURES = Pictures()


def readings_part(study: ReadingStudy, reading: Reading) -> Part:
    """Return what the search over all readings found; `reading` is the default one."""
    folded: dict[str, list[str]] = {title: [] for title in FOLDED.values()}
    shown: list[str] = []
    for each in (*method(study.main), *study.sentences):
        kind = "variant" if each.text.startswith("Variant") else each.kind
        (folded[FOLDED[kind]] if kind in FOLDED else shown).append(each.text)
    return Part(
        title="Which reading of the text is it?",
        sentences=tuple(shown),
        more={title: tuple(texts) for title, texts in folded.items() if texts},
        figures=tuple(PICTURES),
        tables=(
            _best_readings(study),
            _policies(study),
            _shares(study, reading),
            _completions(reading),
        ),
    )


# ---- figures -----------------------------------------------------------------------------------


@PICTURES.add("reading_support")
def _support(study: ReadingStudy) -> Figure:
    shown = {
        "1,000 experiments each": "1,000 experiments, tolerance 5",
        "10,000 experiments each": "10,000 experiments, tolerance 5",
        "1,000, plot numbers left out": "the three averages alone",
    }
    listed = {label: study.evidence[name].support for label, name in shown.items()}
    names = list(study.search.space.options)
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 6.4), width_ratios=(1, 1))
    for ax, part in zip(axes, (names[:6], names[6:]), strict=True):
        within = {
            label: [each for each in support if each.reading in part]
            for label, support in listed.items()
        }
        _support_bars(ax, within)
    handles, texts = axes[0].get_legend_handles_labels()
    figure.legend(handles, texts, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(
        "Support for each option of each reading, the others averaged out", x=0.01, ha="left"
    )
    return figure


def _support_bars(ax: Axes, listed: Mapping[str, Sequence[OptionSupport]]) -> None:
    """Draw the bars of options, one below the other, under the name of their reading."""
    options = next(iter(listed.values()))
    counts = Counter(option.reading for option in options)
    places, place = [], 0.0
    for number, option in enumerate(options):
        if number == 0 or option.reading != options[number - 1].reading:
            place += 1.5
            name = option.reading.replace("_", " ")
            ax.text(0.01, place - 0.62, name, weight="bold", va="bottom")
        places.append(place)
        prior = 1 / counts[option.reading]
        ax.plot([prior] * 2, [place - 0.42, place + 0.42], color="black", ls=":", lw=1.2)
        place += 1
    height = 0.26
    for number, (label, part) in enumerate(listed.items()):
        ax.barh(
            np.array(places) + (number - 1) * height,
            [option.weight for option in part],
            height=height,
            label=label,
            color=SHADES[number],
            edgecolor="black",
            linewidth=0.5,
        )
    ax.plot([], [], color="black", ls=":", label="weight before any evidence")
    ax.set_yticks(places, [option_label(option.option) for option in options])
    ax.set_ylim(place, 0.6)
    ax.set_xlim(0, 1)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel("posterior weight")


@PICTURES.add("reading_ranking")
def _ranking(study: ReadingStudy) -> Figure:
    search, found = study.search, study.main
    numbers = list(dict.fromkeys([*found.ranking[:RANKED].tolist(), 0]))
    y = np.arange(len(numbers))
    figure, (left, right, weight) = plt.subplots(
        1, 3, figsize=(13.5, 8.8), sharey=True, width_ratios=(3, 1.5, 1)
    )
    # Small letters come out wider on paper than the layout takes them for.
    figure.set_layout_engine("constrained", rect=(0.04, 0, 0.96, 1))
    chosen = found.completion[numbers]
    for place, (start, average) in enumerate(AVERAGE_RETURN.items()):
        variance = search.variance[numbers, chosen, place]
        marker, fill = MARKS[start]
        _stated(left, average, f"{average}")
        left.errorbar(
            search.mean[numbers, chosen, place],
            y,
            xerr=2 * np.sqrt(variance / found.experiments),
            fmt=marker,
            **{**INK, "ms": 4.5, "mfc": fill, "elinewidth": 0.7},
            label=f"{SHORT[start]} in 0000",
        )
    _stated(right, RANDOM_RETURN, f"≈ {RANDOM_RETURN}")
    right.axvspan(RANDOM_RETURN - TOLERANCE, RANDOM_RETURN + TOLERANCE, color="0.9", lw=0)
    right.plot(search.random_mean[numbers], y, "D", ms=4, mfc="white", mec="black")
    weight.barh(y, found.weights[numbers], color="0.4", height=0.6)
    left.set_yticks(y, [_wrapped(search.space.label(number)) for number in numbers], fontsize=6)
    left.set_ylim(len(numbers) - 0.4, -1.4)
    left.set_xlabel("mean return, exact, ± 2 standard errors\nof an average of 1,000 experiments")
    right.set_xlabel("mean return of the\nrandom strategy, exact")
    weight.set_xlabel("posterior weight")
    weight.xaxis.set_major_locator(MaxNLocator(3))
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=3, frameon=False)
    figure.suptitle(
        f"The {RANKED} best supported readings and the default: what changes from the default, "
        "and what it returns",
        x=0.01,
        ha="left",
    )
    return figure


def _stated(ax: Axes, value: float, text: str) -> None:
    """Mark a reported number by a line."""
    ax.axvline(value, color="0.5", lw=0.8, ls="--")
    ax.text(value, -1.3, text, ha="center", va="bottom")


def _wrapped(label: str) -> str:
    """Return a label in one line, or in two of nearly the same length."""
    parts = label.split(", ")
    if len(parts) < 4:
        return label
    ways = [(", ".join(parts[:k]) + ",", ", ".join(parts[k:])) for k in range(1, len(parts))]
    return "\n".join(min(ways, key=lambda lines: max(map(len, lines))))


@PICTURES.add("reading_scatter")
def _scatter(study: ReadingStudy) -> Figure:
    figure, (whole, near) = plt.subplots(1, 2, figsize=(11.5, 5.2))
    for ax, size in ((whole, 9), (near, 22)):
        _points(study, ax, size)
        ax.set_xlabel("mean return of the random strategy, exact (points)")
    whole.set_ylabel(
        "mean return of the final policy (a2 in 0000), exact,\nbest completion (points)"
    )
    whole.set_title("all readings")
    near.set_title("near what is reported")
    x, y = RANDOM_RETURN, AVERAGE_RETURN[FINAL]
    near.set_xlim(x - 2.5 * TOLERANCE, x + 4 * TOLERANCE)
    near.set_ylim(y - 7, y + 5)
    handles, labels = whole.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    return figure


def _points(study: ReadingStudy, ax: Axes, size: float) -> None:
    search, found = study.search, study.main
    best = (np.arange(len(search.space)), found.completion, 0)
    final, spread = search.mean[best], search.variance[best]
    codes, names = search.space.codes, search.space.names
    tasks, rate = codes[:, names.index("tasks")], codes[:, names.index("evaluation_discount")]
    for number, shape in enumerate(search.space.options["tasks"]):
        for discounted, fill in ((0, "0.45"), (1, "white")):
            here = (tasks == number) & (rate == discounted)
            ax.scatter(
                search.random_mean[here],
                final[here],
                s=size,
                marker="os^Dv*"[number],
                facecolors=fill,
                edgecolors="black",
                linewidths=0.3,
                rasterized=True,  # thousands of points
                label=f"tasks {option_label(shape)}" if discounted == 0 else None,
            )
    ax.scatter([], [], s=size, facecolors="white", edgecolors="black", label="white: γ = 0.95")
    ax.errorbar(
        RANDOM_RETURN,
        AVERAGE_RETURN[FINAL],
        xerr=2 * TOLERANCE,
        yerr=2 * float(np.sqrt(np.median(spread[found.credible()]) / found.experiments)),
        fmt="P",
        **{**INK, "ms": 9, "mfc": "white", "elinewidth": 1.6},
        capsize=4,
        zorder=5,
        label="reported, ± 2 sd",
    )
    ax.scatter(
        search.random_mean[0],
        final[0],
        s=90,
        facecolors="none",
        edgecolors="black",
        linewidths=1.6,
        zorder=5,
        label="default reading",
    )


@PICTURES.add("reading_joint")
def _joint(study: ReadingStudy) -> Figure:
    columns = {
        n: [*largest_possible(sets), *contradictions(sets)] for n, sets in study.joints.items()
    }
    widths = [max(len(sets), 2) for sets in columns.values()]
    figure, axes = plt.subplots(
        2,
        len(columns),
        figsize=(4.2 + 0.75 * sum(widths), 5.6),
        sharey="row",
        width_ratios=widths,
        height_ratios=(1.3, 1),
        squeeze=False,
    )
    names = {name for sets in columns.values() for each in sets for name in each.statements}
    order = [name for name in STATEMENTS if name in names]
    for column, (experiments, sets) in enumerate(columns.items()):
        _joint_column(axes[0, column], axes[1, column], sets, order)
        axes[0, column].set_title(f"{experiments:,} experiments")
    axes[0, 0].set_ylabel("largest distance of a statement,\nat best (standard deviations)")
    axes[1, 0].set_yticks(range(len(order)), [STATEMENTS[name][1] for name in order])
    figure.suptitle(
        "Statements that can hold together under some reading (grey), and that cannot (black)",
        x=0.01,
        ha="left",
    )
    return figure


def _joint_column(bars: Axes, dots: Axes, sets: Sequence[Joint], order: Sequence[str]) -> None:
    scores = [one.score for one in sets]
    shades = ["0.75" if one.possible else "0.15" for one in sets]
    drawn = bars.bar(
        range(len(sets)), scores, width=0.6, edgecolor="black", linewidth=0.6, color=shades
    )
    bars.bar_label(drawn, [f"{score:.1f}" for score in scores])
    bars.axhline(TOGETHER, color="black", ls="--", lw=0.8)
    for place, one in enumerate(sets):
        held = [order.index(name) for name in one.statements]
        dots.plot([place] * len(order), range(len(order)), "o", ms=6, color="0.88", zorder=1)
        dots.plot([place] * len(held), held, "o-", ms=6, color="black", lw=1, zorder=2)
    for ax in (bars, dots):
        ax.set_xlim(-0.6, max(len(sets), 2) - 0.4)
        ax.set_xticks([])
    dots.set_ylim(len(order) - 0.5, -0.5)
    dots.spines[["bottom", "left"]].set_visible(False)
    dots.tick_params(axis="y", length=0)


@PICTURES.add("reading_learning")
def _learning(study: ReadingStudy) -> Figure:
    learned = study.learned
    figure, ax = plt.subplots(figsize=(8.2, 4.2))
    y = np.arange(len(learned.readings))
    for column, schedule in enumerate(SETTINGS):
        share = learned.hits[:, column] / learned.seeds
        low, high = np.array([learned.interval(place, column) for place in range(len(y))]).T
        ax.errorbar(
            y + 0.3 * (column - 0.5),
            share,
            yerr=np.maximum([share - low, high - share], 0.0),
            fmt="os"[column],
            **{**INK, "ms": 4, "mfc": ("black", "white")[column], "ecolor": "0.4"},
            elinewidth=0.8,
            capsize=1.5,
            label=f"{UNIQUE_POLICIES[schedule]} unique policies, {schedule} exploration",
        )
    names = [
        f"{place + 1}" if number else "default" for place, number in enumerate(learned.readings)
    ]
    ax.set_xticks(y, names, fontsize=7, rotation=90)
    ax.set_xlabel("reading, in the order of its support by the reported returns")
    ax.set_ylabel(f"share of {learned.seeds} training runs")
    ax.set_ylim(0, 1)
    ax.set_title("Unique policies in the last 100 episodes as reported, with 95 % intervals")
    ax.legend(loc="upper right", frameon=False)
    return figure


# ---- tables ------------------------------------------------------------------------------------


def _best_readings(study: ReadingStudy) -> Table:
    """Return the best supported readings beside what is reported."""
    search, found, rows = study.search, study.main, []
    for place, number in enumerate(found.ranking[:LISTED].tolist(), start=1):
        completion = int(found.completion[number])
        rows.append(
            (
                f"{place}",
                search.space.label(number),
                f"{found.weights[number]:.2%}",
                *(f"{mean:.1f}" for mean in search.mean[number, completion]),
                f"{search.random_mean[number]:.1f}",
                f"{search.optimum[number]:.1f}",
                reported.told(search.completions[completion]),
            )
        )
    stated = map(str, AVERAGE_RETURN.values())
    rows.append(("", "reported", "", *stated, f"≈ {RANDOM_RETURN}", "", ""))
    return Table(
        title=f"The {LISTED} best supported readings",
        headings=(
            "rank",
            "differs from the default in",
            "weight",
            *(f"{start} in 0000" for start in STARTS),
            "random",
            "optimum",
            "1000 and 0100; the open statuses",
        ),
        rows=tuple(rows),
        note="Weights are posterior, from a uniform prior over all readings; readings that nothing "
        "tells apart share a weight. Completions have the weights with which training ends with "
        "them. The three averages are those of the completion that fits best and is learned often, "
        "taken together. The number of unique policies is left out of the weights: it is known "
        "for the readings that were trained alone; what it adds is said above.",
    )


def _shares(study: ReadingStudy, reading: Reading) -> Table:
    """Return how often training ends with each option of what the text leaves open."""
    own, options = reading.completions, [list(reported.ORDERS)] + [list(reported.ACTIONS)] * 4
    drawn = counted(study.sampled.final) + JEFFREYS
    others, rows = normalised(drawn), []
    for part, name in enumerate(PARTS):
        for place, option in enumerate(options[part]):
            cells = []
            for schedule in range(len(SETTINGS)):
                low, high = own.intervals[schedule, part, place]
                share, there = own.shares[schedule, part, place], others[:, schedule, part, place]
                cells += [
                    f"{share:.1%} ({low:.1%} to {high:.1%})",
                    f"{there.mean():.1%} ({there.min():.1%} to {there.max():.1%})",
                ]
            rows.append(("1000 and 0100" if part == 0 else name, option, *cells))
    shown = [f"{where}, {each} ε" for each in SETTINGS for where in ("default", "drawn at random")]
    return Table(
        title="What training ends with where the text leaves it open",
        headings=("status", "action", *shown),
        rows=tuple(rows),
        note=f"Shares of {reading.runs} runs under the default reading, with 95 % intervals, from "
        f"Jeffreys' prior; and of {study.sampled.seeds} runs under each of "
        f"{len(study.sampled.readings)} readings drawn at random, with the least and the greatest. "
        "The order of 1000 and 0100 is counted among the runs that end with one of the two.",
    )


def _completions(reading: Reading) -> Table:
    """Return the completions that training can be expected to end with, the likeliest first."""
    found, drawn = reading.weighed, np.exp(reading.completions.draws(DRAWS, SEED))
    weights = np.exp(reading.completions.log_weights)
    listed = [n for n in np.argsort(-weights).tolist() if found.learnable[n]]
    low, high = np.quantile(drawn, [0.025, 0.975], axis=0)
    fitting = {int(found.fitting): "best learnable", int(found.fitting_of_all): "best of all"}
    rows = tuple(
        (
            reported.told(COMPLETIONS[n]),
            f"{weights[n]:.2g}",
            f"{low[n]:.2g} to {high[n]:.2g}",
            *(f"{mean:.1f}" for mean in found.mean[n]),
            f"{found.chi_squared[n]:.1f}",
            f"{found.probabilities[n]:.2g}",
            fitting.get(n, ""),
        )
        for n in dict.fromkeys([*listed, *fitting])
    )
    return Table(
        title="Completions that training can be expected to end with",
        headings=(
            "1000 and 0100; the open statuses",
            "weight",
            "95 % interval",
            *(f"{start} in 0000" for start in STARTS),
            "χ²",
            "p",
            "fit",
        ),
        rows=rows,
        note="Under the default reading; both runs of the paper ended with the same completion, so "
        "that the shares of both schedules multiply. Listed are the fewest that hold all but "
        f"{LEFT_OUT:.2%} of the weight, and the best fit of all {len(COMPLETIONS)}. The reported "
        f"averages are {', '.join(map(str, AVERAGE_RETURN.values()))}.",
    )


def _policies(study: ReadingStudy) -> Table:
    rows = []
    for each in study.policies:
        costly = cost_by_status(each.audit, each.mdp.space).items()
        costs = [f"{status} {cost:.2f}" for status, cost in costly if cost >= 0.005]
        low, high = each.regret_range
        rows.append(
            (
                each.label,
                reported.told(study.search.completions[each.completion]),
                *(f"{float(x.value):.2f}" for x in (each.value, each.optimal, each.regret)),
                f"{low:.2f} to {high:.2f}",
                ", ".join(costs) or "nowhere",
                *(f"{chance.best:.2%}" for chance in each.ranking),
            )
        )
    return Table(
        title="The reported final policy under these readings",
        headings=(
            "reading",
            "1000 and 0100; the open statuses",
            "value",
            "optimum",
            "regret",
            "regret over all completions",
            "where it errs, and the cost",
            *(f"{chance.experiments:,} runs rank so" for chance in study.policies[0].ranking),
        ),
        rows=tuple(rows),
        note=f"The policy with {FINAL} assistance in 0000, with the completion that fits the "
        "reported numbers best under each reading, named in the second column. The claims show "
        "the default reading with the order as written beside it. Costs by status add up to the "
        "regret, which is against the best policy that knows subtask and trial. The last columns "
        "give the probability that so many experiments rank the three policies as the paper found.",
    )
