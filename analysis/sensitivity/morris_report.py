"""What `exact-mdp sensitivity MODEL morris` tells."""

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
from analysis.sensitivity.morris import Effects, Morris, morris
from analysis.sensitivity.report import SHOWN, Report, written
from analysis.sensitivity.report_options import model_of

if TYPE_CHECKING:
    from mdp.load import Loaded


def morris_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return elementary effects on the optimum's value and on a policy's regret."""
    trajectories = whole_of(options["samples"] or "64", "--samples", 2, 10**7)
    names, ranges, without = drawn_from(loaded, options)
    found = morris(
        model_of(loaded),
        names=names,
        ranges=ranges,
        trajectories=trajectories,
        **how_from(loaded, options),
    )
    result = head_of(loaded, options, found) | {
        "trajectories": found.trajectories,
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
