"""The part of the report about the readings: what is supported, what fits, what can hold together.

Figures and tables show a finished `ReadingStudy`; nothing is computed that it does not hold.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from exact_mdp.analysis.plots.style import PALETTE, Look
from exact_mdp.analysis.readings import OptionSupport, ReadingSpace
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
from exact_mdp.paper_repro.readings.wording import changes, said, title
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
REPORTED = PALETTE[3]
SHADES = ("0.15", "0.6", "white")
RANKED = 30  # readings in the figure
LISTED = 10  # readings in the table
FOLDED = {  # kinds of sentences that are folded, and the heading that they stand under
    "method": "How the readings are weighed",
    "not identified": "What the numbers leave open",
    "variant": "With other evidence",
    "cannot hold together": "What cannot hold together",
    "learning": "What training runs add",
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
    figure, axes = plt.subplots(1, 2, figsize=(9.4, 7.4))
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


def _broken(words: str, most: int = 22) -> str:
    """Return words in lines of nearly equal length, as many as it takes to hold to the most."""
    return fill(words, max(most, -(-len(words) // -(-len(words) // most)) + 4))


def _support_bars(ax: Axes, listed: Mapping[str, Sequence[OptionSupport]]) -> None:
    """Draw the bars of options, one below the other, under the name of their reading."""
    options = next(iter(listed.values()))
    counts = Counter(option.reading for option in options)
    places, place = [], 0.0
    for number, option in enumerate(options):
        if number == 0 or option.reading != options[number - 1].reading:
            place += 1.5
            ax.text(0.01, place - 0.62, title(option.reading), weight="bold", va="bottom")
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
    ax.set_yticks(places, [_broken(said(option.reading, option.option)) for option in options])
    ax.set_ylim(place, 0.6)
    ax.set_xlim(0, 1)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel("posterior weight")


@PICTURES.add("reading_ranking")
def _ranking(study: ReadingStudy) -> Figure:
    search, found = study.search, study.main
    numbers = list(dict.fromkeys([*found.ranking[:RANKED].tolist(), 0]))
    y = np.arange(len(numbers))
    figure, (dots, left, right, weight) = plt.subplots(
        1, 4, figsize=(10, 8.6), sharey=True, width_ratios=(1.7, 3, 1.3, 1)
    )
    _changed(dots, search.space, numbers)
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
    left.set_ylim(len(numbers) - 0.4, -1.4)
    left.set_xlabel(
        "mean return (points), exact, ± 2 standard\nerrors of an average of 1,000 experiments"
    )
    right.set_xlabel("mean return of\nrandom actions\n(points), exact")
    weight.set_xlabel("posterior weight")
    for ax in (left, right, weight):
        ax.tick_params(axis="y", left=False)
    weight.xaxis.set_major_locator(MaxNLocator(3))
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=3, frameon=False)
    figure.suptitle(
        f"The {RANKED} best supported readings: what each changes from the default (a dot), and "
        "what it returns",
        x=0.01,
        ha="left",
    )
    return figure


def _stated(ax: Axes, value: float, text: str) -> None:
    """Mark a reported number by a line."""
    ax.axvline(value, color="0.5", lw=0.8, ls="--")
    ax.text(value, -1.3, text, ha="center", va="bottom")


def _changed(ax: Axes, space: ReadingSpace, numbers: Sequence[int]) -> None:
    """Draw a dot for each option that a reading changes; the columns are those that any changes."""
    settings = [space.settings(number) for number in numbers]
    columns = [
        (name, option)
        for name, options in space.options.items()
        for option in options[1:]
        if any(each[name] == option for each in settings)
    ]
    for row, each in enumerate(settings):
        held = [column for column, (name, option) in enumerate(columns) if each[name] == option]
        ax.plot(range(len(columns)), [row] * len(columns), "o", ms=5, color="0.9")
        ax.plot(held, [row] * len(held), "o", ms=5, color="black")
    ax.set_xticks(range(len(columns)), [said(*column) for column in columns], rotation=90)
    ax.xaxis.tick_top()
    names = ["default" if number == 0 else f"{row + 1}" for row, number in enumerate(numbers)]
    ax.set_yticks(range(len(numbers)), names)
    ax.set_ylabel("rank")
    ax.set_xlim(-0.6, len(columns) - 0.4)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)


@PICTURES.add("reading_scatter")
def _scatter(study: ReadingStudy) -> Figure:
    search, found = study.search, study.main
    best = (np.arange(len(search.space)), found.completion, 0)
    x, y = search.random_mean, search.mean[best]
    discounted = search.space.codes[:, search.space.names.index("evaluation_discount")] == 1
    error = float(np.sqrt(np.median(search.variance[best][found.credible()]) / found.experiments))
    near = (50.0, 100.0, AVERAGE_RETURN[FINAL] - 8, AVERAGE_RETURN[FINAL] + 8)
    whole = (float(x.min()) - 5, float(x.max()) + 5, float(y.min()) - 5, float(y.max()) + 5)
    panels = {
        "all readings": (x > 0, whole),
        "near what is reported, plain sums": (~discounted, near),
        "near what is reported, discounted": (discounted, near),
    }
    figure, axes = plt.subplots(3, 1, figsize=(5.6, 9))
    for ax, (name, (chosen, window)) in zip(axes, panels.items(), strict=True):
        # Readings in a cell are counted: points would lie on top of each other.
        inside = chosen & (x > window[0]) & (x < window[1]) & (y > window[2]) & (y < window[3])
        shown: Look = {"gridsize": (40, 14), "mincnt": 1, "cmap": "Greys", "linewidth": 0}
        cells = ax.hexbin(x[inside], y[inside], extent=window, norm=LogNorm(0.3, 300), **shown)
        ax.errorbar(
            RANDOM_RETURN,
            AVERAGE_RETURN[FINAL],
            xerr=2 * TOLERANCE,
            yerr=2 * error,
            fmt="none",
            ecolor=REPORTED,
            elinewidth=1.8,
            capsize=3,
            label="reported, ± 2 standard deviations",
        )
        if chosen[0]:
            ring: Look = {"mfc": "none", "mec": "black", "mew": 1.4, "ls": ""}
            ax.plot(x[0], y[0], "o", ms=9, label="default reading", **ring)
        ax.set(xlim=window[:2], ylim=window[2:], title=name)
    axes[0].legend(loc="upper left")
    axes[-1].set_xlabel("mean return of random actions, exact (points)")
    figure.supylabel("mean return of the final policy, exact (points)", fontsize=9)
    bar: Look = {"location": "right", "shrink": 0.4, "format": "%g"}
    figure.colorbar(cells, ax=axes, label="readings in a cell", **bar)
    return figure


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
                changes(search.space, number),
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
        note=f"Shares of {reading.runs} runs under the default reading, with 95 % intervals, and "
        f"of {study.sampled.seeds} runs under each of {len(study.sampled.readings)} readings drawn "
        "at random, with the least and the greatest; all smoothed by Jeffreys' prior. "
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
