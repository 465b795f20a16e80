"""What `exact-mdp sensitivity` tells of gradient, tornado and thresholds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from analysis.cli_common import policy_of
from analysis.cli_output import Grid, number
from analysis.sensitivity.gradient import Derivative, gradient
from analysis.sensitivity.joint import joint_radius
from analysis.sensitivity.one_way import Bar, tornado
from analysis.sensitivity.ranges import Range, around, checked, load_ranges, whole
from analysis.sensitivity.thresholds import Threshold, Thresholds, thresholds
from analysis.sensitivity.units import unit_of
from mdp.errors import ModelError
from mdp.parametric import Parametric, parameter_of, parametric
from mdp.table import exact
from solvers import solve
from solvers.solution import Certified

if TYPE_CHECKING:
    from mdp.load import Loaded

Report = tuple[dict[str, Any], dict[str, str], list[Grid]]
SHOWN = 40  # rows of a table for people
ROUNDED = "of the perception, and the probabilities of actions that it makes, as rounded to floats"
"""What is certified under a perception: a file may state 1/3, which no float is."""


def gradient_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return derivatives of the start value."""
    model = model_of(loaded)
    if options["ranges"] or options["range_file"] or options["relative"] or options["whole"]:
        raise ModelError(
            "a gradient has no ranges", where="sensitivity gradient", fix="leave them out"
        )
    names = options["parameters"] or None
    found = gradient(model, policy_from(loaded, options), names=names)
    ends = {True: "re-optimised", False: "fixed"}
    result = {
        "start_value": float(found.start_value.value),
        "claim": found.start_value.claim,
        "policy": ends[found.reoptimised],
        "derivatives": {n: _value(d.value) for n, d in found.derivatives.items()},
        "left": {n: _value(d.left) for n, d in found.derivatives.items()},
        "right": {n: _value(d.right) for n, d in found.derivatives.items()},
        "elasticities": {n: d.elasticity for n, d in found.derivatives.items()},
        "exact_derivatives": {
            n: d.value.value if isinstance(d.value, Certified) else None
            for n, d in found.derivatives.items()
        },
        "error_bounds": {n: _error(d) for n, d in found.derivatives.items()},
        "steps": {
            n: {"one_less": _value(less), "one_more": _value(more)}
            for n, (less, more) in found.steps.items()
        },
    }
    ordered = sorted(found.derivatives.items(), key=lambda item: -abs(item[1].elasticity or 0.0))
    rows = [
        (
            name,
            number(float(each.parameter.value)),
            f"{_value(each.value):.6g}" if each.value else _sides(each),
            "-" if each.elasticity is None else f"{each.elasticity:.4g}",
        )
        for name, each in ordered[:SHOWN]
    ]
    grid = Grid(
        title=_title("derivatives of the start value, per unit of the parameter", found, ordered),
        headings=("parameter", "today", "derivative", "elasticity"),
        rows=rows,
        numeric=frozenset({1, 2, 3}),
    )
    claim = str(found.start_value.claim)
    if options.get("perception") is not None:
        result["claim_of"] = ROUNDED
        claim += f", {ROUNDED}"
    facts = {
        "start value": f"{number(result['start_value'])} ({claim})",
        "policy": result["policy"],
    }
    for name, (less, more) in found.steps.items():
        last = "" if less is None else f"the last one adds {float(less.value):+.6g}, "
        facts[name] = f"{last}one more adds {float(more.value):+.6g}"
    return result, facts, [grid]


def tornado_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return values and regrets at the ends of every range."""
    model = model_of(loaded)
    spans = ranges_from(model, options)
    ranges = {name: span for name, span in spans.items() if span.low < span.high}
    policy = policy_from(loaded, options)
    found = tornado(model, policy=policy, names=list(ranges), ranges=ranges)
    bars = [_bar(bar) for bar in found.bars]
    seen = options.get("perception") is not None
    if seen:  # what the perception does to the policy is what is asked, not the optimum
        bars.sort(key=lambda bar: -bar["fixed_swing"])
    result = {
        "start_value": found.today.optimal.value,
        "error_bound": found.today.optimal.error,
        "claim": "bounded",
        "policy": options["policy"],
        "policy_value": found.today.fixed.value,
        "regret": found.today.regret.value,
        "bars": bars,
        "without_range": sorted(set(spans) - set(ranges)),
    }
    headings = ("parameter", "from", "to", "at low", "at high", "regret")
    kind = "fixed_value" if seen else "value"
    rows = [
        (
            bar["parameter"],
            *(f"{bar[key]:.6g}" for key in ("low", "high", f"{kind}_low", f"{kind}_high")),
            f"{bar['regret']:.3g}",
        )
        for bar in bars[:SHOWN]
    ]
    title = "start value at both ends, policy re-optimised; regret of the policy held fixed"
    if seen:
        title = (
            "start value at both ends of the policy held fixed, on what it perceives; its regret"
        )
    numeric = frozenset(range(1, 6))
    grids = [Grid(title=title, headings=headings, rows=rows, numeric=numeric)]
    lost = found.today.regret.value
    facts = {
        "start value": f"{number(found.today.optimal.value)} (bounded)",
        "policy held fixed": f"{options['policy']}, {number(found.today.fixed.value)}",
        "its regret": f"{lost:.6g} (bounded)",
    }
    if result["without_range"]:
        facts["zero today, without range"] = ", ".join(result["without_range"])
    if seen or options["policy"] != "optimal":
        # A policy that is not today's optimum has a tornado of its own: that of its regret.
        widest = sorted(
            bars, key=lambda bar: -max(abs(bar[f"regret_{end}"] - lost) for end in ("low", "high"))
        )
        grids.append(
            Grid(
                title=f"regret of the policy held fixed at both ends; {lost:.6g} today",
                headings=("parameter", "from", "to", "at low", "at high"),
                rows=[
                    (
                        bar["parameter"],
                        *(f"{bar[k]:.6g}" for k in ("low", "high", "regret_low", "regret_high")),
                    )
                    for bar in widest[:SHOWN]
                ],
                numeric=frozenset(range(1, 5)),
            )
        )
    return result, facts, grids


def threshold_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return every threshold within the ranges, and the range in which the policy stays."""
    from tqdm import tqdm

    model = model_of(loaded)
    if options["policy"] != "optimal":
        raise ModelError(
            "thresholds are those of the optimal policy", where="--policy", fix="leave it out"
        )
    spans = ranges_from(model, options)
    ranges = {name: span for name, span in spans.items() if span.low < span.high}
    steps = tqdm(ranges.items(), desc="thresholds", disable=None, leave=False)
    found = {name: thresholds(model, name, span) for name, span in steps}
    switches = [
        switch
        for name, each in found.items()
        for threshold in each.found
        for switch in _switches(name, threshold)
    ]
    start = solve(loaded.mdp).start
    result = {
        "start_value": start.value,
        "error_bound": start.error,
        "claim": "certified",
        "switches": switches,
        "stable": {name: _stable(each) for name, each in found.items()},
        "without_range": sorted(set(spans) - set(ranges)),
    }
    facts = {"start value": f"{number(start.value, start.error)} (bounded)"}
    if loaded.scenario is not None and ranges:
        joint = joint_radius(loaded.scenario, ranges)
        result["joint"] = {
            "share": float(joint.share),
            "widths": {name: float(width) for name, width in joint.widths.items()},
            "state": joint.state,
        }
        facts["all at once"] = (
            f"the policy stays where each moves by less than {float(joint.share):.3g} of the "
            "farther end's distance (proven, not tight)"
        )
    grids = [
        Grid(
            title="the optimal policy stays as it is, other parameters held",
            headings=("parameter", "today", "from", "to", "searched", "thresholds"),
            rows=[
                (
                    name,
                    f"{float(each.parameter.value):.6g}",
                    *(f"{float(end):.6g}" for end in each.stable()),
                    f"{float(each.range.low):.4g} to {float(each.range.high):.4g}",
                    str(len(each.found)),
                )
                for name, each in found.items()
            ],
            numeric=frozenset({1, 2, 3, 5}),
        )
    ]
    if switches:
        more = f", the first {SHOWN} of {len(switches)}" if len(switches) > SHOWN else ""
        rows = [
            (
                f"{each['parameter']}\n{each['state']}",
                f"{each['threshold']:.12g}",
                " or ".join(each["before"]),
                " or ".join(each["after"]),
            )
            for each in switches[:SHOWN]
        ]
        headings = ("parameter, state", "threshold", "below", "above")
        numeric = frozenset({1})
        title = f"optimal actions that change{more}"
        grids.append(Grid(title=title, headings=headings, rows=rows, numeric=numeric))
    return result, facts, grids


def model_of(loaded: Loaded) -> Parametric:
    """Return the loaded model with its parameters."""
    return parametric(loaded.scenario if loaded.scenario is not None else loaded.mdp)


def policy_from(loaded: Loaded, options: Mapping[str, Any]) -> object:
    """Return the policy that the options name, or "optimal"."""
    form, perception = options["policy"], options.get("perception")
    if form == "optimal" and perception is None:
        return form
    return policy_of(loaded.mdp, form, perception)


def ranges_from(model: Parametric, options: Mapping[str, Any]) -> dict[str, Range]:
    """Return the range of each parameter that is asked for."""
    stated: dict[str, Range] = {}
    if options["range_file"] is not None:
        stated |= load_ranges(model, options["range_file"])
    for text in options["ranges"]:
        name, equals, ends = text.partition("=")
        low, colon, high = ends.partition(":")
        if not equals or not colon:
            raise ModelError(f"{text!r} is not a range", where="--range", fix="write NAME=LOW:HIGH")
        stated |= checked(model, {name.strip(): (low.strip(), high.strip())})
    if options["relative"] is not None and options["whole"]:
        raise ModelError("both --relative and --whole", where="options", fix="give one of them")
    names = options["parameters"] or list(stated) or [p.name for p in model.parameters]
    found = {}
    for name in names:
        parameter = parameter_of(model, name)
        if name in stated:
            found[name] = stated[name]
        elif options["whole"]:
            found[name] = whole(parameter)
        elif options["relative"] is not None:
            found[name] = around(parameter, exact(options["relative"]))
        else:
            found[name] = around(parameter)
    return found


def _bar(bar: Bar) -> dict[str, Any]:
    return {
        "parameter": bar.parameter.name,
        "unit": unit_of(bar.parameter),
        "today": float(bar.parameter.value),
        "low": float(bar.low.at),
        "high": float(bar.high.at),
        "value_low": bar.low.optimal.value,
        "value_high": bar.high.optimal.value,
        "swing": bar.swing,
        "fixed_value_low": bar.low.fixed.value,
        "fixed_value_high": bar.high.fixed.value,
        "fixed_swing": bar.fixed_swing,
        "regret_low": bar.low.regret.value,
        "regret_high": bar.high.regret.value,
        "regret": bar.regret,
    }


def _switches(name: str, threshold: Threshold) -> list[dict[str, Any]]:
    return [
        {
            "parameter": name,
            "threshold": threshold.value,
            "low": threshold.low,
            "high": threshold.high,
            "state": switch.label,
            "columns": dict(switch.columns),
            "before": list(switch.before),
            "after": list(switch.after),
            "reached": switch.reached,
            "touch": threshold.touch,
        }
        for switch in threshold.switches
    ]


def _stable(found: Thresholds) -> dict[str, Any]:
    low, high = found.stable()
    near, far = found.stable(reached=True)
    return {
        "today": float(found.parameter.value),
        "unit": unit_of(found.parameter),
        "low": float(low),
        "high": float(high),
        "low_on_reached_states": float(near),
        "high_on_reached_states": float(far),
        "radius": float(found.radius),
        "searched": [float(found.range.low), float(found.range.high)],
    }


def _value(each: Any) -> float | None:
    return None if each is None else float(each.value)


def _error(each: Derivative) -> float:
    """Return the larger error bound of both sides; 0 for exact ones."""
    return max(getattr(side, "error", 0.0) for side in (each.left, each.right) if side is not None)


def _sides(each: Derivative) -> str:
    return f"{_value(each.left):.6g} | {_value(each.right):.6g}"


def _title(text: str, found: Any, ordered: list[Any]) -> str:
    more = f", the first {SHOWN} of {len(ordered)}" if len(ordered) > SHOWN else ""
    return f"{text}{more} (policy {'re-optimised' if found.reoptimised else 'held fixed'})"
