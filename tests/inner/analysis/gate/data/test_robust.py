"""Bounds for every model that records allow, beside sampled models and their own fixed points."""

from dataclasses import replace
from fractions import Fraction as F
from itertools import count, product
from math import sqrt
from typing import Any

import numpy as np
import oracle
import pandas as pd
import pytest
from records import NAMES, POLICY, STAGES, estimated, recorded

from exact_mdp import MDP, ModelError, Robust
from exact_mdp.analysis.gate.data import robust as module
from exact_mdp.analysis.gate.data.robust import (
    Operators,
    _bound_totals,
    _require_seen,
    robust_bounds,
)
from exact_mdp.analysis.gate.data.sets import RowSets
from exact_mdp.solvers.claims import Claim, SolverError

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
        least, most = (sets.at_start(bounds.lost[k], most=bool(k)) for k in (0, 1))
        assert (low, high) == (max(least, 0), most) == bounds.at_start(sets.mdp, bounds.lost)
        assert least < most
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


def certain(sense: str = "max") -> RowSets:
    """Three states with six actions each, whose rows are as certain as the model says."""
    rng = np.random.default_rng(0)
    rows = [
        (n, "abc"[n % 3], n // 3 % 6, float(rng.normal()), [None, "a", "b", "c"][to])
        for n, to in enumerate(rng.integers(0, 4, size=90).tolist())
    ]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=NAMES), discount="9/10", sense=sense)
    sets = RowSets.of(mdp, 0.05, (-5, 5))
    return replace(sets, counted=0 * sets.counted)


def mixture(mdp: MDP, rng: np.random.Generator) -> np.ndarray:
    weight = np.where(mdp.forced[mdp.pair_state], 1.0, rng.random(mdp.n_pairs))
    return weight / np.bincount(mdp.pair_state, weight)[mdp.pair_state]


def test_bounds_of_advantages_are_those_of_the_head() -> None:
    """Own and others' ends at the middle, and γ Σ |P_l - P_π| h with what rows may move."""
    for episodes in (60, 6):
        mdp = model(0, episodes)
        sets, rng = RowSets.of(mdp, 0.05, (0, 1)), np.random.default_rng(0)
        own, low = mixture(mdp, rng), rng.normal(size=mdp.n_states)
        high = low + rng.random(mdp.n_states)
        found = Operators(sets=sets, own=own, ends=(-9.0, 9.0)).bound_advantages(low, high)
        middle, h, rows = (low + high) / 2, (high - low) / 2, mdp.transition.toarray()
        ends = [sets.solve_inner_problem(middle, most=most).bound for most in (False, True)]
        moved = [min(sqrt(2 * radius), 2) * h.max() for radius in sets.radius]
        for pair, s in enumerate(mdp.pair_state.tolist()):
            here = mdp.pairs_of(s)
            others = [k for k in here if k != pair]
            apart = float(abs(rows[pair] - sum(own[k] * rows[k] for k in here)) @ h)
            apart += (1 - own[pair]) * moved[pair] + sum(own[k] * moved[k] for k in others)
            for bound, mine, theirs, sign in zip(found, ends, ends[::-1], (-1, 1), strict=True):
                wide = sign * (bound[pair] - (1 - own[pair]) * mine[pair])
                wide += sign * sum(own[k] * theirs[k] for k in others)
                least = 0.0 if own[pair] == 1 else mdp.discount * apart
                assert least <= wide <= least * (1 + 2e-6)


def test_rounding_is_on_the_side_of_the_bounds() -> None:
    """Of advantages and mixtures, beside fractions of the same floats, large ones and small."""
    rng, few = np.random.default_rng(0), RowSets.of(model(0), 0.05, (0, 1))
    few = replace(few, counted=0 * few.counted)
    for sets in [certain(), few] * 30:
        mdp = sets.mdp
        own = mixture(mdp, rng)
        value = rng.normal(size=mdp.n_states) * 10.0 ** rng.integers(-6, 7, size=mdp.n_states)
        at = Operators(sets=sets, own=own, ends=(-50.0, 50.0))
        found = at.bound_advantages(value, value)
        ends = [sets.solve_inner_problem(value, most=most).bound for most in (False, True)]
        share = [F(x) for x in own.tolist()]
        steps = [at.apply_operator(value, most=most, mixing=at.mixing).bound for most in (0, 1)]
        for s in range(mdp.n_states):
            here = mdp.pairs_of(s)
            for sign, each, other, bounds, step in (
                (-1, *ends, found[0], steps[0]),
                (1, *ends[::-1], found[1], steps[1]),
            ):
                mean = sum(share[k] * F(float(each[k])) for k in here)
                assert 0 <= sign * (F(float(step[s])) - mean) <= F(1e-13 * abs(each[here]).max())
                for pair in here[: len(here) * (len(here) > 1)]:
                    exact = (1 - share[pair]) * F(float(each[pair])) - sum(
                        share[k] * F(float(other[k])) for k in here if k != pair
                    )
                    size = float(max(abs(each[here]).max(), abs(other[here]).max()))
                    wide = sign * (F(float(bounds[pair])) - exact)
                    assert 0 <= wide <= F(1e-13 * size)


def test_the_piece_of_a_step_is_the_step_at_its_values() -> None:
    """γ P v + c; states in which episodes were cut off are worth the end of the range, always."""
    rows = [(n, "a", "xy"[n % 2], 1, "bc"[n % 3 > 0], n % 3 == 0) for n in range(39)]
    rows += [(n, "c", "xy"[n % 2], n % 2, None, False) for n in range(39) if n % 3]
    rows.sort(key=lambda row: row[0])
    frame = pd.DataFrame(rows, columns=[*NAMES, "truncated"])
    mdp = MDP.from_transitions(frame, discount="1/2")
    sets, rng = RowSets.of(mdp, 0.05, (0, 1)), np.random.default_rng(0)
    cut = sets.unknown
    assert cut.any()
    at = Operators(sets=sets, own=mixture(mdp, rng), ends=(-3.0, 7.0))
    for _ in range(4):
        value = rng.normal(size=mdp.n_states) * 4
        pair_bounds = rng.normal(size=(2, mdp.n_pairs)) * 2
        losing = pair_bounds[0], pair_bounds[1] + 1
        for most, of in product((0, 1), ({}, {"mixing": at.mixing}, {"losing": losing})):
            step = at.apply_operator(value, most=most, **of)
            matrix, constant = step.piece()
            assert mdp.discount * (matrix @ value) + constant == pytest.approx(step.bound, abs=1e-9)
            assert (step.bound[cut] == (10 * most if "losing" in of else (-3, 7)[most])).all()
            q = sets.solve_inner_problem(value, most=bool(most), rewards="losing" not in of).bound
            if "losing" in of:
                q = (np.minimum if most else np.maximum)(losing[0] + q, losing[1])
            best = [
                sum(at.own[k] * q[k] for k in here) if "mixing" in of else max(q[here])
                for here in map(mdp.pairs_of, range(mdp.n_states))
            ]
            assert step.bound[~cut] == pytest.approx(np.array(best)[~cut], abs=1e-12)


def test_bounds_hold_wherever_the_search_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """At values below a fixed point, v + e / (1 - γ) is the fixed point, and so from above."""
    sets = certain()
    mdp = sets.mdp
    exact, _ = oracle.solve_exact(mdp.n_states, oracle.rows_of(mdp), F(9, 10))
    at = Operators(sets=sets, own=mixture(mdp, np.random.default_rng(0)), ends=(-50.0, 50.0))
    ended = np.array(exact, dtype=float)
    for most, side in ((1, 1), (0, -1)):

        class Off:
            def __init__(self, *_: Any) -> None: ...

            def approximate(self, _: Any, side: int = side) -> Any:
                return ended - side

        monkeypatch.setattr(module, "LinearSystem", Off)
        found = at.bound_fixed_point(most, None)
        for bound, value in zip(found.tolist(), exact, strict=True):
            assert 0 <= side * (F(bound) - value) < F(1, 10**5)


def test_the_search_ends_once_a_step_moves_little(monkeypatch: pytest.MonkeyPatch) -> None:
    """Less than 1e-10 of the range."""
    sets = certain()
    own = mixture(sets.mdp, np.random.default_rng(0))
    wide, none = (-2.0, 6.0), (0.25, 0.25)
    for ends, move, steps in ((wide, 0, 2), (wide, 7e-10, 2), (wide, 9e-10, 50), (none, 0, 2)):
        calls = count()

        class Slow:
            def __init__(self, *_: Any) -> None: ...

            def approximate(self, _: Any, move: float = move, calls: Any = calls) -> Any:
                return np.full(sets.mdp.n_states, 0.25 + move * next(calls))

        monkeypatch.setattr(module, "LinearSystem", Slow)
        Operators(sets=sets, own=own, ends=ends).bound_fixed_point(1, None)
        assert next(calls) == steps


def test_stages_show_a_bar_on_a_terminal_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[dict[str, Any]]()

    def counted(*ends: int, **how: Any) -> range:
        asked.append(how)
        return range(*ends)

    monkeypatch.setattr(module.tqdm, "trange", counted)
    mdp = model()
    robust_bounds(RowSets.of(mdp, 0.05, (0, 1)), own_of(mdp, STAGES))
    assert asked == [{"desc": "stages", "disable": None, "delay": 2}]


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
    assert interval.claim is Claim.BOUNDED
    untaken = "actions that nobody took are as the model says"
    assert untaken not in interval.assumptions
    sets = RowSets.of(mdp, 0.1, (0, 1))
    fewer = replace(sets, counted=np.where(mdp.pair_state == 1, 0.0, sets.counted))
    assert untaken in Robust(rewards=(0, 1)).assumptions(mdp, fewer)
    assert interval.found["learned_value"] == pytest.approx(bounds.at_start(mdp, bounds.own))
    assert interval.found["optimal_value"] == pytest.approx(bounds.at_start(mdp, bounds.best))
    assert "rewards lie from 0 to 1, as stated" in interval.assumptions
    stated = Robust(rewards=(0, 1), returns=(0, 10)).interval(mdp, own, F(9, 10))
    assert "total rewards lie from 0 to 10, as stated" in stated.assumptions
    with pytest.raises(SolverError, match=r"beyond the range.*scale the rewards"):
        Robust(rewards=(0, 1e308)).interval(mdp, own, F(9, 10))
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
    once = MDP.from_transitions(pd.DataFrame(rows[:2], columns=NAMES), discount="1/2")
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
            for seen in (mdp, once):
                with pytest.raises(ModelError, match="was seen, after which"):
                    _require_seen(seen, ends)


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
