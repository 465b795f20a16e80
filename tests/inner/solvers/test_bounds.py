"""Bounds are held against rational arithmetic: the inequalities that prove them, and exact optima.

With V, w, c and c' as the exact rationals that the floats are, V + c w ≥ r + γ P (V + c w) for
every pair and V + c' w ≤ r + γ P (V + c' w) for the policy's pairs; that is all of the proof.
"""

from dataclasses import replace
from fractions import Fraction as F

import numpy as np
import pytest
from cases import BY_NAME
from hypothesis import assume, given
from hypothesis import strategies as st
from oracle import solve_exact
from strategies import DISCOUNTS, Rows, exact_gains, exact_values, model_of, models

from exact_mdp import MDP, SolverError
from exact_mdp.mdp.forms import threads
from exact_mdp.solvers.bounds.bounds import Bounds, lower, margin_weights, verify
from exact_mdp.solvers.bounds.gains import gains, greedy

NUMBERS = st.one_of(
    st.floats(-10, 10), st.sampled_from([0.0, 1e9, -1e9, 1e-9, 1 / 3, 1e15, 2.0**-1060])
)


def any_value(mdp: MDP, data: st.DataObject) -> np.ndarray:
    drawn = data.draw(st.lists(NUMBERS, min_size=mdp.n_states, max_size=mdp.n_states))
    return np.where(mdp.terminal, 0.0, np.array(drawn))


def proves(mdp: MDP, found: Bounds) -> bool:
    value, weight = exact_values(found.value), exact_values(found.weight)
    above = [v + F(found.high) * w for v, w in zip(value, weight, strict=True)]
    below = [v + F(found.low) * w for v, w in zip(value, weight, strict=True)]
    live = [pair for pair in range(mdp.n_pairs) if not mdp.terminal[mdp.pair_state[pair]]]
    no_more, no_less = exact_gains(mdp, above), exact_gains(mdp, below)
    ended = all(above[s] == below[s] == 0 for s in np.flatnonzero(mdp.terminal))
    chosen = set(found.pairs.tolist())
    return (
        ended
        and all(no_more[pair] <= 0 for pair in live)
        and all(no_less[pair] >= 0 for pair in live if pair in chosen)
    )


@given(models(), st.booleans(), st.data())
def test_bounds_are_proven_by_exact_inequalities(
    rows: Rows, floats: bool, data: st.DataObject
) -> None:
    mdp = rows.model(floats=floats)
    value = any_value(mdp, data)
    found = verify(mdp, value)
    assert proves(mdp, found)
    picked = np.array([data.draw(st.sampled_from(mdp.pairs_of(s))) for s in range(mdp.n_states)])
    low = lower(mdp, gains(mdp, value), picked)
    assert proves(mdp, replace(found, pairs=picked, low=low))


@given(models(), st.data())
def test_optimal_values_lie_within_the_bounds(rows: Rows, data: st.DataObject) -> None:
    mdp = rows.model()
    exact, _ = solve_exact(rows.n_states, rows.pairs, rows.discount)
    for found in (
        verify(mdp, np.array([float(x) for x in exact])),
        verify(mdp, any_value(mdp, data)),
    ):
        errors = zip(exact, exact_values(found.value), found.state_error, strict=True)
        assert all(abs(x - v) <= F(float(e)) for x, v, e in errors)


@given(models())
def test_bounds_around_the_optimum_are_tight(rows: Rows) -> None:
    exact, optimal = solve_exact(rows.n_states, rows.pairs, rows.discount)
    mdp = rows.model()
    found = verify(mdp, np.array([float(x) for x in exact]))
    size = float(max(map(abs, exact)) + max(abs(r) for _, _, r, _ in rows.pairs))
    assert found.error <= 1e-14 * size * found.weight.max() * _worst(mdp)
    assert found.regret <= 2 * found.error * (1 + 1e-6)
    # Among tied actions the one of lowest number is taken; rounding decides nothing.
    chosen = mdp.pair_action[found.pairs].tolist()
    assume(_separated(mdp, exact, size))
    assert chosen == [min(actions) for actions in optimal]


def _worst(mdp: MDP) -> float:
    weights = margin_weights(mdp)
    return float(1 / weights.least.min())


def _separated(mdp: MDP, value: list[F], size: float) -> bool:
    return not any(0 < -gain < 1e-12 * size for gain in exact_gains(mdp, value))


@given(models(), st.booleans(), st.data())
def test_gains_are_off_by_no_more_than_they_say(
    rows: Rows, floats: bool, data: st.DataObject
) -> None:
    mdp = rows.model(floats=floats)
    value = any_value(mdp, data)
    gain = gains(mdp, value)
    exact = exact_gains(mdp, exact_values(value))
    for x, g, e in zip(exact, exact_values(gain.value), gain.error, strict=True):
        assert abs(x - g) <= F(float(e))


@given(models(), st.booleans())
def test_margins_lie_where_they_were_verified(rows: Rows, floats: bool) -> None:
    mdp = rows.model(floats=floats)
    weights = margin_weights(mdp)
    weight = exact_values(weights.value)
    margins = np.broadcast_to(weights.margin, mdp.n_pairs)
    for pair, (least, most) in enumerate(
        zip(margins - weights.error, margins + weights.error, strict=True)
    ):
        state = int(mdp.pair_state[pair])
        if mdp.terminal[state]:
            assert weight[state] == 0
            continue
        later = sum((p * weight[t] for p, t, _ in mdp.table.row(pair)), F(0))
        exact = weight[state] - mdp.discount_exact * later
        assert 0 < F(float(least)) <= exact <= F(float(most))


def test_float_rows_need_not_sum_to_one() -> None:
    """They mean a row that does, whatever the discount."""
    row = [0.1, 0.2, 0.7 + 9e-10]
    mdp = MDP.from_arrays([[row, row, [0.0, 0.0, 1.0]]], np.array([1.0, 2.0, 3.0]), "999/1000")
    found = verify(mdp, np.array([1e6, -3.0, 7.0]))
    assert proves(mdp, found)
    near = mdp.with_(discount=1 - F(1, 10**12))
    assert proves(near, verify(near, np.zeros(3)))


def test_weights_are_the_smaller_of_levels_and_horizon() -> None:
    rows = [(s, 0, F(1), {max(s - 1, 0): F(1)}) for s in range(1, 17)]
    rows.append((0, 0, F(0), {0: F(1)}))
    few_steps = margin_weights(model_of(17, rows, F(999_999, 10**6))).value.max()
    assert 15.9 < few_steps <= 16
    short_horizon = margin_weights(model_of(17, rows, F(1, 2))).value.max()
    assert short_horizon < 2
    assert margin_weights(model_of(17, rows, F(1))).value.tolist() == list(range(17))
    assert margin_weights(model_of(17, rows, F(0))).value.max() == 1


@pytest.mark.parametrize("discount", DISCOUNTS)
def test_a_model_that_has_ended(discount: F) -> None:
    found = verify(model_of(1, [(0, 0, F(0), {0: F(1)})], discount), np.zeros(1))
    assert (found.error, found.regret) == (0, 0)


def test_an_end_too_far_away_is_refused() -> None:
    case = BY_NAME["reset-chain-100-7/10-steps"]
    mdp = model_of(case.n_states, case.pairs, case.discount)
    with pytest.raises(SolverError, match="certify"):
        verify(mdp, np.zeros(case.n_states))


def test_many_transitions_are_taken_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    chances = rng.dirichlet(np.full(9, 0.3), size=(3, 9))
    mdp = MDP.from_arrays(chances, rng.normal(size=(9, 3)), "9/10")
    value = rng.normal(size=9)
    whole, keep = gains(mdp, value), mdp.pair_offsets[:-1] + rng.integers(0, 3, 9)
    chosen, kept = greedy(mdp, whole), greedy(mdp, whole, keep=keep)
    for chunk in (1, 7, 10, 10_000):
        monkeypatch.setattr(threads, "IN_CACHE", chunk)
        pieces = gains(mdp, value)
        for name in ("value", "error", "noise"):
            assert getattr(pieces, name).tolist() == getattr(whole, name).tolist()
        assert greedy(mdp, pieces).tolist() == chosen.tolist()
        assert greedy(mdp, pieces, keep=keep).tolist() == kept.tolist()


def test_keeping_a_pair_that_is_as_good() -> None:
    mdp = model_of(2, [(0, a, F(1), {1: F(1)}) for a in range(3)] + [(1, 0, F(0), {1: F(1)})], F(1))
    gain = gains(mdp, np.zeros(2))
    assert greedy(mdp, gain).tolist() == [0, 3]
    assert greedy(mdp, gain, keep=np.array([2, 3])).tolist() == [2, 3]


def test_rewards_that_cancel_are_known_no_better_than_their_sum() -> None:
    """Floats add up to 0 here, where the exact expected reward is 1/180 or so."""
    outcomes = [(0.1, 1, 1e15), (0.2, 1, 3e15), (0.7, 1, -1e15)]
    mdp = MDP.from_outcomes([(0, 0, outcomes), (1, 0, [(1, 1, 0)])])
    exact = sum(F(p) * F(reward) for p, _, reward in outcomes)
    assert abs(F(float(mdp.reward[0])) - exact) > F(1, 1000)
    for value in (mdp.reward * 1.0, np.array([1.0, 0.0])):
        found = verify(mdp, np.where(mdp.terminal, 0.0, value))
        low, high = (F(found.value[0]) + F(c) * F(found.weight[0]) for c in (found.low, found.high))
        assert low <= exact <= high
    gain = gains(mdp, np.zeros(2))
    assert abs(F(float(gain.value[0])) - exact) <= F(float(gain.error[0]))
