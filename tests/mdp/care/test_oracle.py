"""The reference model against numbers worked out by hand."""

from fractions import Fraction
from typing import Any

import pytest
from care_oracle import COMPONENTS, Oracle

ONE = {"tasks": [1], "max_trial": 1}
FREE = {f"reward.{name}": Fraction(0) for name in COMPONENTS if name != "timestep"}
ROWS, COLUMNS = ({"influence_orientation": way} for way in ("row-to-column", "column-to-row"))
AFTER, OWN = {"max_trial_rule": "after"}, {"skip_timestep": "own"}
FIGURES: list[tuple[dict[str, str], dict[str, Any], str, dict[str, str]]] = [
    # One subtask, one trial, from status 0000. The base chances are .3, .3, .05 and .2.
    #   none:          0000 next with .7 * .7 * .95 * .8 = .3724; status cost .3 + .3 + 5 * .05 + .2
    #                  = 1.05, so -1 - 1.05 - 1 + .3724 * 50 - .6276 * 10 + 20 = 29.294
    #   supportive:    no onset of A, D: .7 * .7 = .49; cost .6:
    #                  -1 - .6 - 1 + .49 * (50 - 1) - .51 * 10 + 20 = 36.31
    #   non-directive: no onset of F, C: .95 * .8 = .76; cost .25 + .2:
    #                  -1 - .45 - 1 + .76 * (50 - 3) - .24 * 10 + 20 = 50.87
    #   directive:     as before, with 5 for 3: 49.35
    ({}, ONE, "none", {"mean": "29.294", "skip_probability": "0.6276", "steps": "1"}),
    ({}, ONE, "supportive", {"mean": "36.31"}),
    ({}, ONE, "non-directive", {"mean": "50.87"}),
    ({}, ONE, "directive", {"mean": "49.35"}),
    # The trial costs 1 only when it failed: + .3724.
    ({"trial_cost": "failed-trials"}, ONE, "none", {"mean": "29.6664"}),
    # The status before is 0000 and costs nothing: + 1.05.
    ({"status_cost": "current"}, ONE, "none", {"mean": "30.344"}),
    # 20 less in .6276 of the episodes.
    ({"task_bonus": "last-subtask-completed"}, ONE, "none", {"mean": "16.742"}),
    ({"task_bonus": "no-subtask-skipped"}, ONE, "none", {"mean": "16.742"}),
    # One more timestep on a skip (.6276) and the cost of z: F and C each
    # .3 * (.3 * .5 + .7 * .2) = .087, A 5 * .05 * .5 = .125, D .2 * .5 = .1: together .399.
    (OWN, ONE, "none", {"mean": "28.2674", "skip_probability": "0.6276", "steps": "1.6276"}),
    (OWN | {"skip_onset": "reset"}, ONE, "none", {"mean": "28.6664"}),
    # The first step costs nothing for status, the skip step what it did before: 1.05.
    (OWN | {"status_cost": "current"}, ONE, "none", {"mean": "28.6664"}),
    # Two trials. 0010 (.04) and 0011 (.01) never clear: anger stays. From 0001 (.19) D clears with
    # .01 and anger stays away with 1 - .05 - .20 (row D, column A), or with 1 - .05 - .10 (row A,
    # column D): .19 * (1 - .01 * .75) or .19 * (1 - .01 * .85), and .05.
    (ROWS | AFTER, ONE, "directive", {"skip_probability": "0.238575", "steps": "1.24"}),
    (COLUMNS | AFTER, ONE, "directive", {"skip_probability": "0.238385", "steps": "1.24"}),
    # As above, at 1/2, every trial completing with 0 later: only the timestep is not free here.
    ({}, {"tasks": [1], "max_trial": 2, "discount": Fraction(1, 2), "parameters": FREE},
     "directive", {"mean": "-1.12", "variance": "0.0456", "steps": "1.24"}),
    # Under reset each subtask is completed with .76, independently: 20 * .76 * .76 and so on; the
    # flag is 1 again in the second task.
    *(({"task_bonus": bonus, "skip_onset": "reset", "skip_timestep": timestep},
       {"tasks": tasks, "max_trial": 1}, "directive", {"task-complete": mean})
      for timestep in ("same", "own") for tasks, bonus, mean in (
        ([2], "always", "20"), ([2], "last-subtask-completed", "15.2"),
        ([2], "no-subtask-skipped", "11.552"), ([1, 1], "always", "40"),
        ([1, 1], "last-subtask-completed", "30.4"), ([1, 1], "no-subtask-skipped", "30.4"),
        ([2, 1], "no-subtask-skipped", "26.752"))),
]  # fmt: skip


@pytest.mark.parametrize(("readings", "settings", "action", "wanted"), FIGURES)
def test_figures_by_hand(
    readings: dict[str, str], settings: Any, action: str, wanted: dict[str, str]
) -> None:
    figures = Oracle(readings, **settings).evaluate(lambda _: {action: Fraction(1)})
    figures |= figures["components"]
    assert {name: figures[name] for name in wanted} == {n: Fraction(x) for n, x in wanted.items()}


def test_the_optimum_by_hand() -> None:
    oracle = Oracle(**ONE)
    assert oracle.value(oracle.start) == Fraction("50.87")
    assert oracle.optimal_actions(oracle.start) == {"non-directive"}


HALF = {"persistence.forgetfulness": Fraction(1, 2)}
ADDITIVE, BASE = {"influence_on_present": "additive"}, {"skip_onset": "base"}
CHANCES: list[tuple[dict[str, str], dict[str, Fraction], str, str, list[int]]] = [  # in per cent
    ({}, {}, "0000", "none", [30, 30, 5, 20]),
    ({}, {}, "0010", "none", [37, 38, 100, 30]),  # the row of anger
    (COLUMNS, {}, "0010", "none", [36, 38, 100, 40]),  # its column
    ({}, {}, "1100", "none", [99, 99, 19, 24]),
    ({}, {}, "1111", "supportive", [99, 99, 5, 5]),
    ({}, {}, "1000", "supportive", [99, 35, 0, 0]),
    ({}, {}, "1100", "non-directive", [40, 60, 19, 24]),
    ({}, {}, "1001", "directive", [5, 0, 31, 99]),
    ({}, HALF, "1100", "none", [50, 99, 19, 24]),
    (ADDITIVE, HALF, "1100", "none", [57, 100, 19, 24]),
    (ADDITIVE | COLUMNS, HALF, "1100", "none", [55, 100, 20, 37]),
    (ADDITIVE, {}, "1100", "none", [100, 100, 19, 24]),  # clipped
    (ADDITIVE, {}, "1100", "directive", [5, 5, 19, 24]),
    ({}, {}, "1111", "skip", [50, 50, 50, 50]),
    ({}, {}, "1001", "skip", [20, 0, 0, 50]),
    ({"skip_onset": "reset"}, {}, "1111", "skip", [0, 0, 0, 0]),
    # C .3 + .05 + .10 and A .05 + .06 + .20, from F and D in rows; from columns C .3 + .07 + .02
    # and A .05 + .07 + .10.
    (BASE, {}, "1001", "skip", [20, 45, 31, 50]),
    (BASE | COLUMNS, {}, "1001", "skip", [20, 39, 22, 50]),
]


@pytest.mark.parametrize(("readings", "parameters", "status", "action", "wanted"), CHANCES)
def test_chances_by_hand(
    readings: Any, parameters: Any, status: str, action: str, wanted: list[int]
) -> None:
    oracle, now = Oracle(readings, parameters=parameters), tuple(map(int, status))
    chances = oracle.skip_chances(now) if action == "skip" else oracle.chances(now, action)
    assert chances == [Fraction(each, 100) for each in wanted]


def test_skip_and_last_trial_by_hand() -> None:
    oracle, clear, confused = Oracle(OWN, tasks=[2]), (0, 0, 0, 0), (0, 1, 0, 0)
    assert oracle.actions((0, 5, 1, confused)) == ("skip",)
    skip = {"timestep": -1, "subtask-skip": -10}
    assert oracle.outcomes((0, 5, 1, confused), "skip") == [
        (Fraction(4, 5), (1, 0, 1, clear), skip, True),
        (Fraction(1, 5), (1, 0, 1, confused), skip | {"confuse": -1}, True),
    ]
    for state, action in (((0, 5, 1, confused), "none"), ((0, 0, 1, clear), "skip")):
        with pytest.raises(ValueError):
            oracle.outcomes(state, action)
