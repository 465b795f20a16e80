"""Layers of a directed graph: nodes on a common cycle count as one, and edges lead to lower layers.

The layer of a node is the greatest number of edges on a way out of its strongly connected
component, those inside components left out.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp import graph as graphs
from exact_mdp.mdp.table import Integers, Numbers, spans

FIRST = 16  # layers that may be narrow


def strong_components(source: Numbers, target: Numbers, count: int) -> Integers:
    """Return the component (count,) of each node, from edges (M,), numbered by their first nodes.

    Examples
    --------
    >>> strong_components(np.array([0, 1, 2]), np.array([1, 2, 1]), 3).tolist()
    [0, 1, 1]
    """
    graph = sp.csr_array((np.ones(len(source)), (source, target)), (count, count))
    return graphs.strong_components(graph)


def layers(source: Numbers, target: Numbers, label: Integers, *, least: int = 0) -> Integers | None:
    """Return the layer (count,) of each node, from edges (M,) between them and their components.

    None where layers above the last one have fewer than `least` components on average.

    Examples
    --------
    >>> source, target = np.array([0, 1, 2]), np.array([1, 2, 1])
    >>> layers(source, target, strong_components(source, target, 3)).tolist()
    [1, 0, 0]
    """
    parts = int(label.max(initial=-1)) + 1
    here, there = label[source], label[target]
    apart = here != there
    here, there = here[apart], there[apart]
    waiting = np.bincount(here, minlength=parts)
    by_target = np.argsort(there, kind="stable")
    before = np.searchsorted(there[by_target], np.arange(parts + 1))
    predecessors = here[by_target]
    level = np.zeros(parts, dtype=np.int64)
    frontier, reached, settled = np.flatnonzero(waiting == 0), 0, 0
    while len(frontier):
        reached += 1
        into = predecessors[spans(before[frontier], before[frontier + 1])]
        into, times = np.unique(into, return_counts=True)
        waiting[into] -= times
        frontier = into[waiting[into] == 0]
        level[frontier] = reached
        settled += len(frontier)
        if settled < least * (reached - FIRST):
            return None
    return np.asarray(level[label])
