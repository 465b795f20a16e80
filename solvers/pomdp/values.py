"""Values and visits where a status is perceived, for many policies or perceptions at once.

    Q(x, s, a) = r(x, s, a) + γ Σ_{x', σ, s'} T(s, a; x', σ, s') V(x', s')
    V(x, s)    = Σ_a w(x, s, a) Q(x, s, a),     w(x, s, a) = Σ_z C(s, z) π(a | x, z)

in one pass from the last place to the first (`mdp.care.process`), and the visits d in one
pass forward. Every number is a sum of products, so with D steps at most, n roundings in each of
them and R the greatest reward of an outcome, a start value is off by at most γ(D n) D R (Higham,
Accuracy and Stability of Numerical Algorithms, SIAM 2002, section 3.1).

The fast informed bound has one vector for each place x and action a, linear in the belief:

    α(x, a)(s) = r + γ Σ_{x', σ, z'} max_a' Σ_{s'} T(s, a; x', σ, s') C(s', z') α(x', a')(s')

It lets whoever acts know the status of the step before. It is at least the value of every
controller that sees perceptions alone, with whatever memory, mixed or not (Hauskrecht,
Value-function approximations for partially observable Markov decision processes, Journal of
Artificial Intelligence Research 13, 2000, section 4.3).
"""

from __future__ import annotations

import numpy as np

from exact_mdp.mdp.care.process import Process
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import SLACK, gamma


def acting(process: Process, table: Floats, confusion: Floats | None = None) -> Floats:
    """Return (P, Z, A, N) the probability of each action in each *true* status.

    The table (P, Z, A) or (N, P, Z, A) has it by place and perceived status, as `Process.table`
    gives it; the confusion (Z, Z) or (N, Z, Z) is the process's own unless given.
    """
    matrix = process.confusion if confusion is None else confusion
    if table.ndim == 3 and matrix.ndim == 2:
        found = (matrix @ table)[..., None]
    elif matrix.ndim == 2:
        found = np.moveaxis(matrix @ table, 0, -1)
    else:
        found = np.moveaxis(matrix[:, None] @ table, 0, -1)
    return np.ascontiguousarray(found)


def values(process: Process, weights: Floats) -> tuple[Floats, Floats]:
    """Return values (P, Z, N) and action values (P, Z, A, N) of policies (P, Z, A, N)."""
    places, statuses, actions, count = weights.shape
    value = np.zeros((places, statuses, count))
    q = np.zeros((places, statuses, actions, count))
    for place in reversed(process.order):
        q[place] = process.reward[place][:, :, None]
        for move in process.moves[place]:
            ahead = move.chance @ value[move.place][move.reach]
            q[place] += process.discount * ahead.transpose(1, 0, 2)
        value[place] = (weights[place] * q[place]).sum(axis=1)
    return value, q


def visits(process: Process, weights: Floats) -> Floats:
    """Return (P, Z, N) expected discounted visits from the start under policies (P, Z, A, N)."""
    places, statuses, _, count = weights.shape
    found = np.zeros((places, statuses, count))
    found[process.start_place] = process.start[:, None]
    for place in process.order:
        flow = (found[place][:, None] * weights[place]).transpose(1, 0, 2)
        for move in process.moves[place]:
            step = np.einsum("asr,asn->rn", move.chance, flow)
            found[move.place][move.reach] += process.discount * step
    return found


def at_start(process: Process, value: Floats) -> Floats:
    """Return (N,) start values of values (P, Z, N)."""
    return np.asarray(process.start @ value[process.start_place])


def largest(process: Process) -> float:
    """Return a bound on |V| and |Q| of every policy, at every place."""
    return process.depth * float(np.abs(process.mdp.table.gains()).max(initial=0.0)) * SLACK


def rounding(process: Process) -> float:
    """Return how far a computed value may be from the exact one, at every place."""
    return float(gamma(process.depth * process.terms)) * largest(process) * SLACK


def fast_informed(process: Process) -> Floats:
    """Return (P, A, Z) vectors of the fast informed bound."""
    places, actions = process.offered.shape
    vectors = np.zeros((places, actions, process.statuses))
    for place in reversed(process.order):
        vectors[place] = process.reward[place].T
        for move in process.moves[place]:
            # (A, Z, Z', A') the value of a' after (a, s) where z' is perceived
            weights = move.chance[:, :, None, :] * process.confusion[move.reach].T
            ahead = np.ascontiguousarray(vectors[move.place][:, move.reach].T)
            q = (weights.reshape(-1, len(ahead)) @ ahead).reshape(*weights.shape[:3], actions)
            q = np.where(process.offered[move.place], q, -np.inf)
            vectors[place] += process.discount * q.max(axis=3).sum(axis=2)
    return vectors
