"""Graphs: what can be reached, and components: strongly connected ones and end components.

The graph of a model has an edge from each state to every state that one of its pairs may lead to.
All work on it is linear in the number of transitions, with the algorithms of SciPy and a
breadth-first search (Cormen et al., Introduction to Algorithms, 2009, sections 22.2 and 22.5).

In the graph of the pairs, an end component is a set of states with pairs that never leave it and
connect all of it. Under any policy, the states and pairs used forever form an end component with
probability 1 (de Alfaro, Formal Verification of Probabilistic Systems, 1997, sections 3.1 to 3.3;
Baier and Katoen, Principles of Model Checking, 2008, section 10.6). Maximal end components are
found by alternately removing states that cannot stay and splitting into strongly connected
components.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property
from itertools import count
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csgraph

from exact_mdp.mdp.table import COMPILED, Integers, Numbers, OutcomeTable, concatenate_ranges

Mask = NDArray[np.bool_]


class Transitions(Protocol):
    """The parts of a model that graphs are made of: an `MDP`, or its `Ends`."""

    @property
    def table(self) -> OutcomeTable:
        """The exact outcomes of every pair."""

    @property
    def transition(self) -> sp.csr_array:
        """(L, S) the probabilities of next states."""

    @property
    def pair_state(self) -> Integers:
        """(L,) the state of each pair."""

    @property
    def pair_offsets(self) -> Integers:
        """(S+1,) where the pairs of each state begin."""

    @property
    def start(self) -> tuple[tuple[int, Fraction], ...]:
        """The initial distribution, by state number."""


def find_reachable_states(
    mdp: Transitions, states: ArrayLike | None = None, pairs: ArrayLike | None = None
) -> Mask:
    """Return (S,) True for states that can be reached from `states` (K,), these included.

    By default they are the start. `pairs`, numbers or truth values, restricts the search to some
    pairs.
    """
    first = find_start_states(mdp)
    if states is not None:
        first = np.zeros_like(first)
        first[np.asarray(states, dtype=np.int64)] = True
    return find_reachable_nodes(_build_edges(mdp, pairs), first)


def find_start_states(mdp: Transitions) -> Mask:
    """Return (S,) True for the states in which a run may begin."""
    first = np.zeros(len(mdp.pair_offsets) - 1, dtype=bool)
    first[[state for state, weight in mdp.start if weight]] = True
    return first


def label_components(mdp: Transitions) -> tuple[int, Integers]:
    """Return the number of strongly connected components, and the component (S,) of each state."""
    labels = strong_components(_build_edges(mdp))
    return int(labels.max()) + 1, labels


def strong_components(graph: sp.csr_array) -> Integers:
    """Return the component (K,) of each node of a graph (K, K), numbered by their first nodes."""
    label = components_in_order(graph)
    node, first = np.arange(len(label)), np.empty(int(label.max(initial=-1)) + 1, dtype=np.int64)
    first[label[::-1]] = node[::-1]
    return (np.cumsum(first[label] == node) - 1)[first[label]]


def components_in_order(graph: sp.csr_array) -> Integers:
    """Return the component (K,) of each node of a graph (K, K); no edge leads to a higher number.

    So components in rising order are a reverse topological order.
    """
    # SciPy 1.18 and later need contiguous arrays, and a model's columns may be a strided view.
    columns, rows = map(np.ascontiguousarray, (graph.indices, graph.indptr))
    packed = sp.csr_array((graph.data, columns, rows), graph.shape)
    _, label = csgraph.connected_components(packed, directed=True, connection="strong")
    if (np.repeat(label, np.diff(graph.indptr)) < label[graph.indices]).any():
        raise RuntimeError("strongly connected components are not numbered from the last one")
    return np.asarray(label, dtype=np.int64)


def longest_ways(graph: sp.csr_array) -> tuple[Integers, Integers]:
    """Return the component (K,) of each node, and the length (K,) of the longest path from it.

    All nodes of a strongly connected component count as one.
    """
    # Contract each component to a node; the edges between components have no cycle.
    label = components_in_order(graph)
    count = int(label.max(initial=-1)) + 1
    if count == 1:
        return label, np.zeros_like(label)
    starts, ends = graph.tocoo().coords
    here, there = label[starts], label[ends]
    apart = here != there
    edges = sp.csr_array((np.ones(apart.sum()), (here[apart], there[apart])), (count, count))
    return label, _rank_nodes(edges, np.diff(edges.indptr) == 0)[label]


def _rank_nodes(edges: sp.csr_array, ended: Mask) -> Integers:
    """Return the rank (K,) of each node: one more than the last of its successors'; -1 in cycles.

    The `ended` nodes have rank 0. Equal edges of the graph (K, K) are merged.
    """
    edges.sum_duplicates()
    needed = np.diff(edges.indptr)
    owner = np.repeat(np.arange(len(ended)), needed)
    backward = Backward.of(np.arange(edges.nnz + 1), edges.indices, owner, len(ended))
    return backward.rank_states(ended, ~ended[owner], needed)[0]


def find_reachable_nodes(graph: sp.csr_array, first: Mask) -> Mask:
    """Return (K,) True for nodes that can be reached from the nodes in `first` (K,)."""
    # An extra node with edges to all first nodes makes this a single search.
    indices, size = np.concatenate([graph.indices, np.flatnonzero(first)]), len(first) + 1
    offsets = np.append(graph.indptr, len(indices))
    more = sp.csr_array((np.ones(len(indices)), indices, offsets), (size, size))
    reached = np.zeros(size, dtype=bool)
    reached[csgraph.breadth_first_order(more, size - 1, return_predecessors=False)] = True
    return reached[:-1]


def rank_acyclic_states(offsets: Numbers, following: Numbers, ended: Mask) -> Integers | None:
    """Return (S,) the greatest number of steps to an end; None if there is a cycle.

    State s leads to following[offsets[s]:offsets[s+1]], in which states may be repeated.
    """
    if not ended.any():
        return None
    # Without cycles, some state leads to ends only. Most models with cycles have no such state,
    # which is quickly seen.
    last = np.logical_and.reduceat(ended[following], offsets[:-1]) & ~ended
    if not last.any() and not ended.all():
        return None
    # Rank states backward, each when all of its successors are ranked.
    size = len(ended)
    edges = sp.csr_array((np.ones(len(following), np.int8), following, offsets), (size, size))
    level = _rank_nodes(edges.copy(), ended)
    if (level < 0).any():
        return None
    return level


@dataclass(frozen=True, eq=False)
class Backward:
    """The graph of pairs in reverse: into[before[s]:before[s+1]] are the pairs that may lead to s.

    `owner` (L,) is the state of each pair.
    """

    before: Numbers
    into: Numbers
    owner: Integers

    @classmethod
    def of(cls, offsets: Numbers, following: Numbers, owner: Integers, states: int) -> Backward:
        """Reverse the edges: pair l leads to following[offsets[l]:offsets[l+1]]."""
        ones, shape = np.ones(len(following), dtype=np.int8), (len(offsets) - 1, states)
        reverse = sp.csr_array((ones, following, offsets), shape).tocsc()
        return cls(reverse.indptr, reverse.indices, owner)

    def rank_states(self, first: Mask, pairs: Mask, needed: Integers) -> tuple[Integers, Mask]:
        """Return the rank (S,) of each state, or -1, and (L,) True for `pairs` that remain.

        The `first` states have rank 0. Another state gets its rank as soon as `needed` (S,) of its
        `pairs` (L,) may lead to ranked states: one more than the last of these ranks.
        """
        # Breadth-first search from the first states, against the direction of the edges.
        rank, left, needed = np.where(first, 0, -1), pairs.copy(), needed.copy()
        queue, start = np.empty_like(rank), np.flatnonzero(first)
        queue[: len(start)] = start
        parts = (self.before, self.into, self.owner, left, needed, rank, queue)
        if len(self.into) >= COMPILED:
            _compile_peeling()(*parts, len(start))
            return rank, left
        # Python loops over lists much faster than over arrays.
        lists: list[Any] = [*(part.tolist() for part in parts), len(start)]
        peel_states(*lists)
        return np.array(lists[5], dtype=np.int64), np.array(lists[3], dtype=bool)


def peel_states(
    before: Any, into: Any, owner: Any, left: Any, needed: Any, rank: Any, queue: Any, filled: int
) -> None:
    """Rank the states by a breadth-first search; see `Backward.rank_states`.

    The queue begins with `filled` states. For large models this function is compiled.
    """
    head = 0
    while head < filled:
        state = queue[head]
        head += 1
        for i in range(before[state], before[state + 1]):
            pair = into[i]
            # A pair counts once, for the first of its successors that is ranked.
            if left[pair]:
                left[pair] = False
                own = owner[pair]
                needed[own] -= 1
                if needed[own] <= 0 and rank[own] < 0:
                    rank[own] = rank[state] + 1
                    queue[filled] = own
                    filled += 1


@cache
def _compile_peeling() -> Any:
    """Return `peel_states` compiled for arrays."""
    from exact_mdp.mdp.forms import compiling

    return compiling.compile_loop(peel_states)


def _build_edges(mdp: Transitions, pairs: ArrayLike | None = None) -> sp.csr_array:
    """Return the (S, S) edges from each state to its successors, under some pairs or all.

    `pairs` are numbers, or truth values (L,).
    """
    matrix, offsets = mdp.transition, mdp.pair_offsets
    states = len(offsets) - 1
    if pairs is not None:
        chosen: Numbers = np.asarray(pairs)
        if chosen.dtype == bool:
            chosen = np.flatnonzero(chosen)
        else:
            chosen = np.unique(chosen.astype(np.int64))
        # Without all pairs, the edges of a state are the rows of its chosen pairs.
        if len(chosen) < len(mdp.pair_state):
            counts = np.bincount(mdp.pair_state[chosen], minlength=states)
            matrix, offsets = matrix[chosen], np.concatenate([[0], np.cumsum(counts)])
    # The rows of a state's pairs are adjacent, so together they are the row of the state.
    ones = np.ones(len(matrix.indices), dtype=np.int8)
    return sp.csr_array((ones, matrix.indices, matrix.indptr[offsets]), (states, states))


def find_least_successors(mdp: Transitions) -> Numbers:
    """Return (S,) the lowest successor of each state."""
    matrix = mdp.transition
    # The successors of a pair are sorted, so the first one is the lowest.
    return np.minimum.reduceat(matrix.indices[matrix.indptr[:-1]], mdp.pair_offsets[:-1])


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
