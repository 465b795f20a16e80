"""The exact distribution of the return, as bars.

The map of a status policy: every status vector in a grid, coloured by its action.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from exact_mdp.analysis.plots.style import action_styles, axes_or_new, plain_text
from exact_mdp.mdp import MDP
from exact_mdp.solvers.values.returns import ReturnDistribution


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


@plain_text
def plot_policy_map(
    mdp: MDP,
    choices: NDArray[np.int64],
    *,
    statuses: Sequence[str],
    ax: Axes | None = None,
    legend: bool = True,
    **place: int,
) -> Axes:
    """Draw the action in every status vector at one place of the model.

    Parameters
    ----------
    mdp : MDP with a column `status`
    choices : (S,) action numbers
    statuses : names of the status bits, first bit first
    **place : values of the other columns, such as `subtask=0, trial=0` (0 where left out)
    """
    ax = axes_or_new(ax)
    styles = action_styles(mdp.actions)
    bits = len(statuses)
    high, low = bits - bits // 2, bits // 2
    for vector in range(2**bits):
        row, column = vector >> low, vector & (2**low - 1)
        drawn = styles[int(choices[mdp.space.index(**place, status=vector)])]
        ax.add_patch(
            Rectangle(
                (column, row), 1, 1, facecolor=drawn.fill, edgecolor="black", hatch=drawn.hatch
            )
        )
        ax.text(
            column + 0.5,
            row + 0.5,
            drawn.short,
            ha="center",
            va="center",
            color=drawn.ink,
            bbox={"facecolor": drawn.fill, "edgecolor": "none", "pad": 1.5},
        )
    ax.set(xlim=(0, 2**low), ylim=(2**high, 0), aspect="equal")
    ax.set_xticks(
        np.arange(2**low) + 0.5, [format(v, f"0{low}b") if low else "" for v in range(2**low)]
    )
    ax.set_yticks(np.arange(2**high) + 0.5, [format(v, f"0{high}b") for v in range(2**high)])
    ax.set_xlabel(", ".join(statuses[high:]))
    ax.set_ylabel(", ".join(statuses[:high]))
    ax.tick_params(length=0)
    if legend:
        used = sorted({int(choices[mdp.space.index(**place, status=v)]) for v in range(2**bits)})
        ax.legend(
            handles=[
                Patch(
                    facecolor=styles[a].fill,
                    edgecolor="black",
                    hatch=styles[a].hatch,
                    label=f"{styles[a].short} {styles[a].name}",
                )
                for a in used
            ],
            loc="upper left",
            bbox_to_anchor=(1.02, 1.0),
            frameon=False,
        )
    return ax
