"""All parameters drawn from distributions: the kind psa."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.analysis.cli.options import whole_of
from exact_mdp.analysis.cli.render import Report, Table, cell, claimed, plain
from exact_mdp.analysis.cli.sensitivity.options import Asked, analysis
from exact_mdp.analysis.vary.distributions import (
    EFFECTIVE_SAMPLE_SIZE,
    Uncertainty,
    load_uncertainty,
    row_family,
    uncertainty,
)
from exact_mdp.analysis.vary.information import FEWEST, PartialInformation
from exact_mdp.analysis.vary.intervals import (
    MeanLoss,
    mean_loss,
    mean_of,
    quantiles,
    tolerances_of,
)
from exact_mdp.analysis.vary.psa import PSA, psa
from exact_mdp.analysis.vary.study import solver_of
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.table import Floats, exact

SHOWN = 16  # rows of a table
DRAWS, SLOW_DRAWS = "10000", "500"

Stated = Mapping[str, Mapping[str, object]]


@analysis("psa")
def psa_report(asked: Asked) -> Report:
    """Return value, regret, optimal actions and the value of information over the draws."""
    model, stated, size = _stated(asked)
    names = list(asked["parameters"] or ()) or None
    chosen = _uncertain(asked, model, stated, size, names)
    samples = asked["samples"] or (DRAWS if solver_of(model).compiled else SLOW_DRAWS)
    count = whole_of(samples, "--samples", 1, 10**8)
    found = psa(model, count, rng=asked.seed, uncertain=chosen, policy=asked.policy, **asked.work)
    partial = found.evppi() if len(found) >= FEWEST else {}
    start, worth, regret = found.start, found.evpi(), found.regret()
    tolerances = tolerances_of([regret])
    accepted, least, most = found.accepted(tolerances)
    lost, clipped = mean_loss(regret), found.clipped
    result = {
        **claimed("start_value", start),
        "claim": "estimated",
        "policy": asked.form,
        "draws": len(found),
        "seed": found.seed,
        "effective_sample_size": size,
        "drawn": {
            name: {"distribution": part.kind, "size": part.size, "mean": mean, "sd": sd}
            for part in found.uncertainty.parts
            for name, mean, sd in zip(part.names, part.mean, part.sd, strict=True)
        },
        "fixed": found.uncertainty.fixed,
        "clipped": clipped,
        "value": _spread(found.optimal),
        "regret": _spread(regret, lost),
        "acceptability": {
            "policy": asked.form,
            "tolerance": tolerances,
            "probability": accepted,
            "low": least,
            "high": most,
            "candidates": {
                candidate.name: found.accepted(tolerances, n)[0]
                for n, candidate in enumerate(found.candidates)
            },
        },
        "evpi": worth.high.value,
        "evpi_bounds": {
            "low": _loss(worth.low),
            "high": _loss(worth.high),
            "best_policy": worth.best,
        },
        "evpi_of_candidates": _loss(found.evpi_of_candidates()),
        "evppi": {name: each.regression.value for name, each in partial.items()},
        "evppi_details": {
            name: {
                "parameters": each.names,
                "regression": each.regression,
                "lower": each.lower,
                "reliable": each.reliable,
                "doubts": each.doubts,
            }
            for name, each in partial.items()
        },
        "p_optimal": _shares(found),
        "candidates": [
            {
                "name": candidate.name,
                "actions": candidate.actions,
                "mean": mean_of(found.values[:, n]),
                "expected_loss": _loss(mean_loss(found.regret(n))),
                "probability_optimal": found.acceptability([0.0], n)[0].value,
                "draws_whose_optimum_it_was": candidate.frequency,
            }
            for n, candidate in enumerate(found.candidates)
        ],
    }
    means = {"regret": lost, "EVPI's upper end": worth.high, "EVPI's lower end": worth.low}
    few = [f"{name} by {m.carried:.0f}" for name, m in means.items() if m.few and m.value]
    facts = {
        "draws": f"{len(found):,}, seed {found.seed}; every draw re-solved",
        "drawn, held": f"{len(result['drawn'])}, {len(found.uncertainty.fixed)} parameters; "
        f"effective sample size {size:g} unless stated",
        "start value today": start,
        "V* over the draws": f"mean {cell(mean_of(found.optimal))}, "
        f"sd {_sd(found.optimal):.4g}, 95 % of draws {_middle(found.optimal)}",
        "policy held fixed": asked.form,
        "its regret": f"mean {cell(lost)}, 95 % of draws {_middle(regret)}",
        "it is optimal in": f"{accepted[0]:.1%} of draws",
        "EVPI": f"{cell(worth.low)} to {cell(worth.high)} (best policy found: {worth.best})",
        "probabilities cut off at 1": f"in {clipped.value:.2%} of draws" if clipped else None,
        "carried by few draws": f"{', '.join(few)}: take more draws to rely on it" if few else None,
        "claim": "estimated; ± is the standard error",
    }
    return Report(result=result, facts=facts, tables=_tables(result, found, partial))


def _loss(found: MeanLoss) -> dict[str, Any]:
    more = {"draws_that_carry_it": found.carried, "few_draws": found.few}
    return {**plain(found), **more}


def _spread(values: Floats, found: MeanLoss | None = None) -> dict[str, Any]:
    mean = plain(mean_of(values)) if found is None else _loss(found)
    return {"mean": mean.pop("value"), **mean, "sd": _sd(values), "quantiles": quantiles(values)}


def _sd(values: Floats) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 else float("nan")


def _middle(values: Floats) -> str:
    found = {each.probability: each.value for each in quantiles(values)}
    return f"{found[0.025]:.4g} to {found[0.975]:.4g}"


def _shares(found: PSA) -> dict[str, dict[str, dict[str, float]]]:
    """Return the share of draws in which each action is optimal, with Wilson's intervals."""
    keys = ("probability", "low", "high")
    bounds = np.stack(found.probability_optimal(), axis=-1).tolist()
    return {
        label: {
            action: dict(zip(keys, each, strict=True))
            for action, each in zip(found.actions, row, strict=True)
        }
        for label, row in zip(found.labels, bounds, strict=True)
    }


def _tables(
    result: Mapping[str, Any], found: PSA, partial: Mapping[str, PartialInformation]
) -> list[Table]:
    share, low, high = found.probability_optimal()
    reach = float(np.maximum(high - share, share - low).max(initial=0.0))
    where = "at subtask 0, trial 0; " if found.compiled else ""
    return [
        Table(
            title=f"share of draws in which an action is optimal, {where}ends of Wilson's 95 % "
            f"intervals are within {reach:.2g}",
            rows=[
                {"label": label} | {str(n): each for n, each in enumerate(row)}
                for label, row in zip(found.labels, share.tolist(), strict=True)
            ],
            columns={"status" if found.compiled else "state": "label"}
            | {action: f"{n}:.4f" for n, action in enumerate(found.actions)},
            first=SHOWN,
        ),
        Table(
            title="policies held fixed in every draw",
            rows=result["candidates"],
            columns={
                "policy": "name",
                "mean value": (lambda row: row["mean"].value, ".6g"),
                "expected loss": (lambda row: row["expected_loss"]["value"], ".4g"),
                "s.e.": (lambda row: row["expected_loss"]["standard_error"], ".1g"),
                "optimal in": "probability_optimal:.1%",
            },
        ),
        Table(
            title="EVPPI, choosing among these policies: by regression, at most their EVPI, "
            "and a lower estimate; ? marks what is not to be relied on",
            rows=sorted(partial.items(), key=lambda item: -item[1].regression.value),
            columns={
                "known": lambda row: row[0],
                "regression": lambda row: row[1].regression,
                "lower": lambda row: row[1].lower,
                "": lambda row: "" if row[1].reliable else "?",
            },
            first=SHOWN,
        ),
    ]


def _stated(asked: Asked) -> tuple[Parametric, Stated, float]:
    """Return the model, what is stated, and the sample size of what nothing is stated of."""
    stated: Stated = {}
    default, text, file = None, asked["effective_sample_size"], asked["range_file"]
    if text is not None and text.lower().endswith(".toml"):
        if file is not None:
            raise ModelError(
                "two files with distributions",
                where="psa",
                fix="put all into one of them",
            )
        text, file = None, text
    if file is not None:
        stated, default = load_uncertainty(Path(file))
    if text is not None:
        try:
            default = float(exact(text))
        except (ModelError, OverflowError) as error:
            raise ModelError(
                f"{text[:40]!r} is not a number",
                where="--effective-sample-size",
                fix="give a number above 0, or a .toml file",
            ) from error
    size = EFFECTIVE_SAMPLE_SIZE if default is None else default
    of_rows = asked.given.endless.scenario is None
    return row_family(asked.loaded.mdp) if of_rows else asked.model, stated, size


def _uncertain(
    asked: Asked, model: Parametric, stated: Stated, size: float, names: Sequence[str] | None
) -> Uncertainty:
    """Return what is drawn; an error names the file that states it."""
    text = asked["effective_sample_size"] or ""
    file = asked["range_file"] or (text if text.lower().endswith(".toml") else None)
    try:
        return uncertainty(model, stated, default=size, names=names)
    except ModelError as error:
        if file is None:
            raise
        where = f"{file}, {error.where}" if error.where else str(file)
        raise ModelError(error.what, where=where, fix=error.fix) from error
