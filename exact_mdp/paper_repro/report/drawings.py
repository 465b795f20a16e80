"""Drawings that a comparison of policies needs: flow of trials, averages, maps of agreement."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress, product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch, Rectangle
from matplotlib.ticker import PercentFormatter

from exact_mdp.analysis.plots.learning import sampled_band, smoothed
from exact_mdp.analysis.plots.style import (
    INK,
    LINES,
    Look,
    action_styles,
    axes_or_new,
    cell,
    name_rows,
    plain_text,
    swatch,
)
from exact_mdp.mdp.table import Floats, Integers


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
def plot_averages(averages: Sequence[Average], *, optimum: float, ax: Axes | None = None) -> Axes:
    """Draw exact means with bars of one and three standard errors, and what was reported.

    The first average is on top; the optimal value is a dotted line.
    """
    ax = axes_or_new(ax)
    reported: Look = {"marker": "D", "color": "black", "markerfacecolor": "white", "linestyle": ""}
    exact: Look = {"marker": "o", "color": "black", "markersize": 5, "linestyle": ""}
    wide: Look = {"color": "0.8", "linewidth": 9, "solid_capstyle": "butt"}
    for row, each in enumerate(averages):
        if each.span is not None:
            ax.plot(each.span, [row, row], **wide)
        for errors, width in ((3, 1.2), (1, 4.0)):
            reach = errors * each.standard_error
            ends = [each.exact - reach, each.exact + reach]
            ax.plot(ends, [row, row], color="0.35", linewidth=width, solid_capstyle="butt")
        ax.plot(each.exact, row, **exact)
        ax.plot(each.reported, row - 0.26, markersize=6, **reported)  # above, not on, the exact one
        apart = f"{(each.exact - each.reported) / each.standard_error:+z.1f} s.e."
        place = ("axes fraction", "data")
        ax.annotate(apart.replace("-", "−"), (1.01, row), xycoords=place, va="center")
    ax.axvline(optimum, color="black", linestyle=":", linewidth=1)
    ax.annotate(
        f"optimum {optimum:.1f}",
        (optimum, 1.01),
        xycoords=("data", "axes fraction"),
        ha="center",
        va="bottom",
        fontsize=8,
    )
    name_rows(ax, [each.label for each in averages])
    ax.set_ylim(len(averages) - 0.5, -0.5)
    ax.set_xlabel("average return (points)")
    handles = [
        *ax.plot([], [], label="exact, ±1 and ±3 s.e.", **exact),
        *ax.plot([], [], label="reported", **reported),
    ]
    if any(each.span is not None for each in averages):
        handles += ax.plot([], [], label="exact, over what the text leaves open", **wide)
    ax.legend(handles=handles, loc="upper left", bbox_to_anchor=(0, -0.18))
    return ax


@plain_text
def plot_status_policy(
    actions: Sequence[str],
    choices: Integers,
    *,
    statuses: Sequence[str],
    shares: Floats | None = None,
    marked: Collection[int] = (),
    ax: Axes | None = None,
) -> Axes:
    """Draw the action in every status vector, in words; perhaps the share of runs that chose it.

    Choices and shares are (2^n,) for n statuses; a vector that is marked is called not optimal.
    """
    ax, styles, bits = axes_or_new(ax), action_styles(actions), len(statuses)
    low = bits // 2
    for vector, choice in enumerate(choices):
        lines = [actions[int(choice)]]
        lines += [] if shares is None else [f"{shares[vector]:.0%} of the runs"]
        lines += ["not optimal"] if vector in marked else []
        place = vector & (2**low - 1), vector >> low
        cell(ax, *place, styles[int(choice)], text="\n".join(lines), font=7)
    down, across = statuses[: bits - low], statuses[bits - low :]
    ax.set(xlim=(0, 2**low), ylim=(2 ** (bits - low), 0))
    ax.set_xticks(np.arange(2**low) + 0.5, combinations(across))
    ax.set_yticks(np.arange(2 ** (bits - low)) + 0.5, combinations(down))
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    return ax


def combinations(names: Sequence[str]) -> list[str]:
    """Return every combination of statuses in words, one below the other.

    >>> combinations(["anger", "disengagement"])
    ['neither', 'disengagement', 'anger', 'anger\\ndisengagement']
    """
    absent = "neither" if len(names) == 2 else "none"
    rows = product((False, True), repeat=len(names))
    return ["\n".join(compress(names, present)) or absent for present in rows]


@plain_text
def plot_trials(flows: Mapping[str, tuple[Floats, Floats]], *, ax: Axes | None = None) -> Axes:
    """Draw the trials of a subtask: how many of those who try complete it, and who skips it.

    For each label, (M,) probabilities that trial t = 1 … M is made, and (M,) that it completes the
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
    note = (
        "In a box: probability that the trial is made. At an arrow upwards: that it completes the "
        f"subtask when made.\nIn each, {order}."
    )
    ax.text(-0.62, -0.62, note, fontsize=8, va="top")
    ax.set(xlim=(-0.7, last + gap + 0.7), ylim=(-1.15, top + 0.3))
    ax.set_axis_off()
    return ax


@plain_text
def plot_boxes(
    boxes: Mapping[str, tuple[float, float, str, bool]],
    arrows: Sequence[tuple[str, str, str]],
    *,
    ax: Axes | None = None,
) -> Axes:
    """Draw boxes {name: (x, y, text, shaded)} and arrows (from, to, words beside it) between them.

    An arrow runs straight between neighbours in a row or a column.
    """
    ax = axes_or_new(ax)
    width, height = 1.9, 0.62
    xs, ys = zip(*((x, y) for x, y, *_ in boxes.values()), strict=True)
    for x, y, text, shaded in boxes.values():
        _box(ax, x, y, text, width=width, height=height, shade="0.88" if shaded else "white")
    for source, target, words in arrows:
        (x, y), (u, v) = boxes[source][:2], boxes[target][:2]
        across = x != u
        reach = width / 2 if across else height / 2
        step = reach * (1 if (u > x if across else v > y) else -1)
        start, end = ((x + step, y), (u - step, v)) if across else ((x, y + step), (u, v - step))
        _arrow(ax, start, end)
        at = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
        side = 0 if across else -0.08 if x == max(xs) else 0.08  # words stay inside the picture
        place: Look = {"ha": "center", "va": "bottom"} if across else {"va": "center"}
        if not across:
            place["ha"] = "left" if side > 0 else "right"
        ax.text(at[0] + side, at[1] + (0.05 if across else 0), words, fontsize=7, **place)
    ax.set(xlim=(min(xs) - 1.05, max(xs) + 1.05), ylim=(min(ys) - 0.4, max(ys) + 0.4))
    ax.set_axis_off()
    return ax


def _box(
    ax: Axes,
    x: float,
    y: float,
    text: str,
    *,
    width: float = 1.24,
    height: float = 0.84,
    shade: str = "white",
) -> None:
    corner = x - width / 2, y - height / 2
    ax.add_patch(Rectangle(corner, width, height, facecolor=shade, edgecolor="black"))
    ax.text(x, y, text, ha="center", va="center", fontsize=8)


def _arrow(ax: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    drawn: Look = {"color": "0.35", "linewidth": 1, "shrinkA": 0, "shrinkB": 0}
    ax.add_patch(FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=9, **drawn))


@plain_text
def plot_choices(
    losses: Floats,
    *,
    rows: Sequence[str],
    columns: Sequence[str],
    marked: Mapping[int, int],
    ax: Axes | None = None,
) -> Axes:
    """Draw what is lost by taking each action in each row, everything else being optimal.

    Losses are (K, A), 0 for the best action of a row; cells {row: column} marked have a dot.
    """
    ax = axes_or_new(ax)
    shade = 1 - 0.75 * np.sqrt(losses / max(float(losses.max()), 1e-300))
    for row, column in np.ndindex(losses.shape):
        light, loss = float(shade[row, column]), losses[row, column]
        ink = "black" if light > 0.5 else "white"
        face: Look = {"facecolor": str(light), "edgecolor": "0.85", "linewidth": 0.5}
        ax.add_patch(Rectangle((column, row), 1, 1, **face))
        text = "best" if loss == 0 else f"{loss:.2f}" if loss >= 0.005 else "under 0.01"
        weight = "bold" if loss == 0 else "normal"
        centre: Look = {"ha": "center", "va": "center", "fontsize": 8, "color": ink}
        ax.text(column + 0.5, row + 0.5, text, fontweight=weight, **centre)
        if marked.get(row) == column:
            ax.plot(column + 0.12, row + 0.5, "o", color=ink, markersize=4)
    ax.set(xlim=(0, len(columns)), ylim=(len(rows), 0))
    ax.set_xticks(np.arange(len(columns)) + 0.5, columns)
    ax.set_yticks(np.arange(len(rows)) + 0.5, rows)
    ax.xaxis.tick_top()
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    return ax


@plain_text
def plot_experiments(
    curves: Mapping[str, Floats], *, window: int = 100, ax: Axes | None = None
) -> Axes:
    """Draw averages (E,) of experiments by epoch: their range in bins, and their running mean."""
    ax = axes_or_new(ax)
    inks = (INK[0], INK[1], INK[3])
    for number, (label, values) in enumerate(curves.items()):
        ink, line = inks[number % len(inks)], LINES[number % len(LINES)]
        sampled_band(ax, values, ink)
        ax.plot(*smoothed(values, window), color=ink, linestyle=line, linewidth=1.6, label=label)
    ax.set(xlabel="epoch", ylabel="average return (points)")
    return ax


@plain_text
def plot_shares(
    counts: Mapping[str, Integers], actions: Sequence[str], *, ax: Axes | None = None
) -> Axes:
    """Draw a bar for each row of counts (A,), divided by the shares of the actions."""
    ax = axes_or_new(ax)
    styles = action_styles(actions)
    for row, each in enumerate(counts.values()):
        shares = np.asarray(each)[: len(actions)] / np.sum(each)
        for style, share, left in zip(styles, shares, np.cumsum(shares) - shares, strict=True):
            look: Look = {"color": style.fill, "hatch": style.hatch, "edgecolor": "black"}
            ax.barh(row, share, left=left, height=0.6, linewidth=0.6, **look)
    name_rows(ax, list(counts))
    ax.set_xlim(0, 1)
    ax.xaxis.set_major_formatter(PercentFormatter(1))
    handles = [swatch(style.name, style) for style in styles]
    ax.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1), ncols=4, frameon=False)
    return ax


@plain_text
def plot_dots(values: Mapping[str, Floats], *, ax: Axes | None = None) -> Axes:
    """Draw a row of dots for each name, one for each value, and a bar at their mean."""
    ax = axes_or_new(ax)
    for row, each in enumerate(values.values()):
        apart = (np.arange(len(each)) * 0.618034) % 1 - 0.5  # spread, and the same each time
        ax.plot(each, row + 0.6 * apart, "o", ms=2.5, mfc="none", color="0.45", mew=0.6)
        ax.plot([each.mean()] * 2, [row - 0.4, row + 0.4], color="black", lw=2)
    name_rows(ax, list(values))
    return ax
