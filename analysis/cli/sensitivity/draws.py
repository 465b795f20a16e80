"""All parameters at once, by how much of the output each decides: the kinds sobol and morris."""

from __future__ import annotations

from typing import Any

import numpy as np

from exact_mdp.analysis.cli.options import whole_of
from exact_mdp.analysis.cli.render import Column, Report, Table, claimed
from exact_mdp.analysis.cli.sensitivity.options import Asked
from exact_mdp.analysis.sensitivity.draws.global_ import (
    Effects,
    Indices,
    Morris,
    Sobol,
    morris,
    sobol,
)
from exact_mdp.analysis.sensitivity.ranges import Ranges, usual
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.parametric import DISCOUNT
from exact_mdp.solvers import solve

OUTPUTS = {
    "optimal": "the start value, policy re-optimised",
    "regret": "the regret of the policy held fixed",
}
SHARES: dict[str, Column] = {
    "parameter": "parameter",
    "first order": "first order (share of variance):.4f",
    "± first": "first order ±:± .4f",
    "total": "total (share of variance):.4f",
    "± total": "total ±:± .4f",
}
EFFECTS: dict[str, Column] = {
    "parameter": "parameter",
    "μ": "mu (reward per range):.4g",
    "μ*": "mu* (reward per range):.4g",
    "± μ*": "mu* ±:± .2g",
    "σ": "sigma (reward per range):.4g",
    "± σ": "sigma ±:± .2g",
}


def sobol_report(asked: Asked) -> Report:
    """Return Sobol indices of the optimum's value and of a policy's regret."""
    n = whole_of(asked["samples"] or "1024", "--samples", 2, 2**24)
    ranges, without = _drawn(asked)
    how = {"ranges": ranges, "policy": asked.policy, "rng": asked.seed, **asked.work}
    found = sobol(asked.model, names=list(ranges), n=n, **how)
    drawn = found.regret
    told = {
        key: {"mean": each.mean, "sd": each.sd, **_numbers(found, each, ("first", "total"))}
        for key, each in (("value", found.optimal), ("regret", drawn))
    }
    facts = {
        "drawn value": f"{found.optimal.mean:.6g}, sd {found.optimal.sd:.4g} (estimated)",
        "drawn regret": f"{drawn.mean:.6g} at every draw, up to rounding"
        if drawn.constant
        else f"{drawn.mean:.6g}, sd {drawn.sd:.4g} (estimated)",
        "first order above total": _noise(found),
    }
    result = {"samples": found.n, **told["value"], "regret": told["regret"]}
    tables = [
        Table(title=f"shares of the variance of {what}", rows=found.frame(name), columns=SHARES)
        for name, what in OUTPUTS.items()
        if not found.of(name).constant
    ]
    return _report(asked, found, without, result, facts, tables)


def _noise(found: Sobol) -> str | None:
    """Return whether first orders exceed totals by no more than the intervals."""
    above = np.zeros(len(found.names), dtype=bool)
    for each in (found.optimal, found.regret):
        over = each.first - each.total
        if not each.constant:
            above |= (over > 0) & (over <= each.first_half + each.total_half)
    if not above.any():
        return None
    return (
        f"for {above.sum()} of {len(above)}, within the intervals: estimator noise; "
        "more --samples help"
    )


def morris_report(asked: Asked) -> Report:
    """Return elementary effects on the optimum's value and on a policy's regret."""
    n = whole_of(asked["samples"] or "64", "--samples", 2, 10**7)
    ranges, without = _drawn(asked)
    how = {"ranges": ranges, "policy": asked.policy, "rng": asked.seed, **asked.work}
    found = morris(asked.model, names=list(ranges), n=n, **how)
    keys = ("mu", "mu_star", "sigma")
    result = {
        "trajectories": found.n,
        "levels": found.levels,
        **_numbers(found, found.optimal, keys),
        "regret": _numbers(found, found.regret, keys),
    }
    tables = [
        Table(
            title=f"elementary effects on {what}; reward for the range",
            rows=found.frame(name),
            columns=EFFECTS,
        )
        for name, what in OUTPUTS.items()
        if found.of(name).mu_star.any()
    ]
    facts = {"regret": None if found.regret.mu_star.any() else "0 at every draw"}
    return _report(asked, found, without, result, facts, tables)


def _drawn(asked: Asked) -> tuple[Ranges, list[str]]:
    """Return the ranges that are drawn from, and the names that have none."""
    ranges, without = asked.ranges()
    if not (asked["parameters"] or asked["ranges"] or asked["range_file"]):
        names = set(usual(asked.model))
        ranges = Ranges({name: span for name, span in ranges.items() if name in names})
        without = [name for name in without if name in names]
    if not ranges:
        raise ModelError(
            "every chosen parameter is 0, and a share of 0 gives no range",
            where=f"sensitivity of {asked.loaded.name}",
            fix="give a range: --range NAME=LOW:HIGH",
        )
    return ranges, without


def _report(
    asked: Asked,
    found: Sobol | Morris,
    without: list[str],
    own: dict[str, Any],
    facts: dict[str, Any],
    tables: list[Table],
) -> Report:
    """Return the report of either kind."""
    start = solve(asked.loaded.mdp).start
    held = "held; vary it with --parameter discount or --range discount=LOW:HIGH"
    result = {
        **claimed("start_value", start),
        "claim": "estimated",
        "policy": asked.form,
        "draws": found.draws,
        "seed": found.seed,
        "confidence": found.confidence,
        "ranges": {name: [float(r.low), float(r.high)] for name, r in found.ranges.items()},
        **own,
        "without_range": without,
    }
    first = {
        "start value": start,
        "policy held fixed": asked.form,
        "draws": f"{found.draws:,}, seed {found.seed}",
        "intervals": f"± half a {found.confidence:.0%} interval (bootstrap)",
        "zero today, without range": without or None,
        "discount": None if DISCOUNT in found.ranges else held,
    }
    return Report(result=result, facts=first | facts, tables=tables)


KEYS = {"first": "first_order"}  # in JSON, where it differs from the attribute


def _numbers(found: Sobol | Morris, each: Indices | Effects, names: tuple[str, ...]) -> Any:
    """Return each parameter's numbers, and their intervals."""
    told: dict[str, dict[str, Any]] = {}
    for name in names:
        key, middle = KEYS.get(name, name), getattr(each, name)
        told[key] = dict(zip(found.names, middle.tolist(), strict=True))
        if hasattr(each, f"{name}_half"):
            half = getattr(each, f"{name}_half")
            ends = np.stack([middle - half, middle + half], axis=1).tolist()
            told[f"{key}_interval"] = dict(zip(found.names, ends, strict=True))
    return told
