"""Drawings that a comparison of policies needs: flow of trials, averages, maps of agreement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch, Rectangle

from exact_mdp.analysis.plots.style import LINES, PALETTE, action_styles, axes_or_new, plain_text
from exact_mdp.mdp.table import Floats, Integers

SHADES = (PALETTE[6], PALETTE[3], PALETTE[7])


@dataclass(frozen=True, kw_only=True)
class Average:
    """A reported average beside the exact one.

    Attributes
    ----------
    label : str
    exact, standard_error : float
        The exact mean, and the exact standard error of an average like the reported one.
    reported : float
    span : (low, high), optional
        Exact means over everything that is left open.
    """

    label: str
    exact: float
    standard_error: float
    reported: float
    span: tuple[float, float] | None = None


@plain_text
def plot_averages(
    averages: Sequence[Average], *, optimum: float | None = None, ax: Axes | None = None
) -> Axes:
    """Draw exact means with bars of one and three standard errors, and what was reported.

    Parameters
    ----------
    averages : from top to bottom
    optimum : the optimal value, as a dotted line
    """
    ax = axes_or_new(ax)
    for row, each in enumerate(averages):
        if each.span is not None:
            ax.plot(each.span, [row, row], color="0.8", linewidth=9, solid_capstyle="butt")
        for errors, width in ((3, 1.2), (1, 4.0)):
            low, high = (each.exact + sign * errors * each.standard_error for sign in (-1, 1))
            ax.plot([low, high], [row, row], color="0.35", linewidth=width, solid_capstyle="butt")
        ax.plot(each.exact, row, "o", color="black", markersize=5)
        ax.plot(each.reported, row, "D", markersize=7, markerfacecolor="white", color="black")
        apart = (each.exact - each.reported) / each.standard_error
        ax.annotate(
            f"{apart:+.1f} s.e.".replace("-", "−"),
            (1.01, row),
            xycoords=("axes fraction", "data"),
            va="center",
        )
    if optimum is not None:
        ax.axvline(optimum, color="black", linestyle=":", linewidth=1)
        ax.annotate(
            f"optimum {optimum:.1f}", (optimum, 1.01), xycoords=("data", "axes fraction"),
            ha="center", va="bottom", fontsize=8,
        )  # fmt: skip
    ax.set_yticks(range(len(averages)), [each.label for each in averages])
    ax.set_ylim(len(averages) - 0.5, -0.5)
    ax.set_xlabel("average return")
    handles = [
        ax.plot([], [], "o", color="black", markersize=5, label="exact, ±1 and ±3 s.e.")[0],
        ax.plot([], [], "D", color="black", markerfacecolor="white", label="reported")[0],
    ]
    if any(each.span is not None for each in averages):
        handles += ax.plot(
            [], [], color="0.8", linewidth=9, label="exact, over what the text leaves open"
        )
    ax.legend(
        handles=handles, frameon=False, loc="upper center", bbox_to_anchor=(0.45, -0.22), ncols=3
    )
    return ax


@plain_text
def plot_agreement(
    actions: Sequence[str],
    choices: Integers,
    shares: Floats,
    *,
    statuses: Sequence[str],
    marked: Sequence[int] = (),
    ax: Axes | None = None,
) -> Axes:
    """Draw the commonest action of every status vector and the share of runs that chose it.

    Parameters
    ----------
    actions : names of all actions
    choices, shares : (2^n,)
    statuses : names of the n status bits
    marked : status vectors to be marked with a heavy frame
    """
    ax = axes_or_new(ax)
    styles = action_styles(actions)
    bits = len(statuses)
    high, low = bits - bits // 2, bits // 2
    for vector in range(2**bits):
        row, column = vector >> low, vector & (2**low - 1)
        drawn = styles[int(choices[vector])]
        ax.add_patch(
            Rectangle(
                (column, row), 1, 1, facecolor=drawn.fill, edgecolor="black", hatch=drawn.hatch
            )
        )
        ax.text(
            column + 0.5, row + 0.5, f"{drawn.short}\n{shares[vector]:.0%}", ha="center",
            va="center", color=drawn.ink, fontsize=8,
            bbox={"facecolor": drawn.fill, "edgecolor": "none", "pad": 1.2},
        )  # fmt: skip
    for vector in marked:
        row, column = vector >> low, vector & (2**low - 1)
        ax.add_patch(
            Rectangle(
                (column + 0.05, row + 0.05), 0.9, 0.9, fill=False, edgecolor="black", linewidth=2.5
            )
        )
    ax.set(xlim=(0, 2**low), ylim=(2**high, 0), aspect="equal")
    ax.set_xticks(np.arange(2**low) + 0.5, [format(v, f"0{low}b") for v in range(2**low)])
    ax.set_yticks(np.arange(2**high) + 0.5, [format(v, f"0{high}b") for v in range(2**high)])
    ax.set_xlabel(", ".join(statuses[high:]))
    ax.set_ylabel(", ".join(statuses[:high]))
    ax.tick_params(length=0)
    return ax


@plain_text
def plot_trials(flows: Mapping[str, tuple[Floats, Floats]], *, ax: Axes | None = None) -> Axes:
    """Draw the trials of a subtask: how many of those who try complete it, and who skips it.

    Parameters
    ----------
    flows : {label: ((M,), (M,))}
        For each policy the probability that trial t = 1 … M is made, and that it completes the
        subtask when made.
    """
    ax = axes_or_new(ax)
    trials, gap, top = len(next(iter(flows.values()))[0]), 2.1, 1.5
    last = gap * (trials - 1)
    _box(ax, last / 2, top, "status 0000: subtask completed", width=last + 1.3, height=0.42)
    _box(ax, last + gap, 0.0, "skipped")
    for t in range(trials):
        x = gap * t
        reached = "\n".join(f"{made[t]:.1%}" for made, _ in flows.values())
        _box(ax, x, 0.0, f"trial {t + 1}\n{reached}")
        _arrow(ax, (x, 0.42), (x, top - 0.21))
        completes = "\n".join(f"{ends[t]:.1%}" for _, ends in flows.values())
        ax.text(x + 0.1, 0.86, completes, fontsize=8, va="center", ha="left")
        _arrow(ax, (x + 0.62, 0.0), (x + gap - 0.62, 0.0))
    order = "; ".join(f"line {i + 1}: {label}" for i, label in enumerate(flows))
    ax.text(
        -0.62, -0.62,
        "In a box: probability that the trial is made. At an arrow upwards: that it completes the "
        f"subtask when made.\nIn each, {order}.", fontsize=8, va="top",
    )  # fmt: skip
    ax.set(xlim=(-0.7, last + gap + 0.7), ylim=(-1.15, top + 0.3))
    ax.set_axis_off()
    return ax


def _box(
    ax: Axes, x: float, y: float, text: str, *, width: float = 1.24, height: float = 0.84
) -> None:
    ax.add_patch(
        Rectangle(
            (x - width / 2, y - height / 2), width, height, facecolor="white", edgecolor="black"
        )
    )
    ax.text(x, y, text, ha="center", va="center", fontsize=8)


def _arrow(ax: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    ax.add_patch(
        FancyArrowPatch(
            start, end, arrowstyle="-|>", mutation_scale=9, color="0.35", linewidth=1,
            shrinkA=0, shrinkB=0,
        )
    )  # fmt: skip


@plain_text
def plot_choices(
    losses: Floats,
    *,
    rows: Sequence[str],
    columns: Sequence[str],
    marked: Mapping[int, int] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw what is lost by taking each action in each row, everything else being optimal.

    Parameters
    ----------
    losses : (K, A)
        0 for the best action of a row.
    rows, columns : names of the K rows and A actions
    marked : {row: column}, optional
        Cells with a heavy frame.
    """
    ax = axes_or_new(ax)
    shade = 1 - 0.75 * np.sqrt(losses / max(float(losses.max()), 1e-300))
    for row, column in np.ndindex(losses.shape):
        light = float(shade[row, column])
        ax.add_patch(Rectangle((column, row), 1, 1, facecolor=str(light), edgecolor="white"))
        loss = losses[row, column]
        text = "best" if loss == 0 else f"−{loss:.2f}" if loss >= 0.005 else "−0.00…"
        ax.text(
            column + 0.5, row + 0.5, text, ha="center",
            va="center", fontsize=8, color="black" if light > 0.5 else "white",
            fontweight="bold" if loss == 0 else "normal",
        )  # fmt: skip
    for row, column in (marked or {}).items():
        ax.add_patch(
            Rectangle(
                (column + 0.03, row + 0.06), 0.94, 0.88, fill=False, edgecolor="black", linewidth=2
            )
        )
    ax.set(xlim=(0, len(columns)), ylim=(len(rows), 0))
    ax.set_xticks(np.arange(len(columns)) + 0.5, columns)
    ax.set_yticks(np.arange(len(rows)) + 0.5, rows, family="monospace")
    ax.xaxis.tick_top()
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    return ax


@plain_text
def plot_experiments(
    curves: Mapping[str, Floats], *, window: int = 100, bin: int = 20, ax: Axes | None = None
) -> Axes:
    """Draw averages of experiments by epoch: their range in bins, and their running mean.

    A line through thousands of points is a pale block; the range in each bin of epochs is the same
    block, and light as a vector drawing.

    Parameters
    ----------
    curves : {label: (E,)}
    window : epochs of the running mean
    bin : epochs of a range
    """
    ax = axes_or_new(ax)
    for number, (label, values) in enumerate(curves.items()):
        parts = np.array_split(values, max(len(values) // bin, 1))
        at = np.linspace(0, len(values), len(parts))
        low, high = ([f(part) for part in parts] for f in (np.min, np.max))
        ink, line = SHADES[number % len(SHADES)], LINES[number % len(LINES)]
        ax.fill_between(at, low, high, color=ink, alpha=0.22, linewidth=0)
        size = min(window, len(values))
        mean = np.convolve(values, np.full(size, 1 / size), mode="valid")
        ax.plot(
            np.arange(len(mean)) + size / 2, mean, color=ink, linestyle=line, linewidth=1.6,
            label=label,
        )  # fmt: skip
    ax.set_xlabel("epoch")
    ax.set_ylabel("average return")
    return ax
