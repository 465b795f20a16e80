"""Discounts next to 1 in compiled and plain loops: shifts, ties, digits that are kept."""

import warnings
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
from made_models import classes, sparse

from exact_mdp import (
    MDP,
    GaussSeidel,
    ModifiedPolicyIteration,
    Status,
    ValueIteration,
    certify,
    evaluate,
    solve,
)
from exact_mdp.mdp.table import COMPILED
from exact_mdp.solvers.bounds import gains as gains_module
from exact_mdp.solvers.bounds import sweeps as sweeps_module
from exact_mdp.solvers.bounds.bounds import Bounds, margin_weights
from exact_mdp.solvers.bounds.sweeps import CompiledSweeps, Sweeps
from exact_mdp.solvers.dynamic.known import greedy_of
from exact_mdp.solvers.dynamic.policy_iteration import improved
from exact_mdp.solvers.dynamic.stopping import Iterate
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.unending import model_of


def howard(model: MDP) -> Bounds:
    """Bounds around what policy iteration finds by equations alone, without rounds."""
    return improved(model, greedy_of(model, None), 1000)[0]


def ring(states: int, near: int, discount: float) -> MDP:
    """States on a ring, half of their rows off by up to what is allowed."""
    rng, pairs = np.random.default_rng(1), 3 * states
    rows = (
        np.repeat(np.arange(states), 3)[:, None] + rng.integers(-near, near + 1, (pairs, 3))
    ) % states
    weight = rng.dirichlet(np.ones(3), pairs) * (1 - rng.choice([0, 1e-10, 9e-10], size=(pairs, 1)))
    return sparse(rows, weight, rng.normal(size=pairs), discount)


def alike(states: int, discount: float) -> MDP:
    """Dense rows, and rewards that differ by little."""
    chances = np.random.default_rng(0).random((2, states, states))
    chances /= chances.sum(axis=2, keepdims=True)
    rewards = 1 + np.random.default_rng(1).random((states, 2)) * 1e-9
    return MDP.from_arrays(chances, rewards, discount=discount)


CLOSE = {
    "ring, 1e-9": (ring(3000, 3, 1 - 1e-9), None),
    "classes, rare": (classes("rare", 1 - 1e-8), None),
    "classes, integers": (classes("int", 1 - 1e-9), None),
    **{f"alike, {n}": (alike(100, 1 - 10.0**-n), None) for n in (7, 8, 9)},
    "alike, tol": (alike(100, 1 - 1e-6), 1e-4),
}


@pytest.mark.parametrize("name", CLOSE)
def test_pairs_that_differ_by_little_are_told_apart(name: str) -> None:
    model, tol = CLOSE[name]
    found, other = solve(model, tol=tol), howard(model)
    assert found.status is Status.CONVERGED
    assert found.iterations < 500
    assert (np.abs(found.value - other.value) <= found.state_error + other.state_error).all()


def test_at_the_limit_of_double_precision_the_bounds_still_hold() -> None:
    """Moving to the middle of bounds went astray, to 1e23 where values are 1e12."""
    model = ring(3000, 1, 1 - 1e-12)
    with pytest.warns(UserWarning, match="double precision reaches its limit"):
        found = solve(model)
    other = howard(model)
    assert found.iterations < 150
    assert found.error_bound < 2e-3 * np.abs(found.value).max()
    assert (np.abs(found.value - other.value) <= found.state_error + other.state_error).all()


@pytest.mark.parametrize("seed", range(8))
def test_improving_passes_choose_as_judging_ones_do(seed: int) -> None:
    """By what a pair adds to h + c w, all of it: the margins of a state's pairs differ."""
    rng = np.random.default_rng(seed)
    chances = rng.dirichlet(np.ones(6), (4, 6)) * (1 - rng.uniform(0, 9e-10, (4, 6, 1)))
    model = MDP.from_arrays(chances, rng.normal(size=(6, 4)), discount=1 - 1e-9)
    fast, slow = (kind(model, margin_weights(model)) for kind in (CompiledSweeps, Sweeps))
    for shift in (0.0, 1e9, 1.1e9, -3e10, 1e8):
        value = rng.normal(size=6)
        one, other = fast.improve(value, shift), slow.improve(value, shift)
        np.testing.assert_array_equal(fast.policy, slow.policy)
        np.testing.assert_allclose(one.step, other.step, rtol=1e-12, atol=1e-14 * (1 + abs(shift)))


def leaking(seed: int) -> MDP:
    """A random model next to discount 1, half of its rows off by up to what is allowed."""
    rng = np.random.default_rng(seed)
    states, actions = int(rng.integers(2, 8)), int(rng.integers(1, 4))
    chances = rng.dirichlet(np.ones(states), (actions, states))
    if seed % 2:
        chances = np.eye(states)[rng.integers(states, size=(2, actions, states))].mean(axis=0)
    chances *= 1 - rng.choice([0.0, 1e-11, 1e-10, 9e-10], size=(actions, states, 1))
    reward = rng.integers(-3, 4, (states, actions)) * 1.0
    discount = 1 - 2.0 ** -rng.integers(26, 50)
    return MDP.from_arrays(chances, reward, discount, layout="ass")


@pytest.mark.parametrize("tol", [None, 1e-3])
@pytest.mark.parametrize("seed", range(100, 112))
def test_loops_of_large_models_bound_what_rational_arithmetic_proves(
    seed: int, tol: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweeps_module, "COMPILED", 0)
    model = leaking(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = ModifiedPolicyIteration(tol=tol, max_iterations=300).solve(model)
    for value, exact, error in zip(
        found.value, certify(model).value, found.state_error, strict=True
    ):
        assert abs(F(float(value)) - exact) <= F(float(error))


def one_way(states: int, discount: float, seed: int) -> MDP:
    """Ways round a ring that all earn 1, some of their rows off."""
    rng, pairs = np.random.default_rng(seed), 4 * states
    rows = (np.repeat(np.arange(states), 4)[:, None] + rng.integers(0, 3, (pairs, 3))) % states
    weight = rng.dirichlet(np.ones(3), pairs)
    weight *= 1 - 1e-10 * rng.random((pairs, 1)) * (rng.random((pairs, 1)) < 0.4)
    return sparse(rows, weight, np.ones(pairs), discount)


def in_circles(discount: float) -> MDP:
    """Whole rewards along ways on which nothing is drawn: policies tie, or lose 1.5 in all."""
    after = [1, 3, 2, 2, 3, 1, 1, 2, 3, 0, 1, 1]
    reward = [3, -2, 1, 1, -2, -1, -1, -3, 0, -3, 1, -1]
    state, action = [0, 0, 0, 1, 1, 2, 2, 2, 3, 3, 3, 3], [0, 1, 2, 0, 1, 0, 1, 2, 0, 1, 2, 3]
    return MDP.from_pairs(state, action, np.eye(4)[after], reward, discount=discount)


TIED = [
    *((one_way(states, 1 - 1e-9, seed), None) for states, seed in ((40, 2), (60, 4))),
    *((one_way(40, 1 - 1e-9, seed), 1e-6) for seed in (2, 8)),
    *((in_circles(1 - 2.0**-n), None) for n in range(47, 53)),
]


@pytest.mark.parametrize("least", [0, COMPILED])
@pytest.mark.parametrize(("model", "tol"), TIED)
def test_ties_do_not_make_policies_alternate(
    model: MDP, tol: Any, least: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By rounding, the first pair that ties loses more in all than another state gains."""
    for module in (gains_module, sweeps_module):
        monkeypatch.setattr(module, "COMPILED", least)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found, other = solve(model, tol=tol), howard(model)
    assert found.iterations < (150 if model.n_states > 4 else 40)
    assert (np.abs(found.value - other.value) <= found.state_error + other.state_error).all()


@pytest.mark.parametrize(("error", "relaxed"), [(1.0, 2), (1e-9, 0)])
def test_news_is_not_carried_on_where_it_is_rounding(
    error: float, relaxed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, calls = CLOSE["alike, 7"][0], list[bool]()
    values = Iterate(CompiledSweeps(model, margin_weights(model)), np.zeros(model.n_states))
    for _ in range(4):
        values.take(values.improve())
    monkeypatch.setattr(values.sweeps, "relax", lambda *_, backward: calls.append(backward))
    values.correct(1e-6, error=error)
    assert len(calls) == relaxed
    assert abs(values.shift) > 0.9e7


def beside_an_end(exponent: int) -> MDP:
    """Four states that no way leads out of, beside one in which all is over."""
    state, action = [0, 1, 1, 2, 2, 3, 3, 3, 4, 4, 4, 4], [0, 0, 1, 0, 1, 0, 1, 2, 0, 1, 2, 3]
    after = np.eye(5)[[0, 1, 3, 1, 4, 4, 1, 3, 4, 4, 3, 4]]
    reward = [0, -0.33, -0.42, -0.46, 0.44, 0.14, -0.48, -0.38, 0.21, 0.38, -0.21, -0.47]
    return MDP.from_pairs(state, action, after, reward, discount=1 - 2.0**-exponent)


@pytest.mark.parametrize("kind", [ModifiedPolicyIteration, GaussSeidel, ValueIteration])
@pytest.mark.parametrize("exponent", [25, 30, 40, 51])
@pytest.mark.parametrize("least", [0, COMPILED])
def test_an_end_that_nothing_leads_to_costs_no_digits(
    kind: Any, exponent: int, least: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (gains_module, sweeps_module):
        monkeypatch.setattr(module, "COMPILED", least)
    model = beside_an_end(exponent)
    found = kind().solve(model)
    assert found.status is Status.CONVERGED
    assert found.iterations < 10
    for value, exact, error in zip(
        found.value, certify(model).value, found.state_error, strict=True
    ):
        assert abs(F(float(value)) - exact) <= F(float(error))


def test_a_mixed_policy_is_evaluated_as_the_model_that_it_makes() -> None:
    chances = np.random.default_rng(0).dirichlet(np.ones(4), (2, 4))
    model = MDP.from_arrays(chances, [[1, 2]] * 4, discount=1 - 1e-9)
    chain = PolicyChain.of(model, np.tile([0.3, 0.7], 4))
    exact = certify(model_of(chain)).value
    found, plain = evaluate(model, np.tile([0.3, 0.7], 4)), chain.discounted.solve(*chain.reward)
    assert (np.abs(found.value - plain.value) <= found.error + plain.error).all()
    for value, wanted, error in zip(found.value, exact, found.error, strict=True):
        assert abs(F(float(value)) - wanted) <= F(float(error))
