"""Many models at once: each one's optimum and a policy's values are those of rationals."""

from dataclasses import replace
from fractions import Fraction as F

import numpy as np
import pytest
from oracle import mean, mixed, policy_values, rows_of, solve_exact

from exact_mdp import MDP
from exact_mdp.solvers.stacked import StackedModel

LATER = {0: [1, 2, 3], 1: [3], 2: [1, 3], 3: [3]}


def drawn(seed: int, discount: str, sense: str, cycles: bool = True) -> MDP:
    """A model of 4 states whose last one is the end; state 0 has three pairs, others two.

    Without cycles, states lead to the states of `LATER` only, in each model to other ones of them.
    """
    rng = np.random.default_rng(seed)
    state, action = [0, 0, 0, 1, 1, 2, 2, 3], [0, 1, 2, 0, 1, 0, 1, 0]
    rows = rng.multinomial(7, np.full(4, 0.25), size=8) + np.eye(4, dtype=int)[3]
    for row, own in zip(rows, state, strict=True):
        for then in range(4):
            if not cycles and then not in LATER[own]:
                row[3] += row[then]
                row[then] = 0
    rows[-1] = [0, 0, 0, 8]
    reward = [*map(int, rng.integers(-9, 10, 7)), 0]
    chances = [[F(int(x), 8) for x in row] for row in rows]
    start = {0: F(1, 4), 2: F(3, 4)}
    return MDP.from_pairs(state, action, chances, reward, discount, start=start, sense=sense)


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("discount", ["0", "9/10", "1"])
@pytest.mark.parametrize("cycles", [True, False])
def test_stacked_models_are_what_each_is_alone(discount: str, sense: str, cycles: bool) -> None:
    models = [drawn(seed, discount, sense, cycles) for seed in range(25)]
    stacked = StackedModel.of(models)
    assert stacked is not None
    steps = None if stacked.steps is None else stacked.steps.tolist()
    assert steps == (None if cycles else [3, 1, 2, 0])
    found = stacked.optimum()
    assert found is not None
    shares = np.array([0.5, 0.25, 0.25, 0, 1, 0.125, 0.875, 1])
    amounts = np.stack([np.arange(8.0), np.ones(8)], axis=1)
    assert stacked.pays_at_end(np.ones((25, 8))) == (discount == "1" or not cycles)
    if not cycles:
        amounts[-1] = 0
    assert not stacked.pays_at_end(np.eye(8)[[0] * 25])
    own, off = (each[:, 0] for each in stacked.evaluate([shares]))
    totals = []
    for column in amounts.T:
        counting = stacked.with_reward(
            np.tile(column, (len(models), 1)), np.zeros((len(models), 8))
        )
        totals.append(counting.evaluate([shares])[0][:, 0])
    for k, mdp in enumerate(models):
        sign, rate, rows = mdp.sense.sign, mdp.discount_exact, rows_of(mdp)
        ended = {3} if rate == 1 else set()
        gained = [(s, a, sign * r, law) for s, a, r, law in rows]
        best, _ = solve_exact(4, gained, rate)
        value, error, loss, loss_error = (each[k] for each in found)
        assert (np.abs(value - np.array(best, float)) <= error).all()
        assert error.max() < 1e-12
        lost = [
            0 if s in ended else best[s] - r - rate * mean(law, best) for s, _, r, law in gained
        ]
        assert (np.abs(loss - np.array(lost, float)) <= loss_error).all()
        chances = {(s, a): F(x) for (s, a, *_), x in zip(rows, shares.tolist(), strict=True)}
        exact = policy_values(mixed(gained, chances), rate, ended)
        assert abs(own[k] - float(exact[0] / 4 + 3 * exact[2] / 4)) <= off[k] < 1e-12
        for c in range(2):
            counted = [(s, a, F(amounts[l, c]), law) for l, (s, a, _, law) in enumerate(rows)]
            exact = policy_values(mixed(counted, chances), rate, ended)
            assert totals[c][k] == pytest.approx(float(exact[0] / 4 + 3 * exact[2] / 4))


def test_policies_are_evaluated_side_by_side() -> None:
    stacked = StackedModel.of([drawn(seed, "1", "max", cycles=False) for seed in range(3)])
    assert stacked is not None
    policies = [np.array([1.0, 0, 0, 1, 0, 1, 0, 1]), np.array([0, 0, 1.0, 0.5, 0.5, 0, 1, 1])]
    value, error = stacked.evaluate(policies)
    for n, policy in enumerate(policies):
        one, off = stacked.evaluate([policy])
        assert value[:, n].tolist() == one[:, 0].tolist()
        assert error[:, n].tolist() == off[:, 0].tolist()


def test_errors_of_backward_induction_grow_with_each_step_and_with_the_rows() -> None:
    stacked = StackedModel.of([drawn(seed, "1", "max", cycles=False) for seed in range(3)])
    assert stacked is not None
    found = stacked.optimum()
    assert found is not None
    once = found.error[:, 1]
    assert (once > 0).all()
    assert found.error == pytest.approx(once[:, None] * np.array([3, 1, 2, 0]))
    known = replace(stacked, reward_error=np.full((3, 8), 0.5), row_error=0.25).optimum()
    assert known is not None
    size = np.abs(found.value).max(axis=1)
    assert known.error[:, 1] == pytest.approx(0.5 + 0.25 * size)
    assert known.doubt[:, 0] == pytest.approx(2 * known.error[:, 0])


def test_values_beyond_floats_have_no_optimum() -> None:
    rows = [(0, 0, [(1, 1, 1e308)]), (1, 0, [(1, 2, 1e308)]), (2, 0, [(1, 2, 0)])]
    stacked = StackedModel.of([MDP.from_outcomes(rows)])
    assert stacked is not None
    assert stacked.optimum() is None


def test_models_that_do_not_fit_together_are_not_stacked() -> None:
    one = drawn(0, "9/10", "max")
    other = MDP.from_arrays(np.eye(4)[None], np.zeros((4, 1)), discount="9/10")
    assert StackedModel.of([one, other]) is None
    for_ever = MDP.from_arrays([[[1, 0], [0, 1]], [[0, 1], [0, 1]]], [[1, 1], [0, 0]], discount=1)
    assert StackedModel.of([for_ever]) is None
