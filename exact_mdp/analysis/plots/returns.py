"""The distribution of a return, a sample of it, fronts of totals, and means against the worst."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from exact_mdp.analysis.plots.style import (
    BLACK,
    BLUE,
    INK,
    MARKS,
    Look,
    axes_or_new,
    described,
    picture,
)
from exact_mdp.analysis.tradeoffs.front import Front
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.solvers.values.returns import ReturnDistribution
from exact_mdp.solvers.values.simulate import Simulation

MEAN: Look = {"color": "black", "linestyle": "--", "linewidth": 1}


@picture
def plot_return_distribution(distribution: ReturnDistribution, *, ax: Axes | None = None) -> Axes:
    """Draw the probability of each return, with the mean as a line."""
    ax = axes_or_new(ax)
    values = np.array([float(value) for value in distribution.values])
    thick = 5 if len(values) < 20 else 1.3
    ax.vlines(values, 0, distribution.probabilities, color="0.45", linewidth=thick)
    if len(values) == 1:
        ax.set_xlim(values[0] - 1, values[0] + 1)
    ax.set_ylim(bottom=0)
    title = f"mean {distribution.mean:.2f}, standard deviation {distribution.sd:.2f}"
    if distribution.unending:
        title = f"never ends, and is infinite, with probability {distribution.never_ends:.4g}"
    else:
        ax.axvline(distribution.mean, label="mean", **MEAN)
    what = f"Distribution of the return: {title}"
    return described(ax, what, x="return (reward)", y="probability")


@picture
def plot_simulation(simulation: Simulation, *, ax: Axes | None = None) -> Axes:
    """Draw how many sampled episodes had which return, and the mean with its 95 % interval."""
    ax = axes_or_new(ax)
    finite = simulation.returns[np.isfinite(simulation.returns)]
    ax.hist(finite, bins=min(40, len(np.unique(finite)) + 1), color="0.6", ec="0.3")
    if simulation.never_ends:
        ax.plot([], [], color="white", label=f"a share of {simulation.never_ends:.4g} never ends")
    else:
        ax.axvspan(*simulation.value.interval, color="0.85", zorder=0)
        ax.axvline(simulation.mean, label=f"mean {simulation.value}", **MEAN)
    what = f"Returns of {len(simulation.returns):,} simulated episodes"
    return described(ax, what, x="return (reward)", y="episodes")


@picture
def draw_front(
    front: Front, *, policies: Mapping[str, PolicyLike] | None = None, ax: Axes | None = None
) -> Axes:
    """Draw a front of two totals, and policies by name with their distance from it."""
    if len(front.names) != 2:
        what = "a front of three totals has no flat picture"
        raise ModelError(what, where="plot", fix="name two totals")
    ax, at = axes_or_new(ax), np.array(front.vertices, dtype=np.float64)
    ax.plot(*at.T, color=BLUE, marker="o", markersize=4, label="front", zorder=2)
    for number, (name, policy) in enumerate((policies or {}).items()):
        place, far = np.array(front.totals(policy), dtype=float), float(front.distance(policy))
        label = f"{name} (on the front)" if far == 0 else f"{name} (distance {far:.3g})"
        # Open, and larger than those before: all that lie on each other can be seen.
        look: Look = {"color": INK[number % len(INK)], "fillstyle": "none", "zorder": 3}
        mark = MARKS[1 + number % (len(MARKS) - 1)]
        ax.plot(*place, mark, label=label, markersize=7 + 3 * number, **look)
        if far:
            ends = np.array([place, place + front.of.sign * far])
            ax.plot(*ends.T, color=BLACK, linewidth=0.8, linestyle=":")
    first, second = front.names
    names = {"x": f"expected total of {first}", "y": f"expected total of {second}"}
    return described(ax, f"The front of {second} against {first}", **names)
