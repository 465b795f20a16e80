"""Bounds on values: beside exact values, and beside the greatest ratios by hand."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
from oracle import policies, policy_values, rows_of, solve_exact

from exact_mdp import MDP, ModelError, SolverError
from exact_mdp.solvers.bounds import bounds as module
from exact_mdp.solvers.bounds.bounds import (
    Bounds,
    _compute_margins,
    _is_closed,
    bound_optimal_values,
    evaluate_pairs,
    improve_policy,
    margin_weights,
    solve_backward,
)
from exact_mdp.solvers.bounds.gains import SLACK, UNIT, compute_advantages

Array = np.ndarray[Any, Any]
RATES = (F(0), F(1, 2), F(9, 10), F(9999, 10_000), F(1))


def model(
    rng: np.random.Generator, rate: F, *, acyclic: bool = False, order: int = 1, ends: bool = True
) -> MDP:
    """A random model; each pair may lead to states after its own, the last of which is an end."""
    size, rows = int(rng.integers(2, 6)), list[Any]()
    for s in range(size - ends):
        for a in range(int(rng.integers(1, 4))):
            targets = rng.integers(s + 1 if acyclic else 0, size, 2).tolist()
            if ends:
                targets.append(int(rng.integers(s + 1, size)))
            weights = rng.integers(1, 9, len(targets)).tolist()
            law = [(F(w, sum(weights)), t, F(int(rng.integers(-9, 10)), 2))
                   for w, t in zip(weights, targets, strict=True)]  # fmt: skip
            rows.append((s, a, law))
    if ends:
        rows.append((size - 1, 0, [(1, size - 1, 0)]))
    turn = size - 1
    if order < 0:
        rows = [(turn - s, a, [(p, turn - t, r) for p, t, r in law]) for s, a, law in rows]
        rows.sort(key=lambda each: each[:2])
    return MDP.from_outcomes(rows, rate)


def models(seed: int = 0, **more: Any) -> Iterator[MDP]:
    rng = np.random.default_rng(seed)
    for rate in RATES * 4:
        for order in (1, -1):
            yield model(rng, rate, order=order, **more)


def optimum(mdp: MDP) -> tuple[list[F], list[set[int]]]:
    return solve_exact(mdp.n_states, rows_of(mdp), mdp.discount_exact)


def ended(mdp: MDP) -> set[int]:
    return {*np.flatnonzero(mdp.terminal).tolist()}


def steps_of(mdp: MDP) -> list[F]:
    """The greatest expected discounted number of steps to the end, over all policies."""
    each = []
    for policy in policies(rows_of(mdp)):
        ones = [(s, a, F(1), law) for s, a, _, law in policy]
        each.append(policy_values(ones, mdp.discount_exact, ended(mdp)))
    return [max(column) for column in zip(*each, strict=True)]


def within(found: Bounds, low: list[F], high: list[F]) -> bool:
    each = zip(found.value.tolist(), found.weight.tolist(), low, high, strict=True)
    return all(
        F(x) + F(found.low) * F(w) <= a <= b <= F(x) + F(found.high) * F(w) for x, w, a, b in each
    )


@pytest.mark.parametrize("acyclic", [True, False])
def test_values_lie_within_their_bounds(acyclic: bool) -> None:
    """Of any values, near the optimum or far off; and so does their middle."""
    rng = np.random.default_rng(1)
    for mdp in models(acyclic=acyclic):
        best, _ = optimum(mdp)
        near = np.array([float(x) for x in best])
        for size in (0.0, 1e-9, 1.0, 100.0):
            value = np.where(mdp.terminal, 0.0, near + size * rng.normal(size=mdp.n_states))
            found = bound_optimal_values(mdp, value)
            own = policy_values(rows_of(mdp, found.pairs.tolist()), mdp.discount_exact, ended(mdp))
            assert within(found, own, best)
            assert found.value is value
            centred = found.centre_bounds()
            assert within(centred, own, best)
            middle = 1e-15 * max(abs(found.low), abs(found.high))
            assert abs(centred.low + centred.high) <= 1e-6 * (found.high - found.low) + middle
            assert centred.pairs is found.pairs
            wide = found.high - found.low
            assert centred.high - centred.low == pytest.approx(wide, rel=1e-5, abs=1e-11)
            off = [max(abs(F(x) - a), abs(F(x) - b))
                   for x, a, b in zip(value.tolist(), own, best, strict=True)]  # fmt: skip
            assert all(x <= F(e) for x, e in zip(off, found.state_error.tolist(), strict=True))
            assert max(b - a for a, b in zip(own, best, strict=True)) <= F(found.regret) or not wide


def test_bounds_are_the_greatest_and_the_least_ratio() -> None:
    """c = max d / m over all pairs, c' = min d / m over those of the policy, up to rounding."""
    rng = np.random.default_rng(2)
    for mdp in models(3):
        value = np.where(mdp.terminal, 0.0, rng.normal(size=mdp.n_states))
        found, rows = bound_optimal_values(mdp, value), rows_of(mdp)
        ratios = dict[int, float]()
        for pair, (s, _, r, law) in enumerate(rows):
            if mdp.terminal[s]:
                continue
            rate, weight = mdp.discount, found.weight
            d = float(r) + rate * sum(float(p) * value[t] for t, p in law.items()) - value[s]
            m = weight[s] - rate * sum(float(p) * weight[t] for t, p in law.items())
            ratios[pair] = d / m
        own = [pair for pair in found.pairs.tolist() if pair in ratios]
        assert found.high == pytest.approx(max(ratios.values()), rel=1e-9, abs=1e-9)
        assert found.low == pytest.approx(min(ratios[pair] for pair in own), rel=1e-9, abs=1e-9)
        states = [s for s, *_ in rows]
        for pair in own:
            added = compute_advantages(mdp, value).value
            others = [added[k] for k in ratios if states[k] == states[pair]]
            assert added[pair] >= max(others) - 1e-9


def test_what_bounds_say_of_errors() -> None:
    found = Bounds(
        value=np.array([1.0, 2.0, 0.0]), weight=np.array([2.0, 4.0, 0.0]),
        pairs=np.array([0, 1, 2]), low=-0.5, high=0.25,
    )  # fmt: skip
    np.testing.assert_allclose(found.state_error, [1, 2, 0], rtol=2e-6)
    assert (found.state_error >= [1, 2, 0]).all()
    assert found.error == found.state_error.max()
    assert found.regret == 3 * SLACK
    with pytest.raises(ValueError, match="read-only"):
        found.state_error[0] = 1
    centred = found.centre_bounds()
    np.testing.assert_allclose(centred.value, [0.75, 1.5, 0], rtol=1e-15)
    np.testing.assert_allclose([centred.low, centred.high], [-0.375, 0.375], rtol=2e-6)
    assert centred.high >= 0.375
    other = replace(found, low=0.25, high=0.75)
    np.testing.assert_allclose(other.state_error, [1.5, 3, 0], rtol=2e-6)
    np.testing.assert_allclose(other.centre_bounds().value, [2, 4, 0], rtol=1e-15)


def test_centring_counts_its_own_roundings() -> None:
    """Values of 10¹⁵ move by whole eighths: their middle is off by as much."""
    rng = np.random.default_rng(4)
    for number in range(80):
        weight = rng.uniform(0.5, 2, 5) * 10.0 ** rng.integers(-4, 5)
        value, ends = rng.normal(size=5) * 1e15, np.sort(rng.normal(size=2))
        if number % 2:  # close to each other, and to what makes the values 0
            ends = ends / 8 + rng.uniform(1e15, 2e15)
            value = rng.normal(size=5) - ends[0] * weight
        given = Bounds(value=value, weight=weight, pairs=np.arange(5), low=float(ends[0]),
                       high=float(ends[1]))  # fmt: skip
        made = given.centre_bounds()
        for own, middle, w in zip(value, made.value, weight, strict=True):
            exact = [F(float(own)) + F(c) * F(float(w)) for c in (given.low, given.high)]
            around = [F(float(middle)) + F(c) * F(float(w)) for c in (made.low, made.high)]
            assert around[0] <= exact[0] <= exact[1] <= around[1]
        size = float((np.abs(value) / weight).max() + abs(ends).max())
        assert made.high - made.low <= (given.high - given.low) * 1.01 + 2e-15 * size


def test_the_middle_is_widened_by_twice_what_its_roundings_lose() -> None:
    """c w and V + c w round: twice |c| w and |V + c w| units of w, and 8 units of c itself."""
    weight = np.array([2.0, 4.0, 0.0])
    given = Bounds(value=-3 * weight, weight=weight, pairs=np.arange(3), low=5.0, high=5.0)
    made = given.centre_bounds()
    assert made.value.tolist() == [4, 8, 0]
    units = 2 * (2 + 2 * 5) + 8 * 5
    assert made.high == -made.low == pytest.approx(units * UNIT, rel=1e-9, abs=0)


def test_actions_that_rounding_does_not_tell_apart_are_as_good() -> None:
    """Rounding of 10⁹ hides a difference of 10⁻⁸ between rewards."""
    rows: Any = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 1 + F(1, 10**8))]), (1, 0, [(1, 0, 0)])]
    mdp = MDP.from_outcomes(rows, "1/2")
    assert bound_optimal_values(mdp, np.array([1e9, 1e9])).pairs.tolist() == [0, 2]
    assert bound_optimal_values(mdp, np.zeros(2)).pairs.tolist() == [1, 2]


def test_strict_choices_follow_gains_alone() -> None:
    """1 and 1 + 2⁻⁵⁰ differ by more than a gain is off, and by less than values and q are."""
    more = 1 + F(1, 2**48)
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 0, more)])], 1 - F(1, 2**20))
    value = np.array([2.0**20])
    assert bound_optimal_values(mdp, value).pairs.tolist() == [0]
    assert bound_optimal_values(mdp, value, strict=True).pairs.tolist() == [1]


def test_values_that_no_bounds_are_around_are_refused() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])])
    with pytest.raises(ValueError, match="terminal states are worth 0"):
        bound_optimal_values(mdp, np.array([0.0, 1e-300]))
    for size in (np.inf, np.nan, 1.7e308, 5e307):  # of the last one, bounds are ±1.5e308
        half = MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (1, 0, [(1, 0, 0)])], "1/2")
        with pytest.raises(SolverError, match="beyond the range of floats"):
            bound_optimal_values(half, np.array([size, -size]))
    over = MDP.from_outcomes([(0, 0, [(1, 0, 0)])])
    found = bound_optimal_values(over, np.zeros(1))
    assert (found.low, found.high, found.weight.tolist()) == (0, 0, [0])


# ---- weights -------------------------------------------------------------------------------------


@pytest.mark.parametrize("acyclic", [True, False])
def test_weights_are_steps_to_the_end_or_one(acyclic: bool) -> None:
    for mdp in models(5, acyclic=acyclic):
        weights, steps = margin_weights(mdp), [float(x) for x in steps_of(mdp)]
        if acyclic:
            np.testing.assert_allclose(weights.value, steps, rtol=1e-14)
        elif mdp.discount_exact == 1 and not mdp.ends.is_acyclic:
            assert (weights.value >= 0.5 * np.array(steps) - 1e-9).all()
            assert (weights.value <= np.array(steps) + 1e-9).all()  # they are a policy's
        elif not mdp.ends.is_acyclic:
            assert weights.value.tolist() == [0.0 if over else 1.0 for over in mdp.terminal]
        margin = np.broadcast_to(weights.margin, mdp.n_pairs)
        for pair, (s, _, _, law) in enumerate(rows_of(mdp)):
            if mdp.terminal[s]:
                continue
            held = [F(float(w)) for w in weights.value]
            exact = held[s] - mdp.discount_exact * sum(p * held[t] for t, p in law.items())
            assert abs(F(float(margin[pair])) - exact) <= F(weights.error)
        assert weights.smallest > 0
        assert weights.error < 1e-13


def test_margins_of_one_need_no_sums_where_nothing_ends() -> None:
    rng = np.random.default_rng(6)
    endless = model(rng, F(3, 4), ends=False)
    margin, error = _compute_margins(endless, np.ones(endless.n_states))
    assert margin.tolist() == [0.25]
    assert 0.25 * 2.0**-53 * 5 <= error <= 0.25 * 2.0**-53 * 6
    assert margin_weights(endless).uniform
    ending = model(rng, F(3, 4))
    margin, error = _compute_margins(ending, np.where(ending.terminal, 0.0, 1.0))
    live = ~ending.terminal[ending.pair_state]
    assert margin[~live].tolist() == [1.0]
    assert (margin[live] >= 0.25 - 1e-15).all()
    assert 0 < error < 1e-14
    undiscounted = ending.with_(discount=1)
    assert len(_compute_margins(undiscounted, np.ones(ending.n_states))[0]) == ending.n_pairs


def test_weights_are_closed_where_all_that_live_stay_among_themselves() -> None:
    apart: Any = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 0, 1)]), (2, 0, [(1, 2, 0)])]
    leading: Any = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 2, 1)]), *apart[1:]]
    back: Any = [*apart[:2], (2, 0, [(1, 2, 0)]), (2, 1, [(1, 2, 0)])]
    for rows, weight, closed in (
        (apart, [1, 1, 0], True), (apart, [1, 1, 1], True), (apart, [1, 2, 0], False),
        (leading, [1, 1, 0], False), (leading, [1, 1, 1], True), (back, [1, 1, 0], True),
        ([(0, 0, [(1, 0, 0)])], [0], False), ([(0, 0, [(1, 0, 0)])], [1], True),
    ):  # fmt: skip
        mdp = MDP.from_outcomes(rows, "1/2")
        assert _is_closed(mdp, np.array(weight, dtype=float)) is closed


def test_where_margins_vanish_there_are_no_weights() -> None:
    ring: Any = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 0, 1)])]
    assert margin_weights(MDP.from_outcomes(ring, 1 - F(1, 2**53))).uniform
    leading: Any = [(0, 0, [("1/2", 0, 1), ("1/2", 1, 0)]), (0, 1, [(1, 0, 0)]),
                    (1, 0, [(1, 1, 0)])]  # fmt: skip
    with pytest.raises(SolverError, match=r"1 - γ is 1\.1e-16, of which rounding leaves"):
        margin_weights(MDP.from_outcomes(leading, 1 - F(1, 2**53)))
    tiny = F(1, 2**60)
    hardly: Any = [(0, 0, [(1 - tiny, 0, 1), (tiny, 1, 0)]), (1, 0, [(1, 1, 0)])]
    with pytest.raises(SolverError):
        margin_weights(MDP.from_outcomes(hardly))
    with pytest.raises(ModelError):
        margin_weights(MDP.from_outcomes(ring))


def test_only_positive_weights_with_positive_margins_prove_anything(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    end: Any = (2, 0, [(1, 2, 0)])
    far = MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (1, 0, [(1, 2, 1)]), end], "1/2")
    near = MDP.from_outcomes([(0, 0, [(1, 2, 1)]), (1, 0, [(1, 2, 1)]), end])

    def refuse(margin: float, error: float) -> None:
        monkeypatch.setattr(module, "_compute_margins", lambda *_: (np.array([margin]), error))
        for mdp in (far.with_(), near.with_()):  # weights are kept with each model
            with pytest.raises(SolverError, match="the end is too many steps away"):
                margin_weights(mdp)

    for margin, error in ((0.5, 0.5), (0.25, 0.5), (-1.0, 0.0)):
        refuse(margin, error)
    monkeypatch.setattr(module, "solve_backward", lambda mdp, _: np.zeros(mdp.n_states))
    refuse(1.0, 0.0)


def test_a_policy_is_kept_where_no_pair_adds_more_than_half_a_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two steps, by staying with probability 1/2; to stay with probability p adds 2 p - 1."""

    def stays(p: F) -> MDP:
        rows: Any = [(0, a, [(q, 0, 0), (1 - q, 1, 0)]) for a, q in enumerate((F(1, 2), p))]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])

    for p, steps in ((F(7, 10), 2), (F(3, 4), 2), (F(4, 5), 5), (F(9, 10), 10)):
        np.testing.assert_allclose(margin_weights(stays(p)).value, [steps, 0], rtol=1e-12)
    monkeypatch.setattr(module, "POLICIES", 1)
    np.testing.assert_allclose(margin_weights(stays(F(3, 4))).value, [2, 0], rtol=1e-12)
    with pytest.raises(SolverError, match="the end is too many steps away"):
        margin_weights(stays(F(9, 10)))


# ---- values --------------------------------------------------------------------------------------


@pytest.mark.parametrize("compiled", [0, 20_000])
def test_values_from_the_end_on_are_the_optimum(
    compiled: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "COMPILED", compiled)
    for mdp in models(7, acyclic=True):
        best, _ = optimum(mdp)
        value = solve_backward(mdp, mdp.reward)
        np.testing.assert_allclose(value, [float(x) for x in best], rtol=1e-13, atol=1e-13)
        steps = [float(x) for x in steps_of(mdp)]
        np.testing.assert_allclose(solve_backward(mdp, np.ones(mdp.n_pairs)), steps, rtol=1e-13)


@pytest.mark.parametrize("compiled", [0, 20_000])
def test_states_in_any_order_have_the_same_values(
    compiled: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Levels of several states, each with several actions, which are numbered by chance."""
    monkeypatch.setattr(module, "COMPILED", compiled)
    rng = np.random.default_rng(8)
    for _ in range(10):
        place = rng.permutation(9)
        rows: list[Any] = [(int(place[8]), 0, [(1, int(place[8]), 0)])]
        for s in range(8):
            for a in range(int(rng.integers(1, 4))):
                ahead = rng.integers(s // 2 * 2 + 2, 9, 2) if s < 6 else [8, 8]
                law = [(F(1, 2), int(place[t]), int(rng.integers(-5, 6))) for t in ahead]
                rows.append((int(place[s]), a, law))
        mdp = MDP.from_outcomes(sorted(rows, key=lambda row: row[:2]))
        best, _ = optimum(mdp)
        value = solve_backward(mdp, mdp.reward)
        np.testing.assert_allclose(value, [float(x) for x in best], atol=1e-13)


def test_values_of_a_policy_are_those_of_its_equations() -> None:
    rng = np.random.default_rng(9)
    for mdp in models(10):
        pairs = np.array([int(rng.choice(mdp.pairs_of(s))) for s in range(mdp.n_states)])
        for reward in (None, rng.normal(size=mdp.n_pairs)):
            earned = mdp.reward if reward is None else reward
            rows = [(s, a, F(float(earned[pair])), law)
                    for pair, (s, a, _, law) in zip(pairs, rows_of(mdp, pairs.tolist()),
                                                    strict=True)]  # fmt: skip
            exact = policy_values(rows, mdp.discount_exact, ended(mdp))
            found = evaluate_pairs(mdp, pairs, reward)
            np.testing.assert_allclose(found, [float(x) for x in exact], rtol=1e-9, atol=1e-9)


def test_policies_improve_to_the_optimum() -> None:
    for mdp in models(11):
        best, actions = optimum(mdp)
        pairs, value, gain = improve_policy(mdp, mdp.pair_offsets[:-1])
        np.testing.assert_allclose(value, [float(x) for x in best], rtol=1e-9, atol=1e-9)
        for state, pair in enumerate(pairs.tolist()):
            assert mdp.pair_state[pair] == state
            assert int(mdp.pair_action[pair]) in actions[state] or mdp.terminal[state]
        assert gain.value.max() <= gain.noise.max()
        again, *_ = improve_policy(mdp, pairs)
        assert again.tolist() == pairs.tolist()  # as good a policy stays
        first, value, gain = improve_policy(mdp, mdp.pair_offsets[:-1], enough=np.inf)
        assert first.tolist() == mdp.pair_offsets[:-1].tolist()
        np.testing.assert_array_equal(value, evaluate_pairs(mdp, first))
        np.testing.assert_array_equal(gain.value, compute_advantages(mdp, value).value)
        ones = np.where(mdp.terminal, 0.0, 1.0)[mdp.pair_state]
        _, steps, _ = improve_policy(mdp, first, ones)
        np.testing.assert_allclose(steps, [float(x) for x in steps_of(mdp)], rtol=1e-9)
        _, steps, gain = improve_policy(mdp, first, ones, enough=0.5)
        assert gain.value.max() <= 0.5


def test_the_number_of_policies_that_are_tried_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each policy of a row of choices is improved on at its end alone, one state at a time."""
    rows: list[Any] = [(4, 0, [(1, 4, 0)])]
    for s in range(4):
        rows += [(s, 0, [(1, 4, 0)]), (s, 1, [(1, s + 1, 1 if s == 3 else "-1/9")])]
    mdp = MDP.from_outcomes(sorted(rows, key=lambda row: row[:2]))
    begin = mdp.pair_offsets[:-1]
    assert improve_policy(mdp, begin)[0].tolist() == [1, 3, 5, 7, 8]
    for most, pairs in ((1, [0, 2, 4, 7, 8]), (2, [0, 2, 5, 7, 8]), (3, [0, 3, 5, 7, 8])):
        monkeypatch.setattr(module, "POLICIES", most)
        assert improve_policy(mdp, begin)[0].tolist() == pairs
    monkeypatch.setattr(module, "POLICIES", 1)
    ring: Any = [(0, 0, [("1/2", 0, 0), ("1/2", 2, 0)]),
                 (0, 1, [("99/100", 1, 0), ("1/100", 2, 0)]),
                 (1, 0, [("99/100", 0, 0), ("1/100", 2, 0)]), (2, 0, [(1, 2, 0)])]  # fmt: skip
    with pytest.raises(SolverError, match="the end is too many steps away"):
        margin_weights(MDP.from_outcomes(ring))


def test_ends_among_other_states_are_no_steps() -> None:
    rows: Any = [(0, 0, [(1, 2, 0)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 3, 0)]), (3, 0, [(1, 3, 0)])]
    mdp = MDP.from_outcomes(rows)
    assert solve_backward(mdp, np.ones(4)).tolist() == [2, 0, 1, 0]


def test_a_step_to_a_state_of_smaller_number_is_taken_in_order() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 0)]), (1, 0, [(1, 0, 5)]), (1, 1, [(1, 0, 3)])])
    assert solve_backward(mdp, mdp.reward).tolist() == [0, 5]


def test_a_pair_that_is_as_good_stays() -> None:
    rows: Any = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 1)]), (0, 2, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows)
    for first, last in ((0, 0), (1, 1), (2, 0)):
        assert improve_policy(mdp, np.array([first, 3]))[0].tolist() == [last, 3]
