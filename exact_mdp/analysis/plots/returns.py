"""The distribution of a policy's return, and of a sample of it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from exact_mdp.analysis.plots.style import axes_or_new, described, picture
from exact_mdp.solvers.values.returns import ReturnDistribution
from exact_mdp.solvers.values.simulate import Simulation


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
        ax.axvline(distribution.mean, color="black", linestyle="--", linewidth=1, label="mean")
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
        mean = f"mean {simulation.value}"
        ax.axvline(simulation.mean, color="black", linestyle="--", linewidth=1, label=mean)
    what = f"Returns of {len(simulation.returns):,} simulated episodes"
    return described(ax, what, x="return (reward)", y="episodes")
