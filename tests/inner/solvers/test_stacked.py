"""Many small models at once: each one's optimum and a policy's values are those of rationals."""

from fractions import Fraction as F

import numpy as np
import pytest
from oracle import mean, mixed, policy_values, rows_of, solve_exact

from exact_mdp import MDP
from exact_mdp.solvers.stacked import StackedModel


def drawn(seed: int, discount: str, sense: str) -> MDP:
    """A model of 4 states whose last one is the end; state 0 has three pairs, others two."""
    rng = np.random.default_rng(seed)
    state, action = [0, 0, 0, 1, 1, 2, 2, 3], [0, 1, 2, 0, 1, 0, 1, 0]
    rows = rng.multinomial(7, np.full(4, 0.25), size=8) + np.eye(4, dtype=int)[3]
    rows[-1] = [0, 0, 0, 8]
    reward = [*map(int, rng.integers(-9, 10, 7)), 0]
    chances = [[F(int(x), 8) for x in row] for row in rows]
    start = {0: F(1, 4), 2: F(3, 4)}
    return MDP.from_pairs(state, action, chances, reward, discount, start=start, sense=sense)


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("discount", ["0", "9/10", "1"])
def test_stacked_models_are_what_each_is_alone(discount: str, sense: str) -> None:
    models = [drawn(seed, discount, sense) for seed in range(25)]
    stacked = StackedModel.of(models)
    assert stacked is not None
    found = stacked.optimum()
    assert found is not None
    shares = np.array([0.5, 0.25, 0.25, 0, 1, 0.125, 0.875, 1])
    amounts = np.stack([np.arange(8.0), np.ones(8)], axis=1)
    own, off = (each[:, 0] for each in stacked.evaluate([shares]))
    totals = []
    for column in amounts.T:
        counting = stacked.with_reward(
            np.tile(column, (len(models), 1)), np.zeros((len(models), 8))
        )
        totals.append(counting.evaluate([shares])[0][:, 0])
    for k, mdp in enumerate(models):
        sign, rate, rows = mdp.sign, mdp.discount_exact, rows_of(mdp)
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


def test_models_that_do_not_fit_together_are_no_batch() -> None:
    one = drawn(0, "9/10", "max")
    other = MDP.from_arrays(np.eye(4)[None], np.zeros((4, 1)), discount="9/10")
    assert StackedModel.of([one, other]) is None
    for_ever = MDP.from_arrays([[[1, 0], [0, 1]], [[0, 1], [0, 1]]], [[1, 1], [0, 0]], discount=1)
    assert StackedModel.of([for_ever]) is None
