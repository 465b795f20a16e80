"""What `exact-mdp sensitivity MODEL sobol` tells."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.cli_common import whole_of
from analysis.cli_output import Grid
from analysis.sensitivity.design_report import (
    DRAWN,
    by_name,
    drawn_from,
    facts_of,
    head_of,
    how_from,
    intervals,
)
from analysis.sensitivity.report import SHOWN, Report, written
from analysis.sensitivity.report_options import model_of
from analysis.sensitivity.sobol import Indices, Sobol, sobol

if TYPE_CHECKING:
    from mdp.load import Loaded


def sobol_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return Sobol indices of the optimum's value and of a policy's regret."""
    samples = whole_of(options["samples"] or "1024", "--samples", 2, 2**24)
    names, ranges, without = drawn_from(loaded, options)
    found = sobol(
        model_of(loaded), names=names, ranges=ranges, samples=samples, **how_from(loaded, options)
    )
    result = head_of(loaded, options, found) | {
        "samples": found.samples,
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
