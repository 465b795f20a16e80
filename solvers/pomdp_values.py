"""Values and visits where a status is perceived, for many policies or perceptions at once.

    Q(x, s, a) = r(x, s, a) + γ Σ_{x', σ, s'} T(s, a; x', σ, s') V(x', s')
    V(x, s)    = Σ_a w(x, s, a) Q(x, s, a),     w(x, s, a) = Σ_z C(s, z) π(a | x, z)

in one pass from the last place to the first (`mdp.perception_process`), and the visits d in one
pass forward. Every number is a sum of products, so with D steps at most, n roundings in each of
them and R the greatest reward of an outcome, a start value is off by at most γ(D n) D R (Higham,
Accuracy and Stability of Numerical Algorithms, SIAM 2002, section 3.1).
"""

from __future__ import annotations

import numpy as np

from mdp.perception_process import Process
from mdp.table import Floats
from solvers.rounding import SLACK, gamma


def acting(process: Process, table: Floats, confusion: Floats | None = None) -> Floats:
    """Return (P, Z, A, N) what is done in each *true* status.

    Parameters
    ----------
    table : (P, Z, A) or (N, P, Z, A)
        Probability of each action by place and perceived status, as `Process.table` returns it.
    confusion : (Z, Z) or (N, Z, Z), optional
        The process's own unless given.
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
    """Return values (P, Z, N) and action values (P, Z, A, N) of policies (P, Z, A, N).

    Examples
    --------
    >>> from mdp import Scenario
    >>> process = Process.of(Scenario.load("yuan2025").compile(), np.eye(16))
    >>> value, _ = values(process, acting(process, process.table("always:directive")))
    >>> round(float(at_start(process, value)[0]), 6)
    64.363644
    """
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
