"""The figures of the reading search: what is supported, what fits, what can hold together.

Each function draws from a finished `ReadingStudy` and returns the figure; nothing is computed that
the study does not hold, nothing is shown or saved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.readings import OptionSupport, option_label
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.evidence import TOLERANCE
from exact_mdp.paper_repro.readings.joint import TOGETHER, Joint, contradictions, largest_possible
from exact_mdp.paper_repro.readings.learning import SETTINGS
from exact_mdp.paper_repro.readings.search import STARTS
from exact_mdp.paper_repro.readings.study import ReadingStudy

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHORT = {"non-directive": "a2", "directive": "a3", "supportive": "a1"}
LOOKS = {"non-directive": ("o", "black"), "directive": ("s", "0.45"), "supportive": ("^", "white")}
SHADES = ("0.15", "0.6", "white")
RANKED = 30


def support_figure(study: ReadingStudy) -> Figure:
    """Posterior weight of each option of each reading, under three sets of evidence."""
    import matplotlib.pyplot as plt

    chosen = ("1,000 experiments, tolerance 5", "10,000 experiments, tolerance 5")
    last = "the three averages alone"
    listed = [study.evidence[name].support for name in (*chosen, last)]
    labels = ("1,000 experiments each", "10,000 experiments each", "1,000, plot numbers left out")
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 6.4), width_ratios=(1, 1))
    names = list(study.search.space.options)
    for ax, part in zip(axes, (names[:6], names[6:]), strict=True):
        _support_bars(ax, [[o for o in one if o.reading in part] for one in listed], labels)
    handles, texts = axes[0].get_legend_handles_labels()
    figure.legend(handles, texts, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(
        "Support for each option of each reading, the others averaged out", x=0.01, ha="left"
    )
    return figure


def _support_bars(
    ax: Axes, parts: Sequence[Sequence[OptionSupport]], labels: Sequence[str]
) -> None:
    place, ticks, texts, previous = 0.0, [], [], ""
    at = []
    for option in parts[0]:
        if option.reading != previous:
            place += 1.5
            ax.text(0, place - 0.62, option.reading.replace("_", " "), weight="bold", va="bottom")
            previous = option.reading
        at.append(place)
        ticks.append(place)
        texts.append(option_label(option.option))
        place += 1
    height = 0.26
    for number, (part, label) in enumerate(zip(parts, labels, strict=True)):
        ax.barh(
            np.array(at) + (number - 1) * height,
            [option.weight for option in part],
            height=height,
            color=SHADES[number],
            edgecolor="black",
            linewidth=0.5,
            label=label,
        )
    counts = [sum(o.reading == option.reading for o in parts[0]) for option in parts[0]]
    for y, count in zip(at, counts, strict=True):
        ax.plot([1 / count] * 2, [y - 0.42, y + 0.42], color="black", ls=":", lw=1.2)
    ax.plot([], [], color="black", ls=":", label="weight before any evidence")
    ax.set_yticks(ticks, texts)
    ax.set_ylim(place, 0.6)
    ax.set_xlim(0, 1)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel("posterior weight")


def ranking_figure(study: ReadingStudy) -> Figure:
    """The best supported readings and the default: exact means beside what was reported."""
    import matplotlib.pyplot as plt
    from matplotlib.ticker import MaxNLocator

    rows = study.ranking(RANKED)
    search, found = study.search, study.main
    numbers = [int(row["reading"]) for row in rows]
    if 0 not in numbers:
        numbers.append(0)
    y = np.arange(len(numbers))
    figure, (left, right, weight) = plt.subplots(
        1, 3, figsize=(13.5, 7.6), sharey=True, width_ratios=(3, 1.5, 1)
    )
    chosen = [int(found.completion[number]) for number in numbers]
    for place, start in enumerate(STARTS):
        mean = search.mean[numbers, chosen, place]
        error = 2 * np.sqrt(search.variance[numbers, chosen, place] / found.experiments)
        marker, fill = LOOKS[start]
        average = reported.AVERAGE_RETURN[start]
        left.axvline(average, color="0.5", lw=0.8, ls="--")
        left.text(average, -1.3, f"{average}", ha="center", va="bottom")
        left.errorbar(
            mean,
            y,
            xerr=error,
            fmt=marker,
            ms=4.5,
            mfc=fill,
            mec="black",
            ecolor="black",
            elinewidth=0.7,
            label=f"{SHORT[start]} in 0000",
        )
    right.axvline(reported.RANDOM_RETURN, color="0.5", lw=0.8, ls="--")
    right.axvspan(
        reported.RANDOM_RETURN - TOLERANCE, reported.RANDOM_RETURN + TOLERANCE, color="0.9", lw=0
    )
    right.plot(search.random_mean[numbers], y, "D", ms=4, mfc="white", mec="black")
    right.text(
        reported.RANDOM_RETURN, -1.3, f"≈ {reported.RANDOM_RETURN}", ha="center", va="bottom"
    )
    weight.barh(y, found.weights[numbers], color="0.4", height=0.6)
    space = search.space
    left.set_yticks(y, [_wrapped(space.label(number)) for number in numbers], fontsize=6)
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


def _wrapped(label: str) -> str:
    """Return a label in at most two lines."""
    parts = label.split(", ")
    if len(parts) < 4:
        return label
    half = (len(parts) + 1) // 2
    return ", ".join(parts[:half]) + ",\n" + ", ".join(parts[half:])


def scatter_figure(study: ReadingStudy) -> Figure:
    """Mean return of the final policy and of the random strategy, one point for each reading."""
    import matplotlib.pyplot as plt

    figure, (whole, near) = plt.subplots(1, 2, figsize=(11.5, 5.2))
    for ax, size in ((whole, 9), (near, 22)):
        _scatter(study, ax, size)
        ax.set_xlabel("mean return of the random strategy, exact (points)")
    whole.set_ylabel(
        "mean return of the final policy (a2 in 0000), exact,\nbest completion (points)"
    )
    whole.set_title("all readings")
    near.set_title("near what is reported")
    x, y = reported.RANDOM_RETURN, reported.AVERAGE_RETURN["non-directive"]
    near.set_xlim(x - 2.5 * TOLERANCE, x + 4 * TOLERANCE)
    near.set_ylim(y - 7, y + 5)
    handles, labels = whole.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    return figure


def _scatter(study: ReadingStudy, ax: Axes, size: float) -> None:
    search, found = study.search, study.main
    best, place = (np.arange(len(search.space)), found.completion), STARTS.index("non-directive")
    final, spread = search.mean[(*best, place)], search.variance[(*best, place)]
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
    error = float(np.sqrt(np.median(spread[found.credible()]) / found.experiments))
    ax.errorbar(
        reported.RANDOM_RETURN,
        reported.AVERAGE_RETURN["non-directive"],
        xerr=2 * TOLERANCE,
        yerr=2 * error,
        fmt="P",
        ms=9,
        mfc="white",
        mec="black",
        ecolor="black",
        elinewidth=1.6,
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


def joint_figure(study: ReadingStudy) -> Figure:
    """The largest sets of statements that can hold together, and the smallest that cannot."""
    import matplotlib.pyplot as plt

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
    names = list(dict.fromkeys(n for sets in columns.values() for s in sets for n in s.statements))
    order = [name for name in LONG if name in names]
    for column, (experiments, sets) in enumerate(columns.items()):
        _joint_column(axes[0, column], axes[1, column], sets, order)
        axes[0, column].set_title(f"{experiments:,} experiments")
    axes[0, 0].set_ylabel("largest distance of a statement,\nat best (standard deviations)")
    axes[1, 0].set_yticks(range(len(order)), [LONG[name] for name in order])
    figure.suptitle(
        "Statements that can hold together under some reading (grey), and that cannot (black)",
        x=0.01,
        ha="left",
    )
    return figure


LONG = {
    **{
        SHORT[start]: f"{SHORT[start]} in 0000 returns {average}"
        for start, average in reported.AVERAGE_RETURN.items()
    },
    "converged": f"learned policies: about {reported.CONVERGED_RETURN}",
    "random": f"random strategy: around {reported.RANDOM_RETURN}",
    "ranking": "a2 above a3 above a1",
    "respectively": "1000: a3 and 0100: a2, as written",
    "optimal": "the final policy is optimal",
}


def _joint_column(bars: Axes, dots: Axes, sets: Sequence[Joint], order: Sequence[str]) -> None:
    x = np.arange(len(sets))
    bars.bar(
        x,
        [one.score for one in sets],
        width=0.6,
        edgecolor="black",
        linewidth=0.6,
        color=["0.75" if one.possible else "0.15" for one in sets],
    )
    for place, one in enumerate(sets):
        bars.text(place, one.score, f"{one.score:.1f}", ha="center", va="bottom")
    bars.axhline(TOGETHER, color="black", ls="--", lw=0.8)
    bars.set_xticks([])
    for place, one in enumerate(sets):
        held = [order.index(name) for name in one.statements]
        dots.plot([place] * len(order), range(len(order)), "o", ms=6, color="0.88", zorder=1)
        dots.plot([place] * len(held), held, "o-", ms=6, color="black", lw=1, zorder=2)
    dots.set_xlim(-0.6, max(len(sets), 2) - 0.4)
    bars.set_xlim(-0.6, max(len(sets), 2) - 0.4)
    dots.set_ylim(len(order) - 0.5, -0.5)
    dots.set_xticks([])
    for side in ("bottom", "left"):
        dots.spines[side].set_visible(False)
    dots.tick_params(axis="y", length=0)


def learning_figure(study: ReadingStudy) -> Figure:
    """Shares of runs with the reported number of unique policies, by reading, with intervals."""
    import matplotlib.pyplot as plt

    learned = study.learned
    figure, ax = plt.subplots(figsize=(8.2, 4.2))
    y = np.arange(len(learned.readings))
    for column, schedule in enumerate(SETTINGS):
        wanted = reported.UNIQUE_POLICIES[schedule]
        share = learned.hits[:, column] / learned.seeds
        limits = np.array([learned.interval(place, column) for place in range(len(y))])
        error = np.maximum(np.stack([share - limits[:, 0], limits[:, 1] - share]), 0.0)
        ax.errorbar(
            y + 0.3 * (column - 0.5),
            share,
            yerr=error,
            fmt="os"[column],
            ms=4,
            capsize=1.5,
            mfc=("black", "white")[column],
            mec="black",
            ecolor="0.4",
            elinewidth=0.8,
            label=f"{wanted} unique policies, {schedule} exploration",
        )
    ax.set_xticks(y, [f"{place + 1}" for place in y], fontsize=7)
    ax.set_xlabel("reading, in the order of its support by the reported returns")
    ax.set_ylabel(f"share of {learned.seeds} training runs")
    ax.set_ylim(0, 1)
    ax.set_title("Unique policies in the last 100 episodes as reported, with 95 % intervals")
    ax.legend(loc="upper right", frameon=False)
    return figure


FIGURES: dict[str, Callable[[ReadingStudy], Figure]] = {
    "reading_support": support_figure,
    "reading_ranking": ranking_figure,
    "reading_scatter": scatter_figure,
    "reading_joint": joint_figure,
    "reading_learning": learning_figure,
}
"""Every figure by its name."""
