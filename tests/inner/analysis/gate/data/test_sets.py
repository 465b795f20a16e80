"""Sets of rows that records allow, beside the likelihood ratio written out and its dual."""

from dataclasses import replace
from fractions import Fraction as F
from functools import cache
from math import exp, expm1, lgamma, log
from typing import Any

import flint
import numpy as np
import oracle
import pandas as pd
import pytest
from records import NAMES, recorded
from scipy import optimize

from exact_mdp import MDP, ModelError
from exact_mdp.analysis.gate.data.sets import RowSets, _bound_mean_above, _compute_radii
from exact_mdp.mdp.io.transitions import CUT_OFF


@cache
def model(seed: int = 0, episodes: int = 20, rewards: str = "chance") -> MDP:
    frame = recorded(np.random.default_rng(seed), episodes)
    if rewards == "decided":  # by state, action and next state
        then = frame["next_state"].fillna(3).astype(int)
        frame["reward"] = frame["state"] * 2 - frame["action"] + then / 2
    return MDP.from_transitions(frame, discount="9/10")


def counts_of(mdp: MDP) -> np.ndarray:
    counts = mdp.counts
    assert counts is not None
    return counts.toarray()


def radius_of(counts: np.ndarray, doubt: float) -> float:
    """The docstring, for one row of counts."""
    n, m = counts.sum(), len(counts)
    seen = counts[counts > 0]
    likely = sum(c * log(c / n) for c in seen)
    mixed = lgamma(1) - lgamma(n + 1) + sum(lgamma(c + 1 / m) - lgamma(1 / m) for c in counts)
    return (log(1 / doubt) + likely - mixed) / n


def extreme(p: np.ndarray, x: np.ndarray, radius: float, most: bool) -> float:
    """The greatest or least mean of x among laws q with KL(p‖q) ≤ radius, by the dual over s."""
    if most:
        return -extreme(p, -x, radius, False)
    d = x - x.min()
    if d.max() == 0:
        return float(x.min())

    def less(t: float) -> float:
        s = exp(t)
        return s - exp(-radius + float((p * np.log(d + s)).sum()))

    best = min(less(t) for t in np.linspace(-30, 30, 601))
    around = min(np.linspace(-30, 30, 601), key=less)
    found = optimize.minimize_scalar(less, bounds=(around - 0.2, around + 0.2), method="bounded",
                                     options={"xatol": 1e-12})  # fmt: skip
    return float(x.min()) - min(best, float(found.fun))


@pytest.mark.parametrize("known", [True, False])
def test_radii_are_the_likelihood_ratio(known: bool) -> None:
    for seed, episodes in ((0, 20), (1, 20), (2, 20), (0, 4)):
        mdp = model(seed, episodes, rewards="decided")
        sets = RowSets.of(mdp, 0.05, "known" if known else (-10, 10))
        counts, seen = counts_of(mdp), sets.counted > 0
        assert sets.counted.tolist() == counts.sum(axis=1).tolist()
        assert sets.pairs.tolist() == np.flatnonzero(seen).tolist()
        states = len({*mdp.pair_state[seen].tolist()})
        assert mdp.episodes is not None
        assert sets.share == pytest.approx(0.05 / (states * mdp.n_actions + 1), rel=1e-15)
        for pair in range(mdp.n_pairs):
            doubt = sets.share / (1 if known else 2)
            wanted = radius_of(counts[pair], doubt) if seen[pair] else 0.0
            assert sets.radius[pair] == pytest.approx(wanted, rel=1e-11)
            assert sets.radius[pair] >= wanted * (1 - 1e-13)
        given = RowSets.of(mdp.with_(start=0), 0.05, "known")
        assert given.share == pytest.approx(0.05 / (states * mdp.n_actions), rel=1e-15)
    one = _compute_radii(np.ones(1), np.zeros(1, dtype=int), np.array([5.0]), 1, 0.1)
    assert one.tolist() == [0]


@pytest.mark.parametrize("most", [True, False])
@pytest.mark.parametrize("known", [True, False])
def test_nature_chooses_the_extreme_law_of_each_set(known: bool, most: bool) -> None:
    rng = np.random.default_rng(0)
    for seed, episodes in ((0, 20), (1, 20), (2, 20), (0, 5)):
        mdp = model(seed, episodes, rewards="decided" if known else "chance")
        sets = RowSets.of(mdp, 0.05, "known" if known else (-1, 2))
        if seed == 1:  # as if nobody had taken this one
            sets = replace(sets, counted=np.where(np.arange(mdp.n_pairs) == 2, 0, sets.counted))
        value, counts = rng.normal(size=mdp.n_states) * 3, counts_of(mdp)
        for rewards in (True, False):
            step = sets.solve_inner_problem(value, most=most, rewards=rewards)
            if rewards:
                assert np.array_equal(sets.solve_inner_problem(value, most=most).bound, step.bound)
            laws, earned = step.piece()
            laws = laws.toarray()
            gain = {}
            for pair in range(mdp.n_pairs):
                for _, t, r in mdp.table.row(pair):
                    gain[pair, t] = float(r)
            low, high = sets.reward
            for pair in range(mdp.n_pairs):
                if not sets.counted[pair]:
                    wanted = mdp.discount * float(mdp.transition[[pair]].toarray()[0] @ value)
                    wanted += rewards * float(mdp.reward[pair])
                else:
                    p = counts[pair] / counts[pair].sum()
                    x = mdp.discount * value
                    never = sets.rewards[most] if known and rewards else 0.0
                    paid = [
                        gain.get((pair, t), never) if known and rewards else 0.0
                        for t in range(mdp.n_states)
                    ]
                    far = (value.max() if most else value.min()) * mdp.discount + never
                    x, p = np.append(x + paid, far), np.append(p, 0.0)
                    keep = (p > 0) | (np.arange(len(p)) == len(p) - 1)
                    wanted = extreme(p[keep], x[keep], sets.radius[pair], most)
                    if rewards and not known:
                        wanted += (high if most else low)[pair]
                assert step.bound[pair] == pytest.approx(wanted, rel=1e-7, abs=1e-7)
                attained = mdp.discount * float(laws[pair] @ value) + rewards * earned[pair]
                assert attained == pytest.approx(step.bound[pair], rel=1e-7, abs=1e-7)
                assert laws[pair].sum() == pytest.approx(1, rel=1e-12)
                off = 1 if most else -1
                assert off * (step.bound[pair] - attained) >= -1e-13


def test_what_is_certain_is_rounded_outward() -> None:
    """Rows that nobody counted, beside fractions: large numbers, small ones and the smallest."""
    mdp, rng = model(0), np.random.default_rng(0)
    table = mdp.table.with_reward(mdp.table.gain * 10**6 + 1, mdp.table.gain_denominator * 3)
    seen = {"observations": mdp.observations, "episodes": mdp.episodes}
    for each in (mdp, mdp.with_(table=table, **seen)):
        sets = RowSets.of(each, 0.05, (-1, 10**6))
        sets = replace(sets, counted=0 * sets.counted)
        rows = oracle.rows_of(each)
        for size in (0.0, 1.0, 1e6, 1e-310):
            value = rng.normal(size=(30, each.n_states)) * size
            for values, most, rewards in ((v, m, r) for v in value for m in (0, 1) for r in (0, 1)):
                step = sets.solve_inner_problem(values, most=bool(most), rewards=bool(rewards))
                whole = float(abs(values).max()) + rewards * float(abs(each.reward).max() + 10**6)
                for bound, (_, _, r, law) in zip(step.bound.tolist(), rows, strict=True):
                    later = F(9, 10) * sum(p * F(float(values[t])) for t, p in law.items())
                    wide = (F(bound) - later - rewards * r) * (1 if most else -1)
                    assert 0 <= wide <= F(1e-14 * whole) + F(whole > 0, 2**990)


def test_radii_are_rounded_up() -> None:
    """Beside intervals of more digits: of long rows, of one outcome, and of many states."""
    flint.ctx.prec, before = 300, flint.ctx.prec
    rng = np.random.default_rng(0)
    for size, states, doubt in ((1, 1000, 0.5), (1, 3, 1e-9), (3, 3, 0.05), (40, 60, 0.3)):
        for n in (1, 7, 1000, 10**6, 10**9):
            counts = rng.multinomial(n, rng.dirichlet(np.ones(size)))
            counts = counts[counts > 0]
            row = np.zeros(len(counts), dtype=int)
            (found,) = _compute_radii(counts / n, row, np.array([float(n)]), states, doubt).tolist()
            part, whole = flint.arb(flint.fmpq(1, states)), flint.arb(n)
            terms = [flint.arb(n + 1).lgamma(), -flint.arb(doubt).log()]
            for c in map(flint.arb, counts.tolist()):
                terms += [c * (c / whole).log(), part.lgamma(), -(c + part).lgamma()]
            exact = sum(terms, flint.arb(0)) / whole
            size_of_terms = sum(abs(float(term)) for term in terms)
            assert exact <= found <= exact + (len(counts) + 66) * 2.0**-53 * size_of_terms / n
    flint.ctx.prec = before


def test_laws_within_a_set_are_no_more_extreme() -> None:
    rng = np.random.default_rng(1)
    mdp = model(0)
    sets = RowSets.of(mdp, 0.05, (0, 1))
    value = rng.normal(size=mdp.n_states)
    low, high = (
        sets.solve_inner_problem(value, most=most, rewards=False).bound for most in (False, True)
    )
    counts, inside = counts_of(mdp), 0
    for pair in sets.pairs.tolist():
        p = counts[pair] / counts[pair].sum()
        for q in rng.dirichlet(counts[pair] + 0.3, size=200):
            apart = float((p[p > 0] * np.log(p[p > 0] / q[p > 0])).sum())
            if apart <= sets.radius[pair]:
                inside += 1
                assert low[pair] <= mdp.discount * q @ value <= high[pair]
    assert inside > 500


def test_means_of_rewards_are_those_of_coins() -> None:
    """kl(mean seen, μ) is log((n + 1) / δ) / n at both ends, or these are the range's."""
    mdp = model(0)
    sets = RowSets.of(mdp, 0.05, (-1, 3))
    low, high = sets.reward

    def kl(a: float, b: float) -> float:
        parts = [(a, b), (1 - a, 1 - b)]
        return sum(x * log(x / y) for x, y in parts if x > 0)

    for pair in range(mdp.n_pairs):
        n = sets.counted[pair]
        if not n:
            assert low[pair] == high[pair] == mdp.reward[pair]
            continue
        seen = (mdp.reward[pair] + 1) / 4
        edge = log((n + 1) / (sets.share / 2)) / n
        for end in ((high[pair] + 1) / 4, (low[pair] + 1) / 4):
            assert edge <= kl(seen, end) * (1 + 1e-12) <= edge * 1.01
        assert low[pair] < mdp.reward[pair] < high[pair]
    flat = RowSets.of(
        mdp.with_(
            table=mdp.table.with_reward(0 * mdp.table.gain, mdp.table.gain_denominator),
            observations=mdp.observations,
            episodes=mdp.episodes,
        ),
        0.05,
        (0, 0),
    )
    assert flat.reward[0].tolist() == flat.reward[1].tolist() == [0] * mdp.n_pairs


def test_a_mean_beyond_the_range_by_rounding_is_the_end_of_the_range() -> None:
    mdp = model(0)
    sets = RowSets.of(mdp, 0.05, (0, 1))
    pair = int(mdp.reward.argmax())
    most = float(mdp.reward[pair])
    at, beyond = (replace(sets, rewards=(0.0, end)) for end in (most, np.nextafter(most, 0)))
    low, high = beyond.reward
    assert low[pair] == pytest.approx(at.reward[0][pair], rel=1e-9)
    assert low[pair] < 0.9 * most
    assert high[pair] == pytest.approx(most, rel=1e-9)


def test_known_rewards_are_those_of_the_entries_counted() -> None:
    """The end `a` comes before the others; one of the pairs was seen once."""
    rows: Any = [(0, "b", "x", 2, "c"), (0, "c", "x", 3, "a"), (1, "b", "y", 4, "b")]
    rows += [(1, "b", "x", 5, "a"), (2, "b", "x", 2, "c"), (2, "c", "x", 3, "a")]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=NAMES), discount="1/2")
    assert mdp.terminal.tolist() == [True, False, False]
    sets = RowSets.of(mdp, 0.05, "known")
    assert sets.counts.toarray().tolist() == [[1, 0, 2], [0, 1, 0], [2, 0, 0]]
    assert sets.gains.tolist() == [5, 2, 4, 3]
    assert sets.rewards == (2, 5)


def test_the_greatest_mean_of_a_coin() -> None:
    mean, edge = np.array([0.0, 0.25, 0.9, 1.0, 0.5]), np.array([0.5, 0.1, 2.0, 0.3, 0.0])
    found = _bound_mean_above(mean, edge)
    assert found[0] == pytest.approx(1 - exp(-0.5), rel=1e-5)
    parts = 0.25 * log(0.25 / found[1]) + 0.75 * log(0.75 / (1 - found[1]))
    assert parts == pytest.approx(0.1, rel=1e-4)
    assert (found[2], found[3]) == (pytest.approx(1, abs=1e-2), 1)
    assert 0.5 <= found[4] < 0.5 + 1e-5
    assert (found <= 1).all()
    assert found[0] >= 1 - exp(-0.5)
    for edge in (1e-15, 1e-13, 1e-9, 1e-3, 3.0):
        for mean in (np.zeros(1), np.full(1, 1e-12)):
            (bound,) = _bound_mean_above(mean, np.array([edge])).tolist()
            assert bound >= -expm1(-edge)


def test_a_start_that_was_counted_is_a_row_of_its_own() -> None:
    rows = [(n, "abc"[n % 5 // 2], 0, 1, None) for n in range(20)]
    several = MDP.from_transitions(pd.DataFrame(rows, columns=NAMES), discount="1/2")
    value = np.array([3.0, -1.0, 2.0, 0.5])
    for mdp in (several, model(0)):
        sets = RowSets.of(mdp, 0.05, (0, 1))
        begun = mdp.start_distribution
        assert mdp.episodes == 20
        radius = radius_of(begun * 20, sets.share)
        for most in (True, False):
            p = np.append(begun, 0.0)
            x = np.append(value, value.max() if most else value.min())
            keep = (p > 0) | (np.arange(5) == 4)
            wanted = extreme(p[keep], x[keep], radius, most)
            assert sets.at_start(value, most=most) == pytest.approx(wanted, rel=1e-7)
    given = RowSets.of(mdp.with_(start={0: "1/3", 1: "2/3"}), 0.05, (0, 1))
    low, high = (given.at_start(value, most=most) for most in (False, True))
    assert low < 1 / 3 < high
    assert high - low < 1e-14
    rng = np.random.default_rng(0)
    for values in rng.normal(size=(40, 4)) * 10.0 ** rng.integers(-9, 9, size=(40, 1)):
        low, high = (given.at_start(values, most=most) for most in (False, True))
        exact = F(float(values[0])) / 3 + F(float(values[1])) * 2 / 3
        assert F(low) <= exact <= F(high)
        assert high - low <= 20 * 2.0**-53 * abs(values).max()


def test_what_one_step_may_earn() -> None:
    mdp = model(0)
    assert RowSets.of(mdp, 0.05, (0.0, 1.0)).of_a_step == (0, 1)
    assert RowSets.of(mdp, 0.05, (-1.5, 3)).of_a_step == (-1.5, 3)
    costs = mdp.with_(sense="min")
    assert RowSets.of(costs, 0.05, (-1.5, 3)).rewards == (-3, 1.5)
    untaken = replace(RowSets.of(mdp, 0.05, (0, 1)), counted=np.zeros(mdp.n_pairs))
    assert mdp.reward.max() == 1
    narrow = replace(untaken, rewards=(0.1, 0.2))
    assert narrow.of_a_step == (0, 1)
    one = MDP.from_transitions(pd.DataFrame([(0, 0, 0, 1, 0)], columns=NAMES), discount="1/2")
    assert not one.terminal.any()
    assert RowSets.of(one, 0.05, (0.5, 2)).of_a_step == (0, 2)
    costs = one.with_(sense="min")
    assert RowSets.of(costs, 0.05, (0.5, 2)).of_a_step == (-2, 0)
    known = model(0, rewards="decided")
    gains = known.table.compute_gains()[known.observations[known.table.pair] > 0]
    assert RowSets.of(known, 0.05, "known").rewards == (gains.min(), gains.max())


def test_rewards_that_do_not_fit_are_refused() -> None:
    mdp = model(0)
    with pytest.raises(ModelError, match="no range of rewards is given"):
        RowSets.of(mdp, 0.05)
    for wrong in ("all", (0.5, 1), (0, 0.5)):
        with pytest.raises(ModelError):
            RowSets.of(mdp, 0.05, wrong)
    two = [(0, "a", "x", 0, "a"), (1, "a", "x", 1, "a"), (2, "a", "x", 1, None)]
    seen = MDP.from_transitions(pd.DataFrame(two, columns=NAMES), discount="1/2")
    with pytest.raises(ModelError, match="two rewards were seen"):
        _ = RowSets.of(seen, 0.05, "known").gains


def test_states_in_which_episodes_were_cut_off_are_unknown() -> None:
    rows: Any = [(0, "a", "x", 0, "b", True), (1, "a", "x", 0, None, False)]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=[*NAMES, "truncated"]), discount="1/2")
    sets = RowSets.of(mdp, 0.05, (0, 1))
    assert sets.unknown.tolist() == mdp.labels[CUT_OFF].tolist()
    assert sets.unknown.sum() == 1
