"""Figures of what records leave open."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from exact_mdp.analysis.plots.style import PALETTE, axes_or_new, plain_text, titled

if TYPE_CHECKING:
    from exact_mdp.analysis.gate.data.needed import Needed

MOST = 20  # pairs


@plain_text
def plot_needed(found: Needed, *, most: int = MOST, ax: Axes | None = None) -> Axes:
    """Draw what knowing each row is worth, and write beside it how many more observations it needs.

    The pairs that are worth most, `most` of them, come first; one that the plan does not ask for
    has no number.
    """
    mdp, pairs = found.mdp, found.pairs[:most]
    labels = [
        f"{mdp.space.label(int(mdp.pair_state[pair]))}: {mdp.actions[mdp.pair_action[pair]]}"
        for pair in pairs.tolist()
    ]
    ax = axes_or_new(ax, labels)
    place, worth = np.arange(len(pairs)), found.worth[:most]
    ax.barh(place, worth, color=PALETTE[3], edgecolor="black", linewidth=0.6)
    for at, width, more in zip(place, worth, found.more[:most].tolist(), strict=True):
        if more:
            ax.annotate(
                f"+{more:,}", (width, at), xytext=(3, 0), textcoords="offset points", va="center"
            )
    ax.set_yticks(place, labels)
    ax.invert_yaxis()
    ax.margins(x=0.25)
    ax.set_xlim(left=0)
    ax.set_xlabel("what knowing the row would narrow the bound by (reward)")
    left = len(found.pairs) - len(pairs)
    told = "decided" if found.decided is not None else "open"
    if found.chance is not None:
        told = f"numbers: observations that decide if they show the same shares{found.likely}"
    titled(ax, told + (f"; {left} more pairs" if left else "") + found.others)
    return ax
