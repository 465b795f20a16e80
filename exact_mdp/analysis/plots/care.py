"""Pictures of a care model: who influences whom, and what errors in reading the status cost."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch

from exact_mdp.analysis.perception import ErrorCosts
from exact_mdp.analysis.plots.style import (
    HIGH,
    LOW,
    Look,
    axes_or_new,
    bars,
    described,
    picture,
    swatch,
)
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.table import Floats

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
def plot_error_costs(costs: ErrorCosts, *, ax: Axes | None = None) -> Axes:
    """Draw the loss by status: missed where present, and seen where absent."""
    by_cost = sorted(costs.by_status.items(), key=lambda item: -sum(item[1]))
    names = [name for name, _ in by_cost]
    drawn = [
        (row + aside, loss, look | {"height": 0.38})
        for row, (_, losses) in enumerate(by_cost)
        for aside, loss, look in zip((-0.2, 0.2), losses, (LOW, HIGH), strict=True)
    ]
    ax = bars(axes_or_new(ax, names * 2), names, drawn)
    for place, loss, _ in drawn:
        ax.text(loss, place, f" {loss:.2f}", va="center", fontsize=8)
    ax.margins(x=0.12)
    return described(
        ax,
        "What errors in reading each status cost",
        x="loss against perfect perception (reward)",
        handles=[swatch("present, not seen", LOW), swatch("absent, but seen", HIGH)],
    )
