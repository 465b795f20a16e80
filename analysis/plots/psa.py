"""Figures of the probabilistic sensitivity analysis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from exact_mdp.analysis.plots.style import axes_or_new, plain_text
from exact_mdp.analysis.sensitivity.psa.intervals import tolerances_of

if TYPE_CHECKING:
    from exact_mdp.analysis.sensitivity.psa.expected_loss import LossCurve
    from exact_mdp.analysis.sensitivity.psa.result import PSA
    from exact_mdp.analysis.sensitivity.psa.value_of_information import PartialInformation

INK, BAR = "#000000", "#56B4E9"
DASHES = ("-", "--", ":", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 3)))
MARKS = ("o", "s", "^", "D", "v", "x", "+")
COLOURS = ("#000000", "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#4D4D4D", "#8C6D1F")
MOST_ROWS = 32


@plain_text
def plot_acceptability(
    found: PSA,
    *,
    candidates: Sequence[int] = (0,),
    tolerances: Sequence[float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the probability that a policy loses at most Δ, with its 95 % interval, against Δ.

    Parameters
    ----------
    candidates : numbers of `found.candidates`
    tolerances : values of Δ, on a linear scale
        Unless given, from 0 to the largest 99 % quantile of these policies' regrets; the scale is
        linear up to a ten-thousandth of that, then logarithmic.
    """
    ax = axes_or_new(ax)
    if tolerances is None:
        tolerances = tolerances_of([found.regret(number) for number in candidates], 201)
        if len(tolerances) > 1:
            near = float(tolerances[1])
            ax.set_xscale("symlog", linthresh=near, linscale=0.3)
            # Powers of 10 within the linear part would stand upon the 0.
            powers = np.arange(np.ceil(np.log10(2 * near)), np.log10(tolerances[-1]) + 1e-9)
            ax.set_xticks([0.0, *10.0**powers])
            ax.set_xticks([], minor=True)
            tolerances = np.append(np.linspace(0, near, 21), tolerances[2:])
    for place, number in enumerate(candidates):
        share, low, high = found.accepted(tolerances, number)
        colour = COLOURS[place % len(COLOURS)]
        ax.plot(
            tolerances,
            share,
            linestyle=DASHES[place % len(DASHES)],
            color=colour,
            label=found.candidates[number].name,
        )
        ax.fill_between(tolerances, low, high, color=colour, alpha=0.2, linewidth=0)
    ax.set(xlabel="loss that is accepted, Δ (reward)", ylim=(-0.02, 1.02))
    if max(tolerances) > 0:
        ax.set_xlim(0, max(tolerances))
    ax.set_ylabel("probability that the policy loses at most Δ")
    if len(candidates) > 1:
        ax.legend(frameon=False, loc="best")
    return ax


@plain_text
def plot_expected_loss(found: LossCurve, *, ax: Axes | None = None) -> Axes:
    """Draw each policy's expected loss, with its 95 % interval, and the lowest one in grey."""
    ax = axes_or_new(ax)
    positive = found.loss[found.loss > 0]
    floor = float(positive.min()) / 10 if len(positive) else 1e-6
    lowest = np.maximum(found.loss.min(axis=1), floor)
    ax.plot(
        found.points,
        lowest,
        color="0.8",
        linewidth=7,
        solid_capstyle="round",
        label="best of these",
    )
    for n, name in enumerate(found.policies):
        loss = np.maximum(found.loss[:, n], floor)
        high = np.maximum(found.high[:, n], loss)
        # A logarithmic axis has no 0: bars that would end below its floor end there.
        low = np.clip(found.low[:, n], floor, loss)
        ax.errorbar(
            found.points,
            loss,
            yerr=(loss - low, high - loss),
            linestyle=DASHES[n % len(DASHES)],
            marker=MARKS[n % len(MARKS)],
            color=COLOURS[n % len(COLOURS)],
            markersize=4,
            capsize=2,
            label=name,
        )
    ax.set_yscale("log")
    if found.unit == "observations":
        ax.set_xscale("log")
    ax.set_xlabel(f"{found.along.replace('_', ' ')} ({found.unit})")
    ax.set_ylabel("expected loss of the policy (reward)")
    ax.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.02, 1.0))
    return ax


@plain_text
def plot_optimal_actions(found: PSA, *, ax: Axes | None = None) -> Axes:
    """Draw, for each status and action, the share of draws in which the action is optimal."""
    ax = axes_or_new(ax)
    share, _, _ = found.probability_optimal()
    share, labels = share[:MOST_ROWS], found.labels[:MOST_ROWS]
    ax.imshow(share, cmap="Greys", vmin=0, vmax=1, aspect="auto")
    for row, column in np.ndindex(*share.shape):
        value = share[row, column]
        told = "" if value == 0 else "1" if value == 1 else _share(value)
        ink = "white" if value > 0.55 else "black"
        ax.text(column, row, told, ha="center", va="center", color=ink, fontsize=7)
    ax.set_xticks(range(len(found.actions)), found.actions)
    ax.set_yticks(range(len(labels)), labels)
    ax.set_xlabel("action: share of draws in which it is optimal")
    ax.set_ylabel("status at subtask 0, trial 0" if found.compiled else "state")
    ax.tick_params(length=0)
    return ax


@plain_text
def plot_start_values(found: PSA, *, bins: int = 60, ax: Axes | None = None) -> Axes:
    """Draw the distribution of V* over the draws, its mean, and V* at today's values."""
    ax = axes_or_new(ax)
    ax.hist(found.optimal, bins=bins, color=BAR, edgecolor="white", linewidth=0.3)
    mean = float(found.optimal.mean())
    ax.axvline(
        found.start.value,
        color=INK,
        linewidth=1.2,
        label=f"today's values: {found.start.value:.4g}",
    )
    ax.axvline(mean, color=INK, linewidth=1.2, linestyle="--", label=f"mean of draws: {mean:.4g}")
    low, high = np.quantile(found.optimal, [0.025, 0.975])
    ax.axvspan(low, high, color="0.85", zorder=0, label=f"95 % of draws: {low:.4g} to {high:.4g}")
    ax.set_xlabel("V* of the start, policy re-optimised (reward)")
    ax.set_ylabel(f"draws of {len(found):,}")
    ax.legend(frameon=False, loc="upper left")
    return ax


@plain_text
def plot_evppi(
    found: Mapping[str, PartialInformation], *, most: int = 12, ax: Axes | None = None
) -> Axes:
    """Draw what knowing each parameter or group would be worth; marks show the lower estimate."""
    ax = axes_or_new(ax)
    ordered = sorted(found.items(), key=lambda item: -item[1].regression.value)[:most]
    for place, (_, each) in enumerate(ordered):
        reach = 1.96 * each.regression.standard_error
        ax.barh(place, each.regression.value, color=BAR, edgecolor=INK, height=0.65)
        ax.errorbar(each.regression.value, place, xerr=reach, color=INK, capsize=2, linewidth=1)
        ax.plot(each.lower.value, place, "|", color=INK, markersize=13, markeredgewidth=2)
    ax.set_yticks(range(len(ordered)), [name for name, _ in ordered])
    ax.invert_yaxis()
    ax.axvline(0, color=INK, linewidth=0.8)
    ax.set_xlabel("EVPPI (reward); bold mark: lower estimate")
    return ax


def _share(value: float) -> str:
    return "<.01" if value < 0.01 else ">.99" if value > 0.99 else f"{value:.2f}".lstrip("0")
