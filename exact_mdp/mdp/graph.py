"""The graph of a model: who reaches whom, in what order, and a proof that every policy ends.

Every policy ends, that is reaches a terminal state with probability 1 from everywhere, exactly
where no set of other states can be stayed in for ever. The greatest such set is what remains when a
state is peeled off as soon as each of its pairs has a successor outside. The round of that is its
rank:

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
SHOWN = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Termination:
    """A proof that every policy ends, or a policy that need not.

    `rank` (S,) is the proof, -1 in states that can be stayed in for ever; `policy` (S,) the action
    numbers of a policy that stays among the `trapped` states (K,) once there.
    """

    proven: bool
    rank: Integers
    policy: Integers | None
    trapped: Integers


def find_reachable_states(
    mdp: MDP, states: ArrayLike | None = None, pairs: ArrayLike | None = None
) -> Mask:
    """Return (S,) True for states that can be reached, the first ones included.

    These are `states` (K,), by default the start; `pairs`, numbers or truth values, are the only
    ones to go along.
    """
    first = [state for state, weight in mdp.start if weight] if states is None else states
    begin = np.zeros(mdp.n_states, dtype=bool)
    begin[np.asarray(first, dtype=np.int64)] = True
    return find_reachable_nodes(_build_edges(mdp, pairs), begin)


def label_components(mdp: MDP) -> tuple[int, Integers]:
    """Return the number of strongly connected components, and each state's (S,)."""
    labels = strong_components(_build_edges(mdp))
    return int(labels.max()) + 1, labels


def strong_components(graph: sp.csr_array) -> Integers:
    """Return the component (K,) of each node of a graph (K, K), numbered by their first nodes."""
    label = components_in_order(graph)
    node, first = np.arange(len(label)), np.empty(int(label.max(initial=-1)) + 1, dtype=np.int64)
    first[label[::-1]] = node[::-1]
    return (np.cumsum(first[label] == node) - 1)[first[label]]


def components_in_order(graph: sp.csr_array) -> Integers:
    """Return the component (K,) of each node of a graph (K, K); no edge leads to a higher one."""
    # From 1.18 on SciPy reads memory as it lies, and a model's columns may be a strided view.
    columns, rows = map(np.ascontiguousarray, (graph.indices, graph.indptr))
    packed = sp.csr_array((graph.data, columns, rows), graph.shape)
    _, label = csgraph.connected_components(packed, directed=True, connection="strong")
    if (np.repeat(label, np.diff(graph.indptr)) < label[graph.indices]).any():
        raise RuntimeError("strongly connected components are not numbered from the last one")
    return np.asarray(label, dtype=np.int64)


def longest_ways(graph: sp.csr_array) -> tuple[Integers, Integers]:
    """Return the component (K,) of each node, and the most edges on a way from it (K,).

    Nodes on a common cycle, which make a component, count as one.
    """
    label = components_in_order(graph)
    here, there = (label[each] for each in graph.tocoo().coords)
    count, apart = int(label.max(initial=-1)) + 1, here != there
    edges = sp.csr_array((np.ones(apart.sum()), (here[apart], there[apart])), (count, count))
    edges.sum_duplicates()
    waiting = np.diff(edges.indptr)
    owner, every = np.repeat(np.arange(count), waiting), np.ones(edges.nnz, dtype=bool)
    backward = Backward.of(np.arange(edges.nnz + 1), edges.indices, owner, count)
    return label, backward.rank_states(waiting == 0, every, waiting)[0][label]


def find_reachable_nodes(graph: sp.csr_array, first: Mask) -> Mask:
    """Return (K,) True for nodes that can be reached from `first` (K,) along a graph's rows."""
    # One more node leads to all the first ones, so that a single search serves.
    indices, size = np.concatenate([graph.indices, np.flatnonzero(first)]), len(first) + 1
    offsets = np.append(graph.indptr, len(indices))
    more = sp.csr_array((np.ones(len(indices)), indices, offsets), (size, size))
    reached = np.zeros(size, dtype=bool)
    reached[csgraph.breadth_first_order(more, size - 1, return_predecessors=False)] = True
    return reached[:-1]


@cache_on_model
def numbered_in_order(mdp: MDP) -> bool:
    """Return whether every transition leads to a higher number, terminal states apart."""
    first = int(mdp.transition.indices[0])  # most others show it at once
    if (first <= 0 and not mdp.terminal[0]) or not mdp.terminal[-1]:
        return False
    return bool((_least_successor(mdp) > np.arange(mdp.n_states)).all())


def is_acyclic(mdp: MDP) -> bool:
    """Return whether no state can come back to itself, terminal states apart."""
    return numbered_in_order(mdp) or topological_levels(mdp) is not None


@cache_on_model
def topological_levels(mdp: MDP) -> Integers | None:
    """Return (S,) the greatest number of steps to a terminal state; None where there is a cycle."""
    if not mdp.terminal.any():
        return None
    edges = _build_edges(mdp)
    # Without cycles, some state leads to terminal states alone; most other models show at once
    # that they have none.
    last = np.logical_and.reduceat(mdp.terminal[edges.indices], edges.indptr[:-1]) & ~mdp.terminal
    if not last.any() and not mdp.terminal.all():
        return None
    edges = edges.copy()
    edges.sum_duplicates()
    steps, each = np.diff(edges.indptr), np.arange(len(edges.indices) + 1)
    owner = np.repeat(np.arange(mdp.n_states), steps)
    backward = Backward.of(each, edges.indices, owner, mdp.n_states)
    level, _ = backward.rank_states(mdp.terminal, ~mdp.terminal[owner], steps)
    return None if (level < 0).any() else level


@cache_on_model
def prove_termination(mdp: MDP) -> Termination:
    """Return a proof that every policy ends, or a policy that never does from some states."""
    if numbered_in_order(mdp):
        rank = np.where(mdp.terminal, 0, np.arange(mdp.n_states)[::-1])
        return Termination(proven=True, rank=rank, policy=None, trapped=rank[:0])
    matrix = mdp.transition
    backward = Backward.of(matrix.indptr, matrix.indices, mdp.pair_state, mdp.n_states)
    every = np.ones(mdp.n_pairs, dtype=bool)
    rank, staying = backward.rank_states(mdp.terminal, every, np.diff(mdp.pair_offsets))
    trapped = np.flatnonzero(rank < 0)
    if not len(trapped):
        return Termination(proven=True, rank=rank, policy=None, trapped=trapped)
    chosen = mdp.pair_offsets[:-1].copy()
    first = np.where(staying, np.arange(mdp.n_pairs), mdp.n_pairs)
    chosen[trapped] = np.minimum.reduceat(first, mdp.pair_offsets[:-1])[trapped]
    return Termination(proven=False, rank=rank, policy=mdp.pair_action[chosen], trapped=trapped)


def has_improper_policy(mdp: MDP) -> bool:
    """Return whether the discount is 1 and some policy never ends, or ends beside a goal."""
    if mdp.discount_exact != 1:
        return False
    return bool(beside_goal(mdp).any()) or not prove_termination(mdp).proven


def beside_goal(mdp: MDP) -> Mask:
    """Return (S,) True for terminal states that are not the goal of a model that has one.

    A run that ends there has missed the goal, and is worth `unreached` instead of 0.
    """
    if mdp.goal is None:
        return np.zeros(mdp.n_states, dtype=bool)
    return np.asarray(mdp.terminal & ~mdp.goal)


@dataclass(frozen=True, eq=False)
class Backward:
    """Pairs (L,) by where they may lead: to s those in into[before[s]:before[s+1]]."""

    before: Numbers
    into: Numbers
    owner: Integers

    @classmethod
    def of(cls, offsets: Numbers, following: Numbers, owner: Integers, states: int) -> Backward:
        """Turn pairs round, from the offsets (L+1,) of what follows each."""
        ones, shape = np.ones(len(following), dtype=np.int8), (len(offsets) - 1, states)
        reverse = sp.csr_array((ones, following, offsets), shape).tocsc()
        return cls(reverse.indptr, reverse.indices, owner)

    def rank_states(self, first: Mask, pairs: Mask, waiting: Integers) -> tuple[Integers, Mask]:
        """Return (S,) the round in which each joins the `first` ones, or -1; and (L,) pairs left.

        It joins once `waiting` (S,) of its `pairs` (L,) may lead to those before.
        """
        rank, left, waiting = np.where(first, 0, -1), pairs.copy(), waiting.copy()
        queue, start = np.empty_like(rank), np.flatnonzero(first)
        queue[: len(start)] = start
        parts = (self.before, self.into, self.owner, left, waiting, rank, queue)
        if len(self.into) >= COMPILED:
            _compile_peeling()(*parts, len(start))
            return rank, left
        lists: list[Any] = [*(part.tolist() for part in parts), len(start)]
        peel_states(*lists)
        return np.array(lists[5], dtype=np.int64), np.array(lists[3], dtype=bool)


def peel_states(
    before: Any, into: Any, owner: Any, left: Any, waiting: Any, rank: Any, queue: Any, filled: int
) -> None:
    """Write into `rank` when each state joins those in the queue, one round after the other.

    Lists are faster where there are few pairs; for many this is compiled.
    """
    head = 0
    while head < filled:
        state = queue[head]
        head += 1
        for i in range(before[state], before[state + 1]):
            pair = into[i]
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
    """Return `peel_states` for arrays."""
    from exact_mdp.mdp.forms import compiling

    return compiling.compile_loop(peel_states)


def where_endless(mdp: MDP) -> str:
    """Return where a policy of an endless model stays for ever, or ends beside the goal."""
    ending = prove_termination(mdp)
    if ending.policy is None:
        goal = np.zeros(mdp.n_states, dtype=bool) if mdp.goal is None else mdp.goal
        states, before = np.flatnonzero(mdp.terminal & ~goal), "it ends beside the goal in "
        named = [f"({mdp.space.label(state)})" for state in states[:SHOWN].tolist()]
    else:
        states, before = ending.trapped, "it stays for ever in "
        named = [
            f"({mdp.space.label(state)}) with action {mdp.actions[ending.policy[state]]}"
            for state in states[:SHOWN].tolist()
        ]
    more = len(states) - len(named)
    return before + ", ".join(named) + (f" and {more} more" if more else "")


def ways_out(mdp: MDP, *others: str) -> str:
    """Return what can be done, and `others`, where a total is infinite or has no limit.

    A run that misses a goal is worth infinity after N steps, too.
    """
    steps = mdp.time_limit or "N"
    ways = ["choose a discount below 1 (--discount 0.95, mdp.with_(discount=0.95))"]
    if mdp.goal is None:
        ways.append(f"stop after {steps} steps (--horizon {steps}, mdp.within({steps}))")
    *ways, last = [*ways, *others]
    return f"{', '.join(ways)}, or {last}" if ways else last


def other_question(mdp: MDP) -> str:
    """Return what can be asked instead of a total; a run to a goal has no reward per step."""
    if mdp.goal is None:
        return 'ask for the reward per step (--criterion average, criterion="average")'
    return "ask for the chance of getting there (--reach LABEL, mdp.reaching(label))"


def require_termination(mdp: MDP) -> None:
    """Raise ModelError unless γ < 1, or every policy ends and none of them beside a goal."""
    if not has_improper_policy(mdp):
        return
    ways = ["for the optimum of all policies use solve(mdp) or certify(mdp)"]
    if prove_termination(mdp).proven:
        said = "a run that ends beside the goal is worth infinity, and some policy has such a run"
    else:
        said = "discount 1 needs every policy to end, and one does not"
        ways.append("add a way out: a terminal state stays put and earns 0")
    raise ModelError(said, where=where_endless(mdp), fix=ways_out(mdp, *ways))


def _build_edges(mdp: MDP, pairs: ArrayLike | None = None) -> sp.csr_array:
    """Return the (S, S) edges from each state to its successors, pair after pair."""
    matrix, offsets = mdp.transition, mdp.pair_offsets
    chosen: Numbers = np.ones(mdp.n_pairs, dtype=bool) if pairs is None else np.asarray(pairs)
    mask = chosen.dtype == bool
    if not (mask and chosen.all()):
        chosen = np.flatnonzero(chosen) if mask else np.unique(chosen.astype(np.int64))
        counts = np.bincount(mdp.pair_state[chosen], minlength=mdp.n_states)
        matrix, offsets = matrix[chosen], np.concatenate([[0], np.cumsum(counts)])
    ones, shape = np.ones(len(matrix.indices), dtype=np.int8), (mdp.n_states, mdp.n_states)
    return sp.csr_array((ones, matrix.indices, matrix.indptr[offsets]), shape)


def _least_successor(mdp: MDP) -> Numbers:
    """Return (S,) the lowest successor of each state; S where the state is terminal."""
    matrix = mdp.transition
    # The successors of a pair are sorted: the first one is its lowest.
    lowest = np.minimum.reduceat(matrix.indices[matrix.indptr[:-1]], mdp.pair_offsets[:-1])
    return np.where(mdp.terminal, mdp.n_states, lowest)


@cache_on_model
def runs_in_order(mdp: MDP) -> Integers:
    """Return where runs of states begin that do not lead to each other; the last entry is S."""
    least, ends = _least_successor(mdp).tolist(), mdp.terminal.tolist()
    cuts = [mdp.n_states]
    for state in range(mdp.n_states - 1, 0, -1):
        if least[state - 1] < cuts[-1] or ends[state] or ends[state - 1]:
            cuts.append(state)
    return np.array([0, *cuts[::-1]])
