"""Figures of varied parameters: tornado, curves, thresholds, indices, draws.

`output` is "optimal", the value with the policy re-optimised, "fixed", the value with the policy
held fixed, or "regret", the difference of the two; `most` is the number of bars.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap

from exact_mdp.analysis.plots.style import (
    BLACK,
    BLUE,
    HIGH,
    INK,
    LOW,
    Look,
    add_bar,
    add_bars,
    add_lines,
    apply_style,
    axes_or_new,
    choose_line_style,
    label_axes,
    make_swatch,
    name_rows,
)
from exact_mdp.analysis.vary.economics import WTP, CostEffectiveness, parse_price
from exact_mdp.analysis.vary.intervals import tolerances_of
from exact_mdp.analysis.vary.ranges import unit_of
from exact_mdp.mdp.errors import ModelError, require_known_name
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.solvers.arguments import OfCriterion

if TYPE_CHECKING:
    from exact_mdp.analysis.vary.curves.curve import ValueFunction
    from exact_mdp.analysis.vary.curves.gradient import Gradient
    from exact_mdp.analysis.vary.curves.thresholds import Thresholds
    from exact_mdp.analysis.vary.one_way import Curve, Tornado, TwoWay
    from exact_mdp.analysis.vary.psa import PSA
    from exact_mdp.analysis.vary.sobol import Sobol

OUTPUT = {
    "optimal": "value at the start, policy re-optimised",
    "fixed": "value at the start, policy held fixed",
    "regret": "regret of the policy held fixed",
    "difference": "value at the start, one policy less the other",
}
INKS = (BLACK, *INK)
WIDE: Look = {"color": "0.8", "linewidth": 7, "solid_capstyle": "butt"}


def _describe_output(output: str, *, average: bool) -> str:
    """Return the label of an output, which is a total or an average reward."""
    if average:
        return OUTPUT[output].replace("value at the start", "average reward")
    return OUTPUT[output]


def _label_values(output: str, result: OfCriterion, claim: str = "") -> str:
    """Return the label of an axis of values, with their unit and perhaps their claim."""
    average = bool(result.criterion_facts)
    unit = "reward"
    if average:
        unit = "reward per step"
    return f"{_describe_output(output, average=average)} ({unit}{claim})"


def _with_range(name: str, low: float | Fraction, high: float | Fraction) -> str:
    return f"{name} [{_format_short_number(low)}, {_format_short_number(high)}]"


def _format_short_number(value: float | Fraction) -> str:
    """Return a number in three digits, or a whole one without an exponent."""
    number = float(value)
    return f"{number:,.0f}" if 1000 <= abs(number) < 1e9 else f"{number:.3g}"


def _format_shown_count(shown: int, every: int, what: str = "parameters") -> str:
    """Return the addition to a title if not all are shown."""
    if shown < every:
        return f", {shown} of {every} {what}"
    return ""


def _label_axis(parameter: Parameter) -> str:
    unit = unit_of(parameter)
    return parameter.name if unit == "number" else f"{parameter.name} ({unit})"


@apply_style
def plot_gradient(gradient: Gradient, *, most: int = 15, ax: Axes | None = None) -> Axes:
    """Draw the largest elasticities: per cent of the start value for a per cent of a parameter.

    Fills say where the value goes: a positive elasticity of a negative value lowers it.
    """
    every = gradient.frame().dropna(subset="elasticity (% per %)")
    table = every.head(most)
    looks = [HIGH if slope > 0 else LOW for slope in table["derivative (reward per unit)"]]
    drawn = zip(range(len(table)), table["elasticity (% per %)"], looks, strict=True)
    return label_axes(
        add_bars(ax, table["parameter"].tolist(), drawn),
        f"Which parameters move the value most{_format_shown_count(len(table), len(every))}",
        gradient.model,
        x=f"elasticity of the {gradient.measure} at the start (% per %)",
        handles=[make_swatch("raises the value", HIGH), make_swatch("lowers the value", LOW)],
        legend="a higher parameter",
    )


@apply_style
def plot_tornado(
    tornado: Tornado, *, most: int = 15, output: str | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the widest bars: white where the parameter is at its low end, blue at its high end.

    `output` is "optimal", "fixed", "regret", or "difference" from another policy. By default it is
    the last if there is one, and "fixed" if the policy held fixed is not optimal today.
    """
    today = tornado.today
    if output is None and tornado.compares:
        output = "difference"
    elif output is None:
        output = "fixed" if today["regret"].value > today["regret"].error else "optimal"
    require_known_name(output, today, "output", "output")
    # Bars reach from today's value to the values at both ends, the widest bars first.
    middle = today[output].value
    column = {"optimal": "value", "fixed": "fixed_value"}.get(output, output)
    swing = {"optimal": "swing", "fixed": "fixed_swing", "regret": "regret"}
    table = tornado.frame(swing.get(output, "difference_swing"))
    reach = table[[f"{column}_low", f"{column}_high"]].to_numpy()[:most] - middle
    rows = table[["parameter", "low", "high"]].head(most)
    names = [_with_range(*row) for row in rows.itertuples(index=False)]
    # The wider of two ends is drawn first, so that the other stays visible.
    drawn = []
    for row, both in enumerate(reach):
        ends = zip(both, (LOW, HIGH), strict=True)
        for end, look in sorted(ends, key=lambda each: -abs(each[0])):
            drawn.append((row, end, look))
    what = output if output in ("regret", "difference") else tornado.table.measure
    return label_axes(
        add_bars(ax, names, drawn, middle),
        f"Tornado: the {what} at both ends of each range"
        f"{_format_shown_count(len(rows), len(table))}",
        tornado.model,
        x=_label_values(output, tornado.table),
        handles=[make_swatch("at the low end", LOW), make_swatch("at the high end", HIGH)],
    )


@apply_style
def plot_value_curves(curve: Curve, *, ax: Axes | None = None) -> Axes:
    """Draw the start value along a parameter, the policy re-optimised and held fixed."""
    ax, at = axes_or_new(ax), curve.table.points[:, 0].astype(float)
    best, own = (at, curve.table.optimal), (at, curve.table.fixed[:, 0])
    add_lines(ax, {"policy re-optimised": best, "policy held fixed": own}, inks=[BLACK])
    _mark_today(ax, float(curve.parameter.value), at.min(), at.max())
    said = _label_values("optimal", curve.table).replace(", policy re-optimised", "")
    title = f"The {curve.table.measure} along {curve.parameter.name}"
    return label_axes(ax, title, curve.model, x=_label_axis(curve.parameter), y=said)


def _mark_today(ax: Axes, today: float, low: float | Fraction, high: float | Fraction) -> None:
    """Draw a line at today's value, or say that it lies outside the curve."""
    if low <= today <= high:
        ax.axvline(today, color="0.6", linewidth=0.8, label="today")
    else:
        ax.plot([], [], " ", label=f"today: {today:g}, outside")


@apply_style
def plot_value_function(curve: ValueFunction, *, n: int = 33, ax: Axes | None = None) -> Axes:
    """Draw the optimal start value along a parameter, piece by piece, from its exact functions.

    A dotted line is a value at which another policy becomes optimal; each piece has `n` points.
    """
    ax, name = axes_or_new(ax), curve.parameter.name
    x, best, own = list[float](), list[float](), list[float]()
    for piece in curve.pieces:
        low, high = piece.low[1], piece.high[0]
        at = [low + (high - low) * Fraction(k, n - 1) for k in range(n)]
        x += map(float, at)
        best += [float(piece.value.at(value)) for value in at]
        own += [float(piece.fixed.at(value)) for value in at] if piece.fixed is not None else []
    held = {"policy held fixed": (x, own)} if own else {}
    add_lines(ax, {"policy re-optimised": (x, best)} | held, inks=(BLACK, "0.4"))
    for number, end in enumerate(x[n::n]):
        label = None if number else "another policy becomes optimal"
        ax.axvline(end, color="0.5", linestyle=":", linewidth=1, label=label)
    drawn = np.array([*best, *own])
    # Next to discount 1, values beyond 50 times the usual one would flatten the others.
    near = drawn[np.abs(drawn) <= 50 * (float(np.median(np.abs(drawn))) or 1.0)]
    if len(near) < len(drawn):
        ax.set_ylim(near.min(), near.max())
        ax.plot([], [], " ", label=f"beyond the picture: {drawn[np.abs(drawn).argmax()]:.3g}")
    _mark_today(ax, float(curve.parameter.value), curve.range.low, curve.range.high)
    said = _label_values("optimal", curve, f"; {curve.claim}").replace(", policy re-optimised", "")
    title = f"The optimal {curve.measure} along {name}"
    return label_axes(ax, title, curve.mdp.name, x=_label_axis(curve.parameter), y=said)


@apply_style
def plot_thresholds(
    changes: Thresholds | Mapping[str, Thresholds], *, ax: Axes | None = None
) -> Axes:
    """Draw a strip for each parameter: its range, today's value, thresholds, and where it is safe.

    Ranges are drawn to the same length; numbers at their ends give the scale.

    Parameters
    ----------
    changes : Thresholds or {name: Thresholds}
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> from exact_mdp import Scenario, thresholds
    >>> small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    >>> ax = plot_thresholds(thresholds(small, "reward.anger"))
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['today', 'the optimal policy stays']
    """
    every = [*changes.values()] if isinstance(changes, Mapping) else [changes]
    names = [_label_axis(each.curve.parameter) for each in every]
    ax = axes_or_new(ax, names, high=1.2 + 0.6 * len(every))
    for place, each in enumerate(every):
        # The strip of a range, scaled to 0 … 1.
        low, high = float(each.curve.range.low), float(each.curve.range.high)
        width = (high - low) or 1.0
        near, far = ((float(end) - low) / width for end in each.stable())
        add_bar(ax, place, 1.0, LOW, height=0.6)
        stays: Look = {"color": BLUE, "left": near, "label": "the optimal policy stays"}
        add_bar(ax, place, far - near, stays, height=0.6)
        for threshold in each.found:
            x = (threshold.value - low) / width
            ends = [place - 0.3, place + 0.3]
            ax.plot([x, x], ends, "-", color=BLACK, lw=1, label="an optimal action changes")
        today = (float(each.curve.parameter.value) - low) / width
        ax.plot(today, place, "D", color=BLACK, markersize=4, label="today")
        ax.text(0, place + 0.42, _format_short_number(low), ha="left", va="center", fontsize=7)
        ax.text(1, place + 0.42, _format_short_number(high), ha="right", va="center", fontsize=7)
    name_rows(ax, names)
    ax.set(xticks=[], xlim=(-0.02, 1.02), ylim=(len(every) - 0.4, -0.6))
    handles, labels = ax.get_legend_handles_labels()
    once = [*dict(zip(labels, handles, strict=True)).values()]
    return label_axes(ax, "How far each parameter may move", every[0].curve.mdp.name, handles=once)


@apply_style
def plot_two_way(grid: TwoWay, *, ax: Axes | None = None) -> Axes:
    """Draw which policy is optimal over two parameters.

    Shades have no order; each region has a number. The legend describes the first policies by the
    actions in which they differ, or a single policy by its first actions.
    """
    ax, shown = axes_or_new(ax), grid.policy
    x, y = (np.unique(column) for column in grid.table.points.T.astype(float))
    # A legend has room for eight policies, and for four lines in an inch.
    count, room = int(shown.max()) + 1, 4 * ax.figure.bbox.height / ax.figure.dpi
    listed = [grid.list_actions(number) for number in range(min(count, 8))]
    entries = _describe_policies(listed)
    while len(listed) > 2 and "\n".join(entries).count("\n") > room:
        entries = _describe_policies(listed := listed[:-1])
    shades = np.linspace(0.95, 0.35, count)[np.argsort(np.arange(count) % 2, kind="stable")]
    looks = [{"color": str(shade), "hatch": ""} for shade in shades]
    handles = [make_swatch(*each) for each in zip(entries, looks, strict=False)]
    colours, ends = ListedColormap([*map(str, shades)]), (-0.5, count - 0.5)
    ax.pcolormesh(x, y, shown, cmap=colours, vmin=ends[0], vmax=ends[1], shading="nearest")
    for number in np.unique(shown).tolist():
        places = np.argwhere(shown == number)
        row, column = places[len(places) // 3]  # the middle may be today's
        ink = "black" if shades[number] > 0.5 else "white"
        ax.text(x[column], y[row], str(number), ha="center", va="center", color=ink, fontsize=7)
    today = (float(grid.x.value), float(grid.y.value))
    (mark,) = ax.plot(*today, "D", color=BLACK, markersize=5, label="today")
    names = {"x": _label_axis(grid.x), "y": _label_axis(grid.y)}
    legend = ""
    if count > 1:
        legend = "how the policies differ"
    if count > len(listed):
        legend += f" ({len(listed)} of {count})"
    what = "Which policy is optimal"
    return label_axes(ax, what, grid.mdp.name, handles=[*handles, mark], legend=legend, **names)


def _describe_policies(listed: Sequence[Mapping[str, str]]) -> list[str]:
    """Describe each policy by what no other one does; a single policy by its first actions."""
    entries = []
    for number, own in enumerate(listed):
        states, others = list[str](), [each for each in listed if each is not own]
        while others:
            apart = {}
            for state in own:
                apart[state] = sum(each.get(state) != own[state] for each in others)
            states.append(max(apart, key=apart.__getitem__))
            others = [each for each in others if each.get(states[-1]) == own[states[-1]]]
        said = [f"{state}: {own[state]}" for state in states or [*own][:3]]
        if not states and len(own) > len(said):
            said.append("…")
        entries.append(fill(f"policy {number}: {'; '.join(said)}", 36))
    return entries


@apply_style
def plot_sobol(
    indices: Sobol, *, output: str = "optimal", most: int = 12, ax: Axes | None = None
) -> Axes:
    """Draw first-order and total indices of the parameters that weigh most, with intervals.

    Raises ModelError if the output does not vary, and has no indices.
    """
    each = indices.of(output)
    said = _describe_output(output, average=bool(indices.criterion_facts))
    if each.constant:
        raise ModelError(
            f"the {said} is the same at every draw",
            where="plot_sobol",
            fix="draw another output, or state wider ranges",
        )
    order = np.argsort(-each.total, kind="stable")[:most]
    every = [_with_range(each.name, r.low, r.high) for each, r in indices.spans.items()]
    # Two bars for each parameter, with intervals: first order above, total below.
    drawn = []
    for aside, lengths, half, look in (
        (-0.19, each.first, each.first_half, HIGH),
        (0.19, each.total, each.total_half, LOW),
    ):
        for row, place in enumerate(order.tolist()):
            drawn.append(
                (row + aside, lengths[place], look | {"height": 0.38, "xerr": half[place]})
            )
    ax = add_bars(ax, [every[place] for place in order.tolist()], drawn)
    ax.set_xlim(right=max(1.0, ax.get_xlim()[1]))
    return label_axes(
        ax,
        f"Variance of the {said}{_format_shown_count(len(order), len(every))}",
        indices.model,
        x="share of the variance",
        handles=[
            make_swatch("first order: alone", HIGH),
            make_swatch("total: alone and with others", LOW),
        ],
        legend="95% intervals",
    )


# ---- draws -------------------------------------------------------------------------------------


@apply_style
def plot_acceptability(draws: PSA, *, ax: Axes | None = None) -> Axes:
    """Draw the probability that each candidate loses at most Δ, with its 95 % interval, against Δ.

    Tolerances Δ reach from 0 to the largest 99 % quantile of the candidates' regrets; the scale is
    linear up to a ten-thousandth of that, then logarithmic.
    """
    ax = axes_or_new(ax)
    at = tolerances_of([draws.regret(number) for number in range(len(draws.candidates))], 201)
    shares = {each.name: draws.acceptability(at, n) for n, each in enumerate(draws.candidates)}
    curves = {name: (at, share) for name, (share, _, _) in shares.items()}
    bands = {name: (at, low, high) for name, (_, low, high) in shares.items()}
    marker = ""
    if len(at) == 1:
        marker = "o"
    add_lines(ax, curves, bands, inks=INKS, marker=marker)
    ax.set_ylim(-0.02, 1.02)
    if len(at) > 1:
        ax.set_xscale("symlog", linthresh=at[1], linscale=0.3)
        # Labels of powers of 10 in the linear part would cover the 0.
        powers = np.arange(np.ceil(np.log10(2 * at[1])), np.log10(at[-1]) + 1e-9)
        ax.set_xticks([0.0, *10.0**powers])
        ax.minorticks_off()
        ax.xaxis.set_major_formatter("{x:g}")
        ax.set_xlim(0, at[-1])
    else:  # nothing is ever lost
        ax.set_xticks([0.0])
    unit = "reward"
    if draws.table.criterion_facts:
        unit = "reward per step"
    x, y = f"regret that is accepted, Δ ({unit})", "probability that the regret is at most Δ"
    return label_axes(ax, "How often each policy is good enough", draws.model, x=x, y=y)


@apply_style
def plot_cost_effectiveness(
    analysis: CostEffectiveness,
    *,
    wtp: float | None = None,
    show: str = "acceptability",
    reference: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw an analysis of costs and effects; a willingness to pay `wtp` is marked by a line.

    `show` is "acceptability": the curves, and the frontier as the wide grey line; "loss": the
    expected loss of each strategy, of which the least is the value of perfect information; or
    "plane": the draws compared with the `reference`, by default the first strategy, with the
    ellipse of a normal distribution that holds 95 %.
    """
    require_known_name(show, ("acceptability", "loss", "plane"), "picture", "show")
    ax = axes_or_new(ax)
    marked = None if wtp is None else parse_price(wtp)
    if show == "plane":
        return _draw_plane(analysis, reference, marked, ax)
    if reference is not None:
        fix = "leave it out, or show the plane"
        raise ModelError("only the plane has a reference", where="reference", fix=fix)
    at = analysis.grid()
    if marked is not None:
        at = np.union1d(at, np.linspace(0, 1.1 * marked, len(at)))
    ax.xaxis.set_major_formatter("{x:,.10g}")
    effect, cost = analysis.components
    x = f"{WTP} ({cost} per {effect})"
    if show == "loss":
        benefits = analysis.net_benefit(at)
        losses = (benefits.max(axis=2, keepdims=True) - benefits).mean(axis=1).T
        ax.plot(at, losses.min(axis=0), label="EVPI", **WIDE)
        curves = zip(analysis.strategies, losses, strict=True)
        add_lines(ax, {name: (at, loss) for name, loss in curves}, inks=INKS)
        _mark_price(ax, marked)
        ax.set_ylim(bottom=0)
        ax.yaxis.set_major_formatter("{x:,.10g}")
        return label_axes(ax, "Expected loss", x=x, y=f"mean loss against the best ({cost})")
    frontier = [share for _, share in analysis.frontier(at)]
    ax.plot(at, frontier, label="frontier", **WIDE)
    shares = zip(analysis.strategies, analysis.acceptability(at).T, strict=True)
    add_lines(ax, {name: (at, share) for name, share in shares}, inks=INKS)
    _mark_price(ax, marked)
    ax.set_ylim(-0.02, 1.02)
    y = "share of draws in which it is the best"
    return label_axes(ax, "Cost-effectiveness acceptability curves", x=x, y=y)


def _mark_price(ax: Axes, wtp: float | None) -> None:
    """Mark a willingness to pay, if there is one, by an upright line."""
    if wtp is not None:
        ax.axvline(wtp, color="0.5", linewidth=1, label=f"{WTP} {wtp:,.10g}")


def _draw_plane(
    analysis: CostEffectiveness, reference: str | None, wtp: float | None, ax: Axes
) -> Axes:
    """Plot the draws of each strategy, relative to the reference."""
    names = analysis.strategies
    one = 0
    if reference is not None:
        one = names.index(require_known_name(reference, names, "strategy", "reference"))
    effects = analysis.effect - analysis.effect[:, [one]]
    costs = analysis.cost - analysis.cost[:, [one]]
    turn = np.linspace(0, 2 * np.pi, 100)
    circle = np.sqrt(-2 * np.log(0.05)) * np.stack([np.cos(turn), np.sin(turn)])
    for number, name in enumerate(names):
        if number == one:
            continue
        look = choose_line_style(number, INKS)
        x, y = effects[:, number], costs[:, number]
        ax.scatter(x, y, s=6, color=look["color"], alpha=0.3, linewidth=0)
        ax.plot(x.mean(), y.mean(), "o", color=look["color"], markeredgecolor="black", label=name)
        if len(x) > 2:
            # The root of the covariance takes a circle to the ellipse.
            values, axes = np.linalg.eigh(np.cov(x, y))
            ring = axes @ (np.sqrt(np.maximum(values, 0))[:, None] * circle)
            ax.plot(x.mean() + ring[0], y.mean() + ring[1], **look)
    if wtp is not None:
        ax.axline((0, 0), slope=wtp, color="0.5", linewidth=1, label=f"{WTP} {wtp:,.10g}")
    ax.axhline(0, color="0.8", linewidth=0.8, zorder=0)
    ax.axvline(0, color="0.8", linewidth=0.8, zorder=0)
    ax.yaxis.set_major_formatter("{x:,.10g}")
    effect, cost = analysis.components
    x_words, y_words = (f"{word} more than {names[one]}" for word in (effect, cost))
    title = "Cost-effectiveness plane"
    if len(effects) > 2:
        title += ", ellipses of 95 %"
    return label_axes(ax, title, x=x_words, y=y_words)


@apply_style
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
    # 32 rows are two for each status.
    ax, labels = axes_or_new(ax), draws.labels[:32]
    share = draws.probability_optimal()[0][: len(labels)]
    # Cells, not one image: it stays sharp at any size.
    ax.pcolormesh(share, vmin=0, vmax=1, cmap="Greys", edgecolors="0.9", linewidth=0.3)
    for (row, column), value in np.ndenumerate(share):
        look: Look = {"color": "white" if value > 0.59 else BLACK, "fontsize": 7}
        ax.text(column + 0.5, row + 0.5, _format_share(value), ha="center", va="center", **look)
    ax.set_xticks(np.arange(len(draws.actions)) + 0.5, draws.actions)
    ax.set_yticks(np.arange(len(share)) + 0.5, labels)
    ax.tick_params(length=0)
    ax.invert_yaxis()
    y = "status at subtask 0, trial 0" if draws.compiled else "state"
    more = _format_shown_count(len(share), len(draws.labels), "states")
    what = f"Share of draws in which each action is optimal{more}"
    return label_axes(ax, what, draws.model, x="action", y=y)


def _format_share(value: float) -> str:
    if value in (0, 1):
        return "1" if value else ""
    return "<.01" if value < 0.01 else ">.99" if value > 0.99 else f"{value:.2f}".lstrip("0")
