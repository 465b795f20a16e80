"""The reference model against numbers worked out by hand."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from random import Random
from typing import Any

import pytest
from care_oracle import ACTIONS, COMPONENTS, READINGS, Oracle, Policy

ALL_READINGS: list[dict[str, str]] = [
    dict(zip(READINGS, options, strict=True)) for options in product(*READINGS.values())
]
SAMPLE = Random(1).sample(ALL_READINGS, 24)
CLEAR = (0, 0, 0, 0)


def always(action: str) -> Policy:
    return lambda state: {action: Fraction(1)}


# One subtask, one trial, from status 0000. The base chances are .3, .3, .05 and .2.
#   none:          0000 next with .7 * .7 * .95 * .8 = .3724; status cost .3 + .3 + 5 * .05 + .2
#                  = 1.05, so -1 - 1.05 - 1 + .3724 * 50 - .6276 * 10 + 20 = 29.294
#   supportive:    no onset of A, D: .7 * .7 = .49; cost .6:
#                  -1 - .6 - 1 + .49 * (50 - 1) - .51 * 10 + 20 = 36.31
#   non-directive: no onset of F, C: .95 * .8 = .76; cost .25 + .2:
#                  -1 - .45 - 1 + .76 * (50 - 3) - .24 * 10 + 20 = 50.87
#   directive:     as before, with 5 for 3: 49.35
ONE_TRIAL = {"none": 29.294, "supportive": 36.31, "non-directive": 50.87, "directive": 49.35}


@pytest.mark.parametrize("action", ACTIONS)
def test_one_trial_by_hand(action: str) -> None:
    oracle = Oracle(tasks=[1], max_trial=1)
    assert oracle.evaluate(always(action))["mean"] == Fraction(str(ONE_TRIAL[action]))
    assert oracle.value(oracle.start) == Fraction("50.87")
    assert oracle.optimal_actions(oracle.start) == {"non-directive"}


@pytest.mark.parametrize(
    "readings, mean",
    [
        # the trial costs 1 only when it failed: + .3724
        ({"trial_cost": "failed-trials"}, "29.6664"),
        # the status before is 0000 and costs nothing: + 1.05
        ({"status_cost": "current"}, "30.344"),
        # 20 less in .6276 of the episodes
        ({"task_bonus": "last-subtask-completed"}, "16.742"),
        ({"task_bonus": "no-subtask-skipped"}, "16.742"),
        # one more timestep on a skip (.6276) and the cost of z: F and C each
        # .3 * (.3 * .5 + .7 * .2) = .087, A 5 * .05 * .5 = .125, D .2 * .5 = .1: together .399
        ({"skip_timestep": "own"}, "28.2674"),
        ({"skip_timestep": "own", "skip_onset": "reset"}, "28.6664"),
        # the first step costs nothing for status, the skip step what it did before: 1.05
        ({"skip_timestep": "own", "status_cost": "current"}, "28.6664"),
    ],
)
def test_readings_on_one_trial_by_hand(readings: dict[str, str], mean: str) -> None:
    evaluation = Oracle(readings, tasks=[1], max_trial=1).evaluate(always("none"))
    assert evaluation["mean"] == Fraction(mean)
    assert evaluation["skip_probability"] == Fraction("0.6276")
    assert evaluation["steps"] == Fraction("1.6276" if "skip_timestep" in readings else "1")


@pytest.mark.parametrize(
    "orientation, skip", [("row-to-column", "0.238575"), ("column-to-row", "0.238385")]
)
def test_second_trial_by_hand(orientation: str, skip: str) -> None:
    # Directive, two trials. 0010 (.04) and 0011 (.01) never clear: anger stays. From 0001 (.19)
    # D clears with .01 and anger stays away with 1 - .05 - .20 (row D, column A), or with
    # 1 - .05 - .10 (row A, column D): .19 * (1 - .01 * .75) or .19 * (1 - .01 * .85), and .05
    readings = {"influence_orientation": orientation, "max_trial_rule": "after"}
    evaluation = Oracle(readings, tasks=[1], max_trial=1).evaluate(always("directive"))
    assert evaluation["skip_probability"] == Fraction(skip)
    assert evaluation["steps"] == Fraction("1.24")


def test_discounting_by_hand() -> None:
    # As above, at 1/2, every trial completing with 0 later: only the timestep is not free here.
    free = {f"reward.{name}": Fraction(0) for name in COMPONENTS if name != "timestep"}
    oracle = Oracle(tasks=[1], max_trial=2, discount=Fraction(1, 2), parameters=free)
    evaluation = oracle.evaluate(always("directive"))
    assert evaluation["mean"] == -1 - Fraction("0.24") / 2
    assert evaluation["variance"] == Fraction("0.24") * Fraction("0.76") / 4
    assert evaluation["steps"] == Fraction("1.24")


@pytest.mark.parametrize(
    "tasks, bonus, mean",
    [
        # Two trials' worth of 0000 under reset: each subtask is completed with .76, independently.
        ([2], "always", "20"),
        ([2], "last-subtask-completed", "15.2"),
        ([2], "no-subtask-skipped", "11.552"),  # 20 * .76 * .76
        ([1, 1], "always", "40"),
        ([1, 1], "last-subtask-completed", "30.4"),
        ([1, 1], "no-subtask-skipped", "30.4"),  # the flag is 1 again in the second task
        ([2, 1], "no-subtask-skipped", "26.752"),
    ],
)
@pytest.mark.parametrize("timestep", ["same", "own"])
def test_task_bonus_by_hand(tasks: list[int], bonus: str, mean: str, timestep: str) -> None:
    readings = {"task_bonus": bonus, "skip_onset": "reset", "skip_timestep": timestep}
    evaluation = Oracle(readings, tasks, max_trial=1).evaluate(always("directive"))
    assert evaluation["components"]["task-complete"] == Fraction(mean)


def percent(*values: int) -> list[Fraction]:
    return [Fraction(value, 100) for value in values]


def test_chances_by_hand() -> None:
    rows, columns = Oracle(), Oracle({"influence_orientation": "column-to-row"})
    assert rows.chances(CLEAR, "none") == percent(30, 30, 5, 20)
    assert rows.chances((0, 0, 1, 0), "none") == percent(37, 38, 100, 30)  # the row of anger
    assert columns.chances((0, 0, 1, 0), "none") == percent(36, 38, 100, 40)  # its column
    assert rows.chances((1, 1, 0, 0), "none") == percent(99, 99, 19, 24)
    assert rows.chances((1, 1, 1, 1), "supportive") == percent(99, 99, 5, 5)
    assert rows.chances((1, 0, 0, 0), "supportive") == percent(99, 35, 0, 0)
    assert rows.chances((1, 1, 0, 0), "non-directive") == percent(40, 60, 19, 24)
    assert rows.chances((1, 0, 0, 1), "directive") == percent(5, 0, 31, 99)


def test_influence_on_present_by_hand() -> None:
    half = {"persistence.forgetfulness": Fraction(1, 2)}
    additive = {"influence_on_present": "additive"}
    both = {**additive, "influence_orientation": "column-to-row"}
    assert Oracle(parameters=half).chances((1, 1, 0, 0), "none")[0] == Fraction("0.5")
    assert Oracle(additive, parameters=half).chances((1, 1, 0, 0), "none")[0] == Fraction("0.57")
    assert Oracle(both, parameters=half).chances((1, 1, 0, 0), "none")[0] == Fraction("0.55")
    assert Oracle(additive).chances((1, 1, 0, 0), "none")[:2] == [1, 1]  # clipped
    assert Oracle(additive).chances((1, 1, 0, 0), "directive")[:2] == percent(5, 5)


def test_skip_chances_by_hand() -> None:
    assert Oracle().skip_chances((1, 1, 1, 1)) == percent(50, 50, 50, 50)
    assert Oracle().skip_chances((1, 0, 0, 1)) == percent(20, 0, 0, 50)
    assert Oracle({"skip_onset": "reset"}).skip_chances((1, 1, 1, 1)) == [0, 0, 0, 0]
    # base: C .3 + .05 + .10 and A .05 + .06 + .20, from F and D in rows; from columns
    # C .3 + .07 + .02 and A .05 + .07 + .10
    rows = Oracle({"skip_onset": "base"})
    columns = Oracle({"skip_onset": "base", "influence_orientation": "column-to-row"})
    assert rows.skip_chances((1, 0, 0, 1)) == percent(20, 45, 31, 50)
    assert columns.skip_chances((1, 0, 0, 1)) == percent(20, 39, 22, 50)


def test_skip_and_last_trial_by_hand() -> None:
    oracle = Oracle({"skip_timestep": "own"}, tasks=[2])
    assert oracle.actions((0, 5, 1, (0, 1, 0, 0))) == ("skip",)
    expected: list[Any] = [
        (Fraction(4, 5), (1, 0, 1, CLEAR), {"timestep": -1, "subtask-skip": -10}, True),
        (
            Fraction(1, 5),
            (1, 0, 1, (0, 1, 0, 0)),
            {"timestep": -1, "subtask-skip": -10, "confuse": -1},
            True,
        ),
    ]
    assert oracle.outcomes((0, 5, 1, (0, 1, 0, 0)), "skip") == expected
    with pytest.raises(ValueError):
        oracle.outcomes((0, 5, 1, (0, 1, 0, 0)), "none")
    with pytest.raises(ValueError):
        oracle.outcomes((0, 0, 1, CLEAR), "skip")
