"""Bounds on what can be had where a status is perceived: fully informed, QMDP and fast informed.

Upper bounds that are linear in the belief, one vector for each place x and action a:

    QMDP   α(x, a)(s) = r + γ Σ_{x', σ, s'} T(s, a; x', σ, s') max_a' α(x', a')(s')
    FIB    α(x, a)(s) = r + γ Σ_{x', σ, z'} max_a' Σ_{s'} T(s, a; x', σ, s') C(s', z') α(x', a')(s')

QMDP lets the actor know the status from the next step on, the fast informed bound only the one
before. Each is at least the value of every controller that sees perceptions alone, with whatever
memory, mixed or not: V* ≥ QMDP ≥ FIB ≥ the best (Hauskrecht, Value-function approximations for
partially observable Markov decision processes, Journal of Artificial Intelligence Research 13,
2000, sections 4.1 to 4.3). Where only some actions are allowed at each place and perceived status,
FIB bounds all policies that keep to them, and with one action allowed it is that policy's value.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mdp.perception_process import Move, Process
from mdp.table import Floats

Flags = NDArray[np.bool_]


def qmdp(process: Process) -> Floats:
    """Return (P, A, Z) vectors of action values for knowing the status from the next step on.

    The greatest entry over the actions is the value of knowing the status already. An action that
    is not available has -inf.
    """
    closed = ~process.offered[:, :, None]
    vectors = np.where(closed, -np.inf, process.reward.transpose(0, 2, 1))
    best = np.zeros(vectors.shape[::2])
    for place in reversed(process.order):
        for move in process.moves[place]:
            vectors[place] += process.discount * (move.chance @ best[move.place][move.reach])
        best[place] = vectors[place].max(axis=0)
    return vectors


def fast_informed(process: Process, allowed: Flags | None = None) -> Floats:
    """Return (P, A, Z, N) vectors of the fast informed bound.

    Parameters
    ----------
    allowed : (P, Z, A, N) bool, optional
        Actions allowed at each place and perceived status, among those on offer; all of them
        unless given, with N = 1.

    Examples
    --------
    >>> from mdp import Scenario
    >>> from mdp.perception import independent
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> process = Process.of(mdp, independent([0.9] * 4, [0.9] * 4))
    >>> known, guessed = qmdp(process)[0, :, 0].max(), fast_informed(process)[0, :, 0, 0].max()
    >>> f"{known:.3f} {guessed:.3f}"
    '146.236 145.886'
    """
    places, actions = process.offered.shape
    if allowed is None:
        allowed = np.repeat(process.offered[:, None, :, None], process.statuses, axis=1)
    count = allowed.shape[3]
    vectors = np.zeros((places, actions, process.statuses, count))
    for place in reversed(process.order):
        vectors[place] = process.reward[place].T[:, :, None]
        for move in process.moves[place]:
            q = informed(process, move, vectors[move.place])
            q = np.where(allowed[move.place], q, -np.inf)
            vectors[place] += process.discount * q.max(axis=3).sum(axis=2)
    return vectors


def informed(process: Process, move: Move, vectors: Floats) -> Floats:
    """Return (A, Z, Z', A', N) what action a' is worth after (a, s), where z' is perceived.

    Parameters
    ----------
    vectors : (A', Z, N)
        At the place that the move leads to.
    """
    weights = move.chance[:, :, None, :] * process.confusion[move.reach].T
    actions, statuses, seen, reached = weights.shape
    ahead = vectors[:, move.reach].transpose(1, 0, 2).reshape(reached, -1)
    found = weights.reshape(-1, reached) @ ahead
    return np.asarray(found.reshape(actions, statuses, seen, len(vectors), -1))
