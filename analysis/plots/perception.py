"""Figures about acting on a perceived status."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from exact_mdp.analysis.plots.style import action_styles, axes_or_new, plain_text

if TYPE_CHECKING:
    from exact_mdp.analysis.perception.accuracy import AccuracyCurves, Hedging
    from exact_mdp.analysis.perception.cost import PriceOfPerception
    from exact_mdp.analysis.perception.errors import ErrorCosts
    from exact_mdp.analysis.perception.needed import AccuracyNeeded

MISSED, SEEN = "#FFFFFF", "#56B4E9"
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
DASHES = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)), (0, (3, 1, 1, 1, 1, 1)))


@plain_text
def plot_accuracy_curves(
    curves: AccuracyCurves, *, needed: AccuracyNeeded | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the value of a policy against the accuracy of one status, and of all.

    Parameters
    ----------
    needed : AccuracyNeeded, optional
        Its target, that share of the value with perfect perception, is drawn as a level line, and
        its last crossing as a point.
    """
    ax = axes_or_new(ax)
    every = max(1, len(curves.levels) // 8)
    for number, (name, values) in enumerate(curves.values.items()):
        ax.plot(
            curves.levels,
            values,
            linestyle=DASHES[number % len(DASHES)],
            marker=MARKERS[number % len(MARKERS)],
            markevery=every,
            markersize=4,
            markerfacecolor="white",
            color="black" if name == "all" else "0.35",
            linewidth=1.8 if name == "all" else 1.1,
            label="all four alike" if name == "all" and len(curves.values) == 5 else name,
        )
    if needed is not None:
        share, target, at = float(needed.share), float(needed.target), float(needed.enough)
        ax.axhline(target, color="0.6", linewidth=0.8)
        # Beside the axes, where no curve crosses it.
        ax.annotate(
            f"{share:.0%} of\nthe value",
            (1.01, target), xycoords=("axes fraction", "data"), va="center", fontsize=8,
            color="0.3", annotation_clip=False,
        )  # fmt: skip
        if needed.crossings:
            ax.plot([at], [target], "o", color="black", markersize=5, zorder=5)
            ax.annotate(
                f"{at:.3f}", (at, target), textcoords="offset points", xytext=(5, -12), fontsize=8
            )
    ax.set_xlabel("accuracy of perception (sensitivity = specificity)")
    ax.set_ylabel("value at the start (reward)")
    ax.legend(frameon=False, loc="lower right", title="read with this accuracy")
    return ax


@plain_text
def plot_prices(
    levels: Sequence[float], prices: Sequence[PriceOfPerception], *, ax: Axes | None = None
) -> Axes:
    """Draw what remembering, the best reading and taking as true are worth along accuracies."""
    ax = axes_or_new(ax)
    x = np.asarray(levels)
    perfect = prices[0].perfect.value
    ax.axhline(perfect, color="0.6", linewidth=0.8)
    ax.annotate(
        "perfect perception", (0.01, perfect), xycoords=("axes fraction", "data"), va="bottom",
        fontsize=8, color="0.3",
    )  # fmt: skip
    low = np.array([price.filtering.lower for price in prices])
    high = np.array([price.filtering.upper for price in prices])
    ax.fill_between(x, low, high, color="0.8", linewidth=0)
    ax.plot(x, low, "-", color="black", marker="o", markersize=4, label="the best that remembers")
    value = np.array([price.memoryless.value.value for price in prices])
    upper = np.array([price.memoryless.upper_bound for price in prices])
    ax.errorbar(
        x, value, yerr=[np.zeros_like(value), upper - value], linestyle=(0, (5, 2)), marker="s",
        markersize=4, color="black", markerfacecolor="white", capsize=2, elinewidth=0.8,
        label="the best that reads the status seen\n(bar: how good any other might be)",
    )  # fmt: skip
    taken = [price.taken_as_true.value for price in prices]
    ax.plot(
        x, taken, linestyle=(0, (1, 1.5)), marker="^", markersize=4, color="black",
        markerfacecolor="white", label="what is seen taken for true",
    )  # fmt: skip
    ax.set_xlabel("accuracy of perception, all statuses (sensitivity = specificity)")
    ax.set_ylabel("value at the start (reward)")
    ax.legend(frameon=False, loc="lower right")
    return ax


@plain_text
def plot_error_costs(costs: ErrorCosts, *, ax: Axes | None = None) -> Axes:
    """Draw the loss by status: missed where present, and seen where absent."""
    ax = axes_or_new(ax)
    found = sorted(costs.by_status.items(), key=lambda item: -sum(item[1]))
    for row, (_, (missed, seen)) in enumerate(found):
        ax.barh(row - 0.2, missed, height=0.38, facecolor=MISSED, edgecolor="black")
        ax.barh(row + 0.2, seen, height=0.38, facecolor=SEEN, edgecolor="black", hatch="//")
        for place, loss in ((row - 0.2, missed), (row + 0.2, seen)):
            ax.text(loss, place, f" {loss:.2f}", va="center", fontsize=8)
    ax.set_yticks(range(len(found)), [name for name, _ in found])
    ax.invert_yaxis()
    ax.margins(x=0.12)
    ax.set_xlabel("loss against perfect perception (reward)")
    ax.legend(
        handles=[
            Patch(facecolor=MISSED, edgecolor="black", label="present, not seen"),
            Patch(facecolor=SEEN, edgecolor="black", hatch="//", label="absent, but seen"),
        ],
        loc="lower right",
        frameon=False,
    )
    return ax


@plain_text
def plot_hedging(found: Hedging, *, ax: Axes | None = None) -> Axes:
    """Draw the best memoryless policy's action for each perceived status, along accuracies.

    Where it is not proven to be the best, its cells are pale and its accuracy has a star.
    """
    ax = axes_or_new(ax)
    styles = action_styles(found.mdp.actions)
    actions = found.actions
    column = found.mdp.space.column("status")
    for level, statuses in enumerate(actions):
        proven = found.best[level].proven
        for status, action in enumerate(statuses.tolist()):
            drawn = styles[action]
            fill = drawn.fill if proven else _paler(drawn.fill)
            ax.add_patch(
                Rectangle(
                    (level, status), 1, 1, facecolor=fill, edgecolor="black" if proven else "0.7",
                    linewidth=0.5, hatch=drawn.hatch if proven else "",
                )
            )  # fmt: skip
            ax.text(
                level + 0.5, status + 0.5, drawn.short, ha="center", va="center", fontsize=7,
                color=drawn.ink if proven else "0.35",
                bbox={"facecolor": fill, "edgecolor": "none", "pad": 0.8},
            )  # fmt: skip
    count, size = actions.shape
    ax.set(xlim=(0, count), ylim=(size, 0))
    labels = [
        f"{level:g}" + ("" if best.proven else "*")
        for level, best in zip(found.levels, found.best, strict=True)
    ]
    ax.set_xticks(np.arange(count) + 0.5, labels)
    ax.set_yticks(np.arange(size) + 0.5, [column.label(status) for status in range(size)])
    ax.tick_params(length=0)
    all_proven = all(best.proven for best in found.best)
    note = "" if all_proven else "\n* pale: the best found, not proven to be the best"
    ax.set_xlabel(f"accuracy of perception, all statuses{note}")
    ax.set_ylabel("perceived status")
    ax.legend(
        handles=[
            Patch(
                facecolor=styles[a].fill, edgecolor="black", hatch=styles[a].hatch,
                label=f"{styles[a].short} {styles[a].name}",
            )
            for a in sorted(set(actions.reshape(-1).tolist()))
        ],
        loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False,
    )  # fmt: skip
    return ax


def _paler(fill: str) -> tuple[float, float, float]:
    """Return a colour with three parts of white."""
    red, green, blue = to_rgb(fill)
    return 0.75 + 0.25 * red, 0.75 + 0.25 * green, 0.75 + 0.25 * blue


@plain_text
def plot_confusion(confusion: NDArray[np.float64], *, ax: Axes | None = None) -> Axes:
    """Draw a confusion matrix: the darker, the likelier; numbers where 5 % and more."""
    ax = axes_or_new(ax)
    size = len(confusion)
    bits = size.bit_length() - 1
    ax.imshow(np.sqrt(confusion), cmap="Greys", vmin=0, vmax=1)
    for row, column in np.argwhere(confusion >= 0.05):
        share = confusion[row, column]
        ax.text(
            column, row, f"{100 * share:.0f}", ha="center", va="center", fontsize=6,
            color="white" if share > 0.35 else "black",
        )  # fmt: skip
    labels = [format(number, f"0{bits}b") for number in range(size)]
    ax.set_xticks(range(size), labels, rotation=90, fontsize=7)
    ax.set_yticks(range(size), labels, fontsize=7)
    ax.tick_params(length=0)
    ax.set_xlabel("perceived status")
    ax.set_ylabel("true status (numbers in %)")
    return ax
