"""All parameters at once, by how much of the output each decides: the kind sobol."""

from __future__ import annotations

from typing import Any

import numpy as np

from exact_mdp.analysis.cli.options import whole_of
from exact_mdp.analysis.cli.render import Column, Report, Table, claimed
from exact_mdp.analysis.cli.sensitivity.options import Asked, analysis
from exact_mdp.analysis.vary.ranges import Ranges, usual
from exact_mdp.analysis.vary.sobol import Indices, Sobol, sobol
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.parametric import DISCOUNT
from exact_mdp.solvers.solver import solve

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


@analysis("sobol")
def sobol_report(asked: Asked) -> Report:
    """Return Sobol indices of the optimum's value and of a policy's regret."""
    n = whole_of(asked["samples"] or "1024", "--samples", 2, 2**24)
    ranges, without = _drawn(asked)
    how = {"ranges": ranges, "policy": asked.policy, "rng": asked.seed, **asked.work}
    found = sobol(asked.model, names=list(ranges), n=n, **how)
    start, drawn = solve(asked.loaded.mdp).start, found.regret
    result = {
        **claimed("start_value", start),
        "claim": "estimated",
        "policy": asked.form,
        "draws": found.draws,
        "seed": found.seed,
        "confidence": found.confidence,
        "ranges": {name: [float(r.low), float(r.high)] for name, r in found.ranges.items()},
        "samples": found.n,
        **_numbers(found, found.optimal),
        "regret": _numbers(found, drawn),
        "without_range": without,
    }
    held = "held; vary it with --parameter discount or --range discount=LOW:HIGH"
    facts = {
        "start value": start,
        "policy held fixed": asked.form,
        "draws": f"{found.draws:,}, seed {found.seed}",
        "intervals": f"± half a {found.confidence:.0%} interval (bootstrap)",
        "zero today, without range": without or None,
        "discount": None if DISCOUNT in found.ranges else held,
        "drawn value": f"{found.optimal.mean:.6g}, sd {found.optimal.sd:.4g} (estimated)",
        "drawn regret": f"{drawn.mean:.6g} at every draw, up to rounding"
        if drawn.constant
        else f"{drawn.mean:.6g}, sd {drawn.sd:.4g} (estimated)",
        "first order above total": _noise(found),
    }
    tables = [
        Table(title=f"shares of the variance of {what}", rows=found.frame(name), columns=SHARES)
        for name, what in OUTPUTS.items()
        if not found.of(name).constant
    ]
    return Report(result=result, facts=facts, tables=tables)


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
            where=f"sobol of {asked.loaded.name}",
            fix="give a range: --range NAME=LOW:HIGH",
        )
    return ranges, without


def _numbers(found: Sobol, each: Indices) -> dict[str, Any]:
    """Return an output's mean and spread, and each parameter's indices with their intervals."""
    numbers: dict[str, Any] = {"mean": each.mean, "sd": each.sd}
    for key, index, half in (
        ("first_order", each.first, each.first_half),
        ("total", each.total, each.total_half),
    ):
        ends = np.stack([index - half, index + half], axis=1).tolist()
        numbers[key] = dict(zip(found.names, index.tolist(), strict=True))
        numbers[f"{key}_interval"] = dict(zip(found.names, ends, strict=True))
    return numbers
