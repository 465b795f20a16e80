"""Backward induction over states for many draws at once, against sums in fractions."""

from fractions import Fraction as F
from random import Random

import numpy as np
import pytest

from exact_mdp.solvers.kernels.stacked import Numbers, write_optimum, write_policy_values
from exact_mdp.solvers.stacked import StackedStructure

DRAWS, STATES = 3, 6


@pytest.mark.parametrize("seed", range(6))
def test_values_of_all_draws_are_those_of_each_alone(seed: int) -> None:
    # Pairs lead to higher states; the last state is the end. Chances and rewards share rows.
    rng = Random(seed)
    state, offsets, column = [], [0], []
    for here in range(STATES - 1):
        for _ in range(rng.randint(1, 3)):
            after = sorted(rng.sample(range(here + 1, STATES), rng.randint(1, STATES - 1 - here)))
            state.append(here)
            column += after
            offsets.append(len(column))
    pairs, outcomes = len(state), len(column)
    number = [rng.randrange(5) for _ in range(outcomes)]
    earned = [rng.randrange(4) for _ in range(pairs)]
    chances = [[F(rng.randint(0, 16), 16) for _ in range(DRAWS)] for _ in range(5)]
    amounts = [[F(rng.randint(-32, 32), 8) for _ in range(DRAWS)] for _ in range(4)]
    rate = [F(rng.randint(8, 16), 16) for _ in range(DRAWS)]
    weight = [F(rng.randint(0, 4), 4) for _ in range(pairs)]

    structure = StackedStructure(
        state=np.array(state),
        first=np.searchsorted(state, np.arange(STATES + 1)),
        offsets=np.array(offsets),
        column=np.array(column),
        number=np.array(number),
        earned=np.array(earned),
        ended=np.arange(STATES) == STATES - 1,
    )
    numbers = Numbers(
        chances=np.array(chances, dtype=float),
        amounts=np.array(amounts, dtype=float),
        rate=np.array(rate, dtype=float),
    )
    order = np.arange(STATES - 1)[::-1].copy()
    best, own = np.zeros((2, STATES, DRAWS))
    q = np.full((pairs, DRAWS), np.nan)
    write_optimum(order, structure, numbers, best, q)
    write_policy_values(order, structure, numbers, np.array(weight, dtype=float), own, q[0].copy())

    for d in range(DRAWS):
        value, worth = [F(0)] * STATES, [F(0)] * STATES

        def action_value(pair: int, later: list[F], d: int = d) -> F:
            some = range(offsets[pair], offsets[pair + 1])
            ahead = sum((chances[number[n]][d] * later[column[n]] for n in some), F(0))
            return amounts[earned[pair]][d] + rate[d] * ahead

        for here in reversed(range(STATES - 1)):
            mine = [pair for pair in range(pairs) if state[pair] == here]
            value[here] = max(action_value(pair, value) for pair in mine)
            worth[here] = sum((weight[p] * action_value(p, worth) for p in mine), F(0))
        for pair in range(pairs):
            assert q[pair, d] == pytest.approx(float(action_value(pair, value)), abs=1e-12)
        assert best[:, d] == pytest.approx([float(x) for x in value], abs=1e-12)
        assert own[:, d] == pytest.approx([float(x) for x in worth], abs=1e-12)
