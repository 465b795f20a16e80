"""Losses of recurrent classes, beside all policies of small models in fractions."""

from fractions import Fraction as F
from itertools import product
from math import inf
from typing import Any

import numpy as np
import oracle
import pytest
from small_models import Chances, given, random_policy, small_model

from exact_mdp import MDP, check
from exact_mdp.analysis.gate.class_losses import (
    _find_third_order_losses,
    charge_class_losses,
    compute_exact_row,
    final_class,
    find_attaining_pairs,
    find_zero_reward_pairs,
    to_blame,
)
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.exact.certify import proven_optimum
from exact_mdp.solvers.values.policy_chain import PolicyChain


def test_twins_have_the_same_outcomes() -> None:
    for seed in range(10):
        mdp = small_model(seed)
        for pair, (_, _, reward, row) in enumerate(oracle.rows_of(mdp)):
            assert compute_exact_row(mdp, pair) == (reward, frozenset(row.items()))


def test_final_classes_are_the_recurrent_ones_but_ends() -> None:
    for seed in range(12):
        mdp = small_model(seed, leaving=False)
        rng = np.random.default_rng(seed)
        pairs = [int(rng.choice(mdp.pairs_of(s))) for s in range(mdp.n_states)]
        label = final_class(PolicyChain.of_pairs(mdp, np.array(pairs)))
        found = {frozenset(np.flatnonzero(label == k).tolist()) for k in {*label.tolist()} - {-1}}
        every = map(frozenset, oracle.classes(oracle.rows_of(mdp, pairs)))
        assert found == {each for each in every if not mdp.terminal[min(each)]}


def test_what_waiting_loses_is_shared_among_those_to_blame() -> None:
    rng = np.random.default_rng(0)
    for _ in range(60):
        size = 7
        label = rng.integers(-1, 3, size=size)
        came, by_state = rng.integers(0, 3, size=size) / 2, rng.integers(0, 4, size=size) / 4
        gap = rng.choice([0.0, 0.0, 0.0, 1.0], size=size)
        wrong = rng.random(size) < 0.6
        found = charge_class_losses(label, came, by_state, gap, wrong)
        for state in range(size):
            own = [s for s in range(size) if label[s] == label[state]]
            blamed = [s for s in own if wrong[s]]
            lost = sum(came[s] * by_state[s] for s in own)
            open_ = label[state] >= 0 and wrong[state] and not any(gap[s] > 0 for s in own)
            wanted = lost / len(blamed) if open_ else 0.0
            assert found[state] == pytest.approx(wanted)
    never = charge_class_losses(
        np.array([0]), np.zeros(1), np.array([inf]), np.zeros(1), np.array([True])
    )
    assert never.tolist() == [0]
    none = np.full(2, -1), np.ones(2), np.ones(2), np.zeros(2), np.array([True, False])
    assert charge_class_losses(*none).tolist() == [0, 0]


def waiting_models(seeds: int) -> Any:
    """Models of few states in which rewards of 0 are many, so that states may be kept for ever."""
    for seed in range(seeds):
        rng, rows = np.random.default_rng(seed), []
        for s in range(3):
            for a in range(int(rng.integers(1, 4))):
                following = rng.integers(0, 4, size=rng.integers(1, 3)).tolist()
                reward = int(rng.choice([0, 0, 0, -1, 1]))
                rows.append((s, a, [(F(1, len(following)), t, reward) for t in following]))
        rows.append((3, 0, [(1, 3, 0)]))
        yield MDP.from_outcomes(rows)


def circling_models(seeds: int) -> Any:
    """States on a circle with ways across: rewards are differences of heights, here and there one
    less, so that many circles keep every value. One more state, which nobody enters, is worth ∞.
    """
    for seed in range(seeds):
        rng, rows = np.random.default_rng(seed), []
        height = rng.integers(0, 4, size=4).tolist()
        for s in range(4):
            ends = [*{(s + 1) % 4, *rng.integers(0, 4, size=2).tolist()}]
            for a, to in enumerate(rng.permutation(ends).tolist()):
                rows.append((s, a, [(1, to, height[s] - height[to] - int(rng.random() < 0.2))]))
        yield MDP.from_outcomes([*rows, (4, 0, [(1, 4, 1)])])


def test_optimal_actions_are_those_of_optimal_policies() -> None:
    """At discount 1 an action attains the optimum where some policy of all that take it does."""
    compared = 0
    for mdp in waiting_models(40):
        rows = oracle.rows_of(mdp)
        best = oracle.best_total(rows)
        if not all(abs(v) < inf for v in best):
            continue
        proof = proven_optimum(mdp)
        optimal = np.array(proof.optimal_pairs)
        attained: dict[int, set[int]] = {s: set() for s in range(4)}
        for choice in product(*(mdp.pairs_of(s) for s in range(4))):
            total = oracle.total([rows[pair] for pair in choice])
            for s in range(4):
                if total == best:
                    attained[s].add(choice[s])
        for s in range(3):
            found = find_attaining_pairs(mdp, proof, optimal, s)
            compared += len(mdp.pairs_of(s)) > 1
            assert {*found} == attained[s]
    assert compared > 20


def test_who_is_worth_infinity_takes_actions_that_some_endless_gain_takes() -> None:
    """Of those that lead to +∞ again, some earn nothing if they are taken forever."""
    fewer = 0
    for mdp in waiting_models(60):
        rows, proof = oracle.rows_of(mdp), proven_optimum(mdp)
        optimal = np.array(proof.optimal_pairs)
        attained = set[int]()
        for choice in product(*(mdp.pairs_of(s) for s in range(4))):
            total = oracle.total([rows[pair] for pair in choice])
            attained |= {choice[s] for s in range(4) if total[s] == inf}
        for state in np.flatnonzero(proof.infinite_sign > 0).tolist():
            every = {pair for pair in mdp.pairs_of(state) if optimal[pair]}
            found = {*find_attaining_pairs(mdp, proof, optimal, state)}
            assert found == attained & {*mdp.pairs_of(state)} <= every
            fewer += found < every
    assert fewer > 9
    rows = [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 0, 2)]), (0, 2, [(1, 0, 1)])]
    (wrong,) = check(MDP.from_outcomes(rows), [0]).disagreements
    assert wrong.optimal == ("1", "2")


def test_elsewhere_an_action_leads_to_where_the_optimum_stays() -> None:
    """Other optimal actions lead there without coming back; below zero all actions do as well."""
    signs = set[int]()
    ways: list[Any] = [[(1, 1, 0)], [(1, 0, -1)]]
    others: list[Any] = [(s, 0, [(1, s, -(s == 1))]) for s in (1, 2, 3)]
    lost = [[(0, a, ways[a ^ b]) for a in (0, 1)] + others for b in (0, 1)]
    for mdp in (*waiting_models(50), *map(MDP.from_outcomes, lost)):
        rows, proof = oracle.rows_of(mdp), proven_optimum(mdp)
        sign, optimal = proof.infinite_sign, np.array(proof.optimal_pairs)
        stay = {s for each in oracle.classes([rows[p] for p in proof.pairs]) for s in each}
        free = find_zero_reward_pairs(mdp, proof, optimal)
        for state in np.flatnonzero(sign[:3] <= 0).tolist():
            wanted = {pair for pair in mdp.pairs_of(state) if optimal[pair]}
            if len(wanted) > 1 and state not in stay and sign[state] >= 0:
                ends = stay | {rows[pair][0] for pair in np.flatnonzero(free)}
                near, before = {s for s in ends if sign[s] == sign[state]}, set[int]()
                while near != before:
                    before = set(near)
                    near |= {
                        s
                        for pair, (s, _, _, law) in enumerate(rows)
                        if optimal[pair] and s != state and not before.isdisjoint(law)
                    }
                near -= {state}
                some = {p for p in wanted if free[p] or not near.isdisjoint(rows[p][3])}
                wanted = some or wanted
            signs.add(int(sign[state]))
            assert {*find_attaining_pairs(mdp, proof, optimal, state)} == wanted
    assert signs == {-1, 0}


def test_pairs_that_may_earn_nothing_for_ever() -> None:
    """Among the optimal pairs, whether some are left out or pairs with a reward are forgiven."""
    for seed, mdp in enumerate(waiting_models(40)):
        rows = oracle.rows_of(mdp)
        best = oracle.best_total(rows)
        if not all(abs(v) < inf for v in best):
            continue
        proof = proven_optimum(mdp)
        optimal = np.array(proof.optimal_pairs) | (seed % 4 == 1)
        if seed % 2:
            optimal &= np.random.default_rng(seed).random(mdp.n_pairs) < 0.7
        kept = {s for s in range(4) if best[s] == 0}
        while True:
            pairs = {
                k
                for k, (s, _, r, law) in enumerate(rows)
                if s in kept and optimal[k] and r == 0 and kept.issuperset(law)
            }
            left = {rows[k][0] for k in pairs}
            if left == kept:
                break
            kept = left
        assert set(np.flatnonzero(find_zero_reward_pairs(mdp, proof, optimal)).tolist()) == pairs


def blamed_by_hand(
    mdp: MDP, proof: Certificate, chances: Chances, lost: list[float], falling: set[int]
) -> set[int]:
    """The pairs to blame, reason by reason; `falling` are those with V + w > P w."""
    rows = oracle.rows_of(mdp)
    chain = oracle.mixed(rows, chances)
    inside = {s: each for each in oracle.classes(chain) if not mdp.terminal[each[0]] for s in each}
    taken = [pair for pair, (s, a, *_) in enumerate(rows) if chances.get((s, a))]
    departs = {pair for pair in taken if rows[pair][1] != proof.policy[rows[pair][0]]}
    optimal = {*np.flatnonzero(proof.optimal_pairs).tolist()}
    leaves = {
        pair
        for pair in taken
        if (own := inside.get(rows[pair][0]))
        and any(not {*rows[k][3]} <= {*own} for k in mdp.pairs_of(rows[pair][0]) if k in optimal)
    }
    found = {pair for pair in taken if pair not in optimal}
    for own in {*map(tuple, inside.values())}:
        losing = {pair for pair in taken if rows[pair][0] in own and lost[rows[pair][0]] > 0}
        reasons = (losing - optimal, losing & leaves, losing & departs & falling, losing & departs)
        found |= next((reason for reason in reasons if reason), set[int]())
    # An infinite value is given up by those that leave it and depart, or depart, or leave it.
    sign = proof.infinite_sign
    giving = {p for p in taken if sign[rows[p][0]] > 0 and lost[rows[p][0]] == inf}
    met, before = {s for s, p in mdp.start if p}, set[int]()
    while met != before:
        before = set(met)
        met |= {t for s, _, _, law in chain if s in before for t in law}
    if not {p for p in giving & found if rows[p][0] in met}:
        out = {p for p in giving if any(sign[t] <= 0 for t in rows[p][3])}
        reasons = (out & departs, giving & departs, out, giving)
        found |= next((reason for reason in reasons if reason), set[int]())
    twins = {(rows[p][0], rows[p][2], frozenset(rows[p][3].items())) for p in found}
    return {p for p, (s, _, r, law) in enumerate(rows) if (s, r, frozenset(law.items())) in twins}


def test_who_waits_for_ever_is_to_blame() -> None:
    """What is lost where no gap is: the pairs of the strongest reason in each losing class."""
    for seed, mdp in enumerate((*waiting_models(30), *circling_models(20))):
        mdp = mdp.with_(start=seed % 4)
        rows, proof = oracle.rows_of(mdp), proven_optimum(mdp)
        best = oracle.best_total(rows)
        falling = set[int]()
        if proof.g is not None and proof.w is not None:
            value, later = proof.h.to_fractions(), proof.w.to_fractions()
            falling = {
                pair
                for pair, (s, _, _, law) in enumerate(rows)
                if proof.infinite_sign[s] == 0 and value[s] + later[s] > oracle.mean(law, later)
            }
        every = np.ones(mdp.n_pairs, dtype=bool)
        assert {*np.flatnonzero(_find_third_order_losses(mdp, proof, every)).tolist()} == falling
        for pure in (True, False):
            chances = random_policy(mdp, seed, pure=pure)
            total = oracle.total(oracle.mixed(rows, chances))
            lost = [0.0 if b == t else float(b - t) for b, t in zip(best, total, strict=True)]
            chain = PolicyChain.of(mdp, given(chances))
            blamed = set(np.flatnonzero(to_blame(chain, proof, np.array(lost))).tolist())
            assert blamed == blamed_by_hand(mdp, proof, chances, lost, falling)


def test_an_infinite_value_may_be_given_up_on_the_way() -> None:
    rows: Any = [
        (0, 0, [(1, 1, 0)]),
        (0, 1, [(1, 2, 0)]),
        (1, 0, [(1, 1, 1)]),
        (1, 1, [(1, 2, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
    mdp = MDP.from_outcomes(rows)
    proof = proven_optimum(mdp)
    for action, state in (([1, 0, 0], 0), ([0, 1, 0], 1)):
        chain = PolicyChain.of(mdp, action)
        lost = np.array([inf, inf if state else 0, 0.0])
        blamed = to_blame(chain, proof, lost)
        assert set(mdp.pair_state[blamed].tolist()) == {state}


def test_what_is_wrong_in_states_that_are_not_reached_does_not_explain_a_loss() -> None:
    """Half of each round from state 0 over 2 leaves 2, where 1 is earned forever; state 1 does not
    even try."""
    half: Any = [(F(1, 2), 2, 0), (F(1, 2), 3, 0)]
    rows: Any = [
        (0, 0, half),
        (0, 1, [(1, 2, 0)]),
        (1, 0, [(1, 3, 0)]),
        (1, 1, [(1, 2, 0)]),
        (2, 0, [(1, 2, 1)]),
        (2, 1, [(1, 0, 0)]),
        (3, 0, [(1, 3, 0)]),
    ]
    for start, wanted in ((0, [0, 2]), (1, [2])):
        mdp = MDP.from_outcomes(rows, start=start)
        lost = np.array([inf, inf, inf, 0.0])
        blamed = to_blame(PolicyChain.of(mdp, [0, 0, 1, 0]), proven_optimum(mdp), lost)
        assert np.flatnonzero(blamed).tolist() == wanted


def test_nobody_gives_up_a_finite_value() -> None:
    """State 1 may lead to 2 as well as to the end; it is in 2, not met, that all is lost."""
    rows: Any = [(0, 0, [(1, 0, 0)]), (1, 0, [(1, 0, 0)]), (1, 1, [(1, 2, 0)])]
    mdp = MDP.from_outcomes([*rows, (2, 0, [(1, 0, 0)]), (2, 1, [(1, 2, -1)])], start=0)
    lost = np.array([0.0, inf, inf])
    blamed = to_blame(PolicyChain.of(mdp, [0, 1, 1]), proven_optimum(mdp), lost)
    assert np.flatnonzero(blamed).tolist() == [4]


def test_below_discount_1_all_optimal_actions_attain_the_optimum() -> None:
    """To stay in state 0 and to leave for state 1 earn the same."""
    for ends in ((0, 1), (1, 0)):
        rows: Any = [(0, a, [(1, to, 1)]) for a, to in enumerate(ends)]
        mdp = MDP.from_outcomes([*rows, (1, 0, [(1, 1, 1)])], "1/2")
        proof = proven_optimum(mdp)
        assert find_attaining_pairs(mdp, proof, np.array(proof.optimal_pairs), 0) == [0, 1]
