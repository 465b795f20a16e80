"""In which order to settle the states of a model: those first that others depend on.

The states that depend on each other are the strongly connected components of the graph, waiting in
place aside. Components are taken by level, the greatest number of steps to one without successors:
all single states of a level make one stage, every larger component makes one of its own. Where all
transitions lead to higher numbers, runs of consecutive states that do not lead to each other are
found faster than levels, and do as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from mdp.bellman import BellmanRows
from mdp.chain import spans
from mdp.table import Integers, Numbers

RUN = 4  # states in a run, on average, for runs to be used


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage:
    """States (K,) that are settled together; `cyclic` where they depend on each other."""

    states: Integers
    cyclic: bool


def stages(rows: BellmanRows) -> Iterator[Stage]:
    """Return the stages of a model in the order of solution, terminal states left out.

    Examples
    --------
    >>> from mdp import MDP
    >>> from mdp.bellman import bellman_rows
    >>> round_trip = [[[0, 1, 0], ["1/2", 0, "1/2"], [0, 0, 1]]]
    >>> mdp = MDP.from_arrays(round_trip, [1, 0, 1], discount="1/2")
    >>> [(stage.states.tolist(), stage.cyclic) for stage in stages(bellman_rows(mdp))]
    [([2], False), ([0, 1], True)]
    """
    from scipy.sparse.csgraph import connected_components

    states = len(rows.scale)
    offsets = rows.offsets[rows.pair_offsets]
    source = np.repeat(np.arange(states), np.diff(offsets))
    moving = rows.next != source
    if (rows.next[moving] > source[moving]).all():
        runs = _runs(states, source[moving], rows.next[moving])
        if RUN * len(runs) < states:
            for first, last in runs:
                run = np.arange(first, last)[~rows.terminal[first:last]]
                if len(run):
                    yield Stage(states=run, cyclic=False)
            return
    ones = np.ones(len(rows.next), dtype=np.int8)
    graph = sp.csr_array((ones, rows.next, offsets), (states, states))
    count, label = connected_components(graph, directed=True, connection="strong")
    size = np.bincount(label, minlength=count)
    level = _levels(label[source], label[rows.next], count)[label]
    cyclic = size[label] > 1
    group = np.where(cyclic, label + 1, 0)
    order = np.lexsort((group, level))
    order = order[~rows.terminal[order]]
    if not len(order):
        return
    fresh = (np.diff(level[order]) != 0) | (np.diff(group[order]) != 0)
    for part in np.split(order, np.flatnonzero(fresh) + 1):
        yield Stage(states=part, cyclic=bool(cyclic[part[0]]))


def _runs(states: int, source: Numbers, target: Numbers) -> list[tuple[int, int]]:
    """Return runs of states, last ones first, that lead out of their run, to higher numbers."""
    least = np.full(states, states)
    first = np.flatnonzero(np.diff(source, prepend=-1))
    if len(first):
        least[source[first]] = np.minimum.reduceat(target, first)
    runs, end = [], states
    for state, lowest in zip(range(states - 1, -1, -1), reversed(least.tolist()), strict=True):
        if lowest < end:
            runs.append((state + 1, end))
            end = state + 1
    return [*runs, (0, end)]


def _levels(source: Numbers, target: Numbers, count: int) -> Integers:
    """Return (count,) the greatest number of edges on a way out of each node, loops left out."""
    between = source != target
    source, target = source[between], target[between]
    waiting = np.bincount(source, minlength=count)
    by_target = np.argsort(target, kind="stable")
    before = np.searchsorted(target[by_target], np.arange(count + 1))
    predecessors = source[by_target]
    level = np.zeros(count, dtype=np.int64)
    frontier, reached = np.flatnonzero(waiting == 0), 0
    while len(frontier):
        reached += 1
        into, edges = np.unique(
            predecessors[spans(before[frontier], before[frontier + 1])], return_counts=True
        )
        waiting[into] -= edges
        frontier = into[waiting[into] == 0]
        level[frontier] = reached
    return level
