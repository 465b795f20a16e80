"""Figures about acting on a perceived status."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb

from exact_mdp.analysis.plots.diagrams import vector_map
from exact_mdp.analysis.plots.style import (
    BLUE,
    MARKS,
    WHITE,
    Look,
    action_legend,
    action_styles,
    axes_or_new,
    cell,
    name_rows,
    plain_text,
    swatch,
)
from exact_mdp.mdp.table import Floats

if TYPE_CHECKING:
    from exact_mdp.analysis.perception.accuracy import AccuracyCurves, Hedging
    from exact_mdp.analysis.perception.cost import PriceOfPerception
    from exact_mdp.analysis.perception.errors import ErrorCosts

DASHES = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)), (0, (3, 1, 1, 1, 1, 1)))
ACCURACY, VALUE = "accuracy of perception", "value at the start (reward)"


@plain_text
def plot_accuracy_curves(curves: AccuracyCurves, *, ax: Axes | None = None) -> Axes:
    """Draw the value of a policy against the accuracy of one status, and of all."""
    ax = axes_or_new(ax)
    for number, (name, values) in enumerate(curves.values.items()):
        every = name == "all"
        ax.plot(
            curves.levels,
            values,
            linestyle=DASHES[number % len(DASHES)],
            marker=MARKS[number % len(MARKS)],
            markevery=max(1, len(curves.levels) // 8),
            markersize=4,
            markerfacecolor="white",
            color="black" if every else "0.35",
            linewidth=1.8 if every else 1.1,
            label="all four alike" if every and len(curves.values) == 5 else name,
        )
    ax.set(xlabel=f"{ACCURACY} (sensitivity = specificity)", ylabel=VALUE)
    ax.legend(loc="lower right", title="read with this accuracy")
    return ax


@plain_text
def plot_prices(
    levels: Sequence[float], prices: Sequence[PriceOfPerception], *, ax: Axes | None = None
) -> Axes:
    """Draw values with memory, with the best reading and with trust in what is seen.

    Parameters
    ----------
    levels : sequence of X float
        Accuracies.
    prices : sequence of X PriceOfPerception
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.analysis.perception.cost import price_of_perception
    >>> from exact_mdp.mdp.care.perception import independent
    >>> mdp = Scenario.load("yuan2025").with_(tasks=[1]).compile()
    >>> price = price_of_perception(mdp, independent([0.9] * 4, [0.9] * 4), tol=0.05)
    >>> plot_prices([0.9], [price]).get_xlabel()
    'accuracy of perception, all statuses (sensitivity = specificity)'
    """
    ax = axes_or_new(ax)
    x, perfect = np.asarray(levels), prices[0].perfect.value
    ax.axhline(perfect, color="0.6", linewidth=0.8)
    place: Look = {"xycoords": ("axes fraction", "data"), "va": "bottom"}
    ax.annotate("perfect perception", (0.01, perfect), fontsize=8, color="0.3", **place)
    low = np.array([price.filtering.lower for price in prices])
    high = np.array([price.filtering.upper for price in prices])
    value = np.array([price.memoryless.value.value for price in prices])
    upper = np.array([price.memoryless.upper_bound for price in prices])
    black: Look = {"color": "black", "markersize": 4}
    ax.fill_between(x, low, high, color="0.8", linewidth=0)
    ax.plot(x, low, "-", marker="o", label="the best that remembers", **black)
    black["markerfacecolor"] = "white"
    ax.errorbar(
        x,
        value,
        yerr=[np.zeros_like(value), upper - value],
        linestyle=DASHES[1],
        marker="s",
        capsize=2,
        elinewidth=0.8,
        label="the best that reads the status seen\n(bar: how good any other might be)",
        **black,
    )
    taken = [price.taken_as_true.value for price in prices]
    label = "what is seen taken for true"
    ax.plot(x, taken, linestyle=DASHES[2], marker="^", label=label, **black)
    ax.set(xlabel=f"{ACCURACY}, all statuses (sensitivity = specificity)", ylabel=VALUE)
    ax.legend(loc="lower right")
    return ax


@plain_text
def plot_error_costs(costs: ErrorCosts, *, ax: Axes | None = None) -> Axes:
    """Draw the loss by status: missed where present, and seen where absent."""
    ax = axes_or_new(ax)
    found = sorted(costs.by_status.items(), key=lambda item: -sum(item[1]))
    fills = ((WHITE, ""), (BLUE, "//"))
    for row, (_, losses) in enumerate(found):
        for place, loss, (fill, hatch) in zip((row - 0.2, row + 0.2), losses, fills, strict=True):
            ax.barh(place, loss, height=0.38, facecolor=fill, edgecolor="black", hatch=hatch)
            ax.text(loss, place, f" {loss:.2f}", va="center", fontsize=8)
    name_rows(ax, [name for name, _ in found])
    ax.margins(x=0.12)
    ax.set_xlabel("loss against perfect perception (reward)")
    words = ("present, not seen", "absent, but seen")
    ax.legend(handles=[*map(swatch, words, fills)], loc="lower right")
    return ax


@plain_text
def plot_hedging(found: Hedging, *, ax: Axes | None = None) -> Axes:
    """Draw the best memoryless policy's action for each perceived status, along accuracies.

    Where it is not proven to be the best, its cells are pale and its accuracy has a star. A status
    that is never perceived with that accuracy has no cell.
    """
    ax, styles, seen = axes_or_new(ax), action_styles(found.mdp.actions), found.seen
    pale: Look = {"edgecolor": "0.7", "hatch": "", "ink": "0.35"}
    for number, status in np.argwhere(seen):
        drawn = styles[found.actions[number, status]]
        how: Look = {} if found.best[number].proven else {"fill": _paler(drawn.fill)} | pale
        cell(ax, number, status, drawn, linewidth=0.5, font=7, pad=0.8, **how)
    count, size = found.actions.shape
    stars = ["" if best.proven else "*" for best in found.best]
    labels = [f"{accuracy:g}{star}" for accuracy, star in zip(found.levels, stars, strict=True)]
    column = found.mdp.space.column("status")
    ax.set(xlim=(0, count), ylim=(size, 0), ylabel="perceived status")
    ax.set_xticks(np.arange(count) + 0.5, labels)
    ax.set_yticks(np.arange(size) + 0.5, [column.label(status) for status in range(size)])
    ax.tick_params(length=0)
    note = "\n* pale: the best found, not proven to be the best" if any(stars) else ""
    note += "" if seen.all() else "\nblank: never perceived"
    ax.set_xlabel(f"{ACCURACY}, all statuses{note}")
    action_legend(ax, styles, np.unique(found.actions[seen]).tolist())
    return ax


def _paler(fill: str) -> tuple[float, ...]:
    """Return a colour with three parts of white."""
    return tuple(0.75 + 0.25 * part for part in to_rgb(fill))


@plain_text
def plot_confusion(confusion: Floats, *, ax: Axes | None = None) -> Axes:
    """Draw a confusion matrix: the darker, the likelier; numbers where 5 % and more.

    Parameters
    ----------
    confusion : (2^n, 2^n)
        Probability of each perceived status (column) given the true one (row).
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> plot_confusion(np.eye(4)).get_xlabel()
    'perceived status'
    """
    ax = axes_or_new(ax)
    vector_map(ax, confusion, 0.05)
    ax.set(xlabel="perceived status", ylabel="true status (numbers in %)")
    return ax
