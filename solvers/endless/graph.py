"""What can be reached, what can be avoided, and where a policy can stay: the graph of the pairs.

    distance   the fewest steps in which a target is reached with positive probability
    ranks      the same for the worst choice: EVERY pair of a ranked state may lead to a lower one
    rounds     0 where some policy reaches a target with probability 1, elsewhere the round in which
               the state was given up
    end_components   the maximal sets that some policy can stay in for ever, all of it used

A round gives up the states that cannot reach the target without a pair that may lead to a state
given up before. So every pair of such a state may lead to an earlier round, or leads nowhere but to
its own. An end component is a set of states with pairs that never leave it and connect all of it;
whatever a policy does, the states and pairs that it uses for ever are one, with probability 1
(de Alfaro, Formal Verification of Probabilistic Systems, 1997, sections 3.1 to 3.3; Baier and
Katoen, Principles of Model Checking, 2008, section 10.6). Maximal ones are found by splitting into
strongly connected components, and peeling off what cannot stay, in turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from exact_mdp.mdp.chain import join, strong_components
from exact_mdp.mdp.lazy import later, worth_compiling
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers, Numbers, spans

kernel = later("exact_mdp.solvers.kernels.graph")
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Graph:
    """S states, L pairs and N transitions, pair by pair."""

    pair_state: Integers
    pair_offsets: Integers
    offsets: Integers
    next: Numbers

    @classmethod
    def of(cls, mdp: MDP) -> Graph:
        """Return the graph of a model, from its exact outcomes."""
        return cls(mdp.pair_state, mdp.pair_offsets, mdp.table.offsets, mdp.table.next)

    @property
    def states(self) -> int:
        """Number of states, S."""
        return len(self.pair_offsets) - 1

    @cached_property
    def _into(self) -> tuple[Numbers, Numbers]:
        """Each state's incoming pairs: offsets (S+1,), and pairs."""
        shape = (len(self.pair_state), self.states)
        ones = np.ones(len(self.next), dtype=np.int8)
        turned = sp.csr_array((ones, self.next, self.offsets), shape).tocsc()
        return turned.indptr, turned.indices

    def every(self, states: Mask) -> Mask:
        """Return (L,) True for pairs that lead nowhere but to some states (S,)."""
        return np.asarray(np.logical_and.reduceat(states[self.next], self.offsets[:-1]))

    def some(self, states: Mask) -> Mask:
        """Return (L,) True for pairs that may lead to some states (S,)."""
        return np.asarray(np.logical_or.reduceat(states[self.next], self.offsets[:-1]))

    def having(self, pairs: Mask) -> Mask:
        """Return (S,) True for states with one of some pairs (L,)."""
        return np.bincount(self.pair_state[pairs], minlength=self.states) > 0

    def distance(self, target: Mask, pairs: Mask) -> Integers:
        """Return (S,) the fewest steps along `pairs` (L,) to the target, -1 where no way leads."""
        return self._spread(target, pairs, np.ones(self.states, dtype=np.int64))

    def ranks(self, target: Mask, pairs: Mask) -> Integers:
        """Return (S,) ranks that may fall along each of `pairs` (L,) to 0 in the target; or -1.

        A state without such a pair is at 0, too.
        """
        waiting = np.bincount(self.pair_state[pairs], minlength=self.states)
        return self._spread(target | (waiting == 0), pairs, waiting)

    def _spread(self, first: Mask, pairs: Mask, waiting: Integers) -> Integers:
        """Return when a state joins: once that many of its pairs may lead to those before."""
        chosen = np.flatnonzero(first)
        queue = np.empty(self.states, dtype=np.int64)
        queue[: len(chosen)] = chosen
        rank = np.where(first, 0, -1)
        parts = (*self._into, self.pair_state, pairs.copy(), waiting.copy(), rank, queue)
        if worth_compiling(len(self.next)):
            kernel.join(*parts, len(chosen))
            return rank
        lists: list[Any] = [*(part.tolist() for part in parts), len(chosen)]
        join(*lists)
        return np.array(lists[5], dtype=np.int64)

    def rounds(self, target: Mask, pairs: Mask) -> Integers:
        """Return (S,) 0 where some policy of `pairs` reaches the target for sure, or a round."""
        given_up = np.zeros(self.states, dtype=np.int64)
        for number in count(1):
            left = given_up == 0
            way = self.distance(target & left, pairs & self.every(left)) >= 0
            if (way == left).all():
                break
            given_up[left & ~way] = number
        return given_up

    def end_components(self, pairs: Mask) -> tuple[Integers, Mask]:
        """Return (S,) the number of each state's end component or -1, and their pairs (L,)."""
        inside = pairs.copy()
        while True:
            leaving = self.ranks(~self.having(inside), inside) >= 0
            inside &= ~self.some(leaving) & ~leaving[self.pair_state]
            here, there = self._edges(inside)
            shape = (self.states, self.states)
            graph = sp.csr_array((np.ones(len(here), dtype=np.int8), (here, there)), shape)
            label = strong_components(graph)
            crossing = np.zeros(len(inside), dtype=bool)
            apart = label[self.next] != label[np.repeat(self.pair_state, np.diff(self.offsets))]
            crossing = np.logical_or.reduceat(apart, self.offsets[:-1]) & inside
            if not crossing.any():
                break
            inside &= ~crossing
        number = np.full(self.states, -1, dtype=np.int64)
        stays = self.having(inside)
        number[stays] = np.unique(label[stays], return_inverse=True)[1]
        return number, inside

    def levels(self, label: Integers, pairs: Mask) -> Integers:
        """Return (S,) ranks that may fall along each of `pairs` (L,), states of one label as one.

        Each of -1 is a state by itself. The pairs make no end component of the merged states.
        """
        own = np.where(label >= 0, label, int(label.max(initial=-1)) + 1 + np.arange(self.states))
        names, own = np.unique(own, return_inverse=True)
        chosen = np.flatnonzero(pairs)
        chosen = chosen[np.argsort(own[self.pair_state[chosen]], kind="stable")]
        lengths = self.offsets[chosen + 1] - self.offsets[chosen]
        state = own[self.pair_state[chosen]]
        merged = Graph(
            state,
            np.searchsorted(state, np.arange(len(names) + 1)),
            np.concatenate([[0], np.cumsum(lengths)]),
            own[self.next[spans(self.offsets[chosen], self.offsets[chosen + 1])]],
        )
        none, every = np.zeros(len(names), dtype=bool), np.ones(len(chosen), dtype=bool)
        return merged.ranks(none, every)[own]

    def _edges(self, pairs: Mask) -> tuple[Integers, Numbers]:
        chosen = np.repeat(pairs, np.diff(self.offsets))
        return np.repeat(self.pair_state, np.diff(self.offsets))[chosen], self.next[chosen]
