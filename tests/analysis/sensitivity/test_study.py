"""A table of points and policies against models that are built and solved one by one."""

from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
from made_models import burning

from exact_mdp import (
    MDP,
    Family,
    ModelError,
    Parameter,
    Parametric,
    Scenario,
    evaluate,
    moving,
    parametric,
    solve,
    study,
)

POINTS = {"x": [0.1, "1/3", 0.75]}
READINGS: list[tuple[dict[str, str], list[int]]] = [
    ({}, [2]),
    ({"skip_timestep": "own", "status_cost": "current"}, [1, 1]),
    ({"task_bonus": "no-subtask-skipped", "max_trial_rule": "after"}, [2]),
    ({"skip_onset": "base", "influence_on_present": "additive"}, [1]),
]


def small(seed: int, discount: object) -> Family:
    """Return a random model of a few states, whose chances move with x; of costs where odd."""
    rng = np.random.default_rng(seed)
    states, sense = int(rng.integers(2, 7)), ("max", "min")[seed % 2]
    shape = (states - 1, 3, 2)
    to, gain = rng.integers(states, size=shape), rng.integers(-3, 4, size=shape)

    def build(at: Any) -> MDP:
        x, end = at["x"], states - 1
        left, rows = (1 - x) / 2, []
        for s, a in np.ndindex(shape[:2]):
            (one, two), (high, low) = to[s, a].tolist(), gain[s, a].tolist()
            rows.append((s, a, [(x, one, high * x), (left, two, 1), (left, end, low)]))
        return MDP.from_outcomes([*rows, (end, 0, [(1, end, 0)])], discount, sense=sense)

    return Family(parameters=(Parameter(name="x", value="1/3", low=0, high=1),), build=build)


def care(readings: dict[str, str], tasks: list[int]) -> tuple[Parametric, dict[str, Any]]:
    rng = np.random.default_rng(5)
    names = ["base.anger", "influence.anger.confusion", "reward.trial", "discount"]
    draws = [*rng.random((2, 6)), rng.normal(size=6), 0.5 + rng.random(6) / 2]
    scenario = Scenario.load("yuan2025").with_(readings=readings, tasks=tasks, max_trial=2)
    return parametric(scenario), dict(zip(names, draws, strict=True))


MODELS: list[Any] = [
    *((small(n, g), POINTS, ["random"]) for n in range(12) for g in (1, "9/10", "999/1000")),
    (burning("24/25"), {"fire": [0.05, 0.1, 0.6], "discount": [0.9, 0.96, 0.5]}, ["always:1"]),
    *((*care(*each), ["random", "always:supportive"]) for each in READINGS),
]


@pytest.mark.parametrize("number", range(len(MODELS)))
def test_points_are_those_solved_one_by_one(number: int) -> None:
    model, points, policies = MODELS[number]
    table = study(model, points, ["optimal", *policies], n_jobs=2)
    for row, values in enumerate(zip(*points.values(), strict=True)):
        mdp = model.at(dict(zip(points, values, strict=True)))
        best = solve(mdp).start
        assert abs(table.optimal[row] - best.value) <= table.error[row, 0] + best.error
        assert table.regret[row].min() >= 0
        for n, policy in enumerate(policies, 1):
            own = evaluate(mdp, policy).start
            assert abs(table.fixed[row, n] - own.value) <= table.error[row, n + 1] + own.error
            lost = abs(best.value - own.value)
            assert table.regret[row, n] == pytest.approx(lost, abs=1e-8)
        assert table.error[row].max() < 1e-9


def test_points_are_the_numbers_that_were_given() -> None:
    """A float beside a fraction in words stays the float that it is."""
    table = study(small(0, 1), {"x": [0.1, "1/10", 0.5]})
    assert table.points[:, 0].tolist() == [F(0.1), F(1, 10), F(1, 2)]
    assert table.frame()["x"].tolist() == [0.1, 0.1, 0.5]


TWO = moving(
    MDP.from_outcomes(
        [(0, 0, [("1/3", s, 1) for s in (1, 2, 3)]), *((s, 0, [(1, s, 0)]) for s in (1, 2, 3))]
    ),
    {"a": [(0, 1)], "b": [(0, 2)]},
)


@pytest.mark.parametrize(
    ("points", "message", "where"),
    [
        ({"a": [0.5, 0.5], "b": [0.25, 0.75]}, "more than 1", "draw 1, a = 0.5, b = 0.75"),
        ({"a": [0.5], "b": [1.5]}, "outside", "draw 0"),
        ({"a": [0.5], "b": [float("nan")]}, "outside", "draw 0"),
        ({"a": [1], "b": [1, 2]}, "columns of shape", ""),
        ({"a": [[1, 2]]}, "columns of shape", ""),
        ({"a": []}, "no points", ""),
        ({}, "none", ""),
        ({"as": [1]}, "unknown parameter 'as'", ""),
    ],
)
def test_points_that_make_no_models_are_refused(points: Any, message: str, where: str) -> None:
    with pytest.raises(ModelError, match=message) as refused:
        study(TWO, points)
    assert where in refused.value.where


def test_a_model_may_have_more_actions_than_a_short_integer_counts() -> None:
    mdp = MDP.from_arrays(np.ones((40_000, 1, 1)), [[*range(40_000)]], "1/2")
    assert study(mdp, {"discount": ["1/4"]}).rows.tolist() == [[39_999]]
