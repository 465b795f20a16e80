"""What the kinds sobol and morris of `exact-mdp sensitivity` have in common.

What `exact-mdp sensitivity MODEL sobol` tells.

What `exact-mdp sensitivity MODEL morris` tells.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.analysis.cli.options import whole_of
from exact_mdp.analysis.cli.render import Grid, number
from exact_mdp.analysis.cli.sensitivity.options import (
    SHOWN,
    Report,
    model_of,
    not_empty,
    policy_from,
    ranges_from,
    work_from,
    written,
)
from exact_mdp.analysis.sensitivity.draws.global_ import (
    Effects,
    Indices,
    Morris,
    Sobol,
    morris,
    sobol,
)
from exact_mdp.analysis.sensitivity.ranges import usual
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.parametric import DISCOUNT
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers import solve

if TYPE_CHECKING:
    from exact_mdp.mdp.io.load import Loaded


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
        "rng": whole_of(options["seed"], "--seed", most=2**128),
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


def sobol_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return Sobol indices of the optimum's value and of a policy's regret."""
    samples = whole_of(options["samples"] or "1024", "--samples", 2, 2**24)
    names, ranges, without = drawn_from(loaded, options)
    found = sobol(
        model_of(loaded), names=names, ranges=ranges, n=samples, **how_from(loaded, options)
    )
    result = head_of(loaded, options, found) | {
        "samples": found.n,
        **_indices(found, found.optimal),
        "regret": _indices(found, found.regret),
        "without_range": without,
    }
    grids = []
    for output, title in DRAWN.items():
        each = getattr(found, output)
        if each.constant:
            continue
        order = np.argsort(-each.total, kind="stable")[:SHOWN]
        rows = [
            (
                found.names[i],
                f"{each.first[i]:.4f}",
                f"± {each.first_half[i]:.4f}",
                f"{each.total[i]:.4f}",
                f"± {each.total_half[i]:.4f}",
            )
            for i in order.tolist()
        ]
        grids.append(
            Grid(
                title=f"shares of the variance {title}",
                headings=("parameter", "first order", "", "total", ""),
                rows=rows,
                numeric=frozenset({1, 2, 3, 4}),
            )
        )
    facts = facts_of(result, options) | {
        "drawn value": f"{found.optimal.mean:.6g}, sd {found.optimal.sd:.4g} (estimated)",
        "drawn regret": f"{found.regret.mean:.6g}, sd {found.regret.sd:.4g} (estimated)"
        if not found.regret.constant
        else f"{found.regret.mean:.6g} at every draw, up to rounding",
    }
    noisy = {name for each in (found.optimal, found.regret) for name in _noisy(found, each)}
    if noisy:
        facts["first order above total"] = (
            f"for {len(noisy)} of {len(found.names)}, within the intervals: estimator noise; "
            "more --samples help"
        )
    return written(loaded, options, result, "sobol"), facts, grids


def _noisy(found: Sobol, each: Indices) -> list[str]:
    """Return the parameters whose first order exceeds the total by no more than the intervals."""
    if each.constant:
        return []
    over = each.first - each.total
    within = (over > 0) & (over <= each.first_half + each.total_half)
    return [name for name, one in zip(found.names, within.tolist(), strict=True) if one]


def _indices(found: Sobol, each: Indices) -> dict[str, Any]:
    return {
        "mean": each.mean,
        "sd": each.sd,
        "first_order": by_name(found, each.first),
        "first_order_interval": intervals(found, each.first, each.first_half),
        "total": by_name(found, each.total),
        "total_interval": intervals(found, each.total, each.total_half),
    }


def morris_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return elementary effects on the optimum's value and on a policy's regret."""
    trajectories = whole_of(options["samples"] or "64", "--samples", 2, 10**7)
    names, ranges, without = drawn_from(loaded, options)
    found = morris(
        model_of(loaded),
        names=names,
        ranges=ranges,
        n=trajectories,
        **how_from(loaded, options),
    )
    result = head_of(loaded, options, found) | {
        "trajectories": found.n,
        "levels": found.levels,
        **_effects(found, found.optimal),
        "regret": _effects(found, found.regret),
        "without_range": without,
    }
    grids = []
    for output, title in DRAWN.items():
        each = getattr(found, output)
        if not each.mu_star.any():
            continue
        order = np.argsort(-each.mu_star, kind="stable")[:SHOWN]
        rows = [
            (
                found.names[i],
                f"{each.mu[i]:.4g}",
                f"{each.mu_star[i]:.4g}",
                f"± {each.mu_star_half[i]:.2g}",
                f"{each.sigma[i]:.4g}",
                f"± {each.sigma_half[i]:.2g}",
            )
            for i in order.tolist()
        ]
        grids.append(
            Grid(
                title=f"elementary effects {title.replace('of', 'on', 1)}; reward for the range",
                headings=("parameter", "μ", "μ*", "", "σ", ""),
                rows=rows,
                numeric=frozenset({1, 2, 3, 4, 5}),
            )
        )
    facts = facts_of(result, options)
    if not found.regret.mu_star.any():
        facts["regret"] = "0 at every draw"
    return written(loaded, options, result, "morris"), facts, grids


def _effects(found: Morris, each: Effects) -> dict[str, Any]:
    return {
        "mu": by_name(found, each.mu),
        "mu_star": by_name(found, each.mu_star),
        "mu_star_interval": intervals(found, each.mu_star, each.mu_star_half),
        "sigma": by_name(found, each.sigma),
        "sigma_interval": intervals(found, each.sigma, each.sigma_half),
    }
