"""Figures of the probabilistic sensitivity analysis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from exact_mdp.analysis.plots.style import (
    LINES,
    PALETTE,
    axes_or_new,
    legend_beside,
    plain_numbers,
    plain_text,
)
from exact_mdp.analysis.vary.intervals import tolerances_of

if TYPE_CHECKING:
    from exact_mdp.analysis.vary.economics import CostEffectiveness
    from exact_mdp.analysis.vary.psa import PSA

COLOURS = ("#000000", *(PALETTE[n] for n in (3, 6, 4, 5, 7)), "#8C6D1F")
MOST_ROWS = 32


@plain_text
def plot_acceptability(
    draws: PSA,
    *,
    candidates: Sequence[int] = (0,),
    tolerances: ArrayLike | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the probability that each candidate loses at most Δ, with its 95 % interval, against Δ.

    Tolerances Δ that are given are on a linear scale. Otherwise they reach from 0 to the largest
    99 % quantile of these policies' regrets; the scale is linear up to a ten-thousandth of that,
    then logarithmic.

    Parameters
    ----------
    draws : PSA
    candidates : sequence of int, optional
        Numbers of the policies in `PSA.candidates`.
    tolerances : (T,) array_like, optional
        Accepted losses Δ, in units of reward.
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> from exact_mdp import Scenario, psa
    >>> draws = psa(Scenario.load("yuan2025"), 10, rng=0, effective_sample_size=40)
    >>> plot_acceptability(draws).get_xlabel()
    'loss that is accepted, Δ (reward)'
    """
    ax = axes_or_new(ax)
    if tolerances is None:
        at = tolerances_of([draws.regret(number) for number in candidates], 201)
        if len(at) > 1:
            near = float(at[1])
            ax.set_xscale("symlog", linthresh=near, linscale=0.3)
            # Powers of 10 within the linear part would stand upon the 0.
            powers = np.arange(np.ceil(np.log10(2 * near)), np.log10(at[-1]) + 1e-9)
            ax.set_xticks([0.0, *10.0**powers])
            ax.set_xticks([], minor=True)
            plain_numbers(ax.xaxis)
            at = np.append(np.linspace(0, near, 21), at[2:])
    else:
        at = np.asarray(tolerances, dtype=float)
    for place, number in enumerate(candidates):
        share, low, high = draws.accepted(at, number)
        colour, line = COLOURS[place % len(COLOURS)], LINES[place % len(LINES)]
        name = draws.candidates[number].name
        ax.plot(at, share, linestyle=line, color=colour, label=name)
        ax.fill_between(at, low, high, color=colour, alpha=0.2, linewidth=0)
    ax.set(xlabel="loss that is accepted, Δ (reward)", ylim=(-0.02, 1.02))
    if at.max() > 0:
        ax.set_xlim(0, at.max())
    ax.set_ylabel("probability that the policy loses at most Δ")
    if len(candidates) > 1:
        ax.legend(loc="best")
    return ax


@plain_text
def plot_cost_effectiveness(
    found: CostEffectiveness, *, wtp: ArrayLike | None = None, ax: Axes | None = None
) -> Axes:
    """Draw acceptability curves over the willingness to pay; the frontier is the wide grey line."""
    ax = axes_or_new(ax)
    at = found.grid() if wtp is None else np.asarray(wtp, dtype=float)
    frontier = [share for _, share in found.frontier(at)]
    ax.plot(at, frontier, color="0.8", linewidth=7, solid_capstyle="butt", label="frontier")
    for place, (name, share) in enumerate(
        zip(found.strategies, found.acceptability(at).T, strict=True)
    ):
        colour, line = COLOURS[place % len(COLOURS)], LINES[place % len(LINES)]
        ax.plot(at, share, linestyle=line, color=colour, label=name)
    ax.set(xlabel="willingness to pay for one unit of effect", ylim=(-0.02, 1.02))
    ax.set_ylabel("share of draws in which it is the best")
    ax.set_title("Cost-effectiveness acceptability curves")
    legend_beside(ax)
    return ax


@plain_text
def plot_optimal_actions(draws: PSA, *, ax: Axes | None = None) -> Axes:
    """Draw, for each status and action, the share of draws in which the action is optimal.

    Parameters
    ----------
    draws : PSA
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> from exact_mdp import Scenario, psa
    >>> draws = psa(Scenario.load("yuan2025"), 10, rng=0, effective_sample_size=40)
    >>> len(plot_optimal_actions(draws).get_xticks())
    4
    """
    ax = axes_or_new(ax)
    share, labels = draws.probability_optimal()[0][:MOST_ROWS], draws.labels[:MOST_ROWS]
    ax.imshow(share, cmap="Greys", vmin=0, vmax=1, aspect="auto")
    for row, column in np.ndindex(*share.shape):
        value = float(share[row, column])
        ink = "white" if value > 0.55 else "black"
        ax.text(column, row, _share(value), ha="center", va="center", color=ink, fontsize=7)
    ax.set_xticks(range(len(draws.actions)), draws.actions)
    ax.set_yticks(range(len(labels)), labels)
    ax.set_xlabel("action: share of draws in which it is optimal")
    ax.set_ylabel("status at subtask 0, trial 0" if draws.compiled else "state")
    ax.tick_params(length=0)
    return ax


def _share(value: float) -> str:
    if value in (0, 1):
        return "1" if value else ""
    return "<.01" if value < 0.01 else ">.99" if value > 0.99 else f"{value:.2f}".lstrip("0")
