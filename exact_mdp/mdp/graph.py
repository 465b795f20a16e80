"""The graph of a model: reachability, order of states, and a proof that every policy ends.

Every policy ends, that is, reaches a terminal state with probability 1 from every state, if and
only if no set of other states exists in which some policy can stay forever. To find the greatest
such set, remove a state as soon as each of its pairs has a successor that was removed before, and
begin with the terminal states. The states that are never removed are this set, and the round in
which a state is removed is its rank:

    terminal states have rank 0; EVERY pair of another state reaches a smaller rank in one step

with positive probability, which can be checked pair by pair and proves termination (proper
policies: Bertsekas and Tsitsiklis, Mathematics of Operations Research 16, 1991; end components: de
Alfaro, Formal Verification of Probabilistic Systems, 1997, section 3.3). All work is linear in the
number of transitions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csgraph

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP, cache_on_model
from exact_mdp.mdp.table import COMPILED, Integers, Numbers

Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Termination:
    """A proof that every policy ends, or a policy that does not.

    `rank` (S,) is the proof; it is -1 in states in which a policy can stay forever. `policy` (S,)
    has the action numbers of a policy that never leaves the `trapped` states (K,).
    """

    proven: bool
    rank: Integers
    policy: Integers | None
    trapped: Integers


def find_reachable_states(
    mdp: MDP, states: ArrayLike | None = None, pairs: ArrayLike | None = None
) -> Mask:
    """Return (S,) True for states that can be reached from `states` (K,), these included.

    By default they are the start. `pairs`, numbers or truth values, restricts the search to some
    pairs.
    """
    first = states
    if first is None:
        first = [state for state, weight in mdp.start if weight]
    begin = np.zeros(mdp.n_states, dtype=bool)
    begin[np.asarray(first, dtype=np.int64)] = True
    return find_reachable_nodes(_build_edges(mdp, pairs), begin)


def label_components(mdp: MDP) -> tuple[int, Integers]:
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
    edges.sum_duplicates()
    # A component is ranked when all of its successors are: one more than the last of them.
    waiting = np.diff(edges.indptr)
    owner, every = np.repeat(np.arange(count), waiting), np.ones(edges.nnz, dtype=bool)
    backward = Backward.of(np.arange(edges.nnz + 1), edges.indices, owner, count)
    return label, backward.rank_states(waiting == 0, every, waiting)[0][label]


def find_reachable_nodes(graph: sp.csr_array, first: Mask) -> Mask:
    """Return (K,) True for nodes that can be reached from the nodes in `first` (K,)."""
    # An extra node with edges to all first nodes makes this a single search.
    indices, size = np.concatenate([graph.indices, np.flatnonzero(first)]), len(first) + 1
    offsets = np.append(graph.indptr, len(indices))
    more = sp.csr_array((np.ones(len(indices)), indices, offsets), (size, size))
    reached = np.zeros(size, dtype=bool)
    reached[csgraph.breadth_first_order(more, size - 1, return_predecessors=False)] = True
    return reached[:-1]


@cache_on_model
def numbered_in_order(mdp: MDP) -> bool:
    """Return whether every transition from a nonterminal state leads to a higher number."""
    first = int(mdp.transition.indices[0])  # most models without this order show it here
    if (first <= 0 and not mdp.terminal[0]) or not mdp.terminal[-1]:
        return False
    return bool((_least_successor(mdp) > np.arange(mdp.n_states)).all())


def is_acyclic(mdp: MDP) -> bool:
    """Return whether no nonterminal state can come back to itself."""
    return numbered_in_order(mdp) or topological_levels(mdp) is not None


@cache_on_model
def topological_levels(mdp: MDP) -> Integers | None:
    """Return (S,) the greatest number of steps to a terminal state; None if there is a cycle."""
    edges = _build_edges(mdp)
    return rank_acyclic_states(edges.indptr, edges.indices, mdp.terminal)


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
    edges = edges.copy()
    edges.sum_duplicates()
    steps, each = np.diff(edges.indptr), np.arange(len(edges.indices) + 1)
    owner = np.repeat(np.arange(size), steps)
    backward = Backward.of(each, edges.indices, owner, size)
    level, _ = backward.rank_states(ended, ~ended[owner], steps)
    if (level < 0).any():
        return None
    return level


@cache_on_model
def prove_termination(mdp: MDP) -> Termination:
    """Return a proof that every policy ends, or a policy that never ends from some states."""
    # If all transitions go up, the numbers in reverse are ranks.
    if numbered_in_order(mdp):
        rank = np.where(mdp.terminal, 0, np.arange(mdp.n_states)[::-1])
        return Termination(proven=True, rank=rank, policy=None, trapped=rank[:0])
    # Otherwise remove states backward from the terminal ones, each when all its pairs can leave.
    matrix = mdp.transition
    backward = Backward.of(matrix.indptr, matrix.indices, mdp.pair_state, mdp.n_states)
    every = np.ones(mdp.n_pairs, dtype=bool)
    rank, staying = backward.rank_states(mdp.terminal, every, np.diff(mdp.pair_offsets))
    trapped = np.flatnonzero(rank < 0)
    if not len(trapped):
        return Termination(proven=True, rank=rank, policy=None, trapped=trapped)
    # The counterexample takes in each trapped state its first pair that stays among them.
    chosen = mdp.pair_offsets[:-1].copy()
    first = np.where(staying, np.arange(mdp.n_pairs), mdp.n_pairs)
    chosen[trapped] = np.minimum.reduceat(first, mdp.pair_offsets[:-1])[trapped]
    return Termination(proven=False, rank=rank, policy=mdp.pair_action[chosen], trapped=trapped)


def has_improper_policy(mdp: MDP) -> bool:
    """Return whether the discount is 1 and some policy never ends, or ends outside the goal."""
    if mdp.discount_exact != 1:
        return False
    return bool(find_ends_outside_goal(mdp).any()) or not prove_termination(mdp).proven


def find_ends_outside_goal(mdp: MDP) -> Mask:
    """Return (S,) True for terminal states outside the goal; all False without a goal.

    A run that ends there has missed the goal: its value is `unreached` instead of 0.
    """
    if mdp.goal is None:
        return np.zeros(mdp.n_states, dtype=bool)
    return np.asarray(mdp.terminal & ~mdp.goal)


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

    def rank_states(self, first: Mask, pairs: Mask, waiting: Integers) -> tuple[Integers, Mask]:
        """Return the rank (S,) of each state, or -1, and (L,) True for `pairs` that remain.

        The `first` states have rank 0. Another state gets its rank as soon as `waiting` (S,) of its
        `pairs` (L,) may lead to ranked states: one more than the last of these ranks.
        """
        # Breadth-first search from the first states, against the direction of the edges.
        rank, left, waiting = np.where(first, 0, -1), pairs.copy(), waiting.copy()
        queue, start = np.empty_like(rank), np.flatnonzero(first)
        queue[: len(start)] = start
        parts = (self.before, self.into, self.owner, left, waiting, rank, queue)
        if len(self.into) >= COMPILED:
            _compile_peeling()(*parts, len(start))
            return rank, left
        # Python loops over lists much faster than over arrays.
        lists: list[Any] = [*(part.tolist() for part in parts), len(start)]
        peel_states(*lists)
        return np.array(lists[5], dtype=np.int64), np.array(lists[3], dtype=bool)


def peel_states(
    before: Any, into: Any, owner: Any, left: Any, waiting: Any, rank: Any, queue: Any, filled: int
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
                waiting[own] -= 1
                if waiting[own] <= 0 and rank[own] < 0:
                    rank[own] = rank[state] + 1
                    queue[filled] = own
                    filled += 1


@cache
def _compile_peeling() -> Any:
    """Return `peel_states` compiled for arrays."""
    from exact_mdp.mdp.forms import compiling

    return compiling.compile_loop(peel_states)


def where_endless(mdp: MDP) -> str:
    """Return in words where a policy can stay forever, or end outside the goal."""
    ending = prove_termination(mdp)
    labels = mdp.space.labels
    if ending.policy is None:
        states = np.flatnonzero(mdp.terminal)
        if mdp.goal is not None:
            states = np.flatnonzero(find_ends_outside_goal(mdp))
        before = "it ends outside the goal in "
        named = [f"({label})" for label in labels(states[:4])]
    else:
        states, before = ending.trapped, "it stays forever in "
        named = []
        for state, label in zip(states[:4], labels(states[:4]), strict=True):
            named.append(f"({label}) with action {mdp.actions[ending.policy[state]]}")
    text = before + ", ".join(named)
    more = len(states) - len(named)
    if more:
        text += f" and {more} more"
    return text


def ways_out(mdp: MDP, *others: str) -> str:
    """Return advice, with `others` at the end, for a total that is infinite or has no limit.

    In a model with a goal a horizon does not help: a run that misses it has an infinite value then,
    too.
    """
    steps = mdp.time_limit or "N"
    ways = ["choose a discount below 1 (--discount 0.95, mdp.with_(discount=0.95))"]
    if mdp.goal is None:
        ways.append(f"stop after {steps} steps (--horizon {steps}, mdp.within({steps}))")
    ways += others
    if len(ways) == 1:
        return ways[0]
    return f"{', '.join(ways[:-1])}, or {ways[-1]}"


def other_question(mdp: MDP) -> str:
    """Return advice to ask for something else than a total; a goal has no reward per step."""
    if mdp.goal is None:
        return 'ask for the reward per step (--criterion average, criterion="average")'
    return "ask for the chance of getting there (--reach LABEL, mdp.reaching(label))"


def require_termination(mdp: MDP) -> None:
    """Raise ModelError unless γ < 1 or every policy ends, in the goal if there is one."""
    if not has_improper_policy(mdp):
        return
    ways = ["for the optimum of all policies use solve(mdp) or certify(mdp)"]
    if prove_termination(mdp).proven:
        said = "a run that ends outside the goal is worth infinity, and some policy has such a run"
    else:
        said = "discount 1 needs every policy to end, and some policy does not"
        ways.append("add a way out: a terminal state stays put and earns 0")
    raise ModelError(said, where=where_endless(mdp), fix=ways_out(mdp, *ways))


def _build_edges(mdp: MDP, pairs: ArrayLike | None = None) -> sp.csr_array:
    """Return the (S, S) edges from each state to its successors, under some pairs or all.

    `pairs` are numbers, or truth values (L,).
    """
    matrix, offsets = mdp.transition, mdp.pair_offsets
    if pairs is not None:
        chosen: Numbers = np.asarray(pairs)
        if chosen.dtype == bool:
            chosen = np.flatnonzero(chosen)
        else:
            chosen = np.unique(chosen.astype(np.int64))
        # Without all pairs, the edges of a state are the rows of its chosen pairs.
        if len(chosen) < mdp.n_pairs:
            counts = np.bincount(mdp.pair_state[chosen], minlength=mdp.n_states)
            matrix, offsets = matrix[chosen], np.concatenate([[0], np.cumsum(counts)])
    # The rows of a state's pairs are adjacent, so together they are the row of the state.
    ones, shape = np.ones(len(matrix.indices), dtype=np.int8), (mdp.n_states, mdp.n_states)
    return sp.csr_array((ones, matrix.indices, matrix.indptr[offsets]), shape)


def _least_successor(mdp: MDP) -> Numbers:
    """Return (S,) the lowest successor of each state, or S if the state is terminal."""
    matrix = mdp.transition
    # The successors of a pair are sorted, so the first one is the lowest.
    lowest = np.minimum.reduceat(matrix.indices[matrix.indptr[:-1]], mdp.pair_offsets[:-1])
    return np.where(mdp.terminal, mdp.n_states, lowest)


@cache_on_model
def runs_in_order(mdp: MDP) -> Integers:
    """Return the first states of runs whose states do not lead to each other; S comes last.

    Backward induction can update all states of a run at once.
    """
    # Go backward, and cut as soon as a state leads into the run that would contain it.
    least, ends = _least_successor(mdp).tolist(), mdp.terminal.tolist()
    cuts = [mdp.n_states]
    for state in range(mdp.n_states - 1, 0, -1):
        if least[state - 1] < cuts[-1] or ends[state] or ends[state - 1]:
            cuts.append(state)
    return np.array([0, *cuts[::-1]])
