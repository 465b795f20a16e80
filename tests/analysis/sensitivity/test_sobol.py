"""Sobol indices against closed forms and scipy's; draws of whole models; seeds."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forest import burning
from scipy import stats

from exact_mdp import (
    MDP,
    ModelError,
    Parametric,
    Scenario,
    evaluate,
    moving,
    parametric,
    sobol,
    solve,
)
from exact_mdp.analysis.sensitivity.draws.sampled import Sampled, sampled
from exact_mdp.analysis.sensitivity.ranges import spans_of

sobol_module = import_module("exact_mdp.analysis.sensitivity.draws.sobol")
solver_module = import_module("exact_mdp.analysis.sensitivity.draws.solver")
F = Fraction
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


def choice() -> Parametric:
    """V = max(p, q): two actions, each earns 1 with its own probability."""
    rows = [
        (0, 0, [(HALF, 1, 1), (HALF, 2, 0)]),
        (0, 1, [(HALF, 1, 1), (HALF, 2, 0)]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
    return moving(MDP.from_outcomes(rows, 1), {"p": [(0, 1)], "q": [(1, 1)]})


CHAIN_RANGES = {"p": (F(1, 2), F(9, 10)), "q": (F(1, 10), F(3, 5)), "r": (0, 1)}


def mean(low: F, high: F) -> F:
    return (low + high) / 2


def square(low: F, high: F) -> F:
    """E[x²] of a uniform x."""
    return (low * low + low * high + high * high) / 3


def closed_form() -> tuple[F, dict[str, F], dict[str, F]]:
    """Variance, first-order and total indices of p (2 + q (3 + 4 r)), worked out by hand.

    With m for means and s for second moments, u = 3 + 4 r, w = 2 + q u:
    E[w] = 2 + m_q m_u,  E[w²] = 4 + 4 m_q m_u + s_q s_u,  V = p w.
    """
    spans = {name: tuple(map(F, span)) for name, span in CHAIN_RANGES.items()}
    m = {name: mean(*span) for name, span in spans.items()}
    s = {name: square(*span) for name, span in spans.items()}
    m_u, s_u = 3 + 4 * m["r"], 9 + 24 * m["r"] + 16 * s["r"]
    v = {name: s[name] - m[name] ** 2 for name in "pqr"}
    v_u = s_u - m_u**2
    m_w, s_w = 2 + m["q"] * m_u, 4 + 4 * m["q"] * m_u + s["q"] * s_u
    variance = s["p"] * s_w - (m["p"] * m_w) ** 2
    first = {
        "p": v["p"] * m_w**2,
        "q": m["p"] ** 2 * m_u**2 * v["q"],
        "r": m["p"] ** 2 * m["q"] ** 2 * v_u,
    }
    total = {"p": v["p"] * s_w, "q": s["p"] * s_u * v["q"], "r": s["p"] * s["q"] * v_u}
    return (
        variance,
        {name: part / variance for name, part in first.items()},
        {name: part / variance for name, part in total.items()},
    )


# ---- Sobol ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def of_chain() -> Any:
    return sobol(chain(), ranges=CHAIN_RANGES, n=128, rng=0)


def test_indices_are_those_of_the_closed_form(of_chain: Any) -> None:
    variance, first, total = closed_form()
    assert of_chain.names == ("p", "q", "r")
    assert of_chain.draws == 128 * 5
    found = of_chain.optimal
    assert found.sd == pytest.approx(float(variance) ** 0.5, rel=0.02)
    for place, name in enumerate("pqr"):
        assert found.first[place] == pytest.approx(float(first[name]), abs=0.02)
        assert found.total[place] == pytest.approx(float(total[name]), abs=0.02)
        # The intervals are of a purely random sample and wider than the scrambled one's error.
        assert abs(found.first[place] - float(first[name])) < found.first_half[place] < 0.2
        assert abs(found.total[place] - float(total[name])) < found.total_half[place] < 0.2
    assert of_chain.regret.constant
    assert of_chain.regret.mean == 0
    np.testing.assert_allclose(of_chain.fixed.first, found.first, atol=1e-9)


def test_the_maximum_of_two_and_the_regret_of_one_have_known_indices() -> None:
    """Var max(p, q) = 1/18, of which 1/45 is each one's own; so is the regret's, max(0, q - p)."""
    found = sobol(choice(), policy="always:0", ranges={"p": (0, 1), "q": (0, 1)}, n=512, rng=1)
    for output in (found.optimal, found.regret):
        np.testing.assert_allclose(output.first, [0.4, 0.4], atol=0.06)
        np.testing.assert_allclose(output.total, [0.6, 0.6], atol=0.06)
        assert (abs(output.first - 0.4) < output.first_half).all()
        assert output.sd == pytest.approx((1 / 18) ** 0.5, rel=0.02)
    assert found.regret.mean == pytest.approx(1 / 6, rel=0.02)
    np.testing.assert_allclose(found.fixed.first, [1, 0], atol=0.02)


def same(a: Any, b: Any) -> bool:
    return all(
        np.array_equal(value, getattr(getattr(b, output), name), equal_nan=True)
        for output in ("optimal", "fixed", "regret")
        for name, value in vars(getattr(a, output)).items()
    )


def test_seed_zero_is_a_seed_and_workers_change_nothing(tmp_path: Path) -> None:
    how: dict[str, Any] = {"policy": "always:0", "ranges": {"p": (0, 1), "q": (0, 1)}, "n": 16}
    first = sobol(choice(), rng=0, **how)
    np.random.seed(1)  # noqa: NPY002 - what others do with the global generator plays no part
    assert same(sobol(choice(), rng=0, n_jobs=2, folder=tmp_path, **how), first)
    assert same(sobol(choice(), rng=0, folder=tmp_path, **how), first)
    assert not same(sobol(choice(), rng=1, **how), first)
    with pytest.raises(ModelError, match="differs in"):
        sobol(choice(), rng=1, folder=tmp_path, **how)


class Told:
    """What `sampled` gives, of a function of the draws."""

    def __init__(self, function: Callable[[np.ndarray], np.ndarray]) -> None:
        self.function, self.value = function, np.empty(0)

    def __call__(self, model: Parametric, names: Any, draws: np.ndarray, *_: Any) -> Sampled:
        self.value = self.function(draws)
        none = np.zeros((len(draws), 2))
        return Sampled(optimal=self.value, fixed=self.value[:, None], error=none)


def ishigami(x: np.ndarray) -> np.ndarray:
    """Ishigami and Homma (1990): sin x1 + 7 sin² x2 + x3⁴ sin(x1) / 10."""
    return np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + x[:, 2] ** 4 * np.sin(x[:, 0]) / 10


def test_the_indices_of_ishigami(monkeypatch: pytest.MonkeyPatch) -> None:
    """Worked out by hand: Var = 49/8 + π⁴/50 + π⁸/1800 + 1/2; x3 weighs with x1 alone."""
    pi = np.pi
    rewards = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 2)]), (0, 2, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])]
    names = [f"reward.{n}" for n in (1, 2, 3)]
    told = Told(ishigami)
    monkeypatch.setattr(sobol_module, "sampled", told)
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
    monkeypatch.setattr(sobol_module, "sampled", Told(lambda x: x[:, 0] + 2 * x[:, 1]))
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
    found = sampled(model, ["fire", "discount"], draws, ["optimal", "always:1"], n_jobs=2)
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
    found = sampled(model, names, draws, policies, n_jobs=2)
    monkeypatch.setattr(solver_module, "MOST_STATUSES", 0)
    slow = sampled(model, names, draws, policies)
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


def test_an_index_that_is_not_there_is_not_a_number(of_chain: Any) -> None:
    frame = of_chain.frame("regret")
    assert frame["total (share of variance)"].isna().all()
    assert frame.attrs["sd (reward)"] == 0
    assert set(of_chain.frame()["claim"]) == {"estimated"}
    assert of_chain.frame()["parameter"][0] == "q"
    with pytest.raises(ModelError, match="unknown output"):
        of_chain.frame("loss")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"n": 0}, "0 samples"),
        ({"n": 100}, "not a power of 2"),
        ({"n": True}, "True samples"),
        ({"rng": -1}, "-1 is not a source"),
        ({"names": ["x"]}, "unknown parameter 'x'"),
        ({"ranges": {"p": (HALF, HALF)}}, "empty"),
        ({"ranges": {"p": (0, 2)}}, "outside"),
        ({"confidence": 1.0}, "confidence"),
        ({"relative": F(0)}, "share of 0"),
        ({"policy": "nobody"}, "nobody"),
        ({"n_jobs": 0}, "n_jobs"),
    ],
)
def test_bad_requests_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        sobol(choice(), **({"n": 4, "rng": 0} | change))


def test_probabilities_that_sum_to_more_than_one_name_the_draw() -> None:
    rows = [(0, 0, [(F(1, 3), 1, 1), (F(1, 3), 2, 0), (F(1, 3), 3, 0)])]
    rows += [(s, 0, [(1, s, 0)]) for s in (1, 2, 3)]
    model = moving(MDP.from_outcomes(rows, 1), {"a": [(0, 1)], "b": [(0, 2)]})
    with pytest.raises(ModelError, match="more than 1") as caught:
        sampled(model, ["a", "b"], np.array([[0.5, 0.25], [0.5, 0.75]]))
    assert caught.value.where.startswith("draw 1")
    for draws, message in (
        (np.zeros((0, 2)), "no draws"),
        (np.zeros((3, 1)), "shape"),
        (np.array([[0.5, 1.5]]), "outside"),
        (np.array([[0.5, np.nan]]), "outside"),
    ):
        with pytest.raises(ModelError, match=message):
            sampled(model, ["a", "b"], draws)


def test_the_spread_of_small_rewards_is_a_spread() -> None:
    """Shares of variance do not depend on the unit of reward."""
    half, found = HALF, []
    for unit in (F(1), F(1, 2**40)):
        rows = [(0, 0, [(half, 1, 5 * unit), (half, 2, 0)]), (1, 0, [(1, 3, unit)])]
        rows += [(2, 0, [(F(1, 3), 3, 0), (F(2, 3), 1, 2 * unit)]), (3, 0, [(1, 3, 0)])]
        model = moving(MDP.from_outcomes(rows), {"p": [(0, 1)], "q": [(2, 1)]})
        found.append(sobol(model, n=32, rng=1).optimal)
    assert found[1].sd == pytest.approx(found[0].sd / 2**40, rel=1e-9, abs=0)
    assert found[1].total == pytest.approx(found[0].total)
