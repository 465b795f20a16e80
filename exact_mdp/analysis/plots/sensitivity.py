"""Figures of sensitivity analyses: tornado, curves, thresholds, robust values, global measures.

`output` is "optimal", the value with the policy re-optimised, "fixed", the value with it held, or
"regret", that of the policy held; `most` is the number of bars.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, to_rgb

from exact_mdp.analysis.plots.style import (
    BLACK,
    BLUE,
    LINES,
    WHITE,
    action_legend,
    action_styles,
    axes_or_new,
    bars_across,
    legend_beside,
    name_rows,
    plain_text,
    swatch,
    titled,
)
from exact_mdp.analysis.vary.ranges import unit_of
from exact_mdp.mdp.errors import ModelError

if TYPE_CHECKING:
    from exact_mdp.analysis.vary.curves.curve import ValueFunction
    from exact_mdp.analysis.vary.curves.gradient import Gradient
    from exact_mdp.analysis.vary.curves.thresholds import Thresholds
    from exact_mdp.analysis.vary.one_way import Bar, Curve, Tornado, TwoWay
    from exact_mdp.analysis.vary.ranges import Range
    from exact_mdp.analysis.vary.robust import RobustCurve
    from exact_mdp.analysis.vary.sobol import Sobol

OUTPUT = {
    "optimal": "start value, policy re-optimised",
    "fixed": "start value, policy held fixed",
    "regret": "regret of the policy held fixed",
}
RADIUS = {
    "interval": "radius: each transition probability p (1 ± x)",
    "absolute": "radius: each transition probability p ± x",
    "l1": "radius: L1 distance of each row",
    "kl": "radius: KL(p‖q) of each row (nats)",
    "entropy": "radius: KL(q‖p) of each row (nats)",
}


def _with_range(name: str, low: Fraction, high: Fraction) -> str:
    return f"{name} [{float(low):.3g}, {float(high):.3g}]"


def _with_ranges(names: Sequence[str], ranges: Mapping[str, Range]) -> list[str]:
    return [_with_range(name, ranges[name].low, ranges[name].high) for name in names]


@plain_text
def plot_gradient(found: Gradient, *, most: int = 15, ax: Axes | None = None) -> Axes:
    """Draw the largest elasticities: per cent of the start value for a per cent of a parameter.

    Fills say where the value goes: a positive elasticity of a negative value lowers it.
    """
    table = found.frame().dropna(subset="elasticity (% per %)").head(most)
    ax = axes_or_new(ax, names := table["parameter"].tolist())
    rises = (table["derivative (reward per unit)"] > 0).tolist()
    looks = ((WHITE, ""), (BLUE, "//"))
    for place, length in enumerate(table["elasticity (% per %)"]):
        fill, hatch = looks[rises[place]]
        ax.barh(place, length, color=fill, hatch=hatch, edgecolor=BLACK)
    name_rows(ax, names)
    ax.axvline(0, color=BLACK, linewidth=0.8)
    ax.set_xlabel("elasticity of the start value (% per %)")
    words = ("lowers the value", "raises the value")
    handles = [swatch(words[way], looks[way]) for way in sorted({*rises}, reverse=True)]
    legend_beside(ax, handles, title="a higher parameter")
    return ax


@plain_text
def plot_tornado(
    found: Tornado, *, most: int = 15, output: str = "optimal", ax: Axes | None = None
) -> Axes:
    """Draw the widest bars: white where the parameter is at its low end, blue at its high end."""
    middle = float(getattr(found.today, output).value)

    def reaches(bar: Bar) -> list[tuple[float, str, str]]:
        """Return both ends' reach and fill, the wider first."""
        low, high = (getattr(end, output).value - middle for end in (bar.low, bar.high))
        return sorted(((low, WHITE, ""), (high, BLUE, "//")), key=lambda end: -abs(end[0]))

    bars = sorted(found.bars, key=lambda bar: -abs(reaches(bar)[0][0]))[:most]
    names = [_with_range(b.parameter.name, b.low.at, b.high.at) for b in bars]
    ax = axes_or_new(ax, names)
    for place, bar in enumerate(bars):
        for reach, fill, hatch in reaches(bar):
            ax.barh(place, reach, left=middle, color=fill, edgecolor=BLACK, hatch=hatch)
    name_rows(ax, names)
    ax.axvline(middle, color=BLACK, linewidth=0.8)
    ax.set_xlabel(f"{OUTPUT[output]} (reward)")
    legend_beside(ax, [swatch("low end", (WHITE, "")), swatch("high end", (BLUE, "//"))])
    return ax


@plain_text
def plot_value_curves(found: Curve, *, ax: Axes | None = None) -> Axes:
    """Draw the start value along a parameter, the policy re-optimised and held fixed."""
    ax = axes_or_new(ax)
    at = [float(point.at) for point in found.points]
    for line, output in zip(LINES, ("optimal", "fixed"), strict=False):
        values = [getattr(point, output).value for point in found.points]
        label = OUTPUT[output].removeprefix("start value, ")
        ax.plot(at, values, linestyle=line, color=BLACK, label=label)
    _mark_today(ax, float(found.parameter.value), min(at), max(at))
    ax.set_xlabel(f"{found.parameter.name} ({unit_of(found.parameter)})")
    ax.set_ylabel("start value (reward)")
    ax.legend()
    return ax


def _mark_today(ax: Axes, today: float, low: float | Fraction, high: float | Fraction) -> None:
    """Draw a line at today's value, or say that it lies outside the curve."""
    if low <= today <= high:
        ax.axvline(today, color="0.6", linewidth=0.8, label="today")
    else:
        ax.plot([], [], " ", label=f"today: {today:g}, outside")


@plain_text
def plot_value_function(found: ValueFunction, *, n: int = 33, ax: Axes | None = None) -> Axes:
    """Draw the optimal start value along a parameter, piece by piece, from its exact functions.

    A dotted line is a value at which another policy becomes optimal; each piece has `n` points.
    """
    ax = axes_or_new(ax)
    for number, piece in enumerate(found.pieces):
        low, high = piece.low[1], piece.high[0]
        at = [low + (high - low) * Fraction(k, n - 1) for k in range(n)]
        x = [float(value) for value in at]
        if number:
            label = "another policy becomes optimal" if number == 1 else None
            ax.axvline(x[0], color="0.5", linestyle=":", linewidth=1, label=label)
        ax.plot(x, [float(piece.value.at(value)) for value in at], color=BLACK)
        if piece.fixed is not None:
            held = [float(piece.fixed.at(value)) for value in at]
            ax.plot(x, held, "--", color="0.4")
    ax.plot([], [], color=BLACK, label=OUTPUT["optimal"].removeprefix("start value, "))
    if found.pieces[0].fixed is not None:
        ax.plot([], [], "--", color="0.4", label=OUTPUT["fixed"].removeprefix("start value, "))
    _mark_today(ax, float(found.parameter.value), found.pieces[0].low[0], found.pieces[-1].high[1])
    ax.set_xlabel(f"{found.parameter.name} ({unit_of(found.parameter)})")
    ax.set_ylabel(f"start value (reward; {found.claim})")
    ax.legend()
    return ax


@plain_text
def plot_thresholds(
    changes: Thresholds | Mapping[str, Thresholds], *, reached: bool = False, ax: Axes | None = None
) -> Axes:
    """Draw a strip for each parameter: its range, today's value, thresholds, and where it is safe.

    Ranges are drawn to the same length; numbers at their ends give the scale. With `reached`,
    changes in states that the optimum does not reach are left out.

    Parameters
    ----------
    changes : Thresholds or {name: Thresholds}
    reached : bool, optional
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> from exact_mdp import Scenario, thresholds
    >>> small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    >>> ax = plot_thresholds(thresholds(small, "reward.anger"))
    >>> ax.get_xlabel()
    'blue: the optimal policy stays; bar: an optimal action changes; diamond: today'
    """
    every = [*changes.values()] if isinstance(changes, Mapping) else [changes]
    if ax is None:
        ax = plt.subplots(figsize=(7, 0.9 + 0.7 * len(every)))[1]
    for place, each in enumerate(every):
        low, high = float(each.range.low), float(each.range.high)
        width = (high - low) or 1.0
        near, far = ((float(end) - low) / width for end in each.stable(reached=reached))
        ax.barh(place, 1.0, color=WHITE, edgecolor=BLACK, height=0.6)
        ax.barh(place, far - near, left=near, color=BLUE, edgecolor=BLACK, height=0.6)
        for threshold in each.found:
            if not reached or threshold.reached:
                x = (threshold.value - low) / width
                line = ":" if threshold.touch else "-"
                ax.plot([x, x], [place - 0.3, place + 0.3], line, color=BLACK, linewidth=1)
        ax.plot((float(each.parameter.value) - low) / width, place, "D", color=BLACK, markersize=4)
        ax.text(-0.01, place + 0.42, f"{low:.3g}", ha="left", va="center", fontsize=7)
        ax.text(1.01, place + 0.42, f"{high:.3g}", ha="right", va="center", fontsize=7)
    parameters = [each.parameter for each in every]
    name_rows(ax, [f"{parameter.name} ({unit_of(parameter)})" for parameter in parameters])
    ax.set(xticks=[], xlim=(-0.02, 1.02), ylim=(len(every) - 0.4, -0.6))
    ax.set_xlabel("blue: the optimal policy stays; bar: an optimal action changes; diamond: today")
    return ax


@plain_text
def plot_two_way(found: TwoWay, *, state: int | None = None, ax: Axes | None = None) -> Axes:
    """Draw which policy is optimal over two parameters, or which action in the state given.

    Colours of policies have no order; a number stands in each region's first point.
    """
    ax, styles = axes_or_new(ax), action_styles(found.mdp.actions)
    x, y = found.x_values, found.y_values
    shown = found.policy if state is None else found.actions_at(state)
    if state is None:
        count = int(shown.max()) + 1
        shades = np.linspace(1.0, 0.35, count)[np.argsort(np.arange(count) % 2, kind="stable")]
        colours, names = [str(shade) for shade in shades], [str(n) for n in range(count)]
        ax.set_title("policies that are optimal, by number (sampled); diamond: today")
    else:
        colours, names = [s.fill for s in styles], [s.short for s in styles]
        action_legend(ax, styles, np.unique(shown).tolist())
    ends, colour_map = (-0.5, len(colours) - 0.5), ListedColormap(colours)
    ax.pcolormesh(x, y, shown, cmap=colour_map, vmin=ends[0], vmax=ends[1], shading="nearest")
    for number in np.unique(shown).tolist():
        row, column = np.argwhere(shown == number)[0]
        ink = "black" if np.mean(to_rgb(colours[number])) > 0.5 else "white"
        ax.text(x[column], y[row], names[number], ha="center", va="center", color=ink, fontsize=7)
    ax.plot(float(found.x.value), float(found.y.value), "D", color=BLACK, markersize=5)
    ax.set_xlabel(f"{found.x.name} ({unit_of(found.x)})")
    ax.set_ylabel(f"{found.y.name} ({unit_of(found.y)})")
    return ax


@plain_text
def plot_robust_curve(found: RobustCurve, *, ax: Axes | None = None) -> Axes:
    """Draw the start value of both policies against the radius: tables right, and worst case.

    The distance of the upper lines is the price of robustness, that of the lower ones the gain.
    """
    ax = axes_or_new(ax)
    every = [each for _, each in found.points]
    for label, values, line, marker, shade in (
        ("robust policy, tables right", [each.robust_value for each in every], "-", "s", "0"),
        ("nominal policy, tables right", [each.value for each in every], "--", "s", "0.55"),
        ("robust policy, worst case", [each.robust.start for each in every], "-", "o", "0"),
        ("nominal policy, worst case", [each.worst for each in every], "--", "o", "0.55"),
    ):
        ax.plot(
            [radius for radius, _ in found.points],
            [value.value for value in values],
            line,
            marker=marker,
            markersize=4,
            markerfacecolor=shade if shade == "0" else "white",
            color=shade,
            label=label,
        )
    ax.set_xlabel(RADIUS[found.kind])
    ax.set_ylabel("start value (reward)")
    ax.legend()
    return ax


@plain_text
def plot_sobol(
    indices: Sobol, *, output: str = "optimal", most: int = 12, ax: Axes | None = None
) -> Axes:
    """Draw first-order and total indices of the parameters that weigh most, with intervals.

    Parameters
    ----------
    indices : Sobol
    output : str, optional
        What varies: a key of `Sobol.of`.
    most : int, optional
        How many parameters are drawn.
    ax : Axes, optional

    Returns
    -------
    Axes

    Raises
    ------
    ModelError
        If the output does not vary, and has no indices.

    Examples
    --------
    >>> from exact_mdp import Scenario, sobol
    >>> small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    >>> indices = sobol(small, names=["base.anger", "reward.anger"], n=8, rng=0)
    >>> plot_sobol(indices).get_xlabel()
    'share of the variance'
    """
    each = indices.of(output)
    if each.constant:
        raise ModelError(
            f"the {OUTPUT[output]} is the same at every draw",
            where="plot_sobol",
            fix="draw another output, or state wider ranges",
        )
    order = np.argsort(-each.total, kind="stable")[:most]
    names = _with_ranges([indices.names[place] for place in order], indices.ranges)
    ax = axes_or_new(ax, names)
    for at, lengths, half, fill, hatch, label in (
        (-0.19, each.first, each.first_half, BLUE, "//", "first order: alone"),
        (0.19, each.total, each.total_half, WHITE, "", "total: alone and with others"),
    ):
        places = np.arange(len(order)) + at
        bars_across(ax, places, lengths[order], half[order], fill, hatch, label, height=0.38)
    name_rows(ax, names)
    ax.axvline(0, color=BLACK, linewidth=0.8)
    ax.set_xlim(right=max(1.0, ax.get_xlim()[1]))
    ax.set_xlabel("share of the variance")
    ax.legend(loc="lower right", title=f"{indices.confidence:.0%} intervals")
    titled(ax, f"variance of the {OUTPUT[output]}")
    return ax
