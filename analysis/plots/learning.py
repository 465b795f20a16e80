"""Learning curves, final policies over seeds, and why a row's greedy action keeps changing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from exact_mdp.analysis.learning.curves import LearningCurve
from exact_mdp.analysis.learning.instability import Prediction
from exact_mdp.analysis.learning.outcomes import Outcomes, share_interval
from exact_mdp.analysis.plots.style import LINES, PALETTE, axes_or_new, plain_text
from exact_mdp.mdp.table import Floats

INK = (PALETTE[6], PALETTE[3], PALETTE[4], PALETTE[7])


@plain_text
def plot_learning_curves(
    curves: Mapping[str, LearningCurve],
    *,
    optimum: float | None = None,
    window: int = 100,
    ax: Axes | None = None,
) -> Axes:
    """Draw each curve twice: sampled means as a thin pale line, exact values as a heavy one.

    The greedy policy changes from epoch to epoch, and its exact value with it; the heavy line is
    the mean over a window of epochs, the dots beside it are the values themselves.

    Parameters
    ----------
    curves : {label: curve}
    optimum : float, optional
        The optimal value, as a dotted line.
    window : int
        Epochs that a heavy line averages over; 1 for the values themselves.
    """
    ax = axes_or_new(ax)
    for number, (label, curve) in enumerate(curves.items()):
        colour, line = INK[number % len(INK)], LINES[number % len(LINES)]
        ax.plot(curve.sampled, color=colour, alpha=0.25, linewidth=0.4)
        at, smooth = _smooth(curve.exact, window)
        if np.ptp(curve.exact) > 0:
            ax.plot(curve.exact, ".", color=colour, markersize=1, alpha=0.3)
        ax.plot(at, smooth, color=colour, linestyle=line, linewidth=1.6, label=label)
    if optimum is not None:
        ax.axhline(optimum, color="black", linestyle=":", linewidth=1, label="optimum")
    ax.set_xlabel("epoch")
    ax.set_ylabel("return")
    ax.legend(frameon=False, loc="lower right")
    return ax


@plain_text
def plot_value_bands(
    values: Mapping[str, Floats],
    *,
    optimum: float | None = None,
    window: int = 25,
    ax: Axes | None = None,
) -> Axes:
    """Draw exact values of greedy policies by epoch: mean over runs, 5 and 95 % quantiles.

    Parameters
    ----------
    values : {label: (R, E)}
        As `analysis.learning.curves.exact_curves` returns them.
    window : int
        Epochs to average over.
    """
    ax = axes_or_new(ax)
    for number, (label, curves) in enumerate(values.items()):
        colour, line = INK[number % len(INK)], LINES[number % len(LINES)]
        low, high = np.quantile(curves, [0.05, 0.95], axis=0)
        at, middle = _smooth(curves.mean(axis=0), window)
        below, above = _smooth(low, window)[1], _smooth(high, window)[1]
        ax.fill_between(at, below, above, color=colour, alpha=0.2, linewidth=0)
        ax.plot(at, middle, color=colour, linestyle=line, linewidth=1.4, label=label)
    if optimum is not None:
        ax.axhline(optimum, color="black", linestyle=":", linewidth=1, label="optimum")
    ax.set_xlabel("epoch")
    ax.set_ylabel("exact value of the greedy policy")
    ax.legend(frameon=False, loc="lower right")
    return ax


@plain_text
def plot_regrets(found: Mapping[str, Outcomes], *, ax: Axes | None = None) -> Axes:
    """Draw the share of runs whose final regret is at most x, one step line for each training."""
    ax = axes_or_new(ax)
    for number, (label, each) in enumerate(found.items()):
        regret = np.sort(each.regret)
        share = np.arange(1, len(regret) + 1) / len(regret)
        ax.step(
            np.concatenate([[0], regret]),
            np.concatenate([[0], share]),
            where="post",
            color=INK[number % len(INK)],
            linestyle=LINES[number % len(LINES)],
            label=f"{label}: mean {regret.mean():.2f}, optimal {each.optimal_fraction:.1%}",
        )
    ax.set_xlim(left=0)
    ax.set_ylim(0, 1)
    ax.set_xlabel("exact regret of the final policy")
    ax.set_ylabel("share of runs")
    ax.legend(frameon=False, loc="lower right")
    return ax


@plain_text
def plot_distinct(found: Mapping[str, Outcomes], *, ax: Axes | None = None) -> Axes:
    """Draw how many policies are greedy in the last episodes of a run, with 95 % intervals."""
    ax = axes_or_new(ax)
    width = 0.8 / max(len(found), 1)
    for number, (label, each) in enumerate(found.items()):
        many = np.arange(1, each.distinct.max() + 1)
        counts = [int((each.distinct == size).sum()) for size in many]
        _bars(ax, many + (number - (len(found) - 1) / 2) * width, counts, each.runs, width, number)
        ax.plot([], [], color=INK[number % len(INK)], marker="s", linestyle="", label=label)
    ax.set_xlabel("policies greedy in the last episodes")
    ax.set_ylabel("share of runs")
    ax.legend(frameon=False)
    return ax


@plain_text
def plot_instability(
    prediction: Prediction, counts: Sequence[int], *, ax: Axes | None = None
) -> Axes:
    """Draw predicted and observed shares of a row's greedy actions, gap and noise below each.

    Parameters
    ----------
    prediction : Prediction
    counts : (A,) runs that ended with each action
    """
    ax = axes_or_new(ax)
    actions = np.flatnonzero(~np.isnan(prediction.gaps))
    total = int(np.sum(counts))
    at = np.arange(len(actions))
    _bars(ax, at, [int(counts[action]) for action in actions], total, 0.5, 3)
    for shares, marker, label, shift in (
        (prediction.linear, "^", "linear noise around the fixed point", -0.12),
        (prediction.switching, "o", "noise and switching", 0.12),
    ):
        ax.plot(
            at + shift,
            shares[actions],
            marker=marker,
            linestyle="",
            color="black",
            markerfacecolor="white",
            label=label,
        )
    names = prediction.field.mdp.actions
    ax.set_xticks(
        at,
        [
            f"{names[action]}\ngap {prediction.gaps[action]:.2f}\n"
            f"noise {prediction.spread[action]:.2f}"
            for action in actions
        ],
    )
    ax.set_ylabel("share of runs")
    ax.set_title(f"Greedy action at the end, {prediction.label}")
    ax.legend(frameon=False)
    return ax


def _smooth(values: Floats, window: int) -> tuple[Floats, Floats]:
    """Return the middle of each window of epochs, and the mean of the values in it."""
    size = min(window, len(values))
    means = np.convolve(values, np.full(size, 1 / size), mode="valid")
    return np.arange(len(means)) + (size - 1) / 2, means


def _bars(
    ax: Axes, at: Floats, counts: Sequence[int], total: int, width: float, number: int
) -> None:
    shares = np.array(counts) / total
    low, high = np.array([share_interval(count, total) for count in counts]).T
    # Rounding may put a share of nothing or of everything beyond the end of its interval.
    error = np.maximum([shares - low, high - shares], 0)
    ax.bar(
        at,
        shares,
        width=width,
        yerr=error,
        color=INK[number % len(INK)],
        alpha=0.55,
        edgecolor="black",
        linewidth=0.6,
        error_kw={"elinewidth": 0.8, "capsize": 2},
    )
