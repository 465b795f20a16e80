"""Pictures of episodes and of training runs: returns, learning curves, final policies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from exact_mdp.analysis.learning.curves import LearningCurve, average_epochs
from exact_mdp.analysis.plots.style import (
    BLUE,
    HATCHES,
    INK,
    Look,
    add_horizontal_line,
    add_lines,
    apply_style,
    axes_or_new,
    choose_line_style,
    label_axes,
)
from exact_mdp.analysis.vary.intervals import compute_wilson_interval

if TYPE_CHECKING:
    from exact_mdp.analysis.learning.outcomes import Outcomes
    from exact_mdp.analysis.learning.trainers import TrainerAudit
    from exact_mdp.solvers.values.returns import ReturnDistribution
    from exact_mdp.solvers.values.simulate import Simulation
    from exact_mdp.solvers.values.trace import Trace

MEAN: Look = {"color": "black", "linestyle": "--", "linewidth": 1}


@apply_style
def plot_return_distribution(distribution: ReturnDistribution, *, ax: Axes | None = None) -> Axes:
    """Draw the probability of each return, with the mean as a line."""
    ax = axes_or_new(ax)
    values = np.array([float(value) for value in distribution.values])
    finite = np.isfinite(values)
    values, thick = values[finite], 5 if finite.sum() < 20 else 1.3
    ax.vlines(values, 0, distribution.probabilities[finite], color="0.45", linewidth=thick)
    if len(values) == 1:
        ax.set_xlim(values[0] - 1, values[0] + 1)
    ax.set_ylim(bottom=0)
    title = f"mean {distribution.mean:.2f}, standard deviation {distribution.sd:.2f}"
    if distribution.never_ends:
        title = f"never ends, and is infinite, with probability {distribution.never_ends:.4g}"
    else:
        ax.axvline(distribution.mean, label="mean", **MEAN)
    what = f"Distribution of the return: {title}"
    return label_axes(ax, what, x="return (reward)", y="probability")


@apply_style
def plot_trace(trace: Trace, *, ax: Axes | None = None) -> Axes:
    """Draw the share of a cohort in each state over time; states without anyone are left out."""
    ax, time = axes_or_new(ax), np.arange(len(trace.share))
    held = np.flatnonzero(trace.share.max(axis=0) > trace.error).tolist()
    add_lines(ax, {trace.states[number]: (time, trace.share[:, number]) for number in held})
    ax.set_ylim(-0.02, 1.02)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    return label_axes(ax, "Cohort trace", x="time (steps)", y="share of the cohort")


@apply_style
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
    return label_axes(ax, what, x="return (reward)", y="episodes")


# ---- learning ------------------------------------------------------------------------------------


@apply_style
def plot_learning_curves(
    curves: LearningCurve | Mapping[str, LearningCurve],
    *,
    optimum: float | None = None,
    window: int = 100,
    ax: Axes | None = None,
) -> Axes:
    """Draw each curve twice: the range of sampled means as a pale band, exact values as a line.

    The greedy policy changes from epoch to epoch, and its exact value with it; the heavy line is
    the mean over a window of epochs, the dots beside it are the values themselves.

    Parameters
    ----------
    curves : LearningCurve or {label: LearningCurve}
    optimum : float, optional
        The optimal value, as a dotted line.
    window : int
        Epochs that a heavy line averages over; 1 for the values themselves.
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> from exact_mdp import QLearning, Scenario, learning_curve
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> curve = learning_curve(mdp, QLearning(epochs=20).train(mdp, rng=0), rng=1)
    >>> plot_learning_curves(curve, window=5).get_xlabel()
    'epoch'
    """
    ax = axes_or_new(ax)
    if isinstance(curves, Mapping):
        every = curves
    else:
        every = {"mean over a window": curves}
    bands = {}
    for number, (label, curve) in enumerate(every.items()):
        # A band is drawn over every 20 epochs.
        parts = np.array_split(curve.sampled, max(len(curve.sampled) // 20, 1))
        at = np.linspace(0, len(curve.sampled) - 1, len(parts))
        bands[label] = at, [part.min() for part in parts], [part.max() for part in parts]
        if np.ptp(curve.value) > 0:
            ax.plot(
                curve.value, ".", color=choose_line_style(number)["color"], markersize=1, alpha=0.3
            )
    means = {label: average_epochs(curve.value, window) for label, curve in every.items()}
    add_lines(ax, means, bands, words="range of sampled means", linewidth=1.6)
    if optimum is not None:
        add_horizontal_line(ax, optimum)
    what = "Value of the greedy policy while it learns"
    return label_axes(ax, what, x="epoch", y="return (reward)")


@apply_style
def plot_regrets(outcomes: Outcomes | Mapping[str, Outcomes], *, ax: Axes | None = None) -> Axes:
    """Draw the share of runs whose final regret is at most x, one step line for each training.

    Parameters
    ----------
    outcomes : Outcomes or {label: Outcomes}
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> from exact_mdp import QLearning, Scenario, outcomes, train
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> runs = outcomes(mdp, train(mdp, QLearning(epochs=20), 2, rng=0))
    >>> plot_regrets(runs).get_xlabel()
    'exact regret of the final policy (reward)'
    """
    ax = axes_or_new(ax)
    if isinstance(outcomes, Mapping):
        every = outcomes
    else:
        every = {"all runs": outcomes}
    steps = {}
    for label, each in every.items():
        words = f"{label}:\nmean {each.regret.mean():.2f}, optimal {each.optimal_fraction:.1%}"
        steps[words] = np.append(0.0, np.sort(each.regret)), np.linspace(0, 1, each.runs + 1)
    add_lines(ax, steps, drawstyle="steps-post")
    ax.set_xlim(left=0)
    ax.set_ylim(0, 1.02)
    return label_axes(
        ax,
        "What trained policies lose",
        next(iter(every.values())).mdp.name,
        x="exact regret of the final policy (reward)",
        y="share of runs that lose at most this",
    )


@apply_style
def plot_trainer(audit: TrainerAudit, *, ax: Axes | None = None) -> Axes:
    """Draw the share of runs within the limits, and its interval, after every run."""
    ax, frame = axes_or_new(ax), audit.frame()
    runs, sure = np.arange(1, len(frame) + 1), 1 - float(audit.alpha)
    label = f"interval of confidence {sure:.4g}\nat all runs"
    band: Look = {"step": "mid", "color": BLUE, "alpha": 0.5, "linewidth": 0}
    ax.fill_between(runs, frame["low"], frame["high"], label=label, **band)
    passed = np.cumsum(frame["passed"]) / runs
    ax.step(runs, passed, where="mid", color=INK[0], label="share of the runs so far")
    add_horizontal_line(ax, float(audit.share), "share required")
    ax.set_ylim(-0.02, 1.02)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    names = {"x": "run", "y": "share of runs within the limits"}
    return label_axes(ax, "How often the trainer is good enough", audit.audits[0].mdp.name, **names)


@apply_style
def plot_distinct(outcomes: Mapping[str, Outcomes], *, ax: Axes | None = None) -> Axes:
    """Draw how many policies are greedy in the last episodes of a run, with 95 % intervals.

    Parameters
    ----------
    outcomes : {label: Outcomes}
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> from exact_mdp import QLearning, Scenario, outcomes, train
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> runs = outcomes(mdp, train(mdp, QLearning(epochs=20), 2, rng=0))
    >>> plot_distinct({"20 epochs": runs}).get_ylabel()
    'share of runs'
    """
    ax = axes_or_new(ax)
    width = 0.8 / max(len(outcomes), 1)
    for number, (label, each) in enumerate(outcomes.items()):
        many = np.arange(1, each.distinct.max() + 1)
        counts = [int((each.distinct == size).sum()) for size in many]
        shares = np.array(counts) / each.runs
        low, high = compute_wilson_interval(counts, each.runs)
        ax.bar(
            many + (number - (len(outcomes) - 1) / 2) * width,
            shares,
            width=width,
            # Rounding may put a share of 0 or 1 beyond the end of its interval.
            yerr=np.maximum([shares - low, high - shares], 0),
            color=INK[number % len(INK)],
            alpha=0.55,
            edgecolor="black",
            hatch=HATCHES[2 * (number % 3)],
            label=label,
            linewidth=0.6,
            error_kw={"elinewidth": 0.8, "capsize": 2},
        )
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    names = {"x": "policies greedy in the last episodes", "y": "share of runs"}
    return label_axes(ax, "How many policies a run ends between", **names)
