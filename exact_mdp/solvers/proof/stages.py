"""The order in which the states of a model are solved exactly, a stage after the other.

States are taken in the order in which they depend on each other, one stage after the other. Those
that depend on each other are the strongly connected components of the graph, waiting in place
aside; a larger one, a cycle, makes a stage of its own. The single states between two cycles are
taken one by one, a chain. Where rows are long, products of integer matrices are faster: then all
single states of a level (the greatest number of steps to the end), or of a run of consecutive
states that do not lead to each other, make one stage, unless these are narrow.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.mdp.graph import components_in_order
from exact_mdp.mdp.table import Integers, Numbers
from exact_mdp.solvers.bounds.layers import layers

RUN = 4  # states in a run or level, on average, for these to be used
LONG = 10  # transitions of a state, on average, for products of matrices to pay


class Kind(Enum):
    """How the states of a stage depend on each other."""

    APART = "not at all"
    CHAIN = "each on those before"
    CYCLE = "all on all"


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage:
    """States (K,) that are settled in one go."""

    states: Integers
    kind: Kind


def stages(rows: BellmanRows) -> Iterator[Stage]:
    """Return the stages of a model in the order of solution, terminal states left out."""
    states = len(rows.scale)
    live = np.flatnonzero(~rows.terminal)
    if not len(live):
        return
    source = np.repeat(np.arange(states), np.diff(rows.offsets[rows.pair_offsets]))
    moving = rows.next != source
    long = len(rows.next) > LONG * states
    if (rows.next[moving] > source[moving]).all():
        runs = _runs(states, source[moving], rows.next[moving]) if long else []
        if 0 < RUN * len(runs) < states:
            for first, last in runs:
                run = np.arange(first, last)[~rows.terminal[first:last]]
                if len(run):
                    yield Stage(states=run, kind=Kind.APART)
        else:
            yield Stage(states=live[::-1], kind=Kind.CHAIN)
        return
    ones, begins = np.ones(len(rows.next), dtype=np.int8), rows.offsets[rows.pair_offsets]
    label = components_in_order(sp.csr_array((ones, rows.next, begins), (states, states)))
    level = layers(source, rows.next, label, least=RUN) if long else None
    cyclic = np.bincount(label)[label] > 1
    group = np.where(cyclic, label + 1, 0)
    key = label if level is None else level
    order = live[np.lexsort((group[live], key[live]))]
    fresh = np.diff(group[order]) != 0
    if level is not None:
        fresh |= np.diff(level[order]) != 0
    single = Kind.CHAIN if level is None else Kind.APART
    for first, last in pairwise([0, *(np.flatnonzero(fresh) + 1).tolist(), len(order)]):
        kind = Kind.CYCLE if cyclic[order[first]] else single
        yield Stage(states=order[first:last], kind=kind)


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
