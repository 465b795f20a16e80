"""Draws of models, Sobol indices of known functions, pieces of ranges."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction as F
from importlib import import_module
from math import isfinite
from random import Random
from typing import Any

import numpy as np
import pytest
from cli_runner import run
from made_models import burning
from scipy import stats

from exact_mdp import (
    MDP,
    BackwardInduction,
    Bounded,
    ModelError,
    Parameter,
    Parametric,
    Range,
    Scenario,
    certify,
    evaluate,
    moving,
    parametric,
    sobol,
    solve,
    tornado,
)
from exact_mdp.analysis.vary.one_way import Point
from exact_mdp.analysis.vary.ranges import around, spans_of
from exact_mdp.analysis.vary.study import Study, lost_by, study
from exact_mdp.mdp.care import scenario as care_scenario

sobol_module = import_module("exact_mdp.analysis.vary.sobol")
solver_module = import_module("exact_mdp.analysis.vary.study")
HALF = F(1, 2)


def chain() -> Parametric:
    """V = p (2 + q (3 + 4 r)): each step is passed with its own probability, or all is over."""
    gains, end = (2, 3, 4), 3
    rows: list[Any] = [
        (state, 0, [(HALF, min(state + 1, end), gain), (HALF, 4, 0)])
        for state, gain in enumerate(gains)
    ]
    rows += [(3, 0, [(1, 3, 0)]), (4, 0, [(1, 4, 0)])]
    return moving(MDP.from_outcomes(rows, 1), {n: [(i, i + 1)] for i, n in enumerate("pqr")})


class Told:
    """What `study` gives, of a function of the draws."""

    def __init__(self, function: Callable[[np.ndarray], np.ndarray]) -> None:
        self.function, self.value = function, np.empty(0)

    def __call__(self, model: Parametric, points: Any, *_: Any) -> Study:
        names, draws = tuple(points), np.column_stack(list(points.values()))
        self.value = self.function(draws)
        none = np.zeros((len(draws), 2))
        which = np.zeros(len(draws), dtype=int)
        return Study(
            names=names,
            points=draws,
            optimal=self.value,
            fixed=self.value[:, None],
            error=none,
            rows=np.zeros((1, 1), dtype=int),
            which=which,
        )


def columns(names: list[str], draws: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(names, draws.T, strict=True))


def ishigami(x: np.ndarray) -> np.ndarray:
    """Ishigami and Homma (1990): sin x1 + 7 sin² x2 + x3⁴ sin(x1) / 10."""
    return np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + x[:, 2] ** 4 * np.sin(x[:, 0]) / 10


def test_the_indices_of_ishigami(monkeypatch: pytest.MonkeyPatch) -> None:
    """Worked out by hand: Var = 49/8 + π⁴/50 + π⁸/1800 + 1/2; x3 weighs with x1 alone."""
    pi = np.pi
    rewards = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 2)]), (0, 2, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])]
    names = [f"reward.{n}" for n in (1, 2, 3)]
    told = Told(ishigami)
    monkeypatch.setattr(sobol_module, "study", told)
    how: dict[str, Any] = {"ranges": dict.fromkeys(names, (-pi, pi)), "n": 2**13}
    found = sobol(MDP.from_outcomes(rewards), rng=0, **how).optimal
    variance = 49 / 8 + pi**4 / 50 + pi**8 / 1800 + 1 / 2
    alone = np.array([(1 + pi**4 / 50) ** 2 / 2, 49 / 8, 0]) / variance
    joint = pi**8 * (1 / 18 - 1 / 50) / 100 / variance
    np.testing.assert_allclose(found.first, alone, atol=3e-3)
    np.testing.assert_allclose(found.total, alone + np.array([joint, 0, joint]), atol=3e-3)
    assert found.sd == pytest.approx(variance**0.5, rel=1e-3)
    # The same numbers by scipy, of the same draws.
    output = told.value.reshape(2**13, 5)
    theirs = stats.sobol_indices(
        func={"f_A": output[:, :1].T, "f_B": output[:, -1:].T, "f_AB": output[:, 1:-1].T[:, None]},
        n=2**13,
    )
    np.testing.assert_allclose(found.first, theirs.first_order, atol=1e-12)
    np.testing.assert_allclose(found.total, theirs.total_order, atol=1e-12)


def test_intervals_cover_as_often_as_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of x1 + 2 x2, both indices are 1/5 and 4/5; intervals are those of a random sample."""
    rewards = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])]
    monkeypatch.setattr(sobol_module, "study", Told(lambda x: x[:, 0] + 2 * x[:, 1]))
    how: dict[str, Any] = {"ranges": {"reward.1": (0, 1), "reward.2": (0, 1)}, "n": 64}
    for seed in range(20):
        found = sobol(MDP.from_outcomes(rewards), rng=seed, **how).optimal
        for index, half in ((found.first, found.first_half), (found.total, found.total_half)):
            assert (np.abs(index - [0.2, 0.8]) < half).all()
            assert (half < 0.5).all()


# ---- draws ---------------------------------------------------------------------------------------


def test_draws_of_a_published_model_are_solved_one_by_one() -> None:
    model = burning("24/25")
    draws = np.array([[0.05, 0.9], [0.1, 0.96], [0.6, 0.5]])
    found = study(model, columns(["fire", "discount"], draws), ["optimal", "always:1"], n_jobs=2)
    for row, (fire, discount) in enumerate(draws.tolist()):
        at = model.at({"fire": fire, "discount": discount})
        assert found.optimal[row] == pytest.approx(solve(at).start_value, abs=1e-9)
        assert found.fixed[row, 1] == pytest.approx(evaluate(at, "always:1").mean, abs=1e-9)
    assert (found.regret >= 0).all()
    assert found.regret[1].tolist() == [0, pytest.approx(found.optimal[1] - found.fixed[1, 1])]
    assert found.regret[1, 1] > 1
    indices = sobol(model, names=["fire", "discount"], n=32, rng=0)
    assert indices.frame()["parameter"][0] == "discount"


@pytest.mark.parametrize(
    "readings, tasks",
    [
        ({}, [2]),
        ({"skip_timestep": "own", "status_cost": "current"}, [1, 1]),
        ({"task_bonus": "no-subtask-skipped", "max_trial_rule": "after"}, [2]),
        ({"skip_onset": "base", "influence_on_present": "additive"}, [1]),
    ],
)
def test_compiled_draws_of_a_scenario_are_those_of_models_built_one_by_one(
    readings: dict[str, str], tasks: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = Scenario.load("yuan2025").with_(readings=readings, tasks=tasks, max_trial=2)
    model = parametric(scenario)
    rng = np.random.default_rng(5)
    names = ["base.anger", "influence.anger.confusion", "reward.trial", "discount"]
    draws = np.column_stack([*rng.random((2, 6)), rng.normal(size=6), 0.5 + rng.random(6) / 2])
    policies = ["optimal", "random", "always:supportive"]
    found = study(model, columns(names, draws), policies, n_jobs=2)
    monkeypatch.setattr(solver_module, "MOST_STATUSES", 0)
    slow = study(model, columns(names, draws), policies)
    np.testing.assert_allclose(found.optimal, slow.optimal, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.fixed, slow.fixed, rtol=0, atol=1e-9)
    assert (abs(found.optimal - slow.optimal) <= found.error[:, 0] + slow.error[:, 0]).all()
    np.testing.assert_allclose(found.regret, slow.regret, rtol=0, atol=1e-8)


def test_care_parameters_without_range_are_left_out() -> None:
    model = parametric(Scenario.load("yuan2025"))
    spans = spans_of(model)
    zero = {parameter.name for parameter in model.parameters if parameter.value == 0}
    assert zero
    others = {p.name for p in model.parameters} - zero - {"discount"}
    assert {parameter.name for parameter in spans} == others
    assert [each.name for each in spans_of(model, ["discount"])] == ["discount"]
    assert [each.name for each in spans_of(model, None, {"discount": ("1/2", 1)})] == ["discount"]
    # A plain model has its rewards varied.
    plain = [each.name for each in spans_of(parametric(chain().at({})))]
    assert plain == ["reward.2", "reward.3", "reward.4"]
    assert all(span.low < span.high for span in spans.values())


def test_probabilities_that_sum_to_more_than_one_name_the_draw() -> None:
    rows = [(0, 0, [(F(1, 3), 1, 1), (F(1, 3), 2, 0), (F(1, 3), 3, 0)])]
    rows += [(s, 0, [(1, s, 0)]) for s in (1, 2, 3)]
    model = moving(MDP.from_outcomes(rows, 1), {"a": [(0, 1)], "b": [(0, 2)]})
    with pytest.raises(ModelError, match="more than 1") as caught:
        study(model, columns(["a", "b"], np.array([[0.5, 0.25], [0.5, 0.75]])))
    assert caught.value.where.startswith("draw 1")
    for draws, message in (
        (np.zeros((0, 2)), "no points"),
        (np.array([[0.5, 1.5]]), "outside"),
        (np.array([[0.5, np.nan]]), "outside"),
    ):
        with pytest.raises(ModelError, match=message):
            study(model, columns(["a", "b"], draws))


def test_optimal_actions_beside_infinite_states() -> None:
    """The pairs that lose nothing in a draw are those that the exact certificate calls optimal."""
    compared = 0
    for seed in range(100):
        rng, sign = Random(seed), 1 - 2 * (seed % 2)
        size = rng.randint(3, 5)
        rows = [(0, 0, [(1, size, 2 * sign)]), (size, 0, [(1, size, 0)])]
        for state in range(size):
            for action in range(not state, rng.randint(1, 2) + (not state)):
                to = rng.sample(range(size), rng.randint(1, 2))
                gains = [F(sign * rng.choice([-2, -1, -1, 0, 1])) for _ in to]
                row = [(F(1, len(to)), t, gain) for t, gain in zip(to, gains, strict=True)]
                rows.append((state, action, row))
        mdp = MDP.from_outcomes(rows).with_(sense="max" if sign > 0 else "min")
        try:
            exact, found = certify(mdp), solve(mdp)
        except ModelError:
            continue
        if not isfinite(exact.start_value) or np.isfinite(found.value).all():
            continue
        compared += 1
        gap, noise = lost_by(mdp, found)
        doubt = found.state_error
        near = gap <= doubt[mdp.pair_state] + mdp.transition @ doubt + noise
        assert near.tolist() == exact.optimal_pairs.tolist()
    assert compared >= 10


SMALL = {"tasks": [1], "max_trial": 2}
SET = ("--set", "tasks=[1]", "--set", "max_trial=2")


def scenario(**readings: str) -> Scenario:
    return Scenario.load("yuan2025").with_(readings=readings, **SMALL)


# ---- parametric models -----------------------------------------------------------------------


def test_a_wide_range_ends_where_the_parameter_does() -> None:
    rare = Parameter(name="p", value=F(1, 10), low=F(0), high=F(1))
    assert around(rare, 2) == Range(low=F(0), high=F(3, 10))
    often = Parameter(name="p", value=F(9, 10), low=F(0), high=F(1))
    assert around(often, "1/2") == Range(low=F(9, 20), high=F(1))
    assert around(Parameter(name="r", value=F(-5)), 2) == Range(low=F(-15), high=F(5))
    (bar,) = tornado(scenario(), names=["base.anger"], relative=2).bars
    assert (bar.low.at, bar.high.at) == (0, F(3, 20))


def test_a_bar_of_a_care_model_compiles_and_solves_the_base_alone(monkeypatch) -> None:
    done = {"compiled": 0, "solved": 0}

    def count(name: str, place: object, what: str) -> None:
        real = getattr(place, what)

        def counted(*given):
            done[name] += 1
            return real(*given)

        monkeypatch.setattr(place, what, counted)

    count("compiled", care_scenario, "compile_scenario")
    count("solved", BackwardInduction, "solve")
    (bar,) = tornado(scenario(), names=["base.anger"]).bars
    assert bar.swing > 0
    assert done == {"compiled": 1, "solved": 1}
    done.update(compiled=0, solved=0)
    words = ("--parameter", "base.anger", "--json")
    found = run("tornado", "yuan2025", *SET, *words).result
    assert found["bars"][0]["swing"] == bar.swing
    assert done == {"compiled": 1, "solved": 1}


def test_the_regret_of_a_point_is_as_uncertain_as_both_values() -> None:
    optimal, fixed = Bounded(value=5.0, error=0.25), Bounded(value=3.0, error=0.5)
    regret = Point(optimal=optimal, fixed=fixed).regret
    assert regret.value == 2
    assert 0.75 <= regret.error <= 0.76
    low, high = regret.interval
    assert low <= optimal.interval[0] - fixed.interval[1]
    assert high >= optimal.interval[1] - fixed.interval[0]
