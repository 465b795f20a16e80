"""One parameter at a time: the kinds gradient, tornado and threshold."""

from __future__ import annotations

from typing import Any

import tqdm as progress

from exact_mdp.analysis.cli.render import Report, Table, cell, claimed
from exact_mdp.analysis.cli.sensitivity.options import ROUNDED, Asked, analysis
from exact_mdp.analysis.vary.curves.gradient import Derivative, gradient
from exact_mdp.analysis.vary.curves.thresholds import Threshold, Thresholds, thresholds
from exact_mdp.analysis.vary.curves.walk import optimum
from exact_mdp.analysis.vary.one_way import Bar, tornado
from exact_mdp.analysis.vary.ranges import unit_of
from exact_mdp.solvers.solution import Bounded, Certified, Claim

# ---- derivatives -------------------------------------------------------------------------------


@analysis("gradient")
def gradient_report(asked: Asked) -> Report:
    """Return derivatives of the start value."""
    found = gradient(asked.model, policy=asked.policy, names=asked["parameters"])
    each, policy = found.derivatives, "re-optimised" if found.reoptimised else "fixed"
    exact = {n: d.value.value if isinstance(d.value, Certified) else None for n, d in each.items()}
    result = {
        "start_value": float(found.start_value),
        "claim": found.start.claim,
        "policy": policy,
        "derivatives": {name: _float(d.value) for name, d in each.items()},
        "left": {name: _float(d.left) for name, d in each.items()},
        "right": {name: _float(d.right) for name, d in each.items()},
        "elasticities": {name: d.elasticity for name, d in each.items()},
        "exact_derivatives": exact,
        "error_bounds": {name: _error(d) for name, d in each.items()},
        "steps": {
            name: {"one_less": _float(less), "one_more": _float(more)}
            for name, (less, more) in found.steps.items()
        },
    }
    facts: dict[str, Any] = {"start value": found.start, "policy": policy}
    if asked["perception"] is not None:
        result["claim_of"] = facts["claim"] = ROUNDED
    for name, (less, more) in found.steps.items():
        last = "" if less is None else f"the last unit adds {float(less.value):+.6g}, "
        facts[name] = f"{last}one more would add {float(more.value):+.6g}"
    held = "re-optimised" if found.reoptimised else "held fixed"
    table = Table(
        title=f"derivatives of the start value, per unit of the parameter (policy {held})",
        rows=sorted(each.values(), key=lambda d: -abs(d.elasticity or 0.0)),
        columns={
            "parameter": lambda d: d.parameter.name,
            "today": lambda d: float(d.parameter.value),
            "derivative": (
                lambda d: d.value or f"{cell(d.left, '.6g')} | {cell(d.right, '.6g')}",
                ".6g",
            ),
            "elasticity": (lambda d: d.elasticity, ".4g"),
        },
    )
    return Report(result=result, facts=facts, tables=[table])


def _float(number: Any) -> float | None:
    return None if number is None else float(number.value)


def _error(each: Derivative) -> float:
    """Return the larger error bound of both sides; 0 for exact ones."""
    sides = (each.left, each.right)
    return max((side.error for side in sides if isinstance(side, Bounded)), default=0.0)


# ---- both ends of each range -------------------------------------------------------------------


@analysis("tornado")
def tornado_report(asked: Asked) -> Report:
    """Return values and regrets at the ends of every range."""
    ranges, without = asked.ranges()
    found = tornado(asked.model, policy=asked.policy, names=list(ranges), ranges=ranges)
    today, bars = found.today, [_bar(bar) for bar in found.bars]
    seen = asked["perception"] is not None
    if seen:  # the question is what the perception does to the policy, not to the optimum
        bars.sort(key=lambda bar: -bar["fixed_swing"])
    result = claimed("start_value", today.optimal) | {
        "policy": asked.form,
        "policy_value": today.fixed.value,
        "regret": today.regret.value,
        "bars": bars,
        "without_range": without,
    }
    facts = {
        "start value": today.optimal,
        "policy held fixed": asked.form,
        "its value": today.fixed,
        "its regret": today.regret,
        "zero today, without range": without or None,
    }
    value = "fixed_value" if seen else "value"
    title = "start value at both ends, policy re-optimised; regret of the policy held fixed"
    if seen:
        title = (
            "start value at both ends of the policy held fixed, on what it perceives; its regret"
        )
    ends = {"parameter": "parameter", "from": "low:.6g", "to": "high:.6g"}
    at = {"at low": f"{value}_low:.6g", "at high": f"{value}_high:.6g"}
    tables = [
        Table(
            title=title,
            rows=bars,
            columns=ends | at | {"regret": "regret:.3g"},
        )
    ]
    if seen or asked.form != "optimal":
        # A policy that is not today's optimum has a tornado of its own: that of its regret.
        lost = today.regret.value
        widest = sorted(
            bars, key=lambda bar: -max(abs(bar[f"regret_{end}"] - lost) for end in ("low", "high"))
        )
        at = {"at low": "regret_low:.6g", "at high": "regret_high:.6g"}
        now = f"regret of the policy held fixed at both ends; {lost:.6g} today"
        tables.append(Table(title=now, rows=widest, columns=ends | at))
    return Report(result=result, facts=facts, tables=tables)


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


# ---- where the optimum changes -----------------------------------------------------------------


@analysis("threshold")
def threshold_report(asked: Asked) -> Report:
    """Return every threshold within the ranges, and the range in which the policy stays."""
    ranges, without = asked.ranges()
    steps = progress.tqdm(ranges, desc="thresholds", disable=None, leave=False)
    found = {name: thresholds(asked.model, name, ranges) for name in steps}
    switches = [
        switch
        for name, each in found.items()
        for threshold in each.found
        for switch in _switches(name, threshold)
    ]
    start = optimum(asked.model.at({}))[1]
    result = {
        **claimed("start_value", start),
        "claim": next(
            (c for each in found.values() if (c := each.claim) != Claim.CERTIFIED), Claim.CERTIFIED
        ),
        "switches": switches,
        "stable": {name: _stable(each) for name, each in found.items()},
        "without_range": without,
    }
    tables = [
        Table(
            title="the optimal policy stays as it is, other parameters held",
            rows=[
                {"parameter": name, "thresholds": len(each.found)} | _stable(each)
                for name, each in found.items()
            ],
            columns={
                "parameter": "parameter",
                "today": "today:.6g",
                "stays from": "low:.6g",
                "to": "high:.6g",
                "searched from": (lambda row: row["searched"][0], ".4g"),
                "up to": (lambda row: row["searched"][1], ".4g"),
                "thresholds": "thresholds",
            },
            first=len(found),
        ),
        Table(
            title="optimal actions that change",
            rows=switches,
            columns={
                "parameter, state": lambda row: f"{row['parameter']}\n{row['state']}",
                "threshold": "threshold:.12g",
                "below": lambda row: " or ".join(row["before"]),
                "above": lambda row: " or ".join(row["after"]),
            },
        ),
    ]
    return Report(result=result, facts={"start value": start}, tables=tables)


def _switches(name: str, threshold: Threshold) -> list[dict[str, Any]]:
    return [
        {
            "parameter": name,
            "threshold": threshold.value,
            "low": threshold.low,
            "high": threshold.high,
            "state": switch.label,
            "columns": switch.columns,
            "before": switch.before,
            "after": switch.after,
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
