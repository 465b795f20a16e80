"""Horizons: their recursion, policies in them, and the way back to the pairs of the model."""

from fractions import Fraction as F
from itertools import product

import numpy as np
import pytest
from oracle import rows_of
from small_models import three_states

from exact_mdp import MDP, ModelError, Policy, certify, evaluate
from exact_mdp.mdp.questions.horizon import (
    describe_time_limit,
    flatten_times,
    repeats_in_time,
    split_by_time,
)
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import estimate_outcome_bytes


def best_of(mdp: MDP, steps: int, last: list[F]) -> list[F]:
    """The recursion of a horizon, written out."""
    best = max if mdp.sense == "max" else min
    value = last
    for _ in range(steps):
        value = [
            best(r + mdp.discount_exact * sum(p * value[t] for t, p in law.items())
                 for s, _, r, law in rows_of(mdp) if s == state)
            for state in range(3)
        ]  # fmt: skip
    return value


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("discount", ["1", "3/4", "0"])
@pytest.mark.parametrize("seed", range(5))
def test_a_horizon_is_its_recursion(seed: int, discount: str, sense: str) -> None:
    mdp = three_states(seed, sense, discount)
    for steps, last in product((0, 1, 2, 3), ([F(0)] * 3, [F(5), F(-2, 3), F(1)])):
        terminal = None if not any(last) else last
        unrolled = mdp.within(steps, terminal_value=terminal)
        value = best_of(mdp, steps, last)
        assert certify(unrolled).start_value == value[0] / 3 + 2 * value[2] / 3
        assert list(certify(unrolled).value[:3]) == value


@pytest.mark.parametrize("seed", range(4))
def test_a_policy_of_the_model_is_one_of_its_horizon(seed: int) -> None:
    mdp = three_states(seed)
    steps = 3
    rule = Policy.of(mdp, "random")
    value = [F(0)] * 3
    rows = rows_of(mdp)
    for _ in range(steps):
        value = [
            sum((r + F(3, 4) * sum(p * value[t] for t, p in law.items())) / len(own)
                for _, _, r, law in own)
            for own in ([row for row in rows if row[0] == s] for s in range(3))
        ]  # fmt: skip
    found = evaluate(mdp.within(steps), rule).start
    assert abs(F(found.value) - (value[0] / 3 + 2 * value[2] / 3)) <= F(found.error) + F(1, 10**15)


def waiting() -> MDP:
    """State 0 may go on to 1 or wait, and 1 is the end."""
    rows = [(0, 0, [("1/2", 0, 1), ("1/2", 1, 2)]), (0, 1, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])]
    return MDP.from_outcomes(rows, 1)


def test_layers_follow_each_other_and_the_end_stays_in_its_own() -> None:
    """Two states at times 0, 1 and 2: from 0 at time t to 0 or 1 at time t + 1."""
    assert rows_of(waiting().within(2)) == [
        (0, 0, F(3, 2), {2: F(1, 2), 3: F(1, 2)}),
        (0, 1, F(3), {3: F(1)}),
        (1, 0, F(0), {1: F(1)}),
        (2, 0, F(3, 2), {4: F(1, 2), 5: F(1, 2)}),
        (2, 1, F(3), {5: F(1)}),
        (3, 0, F(0), {3: F(1)}),
        (4, 0, F(0), {4: F(1)}),
        (5, 0, F(0), {5: F(1)}),
    ]


def test_weights_come_back_by_time_and_pair() -> None:
    mdp = waiting()
    weights = np.array([0, 1, 1, 1, 0, 1, 1, 1])
    assert split_by_time(mdp, weights, 2).tolist() == [[0, 1, 1], [1, 0, 1]]
    # An end with two actions has one of them at each time.
    twice = MDP.from_outcomes([(0, 0, [(1, 1, 3)]), (1, 0, [(1, 1, 0)]), (1, 1, [(1, 1, 0)])], 1)
    assert split_by_time(twice, np.ones(6), 2).tolist() == [[1, 1, 0], [1, 1, 0]]


def test_a_table_by_time_and_state_is_one_over_all_states() -> None:
    mdp = waiting().within(2)
    assert flatten_times(mdp, np.array([[1, 2], [3, 4]])).tolist() == [1, 2, 3, 4, 0, 0]
    assert flatten_times(mdp, np.arange(1, 7).reshape(3, 2)).tolist() == [1, 2, 3, 4, 0, 0]
    by_action = np.arange(12, dtype=np.int8).reshape(2, 2, 3)
    rows = flatten_times(mdp, by_action)
    assert rows.tolist() == [*by_action.reshape(4, 3).tolist(), [0] * 3, [0] * 3]
    assert rows.dtype == np.int8
    for other in (np.ones((4, 2)), np.ones((2, 3)), np.ones(6)):
        assert flatten_times(mdp, other) is other
    assert flatten_times(waiting(), np.ones((2, 2))).shape == (2, 2)


def cycle(times: int, changes: dict[int, tuple[int, int, list[tuple[F, int, int]]]]) -> MDP:
    """Two states at each time, and from the last time back to the first; some rows are changed."""
    size = 2 * times
    rows = {
        s: (s, 0, [(F(1, 3), (s + 2) % size, 1), (F(2, 3), (s + 3) % size, 0)]) for s in range(size)
    }
    layers = (Column(name="time", size=times), Column(name="state", size=2))
    mdp = MDP.from_outcomes([*(rows | changes).values()], "1/2", actions=["x", "y"])
    return mdp.with_(space=StateSpace(columns=layers))


def test_layers_are_recognised_without_an_origin() -> None:
    assert repeats_in_time(waiting().within(3))
    assert repeats_in_time(waiting().within(2))
    for other in (waiting(), waiting().within(1)):
        assert not repeats_in_time(other)
    assert repeats_in_time(cycle(4, {}))
    for row in (
        (0, [(F(1, 2), 4, 1), (F(1, 2), 5, 0)]),  # other probabilities
        (0, [(F(1), 4, 1)]),  # one outcome only
        (1, [(F(1, 3), 4, 1), (F(2, 3), 5, 0)]),  # another action
        (0, [(F(1, 3), 3, 1), (F(2, 3), 5, 0)]),  # other states
    ):
        assert not repeats_in_time(cycle(4, {2: (2, *row)}))


def test_the_time_limit_of_an_environment_is_named() -> None:
    assert describe_time_limit(waiting(), "horizon={}") == []
    limited = waiting().with_(time_limit=1200)
    said = "the environment stops after 1,200 steps; this answer is for episodes without a limit"
    assert describe_time_limit(limited, "") == [said]
    assert describe_time_limit(limited, "horizon={}") == [f"{said}: horizon=1200"]
    other = said.replace("without a limit", "of 3 steps")
    assert describe_time_limit(limited.within(3), "horizon={}") == [other]
    assert describe_time_limit(limited.with_(time_limit=3).within(3), "horizon={}") == []
    assert describe_time_limit(waiting().within(3), "horizon={}") == []


@pytest.mark.parametrize("wide", [False, True])
def test_layers_are_measured_before_they_are_made(
    wide: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two times of 3 pairs and 4 outcomes, and 6 states, each with a last pair and outcome."""
    mdp, table = waiting(), waiting().table
    if wide:
        earned = table.with_reward(table.gain.astype(object) * 2**70, table.gain_denominator)
        mdp = mdp.with_(table=earned)
    each = estimate_outcome_bytes(wide=wide) + 20
    size = each * (4 * 2 + 6) + 250 * (3 * 2 + 6) + 560 * 6
    monkeypatch.setattr("exact_mdp.mdp.questions.horizon.MOST_BYTES", size)
    mdp.within(2)
    monkeypatch.setattr("exact_mdp.mdp.questions.horizon.MOST_BYTES", size - 1)
    with pytest.raises(ModelError, match="2 steps of this model make 6 states and 14 outcomes"):
        mdp.within(2)


def test_a_model_has_one_time_and_fits_in_memory() -> None:
    timed = waiting().with_(space=StateSpace(columns=(Column(name="time", size=2),)))
    for ask, said in (
        (lambda: waiting().within(2).within(2), "already stops"),
        (lambda: timed.within(2), "a column 'time' of its own"),
        (lambda: waiting().within(10**9), "GB of memory"),
    ):
        with pytest.raises(ModelError, match=said):
            ask()
