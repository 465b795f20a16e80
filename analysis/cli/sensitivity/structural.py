"""Readings of the text: the kind structural."""

from __future__ import annotations

from typing import Any

from exact_mdp.analysis.cli.render import Report, Table, claimed
from exact_mdp.analysis.cli.sensitivity.options import Asked
from exact_mdp.analysis.sensitivity.structural import (
    CARRIED,
    Reading,
    Structural,
    combinations,
    one_at_a_time,
    structural,
)
from exact_mdp.mdp.care.perception import read
from exact_mdp.mdp.errors import ModelError


def structural_report(asked: Asked) -> Report:
    """Return the same outputs under every reading of the scenario."""
    scenario, combined, seen = asked.loaded.scenario, asked["combined"], asked["perception"]
    if scenario is None:
        raise ModelError(
            "readings belong to care scenarios, not to this model",
            where=asked.loaded.name,
            fix="name a scenario, or a scenario file",
        )
    form = asked.form
    found = structural(
        scenario,
        combinations(scenario) if combined else one_at_a_time(scenario),
        policies={} if form == "optimal" else {form: form},
        perception=None if seen is None else read(seen, asked.loaded.mdp),
        elasticities=not combined,  # the rest is five times as fast
        **asked.work,
    )
    held = CARRIED if form == "optimal" else form
    present, readings = found.present, found.readings
    rows = [_reading(found, each) for each in readings]
    result = claimed("start_value", present.optimal) | {"policy": form, "readings": rows}
    costliest = max(readings, key=lambda each: each.regret(held).value)
    facts = {
        "start value": present.optimal,
        "readings": len(readings),
        "optimum changes in": sum(each.optimum_changes for each in readings),
        "largest regret": f"{costliest.regret(held).value:.4g}, {costliest.label}",
    }
    if combined:  # too many to read: those where holding the policy costs most
        rows = sorted(rows, key=lambda row: -row["policies"][held]["regret"])
    table = Table(
        title="policy re-optimised under each reading; where it changes at subtask 0, trial 0; "
        f"regret of: {held}",
        rows=rows,
        columns={
            "reading": lambda row: row["reading"].replace(", ", "\n"),
            "start value": "start_value:.6g",
            "sd": "sd:.5g",
            "optimum": _changes,
            "regret": (lambda row: row["policies"][held]["regret"], ".4g"),
            **({} if combined else {"weighs most": "top_parameter"}),
        },
    )
    return Report(result=result, facts=facts, tables=[table])


def _reading(found: Structural, each: Reading) -> dict[str, Any]:
    return {
        "reading": each.label,
        "settings": each.settings,
        "states": each.states,
        "start_value": each.optimal.value,
        "error_bound": each.optimal.error,
        "sd": each.sd,
        "optimum_changes": each.optimum_changes,
        "changed_at_subtask_0_trial_0": each.changed,
        "actions": dict(zip(found.statuses, each.actions, strict=True)),
        "policies": {
            name: {
                "value": value.value,
                "error_bound": value.error,
                "regret": each.regret(name).value,
            }
            for name, value in each.policies.items()
        },
        "top_parameter": each.top or None,
        "elasticity": each.elasticity,
        "stability": each.stability,
    }


def _changes(row: Any) -> str:
    if not row["optimum_changes"]:
        return "same"
    return " ".join(row["changed_at_subtask_0_trial_0"]) or "changes later"
