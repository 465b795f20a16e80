"""Figures of the one-way and two-way analyses and of the thresholds.

Figures of the robust analysis: values against the radius of the sets.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.patches import Patch

from exact_mdp.analysis.plots.style import LINES, action_styles, axes_or_new, plain_text
from exact_mdp.analysis.sensitivity.ranges import unit_of

if TYPE_CHECKING:
    from exact_mdp.analysis.sensitivity.one_way import Curve, Tornado
    from exact_mdp.analysis.sensitivity.robust.robust import RobustCurve
    from exact_mdp.analysis.sensitivity.thresholds import Thresholds
    from exact_mdp.analysis.sensitivity.two_way import TwoWay


BELOW, ABOVE, LINE = "#FFFFFF", "#56B4E9", "#000000"


@plain_text
def plot_tornado(
    tornado: Tornado, *, most: int = 15, show: str = "optimal", ax: Axes | None = None
) -> Axes:
    """Draw the widest bars: white where the parameter is at its low end, blue at its high end.

    Parameters
    ----------
    show : "optimal" (policy re-optimised), "fixed" (policy held) or "regret" (of the held one)
    """
    ax = axes_or_new(ax)
    middle = float(getattr(tornado.today, show).value)

    def width(bar: object) -> float:
        return max(abs(getattr(end, show).value - middle) for end in (bar.low, bar.high))

    bars = sorted(tornado.bars, key=width, reverse=True)[:most]
    for place, bar in enumerate(bars):
        ends = sorted(
            ((bar.low, BELOW, ""), (bar.high, ABOVE, "//")),
            key=lambda end: -abs(getattr(end[0], show).value - middle),
        )
        for end, colour, hatch in ends:
            reach = getattr(end, show).value - middle
            ax.barh(place, reach, left=middle, color=colour, edgecolor="black", hatch=hatch)
    labels = [
        f"{bar.parameter.name} [{float(bar.low.at):.3g}, {float(bar.high.at):.3g}]" for bar in bars
    ]
    ax.set_yticks(range(len(bars)), labels)
    ax.invert_yaxis()
    ax.axvline(middle, color=LINE, linewidth=0.8)
    what = {
        "optimal": "start value, policy re-optimised",
        "fixed": "start value, policy held fixed",
        "regret": "regret of the policy held fixed",
    }[show]
    ax.set_xlabel(f"{what} (reward)")
    handles = [
        Patch(facecolor=BELOW, edgecolor="black", label="low end"),
        Patch(facecolor=ABOVE, edgecolor="black", hatch="//", label="high end"),
    ]
    ax.legend(handles=handles, loc="lower right", frameon=False)
    return ax


@plain_text
def plot_value_curves(curve: Curve, *, ax: Axes | None = None) -> Axes:
    """Draw the start value along a parameter, the policy re-optimised and held fixed."""
    ax = axes_or_new(ax)
    at = [float(point.at) for point in curve.points]
    for line, values, label in (
        (LINES[0], [point.optimal.value for point in curve.points], "policy re-optimised"),
        (LINES[1], [point.fixed.value for point in curve.points], "policy held fixed"),
    ):
        ax.plot(at, values, line, color=LINE, label=label)
    ax.axvline(float(curve.parameter.value), color="0.6", linewidth=0.8, label="today")
    ax.set_xlabel(f"{curve.parameter.name} ({unit_of(curve.parameter)})")
    ax.set_ylabel("start value (reward)")
    ax.legend(frameon=False)
    return ax


@plain_text
def plot_thresholds(
    found: Mapping[str, Thresholds], *, reached: bool = False, ax: Axes | None = None
) -> Axes:
    """Draw a strip for each parameter: its range, today's value, thresholds, and where it is safe.

    Ranges are drawn to the same length; numbers at their ends give the scale.
    """
    ax = axes_or_new(ax)
    for place, each in enumerate(found.values()):
        low, high = float(each.range.low), float(each.range.high)
        width = (high - low) or 1.0
        near, far = (float(end) for end in each.stable(reached=reached))
        ax.barh(place, 1.0, color="white", edgecolor="black", height=0.6)
        ax.barh(
            place,
            (far - near) / width,
            left=(near - low) / width,
            color=ABOVE,
            edgecolor="black",
            height=0.6,
        )
        for threshold in each.found:
            if not reached or threshold.reached:
                x = (threshold.value - low) / width
                style = ":" if threshold.touch else "-"
                ax.plot([x, x], [place - 0.3, place + 0.3], style, color=LINE, linewidth=1)
        ax.plot((float(each.parameter.value) - low) / width, place, "D", color=LINE, markersize=4)
        ax.text(-0.01, place + 0.42, f"{low:.3g}", ha="left", va="center", fontsize=7)
        ax.text(1.01, place + 0.42, f"{high:.3g}", ha="right", va="center", fontsize=7)
    ax.set_yticks(
        range(len(found)), [f"{name} ({unit_of(t.parameter)})" for name, t in found.items()]
    )
    ax.set(xticks=[], xlim=(-0.02, 1.02), ylim=(len(found) - 0.4, -0.6))
    ax.set_xlabel("blue: the optimal policy stays; bar: an optimal action changes; diamond: today")
    return ax


@plain_text
def plot_two_way(found: TwoWay, *, state: int | None = None, ax: Axes | None = None) -> Axes:
    """Draw which policy is optimal over two parameters, or which action in one state.

    Colours of policies have no order; a number stands in each region's first point.
    """
    ax = axes_or_new(ax)
    x, y = found.x_values, found.y_values
    if state is None:
        shown = found.policy
        count = int(shown.max()) + 1
        shades = np.linspace(1.0, 0.35, count)[np.argsort(np.arange(count) % 2, kind="stable")]
        colours = [str(shade) for shade in shades]
        names = [str(number) for number in range(count)]
        legend = None
    else:
        shown = found.actions_at(state)
        styles = action_styles(found.mdp.actions)
        colours, names = [s.fill for s in styles], [s.short for s in styles]
        legend = [
            Patch(facecolor=s.fill, edgecolor="black", label=f"{s.short} {s.name}")
            for number, s in enumerate(styles)
            if (shown == number).any()
        ]
    grid = np.array([to_rgb(colour) for colour in colours])[shown]
    colour_map = ListedColormap(colours)
    ax.pcolormesh(
        x, y, shown, cmap=colour_map, vmin=-0.5, vmax=len(colours) - 0.5, shading="nearest"
    )
    for number in np.unique(shown).tolist():
        row, column = np.argwhere(shown == number)[0]
        ink = "black" if grid[row, column].mean() > 0.5 else "white"
        ax.text(x[column], y[row], names[number], ha="center", va="center", color=ink, fontsize=7)
    ax.plot(float(found.x.value), float(found.y.value), "D", color=LINE, markersize=5)
    ax.set_xlabel(f"{found.x.name} ({unit_of(found.x)})")
    ax.set_ylabel(f"{found.y.name} ({unit_of(found.y)})")
    if legend:
        ax.legend(handles=legend, loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False)
    else:
        ax.set_title("policies that are optimal, by number; diamond: today")
    return ax


RADIUS = {
    "interval": "radius: each transition probability p (1 ± x)",
    "absolute": "radius: each transition probability p ± x",
    "l1": "radius: L1 distance of each row",
    "kl": "radius: KL(p‖q) of each row (nats)",
    "entropy": "radius: KL(q‖p) of each row (nats)",
}


@plain_text
def plot_robust_curve(curve: RobustCurve, *, ax: Axes | None = None) -> Axes:
    """Draw the start value of both policies against the radius: tables right, and worst case.

    The distance of the upper lines is the price of robustness, that of the lower ones the gain.
    """
    ax = axes_or_new(ax)
    radii = [radius for radius, _ in curve.points]
    found = [each for _, each in curve.points]
    lines = (
        ("robust policy, tables right", [each.robust_value.value for each in found], "-", "s", "0"),
        ("nominal policy, tables right", [each.value.value for each in found], "--", "s", "0.55"),
        ("robust policy, worst case", [each.robust.start.value for each in found], "-", "o", "0"),
        ("nominal policy, worst case", [each.worst.value for each in found], "--", "o", "0.55"),
    )
    for label, values, line, marker, shade in lines:
        ax.plot(
            radii,
            values,
            line,
            marker=marker,
            markersize=4,
            markerfacecolor="white" if shade != "0" else shade,
            color=shade,
            label=label,
        )
    ax.set_xlabel(RADIUS[curve.kind])
    ax.set_ylabel("start value (reward)")
    ax.legend(frameon=False)
    return ax
