"""What `exact-mdp sensitivity MODEL structural` tells."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.analysis.cli.render import Grid, number
from exact_mdp.analysis.cli.sensitivity.options import SHOWN, Report, any_range, work_from, written
from exact_mdp.analysis.sensitivity.structural import (
    CARRIED,
    Reading,
    Structural,
    combinations,
    one_at_a_time,
    structural,
)
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Floats

if TYPE_CHECKING:
    from exact_mdp.mdp.io.load import Loaded


def structural_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return the same outputs under every reading of the scenario."""
    scenario = loaded.scenario
    if scenario is None:
        raise ModelError(
            "readings belong to care scenarios, not to this model",
            where=loaded.name,
            fix="name a scenario, or a scenario file",
        )
    if options["parameters"] or any_range(options):
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
        **work_from(options),
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


def _confusion(loaded: Loaded, options: Mapping[str, Any]) -> Floats | None:
    from exact_mdp.mdp.care.perception import read

    path = options.get("perception")
    return None if path is None else read(path, loaded.mdp)


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
