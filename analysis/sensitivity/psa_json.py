"""The result of a probabilistic sensitivity analysis as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from analysis.sensitivity.expected_loss import LossCurve
from analysis.sensitivity.intervals import (
    MeanLoss,
    mean_loss,
    mean_of,
    quantiles,
    tolerances_of,
)
from analysis.sensitivity.psa_result import PSA
from analysis.sensitivity.value_of_information import PartialInformation
from mdp.table import Floats
from solvers.solution import Bounded, Estimated


def result_of(
    start: Bounded,
    found: PSA,
    partial: Mapping[str, PartialInformation],
    curve: LossCurve | None,
    form: str,
    size: float,
) -> dict[str, Any]:
    """Return the result for JSON; `start` is today's optimum, `form` the policy held."""
    worth = found.evpi()
    regret = found.regret()
    tolerances = tolerances_of([regret])
    accepted, least, most = found.accepted(tolerances)
    share, low, high = found.probability_optimal()
    return {
        "start_value": start.value,
        "error_bound": start.error,
        "claim": "estimated",
        "policy": form,
        "draws": len(found),
        "seed": found.seed,
        "effective_sample_size": size,
        "drawn": {
            name: {"distribution": part.kind, "size": part.size, "mean": mean, "sd": sd}
            for part in found.uncertainty.parts
            for name, mean, sd in zip(part.names, part.mean, part.sd, strict=True)
        },
        "fixed": dict(found.uncertainty.fixed),
        "clipped": None if found.clipped is None else _estimate(found.clipped),
        "value": _spread(found.start),
        "regret": _spread(regret, mean_loss(regret)),
        "acceptability": {
            "policy": form,
            "tolerance": tolerances.tolist(),
            "probability": accepted.tolist(),
            "low": least.tolist(),
            "high": most.tolist(),
            "candidates": {
                candidate.name: found.accepted(tolerances, n)[0].tolist()
                for n, candidate in enumerate(found.candidates)
            },
        },
        "evpi": worth.high.value,
        "evpi_bounds": {
            "low": _estimate(worth.low),
            "high": _estimate(worth.high),
            "best_policy": worth.best,
        },
        "evpi_of_candidates": _estimate(found.evpi_of_candidates()),
        "evppi": {name: each.regression.value for name, each in partial.items()},
        "evppi_details": {
            name: {
                "parameters": list(each.names),
                "regression": _estimate(each.regression),
                "lower": _estimate(each.lower),
                "reliable": each.reliable,
                "doubts": list(each.doubts),
            }
            for name, each in partial.items()
        },
        "p_optimal": {
            label: {
                action: {
                    "probability": float(share[x, a]),
                    "low": float(low[x, a]),
                    "high": float(high[x, a]),
                }
                for a, action in enumerate(found.actions)
            }
            for x, label in enumerate(found.labels)
        },
        "candidates": [
            {
                "name": candidate.name,
                "actions": candidate.actions,
                "mean": _estimate(mean_of(found.values[:, n])),
                "expected_loss": _estimate(mean_loss(found.regret(n))),
                "probability_optimal": found.acceptability([0.0], n)[0].value,
                "draws_whose_optimum_it_was": candidate.frequency,
            }
            for n, candidate in enumerate(found.candidates)
        ],
        "expected_loss": None if curve is None else _losses(curve),
    }


def _losses(curve: LossCurve) -> dict[str, Any]:
    columns = ("loss", "standard_error", "low", "high", "carried", "optimal")
    keys = {"carried": "draws_that_carry_it", "optimal": "probability_optimal"}
    return {
        "along": curve.along,
        "unit": curve.unit,
        "draws": curve.draws,
        "points": curve.points.tolist(),
        "policies": {
            name: {keys.get(each, each): getattr(curve, each)[:, n].tolist() for each in columns}
            for n, name in enumerate(curve.policies)
        },
    }


def _estimate(found: Estimated) -> dict[str, Any]:
    low, high = found.interval
    told: dict[str, Any] = {
        "value": found.value,
        "standard_error": found.standard_error,
        "interval": [low, high],
    }
    if isinstance(found, MeanLoss):
        told |= {"draws_that_carry_it": found.carried, "few_draws": found.few}
    return told


def _spread(values: Floats, found: Estimated | None = None) -> dict[str, Any]:
    sd = float(values.std(ddof=1)) if len(values) > 1 else float("nan")
    mean = _estimate(found or mean_of(values))
    return {
        "mean": mean.pop("value"),
        **mean,
        "sd": sd,
        "quantiles": [asdict(each) for each in quantiles(values)],
    }
