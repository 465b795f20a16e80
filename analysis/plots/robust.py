"""Figures of the robust analysis: values against the radius of the sets."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.axes import Axes

from analysis.plots.style import axes_or_new, plain_text

if TYPE_CHECKING:
    from analysis.sensitivity.robust_result import RobustCurve

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
