"""Readings side by side, against an independent model in fractions."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracle import CLEAR, Oracle, acting

from exact_mdp.analysis.sensitivity import gradient, joint_radius
from exact_mdp.analysis.sensitivity.structural import (
    CARRIED,
    OPTIONS,
    PRESENT,
    Structural,
    combinations,
    one_at_a_time,
    structural,
)
from exact_mdp.mdp import ModelError, Scenario

SMALL = {"tasks": [2], "max_trial": 2}
LABELS = [f"{value:04b}" for value in range(16)]
STATED = {
    label: "supportive" if label[2] == "1" else "directive" if label[0] == "1" else "non-directive"
    for label in LABELS
}


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario.load("yuan2025").with_(**SMALL)


@pytest.fixture(scope="module")
def found(scenario: Scenario) -> Structural:
    options = OPTIONS | {"tasks": ((2,), (1, 1))}
    return structural(
        scenario,
        one_at_a_time(scenario, options),
        policies={"stated": STATED, "chance": "random"},
        elasticities=False,
    )


def oracle_of(settings: dict[str, Any]) -> Oracle:
    """One for each reading: what it has worked out is kept."""
    return oracle_for(tuple(sorted(settings.items())))


@cache
def oracle_for(items: tuple[tuple[str, Any], ...]) -> Oracle:
    settings = dict(items)
    tasks = settings.pop("tasks", SMALL["tasks"])
    discount = settings.pop("evaluation_discount", 1)
    return Oracle(tasks=tuple(tasks), max_trial=2, discount=Fraction(discount), readings=settings)


def test_every_reading_is_what_an_independent_model_says(found: Structural) -> None:
    assert len(found.readings) == 1 + 10 + 1 + 1
    today = oracle_of({})
    for reading in found.readings:
        oracle = oracle_of(dict(reading.settings))
        start = (0, 0, 1, CLEAR)
        assert reading.optimal.value == pytest.approx(float(oracle.value(start)), abs=1e-9)
        for label, names in zip(LABELS, reading.optimal_actions, strict=True):
            state = (0, 0, 1, tuple(map(int, label)))
            best = oracle.optimal_actions(state)
            assert {a for a, good in zip(oracle.actions(state), names, strict=True) if good} == best
            assert (label in reading.changed) == (not best & today.optimal_actions(state))
            assert reading.actions[LABELS.index(label)] in best
        held = oracle.evaluate(acting(STATED), distribution=False)
        assert reading.policies["stated"].value == pytest.approx(float(held["mean"]), abs=1e-9)
        lost = float(oracle.value(start) - held["mean"])
        assert reading.regret("stated").value == pytest.approx(lost, abs=1e-9)


def test_the_optimum_changes_where_it_is_none_in_fractions(found: Structural) -> None:
    today = oracle_of({})

    def as_today(state: Any, same: bool) -> frozenset[str]:
        k, t, _, status = state
        if same and t < today.trials and len(today.actions((k, t, 1, status))) > 1:
            return today.optimal_actions((k, t, 1, status))
        return today.optimal_actions((0, 0, 1, status))

    for reading in found.readings:
        oracle, same = oracle_of(dict(reading.settings)), "tasks" not in reading.settings

        def carried(state: Any, oracle: Oracle = oracle, same: bool = same) -> dict[str, Fraction]:
            old = as_today(state, same)
            return {min(old & oracle.optimal_actions(state) or old): Fraction(1)}

        kept = oracle.evaluate(carried, distribution=False)["mean"]
        lost = oracle.value((0, 0, 1, CLEAR)) - kept
        assert reading.optimum_changes == (lost > 0), reading.label
        assert reading.regret(CARRIED).value == pytest.approx(float(lost), abs=1e-9)
    # One of them changes where not all begin, and nowhere else.
    later = [each for each in found.readings if each.optimum_changes and not each.changed]
    assert [each.label for each in later] == ["status_cost = current"]
    assert 4e-5 < later[0].regret(CARRIED).value < 5e-5


def test_ties_and_states_that_are_not_reached_are_no_change() -> None:
    # Nothing that an action does matters: every action ties, today and under every reading.
    free = {f"reward.assist.{name}": 0 for name in ("supportive", "non-directive", "directive")}
    costs = {f"reward.{name}": 0 for name in ("forget", "confuse", "anger", "disengaged")}
    same = {"reward.subtask-complete": 0, "reward.subtask-skip": 0, "reward.trial": 0}
    dull = {**free, **costs, **same, "reward.timestep": 0, "reward.task-complete": 0}
    scenario = Scenario.load("yuan2025").with_(**SMALL, parameters=dull)
    few = {"dear": {"reward.assist.none": -1}, "cheap": {"reward.assist.none": 1}}
    flat = structural(scenario, few, elasticities=False, stability=False)
    assert [each.optimum_changes for each in flat.readings] == [False, False, False]
    assert [each.regret(CARRIED).value for each in flat.readings] == [0, 0, 0]
    back = structural(
        scenario.with_(parameters={"reward.assist.none": 1}),
        {"dear": {"reward.assist.none": -1}},
        elasticities=False,
        stability=False,
    )
    assert [each.optimum_changes for each in back.readings] == [False, True]


def test_the_present_reading_comes_first_and_is_its_own_measure(found: Structural) -> None:
    assert found.present.label == PRESENT
    assert found.present.changed == ()
    assert not found.present.optimum_changes
    assert found.present.regret(CARRIED).value == 0
    frame = found.frame()
    assert len(frame) == len(found.readings)
    assert frame["reading"][0] == PRESENT
    assert not frame["optimum changes"][0]
    assert frame["optimum changes"].sum() == sum(each.optimum_changes for each in found.readings)
    assert list(frame.columns[-17:-1]) == LABELS
    assert frame.attrs["policy"].startswith("re-optimised")
    assert "top parameter" not in frame


def test_named_readings_with_elasticity_and_stability(scenario: Scenario) -> None:
    small = scenario.with_(tasks=[1], max_trial=1)
    found = structural(small, {"no influence": {"influence.anger.confusion": 0}})
    reading = found.readings[1]
    changed = small.with_(parameters={"influence.anger.confusion": 0})
    table = gradient(changed, names=changed.names, exact=False)
    name = max(table.derivatives, key=lambda each: abs(table[each].elasticity or 0))
    assert reading.top == name
    assert reading.elasticity == pytest.approx(table[name].elasticity, rel=1e-6)
    assert reading.stability == float(joint_radius(changed).share) != found.present.stability


def test_processes_and_resuming_change_nothing(scenario: Scenario, tmp_path: Path) -> None:
    chosen = dict(list(one_at_a_time(scenario).items())[:4])
    how: dict[str, Any] = {"policies": {"stated": STATED}, "elasticities": False}
    first = structural(scenario, chosen, **how).frame()
    assert structural(scenario, chosen, n_jobs=2, folder=tmp_path, **how).frame().equals(first)
    assert len(list(tmp_path.glob("*.npz"))) == 5
    assert structural(scenario, chosen, folder=tmp_path, **how).frame().equals(first)
    with pytest.raises(ModelError, match="differs in policies"):
        structural(
            scenario, chosen, policies={"stated": "random"}, elasticities=False, folder=tmp_path
        )


def test_combinations_are_all_of_them(scenario: Scenario) -> None:
    everything = combinations(scenario)
    assert len(everything) == 2**6 * 3 * 3 - 1
    few = combinations(scenario, {"status_cost": ("next", "current"), "tasks": ((2,), (1, 1))})
    assert list(few) == [
        "tasks = [1, 1]",
        "status_cost = current",
        "status_cost = current, tasks = [1, 1]",
    ]
    found = structural(scenario, few, elasticities=False, stability=False)
    oracle = oracle_of({"status_cost": "current", "tasks": (1, 1)})
    value = float(oracle.value((0, 0, 1, CLEAR)))
    assert found.readings[-1].optimal.value == pytest.approx(value, abs=1e-9)
    assert np.isnan(found.readings[-1].stability)


@pytest.mark.parametrize(
    "readings, policies, message",
    [
        ({"x": {"status_cost": "after"}}, {}, "unknown option 'after'"),
        ({"x": {"status_costs": "next"}}, {}, "unknown parameter 'status_costs'"),
        ({"x": {"base.anger": 2}}, {}, "outside"),
        ({PRESENT: {}}, {}, "a reading called"),
        ({}, {CARRIED: "random"}, "a policy called"),
        ({}, {"x": {"0000": "none"}}, ""),
    ],
)
def test_bad_requests_are_refused(
    scenario: Scenario, readings: Any, policies: Any, message: str
) -> None:
    with pytest.raises(ModelError) as caught:
        structural(scenario, readings, policies=policies, elasticities=False, stability=False)
    assert message in str(caught.value)


def test_a_policy_that_does_not_fit_names_the_reading(scenario: Scenario) -> None:
    mdp = scenario.compile()
    choices = np.zeros(mdp.n_states, dtype=np.int64)
    with pytest.raises(ModelError, match="reading three tasks"):
        structural(
            scenario,
            {"three tasks": {"tasks": [1, 1, 1]}},
            policies={"by state": choices},
            elasticities=False,
        )
    with pytest.raises(ModelError, match="readings belong to care scenarios"):
        structural(mdp)
