"""Several weighted models of the same states, and what one policy is worth in them.

See `analysis.sensitivity.multi_model` for the problem that this states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers, float_array
from exact_mdp.solvers import evaluate
from exact_mdp.solvers.bounds.bounds import levels
from exact_mdp.solvers.solution import Bounded
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.visits import visits


class Problem:
    """Models with the same pairs, and the states that share a decision.

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
    order : (S,) ints or None
        Levels from the end; None where the models have cycles.
    taken : (L,) bool
        Pairs of states in which there is a choice.
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

    def values(self, pairs: Integers) -> tuple[Bounded, ...]:
        """Return a policy's value in each model; pairs (S,) are those that it takes."""
        chosen = np.zeros(self.first.n_pairs)
        chosen[pairs] = 1.0
        return tuple(evaluate(mdp, chosen).numbers["mean"] for mdp in self.models)

    def value(self, pairs: Integers) -> Bounded:
        """Return its weighted value."""
        return weighted(self.weights, self.values(pairs))

    def fitted(self, pairs: Integers) -> Integers:
        """Return the pairs of a policy that gives each group one action: its commonest."""
        first = self.first
        if len(np.unique(self.group)) == first.n_states:
            return pairs
        seen = self.visits_of(pairs)
        votes: dict[tuple[int, int], float] = {}
        for state in np.flatnonzero(~first.forced).tolist():
            key = int(self.group[state]), int(first.pair_action[pairs[state]])
            votes[key] = votes.get(key, 0.0) + float(seen[state]) + 1e-9
        return self.by_votes(pairs, votes)

    def by_votes(self, pairs: Integers, votes: Mapping[tuple[int, int], float]) -> Integers:
        """Return the pairs of a policy after each group has taken the action of most votes."""
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

    def visits_of(self, pairs: Integers) -> Floats:
        """Return (S,) weighted expected visits."""
        chosen = np.zeros(self.first.n_pairs)
        chosen[pairs] = 1.0
        found = [
            w * visits(mdp, PolicyChain.of(mdp, chosen).discounted).value
            for w, mdp in zip(self.weights, self.models, strict=True)
        ]
        return np.asarray(sum(found))


def _groups(mdp: MDP, columns: Sequence[str] | None) -> Integers:
    """Return (S,) the decision that each state belongs to."""
    if columns is None:
        return np.arange(mdp.n_states)
    key = np.zeros(mdp.n_states, dtype=np.int64)
    for name in columns:
        key = key * mdp.space.column(name).size + np.maximum(mdp.space.values(name), 0)
    return key


def weighted(weights: Floats, numbers: Sequence[Bounded]) -> Bounded:
    """Return Σ λ x with its error bound, the rounding of the weights left to their definition."""
    terms = [w * number.value for w, number in zip(weights.tolist(), numbers, strict=True)]
    error = sum(w * number.error for w, number in zip(weights.tolist(), numbers, strict=True))
    rounding = (len(terms) + 2) * 2.0**-52 * sum(map(abs, terms))
    return Bounded(value=float(sum(terms)), error=float(error * (1 + 1e-9) + rounding))
