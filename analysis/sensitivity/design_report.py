"""What the kinds sobol and morris of `exact-mdp sensitivity` have in common."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from analysis.cli_common import whole_of
from analysis.cli_output import number
from analysis.sensitivity.morris import Morris
from analysis.sensitivity.ranges import usual
from analysis.sensitivity.report_options import (
    model_of,
    not_empty,
    policy_from,
    ranges_from,
    work_from,
)
from analysis.sensitivity.sobol import Sobol
from mdp.errors import ModelError
from mdp.parametric import DISCOUNT
from mdp.table import Floats
from solvers import solve

if TYPE_CHECKING:
    from mdp.load import Loaded

DRAWN = {
    "optimal": "of the start value, policy re-optimised",
    "regret": "of the regret of the policy held fixed",
}


def drawn_from(
    loaded: Loaded, options: Mapping[str, Any]
) -> tuple[list[str], dict[str, Any], list[str]]:
    """Return the names that are drawn, their ranges, and the names that have none."""
    model = model_of(loaded)
    spans = ranges_from(model, options)
    if not (options["parameters"] or options["ranges"] or options["range_file"]):
        spans = {name: spans[name] for name in usual(model)}
    ranges, without = not_empty(spans)
    if not ranges:
        raise ModelError(
            "every parameter asked for is 0, and 0 ± a share of it is no range",
            where=f"sensitivity of {loaded.name}",
            fix="state one: --range NAME=LOW:HIGH",
        )
    return list(ranges), ranges, without


def how_from(loaded: Loaded, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return where the work is done, the policy held fixed and the seed, from the options."""
    return work_from(options) | {
        "policy": policy_from(loaded, options),
        "seed": whole_of(options["seed"], "--seed", most=2**128),
    }


def head_of(loaded: Loaded, options: Mapping[str, Any], found: Sobol | Morris) -> dict[str, Any]:
    """Return the beginning of the result."""
    start = solve(loaded.mdp).start
    return {
        "start_value": start.value,
        "error_bound": start.error,
        "claim": "estimated",
        "policy": options["policy"],
        "draws": found.draws,
        "seed": found.seed,
        "confidence": found.confidence,
        "ranges": {name: [float(r.low), float(r.high)] for name, r in found.ranges.items()},
    }


def facts_of(result: Mapping[str, Any], options: Mapping[str, Any]) -> dict[str, str]:
    """Return the facts of a result."""
    facts = {
        "start value": f"{number(result['start_value'], result['error_bound'])} (bounded)",
        "policy held fixed": options["policy"],
        "draws": f"{result['draws']:,}, seed {result['seed']}",
        "intervals": f"± half a {result['confidence']:.0%} interval (bootstrap)",
    }
    if result["without_range"]:
        facts["zero today, without range"] = ", ".join(result["without_range"])
    if DISCOUNT not in result["ranges"]:
        facts["discount"] = "held; vary it with --parameter discount or --range discount=LOW:HIGH"
    return facts


def intervals(found: Sobol | Morris, middle: Floats, half: Floats) -> dict[str, list[float]]:
    """Return the ends of each parameter's interval."""
    ends = zip(found.names, (middle - half).tolist(), (middle + half).tolist(), strict=True)
    return {name: [low, high] for name, low, high in ends}


def by_name(found: Sobol | Morris, numbers: Floats) -> dict[str, float]:
    """Return each parameter's number."""
    return dict(zip(found.names, numbers.tolist(), strict=True))
