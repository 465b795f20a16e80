"""Heuristics and branch and bound for one policy in several models; see `multi_model`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from heapq import heappop, heappush
from itertools import count

import numpy as np

from mdp.chain import reachable, spans
from mdp.errors import ModelError
from mdp.model import MDP
from mdp.table import Floats, Integers, OutcomeTable, float_array
from solvers import evaluate, solve
from solvers.bounds import levels
from solvers.policy_chain import PolicyChain
from solvers.solution import Bounded, Solution
from solvers.visits import visits

ROUNDS = 100


class Problem:
    """Models with the same pairs, and the states that share a decision."""

    def __init__(
        self,
        models: Sequence[MDP],
        weights: Sequence[float] | None,
        columns: Sequence[str] | None,
    ) -> None:
        self.models = list(models)
        if not self.models:
            raise ModelError("no model", where="multi-model", fix="give at least one")
        first = self.models[0]
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
        given = np.ones(len(self.models)) if weights is None else float_array(list(weights))
        if given.shape != (len(self.models),) or not (given >= 0).all() or not given.sum() > 0:
            raise ModelError(
                f"weights {given.tolist()} for {len(self.models)} models",
                where="multi-model",
                fix="give one weight of at least 0 for each, not all of them 0",
            )
        if not np.isfinite(given.sum()):
            raise ModelError("weights too large", where="multi-model", fix="scale them down")
        self.weights = given / given.sum()
        self.weights.setflags(write=False)
        self.first = first
        self.group = _groups(first, columns)
        rate = float(self.weights @ [mdp.discount for mdp in self.models])
        transition = sum(
            w * mdp.transition for w, mdp in zip(self.weights, self.models, strict=True)
        )
        reward = sum(w * mdp.reward for w, mdp in zip(self.weights, self.models, strict=True))
        same_rate = len({mdp.discount_exact for mdp in self.models}) == 1
        self.mean = MDP.from_pairs(
            first.pair_state,
            first.pair_action,
            transition,
            reward,
            first.discount_exact if same_rate else rate,
            start=dict(first.start),
        )
        self.order = levels(self.mean)
        self.taken = ~first.forced[first.pair_state]

    # ---- values ------------------------------------------------------------------------------

    def values(self, pairs: Integers) -> tuple[Bounded, ...]:
        chosen = np.zeros(self.first.n_pairs)
        chosen[pairs] = 1.0
        return tuple(evaluate(mdp, chosen).numbers["mean"] for mdp in self.models)

    def value(self, pairs: Integers) -> Bounded:
        return weighted(self.weights, self.values(pairs))

    def fitted(self, pairs: Integers) -> Integers:
        """Return the pairs of a policy that gives each group one action: its commonest."""
        first = self.first
        if len(np.unique(self.group)) == first.n_states:
            return pairs
        seen = self._visits(pairs)
        votes: dict[tuple[int, int], float] = {}
        for state in np.flatnonzero(~first.forced).tolist():
            key = int(self.group[state]), int(first.pair_action[pairs[state]])
            votes[key] = votes.get(key, 0.0) + float(seen[state]) + 1e-9
        return self._by_votes(pairs, votes)

    def _by_votes(self, pairs: Integers, votes: Mapping[tuple[int, int], float]) -> Integers:
        first = self.first
        best: dict[int, int] = {}
        for (group, action), vote in sorted(votes.items()):
            if group not in best or vote > votes[group, best[group]]:
                best[group] = action
        chosen = pairs.copy()
        for state in np.flatnonzero(~first.forced).tolist():
            if int(self.group[state]) in best:
                chosen[state] = first.pair(state, best[int(self.group[state])])
        return chosen

    def _visits(self, pairs: Integers) -> Floats:
        """Return (S,) weighted expected visits."""
        chosen = np.zeros(self.first.n_pairs)
        chosen[pairs] = 1.0
        found = [
            w * visits(mdp, PolicyChain.of(mdp, chosen).discounted).value
            for w, mdp in zip(self.weights, self.models, strict=True)
        ]
        return np.asarray(sum(found))

    # ---- heuristics --------------------------------------------------------------------------

    def weight_select_update(self) -> Integers:
        """Choose level by level from the end by Σ λ_k Q_k, updating the values of each model."""
        first, order = self.first, self.order
        assert order is not None
        value = np.zeros((len(self.models), first.n_states))
        pairs = first.pair_offsets[:-1].copy()
        for depth in range(1, int(order.max(initial=0)) + 1):
            states = np.flatnonzero(order == depth)
            begin, end = first.pair_offsets[states], first.pair_offsets[states + 1]
            rows = spans(begin, end)
            q = np.stack(
                [
                    mdp.reward[rows] + mdp.discount * (mdp.transition[rows] @ value[k])
                    for k, mdp in enumerate(self.models)
                ]
            )
            cuts = np.cumsum(end - begin) - (end - begin)
            chosen = _first_best(self.weights @ q, cuts)
            pairs[states] = rows[chosen]
            value[:, states] = q[:, chosen]
        return pairs

    def improved(self, value: Bounded, pairs: Integers) -> tuple[Bounded, Integers]:
        """Change decisions as long as that pays: all that seem to at once, or the best one."""
        first = self.first
        for _ in range(ROUNDS):
            score = np.zeros(first.n_pairs)
            chosen = np.zeros(first.n_pairs)
            chosen[pairs] = 1.0
            for w, mdp in zip(self.weights, self.models, strict=True):
                chain = PolicyChain.of(mdp, chosen)
                worth = np.nan_to_num(evaluate(mdp, chain).value)
                seen = np.where(mdp.terminal, 0.0, visits(mdp, chain.discounted).value)
                gain = mdp.backup(worth) - worth[mdp.pair_state]
                score += w * seen[mdp.pair_state] * gain
            votes: dict[tuple[int, int], float] = {}
            for pair in np.flatnonzero(self.taken).tolist():
                key = int(self.group[first.pair_state[pair]]), int(first.pair_action[pair])
                votes[key] = votes.get(key, 0.0) + float(score[pair])
            wanted = {key: vote for key, vote in votes.items() if vote > 1e-12}
            if not wanted:
                break
            single = max(wanted, key=lambda key: wanted[key])
            for change in (wanted, {single: wanted[single]}):
                tried = self._by_votes(pairs, change)
                after = self.value(tried)
                if after.interval[0] > value.interval[1]:
                    value, pairs = after, tried
                    break
            else:
                break
        return value, pairs

    # ---- branch and bound --------------------------------------------------------------------

    def search(
        self, best: tuple[Bounded, Integers], gap: float, parts: int
    ) -> tuple[float, tuple[Bounded, Integers], int]:
        """Return an upper bound of W*, the best policy found, and the sets that were bounded."""
        tie, heap = count(), []
        bound, solutions, allowed = self._relaxed({})
        heappush(heap, (-bound, next(tie), {}, solutions, allowed))
        used, done = 1, -np.inf
        while heap:
            bound = -heap[0][0]
            if bound <= best[0].interval[0] + gap or used >= parts:
                break
            _, _, fixed, solutions, allowed = heappop(heap)
            branch, pairs = self._parting(solutions, allowed)
            value = self.value(pairs)
            if value.interval[0] > best[0].interval[0]:
                best = value, pairs
            if branch is None:  # all models agree where they go: the bound is attained
                done = max(done, bound)
                continue
            for action in self._actions(branch):
                inside = {**fixed, branch: action}
                below, found, kept = self._relaxed(inside)
                used += 1
                heappush(heap, (-min(below, bound), next(tie), inside, found, kept))
        top = -heap[0][0] if heap else -np.inf
        return max(top, done), best, used

    def _actions(self, group: int) -> list[int]:
        """Return the actions that every state of a group offers."""
        first = self.first
        states = np.flatnonzero((self.group == group) & ~first.forced)
        offered = [
            {int(first.pair_action[pair]) for pair in first.pairs_of(state)}
            for state in states.tolist()
        ]
        return sorted(set.intersection(*offered))

    def _relaxed(self, fixed: Mapping[int, int]) -> tuple[float, list[Solution], Integers]:
        """Return Σ λ_k V_k* over the policies that keep some decisions, rounded up."""
        first = self.first
        wanted = np.full(first.n_states, -1)
        for group, action in fixed.items():
            wanted[(self.group == group) & ~first.forced] = action
        rule = wanted[first.pair_state]
        allowed = np.flatnonzero((rule < 0) | (rule == first.pair_action))
        solutions = [solve(restricted(mdp, allowed)) for mdp in self.models]
        bound = weighted(self.weights, [found.start for found in solutions]).interval[1]
        return bound, solutions, allowed

    def _parting(
        self, solutions: Sequence[Solution], allowed: Integers
    ) -> tuple[int | None, Integers]:
        """Return the group on which the optima disagree most, and a policy by their votes."""
        first = self.first
        votes: dict[tuple[int, int], float] = {}
        pairs = allowed[solutions[int(np.argmax(self.weights))].pairs]
        for w, mdp, found in zip(self.weights, self.models, solutions, strict=True):
            if w == 0:
                continue
            own = allowed[found.pairs]
            chosen = np.zeros(first.n_pairs)
            chosen[own] = 1.0
            seen = visits(mdp, PolicyChain.of(mdp, chosen).discounted).value
            meets = reachable(mdp, pairs=own) & ~first.forced
            for state in np.flatnonzero(meets).tolist():
                key = int(self.group[state]), int(first.pair_action[own[state]])
                votes[key] = votes.get(key, 0.0) + w * max(float(seen[state]), 1e-300)
        total: dict[int, float] = {}
        most: dict[int, float] = {}
        several: dict[int, int] = {}
        for (group, _), vote in votes.items():
            total[group] = total.get(group, 0.0) + vote
            most[group] = max(most.get(group, 0.0), vote)
            several[group] = several.get(group, 0) + 1
        open_groups = [group for group, number in several.items() if number > 1]
        chosen_pairs = self._by_votes(self.fitted(pairs), votes)
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
    table = mdp.table
    chosen = spans(table.offsets[pairs], table.offsets[pairs + 1])
    per_pair = len(table.gain) == table.pairs
    part = OutcomeTable(
        offsets=np.concatenate([[0], np.cumsum(np.diff(table.offsets)[pairs])]),
        next=table.next[chosen],
        weight=table.weight[chosen],
        denominator=table.denominator[pairs],
        gain=table.gain[pairs if per_pair else chosen],
        gain_denominator=table.gain_denominator[pairs],
        event=None if table.event is None else table.event[chosen],
    )
    return mdp.with_(
        table=part, pair_state=mdp.pair_state[pairs], pair_action=mdp.pair_action[pairs]
    )


def _groups(mdp: MDP, columns: Sequence[str] | None) -> Integers:
    """Return (S,) the decision that each state belongs to."""
    if columns is None:
        return np.arange(mdp.n_states)
    key = np.zeros(mdp.n_states, dtype=np.int64)
    for name in columns:
        key = key * mdp.space.column(name).size + np.maximum(mdp.space.values(name), 0)
    return key


def _first_best(values: Floats, first: Integers) -> Integers:
    lengths = np.diff(np.append(first, len(values)))
    best = np.repeat(np.maximum.reduceat(values, first), lengths)
    return np.minimum.reduceat(np.where(values == best, np.arange(len(values)), len(values)), first)


def weighted(weights: Floats, numbers: Sequence[Bounded]) -> Bounded:
    """Return Σ λ x with its error bound, the rounding of the weights left to their definition."""
    terms = [w * number.value for w, number in zip(weights.tolist(), numbers, strict=True)]
    error = sum(w * number.error for w, number in zip(weights.tolist(), numbers, strict=True))
    rounding = (len(terms) + 2) * 2.0**-52 * sum(map(abs, terms))
    return Bounded(value=float(sum(terms)), error=float(error * (1 + 1e-9) + rounding))
