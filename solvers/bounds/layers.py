"""Layers of a directed graph: nodes on a common cycle count as one, and edges lead to lower layers.

The layer of a node is the greatest number of edges on a way out of its strongly connected
component, those inside components left out.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.table import Integers, Numbers, spans

csgraph = later("scipy.sparse.csgraph")


def layers(source: Numbers, target: Numbers, count: int) -> tuple[Integers, Integers]:
    """Return the layer and the component (count,) of each node, from edges (M,) between them.

    Examples
    --------
    >>> layer, component = layers(np.array([0, 1, 2]), np.array([1, 2, 1]), 3)
    >>> layer.tolist(), bool(component[1] == component[2])
    ([1, 0, 0], True)
    """
    graph = sp.csr_array((np.ones(len(source)), (source, target)), (count, count))
    _, label = csgraph.connected_components(graph, directed=True, connection="strong")
    # Of several edges between two nodes, the matrix has kept one.
    here = np.repeat(label, np.diff(graph.indptr))
    there = label[graph.indices]
    apart = here != there
    here, there = here[apart], there[apart]
    parts = int(label.max(initial=-1)) + 1
    waiting = np.bincount(here, minlength=parts)
    by_target = np.argsort(there, kind="stable")
    before = np.searchsorted(there[by_target], np.arange(parts + 1))
    predecessors = here[by_target]
    level = np.zeros(parts, dtype=np.int64)
    frontier, reached = np.flatnonzero(waiting == 0), 0
    while len(frontier):
        reached += 1
        into = predecessors[spans(before[frontier], before[frontier + 1])]
        into, edges = np.unique(into, return_counts=True)
        waiting[into] -= edges
        frontier = into[waiting[into] == 0]
        level[frontier] = reached
    return level[label], label.astype(np.int64)
