"""What `exact-mdp sensitivity` tells of Sobol indices, Morris effects and readings."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.cli_common import whole_of
from analysis.cli_output import Grid, number, to_json
from analysis.sensitivity.morris import Effects, Morris, morris
from analysis.sensitivity.report import SHOWN, Report, model_of, policy_from, ranges_from
from analysis.sensitivity.sampled import usual
from analysis.sensitivity.sobol import Indices, Sobol, sobol
from analysis.sensitivity.structural import (
    CARRIED,
    Reading,
    Structural,
    combinations,
    one_at_a_time,
    structural,
)
from mdp.errors import ModelError
from mdp.files import write_atomically
from mdp.parametric import DISCOUNT
from mdp.table import Floats
from solvers import solve

if TYPE_CHECKING:
    from mdp.load import Loaded

DRAWN = {
    "optimal": "of the start value, policy re-optimised",
    "regret": "of the regret of the policy held fixed",
}


def sobol_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return Sobol indices of the optimum's value and of a policy's regret."""
    samples = whole_of(options["samples"] or "1024", "--samples", 2, 2**24)
    names, ranges, without = _drawn(loaded, options)
    found = sobol(
        model_of(loaded), names=names, ranges=ranges, samples=samples, **_how(loaded, options)
    )
    result = _head(loaded, options, found) | {
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
    facts = _facts(result, options) | {
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


def morris_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return elementary effects on the optimum's value and on a policy's regret."""
    trajectories = whole_of(options["samples"] or "64", "--samples", 2, 10**7)
    names, ranges, without = _drawn(loaded, options)
    found = morris(
        model_of(loaded),
        names=names,
        ranges=ranges,
        trajectories=trajectories,
        **_how(loaded, options),
    )
    result = _head(loaded, options, found) | {
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
    facts = _facts(result, options)
    if not found.regret.mu_star.any():
        facts["regret"] = "0 at every draw"
    return written(loaded, options, result, "morris"), facts, grids


def structural_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return the same outputs under every reading of the scenario."""
    scenario = loaded.scenario
    if scenario is None:
        raise ModelError(
            "readings belong to care scenarios, not to this model",
            where=loaded.name,
            fix="name a scenario, or a scenario file",
        )
    if options["parameters"] or _ranged(options):
        raise ModelError(
            "readings have no ranges", where="sensitivity structural", fix="leave them out"
        )
    combined = options["combined"]
    form = options["policy"]
    found = structural(
        scenario,
        combinations(scenario) if combined else one_at_a_time(scenario),
        policies={} if form == "optimal" else {form: form},
        perception=_confusion(loaded, options),
        elasticities=not combined,  # the rest is five times as fast
        **_work(options),
    )
    present = found.present
    result = {
        "start_value": present.optimal.value,
        "error_bound": present.optimal.error,
        "claim": "bounded",
        "policy": form,
        "readings": [_reading(found, number) for number in range(len(found.readings))],
    }
    held = CARRIED if form == "optimal" else form
    regrets = [each.regret(held).value for each in found.readings]
    shown = range(len(found.readings))
    if combined:  # too many to read: those where holding the policy costs most
        shown = sorted(shown, key=lambda place: -regrets[place])
    rows = [
        (
            found.readings[place].label.replace(", ", "\n"),
            f"{found.readings[place].optimal.value:.6g}",
            f"{found.readings[place].sd:.5g}",
            _changes(found.readings[place]),
            f"{regrets[place]:.4g}",
            found.readings[place].top or "-",
        )
        for place in shown[:SHOWN]
    ]
    more = f", {SHOWN} of {len(found.readings)}" if len(found.readings) > SHOWN else ""
    headings = ["reading", "start value", "sd", "optimum", "regret", "weighs most"]
    if combined:
        headings, rows = headings[:-1], [row[:-1] for row in rows]
    grid = Grid(
        title=f"policy re-optimised under each reading{more}; where it changes at subtask 0, "
        f"trial 0; regret of: {held}",
        headings=headings,
        rows=rows,
        numeric=frozenset({1, 2, 4}),
    )
    facts = {
        "start value": f"{number(present.optimal.value, present.optimal.error)} (bounded)",
        "readings": str(len(found.readings)),
        "optimum changes in": str(sum(each.optimum_changes for each in found.readings)),
        "largest regret": f"{max(regrets):.4g}, {found.readings[int(np.argmax(regrets))].label}",
    }
    return written(loaded, options, result, "structural"), facts, [grid]


# ---- parts ---------------------------------------------------------------------------------------


def _drawn(
    loaded: Loaded, options: Mapping[str, Any]
) -> tuple[list[str], dict[str, Any], list[str]]:
    """Return the names that are drawn, their ranges, and the names that have none."""
    model = model_of(loaded)
    spans = ranges_from(model, options)
    if not (options["parameters"] or options["ranges"] or options["range_file"]):
        spans = {name: spans[name] for name in usual(model)}
    ranges = {name: span for name, span in spans.items() if span.low < span.high}
    if not ranges:
        raise ModelError(
            "every parameter asked for is 0, and 0 ± a share of it is no range",
            where=f"sensitivity of {loaded.name}",
            fix="state one: --range NAME=LOW:HIGH",
        )
    return list(ranges), ranges, sorted(set(spans) - set(ranges))


def _confusion(loaded: Loaded, options: Mapping[str, Any]) -> Floats | None:
    from mdp.perception import read

    path = options.get("perception")
    return None if path is None else read(path, loaded.mdp)


def _work(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return where the work is done, from the options."""
    jobs = options["n_jobs"]
    return {
        "n_jobs": None if jobs is None else whole_of(jobs, "--n-jobs", 1, 1024),
        "scheduler": options["scheduler"],
        "folder": options["out"],
        "progress": True,
    }


def _how(loaded: Loaded, options: Mapping[str, Any]) -> dict[str, Any]:
    return _work(options) | {
        "policy": policy_from(loaded, options),
        "seed": whole_of(options["seed"], "--seed", most=2**128),
    }


def _head(loaded: Loaded, options: Mapping[str, Any], found: Sobol | Morris) -> dict[str, Any]:
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


def _facts(result: Mapping[str, Any], options: Mapping[str, Any]) -> dict[str, str]:
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


def _intervals(found: Sobol | Morris, middle: Floats, half: Floats) -> dict[str, list[float]]:
    ends = zip(found.names, (middle - half).tolist(), (middle + half).tolist(), strict=True)
    return {name: [low, high] for name, low, high in ends}


def _named(found: Sobol | Morris, numbers: Floats) -> dict[str, float]:
    return dict(zip(found.names, numbers.tolist(), strict=True))


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
        "first_order": _named(found, each.first),
        "first_order_interval": _intervals(found, each.first, each.first_half),
        "total": _named(found, each.total),
        "total_interval": _intervals(found, each.total, each.total_half),
    }


def _effects(found: Morris, each: Effects) -> dict[str, Any]:
    return {
        "mu": _named(found, each.mu),
        "mu_star": _named(found, each.mu_star),
        "mu_star_interval": _intervals(found, each.mu_star, each.mu_star_half),
        "sigma": _named(found, each.sigma),
        "sigma_interval": _intervals(found, each.sigma, each.sigma_half),
    }


def _reading(found: Structural, place: int) -> dict[str, Any]:
    each = found.readings[place]
    held = {
        name: {
            "value": value.value,
            "error_bound": value.error,
            "regret": each.regret(name).value,
        }
        for name, value in each.policies.items()
    }
    return {
        "reading": each.label,
        "settings": {name: _plain(option) for name, option in each.settings.items()},
        "states": each.states,
        "start_value": each.optimal.value,
        "error_bound": each.optimal.error,
        "sd": each.sd,
        "optimum_changes": each.optimum_changes,
        "changed_at_subtask_0_trial_0": list(each.changed),
        "actions": dict(zip(found.statuses, each.actions, strict=True)),
        "policies": held,
        "top_parameter": each.top or None,
        "elasticity": each.elasticity,
        "stability": each.stability,
    }


def _changes(each: Reading) -> str:
    if not each.optimum_changes:
        return "same"
    return " ".join(each.changed) or "changes later"


def _plain(option: object) -> object:
    return list(option) if isinstance(option, tuple) else option


def _ranged(options: Mapping[str, Any]) -> bool:
    return bool(
        options["ranges"] or options["range_file"] or options["relative"] or options["whole"]
    )


def written(
    loaded: Loaded, options: Mapping[str, Any], result: dict[str, Any], kind: str
) -> dict[str, Any]:
    """Write the result and its record into the folder of --out, where there is one."""
    if options["out"] is None:
        return result
    import click

    from analysis.record import run_record

    context = click.get_current_context(silent=True)
    words = (context.find_root().obj or ()) if context is not None else ()
    folder = Path(options["out"])
    paths = [folder / f"{kind}.json", folder / "run.json"]
    result["written"] = [str(path) for path in paths]
    head = {"model": loaded.name, "kind": kind, "discount": loaded.mdp.discount}
    head["perception"] = options.get("perception")
    record = run_record(
        loaded.mdp, model=loaded.name, solver=kind, seed=result.get("seed"), command=words
    )
    write_atomically(paths[0], to_json(head | result) + "\n")
    write_atomically(paths[1], json.dumps(record, indent=2) + "\n")
    return result
