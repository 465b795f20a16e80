"""The result of a probabilistic sensitivity analysis as JSON.

The facts and tables of a probabilistic sensitivity analysis, for people.

What `exact-mdp sensitivity MODEL psa` draws, and tells.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.analysis.cli.options import whole_of
from exact_mdp.analysis.cli.render import Grid, number
from exact_mdp.analysis.cli.sensitivity.options import (
    Report,
    model_of,
    only_first,
    policy_from,
    work_from,
    written,
)
from exact_mdp.analysis.sensitivity.base_case import digest
from exact_mdp.analysis.sensitivity.draws.solver import solver_of
from exact_mdp.analysis.sensitivity.psa.distributions import (
    EFFECTIVE_SAMPLE_SIZE,
    Uncertainty,
    load_uncertainty,
    uncertainty,
)
from exact_mdp.analysis.sensitivity.psa.expected_loss import LossCurve, expected_loss
from exact_mdp.analysis.sensitivity.psa.intervals import (
    FEW,
    MeanLoss,
    mean_loss,
    mean_of,
    quantiles,
    tolerances_of,
)
from exact_mdp.analysis.sensitivity.psa.psa import PSA, psa
from exact_mdp.analysis.sensitivity.psa.rows import row_family
from exact_mdp.analysis.sensitivity.psa.value_of_information import FEWEST, PartialInformation
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.table import Floats, exact
from exact_mdp.solvers import solve
from exact_mdp.solvers.solution import Bounded, Estimated

if TYPE_CHECKING:
    from exact_mdp.mdp.io.load import Loaded


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
        "value": _spread(found.optimal),
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


SHOWN = 16  # rows of a table


def facts_of(result: Mapping[str, Any], found: PSA) -> dict[str, str]:
    """Return the facts of a result."""
    value, regret, bounds = result["value"], result["regret"], result["evpi_bounds"]
    accepted = result["acceptability"]
    clipped = found.clipped
    return {
        "draws": f"{result['draws']:,}, seed {result['seed']}; every draw re-solved",
        "drawn, held": f"{len(result['drawn'])}, {len(result['fixed'])} parameters; "
        f"effective sample size {result['effective_sample_size']:g} unless stated",
        "start value today": number(result["start_value"], result["error_bound"]),
        "V* over the draws": f"mean {_told(value)}, sd {value['sd']:.4g}, "
        f"95 % of draws {_middle(value['quantiles'])}",
        "policy held fixed": result["policy"],
        "its regret": f"mean {_told(regret)}, 95 % of draws {_middle(regret['quantiles'])}",
        "it is optimal in": f"{accepted['probability'][0]:.1%} of draws",
        "EVPI": f"{_pair(bounds['low'])} to {_pair(bounds['high'])} (best policy found: "
        f"{bounds['best_policy']})",
        **({"chances cut off at 1": f"in {clipped.value:.2%} of draws"} if clipped else {}),
        **_warned(result),
        "claim": "estimated; ± is the standard error",
    }


def grids_of(
    result: Mapping[str, Any], found: PSA, partial: Mapping[str, PartialInformation]
) -> list[Grid]:
    """Return the tables: optimal actions, policies, and where there are any losses and EVPPI."""
    losses = result["expected_loss"]
    return [
        _actions(found),
        _policies(result["candidates"]),
        *([] if losses is None else [_psa_tables_losses(losses)]),
        *([_information(partial)] if partial else []),
    ]


def _actions(found: PSA) -> Grid:
    """Return how often each action is optimal."""
    share, low, high = found.probability_optimal()
    rows = [
        (label, *(f"{share[x, a]:.4f}" for a in range(len(found.actions))))
        for x, label in enumerate(found.labels[:SHOWN])
    ]
    where = "at subtask 0, trial 0; " if found.compiled else ""
    reach = float(np.maximum(high - share, share - low).max())
    return Grid(
        title=f"share of draws in which an action is optimal, {where}ends of Wilson's 95 % "
        f"intervals are within {reach:.2g}{only_first(len(found.labels), SHOWN)}",
        headings=("status" if found.compiled else "state", *found.actions),
        rows=rows,
        numeric=frozenset(range(1, 1 + len(found.actions))),
    )


def _policies(candidates: Iterable[Mapping[str, Any]]) -> Grid:
    """Return what each policy is worth on average."""
    return Grid(
        title="policies held fixed in every draw",
        headings=("policy", "mean value", "expected loss", "s.e.", "optimal in"),
        rows=[
            (
                each["name"],
                f"{each['mean']['value']:.6g}",
                f"{each['expected_loss']['value']:.4g}",
                f"{each['expected_loss']['standard_error']:.1g}",
                f"{each['probability_optimal']:.1%}",
            )
            for each in candidates
        ],
        numeric=frozenset(range(1, 5)),
    )


def _psa_tables_losses(losses: Mapping[str, Any]) -> Grid:
    """Return what each policy loses, by how much is known."""
    return Grid(
        title="expected loss by effective sample size of what nothing is stated of, "
        f"{losses['draws']:,} draws each; ~ marks what fewer than {FEW:g} draws carry",
        headings=("policy", *(f"{point:g}" for point in losses["points"])),
        rows=[
            (
                name,
                *(
                    f"{loss:.4g}{'~' if 0 < carried < FEW else ''}"
                    for loss, carried in zip(each["loss"], each["draws_that_carry_it"], strict=True)
                ),
            )
            for name, each in losses["policies"].items()
        ],
        numeric=frozenset(range(1, 1 + len(losses["points"]))),
    )


def _information(partial: Mapping[str, PartialInformation]) -> Grid:
    """Return what knowing some parameters would be worth, the most valuable first."""
    ordered = sorted(partial.items(), key=lambda item: -item[1].regression.value)[:SHOWN]
    return Grid(
        title="EVPPI, choosing among these policies: by regression, at most their EVPI, "
        "and a lower estimate; ? marks what is not to be relied on",
        headings=("known", "regression", "s.e.", "lower", "s.e.", ""),
        rows=[
            (
                name,
                f"{each.regression.value:.4g}",
                f"{each.regression.standard_error:.1g}",
                f"{each.lower.value:.4g}",
                f"{each.lower.standard_error:.1g}",
                "" if each.reliable else "?",
            )
            for name, each in ordered
        ],
        numeric=frozenset({1, 2, 3, 4}),
    )


def _warned(result: Mapping[str, Any]) -> dict[str, str]:
    """Return a line on means that few draws carry, whose intervals may be too short."""
    means = {
        "regret": result["regret"],
        "EVPI's upper end": result["evpi_bounds"]["high"],
        "EVPI's lower end": result["evpi_bounds"]["low"],
    }
    few = [
        f"{name} by {told['draws_that_carry_it']:.0f}"
        for name, told in means.items()
        if told["few_draws"] and told.get("value", told.get("mean"))
    ]
    if not few:
        return {}
    return {"carried by few draws": f"{', '.join(few)}: take more draws to rely on it"}


def _told(spread: Mapping[str, Any]) -> str:
    return f"{number(spread['mean'], spread['standard_error'])} ± {spread['standard_error']:.1g}"


def _pair(estimate: Mapping[str, Any]) -> str:
    error = estimate["standard_error"]
    return f"{number(estimate['value'], error)} ± {error:.1g}"


def _middle(found: Sequence[Mapping[str, Any]]) -> str:
    values = {each["probability"]: each["value"] for each in found}
    return f"{values[0.025]:.4g} to {values[0.975]:.4g}"


DRAWS, SLOW_DRAWS = "10000", "500"
CURVE_DRAWS = 2000  # at each point of the expected loss curve; a tenth of all, of slow models
SIZES = (10.0, 30.0, 100.0, 300.0, 1000.0)


def psa_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return what the draws say of value, regret, optimal actions and the worth of knowing more."""
    for name in ("ranges", "relative", "whole"):
        if options.get(name):
            raise ModelError(
                "the draws have distributions, not ranges",
                where="sensitivity psa",
                fix="state --effective-sample-size, a number or a .toml file",
            )
    model, stated, size = _stated(loaded, options)
    names = list(options.get("parameters") or ()) or None
    chosen = _uncertain(model, options, stated, size, names)
    compiled = solver_of(model).compiled
    samples = options.get("samples") or (DRAWS if compiled else SLOW_DRAWS)
    form = options.get("policy") or "optimal"
    how = work_from(options)
    found = psa(
        model,
        whole_of(str(samples), "--samples", 1, 10**8),
        rng=whole_of(str(options.get("seed") or 0), "--seed", most=2**128),
        uncertain=chosen,
        policy=policy_from(loaded, {**options, "policy": form}),
        **how,
    )
    partial = found.evppi() if len(found) >= FEWEST else {}
    curve = _curve(model, found, stated, names, how)
    result = result_of(solve(loaded.mdp).start, found, partial, curve, form, size)
    result = written(loaded, options, result, "psa")
    return result, facts_of(result, found), grids_of(result, found, partial)


def _stated(
    loaded: Loaded, options: Mapping[str, Any]
) -> tuple[Parametric, dict[str, dict[str, object]], float]:
    """Return the model, what is stated, and the sample size of what nothing is stated of."""
    stated: dict[str, dict[str, object]] = {}
    default = None
    text = options.get("effective_sample_size")
    file = options.get("range_file")
    if text is not None and str(text).lower().endswith(".toml"):
        if file is not None:
            raise ModelError("two files", where="sensitivity psa", fix="state all in one of them")
        text, file = None, text
    if file is not None:
        stated, default = load_uncertainty(Path(str(file)))
    if text is not None:
        try:
            default = float(exact(text))
        except (ModelError, OverflowError) as error:
            raise ModelError(
                f"{str(text)[:40]!r} is not a number",
                where="--effective-sample-size",
                fix="give a number above 0, or a .toml file",
            ) from error
    size = EFFECTIVE_SAMPLE_SIZE if default is None else default
    model = model_of(loaded) if loaded.scenario is not None else row_family(loaded.mdp)
    return model, stated, size


def _uncertain(
    model: Parametric,
    options: Mapping[str, Any],
    stated: Mapping[str, Mapping[str, object]],
    size: float,
    names: Sequence[str] | None,
) -> Uncertainty:
    """Return what is drawn; what cannot be is told with the file that states it."""
    text = str(options.get("effective_sample_size"))
    file = options.get("range_file") or (text if text.lower().endswith(".toml") else None)
    try:
        return uncertainty(model, stated, default=size, names=names)
    except ModelError as error:
        if file is None:
            raise
        where = f"{file}, {error.where}" if error.where else str(file)
        raise ModelError(error.what, where=where, fix=error.fix) from error


def _curve(
    model: Parametric,
    found: PSA,
    stated: Mapping[str, Mapping[str, object]],
    names: Sequence[str] | None,
    how: Mapping[str, Any],
) -> LossCurve | None:
    """Return expected losses by sample size, where that says something and draws suffice."""
    draws = min(len(found), CURVE_DRAWS) if found.compiled else len(found) // 10
    ends = [uncertainty(model, stated, default=size, names=names) for size in SIZES[::4]]
    if draws < 2 or ends[0].parts == ends[1].parts:
        return None
    folder = how["folder"]
    if folder is not None:
        told = digest(*(candidate.weights for candidate in found.candidates))
        folder = Path(folder) / f"loss-{told[:12]}-{draws}"
    return expected_loss(
        model,
        {candidate.name: candidate.weights for candidate in found.candidates},
        SIZES,
        rng=found.seed,
        n=draws,
        stated=stated,
        names=names,
        **{**how, "folder": folder},
    )
