"""Losses of recurrent classes, beside all policies of small models in fractions."""

from fractions import Fraction as F
from itertools import product
from math import inf
from typing import Any

import numpy as np
import oracle
import pytest
from small_models import small_model

from exact_mdp import MDP
from exact_mdp.analysis.gate.class_losses import (
    chain_of_pairs,
    charge_class_losses,
    compute_exact_row,
    final_class,
    find_attaining_pairs,
    find_zero_reward_pairs,
    to_blame,
)
from exact_mdp.solvers.exact.certify import proven_optimum
from exact_mdp.solvers.values.policy_chain import PolicyChain


def test_twins_have_the_same_outcomes() -> None:
    for seed in range(10):
        mdp = small_model(seed)
        for pair, (_, _, reward, row) in enumerate(oracle.rows_of(mdp)):
            assert compute_exact_row(mdp, pair) == (reward, frozenset(row.items()))


def test_a_policy_that_takes_pairs() -> None:
    mdp = small_model(3)
    rng = np.random.default_rng(0)
    pairs = np.array([rng.choice(mdp.pairs_of(s)) for s in range(mdp.n_states)])
    assert chain_of_pairs(mdp, pairs).pairs.tolist() == pairs.tolist()
    assert chain_of_pairs(mdp, pairs).chosen.dtype == np.float64


def test_final_classes_are_the_recurrent_ones_but_ends() -> None:
    for seed in range(12):
        mdp = small_model(seed, leaving=False)
        rng = np.random.default_rng(seed)
        pairs = [int(rng.choice(mdp.pairs_of(s))) for s in range(mdp.n_states)]
        label = final_class(chain_of_pairs(mdp, np.array(pairs)))
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


def test_pairs_that_may_earn_nothing_for_ever() -> None:
    for mdp in waiting_models(24):
        rows = oracle.rows_of(mdp)
        best = oracle.best_total(rows)
        if not all(abs(v) < inf for v in best):
            continue
        proof = proven_optimum(mdp)
        optimal = np.array(proof.optimal_pairs)
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


def test_who_waits_for_ever_is_to_blame() -> None:
    """What is lost where no gap is: some pair of each losing class is named, and of others none."""
    for mdp in waiting_models(24):
        rows = oracle.rows_of(mdp)
        best = oracle.best_total(rows)
        if not all(abs(v) < inf for v in best):
            continue
        proof = proven_optimum(mdp)
        for choice in list(product(*(mdp.pairs_of(s) for s in range(4))))[:12]:
            total = oracle.total([rows[pair] for pair in choice])
            if not all(abs(v) < inf for v in total):
                continue
            chain = chain_of_pairs(mdp, np.array(choice))
            lost = np.array([float(b - t) for b, t in zip(best, total, strict=True)])
            blamed = to_blame(chain, proof, lost)
            label = final_class(chain)
            optimal = np.array(proof.optimal_pairs)
            for k in {*label.tolist()} - {-1}:
                own = [s for s in range(4) if label[s] == k]
                losing = any(lost[s] > 0 for s in own)
                assert losing == any(blamed[choice[s]] for s in own)
            for s in range(4):
                if not optimal[choice[s]]:
                    assert blamed[choice[s]]
                if label[s] < 0 and optimal[choice[s]]:
                    twin = any(
                        blamed[p]
                        and compute_exact_row(mdp, p) == compute_exact_row(mdp, choice[s])
                        and p != choice[s]
                        for p in mdp.pairs_of(s)
                    )
                    assert not blamed[choice[s]] or twin


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
