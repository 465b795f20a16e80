"""One policy for several weighted models of the same states: the weighted value problem.

    W* = max over deterministic policies π of  Σ_k λ_k V_k^π(start)

The policy does not know which model holds and does not learn it (non-adaptive; Steimle, Kaufman and
Denton, IISE Transactions 53, 2021). The problem is NP-hard. Lower bounds are policies: the optimum
of the mean model (mean-value problem), weight-select-update, which chooses backward by weighted
values to go, and improvements one decision at a time, exact where models are acyclic: a change in
state s gains Σ λ_k d_k(s) (Q_k(s, a) - V_k(s)), d_k the visits to s. The upper bound is
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

from exact_mdp.analysis.sensitivity.base_case import finite_optimum, finite_worth
from exact_mdp.mdp.chain import reachable
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats, Integers, float_array, spans
from exact_mdp.solvers import evaluate, solve
from exact_mdp.solvers.bounds.bounds import levels
from exact_mdp.solvers.solution import Bounded, Solution
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.visits import visits

if TYPE_CHECKING:
    from pandas import DataFrame

pandas = later("pandas")

ROUNDS = 100  # of improvements
LEAST = 1e-300  # vote of an action in a state that is hardly met


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MultiModel(Result):
    """A policy for several models, and how far from the best such policy it may be.

    Attributes
    ----------
    weights : (K,)
        λ, with sum 1.
    policy : Policy
        Also an array (S,) of action numbers.
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
    policy: Policy
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
    def error(self) -> float:
        """The same as `gap`."""
        return self.gap

    @property
    def wait_and_see(self) -> Bounded:
        """Σ λ_k V_k*, the value of knowing the model from the start."""
        return _weighted(self.weights, self.optima)

    def frame(self) -> DataFrame:
        """Return one row for each model: values and regret at the start (reward)."""
        each = zip(self.weights.tolist(), self.by_model, self.optima, strict=True)
        return pandas.DataFrame(
            [
                {
                    "model": number,
                    "weight": weight,
                    "value (reward)": mine.value,
                    "optimum (reward)": best.value,
                    "regret (reward)": best.value - mine.value,
                    "error bound (reward)": mine.error + best.error,
                }
                for number, (weight, mine, best) in enumerate(each)
            ]
        )


def multi_model(
    models: Sequence[MDP],
    weights: Sequence[float] | None = None,
    *,
    columns: Sequence[str] | None = None,
    gap: float = 1e-9,
    parts: int = 2000,
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

    Returns
    -------
    MultiModel

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
    problem = _Problem(models, weights, columns)
    optima = tuple(finite_optimum(mdp, f"model {k}").start for k, mdp in enumerate(problem.models))
    tried = {
        "mean-value policy": problem.fitted(
            finite_optimum(problem.mean, "the mean of the models").pairs
        )
    }
    if (order := levels(problem.mean)) is not None:
        tried["weight-select-update"] = problem.fitted(_weight_select_update(problem, order))
    found = {name: (problem.value(pairs), pairs) for name, pairs in tried.items()}
    found["improved"] = _improved(problem, *max(found.values(), key=lambda each: each[0].value))
    best = max(found.values(), key=lambda each: each[0].interval[0])
    upper, best, used = _search(problem, best, gap, parts)
    found["branch and bound"] = best
    value, pairs = best
    return MultiModel(
        weights=problem.weights,
        policy=Policy.from_choices(problem.first, problem.first.pair_action[pairs]),
        value=value,
        upper=max(upper, value.interval[0]),
        by_model=problem.values(pairs),
        optima=optima,
        found_by={name: each[0] for name, each in found.items()},
        parts=used,
    )


class _Problem:
    """Models with the same pairs, and the states that share a decision.

    Votes are (G, A): how much speaks for each action in each group of states that decide alike;
    0 where nothing does.

    Attributes
    ----------
    models : list of K MDP
    first : MDP
        One of them, for what they have in common.
    mean : MDP
        The model whose probabilities and rewards are the weighted means.
    weights : (K,)
        λ, with sum 1.
    group : (S,) ints
        The decision that each state belongs to.
    free : (S,) bool
        States with a choice.
    """

    def __init__(
        self,
        models: Sequence[MDP],
        weights: Sequence[float] | None,
        columns: Sequence[str] | None,
    ) -> None:
        self.models = list(models)
        if not self.models:
            raise ModelError("no model", where="multi-model", fix="give at least one")
        self.first = first = self.models[0]
        for number, mdp in enumerate(self.models):
            same = (
                mdp.n_states == first.n_states
                and np.array_equal(mdp.pair_state, first.pair_state)
                and [mdp.actions[a] for a in mdp.pair_action]
                == [first.actions[a] for a in first.pair_action]
            )
            if not same:
                raise ModelError(
                    f"model {number} has other states or actions than model 0",
                    where="multi-model",
                    fix="give models of the same states, with the same actions in each",
                )
        self.weights = _shares(len(self.models), weights)
        key = np.arange(first.n_states)
        if columns is not None:
            values = [first.space.values(name) for name in columns]
            key = np.unique(np.array(values), axis=1, return_inverse=True)[1].reshape(-1)
        self.group: Integers = key
        self.free = ~first.forced
        self.mean = self._mean()

    def _mean(self) -> MDP:
        first, pairs = self.first, list(zip(self.weights, self.models, strict=True))
        rate = float(self.weights @ [mdp.discount for mdp in self.models])
        same_rate = len({mdp.discount_exact for mdp in self.models}) == 1
        return MDP.from_pairs(
            first.pair_state,
            first.pair_action,
            sum(w * mdp.transition for w, mdp in pairs),
            sum(w * mdp.reward for w, mdp in pairs),
            first.discount_exact if same_rate else rate,
            start=dict(first.start),
        )

    def chosen(self, pairs: Integers) -> Floats:
        """Return (L,) 1 for the pairs (S,) that a policy takes."""
        chosen = np.zeros(self.first.n_pairs)
        chosen[pairs] = 1.0
        return chosen

    def values(self, pairs: Integers) -> tuple[Bounded, ...]:
        """Return a policy's value in each model; pairs (S,) are those that it takes."""
        chosen = self.chosen(pairs)
        return tuple(finite_worth(mdp, chosen, f"model {k}") for k, mdp in enumerate(self.models))

    def value(self, pairs: Integers) -> Bounded:
        """Return its weighted value."""
        return _weighted(self.weights, self.values(pairs))

    def votes(self, states: Integers, actions: Integers, weight: Floats) -> Floats:
        """Return (G, A) the votes of states (N,) for actions (N,)."""
        found = np.zeros((int(self.group.max()) + 1, self.first.n_actions))
        np.add.at(found, (self.group[states], actions), weight)
        return found

    def fitted(self, pairs: Integers) -> Integers:
        """Return the pairs of a policy that gives each group one action: its commonest."""
        first, chosen = self.first, self.chosen(pairs)
        if self.group.max() == first.n_states - 1:
            return pairs
        seen = sum(
            w * visits(mdp, PolicyChain.of(mdp, chosen).discounted).value
            for w, mdp in zip(self.weights, self.models, strict=True)
        )
        states = np.flatnonzero(self.free)
        weight = np.asarray(seen)[states] + 1e-9
        return self.by_votes(pairs, self.votes(states, first.pair_action[pairs[states]], weight))

    def by_votes(self, pairs: Integers, votes: Floats) -> Integers:
        """Return the pairs of a policy after each group has taken the action of most votes."""
        best, cast = votes.argmax(axis=1), votes.max(axis=1) > 0
        chosen = pairs.copy()
        for state in np.flatnonzero(self.free & cast[self.group]).tolist():
            chosen[state] = self.first.pair(
                self.first.space.label(state), self.first.actions[best[self.group[state]]]
            )
        return chosen

    def actions(self, group: int) -> list[int]:
        """Return the actions that every state of a group offers."""
        states = (self.group == group) & self.free
        mine = states[self.first.pair_state]
        offered = np.bincount(self.first.pair_action[mine], minlength=self.first.n_actions)
        return [int(action) for action in np.flatnonzero(offered == states.sum())]


def _shares(number: int, weights: Sequence[float] | None) -> Floats:
    """Return (K,) weights with sum 1."""
    given = np.ones(number) if weights is None else float_array(list(weights))
    if given.shape != (number,) or not (given >= 0).all() or not given.sum() > 0:
        raise ModelError(
            f"weights {given.tolist()} for {number} models",
            where="multi-model",
            fix="give one weight of at least 0 for each, not all of them 0",
        )
    if not np.isfinite(given.sum()):
        raise ModelError("weights too large", where="multi-model", fix="scale them down")
    shares: Floats = given / given.sum()
    shares.setflags(write=False)
    return shares


def _weighted(weights: Floats, numbers: Sequence[Bounded]) -> Bounded:
    """Return Σ λ x with its error bound, the rounding of the weights left to their definition."""
    terms = [w * number.value for w, number in zip(weights.tolist(), numbers, strict=True)]
    error = sum(w * number.error for w, number in zip(weights.tolist(), numbers, strict=True))
    rounding = (len(terms) + 2) * 2.0**-52 * sum(map(abs, terms))
    return Bounded(value=float(sum(terms)), error=float(error * (1 + 1e-9) + rounding))


# ---- policies that serve all models ----------------------------------------------------------


def _weight_select_update(problem: _Problem, order: Integers) -> Integers:
    """Choose level by level from the end by Σ λ_k Q_k, updating the values of each model."""
    first = problem.first
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


def _first_best(values: Floats, first: Integers) -> Integers:
    """Return where the greatest value is, the first one, in each part that begins at `first`."""
    lengths = np.diff(np.append(first, len(values)))
    best = np.repeat(np.maximum.reduceat(values, first), lengths)
    places = np.where(values == best, np.arange(len(values)), len(values))
    return np.minimum.reduceat(places, first)


def _improved(problem: _Problem, value: Bounded, pairs: Integers) -> tuple[Bounded, Integers]:
    """Change decisions as long as that pays: all that seem to at once, or the best one."""
    first = problem.first
    taken = np.flatnonzero(problem.free[first.pair_state])
    for _ in range(ROUNDS):
        score, chosen = np.zeros(first.n_pairs), problem.chosen(pairs)
        for w, mdp in zip(problem.weights, problem.models, strict=True):
            chain = PolicyChain.of(mdp, chosen)
            worth = np.nan_to_num(evaluate(mdp, chain).value)
            seen = np.where(mdp.terminal, 0.0, visits(mdp, chain.discounted).value)
            score += w * seen[mdp.pair_state] * (mdp.backup(worth) - worth[mdp.pair_state])
        votes = problem.votes(first.pair_state[taken], first.pair_action[taken], score[taken])
        votes[votes <= 1e-12] = 0.0
        single = np.zeros_like(votes)
        single.flat[votes.argmax()] = votes.max()
        for change in (votes, single) if votes.any() else ():
            tried = problem.by_votes(pairs, change)
            after = problem.value(tried)
            if after.interval[0] > value.interval[1]:
                value, pairs = after, tried
                break
        else:
            break
    return value, pairs


# ---- branch and bound ------------------------------------------------------------------------


def _search(
    problem: _Problem, best: tuple[Bounded, Integers], gap: float, parts: int
) -> tuple[float, tuple[Bounded, Integers], int]:
    """Return an upper bound of W*, the best policy found, and the sets that were bounded."""
    tie = count()
    bound, solutions, allowed = _relaxed(problem, {})
    heap: list[tuple[float, int, dict[int, int], list[Solution], Integers]] = []
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
        for action in problem.actions(branch):
            inside = {**fixed, branch: action}
            below, found, kept = _relaxed(problem, inside)
            used += 1
            heappush(heap, (-min(below, bound), next(tie), inside, found, kept))
    top = -heap[0][0] if heap else -np.inf
    return max(top, done), best, used


def _relaxed(problem: _Problem, fixed: Mapping[int, int]) -> tuple[float, list[Solution], Integers]:
    """Return Σ λ_k V_k* over the policies that keep some decisions, rounded up."""
    first = problem.first
    wanted = np.full(first.n_states, -1)
    for group, action in fixed.items():
        wanted[(problem.group == group) & problem.free] = action
    rule = wanted[first.pair_state]
    allowed = np.flatnonzero((rule < 0) | (rule == first.pair_action))
    solutions = [solve(restricted(mdp, allowed)) for mdp in problem.models]
    bound = _weighted(problem.weights, [found.start for found in solutions]).interval[1]
    return bound, solutions, allowed


def _parting(
    problem: _Problem, solutions: Sequence[Solution], allowed: Integers
) -> tuple[int | None, Integers]:
    """Return the group on which the optima disagree most, and a policy by their votes."""
    nobody = np.zeros(0, dtype=np.int64)
    votes = problem.votes(nobody, nobody, np.zeros(0))
    for w, mdp, found in zip(problem.weights, problem.models, solutions, strict=True):
        if w > 0:
            own = allowed[found.pairs]
            seen = visits(mdp, PolicyChain.of(mdp, problem.chosen(own)).discounted).value
            states = np.flatnonzero(reachable(mdp, pairs=own) & problem.free)
            weight = np.maximum(w * seen[states], LEAST)
            votes += problem.votes(states, problem.first.pair_action[own[states]], weight)
    pairs = allowed[solutions[int(np.argmax(problem.weights))].pairs]
    chosen = problem.by_votes(problem.fitted(pairs), votes)
    split = (votes > 0).sum(axis=1) > 1
    if not split.any():
        return None, chosen
    apart = np.where(split, votes.sum(axis=1) - votes.max(axis=1), -1.0)
    return int(apart.argmax()), chosen


def restricted(mdp: MDP, pairs: Integers) -> MDP:
    """Return the model with some of its pairs (K,) only, at least one in each state."""
    if len(pairs) == mdp.n_pairs:
        return mdp
    return mdp.with_(
        table=mdp.table.of_pairs(pairs),
        pair_state=mdp.pair_state[pairs],
        pair_action=mdp.pair_action[pairs],
    )
