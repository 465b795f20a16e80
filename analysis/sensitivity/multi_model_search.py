"""Branch and bound for one policy in several models.

With some decisions fixed, Σ λ_k V_k* over the policies that keep them bounds what is left, and is
attained where the optima of all models agree in the states they visit (after Ahluwalia, Steimle and
Denton, European Journal of Operational Research 2021).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from heapq import heappop, heappush
from itertools import count

import numpy as np

from analysis.sensitivity.multi_model_problem import Problem, weighted
from mdp.chain import reachable
from mdp.model import MDP
from mdp.table import Integers
from solvers import solve
from solvers.policy_chain import PolicyChain
from solvers.solution import Bounded, Solution
from solvers.visits import visits


def search(
    problem: Problem, best: tuple[Bounded, Integers], gap: float, parts: int
) -> tuple[float, tuple[Bounded, Integers], int]:
    """Return an upper bound of W*, the best policy found, and the sets that were bounded."""
    tie, heap = count(), []
    bound, solutions, allowed = _relaxed(problem, {})
    heappush(heap, (-bound, next(tie), {}, solutions, allowed))
    used, done = 1, -np.inf
    while heap:
        bound = -heap[0][0]
        if bound <= best[0].interval[0] + gap or used >= parts:
            break
        _, _, fixed, solutions, allowed = heappop(heap)
        branch, pairs = _parting(problem, solutions, allowed)
        value = problem.value(pairs)
        if value.interval[0] > best[0].interval[0]:
            best = value, pairs
        if branch is None:  # all models agree where they go: the bound is attained
            done = max(done, bound)
            continue
        for action in _actions(problem, branch):
            inside = {**fixed, branch: action}
            below, found, kept = _relaxed(problem, inside)
            used += 1
            heappush(heap, (-min(below, bound), next(tie), inside, found, kept))
    top = -heap[0][0] if heap else -np.inf
    return max(top, done), best, used


def _actions(problem: Problem, group: int) -> list[int]:
    """Return the actions that every state of a group offers."""
    first = problem.first
    states = np.flatnonzero((problem.group == group) & ~first.forced)
    offered = [
        {int(first.pair_action[pair]) for pair in first.pairs_of(state)}
        for state in states.tolist()
    ]
    return sorted(set.intersection(*offered))


def _relaxed(problem: Problem, fixed: Mapping[int, int]) -> tuple[float, list[Solution], Integers]:
    """Return Σ λ_k V_k* over the policies that keep some decisions, rounded up."""
    first = problem.first
    wanted = np.full(first.n_states, -1)
    for group, action in fixed.items():
        wanted[(problem.group == group) & ~first.forced] = action
    rule = wanted[first.pair_state]
    allowed = np.flatnonzero((rule < 0) | (rule == first.pair_action))
    solutions = [solve(restricted(mdp, allowed)) for mdp in problem.models]
    bound = weighted(problem.weights, [found.start for found in solutions]).interval[1]
    return bound, solutions, allowed


def _parting(
    problem: Problem, solutions: Sequence[Solution], allowed: Integers
) -> tuple[int | None, Integers]:
    """Return the group on which the optima disagree most, and a policy by their votes."""
    first = problem.first
    votes: dict[tuple[int, int], float] = {}
    pairs = allowed[solutions[int(np.argmax(problem.weights))].pairs]
    for w, mdp, found in zip(problem.weights, problem.models, solutions, strict=True):
        if w == 0:
            continue
        own = allowed[found.pairs]
        chosen = np.zeros(first.n_pairs)
        chosen[own] = 1.0
        seen = visits(mdp, PolicyChain.of(mdp, chosen).discounted).value
        meets = reachable(mdp, pairs=own) & ~first.forced
        for state in np.flatnonzero(meets).tolist():
            key = int(problem.group[state]), int(first.pair_action[own[state]])
            votes[key] = votes.get(key, 0.0) + w * max(float(seen[state]), 1e-300)
    total: dict[int, float] = {}
    most: dict[int, float] = {}
    several: dict[int, int] = {}
    for (group, _), vote in votes.items():
        total[group] = total.get(group, 0.0) + vote
        most[group] = max(most.get(group, 0.0), vote)
        several[group] = several.get(group, 0) + 1
    open_groups = [group for group, number in several.items() if number > 1]
    chosen_pairs = problem.by_votes(problem.fitted(pairs), votes)
    if not open_groups:
        return None, chosen_pairs
    return max(open_groups, key=lambda group: total[group] - most[group]), chosen_pairs


def restricted(mdp: MDP, pairs: Integers) -> MDP:
    """Return the model with some of its pairs (K,) only, at least one in each state.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[1, 0], [0, 1]]], [[1, 2], [0, 0]], "1/2")
    >>> restricted(mdp, np.array([1, 2])).reward.tolist()
    [2.0, 0.0]
    """
    if len(pairs) == mdp.n_pairs:
        return mdp
    part = mdp.table.of_pairs(pairs)
    return mdp.with_(
        table=part, pair_state=mdp.pair_state[pairs], pair_action=mdp.pair_action[pairs]
    )
