"""What a policy loses, beside policy iteration and all policies in fractions."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction as F
from itertools import product
from math import inf
from typing import Any

import numpy as np
import oracle
import pytest
from small_models import Chances, given, random_policy, small_model

from exact_mdp import MDP, ModelError, check, solve
from exact_mdp.analysis.gate import regret as module
from exact_mdp.analysis.gate.regret import (
    ActionBounds,
    bounded_optimum,
    include_near_ties,
    is_cheap_to_certify,
    limit_of,
    policy_regret,
)
from exact_mdp.solvers.bounds.bounds import Bounds, bound_optimal_values
from exact_mdp.solvers.bounds.gains import BoundedVector
from exact_mdp.solvers.claims import Certified, Claim
from exact_mdp.solvers.dynamic.methods import PolicyIteration
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.exact.certify import proven_optimum
from exact_mdp.solvers.values.policy_chain import PolicyChain, policy_of
from exact_mdp.solvers.values.policy_values import find_policy_values


def cases(discount: F, seeds: int = 8) -> Iterator[tuple[MDP, Chances, PolicyChain]]:
    for seed in range(seeds):
        mdp = small_model(seed, discount, falling=seed % 3 == 0, states=4)
        mdp = mdp.with_(sense="min" if seed % 2 else "max")
        chances = random_policy(mdp, seed, pure=seed % 4 > 1)
        yield mdp, chances, PolicyChain.of(mdp, given(chances))


def exactly(mdp: MDP, chances: Chances) -> tuple[list[F], list[F], list[F]]:
    """Optimal and own values, and what each pair falls short, of rewards or of costs."""
    sign, rate = mdp.sense.sign, mdp.discount_exact
    rows = [(s, a, sign * r, row) for s, a, r, row in oracle.rows_of(mdp)]
    best, _ = oracle.solve_exact(mdp.n_states, rows, rate)
    over = set(np.flatnonzero(mdp.terminal).tolist())
    own = oracle.policy_values(oracle.mixed(rows, chances), rate, over)
    gap = [best[s] - r - rate * oracle.mean(row, best) for s, _, r, row in rows]
    return [sign * v for v in best], [sign * v for v in own], gap


@pytest.mark.parametrize("discount", [F(0), F(9, 10), F(1)])
def test_certified_and_bounded_regrets_hold_the_exact_one(discount: F) -> None:
    for mdp, chances, chain in cases(discount):
        best, own, gap = exactly(mdp, chances)
        for exact in (True, False, None):
            lost = policy_regret(chain, exact=exact)
            wanted = sum((p * (best[s] - own[s]) * mdp.sense.sign for s, p in mdp.start), F(0))
            if exact is not False:
                assert lost.at_start == Certified(value=wanted)
                assert lost.claim is Claim.CERTIFIED
                assert lost.optimal_pairs.tolist() == [g == 0 for g in gap]
                assert lost.unclear is False
                assert isinstance(lost.optimum, Certificate)
            else:
                low, high = lost.at_start.bounds
                assert low <= wanted <= high <= wanted + F(1, 10**8)
                assert not (np.array([g == 0 for g in gap]) & ~lost.optimal_pairs).any()
                assert not wanted or lost.claim is Claim.BOUNDED
                assert isinstance(lost.optimum, Bounds)
                rivals = [
                    [k for k in mdp.pairs_of(s) if k != pair and gap[k] <= gap[pair]]
                    for pair, s in enumerate(mdp.pair_state.tolist())
                ]
                assert np.array_equal(
                    lost.unclear,
                    [g == 0 and bool(other) for g, other in zip(gap, rivals, strict=True)],
                )
            assert lost.forgiven == 0
            assert lost.gap == pytest.approx([*map(float, gap)], abs=1e-9)
            assert (lost.gap[lost.optimal_pairs] == 0).all()
            assert lost.optimal_value == pytest.approx([*map(float, best)], rel=1e-9, abs=1e-9)
            assert lost.learned_value == pytest.approx([*map(float, own)], rel=1e-9, abs=1e-9)
            apart = [float(mdp.sense.sign * (b - o)) for b, o in zip(best, own, strict=True)]
            assert lost.by_state == pytest.approx(apart, rel=1e-9, abs=1e-9)
            for number, values in ((lost.optimal, best), (lost.learned, own)):
                low, high = number.bounds
                assert low <= sum((p * values[s] for s, p in mdp.start), F(0)) <= high


def test_totals_of_runs_that_never_end() -> None:
    judged = 0
    for seed in range(24):
        mdp = small_model(seed, leaving=False, ends=1, states=3, start=seed % 3)
        chances = random_policy(mdp, seed, pure=True)
        rows = oracle.rows_of(mdp)
        best = oracle.best_total(rows)
        own = oracle.total(oracle.mixed(rows, chances))
        begin = mdp.start[0][0]
        if abs(best[begin]) == inf and best[begin] == own[begin]:
            with pytest.raises(ModelError, match="both infinite"):
                policy_regret(PolicyChain.of(mdp, given(chances)))
            continue
        lost = policy_regret(PolicyChain.of(mdp, given(chances)))
        proven = proven_optimum(mdp).optimal_pairs
        judged += 1
        assert lost.at_start.value < inf or lost.forgiven == 0
        assert lost.at_start.value == best[begin] - own[begin]
        for state in range(mdp.n_states):
            wanted = 0.0 if best[state] == own[state] else float(best[state] - own[state])
            assert lost.by_state[state] == pytest.approx(wanted, rel=1e-12)
        optimal = lost.optimal_pairs
        assert (lost.gap[optimal] == 0).all()
        for (s, a), _ in chances.items():
            if own[s] == best[s] and abs(best[s]) < inf:
                assert optimal[mdp.pair(s, a)]
        for pair, (s, _, r, row) in enumerate(rows):
            if any(abs(best[t]) == inf for t in (s, *row)):
                if proven[pair] and mdp.pair_action[pair] in (a for t, a in chances if t == s):
                    assert lost.gap[pair] in (0, inf)  # it may be to blame
                else:
                    assert lost.gap[pair] == (0 if proven[pair] else inf)
            elif not optimal[pair]:
                short = (
                    best[s] - r - oracle.mean(row, [F(v) if abs(v) < inf else F(0) for v in best])
                )
                assert lost.gap[pair] == float(short)
    assert judged > 12


def test_who_waits_is_wrong_though_no_gap_says_so() -> None:
    """Of finite and of infinite values: in a class the gap stays 0, on the way it is infinite."""
    half: Any = [(F(1, 2), 2, 0), (F(1, 2), 4, 0)]
    rows: Any = [
        (0, 0, half),
        (0, 1, [(1, 2, 0)]),
        (1, 0, [(1, 1, 0)]),
        (1, 1, [(1, 4, 4)]),
        (1, 2, [(F(1, 2), 4, 0), (F(1, 2), 5, 9)]),
        (2, 0, [(1, 2, 1)]),
        (2, 1, [(1, 0, 0)]),
        (3, 0, [(1, 3, 0)]),
        (3, 1, [(1, 2, 0)]),
        (4, 0, [(1, 4, 0)]),
        (5, 0, [(1, 5, -1)]),
        (6, 0, [(1, 6, 0)]),
        (6, 1, [(1, 2, 0)]),
    ]
    gap = [inf, 0, 0, 0, inf, *[0] * 8]
    for turn in (False, True):  # so that the classes have other numbers
        place = [6 - s if turn else s for s in range(7)]
        named = [(place[s], a, [(p, place[t], r) for p, t, r in row]) for s, a, row in rows]
        mdp = MDP.from_outcomes(named, start={place[0]: F(1, 2), place[1]: F(1, 2)})
        taken = np.zeros(7, dtype=int)
        taken[place[2]] = 1
        lost = policy_regret(PolicyChain.of(mdp, taken))
        each = [mdp.pair(place[s], a) for s, a, _ in rows]
        assert lost.gap[each].tolist() == gap
        assert np.flatnonzero(~lost.optimal_pairs[each]).tolist() == [0, 2, 4, 7, 11]
        assert lost.by_state[place].tolist() == [inf, 4, inf, inf, 0, 0, inf]


def test_a_regret_that_rounding_explains_is_forgiven_where_some_policies_never_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whether all of it, as with 0.3 for 0.1 + 0.2: what is not taken, or not met, stays wrong."""
    rows: Any = [
        (0, 0, [(1, 1, 0.1)]),
        (0, 1, [(1, 2, 0.3)]),
        (0, 2, [(1, 2, 0.0)]),
        (1, 0, [(1, 2, 0.2)]),
        (2, 0, [(1, 2, 0.0)]),
        (3, 0, [(1, 3, 0.0)]),
        (3, 1, [(1, 2, 1.0)]),
    ]
    mdp = MDP.from_outcomes(rows)
    assert mdp.ends.has_improper_policy
    true = F(0.1) + F(0.2) - F(0.3)
    own = [[True, tie, False, True, True, False, True] for tie in (True, False)]
    for action, optimal in ((0, own[1]), (1, own[0]), (2, own[1])):
        lost = policy_regret(PolicyChain.of(mdp, [action, 0, 0, 0]))
        assert lost.at_start.value == [0, true, F(0.1) + F(0.2)][action]
        assert (lost.forgiven > true) == (action == 1)
        assert lost.forgiven < F(1, 10**16)
        assert lost.optimal_pairs.tolist() == optimal
    for most, optimal in ((true, own[0]), (true / 2, own[1])):
        monkeypatch.setattr(module, "compute_rounding_allowance", lambda *_, most=most: most)
        assert policy_regret(PolicyChain.of(mdp, [1, 0, 0, 0])).optimal_pairs.tolist() == optimal


def test_a_gap_that_rounding_explains_is_a_tie_if_the_regret_is_explained(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rows: Any = [(0, 0, [(1, 1, 1.0)]), (0, 1, [(1, 1, 0.5)]), (1, 0, [(1, 1, 0.0)])]
    chain = PolicyChain.of(MDP.from_outcomes(rows), [1, 0])
    edge = np.nextafter(0.5, 1)
    for tie, most, same in ((edge, F(1, 2), True), (0.5, F(1, 2), False), (edge, F(1, 3), False)):
        gaps = np.array([0.0, tie, 0.0])
        monkeypatch.setattr(module, "compute_tie_gaps", lambda *_, gaps=gaps: gaps)
        monkeypatch.setattr(module, "compute_rounding_allowance", lambda *_, most=most: most)
        assert policy_regret(chain, exact=True).optimal_pairs.tolist() == [True, same, True]


def test_pairs_lose_if_their_least_gap_is_more_than_a_tie_allows() -> None:
    """And in a model of exact numbers, if it is more than 0."""
    for kind in (float, F):
        for discount, seed in product((F(1, 2), F(99, 100)), range(4)):
            rng = np.random.default_rng(seed)
            rows: Any = [
                (s, a, [(kind(1), int(rng.integers(3)), kind(1 + s / 64 + a / 128))])
                for s in range(3)
                for a in range(2)
            ]
            mdp = MDP.from_outcomes([*rows[:-2], (2, 0, [(kind(1), 2, kind(1.5))])], discount)
            optimum = bounded_optimum(mdp)
            ideal = PolicyChain.of_pairs(mdp, optimum.pairs)
            known = BoundedVector(value=optimum.value, error=optimum.state_error)
            tie = module.compute_tie_gaps(ideal, known)
            for times in (-1.0, 0.0, 0.01, 0.9, 1.0, 1.5, 1e3, 1e9):
                loses = module._find_losing_pairs(ideal, known, times * tie)
                assert (loses == (times > (kind is float))).all()


def test_bounds_of_the_optimum_are_made_narrow_if_the_solver_stopped_early(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for seed in range(3):
        mdp = small_model(seed, "9/10").maximised
        best, _, _ = exactly(mdp, random_policy(mdp, seed))
        solved = solve(mdp)
        far = abs(solved.value).max()
        wide = bound_optimal_values(mdp, solved.value - 1e-6 * far * ~mdp.terminal).error / far
        for off in (0.0, 1e-6 * far * 0.75 * 2.0**-36 / wide, 1e-6 * far):
            early = replace(solved, value=solved.value - off * ~mdp.terminal)
            calls = list[int]()

            class Counted(PolicyIteration):
                def __init__(self, calls: list[int] = calls, **of: Any) -> None:
                    calls.append(1)
                    super().__init__(**of)

            monkeypatch.setattr(module, "solve_total", lambda _, early=early: early)
            monkeypatch.setattr(module, "PolicyIteration", Counted)
            bounds = bounded_optimum(replace(mdp))
            assert bounds.error <= 2.0**-36 * abs(bounds.value).max()
            assert bounds.value == pytest.approx([*map(float, best)], rel=1e-10, abs=1e-10)
            assert bool(calls) == (off > 1e-7 * far)


def test_bounds_of_actions_hold_their_exact_gains() -> None:
    for discount in (F(1, 2), F(1)):
        for mdp, chances, _ in cases(discount, 6):
            mdp = mdp.maximised
            best, _, gap = exactly(mdp, chances)
            bounds = bounded_optimum(mdp)
            near = ActionBounds(mdp, bounds)
            for pair, s in enumerate(mdp.pair_state.tolist()):
                gain = best[s] - gap[pair] - F(float(bounds.value[s]))
                assert F(float(near.low[pair])) <= gain <= F(float(near.high[pair]))
                assert near.high[pair] - near.low[pair] < 1e-8
                assert near.least_gap[pair] <= gap[pair]
                assert near.gap[pair] == pytest.approx(float(gap[pair]), abs=1e-9)
                others = [gap[k] for k in mdp.pairs_of(s) if k != pair]
                beaten = bool(others) and min(others) < gap[pair]
                if beaten:
                    assert near.open[pair]
                if all(g > gap[pair] + F(1, 10**6) for g in others):
                    assert not near.open[pair]


def test_bounds_that_are_wide_stay_sound() -> None:
    """Of values that are off, whose bounds say by how much."""
    for mdp, chances, _ in cases(F(1, 2), 6):
        mdp = mdp.maximised
        best, _, gap = exactly(mdp, chances)
        known = bounded_optimum(mdp)
        for low, high in ((-0.5, 0.25), (-0.125, 0.5)):
            for share in (0.0, 0.5, 1.0):
                shift = (low + share * (high - low)) * known.weight
                value = known.value - shift
                off = Bounds(
                    value=value,
                    weight=known.weight,
                    pairs=known.pairs,
                    low=low,
                    high=high,
                )
                near = ActionBounds(mdp, off)
                for pair, s in enumerate(mdp.pair_state.tolist()):
                    gain = best[s] - gap[pair] - F(float(value[s]))
                    assert F(float(near.low[pair])) <= gain <= F(float(near.high[pair]))
                    flow = mdp.discount * float((mdp.transition[[pair]] @ known.weight)[0])
                    assert near.high[pair] - near.low[pair] <= (high - low) * flow + 1e-5
                    assert near.least_gap[pair] <= gap[pair]
                    own = [*mdp.pairs_of(s)]
                    least = max(F(float(near.low[k])) for k in own) - F(float(near.high[pair]))
                    assert F(float(near.least_gap[pair])) <= least
                    assert float(least) == pytest.approx(near.least_gap[pair], abs=1e-12)
                    beaten = any(near.high[k] > near.low[pair] for k in own if k != pair)
                    assert near.open[pair] == beaten
                    q = {
                        k: mdp.reward[k] + 0.5 * float((mdp.transition[[k]] @ value)[0])
                        for k in own
                    }
                    assert near.gap[pair] == pytest.approx(max(q.values()) - q[pair], abs=1e-12)
    nothing = MDP.from_outcomes([(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])])
    zero = Bounds(
        value=np.zeros(2), weight=np.array([1.0, 0]), pairs=np.array([0, 2]), low=0.0, high=0.0
    )
    near = ActionBounds(nothing, zero)
    assert (near.low < 0).all()
    assert (near.high > 0).all()
    assert near.open.tolist() == [True, True, False]


def test_optimal_pairs_have_no_gap() -> None:
    losses = module.StateLosses(
        optimal_value=np.array([3.0, 0.0]),
        learned_value=np.array([1.0, 0.0]),
        by_state=np.zeros(2),
        optimal_pairs=np.array([True, False]),
        gap=np.array([1e-17, 2.0]),
    )
    both = Certified(value=F(3)), Certified(value=F(1))
    lost = module.Regret.from_values(*both, lambda: losses)
    assert lost.gap.tolist() == [0, 2]
    assert lost.at_start.value == 2
    costs = lost.negated(MDP.from_arrays([[[1]]], [1], "1/2", sense="min"))
    assert (costs.optimal.value, costs.learned.value, costs.at_start.value) == (-3, -1, 2)
    assert costs.optimal_value.tolist() == [-3, 0]
    assert costs.learned_value.tolist() == [-1, 0]
    assert (lost == costs, lost == 2, lost == 3, costs == replace(lost, at_start=both[0])) == (
        True,
        True,
        False,
        False,
    )


def test_a_policy_is_best_where_bounds_prove_each_of_its_pairs() -> None:
    twin: Any = [(F(1, 2), 1, 4), (F(1, 2), 2, 0)]
    merged: Any = [(F(1, 2), 1, 3), (F(1, 2), 2, 1)]
    rows: Any = [
        (0, 0, twin),
        (0, 1, merged),
        (0, 2, [(1, 1, 1)]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
    mdp = MDP.from_outcomes(rows)
    near = ActionBounds(mdp, bounded_optimum(mdp))
    for action, best in ((0, True), (1, True), (2, False)):
        chain = PolicyChain.of(mdp, [action, 0, 0])
        assert near.all_best(chain) == best
        lost = policy_regret(chain, exact=False)
        assert isinstance(lost.at_start, Certified) == best
        assert lost.keeps_limit(F(0)) == best
        assert np.asarray(lost.unclear).tolist() == [True, True, False, False, False]
    turned = MDP.from_outcomes([(0, 2, twin), (0, 1, merged), (0, 0, [(1, 1, 1)]), *rows[3:]])
    near_turned = ActionBounds(turned, bounded_optimum(turned))
    assert near_turned.all_best(PolicyChain.of(turned, [1, 0, 0]))
    never = PolicyChain.of(mdp.with_(start=1), [2, 0, 0])
    assert near.all_best(PolicyChain(mdp=never.mdp, chosen=never.chosen))


@pytest.mark.parametrize("sense", ["max", "min"])
def test_large_models_without_cycles_are_decided_exactly(
    sense: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bounds leave ties open, of which the policy takes one; the exact values decide."""
    monkeypatch.setattr(module, "EXACT_IN_TIME", 0)
    seen = set()
    for seed in range(30):
        rng = np.random.default_rng(seed)
        # Rewards of few values, and rows of few shapes, make many ties that are no twins.
        rows: list[Any] = []
        for state in range(6):
            for action in range(3):
                ends = state + 1 + rng.integers(0, 2, size=2)
                row = {int(end): F(0) for end in ends}
                for end, chance in zip(ends.tolist(), (F(1, 3), F(2, 3)), strict=True):
                    row[end] += chance
                rows.append(
                    (state, action, [(p, to, int(rng.integers(2))) for to, p in row.items()])
                )
        rows += [(end, 0, [(1, end, 0)]) for end in (6, 7)]
        start = {0: F(1, 2), 1: F(1, 2)}
        mdp = MDP.from_outcomes(rows, "2/3", sense=sense, start=start).within(6)
        best = policy_of(mdp, "optimal")
        policies = [best, policy_of(mdp, "random"), np.zeros(mdp.n_states, dtype=int)]
        for number, policy in enumerate(policies):
            chain = PolicyChain.of(mdp, policy)
            exactly, found = policy_regret(chain, exact=True), policy_regret(chain)
            wanted = exactly.at_start.value
            assert not number or wanted >= 0
            if number == 0:
                assert found.at_start == Certified(value=F(0))
            if isinstance(found.optimal, Certified):
                assert (found.optimal, found.learned) == (exactly.optimal, exactly.learned)
            low, high = found.at_start.bounds
            assert low <= wanted <= high
            seen.add((number, found.claim, found.optimal.claim))
            bounded = policy_regret(chain, exact=False)
            decided = bounded.claim is Claim.CERTIFIED or bounded.bounds[0] <= 0
            assert found.claim is (Claim.CERTIFIED if decided else Claim.BOUNDED)
    assert {(0, Claim.CERTIFIED, Claim.CERTIFIED), (1, Claim.BOUNDED, Claim.BOUNDED)} <= seen
    # If many pairs are open, and if bounds are asked for, the regret stays bounded.
    monkeypatch.setattr(module, "EXACT_TRANSITIONS", 0)
    chain = PolicyChain.of(mdp, best)
    assert policy_regret(chain).claim is policy_regret(chain, exact=False).claim


def test_a_loss_below_the_bounds_is_found_among_the_open_pairs_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """1e-18 of a reward; as many transitions count as open pairs have, of states that they meet."""
    less = 1 - F(1, 10**18)
    rows: Any = [
        (0, 0, [(1, 1, 1)]),
        (0, 1, [(F(1, 2), 2, less), (F(1, 2), 4, less)]),
        (0, 2, [(F(1, 2), 3, 0), (F(1, 4), 2, 0), (F(1, 4), 4, 0)]),
        (1, 0, [(1, 4, 0)]),
        (2, 0, [(1, 4, 0)]),
        (2, 1, [(F(1, 2), 3, F(-1, 2)), (F(1, 2), 4, 0)]),
        (3, 0, [(F(1, 2), 4, 0), (F(1, 2), 1, 0)]),
        (4, 0, [(1, 4, 0)]),
    ]
    mdp = MDP.from_outcomes(rows)
    monkeypatch.setattr(module, "EXACT_TRANSITIONS", 5 + 1)
    monkeypatch.setattr(module, "LAST_CYCLE", 0)
    for action, wanted in ((0, F(0)), (1, F(1, 10**18))):
        chain = PolicyChain.of(mdp, [action, 0, 0, 0, 0])
        bounded = policy_regret(chain, exact=False)
        assert bounded.claim is Claim.BOUNDED
        assert module._decide_exactly(chain, bounded).at_start == Certified(value=wanted)
    monkeypatch.setattr(module, "EXACT_TRANSITIONS", 5)
    assert module._decide_exactly(chain, bounded) is bounded


def test_few_transitions_and_short_cycles_are_cheap(monkeypatch: pytest.MonkeyPatch) -> None:
    rows: Any = [(s, 0, [(F(1, 2), (s + 1) % 4, 1), (F(1, 2), 4, 0)]) for s in range(4)]
    mdp = MDP.from_outcomes([*rows, (4, 0, [(1, 4, 0)])])
    assert (is_cheap_to_certify(mdp, 4), is_cheap_to_certify(mdp, 3), is_cheap_to_certify(mdp)) == (
        True,
        False,
        True,
    )
    for n in (200, 201):
        circle: Any = [(s, 0, [(F(1, 2), (s + 1) % n, 1), (F(1, 2), n, 0)]) for s in range(n)]
        assert is_cheap_to_certify(MDP.from_outcomes([*circle, (n, 0, [(1, n, 0)])])) == (n == 200)
    falling = small_model(0, falling=True)
    assert is_cheap_to_certify(falling, 1)
    assert not is_cheap_to_certify(falling, 0)
    for most, answer in ((mdp.n_transitions, True), (mdp.n_transitions - 1, False)):
        monkeypatch.setattr(module, "EXACT_TRANSITIONS", most)
        assert is_cheap_to_certify(mdp) == answer
    stopped = mdp.within(2)
    for most, answer in ((stopped.n_transitions, True), (stopped.n_transitions - 1, False)):
        monkeypatch.setattr(module, "EXACT_IN_TIME", most)
        assert is_cheap_to_certify(stopped) == answer
    monkeypatch.setattr(module, "EXACT_TRANSITIONS", 0)
    other = small_model(1, "1/2")
    chain = PolicyChain.of(other, given(random_policy(other, 1)))
    assert policy_regret(chain).claim is Claim.BOUNDED
    assert policy_regret(chain, exact=True).claim is Claim.CERTIFIED


def test_ties_count_unless_their_sum_is_too_much() -> None:
    mdp = small_model(0)
    chain = PolicyChain.of(mdp, given(random_policy(mdp, 0, pure=True)))
    taken = chain.chosen > 0
    none = np.zeros(mdp.n_pairs, dtype=bool)
    for optimal, near in ((none, taken), (taken, none)):
        for lost, most, both in ((F(1), F(2), True), (F(2), F(2), True), (F(3), F(2), False)):
            found = include_near_ties(chain, optimal, near, lost, lambda most=most: most)
            assert found.tolist() == (taken if both else optimal).tolist()
    part = taken.copy()
    part[int(taken.argmax())] = False
    assert include_near_ties(chain, none, part, F(3), lambda: F(2)).tolist() == part.tolist()


def test_floats_tie_within_their_rounding_and_exact_numbers_do_not() -> None:
    """0.1 + 0.2 and 0.3 are the same to whoever writes them."""
    for kind, same in ((float, True), (F, False)):
        rows: Any = [
            (0, 0, [(1, 1, kind(0.1))]),
            (0, 1, [(1, 2, kind(0.3))]),
            (1, 0, [(1, 2, kind(0.2))]),
            (2, 0, [(1, 2, kind(0))]),
        ]
        mdp = MDP.from_outcomes(rows)
        for exact in (True, False):
            for action in (0, 1):
                lost = policy_regret(PolicyChain.of(mdp, [action, 0, 0]), exact=exact)
                best = F(0.1) + F(0.2) > F(0.3)
                assert bool(lost.optimal_pairs[action]) == (
                    same or best == (action == 0) or not exact
                )
                assert lost.forgiven < F(1, 10**16)
                assert (lost.forgiven > 0) == same
    far: Any = [(0, 0, [(1, 1, 0.1)]), (0, 1, [(1, 1, 0.1 + 1e-12)]), (1, 0, [(1, 1, 0.0)])]
    for exact in (True, False):
        lost = policy_regret(PolicyChain.of(MDP.from_outcomes(far), [0, 0]), exact=exact)
        assert lost.optimal_pairs.tolist() == [False, True, True]
        assert lost.keeps_limit(lost.forgiven) is False


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("learned", [[1, 0], "random"])
def test_a_bounded_regret_keeps_the_errors_of_both_values(
    monkeypatch: pytest.MonkeyPatch, learned: Any, sign: int
) -> None:
    """Values as far off as their errors allow: the interval holds the exact regret all the same."""
    rows: Any = [(0, 0, [(1, 1, F(5))]), (0, 1, [(1, 1, F(1))]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, "1/2")
    true = check(mdp, learned).regret.at_start.value
    chain = PolicyChain.of(mdp, policy_of(mdp, learned))
    own, best = find_policy_values(chain), module.bounded_optimum(mdp)
    shift = sign * best.weight / 8
    far = replace(own, value=own.value - 2 * shift, error=own.error + 2 * abs(shift))
    monkeypatch.setattr(module, "find_policy_values", lambda _: far)
    off = replace(best, value=best.value + shift, low=-0.126, high=0.126)
    low, high = module._bound_regret(mdp, chain, off).at_start.interval
    assert low <= true <= high
    assert high - low < 0.8  # no wider than twice both errors


def test_a_limit_is_an_exact_number_from_0_up_to_the_largest_float() -> None:
    assert limit_of("max_regret", "1/3") == F(1, 3)
    assert limit_of("max_regret", 0) == 0
    assert limit_of("max_regret", module.LARGEST) == module.LARGEST
    for wrong, words in ((-1, "is -1"), (module.LARGEST * 2, "beyond the floats")):
        with pytest.raises(ModelError, match=words):
            limit_of("max_regret", wrong)
