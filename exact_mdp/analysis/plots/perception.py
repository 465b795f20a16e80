"""Figures about acting on a perceived status."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.axes import Axes

from exact_mdp.analysis.plots.diagrams import vector_map
from exact_mdp.analysis.plots.style import (
    BLUE,
    MARKS,
    WHITE,
    axes_or_new,
    name_rows,
    plain_text,
    swatch,
)
from exact_mdp.mdp.table import Floats

if TYPE_CHECKING:
    from exact_mdp.analysis.perception.accuracy import AccuracyCurves
    from exact_mdp.analysis.perception.errors import ErrorCosts

DASHES = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)), (0, (3, 1, 1, 1, 1, 1)))
ACCURACY, VALUE = "accuracy of perception", "value at the start (reward)"


@plain_text
def plot_accuracy_curves(curves: AccuracyCurves, *, ax: Axes | None = None) -> Axes:
    """Draw the value of a policy against the accuracy of one status, and of all.

    Parameters
    ----------
    curves : AccuracyCurves
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> from exact_mdp import Scenario, accuracy_curves
    >>> curves = accuracy_curves(Scenario.load("yuan2025").compile(), levels=[1.0, 0.9])
    >>> plot_accuracy_curves(curves).get_ylabel()
    'value at the start (reward)'
    """
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
    >>> import numpy as np
    >>> plot_confusion(np.eye(4)).get_xlabel()
    'perceived status'
    """
    ax = axes_or_new(ax)
    vector_map(ax, confusion, 0.05)
    ax.set(xlabel="perceived status", ylabel="true status (numbers in %)")
    return ax
