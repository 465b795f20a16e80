"""The merged model of finite values: what is left out of it, and policies brought back from it.

What is left once the structure of a model is known (`solvers.endless.structure`) is a model of
finite values, its rests merged. Its end components all lose. Policy iteration in floats, from a
policy that ends, tells which pairs in them lose clearly; without these every policy ends.

A policy attains the values if it takes best pairs of the merged model, and moves inside a rest to
where it leaves: never a pair just because it keeps the value of a state, which staying for ever
would not earn.
"""

from __future__ import annotations

import numpy as np

from exact_mdp.mdp.graph import termination
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.gains import gains, greedy
from exact_mdp.solvers.dynamic.iterate import evaluated
from exact_mdp.solvers.endless.derived import Derived
from exact_mdp.solvers.endless.graph import Graph, Mask
from exact_mdp.solvers.endless.structure import Structure
from exact_mdp.solvers.solution import SolverError, Status

LIMIT = 1000  # policies
CLEAR = 16  # times what rounding may make of nothing
COARSER = 16  # between one limit of a clear loss and the next


def without_losing(whole: Derived) -> Derived:
    """Return a model in which every policy ends: without pairs that lose clearly by going round."""
    mdp = whole.mdp
    if termination(mdp).proven:
        return whole
    graph, every = Graph.of(mdp), np.ones(mdp.n_pairs, dtype=bool)
    pairs = ending_policy(graph, mdp.terminal)
    for _ in range(LIMIT):
        gain = gains(mdp, evaluated(mdp, pairs))
        before, pairs = pairs, greedy(mdp, gain, keep=pairs)
        if (pairs == before).all():
            break
    _, inside = graph.end_components(~mdp.terminal[mdp.pair_state])
    losing = inside & (gain.value < -CLEAR * gain.noise)
    losing[pairs] = False
    # In every component some pair loses as much as staying does on average: the fewer are left out,
    # and the more they lose, the better the values may bear it out.
    least = float(gain.value.min())
    while losing.any():
        part = whole.only(np.flatnonzero(every & ~(losing & (gain.value <= least / COARSER))))
        if termination(part.mdp).proven:
            return part
        if not (losing & (gain.value > least / COARSER)).any():
            break
        least /= COARSER
    raise SolverError(Status.NO_BOUND, "staying for ever loses too little a step")


def ending_policy(graph: Graph, ends: Mask) -> Integers:
    """Return pairs (S,) that may each lead a step nearer to the end."""
    every = np.ones(len(graph.pair_state), dtype=bool)
    pairs = graph.pair_offsets[:-1].copy()
    toward(graph, graph.distance(ends, every), every, pairs)
    return pairs


def toward(graph: Graph, distance: Integers, pairs: Mask, chosen: Integers) -> None:
    """Write into `chosen` (S,) one of some pairs (L,) that may fall, where the distance is > 0."""
    far = np.where(distance < 0, graph.states, distance)
    falls = np.minimum.reduceat(far[graph.next], graph.offsets[:-1]) < far[graph.pair_state]
    falling = np.flatnonzero(falls & pairs & (distance > 0)[graph.pair_state])
    states, first = np.unique(graph.pair_state[falling], return_index=True)
    chosen[states] = falling[first]


def lifted(parts: Structure, whole: Derived, chosen: Integers) -> Integers:
    """Return the pairs (S,) of the model for the sources `chosen` (S',) in the merged one."""
    graph, mdp, rest = parts.graph, parts.mdp, parts.rest
    pairs, target = mdp.pair_offsets[:-1].copy(), parts.over & (parts.sign == 0)
    taken = chosen[whole.label]  # of each state's merged one
    leaves = (taken >= 0) & (taken < mdp.n_pairs)
    plain = (parts.sign == 0) & leaves & (rest < 0)
    pairs[plain] = taken[plain]
    staying = parts.inside & ((rest >= 0) & ~leaves)[mdp.pair_state]
    _first(mdp, np.flatnonzero(staying), pairs)
    target |= graph.having(staying)
    ways = taken[(rest >= 0) & leaves]
    pairs[mdp.pair_state[ways]] = ways
    target[mdp.pair_state[ways]] = True
    toward(graph, graph.distance(target, parts.inside), parts.inside, pairs)
    every = np.ones(mdp.n_pairs, dtype=bool)
    if parts.missing.any():
        _first(mdp, np.flatnonzero(graph.every(parts.missing)), pairs)
        toward(graph, graph.distance(parts.missing, every), every, pairs)
    elif len(parts.core):
        states, best = parts.components.gaining(parts.core)
        pairs[states] = best
        above = np.zeros(mdp.n_states, dtype=bool)
        above[states] = True
        safe = graph.every(parts.sign >= 0)
        toward(graph, graph.distance(above, safe), safe & (parts.sign > 0)[mdp.pair_state], pairs)
    return pairs


def _first(mdp: MDP, some: Integers, pairs: Integers) -> None:
    """Write into `pairs` (S,) the first of `some` pairs of each state that has one."""
    states, first = np.unique(mdp.pair_state[some], return_index=True)
    pairs[states] = some[first]
