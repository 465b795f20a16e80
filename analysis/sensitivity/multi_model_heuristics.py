"""Heuristics for one policy in several models: weight-select-update, and improvement.

Source: Steimle, Kaufman and Denton, IISE Transactions 53, 2021. A change in state s is worth
Σ λ_k d_k(s) (Q_k(s, a) - V_k(s)), d_k being the visits to s, see
`analysis.sensitivity.multi_model`.
"""

from __future__ import annotations

import numpy as np

from analysis.sensitivity.multi_model_problem import Problem
from mdp.chain import spans
from mdp.table import Floats, Integers
from solvers import evaluate
from solvers.policy_chain import PolicyChain
from solvers.solution import Bounded
from solvers.visits import visits

ROUNDS = 100


def weight_select_update(problem: Problem) -> Integers:
    """Choose level by level from the end by Σ λ_k Q_k, updating the values of each model."""
    first, order = problem.first, problem.order
    assert order is not None
    value = np.zeros((len(problem.models), first.n_states))
    pairs = first.pair_offsets[:-1].copy()
    for depth in range(1, int(order.max(initial=0)) + 1):
        states = np.flatnonzero(order == depth)
        begin, end = first.pair_offsets[states], first.pair_offsets[states + 1]
        rows = spans(begin, end)
        q = np.stack(
            [
                mdp.reward[rows] + mdp.discount * (mdp.transition[rows] @ value[k])
                for k, mdp in enumerate(problem.models)
            ]
        )
        cuts = np.cumsum(end - begin) - (end - begin)
        chosen = _first_best(problem.weights @ q, cuts)
        pairs[states] = rows[chosen]
        value[:, states] = q[:, chosen]
    return pairs


def improved(problem: Problem, value: Bounded, pairs: Integers) -> tuple[Bounded, Integers]:
    """Change decisions as long as that pays: all that seem to at once, or the best one."""
    first = problem.first
    for _ in range(ROUNDS):
        score = np.zeros(first.n_pairs)
        chosen = np.zeros(first.n_pairs)
        chosen[pairs] = 1.0
        for w, mdp in zip(problem.weights, problem.models, strict=True):
            chain = PolicyChain.of(mdp, chosen)
            worth = np.nan_to_num(evaluate(mdp, chain).value)
            seen = np.where(mdp.terminal, 0.0, visits(mdp, chain.discounted).value)
            gain = mdp.backup(worth) - worth[mdp.pair_state]
            score += w * seen[mdp.pair_state] * gain
        votes: dict[tuple[int, int], float] = {}
        for pair in np.flatnonzero(problem.taken).tolist():
            key = int(problem.group[first.pair_state[pair]]), int(first.pair_action[pair])
            votes[key] = votes.get(key, 0.0) + float(score[pair])
        wanted = {key: vote for key, vote in votes.items() if vote > 1e-12}
        if not wanted:
            break
        single = max(wanted, key=lambda key: wanted[key])
        for change in (wanted, {single: wanted[single]}):
            tried = problem.by_votes(pairs, change)
            after = problem.value(tried)
            if after.interval[0] > value.interval[1]:
                value, pairs = after, tried
                break
        else:
            break
    return value, pairs


def _first_best(values: Floats, first: Integers) -> Integers:
    lengths = np.diff(np.append(first, len(values)))
    best = np.repeat(np.maximum.reduceat(values, first), lengths)
    return np.minimum.reduceat(np.where(values == best, np.arange(len(values)), len(values)), first)
