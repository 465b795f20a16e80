"""The rules of a care scenario are stated once: whoever changes one changes it everywhere."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from itertools import product

import numpy as np
import pytest

from exact_mdp import READINGS, Scenario, evaluate, solve
from exact_mdp.mdp.care import rules
from exact_mdp.mdp.care.laws import chances, excess
from exact_mdp.mdp.care.tables import Tables
from exact_mdp.solvers.care import optimal, policy_values

VARIANTS = (
    {},
    {"task_bonus": "no-subtask-skipped", "status_cost": "current"},
    {"task_bonus": "last-subtask-completed", "skip_timestep": "own", "skip_onset": "base"},
    {"task_bonus": "no-subtask-skipped", "skip_timestep": "own", "trial_cost": "failed-trials"},
)
Patch = pytest.MonkeyPatch


def pay_the_bonus_on_a_skip(patch: Patch) -> None:
    every = (("complete", 0), ("skip", 1))
    patch.setattr(rules, "BONUS", dict.fromkeys(rules.BONUS, every))


def never_pay_the_bonus(patch: Patch) -> None:
    patch.setattr(rules, "BONUS", dict.fromkeys(rules.BONUS, ()))


def charge_a_trial_on_a_skip(patch: Patch) -> None:
    patch.setattr(rules, "CHARGES", (*rules.CHARGES, ("skip", "trial", None)))


def charge_nothing_on_completing(patch: Patch) -> None:
    kept = tuple(row for row in rules.CHARGES if row[0] != "complete")
    patch.setattr(rules, "CHARGES", kept)


def charge_statuses_twice(patch: Patch) -> None:
    patch.setattr(rules, "STATUS_COST", {"next": (1, 1), "current": (1, 1)})


def charge_no_statuses(patch: Patch) -> None:
    patch.setattr(rules, "STATUS_COST", {"next": (0, 0), "current": (0, 0)})


def skip_one_trial_later(patch: Patch) -> None:
    patch.setattr(Tables, "trials", property(lambda scenario: scenario.max_trial + 1))


CHANGES = (
    pay_the_bonus_on_a_skip,
    never_pay_the_bonus,
    charge_a_trial_on_a_skip,
    charge_nothing_on_completing,
    charge_statuses_twice,
    charge_no_statuses,
    skip_one_trial_later,
)


def optimum(scenario: Scenario) -> float:
    """Return the optimal start value, in which matrix and batch agree."""
    known = solve(scenario.compile()).start.value
    batch = optimal(scenario, (), np.empty((1, 0)))
    assert batch.start[0] == pytest.approx(known, abs=1e-9)
    return known


def mean(scenario: Scenario) -> float:
    """Return the mean of one policy, in which matrix and batch agree."""
    mdp, flags = scenario.compile(), rules.Rules(scenario).flags
    known = evaluate(mdp, "always:directive")
    always = np.broadcast_to(np.eye(4)[3], (1, 3, scenario.trials, flags, 16, 4))
    value, _ = policy_values(scenario, (), np.empty((1, 0)), always)
    assert value[0, 0] == pytest.approx(known.mean, abs=1e-9)
    assert sum(known.components.values()) == pytest.approx(known.mean, abs=1e-9)
    return float(known.mean)


@pytest.mark.parametrize("readings", VARIANTS)
@pytest.mark.parametrize("change", CHANGES)
def test_a_rule_that_is_changed_in_its_one_place_is_followed_by_all(
    change: Callable[[Patch], None], readings: dict[str, str], monkeypatch: Patch
) -> None:
    scenario = Scenario.load("yuan2025").with_(
        tasks=[2, 1], max_trial=2, discount="19/20", readings=readings
    )
    before = optimum(scenario), mean(scenario)
    change(monkeypatch)
    after = optimum(scenario), mean(scenario)
    assert after[0] != pytest.approx(before[0], abs=1e-6)
    assert after[1] != pytest.approx(before[1], abs=1e-6)


def test_the_statement_is_that_of_the_paper() -> None:
    """By default: Equation 1 and Table 4; each weight at most once in an event."""
    stated = rules.Rules(Scenario.load("yuan2025"))
    assert stated.charged("complete", rules.INSIDE) == ("timestep", "subtask-complete", "trial")
    assert stated.charged("fail") == ("timestep", "trial")
    assert stated.charged("skip", rules.INSIDE, 1) == ("subtask-skip",)
    assert stated.charged("skip", rules.FINAL, 1) == ("subtask-skip", "task-complete")
    assert stated.charged("complete", rules.LAST)[-1] == "task-complete"


SMALL = {"tasks": [1], "max_trial": 2}


def small(**readings: str) -> Scenario:
    return Scenario.load("yuan2025").with_(readings=readings, **SMALL)


def over(scenario: Scenario) -> int:
    """Count sums above 1 in fractions, one by one."""
    found = chances(scenario)
    values = [*(parameter.value for parameter in scenario.parameters), Fraction(0)]
    which = [*found.step.reshape(-1).tolist(), *found.skip.reshape(-1).tolist()]
    return sum(sum(values[k] for k in found.terms[number]) > 1 for number in which)


@pytest.mark.parametrize(
    "readings",
    [
        dict(
            zip(("influence_on_present", "influence_orientation", "skip_onset"), each, strict=True)
        )
        for each in product(
            READINGS["influence_on_present"],
            READINGS["influence_orientation"],
            READINGS["skip_onset"],
        )
    ],
)
def test_every_chance_above_1_is_counted(readings: dict[str, str]) -> None:
    own = small(**readings)
    count, said = over(own), excess(own)
    assert (said is None) == (count == 0)
    if said is not None and count > 1:
        assert f"so are {count - 1} others" in said
