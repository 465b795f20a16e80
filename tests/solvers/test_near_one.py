"""Discounts next to 1: no run that gains nothing, and no bound or word that is untrue."""

import warnings
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from made_models import classes

from exact_mdp import (
    MDP,
    GaussSeidel,
    PolicyIteration,
    ValueIteration,
    certify,
    check,
    evaluate,
    solve,
)


def test_an_audit_that_bounds_leave_open_says_so() -> None:
    model = classes("int", 1 - 1e-6)
    actions = solve(model).policy.rule.copy()
    actions[5] = (actions[5] + 1) % 3
    lost = check(model, actions).regret.at_start
    found = [check(model, actions, max_regret=lost.value + k * lost.error) for k in (-2, 0, 2)]
    assert [(each.passed, each.undecided) for each in found] == [
        (False, False),
        (False, True),
        (True, False),
    ]
    assert "; failed: " in repr(found[0])
    assert "; failed, left open: " in repr(found[1])
    assert "the bounds do not decide" in found[1].verdicts[0].text


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("exponent", [24, 30, 40, 48, 51])
def test_policies_are_evaluated_as_closely_as_models_are_solved(exponent: int, seed: int) -> None:
    """A policy, a mixed one and policy iteration, against rational arithmetic."""
    rng, rate = np.random.default_rng(seed), 1 - 2.0**-exponent
    chances = rng.multinomial(16, [0.25] * 4, size=(2, 4)) / 16  # floats are exact, their means too
    rewards = rng.integers(-3, 4, (4, 2)) * 1.0
    model = MDP.from_arrays(chances, rewards, discount=rate)
    first = MDP.from_arrays(chances[:1], rewards[:, :1], discount=rate)
    mean = MDP.from_arrays([chances.mean(axis=0)], rewards.mean(axis=1)[:, None], discount=rate)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for found, of in (
            (evaluate(model, [0] * 4), first),
            (evaluate(model, np.full(8, 0.5)), mean),
            (PolicyIteration().solve(model), model),
        ):
            best = solve(of)
            assert found.error_bound <= 2 * max(1e-9 * np.abs(best.value).max(), best.error_bound)
            for value, exact, error in zip(
                found.value, certify(of).value, found.error, strict=True
            ):
                assert abs(F(float(value)) - exact) <= F(float(error))


@pytest.mark.parametrize("kind", [GaussSeidel, ValueIteration])
@pytest.mark.parametrize("seed", range(8))
def test_a_hundred_sweeps_tell_that_ten_thousand_would_be_too_few(kind: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    states = int(rng.integers(3, 8))
    after = (np.arange(states)[:, None] + rng.integers(-1, 2, (2, states, 2))) % states
    chances = np.eye(states)[after].mean(axis=2)
    model = MDP.from_arrays(chances, rng.normal(size=(states, 2)), discount=1 - 1e-9)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = kind().solve(model)
    assert found.iterations < 200
    for value, exact, error in zip(
        found.value, certify(model).value, found.state_error, strict=True
    ):
        assert abs(F(float(value)) - exact) <= F(float(error))


@pytest.mark.parametrize("rate", [1 - 1e-8, 1 - 1e-9, 1 - 1e-12])
@pytest.mark.parametrize("seed", range(5))
def test_a_mixed_policy_earns_its_pairs_rewards_in_full(rate: float, seed: int) -> None:
    """Of rows of floats that miss 1, too: against each state's own equations."""
    rng = np.random.default_rng(seed)
    chances = rng.dirichlet(np.ones(2), (2, 2))
    chances[0, :, 0] -= 1e-10 * (chances[0, :, 0] > 0.1)
    rewards = rng.integers(0, 4, (2, 2)) * 1.0
    model = MDP.from_arrays(chances, rewards, discount=rate, layout="ass")
    rows = [{t: p for p, t, _ in model.table.row(pair)} for pair in range(4)]
    a, b, c, d = ((rows[2 * s][t] + rows[2 * s + 1][t]) / 2 for s, t in np.ndindex(2, 2))
    r, q = (sum(map(F, map(float, row)), F(0)) / 2 for row in rewards)
    g = F(rate)
    below = (1 - g * a) * (1 - g * d) - g * b * g * c
    right = ((1 - g * d) * r + g * b * q) / below, ((1 - g * a) * q + g * c * r) / below
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = evaluate(model, np.full((2, 2), 0.5), kind="policy")
    for value, exact, error in zip(found.value, right, found.error, strict=True):
        assert abs(F(float(value)) - exact) <= F(float(error))


def test_a_mixed_policy_next_to_discount_1_fails_where_it_loses_more() -> None:
    states = np.arange(600)
    half = 0.5 - 2.0**-34  # rows of floats that sum to 1 - 2^-33 mean halves
    rows = np.repeat(np.arange(1200), 2), np.c_[states, (states + 1) % 600].repeat(2, 0).ravel()
    model = MDP.from_pairs(
        states.repeat(2), np.tile([0, 1], 600), sp.csr_array((np.full(2400, half), rows)),
        np.tile([0.0, -1.0], 600), discount=1 - 1e-8,
    )  # fmt: skip
    lost = F(1, 2) / (1 - F(1 - 1e-8))  # in all states alike, by half a step's -1
    mixed = np.full((600, 2), 0.5)
    assert not check(model, mixed, kind="policy", max_regret=lost - F(3, 1000)).passed
    assert check(model, mixed, kind="policy", max_regret=lost + F(3, 1000)).passed
