"""Diagrams of a care model: who influences whom, and how the status moves under an action."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch

from exact_mdp.analysis.plots.style import Look, axes_or_new, plain_text
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.table import Floats

RADIUS = 0.36  # of a status, where the statuses lie on a circle of radius 1
APART = 0.07  # of an arrow from the line between two centres: arrows to and fro lie side by side


@plain_text
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
    ax, count = axes_or_new(ax), len(scenario.statuses)
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
    return ax


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


@plain_text
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
    ax = axes_or_new(ax)
    vector_map(ax, law, threshold)
    ax.set(xlabel="status after the action", ylabel=f"status now: {', '.join(statuses)}")
    return ax


def vector_map(ax: Axes, shares: Floats, threshold: float) -> None:
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
