"""The merged model of finite values: what is left out of it, and policies brought back from it.

What is left once the structure of a model is known (`solvers.endless.structure`) is a model of
finite values, its rests merged. Its end components all lose. Policy iteration in floats, from a
policy that ends, tells which pairs in them lose clearly; without these every policy ends.

A policy attains the values if it takes best pairs of the merged model, moves inside a rest to where
it leaves, and stays only where staying is worth what it claims: never a pair just because it keeps
the value of a state, which staying for ever would not earn.
"""

from __future__ import annotations

import numpy as np

from exact_mdp.mdp.chain import termination
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.gains import gains, greedy
from exact_mdp.solvers.dynamic.known import evaluated
from exact_mdp.solvers.endless.derived import Derived
from exact_mdp.solvers.endless.graph import Graph, Mask
from exact_mdp.solvers.endless.structure import Structure
from exact_mdp.solvers.solution import SolverError, Status

LIMIT = 1000  # policies
CLEAR = 16  # times what rounding may make of nothing


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
    part = whole.only(np.flatnonzero(every & ~losing))
    if not termination(part.mdp).proven:
        raise SolverError(Status.NO_BOUND, "staying for ever loses too little a step")
    return part


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


def lifted(found: Structure, whole: Derived, chosen: Integers) -> Integers:
    """Return pairs (S,) of the model from the sources `chosen` (S',) in the merged one."""
    graph, mdp = found.graph, found.mdp
    pairs = mdp.pair_offsets[:-1].copy()
    target = np.zeros(mdp.n_states, dtype=bool)
    plain = found.sign == 0
    for rest in found.rests:
        plain[rest.states] = False
        taken = int(chosen[whole.label[rest.states[0]]])
        if 0 <= taken < mdp.n_pairs:
            pairs[mdp.pair_state[taken]] = taken
            target[mdp.pair_state[taken]] = True
        else:
            _first(mdp, rest.stay, pairs)
            target[mdp.pair_state[rest.stay]] = True
    toward(graph, graph.distance(target, found.inside), found.inside, pairs)
    plain &= whole.label < whole.mdp.n_states - 1
    pairs[plain] = chosen[whole.label[plain]]
    if found.drift is not None:
        drifting = found.sign != 0
        pairs[drifting] = (mdp.pair_offsets[:-1] + found.drift.policy)[drifting]
    elif found.missing.any():
        _first(mdp, np.flatnonzero(graph.every(found.missing)), pairs)
        every = np.ones(mdp.n_pairs, dtype=bool)
        toward(graph, graph.distance(found.missing, every), every, pairs)
    else:
        above = np.zeros(mdp.n_states, dtype=bool)
        for core in found.cores:
            above[core.states] = True
            pairs[core.states] = core.proof[1]
        safe = graph.every(found.sign >= 0)
        toward(graph, graph.distance(above, safe), safe & (found.sign > 0)[mdp.pair_state], pairs)
    return pairs


def _first(mdp: MDP, some: Integers, pairs: Integers) -> None:
    """Write into `pairs` (S,) the first of `some` pairs of each state that has one."""
    states, first = np.unique(mdp.pair_state[some], return_index=True)
    pairs[states] = some[first]
