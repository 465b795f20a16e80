"""The exact distribution of the return, as bars."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from analysis.plots.style import axes_or_new, plain_text
from solvers.returns import ReturnDistribution


@plain_text
def plot_return_distribution(
    distribution: ReturnDistribution, *, label: str = "", ax: Axes | None = None
) -> Axes:
    """Draw the probability of each return, with the mean as a line.

    Parameters
    ----------
    distribution : ReturnDistribution
    label : what the distribution is of, written into the upper left corner
    """
    ax = axes_or_new(ax)
    values = np.array([float(value) for value in distribution.values])
    ax.vlines(values, 0, distribution.probabilities, color="0.25", linewidth=1.3)
    mean, sd = distribution.mean, distribution.sd
    ax.axvline(mean, color="black", linestyle="--", linewidth=1)
    ax.set_ylim(bottom=0)
    ax.set_ylabel("probability")
    ax.set_title(f"{label}: mean {mean:.2f}, standard deviation {sd:.2f}".lstrip(": "))
    return ax
