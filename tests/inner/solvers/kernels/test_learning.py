"""Random numbers and choices of the compiled learner, against plain Python and frequencies."""

import numpy as np
import pytest
from learning_twin import Stream

from exact_mdp.solvers.kernels.learning import (
    FIRST,
    LAST,
    RANDOM,
    alias_tables,
    choose_greedy_position,
    choose_position,
    find_largest,
    sample_pair_outcome,
    sample_uniform,
)


def state(seed: int) -> np.ndarray:
    return np.random.SeedSequence(seed).generate_state(4, np.uint64)


def test_numbers_are_those_of_xoshiro256pp() -> None:
    """From state 1, 2, 3, 4: the first outputs of the authors' own C program."""
    rng = np.arange(1, 5, dtype=np.uint64)
    words = [41943041, 58720359, 3588806011781223, 3591011842654386]
    assert [sample_uniform(rng) for _ in words] == [(word >> 11) * 2.0**-53 for word in words]
    twin, rng = Stream(state(4).tolist()), state(4)
    assert [sample_uniform(rng) for _ in range(50)] == [twin() for _ in range(50)]


def test_outcomes_come_as_often_as_their_rows_say() -> None:
    p = np.array([0.5, 0.2, 0.3, 1.0])
    offsets, cut = np.array([0, 3, 4]), np.empty(4)
    alias, small, large = np.empty((3, 4), dtype=np.int64)
    alias_tables(offsets, p, cut, alias, small, large)
    rng, counts = state(1), np.zeros(4)
    sides = np.stack([np.arange(4), alias], axis=1).ravel()
    for _ in range(20_000):
        counts[sides[sample_pair_outcome(rng, offsets, cut, 0)]] += 1
    assert counts[:3] / 20_000 == pytest.approx(p[:3], abs=0.02)  # more than 5 deviations
    assert sides[sample_pair_outcome(rng, offsets, cut, 1)] == 3


def test_the_greedy_action_is_the_first_the_last_or_any_of_the_largest() -> None:
    q, entry = np.array([1.0, 3.0, 0.0, 3.0, 9.0]), np.arange(5)
    assert find_largest(q, entry, 0, 4) == (3.0, 1)
    assert choose_greedy_position(state(0), q, entry, 0, 4, FIRST) == 1
    assert choose_greedy_position(state(0), q, entry, 0, 4, LAST) == 3
    rng = state(2)
    seen = [choose_greedy_position(rng, q, entry, 0, 4, RANDOM) for _ in range(2000)]
    assert {*seen} == {1, 3}
    assert np.mean(np.array(seen) == 1) == pytest.approx(0.5, abs=0.06)


def test_an_actor_explores_as_often_as_it_is_told() -> None:
    q, entry, rng = np.array([0.0, 1.0, 0.0, 0.0]), np.arange(4), state(3)
    seen = np.bincount(
        [choose_position(rng, q, entry, 0, 4, 0.4, FIRST) for _ in range(10_000)], minlength=4
    )
    assert seen / 10_000 == pytest.approx([0.1, 0.7, 0.1, 0.1], abs=0.025)
