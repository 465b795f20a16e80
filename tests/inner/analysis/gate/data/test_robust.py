"""Bounds for every model that records allow, beside sampled models and their own fixed points."""

from fractions import Fraction as F
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import pytest
from records import NAMES, POLICY, STAGES, estimated, recorded

from exact_mdp import MDP, ModelError, Robust
from exact_mdp.analysis.gate.data.robust import (
    Operators,
    _bound_totals,
    _require_seen,
    robust_bounds,
)
from exact_mdp.analysis.gate.data.sets import RowSets

NEAR = 1e-7


def model(seed: int = 0, episodes: int = 60) -> MDP:
    return estimated(recorded(np.random.default_rng(seed), episodes))


def own_of(mdp: MDP, actions: Any = POLICY) -> np.ndarray:
    taken = mdp.pair_action == np.array(actions)[..., mdp.pair_state]
    return np.asarray(taken | mdp.forced[mdp.pair_state], dtype=float)


def sampled(sets: RowSets, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rows and rewards within the sets: likely ones, and mixtures towards one state."""
    mdp, counts = sets.mdp, sets.mdp.counts
    assert counts is not None
    rows, (low, high) = mdp.transition.toarray(), sets.reward
    for pair in sets.pairs.tolist():
        seen = counts.toarray()[pair]
        p = seen / seen.sum()
        goal = np.eye(mdp.n_states)[rng.integers(mdp.n_states)]
        for share in (0.6, 0.4, 0.2, 0.1, 0.05, 0.0):
            q = (1 - share) * rng.dirichlet(seen + 0.5) + share * goal
            q = np.maximum(q, 1e-12)
            q /= q.sum()
            if float((p[p > 0] * np.log(p[p > 0] / q[p > 0])).sum()) <= sets.radius[pair]:
                rows[pair] = q
                break
    return rows, rng.choice([low, high], axis=0) if rng.random() < 0.5 else rng.uniform(low, high)


def values_of(mdp: MDP, rows: np.ndarray, reward: np.ndarray, pairs: Any) -> np.ndarray:
    chosen = list(pairs)
    matrix = np.eye(mdp.n_states) - mdp.discount * rows[chosen]
    return np.linalg.solve(matrix, reward[chosen])


def best_of(mdp: MDP, rows: np.ndarray, reward: np.ndarray) -> np.ndarray:
    each = product(*(mdp.pairs_of(s) for s in range(mdp.n_states)))
    return np.max([values_of(mdp, rows, reward, pairs) for pairs in each], axis=0)


def test_every_model_within_the_sets_is_within_the_bounds() -> None:
    for seed, sense in ((0, "max"), (1, "min")):
        mdp = model(seed).with_(sense=sense)
        sets = RowSets.of(mdp, 0.5, (0, 1))
        own, pairs = own_of(mdp), np.flatnonzero(own_of(mdp))
        bounds = robust_bounds(sets, own)
        rng = np.random.default_rng(seed)
        for _ in range(60):
            rows, reward = sampled(sets, rng)
            mine = values_of(sets.mdp, rows, reward, pairs)
            best = best_of(sets.mdp, rows, reward)
            for (low, high), value in (
                (bounds.own, mine),
                (bounds.best, best),
                (bounds.lost, best - mine),
            ):
                assert (low <= value + 1e-12).all()
                assert (value <= high + 1e-12).all()
        low, high = bounds.regret
        assert 0 <= low <= high
        start = bounds.at_start(mdp, bounds.own)
        assert start[0] <= start[1]
        if sense == "min":
            assert start[0] >= 0  # costs from 0 to 1


def test_bounds_are_the_fixed_points_of_their_steps() -> None:
    """Value iteration on what nature makes of every pair, one model for each side."""
    for seed in range(1):
        mdp = model(seed, 200)
        sets, own = RowSets.of(mdp, 0.05, (0, 1)), own_of(mdp)
        bounds = robust_bounds(sets, own)
        pairs = np.flatnonzero(own)
        for most in (0, 1):
            for found, taken in ((bounds.own, pairs), (bounds.best, None)):
                value = np.zeros(mdp.n_states)
                for _ in range(200):
                    q = sets.solve_inner_problem(value, most=bool(most)).bound
                    value = (
                        q[taken]
                        if taken is not None
                        else np.maximum.reduceat(q, mdp.pair_offsets[:-1])
                    )
                    value[mdp.terminal] = 0
                assert found[most] == pytest.approx(value, abs=NEAR)
        apart = bounds.best[1] - bounds.own[0]
        assert (bounds.lost[1] <= apart + 1e-12).all()
        assert (bounds.lost[0] >= np.maximum(bounds.best[0] - bounds.own[1], 0) - 1e-12).all()


def test_the_regret_under_one_model_is_the_optimum_of_advantages() -> None:
    """D(s) = max over l of A(l) + γ P_l D, with the advantages' bounds and what both may be."""
    mdp = model(0, 400)
    sets, own = RowSets.of(mdp, 0.05, (0, 1)), own_of(mdp)
    at = Operators(sets=sets, own=own, ends=(-20.0, 20.0))
    bounds = robust_bounds(sets, own)
    least, greatest = at.bound_advantages(*bounds.own)
    rng = np.random.default_rng(0)
    for _ in range(50):
        rows, reward = sampled(sets, rng)
        value = values_of(mdp, rows, reward, np.flatnonzero(own))
        advantage = reward + mdp.discount * rows @ value - value[mdp.pair_state]
        assert (least <= advantage + 1e-12).all()
        assert (advantage <= greatest + 1e-12).all()
    assert (least[own == 1] == 0).all()
    assert (greatest[own == 1] == 0).all()
    lost = np.zeros(mdp.n_states)
    for _ in range(200):
        ahead = (
            sets.solve_inner_problem(bounds.best[1], most=True).bound
            - bounds.own[0][mdp.pair_state]
        )
        joint = greatest + sets.solve_inner_problem(lost, most=True, rewards=False).bound
        lost = np.maximum.reduceat(np.minimum(joint, ahead), mdp.pair_offsets[:-1])
        lost[mdp.terminal] = 0
    found = bounds.lost[1]
    assert found == pytest.approx(np.minimum(lost, bounds.best[1] - bounds.own[0]), abs=1e-6)


def test_advantages_are_narrow_where_values_are_known() -> None:
    """With V^π known, they are those of rows and rewards that nature chooses apart."""
    mdp = model(0, 200)
    sets = RowSets.of(mdp, 0.05, (0, 1))
    rng = np.random.default_rng(2)
    own = rng.dirichlet([1, 1], size=mdp.n_states)[mdp.pair_state, mdp.pair_action]
    own /= np.add.reduceat(own, mdp.pair_offsets[:-1])[mdp.pair_state]
    value = rng.normal(size=mdp.n_states)
    at = Operators(sets=sets, own=own, ends=(-10.0, 10.0))
    least, greatest = at.bound_advantages(value, value)
    low, high = (sets.solve_inner_problem(value, most=most).bound for most in (False, True))
    for pair, s in enumerate(mdp.pair_state.tolist()):
        others = [k for k in mdp.pairs_of(s) if k != pair]
        above = (1 - own[pair]) * high[pair] - sum(own[k] * low[k] for k in others)
        below = (1 - own[pair]) * low[pair] - sum(own[k] * high[k] for k in others)
        assert greatest[pair] == pytest.approx(above, rel=1e-9, abs=1e-9)
        assert least[pair] == pytest.approx(below, rel=1e-9, abs=1e-9)
    wide, off = at.bound_advantages(value - 0.5, value + 0.5), 1.0
    assert (wide[0] <= least).all()
    assert (wide[1] >= greatest).all()
    assert (wide[1] - greatest <= 0.9 * off * 4).all()


def test_stages_are_steps_from_the_last_to_the_first() -> None:
    mdp = model(1, 100)
    sets, own = RowSets.of(mdp, 0.05, (0, 1)), own_of(mdp, STAGES)
    bounds = robust_bounds(sets, own)
    for most in (0, 1):
        mine, best = np.zeros(mdp.n_states), np.zeros(mdp.n_states)
        for taken in own[::-1]:
            q = sets.solve_inner_problem(mine, most=bool(most)).bound
            mine = np.add.reduceat(q * taken, mdp.pair_offsets[:-1])
            q = sets.solve_inner_problem(best, most=bool(most)).bound
            best = np.maximum.reduceat(q, mdp.pair_offsets[:-1])
        assert bounds.own[most] == pytest.approx(mine, abs=1e-9)
        assert bounds.best[most] == pytest.approx(best, abs=1e-9)
    assert (bounds.lost[1] <= bounds.best[1] - bounds.own[0] + 1e-12).all()
    assert (bounds.lost[0] <= bounds.lost[1]).all()


def test_totals_are_rewards_over_what_the_discount_leaves() -> None:
    sets = RowSets.of(model(), 0.05, (-1, 2))
    assert _bound_totals(sets) == pytest.approx((-10, 20), rel=1e-5)
    low, high = _bound_totals(sets)
    assert low <= -10
    assert high >= 20
    weight = 1 + 0.9 + 0.81
    low, high = _bound_totals(sets, 3)
    assert (low, high) == pytest.approx((-weight, 2 * weight), rel=1e-5)
    assert low <= -weight
    assert high >= 2 * weight
    whole = RowSets.of(model().with_(discount=1), 0.05, (0, 1))
    with pytest.raises(ModelError, match="how long an episode may go on"):
        _bound_totals(whole)
    assert _bound_totals(whole, 4) == pytest.approx((0, 4), rel=1e-5)


def test_at_discount_1_a_range_that_is_stated_is_kept() -> None:
    mdp = model(0, 2000).with_(discount=1)
    sets = RowSets.of(mdp, 0.05, (0, 1))
    bounds = robust_bounds(sets, own_of(mdp), (0.0, 30.0))
    for low, high in (bounds.own, bounds.best):
        assert (low >= 0).all()
        assert (high <= 30).all()
        assert (low <= high).all()
    for most in (0, 1):
        value = np.where(mdp.terminal, 0.0, 30.0 * most)
        for _ in range(400):
            q = sets.solve_inner_problem(value, most=bool(most)).bound
            after = np.maximum.reduceat(q, mdp.pair_offsets[:-1])
            after[mdp.terminal] = 0
            value = np.minimum(after, value) if most else np.maximum(after, value)
        assert bounds.best[most] == pytest.approx(value, abs=1e-5)


def test_an_interval_says_what_it_rests_on() -> None:
    mdp = model(0, 100)
    own = own_of(mdp)
    interval = Robust(rewards=(0, 1)).interval(mdp, own, F(9, 10))
    bounds = robust_bounds(RowSets.of(mdp, 0.1, (0, 1)), own)
    assert (interval.low, interval.high) == pytest.approx(bounds.regret, rel=1e-9)
    assert interval.confidence == 0.9
    assert interval.found["learned_value"] == pytest.approx(bounds.at_start(mdp, bounds.own))
    assert interval.found["optimal_value"] == pytest.approx(bounds.at_start(mdp, bounds.best))
    assert "rewards lie from 0 to 1, as stated" in interval.assumptions
    stated = Robust(rewards=(0, 1), returns=(0, 10)).interval(mdp, own, F(9, 10))
    assert "total rewards lie from 0 to 10, as stated" in stated.assumptions
    with pytest.raises(ModelError, match="with a horizon"):
        Robust(rewards=(0, 1), returns=(0, 5)).interval(mdp, own_of(mdp, STAGES), F(9, 10))


def test_recorded_rewards_have_to_fit_the_range_of_totals() -> None:
    rows: Any = [
        (0, "a", "x", 4, "b"),
        (0, "b", "x", 1, None),
        (1, "a", "x", 4, "b"),
        (1, "b", "x", 1, None),
    ]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=NAMES), discount="1/2")
    # 4 + V/2 may be in the range for some V in it, and the last reward, 1, is in it by itself.
    for ends, good in (
        ((1, 4.5), True),
        ((1, 8), True),
        ((0, 3), False),
        ((1.1, 9), False),
        ((-9, 3.9), True),
        ((-8, 4), True),
        ((9, 10), False),
    ):
        if good:
            _require_seen(mdp, ends)
        else:
            with pytest.raises(ModelError, match="was seen, after which"):
                _require_seen(mdp, ends)


def test_where_episodes_were_cut_off_anything_may_follow() -> None:
    rows = [(n, "a", "xy"[n % 2], 1, "b" if n % 2 else None, n % 2 == 1) for n in range(40)]
    frame = pd.DataFrame(rows, columns=[*NAMES, "truncated"])
    mdp = MDP.from_transitions(frame, discount="1/2")
    sets = RowSets.of(mdp, 0.05, (0, 1))
    assert sets.unknown.sum() == 1
    bounds = robust_bounds(sets, own_of(mdp, [0] * mdp.n_states))
    (state,) = np.flatnonzero(sets.unknown).tolist()
    for sides in (bounds.own, bounds.best):
        assert sides[0][state] == pytest.approx(0, abs=1e-9)
        assert sides[1][state] == pytest.approx(2, rel=1e-5)
    assert bounds.lost[1][state] == pytest.approx(2, rel=1e-5)
    said = Robust(rewards=(0, 1)).assumptions(mdp, sets)
    assert any("have any value that rewards allow" in each for each in said)
