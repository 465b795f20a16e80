"""Heuristics for one policy in several models: weight-select-update, and improvement.

Source: Steimle, Kaufman and Denton, IISE Transactions 53, 2021. A change in state s is worth
Σ λ_k d_k(s) (Q_k(s, a) - V_k(s)), d_k being the visits to s, see
`analysis.sensitivity.multi_model`.

Branch and bound for one policy in several models.

With some decisions fixed, Σ λ_k V_k* over the policies that keep them bounds what is left, and is
attained where the optima of all models agree in the states they visit (after Ahluwalia, Steimle and
Denton, European Journal of Operational Research 2021).

One policy for several weighted models of the same states: the weighted value problem.

    W* = max over deterministic policies π of  Σ_k λ_k V_k^π(start)

The policy does not know which model holds and does not learn it (non-adaptive; Steimle, Kaufman and
Denton, IISE Transactions 53, 2021). The problem is NP-hard. Lower bounds are policies: the optimum
of the mean model (mean-value problem), weight-select-update, which chooses backward by weighted
values to go, and improvements one decision at a time, exact where models are acyclic: a change in
state s is worth Σ λ_k d_k(s) (Q_k(s, a) - V_k(s)), d_k the visits to s. The upper bound is
Σ λ_k V_k*: whoever knew the model (wait and see). Branch and bound closes the distance: with some
decisions fixed, Σ λ_k V_k* over policies that keep them bounds what is left, and is attained where
the optima of all models agree in the states they visit (after Ahluwalia, Steimle and Denton,
European Journal of Operational Research 2021).

A decision belongs to a state, or to all states that share some columns (a policy by status).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.sensitivity.weighted_models import Problem, weighted
from exact_mdp.mdp.chain import reachable
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers, spans
from exact_mdp.solvers import evaluate, solve
from exact_mdp.solvers.solution import Bounded, Solution
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.visits import visits

if TYPE_CHECKING:
    from pandas import DataFrame


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


PARTS = 2000
GAP = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class MultiModel:
    """A policy for several models, and how far from the best such policy it may be.

    Attributes
    ----------
    weights : (K,)
        λ, with sum 1.
    policy : (S,) int64
        Action numbers.
    value : Bounded
        Its weighted value at the start: a lower bound of W*.
    upper : float
        No policy has a greater weighted value.
    by_model, optima : tuple of Bounded
        The policy's value in each model, and that model's own optimum.
    found_by : {method: Bounded}
        Weighted values of the policies that the heuristics found.
    parts : int
        Sets of policies that were bounded.
    """

    weights: Floats
    policy: Integers
    value: Bounded
    upper: float
    by_model: tuple[Bounded, ...]
    optima: tuple[Bounded, ...]
    found_by: Mapping[str, Bounded]
    parts: int

    @property
    def gap(self) -> float:
        """W* less the policy's weighted value is at most this."""
        return self.upper - self.value.interval[0]

    @property
    def wait_and_see(self) -> Bounded:
        """Σ λ_k V_k*, what knowing the model would be worth in all."""
        return weighted(self.weights, self.optima)

    @property
    def mean_value(self) -> Bounded:
        """The weighted value of the mean model's optimum."""
        return self.found_by["mean-value policy"]

    def frame(self) -> DataFrame:
        """Return one row for each model: values and regret at the start (reward)."""
        from pandas import DataFrame

        return DataFrame(
            [
                {
                    "model": number,
                    "weight": weight,
                    "value (reward)": mine.value,
                    "optimum (reward)": best.value,
                    "regret (reward)": best.value - mine.value,
                    "error bound (reward)": mine.error + best.error,
                }
                for number, (weight, mine, best) in enumerate(
                    zip(self.weights.tolist(), self.by_model, self.optima, strict=True)
                )
            ]
        )


def multi_model(
    models: Sequence[MDP],
    weights: Sequence[float] | None = None,
    *,
    columns: Sequence[str] | None = None,
    gap: float = GAP,
    parts: int = PARTS,
) -> MultiModel:
    """Return a policy for all models at once, with a bound on what the best one could add.

    Parameters
    ----------
    models : sequence of MDP
        With the same states and the same actions in each.
    weights : (K,), optional
        λ, at least 0; equal unless given. They are divided by their sum.
    columns : sequence of str, optional
        The policy reads these columns of the state alone, such as `["status"]`; the whole state
        unless given.
    gap : float
        Stop where the bounds are this close.
    parts : int
        Sets of policies to bound at most; 1 leaves out branch and bound.

    Raises
    ------
    ModelError
        For models that do not match, and weights that are no weights.

    Examples
    --------
    >>> rows = lambda a, b: [(0, 0, [(1, 1, a)]), (0, 1, [(1, 1, b)]), (1, 0, [(1, 1, 0)])]
    >>> found = multi_model([MDP.from_outcomes(rows(3, 0)), MDP.from_outcomes(rows(0, 2))])
    >>> found.policy.tolist(), found.value.value, found.wait_and_see.value
    ([0, 0], 1.5, 2.5)
    """
    problem = Problem(models, weights, columns)
    optima = tuple(solve(mdp).start for mdp in problem.models)
    found: dict[str, tuple[Bounded, Integers]] = {}

    def note(name: str, pairs: Integers) -> None:
        fitted = problem.fitted(pairs)
        found[name] = (problem.value(fitted), fitted)

    note("mean-value policy", solve(problem.mean).pairs)
    if problem.order is not None:
        note("weight-select-update", weight_select_update(problem))
    first = max(found.values(), key=lambda each: each[0].value)
    found["improved"] = improved(problem, *first)
    best = max(found.values(), key=lambda each: each[0].interval[0])
    upper, best, used = search(problem, best, gap, parts)
    found["branch and bound"] = best
    upper = max(upper, best[0].interval[0])
    pairs = best[1]
    return MultiModel(
        weights=problem.weights,
        policy=problem.models[0].pair_action[pairs],
        value=best[0],
        upper=upper,
        by_model=problem.values(pairs),
        optima=optima,
        found_by={name: each[0] for name, each in found.items()},
        parts=used,
    )
