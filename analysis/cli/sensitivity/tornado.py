"""What `exact-mdp sensitivity MODEL tornado` tells."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from exact_mdp.analysis.cli.render import Grid, number
from exact_mdp.analysis.cli.sensitivity.options import (
    SHOWN,
    Report,
    model_of,
    not_empty,
    policy_from,
    ranges_from,
)
from exact_mdp.analysis.sensitivity.one_way import Bar, tornado
from exact_mdp.analysis.sensitivity.ranges import unit_of

if TYPE_CHECKING:
    from exact_mdp.mdp.io.load import Loaded


def tornado_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return values and regrets at the ends of every range."""
    model = model_of(loaded)
    ranges, without = not_empty(ranges_from(model, options))
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
        "without_range": without,
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
