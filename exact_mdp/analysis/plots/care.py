"""Pictures of a care model: who influences whom, how the status moves, what errors in it cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch

from exact_mdp.analysis.plots.style import (
    BLUE,
    MARKS,
    WHITE,
    Look,
    axes_or_new,
    described,
    name_rows,
    picture,
    swatch,
)
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.table import Floats

if TYPE_CHECKING:
    from exact_mdp.analysis.perception.errors import ErrorCosts
    from exact_mdp.analysis.perception.values import AccuracyCurves

DASHES = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)), (0, (3, 1, 1, 1, 1, 1)))
RADIUS = 0.36  # of a status, where the statuses lie on a circle of radius 1
APART = 0.07  # of an arrow from the line between two centres: arrows to and fro lie side by side


@picture
def plot_influence(scenario: Scenario, *, ax: Axes | None = None) -> Axes:
    """Draw who raises whom; widths and labels are percentage points per timestep.

    Parameters
    ----------
    scenario : Scenario
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> ax = plot_influence(Scenario.load("yuan2025"))
    >>> ax.texts[0].get_text().splitlines()[0]
    'forgetfulness'
    """
    ax, count = axes_or_new(ax, high=6.0), len(scenario.statuses)
    angles = 3 * np.pi / 4 - 2 * np.pi * np.arange(count) / count  # four statuses make a square
    places = np.column_stack([np.cos(angles), np.sin(angles)])
    for status, place in zip(scenario.statuses, places, strict=True):
        ax.add_patch(Circle(tuple(place), RADIUS, facecolor="white", edgecolor="black"))
        numbers = [float(scenario[f"{kind}.{status}"]) for kind in ("base", "persistence")]
        text = "{}\nsets in {:.0%}\nstays {:.0%}".format(status, *numbers)
        ax.text(place[0], place[1], text, ha="center", va="center", fontsize=8)
    forwards = scenario.readings["influence_orientation"] == "row-to-column"
    for row, column in np.ndindex(count, count):
        if row != column:
            names = scenario.statuses[row], scenario.statuses[column]
            amount = float(scenario[f"influence.{'.'.join(names)}"])
            ends = (row, column) if forwards else (column, row)
            if amount:
                _influence(ax, places[ends[0]], places[ends[1]], amount)
    reach = float(np.abs(places).max()) + RADIUS + 0.03
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    ax.set_axis_off()
    return described(ax, "Who raises whom, in points of chance per timestep", scenario.name)


def _influence(ax: Axes, start: Floats, end: Floats, amount: float) -> None:
    """Draw an arrow between two circles, on the right of the line between them."""
    along = (end - start) / np.linalg.norm(end - start)
    aside = APART * np.array([along[1], -along[0]])
    inside = along * np.sqrt(RADIUS**2 - APART**2)
    tail, head = start + aside + inside, end + aside - inside
    drawn: Look = {"linewidth": 0.6 + 16 * amount, "color": "0.55", "shrinkA": 0, "shrinkB": 0}
    size = 9 + 40 * amount
    ax.add_patch(
        FancyArrowPatch(tuple(tail), tuple(head), arrowstyle="-|>", mutation_scale=size, **drawn)
    )
    x, y = tail + 0.3 * (head - tail)  # nearer to where it comes from, so that labels do not meet
    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
    ax.text(x, y, f"+{100 * amount:g}", ha="center", va="center", fontsize=9, bbox=box)


@picture
def plot_status_transitions(
    law: Floats,
    statuses: Sequence[str],
    *,
    threshold: float = 0.1,
    ax: Axes | None = None,
) -> Axes:
    """Draw the moves between status vectors as a map: the darker, the likelier.

    Parameters
    ----------
    law : (2^n, 2^n)
        Probabilities of the next vector (column) given the present one (row).
    statuses : sequence of n str
    threshold : float
        Probability from which a cell has its number, in per cent.
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> ax = plot_status_transitions(np.eye(4), ["anger", "confusion"])
    >>> [text.get_text() for text in ax.texts], ax.get_ylabel()
    (['100', '100', '100', '100'], 'status now: anger, confusion')
    """
    ax = axes_or_new(ax, high=6.0)
    _vector_map(ax, law, threshold)
    names = {"x": "status after the action", "y": f"status now: {', '.join(statuses)}"}
    return described(ax, "How the status moves in one step (chances in %)", **names)


def _vector_map(ax: Axes, shares: Floats, threshold: float) -> None:
    """Draw shares (2^n, 2^n), from row to column, with numbers in per cent from a threshold on."""
    size = len(shares)
    labels = [format(number, f"0{size.bit_length() - 1}b") for number in range(size)]
    # Cells, not one image: it stays sharp at any size.
    ax.pcolormesh(np.sqrt(shares), cmap="Greys", vmin=0, vmax=1, edgecolors="0.9", linewidth=0.3)
    for row, column in np.argwhere(shares >= threshold):
        share = shares[row, column]
        centre: Look = {"ha": "center", "va": "center", "fontsize": 6}
        ink = "white" if share > 0.35 else "black"
        ax.text(column + 0.5, row + 0.5, f"{100 * share:.0f}", color=ink, **centre)
    middles = np.arange(size) + 0.5
    ax.set_xticks(middles, labels, rotation=90, fontsize=7, family="monospace")
    ax.set_yticks(middles, labels, fontsize=7, family="monospace")
    ax.tick_params(length=0)
    ax.set(ylim=(size, 0), aspect="equal")


@picture
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
    return described(
        ax,
        "What a policy is worth by how well the status is read",
        x="accuracy of perception (sensitivity = specificity)",
        y="value at the start (reward)",
        legend="read with this accuracy",
    )


@picture
def plot_error_costs(costs: ErrorCosts, *, ax: Axes | None = None) -> Axes:
    """Draw the loss by status: missed where present, and seen where absent."""
    by_cost = sorted(costs.by_status.items(), key=lambda item: -sum(item[1]))
    ax = axes_or_new(ax, [name for name, _ in by_cost] * 2)
    fills = ((WHITE, ""), (BLUE, "//"))
    for row, (_, losses) in enumerate(by_cost):
        for place, loss, (fill, hatch) in zip((row - 0.2, row + 0.2), losses, fills, strict=True):
            ax.barh(place, loss, height=0.38, facecolor=fill, edgecolor="black", hatch=hatch)
            ax.text(loss, place, f" {loss:.2f}", va="center", fontsize=8)
    name_rows(ax, [name for name, _ in by_cost])
    ax.margins(x=0.12)
    return described(
        ax,
        "What errors in reading each status cost",
        x="loss against perfect perception (reward)",
        handles=[*map(swatch, ("present, not seen", "absent, but seen"), fills)],
    )


@picture
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
    ax = axes_or_new(ax, high=6.0)
    _vector_map(ax, confusion, 0.05)
    what = "How each status is perceived (chances in %)"
    return described(ax, what, x="perceived status", y="true status")
