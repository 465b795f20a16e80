"""Where the runs of a model end, and what a run is worth that does not end as it should.

A run ends in a terminal state: every action stays there, and earns 0. In a model with a goal it
should end there; at discount 1 a run that ends outside the goal, or never ends, has missed it, and
is worth `unreached`, which is +∞ or -∞. Without a goal a run that never ends is worth all
that it earns, perhaps without bound.

Every policy ends, that is, reaches a terminal state with probability 1 from every state, if and
only if no set of other states exists in which some policy can stay forever. To find the greatest
such set, remove a state as soon as each of its pairs has a successor that was removed before, and
begin with the terminal states. The states that are never removed are this set, and the round in
which a state is removed is its rank:

    terminal states have rank 0; EVERY pair of another state reaches a smaller rank in one step

with positive probability, which can be checked pair by pair and proves termination (proper
policies: Bertsekas and Tsitsiklis, Mathematics of Operations Research 16, 1991; end components: de
Alfaro, Formal Verification of Probabilistic Systems, 1997, section 3.3). All work is linear in the
number of transitions, but for end components.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.graph import (
    Backward,
    Mask,
    PairGraph,
    find_least_successors,
    find_start_states,
    rank_acyclic_states,
)
from exact_mdp.mdp.sense import Sense
from exact_mdp.mdp.table import Integers, OutcomeTable

AMOUNTS = ("gain", "gain_denominator", "event", "components", "component_denominator")


@dataclass(frozen=True, kw_only=True, eq=False)
class Ends:
    """What decides where the runs of a model end; each answer is computed when it is first asked.

    The attributes are the parts of the model of the same names.
    """

    table: OutcomeTable
    transition: sp.csr_array
    pair_state: Integers
    pair_offsets: Integers
    start: tuple[tuple[int, Fraction], ...]
    discount_exact: Fraction
    sense: Sense
    goal: Mask | None
    unreached: float

    # ---- states ------------------------------------------------------------------------------

    @cached_property
    def forced(self) -> Mask:
        """(S,) True for states with a single action."""
        return np.asarray(np.diff(self.pair_offsets) == 1)

    @cached_property
    def terminal(self) -> Mask:
        """(S,) True where every action stays in the state forever and earns 0."""
        # A pair stays if its only next state is its own state.
        indptr = self.transition.indptr
        stays = np.diff(indptr) == 1
        alone = np.flatnonzero(stays)
        stays[alone] = self.transition.indices[indptr[alone]] == self.pair_state[alone]
        # Rewards matter only for these pairs, and these are few in most models.
        alone = np.flatnonzero(stays)
        if len(alone):
            stays[alone] = ~self.table.of_pairs(alone).any_outcome("gain")
        return self._all_of_state(stays)

    @cached_property
    def over(self) -> Mask:
        """(S,) True for states in which an episode is over: terminal, with no amount to count."""
        idle = np.ones(len(self.pair_state), dtype=bool)
        if self.table.components is not None:
            idle &= ~self.table.any_outcome("components")
        if self.table.event is not None:
            idle &= ~self.table.any_outcome("event")
        return self.terminal & self._all_of_state(idle)

    @cached_property
    def must_choose(self) -> Mask:
        """(S,) True where a policy must choose: several actions, and the episode is not over.

        In other states a policy may name any action, or none.
        """
        return ~self.forced & ~self.over

    @cached_property
    def alike(self) -> Mask:
        """(S,) True where all actions have the same outcomes and amounts, number for number."""
        # Compare each pair with the first pair of its state, at first by the number of outcomes.
        table, first = self.table, self.pair_offsets[self.pair_state]
        lengths = np.diff(table.offsets)
        same = lengths == lengths[first]
        rows = np.flatnonzero(same)
        # Then compare pairs with as many outcomes in each array of the table.
        ours, theirs = table.of_pairs(rows), table.of_pairs(first[rows])
        for name in ("next", "weight", "denominator", *AMOUNTS):
            here, there = getattr(ours, name), getattr(theirs, name)
            if here is None:
                continue
            equal = np.asarray(here == there, dtype=bool)
            if equal.ndim == 2:
                equal = np.asarray(equal.all(axis=1))
            # Arrays by outcome agree if they do in every outcome of the pair.
            if len(equal) == len(ours.next):
                equal = np.asarray(np.logical_and.reduceat(equal, ours.offsets[:-1]))
            same[rows] &= equal
        return self._all_of_state(same)

    @property
    def choice_matters(self) -> Mask:
        """(S,) True where a policy must choose among actions that are not all alike."""
        return ~self.over & ~self.alike

    def _all_of_state(self, pairs: Mask) -> Mask:
        """Return (S,) True for states all of whose pairs are among some pairs (L,)."""
        return np.asarray(np.logical_and.reduceat(pairs, self.pair_offsets[:-1]))

    # ---- the goal ----------------------------------------------------------------------------

    @property
    def has_goal(self) -> bool:
        """Whether a run that never reaches certain states has an infinite value."""
        return self.goal is not None

    @property
    def destination(self) -> Mask:
        """(S,) True for states in which a run ends as it should: the goal, or all terminal ones."""
        if self.goal is None:
            return self.terminal
        return self.goal

    def find_missed(self, states: Mask) -> Mask:
        """Return (S,) True for `states` (S,) outside the goal: a run that stays there misses it."""
        if self.goal is None:
            return np.zeros_like(states)
        return states & ~self.goal

    @cached_property
    def outside_goal(self) -> Mask:
        """(S,) True for terminal states outside the goal; all False without a goal."""
        return self.find_missed(self.terminal)

    @property
    def missing_pays(self) -> bool:
        """Whether it is the best of all to miss the goal, not the worst; False without a goal."""
        return self.has_goal and bool(self.sense.orient(self.unreached) > 0)

    # ---- runs --------------------------------------------------------------------------------

    @cached_property
    def numbered_in_order(self) -> bool:
        """Whether every transition from a nonterminal state leads to a higher number."""
        first = int(self.transition.indices[0])  # most models without this order show it here
        if (first <= 0 and not self.terminal[0]) or not self.terminal[-1]:
            return False
        rising = find_least_successors(self) > np.arange(len(self.terminal))
        return bool((rising | self.terminal).all())

    @cached_property
    def most_steps(self) -> Integers | None:
        """(S,) the greatest number of steps to a terminal state; None if there is a cycle."""
        offsets = self.transition.indptr[self.pair_offsets]
        return rank_acyclic_states(offsets, self.transition.indices, self.terminal)

    @property
    def is_acyclic(self) -> bool:
        """Whether no nonterminal state can come back to itself."""
        return self.numbered_in_order or self.most_steps is not None

    @cached_property
    def rank(self) -> Integers:
        """(S,) a proof that every policy ends; -1 in states in which a policy can stay forever."""
        # If all transitions go up, the numbers in reverse are ranks.
        if self.numbered_in_order:
            return np.where(self.terminal, 0, np.arange(len(self.terminal))[::-1])
        # Otherwise remove states backward from the terminal ones, each when all its pairs can
        # leave.
        matrix, every = self.transition, np.ones(len(self.pair_state), dtype=bool)
        backward = Backward.of(matrix.indptr, matrix.indices, self.pair_state, len(self.terminal))
        return backward.rank_states(self.terminal, every, np.diff(self.pair_offsets))[0]

    @property
    def rank_in_proof(self) -> Integers | None:
        """The rank, if a proof needs it: at discount 1."""
        if self.discount_exact == 1:
            return self.rank
        return None

    @cached_property
    def every_policy_ends(self) -> bool:
        """Whether every policy reaches a terminal state with probability 1."""
        return bool((self.rank >= 0).all())

    def find_endless_pairs(self) -> Integers:
        """Return one pair of each state of a policy that stays forever; none if every policy ends.

        These are the first pairs that do not leave the states without a rank.
        """
        matrix = self.transition
        inside = np.logical_and.reduceat(self.rank[matrix.indices] < 0, matrix.indptr[:-1])
        pairs = np.flatnonzero(inside)
        return pairs[np.unique(self.pair_state[pairs], return_index=True)[1]]

    @property
    def has_improper_policy(self) -> bool:
        """Whether the discount is 1 and some policy never ends, or ends outside the goal."""
        if self.discount_exact != 1:
            return False
        return bool(self.outside_goal.any()) or not self.every_policy_ends

    @cached_property
    def is_shortest_path(self) -> bool:
        """Whether staying forever costs something at every step, and every state can end.

        Policies that never end are then worth -∞ (+∞ for costs), and the optimum is the best of
        those that end (stochastic shortest paths: Bertsekas and Tsitsiklis, Mathematics of
        Operations Research 16, 1991). With a goal, runs end there. If missing it is the worst of
        all, states from which no policy is sure of the goal may exist, but not at the start; if it
        pays, no run may.
        """
        graph = PairGraph.of(self)
        sure, inside = graph.find_sure_pairs(self.destination)
        _, staying = graph.end_components(inside)
        if self.missing_pays:
            return bool(sure.all() and not staying.any())
        if self.has_goal:
            sure = sure[find_start_states(self)]
        earned, _ = self.table.expected_gain_exact
        costs = np.asarray(self.sense.orient(earned) < 0, dtype=bool)
        return bool(sure.all() and costs[staying].all())

    @property
    def has_finite_optimum(self) -> bool:
        """Whether no policy is improper, or the best policy from the start is proper anyway."""
        return not self.has_improper_policy or self.is_shortest_path
