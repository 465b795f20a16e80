"""What `exact-mdp sensitivity MODEL threshold` tells."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from exact_mdp.analysis.cli.render import Grid, number
from exact_mdp.analysis.cli.sensitivity.options import (
    SHOWN,
    Report,
    model_of,
    not_empty,
    only_first,
    ranges_from,
)
from exact_mdp.analysis.sensitivity.joint_radius import joint_radius
from exact_mdp.analysis.sensitivity.ranges import unit_of
from exact_mdp.analysis.sensitivity.thresholds import Threshold, Thresholds, thresholds
from exact_mdp.mdp.errors import ModelError
from exact_mdp.solvers import solve

if TYPE_CHECKING:
    from exact_mdp.mdp.io.load import Loaded


def threshold_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return every threshold within the ranges, and the range in which the policy stays."""
    from tqdm import tqdm

    model = model_of(loaded)
    if options["policy"] != "optimal":
        raise ModelError(
            "thresholds are those of the optimal policy", where="--policy", fix="leave it out"
        )
    ranges, without = not_empty(ranges_from(model, options))
    steps = tqdm(ranges, desc="thresholds", disable=None, leave=False)
    found = {name: thresholds(model, name, ranges) for name in steps}
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
        "without_range": without,
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
        title = f"optimal actions that change{only_first(len(switches))}"
        grids.append(Grid(title=title, headings=headings, rows=rows, numeric=numeric))
    return result, facts, grids


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
