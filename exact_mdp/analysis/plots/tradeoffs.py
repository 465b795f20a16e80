"""The front of two totals, and of the mean and the worst episodes, with policies beside it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes

from exact_mdp.analysis.plots.style import BLACK, BLUE, INK, MARKS, axes_or_new, described, picture
from exact_mdp.analysis.tradeoffs.front import Front
from exact_mdp.analysis.tradeoffs.risk import MeanCVaR
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.policies.policy import PolicyLike

NEAR = 0.02  # of an axis: marks that are nearer lie on each other


@picture
def draw_front(
    front: Front, *, policies: Mapping[str, PolicyLike] | None = None, ax: Axes | None = None
) -> Axes:
    """Draw a front of two totals, and policies by name with their distance from it."""
    if len(front.names) != 2:
        raise ModelError(
            "a front of three totals has no flat picture", where="plot", fix="name two totals"
        )
    ax = axes_or_new(ax)
    across, up = ([float(value) for value in own] for own in zip(*front.vertices, strict=True))
    ax.plot(across, up, color=BLUE, marker="o", markersize=4, label="front", zorder=2)
    at = {name: tuple(map(float, front.totals(p))) for name, p in (policies or {}).items()}
    wide, high = (
        max(own) - min(own) or 1.0
        for own in ([*across, *(x for x, _ in at.values())], [*up, *(y for _, y in at.values())])
    )
    for number, (name, policy) in enumerate((policies or {}).items()):
        x, y = at[name]
        far = float(front.distance(policy))
        label = f"{name} (on the front)" if far == 0 else f"{name} (distance {far:.3g})"
        mark, ink = MARKS[1 + number % (len(MARKS) - 1)], INK[number % len(INK)]
        # One that lies on others is an open mark around them.
        below = sum(
            abs(x - a) < NEAR * wide and abs(y - b) < NEAR * high
            for a, b in list(at.values())[:number]
        )
        form: dict[str, Any] = {"ms": 7 + 5 * below, "fillstyle": "none" if below else "full"}
        ax.plot([x], [y], linestyle="", marker=mark, color=ink, label=label, zorder=3, **form)
        if far:
            sign = front.of.sign * far
            ax.plot([x, x + sign], [y, y + sign], color=BLACK, linewidth=0.8, linestyle=":")
    first, second = front.names
    names = {"x": f"expected total of {first}", "y": f"expected total of {second}"}
    return described(ax, f"The front of {second} against {first}", **names)


@picture
def plot_mean_cvar(points: MeanCVaR, *, ax: Axes | None = None) -> Axes:
    """Draw the mean against the mean of the worst episodes: best policies, and given ones."""
    ax = axes_or_new(ax)
    across = [float(each.mean) for each in points.optima]
    up = [float(each.value) for each in points.optima]
    ax.plot(
        across,
        up,
        linestyle="",
        color=BLUE,
        marker="o",
        label="best for a weight of the mean\n(written beside it)",
    )
    weights = dict[tuple[float, float], list[str]]()
    for point, best in zip(zip(across, up, strict=True), points.optima, strict=True):
        weights.setdefault(point, []).append(f"{float(best.weight):.3g}")
    for point, own in weights.items():
        words = own[0] if len(own) == 1 else f"{own[0]} to {own[-1]}"
        left = point[0] < (min(across) + max(across)) / 2
        aside, side = ((4, -12), "left") if left else ((-4, -12), "right")
        ax.annotate(words, point, textcoords="offset points", xytext=aside, ha=side)
    for number, (name, (mean, value)) in enumerate(points.policies.items()):
        mark, ink = MARKS[1 + number % (len(MARKS) - 1)], INK[number % len(INK)]
        ax.plot([float(mean)], [float(value)], linestyle="", marker=mark, color=ink, label=name)
    what = "return" if points.mdp.sense == "max" else "cost"
    return described(
        ax,
        "The mean against the worst episodes",
        points.mdp.name,
        x=f"mean {what} of all episodes",
        y=f"mean {what} of the worst {float(points.level):.3g} of them",
    )
