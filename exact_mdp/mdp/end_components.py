"""The graph of the pairs: reachability, avoidance and end components.

An end component is a set of states with pairs that never leave it and connect all of it. Under any
policy, the states and pairs used forever form an end component with probability 1 (de Alfaro,
Formal Verification of Probabilistic Systems, 1997, sections 3.1 to 3.3; Baier and Katoen,
Principles of Model Checking, 2008, section 10.6). Maximal end components are found by alternately
removing states that cannot stay and splitting into strongly connected components.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import count

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.graph import Backward, Mask, Transitions, strong_components
from exact_mdp.mdp.table import Integers, Numbers, concatenate_ranges


@dataclass(frozen=True, eq=False)
class PairGraph:
    """The graph of S `states` and L pairs: pair l may lead to next[offsets[l]:offsets[l+1]]."""

    states: int
    pair_state: Integers
    offsets: Integers
    next: Numbers

    @classmethod
    def of(cls, mdp: Transitions) -> PairGraph:
        """Return the graph of a model, from its exact outcomes."""
        return cls(len(mdp.pair_offsets) - 1, mdp.pair_state, mdp.table.offsets, mdp.table.next)

    @cached_property
    def _backward(self) -> Backward:
        return Backward.of(self.offsets, self.next, self.pair_state, self.states)

    def find_pairs_within(self, states: Mask) -> Mask:
        """Return (L,) True for pairs that lead only to some states (S,)."""
        return np.asarray(np.logical_and.reduceat(states[self.next], self.offsets[:-1]))

    def find_pairs_into(self, states: Mask) -> Mask:
        """Return (L,) True for pairs that may lead to some states (S,)."""
        return np.asarray(np.logical_or.reduceat(states[self.next], self.offsets[:-1]))

    def find_states_with(self, pairs: Mask) -> Mask:
        """Return (S,) True for states with one of some pairs (L,)."""
        return np.bincount(self.pair_state[pairs], minlength=self.states) > 0

    def find_falling_pairs(self, distance: Integers) -> Mask:
        """Return (L,) True for pairs that may lead to a smaller distance (S,); -1 is infinite."""
        far = np.where(distance < 0, self.states, distance)
        least = np.minimum.reduceat(far[self.next], self.offsets[:-1])
        return np.asarray(least < far[self.pair_state])

    def compute_distance(self, target: Mask, pairs: Mask) -> Integers:
        """Return (S,) the least number of steps along `pairs` (L,) to the target; -1 if none."""
        one = np.ones(self.states, dtype=np.int64)
        return self._backward.rank_states(target, pairs, one)[0]

    def compute_ranks(self, target: Mask, pairs: Mask) -> Integers:
        """Return (S,) ranks that may fall along each of `pairs` (L,) to 0 in the target; or -1.

        A state without such a pair also has rank 0.
        """
        needed = np.bincount(self.pair_state[pairs], minlength=self.states)
        return self._backward.rank_states(target | (needed == 0), pairs, needed)[0]

    def compute_rounds(self, target: Mask, pairs: Mask) -> Integers:
        """Return (S,) 0 if some policy of `pairs` surely reaches the target, else a round.

        Each round removes the states that cannot reach the target without a pair that may lead to a
        state removed before. Every pair of a removed state may lead to an earlier round, or leads
        only to states of its own round.
        """
        given_up = np.zeros(self.states, dtype=np.int64)
        for number in count(1):
            left = given_up == 0
            way = self.compute_distance(target & left, pairs & self.find_pairs_within(left)) >= 0
            if (way == left).all():
                break
            given_up[left & ~way] = number
        return given_up

    def find_sure_pairs(self, target: Mask) -> tuple[Mask, Mask]:
        """Return (S,) True where some policy surely reaches the target, and (L,) safe pairs.

        These are the pairs of such states, outside the target, that lead only to such states.
        """
        sure = self.compute_rounds(target, np.ones(len(self.pair_state), dtype=bool)) == 0
        return sure, (sure & ~target)[self.pair_state] & self.find_pairs_within(sure)

    def split_pairs(self, pairs: Mask) -> PairGraph:
        """Return the graph in which each outcome of some pairs (L,) is a pair of its own."""
        lengths = np.diff(self.offsets)
        begins = np.repeat(pairs, lengths)
        begins[self.offsets[:-1]] = True
        owner = np.repeat(self.pair_state, lengths)[begins]
        offsets = np.append(np.flatnonzero(begins), len(self.next))
        return PairGraph(self.states, owner, offsets, self.next)

    def find_base(self, pairs: Mask) -> int | None:
        """Return a state of all end components of some pairs (L,), or None.

        Every policy of these pairs visits it again and again.
        """
        found = self.find_states_with(pairs)
        while found.any():
            base = int(found.argmax())
            here = np.arange(self.states) == base
            away = pairs & ~here[self.pair_state] & ~self.find_pairs_into(here)
            label, inside = self.end_components(away)
            if (label < 0).all():
                return base
            # A base is in every end component, and so in one that has a pair for each state.
            chosen = np.flatnonzero(inside)
            alone = np.zeros_like(pairs)
            alone[chosen[np.unique(self.pair_state[chosen], return_index=True)[1]]] = True
            found &= self.end_components(alone)[0] == 0
        return None

    def end_components(self, pairs: Mask) -> tuple[Integers, Mask]:
        """Return (S,) the number of each state's end component or -1, and their pairs (L,)."""
        number, inside = np.full(self.states, -1), pairs.copy()
        while True:
            # Remove states all of whose pairs may leave, and pairs that may lead to them.
            stays = self.find_states_with(inside)
            leaving = self.compute_ranks(~stays, inside) >= 0
            inside &= ~self.find_pairs_into(leaving) & ~leaving[self.pair_state]
            stays &= ~leaving
            chosen, place, size = np.flatnonzero(inside), np.cumsum(stays) - 1, int(stays.sum())
            if not size:
                return number, inside
            # The strongly connected components of the remaining graph.
            first, lengths = self.offsets[chosen], np.diff(self.offsets)[chosen]
            source = np.repeat(place[self.pair_state[chosen]], lengths)
            target = place[self.next[concatenate_ranges(first, first + lengths)]]
            rows = np.searchsorted(source, np.arange(size + 1))
            ones = np.ones(len(source), dtype=np.int8)
            label = strong_components(sp.csr_array((ones, target, rows), (size, size)))
            # Remove pairs that lead from one to another; without any, these are the end components.
            crossing = label[source] != label[target]
            apart = np.logical_or.reduceat(crossing, np.cumsum(lengths) - lengths)
            if not apart.any():
                number[stays] = label
                return number, inside
            inside[chosen[apart]] = False
