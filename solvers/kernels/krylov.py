"""BiCGSTAB for (I - γ P) x = b, preconditioned by a sweep of Gauss-Seidel up and one down.

    M = (D - L) D⁻¹ (D - U),   I - γ P = D - L - U

(van der Vorst, SIAM J. Sci. Stat. Comput. 13, 1992; Saad, Iterative Methods for Sparse Linear
Systems, 2003, algorithm 7.7 and section 10.2). A sweep carries news along a whole chain of states
numbered in order, either way, so that queues and grids take few steps. All sums are formed in one
order: the answer does not depend on threads, nor on a library for linear algebra.
"""

from __future__ import annotations

import numpy as np

from mdp.table import Floats, Numbers
from solvers.kernels.compiling import compiled


@compiled
def symmetric(
    indptr: Numbers, indices: Numbers, data: Floats, discount: float, given: Floats, out: Floats
) -> None:
    """Write M⁻¹ x (S,) of a `given` x (S,) into `out`."""
    states = len(given)
    for state in range(states):
        total, diagonal = 0.0, 1.0
        for i in range(indptr[state], indptr[state + 1]):
            if indices[i] < state:
                total += data[i] * out[indices[i]]
            elif indices[i] == state:
                diagonal -= discount * data[i]
        out[state] = (given[state] + discount * total) / diagonal
    for number in range(states):
        state = states - 1 - number
        total, diagonal = 0.0, 1.0
        for i in range(indptr[state], indptr[state + 1]):
            if indices[i] > state:
                total += data[i] * out[indices[i]]
            elif indices[i] == state:
                diagonal -= discount * data[i]
        out[state] += discount * total / diagonal


@compiled
def residual(
    indptr: Numbers, indices: Numbers, data: Floats, discount: float, value: Floats, out: Floats
) -> None:
    """Write x - γ P x (S,) of `value` x (S,) into `out`."""
    for state in range(len(value)):
        ahead = 0.0
        for i in range(indptr[state], indptr[state + 1]):
            ahead += data[i] * value[indices[i]]
        out[state] = value[state] - discount * ahead


@compiled
def dot(left: Floats, right: Floats) -> float:
    """Return the inner product of two vectors (S,)."""
    total = 0.0
    for i in range(len(left)):
        total += left[i] * right[i]
    return total


@compiled
def bicgstab(
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    discount: float,
    constant: Floats,
    rtol: float,
    steps: int,
    value: Floats,
    room: Floats,
) -> int:
    """Write x into `value` (S,); return the steps taken, or -1 where `steps` do not suffice.

    Parameters
    ----------
    constant : (S,)
        b, of magnitude 1 or so.
    rtol : float
        The norm of the residual is to be at most this part of the norm of b.
    room : (6, S)
        To work in.
    """
    states = len(constant)
    r, shadow, p, v, t, y = room[0], room[1], room[2], room[3], room[4], room[5]
    for i in range(states):
        value[i], r[i], shadow[i], p[i], v[i] = 0.0, constant[i], constant[i], 0.0, 0.0
    goal = rtol * np.sqrt(dot(constant, constant))
    rho, alpha, omega = 1.0, 1.0, 1.0
    for step in range(steps):
        if np.sqrt(dot(r, r)) <= goal:
            return step
        before, rho = rho, dot(shadow, r)
        beta = (rho / before) * (alpha / omega)
        for i in range(states):
            p[i] = r[i] + beta * (p[i] - omega * v[i])
        symmetric(indptr, indices, data, discount, p, y)
        residual(indptr, indices, data, discount, y, v)
        alpha = rho / dot(shadow, v)
        for i in range(states):
            value[i] += alpha * y[i]
            r[i] -= alpha * v[i]
        if np.sqrt(dot(r, r)) <= goal:
            return step + 1
        symmetric(indptr, indices, data, discount, r, y)
        residual(indptr, indices, data, discount, y, t)
        omega = dot(t, r) / dot(t, t)
        for i in range(states):
            value[i] += omega * y[i]
            r[i] -= omega * t[i]
        if not abs(omega) > 0.0 or not np.isfinite(alpha):
            return -1
    return -1
