"""What `exact-mdp sensitivity MODEL psa` draws, and tells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.cli_common import whole_of
from analysis.sensitivity.base_case import digest
from analysis.sensitivity.distributions import Uncertainty
from analysis.sensitivity.draw_solver import solver_of
from analysis.sensitivity.expected_loss import LossCurve, expected_loss
from analysis.sensitivity.parameter_uncertainty import EFFECTIVE_SAMPLE_SIZE, uncertainty
from analysis.sensitivity.psa import psa
from analysis.sensitivity.psa_json import result_of
from analysis.sensitivity.psa_result import PSA
from analysis.sensitivity.psa_tables import facts_of, grids_of
from analysis.sensitivity.report import Report, written
from analysis.sensitivity.report_options import model_of, policy_from, work_from
from analysis.sensitivity.row_family import row_family
from analysis.sensitivity.uncertainty_file import load_uncertainty
from analysis.sensitivity.value_of_information import FEWEST
from mdp.errors import ModelError
from mdp.parametric import Parametric
from mdp.table import exact
from solvers import solve

if TYPE_CHECKING:
    from mdp.load import Loaded

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
        seed=whole_of(str(options.get("seed") or 0), "--seed", most=2**128),
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
    model = model_of(loaded) if loaded.scenario is not None else row_family(loaded.mdp)[0]
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
        seed=found.seed,
        samples=draws,
        stated=stated,
        names=names,
        **{**how, "folder": folder},
    )
