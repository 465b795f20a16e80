"""BiCGSTAB and GMRES for (I - γ P) x = b, preconditioned by Gauss-Seidel up and down.

    M = (D - L) D⁻¹ (D - U),   I - γ P = D - L - U

(van der Vorst, SIAM J. Sci. Stat. Comput. 13, 1992; Saad and Schultz, the same, 7, 1986; Saad,
Iterative Methods for Sparse Linear Systems, 2003, algorithms 7.7 and 9.5 and section 10.2). A sweep
carries news along a whole chain of states numbered in order, either way, so that queues and grids
take few steps. Columns are sorted within each row. All sums are formed in one order: the answer
does not depend on threads, nor on a library for linear algebra.
"""

from __future__ import annotations

import numpy as np

from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.kernels.compiling import at, compiled, span

LEAST = 1e-14  # a cosine that is nothing but rounding


@compiled
def applied(
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    discount: float,
    given: Floats,
    out: Floats,
    through: Floats,
) -> None:
    """Write y = M⁻¹ x (S,) of a `given` x (S,) into `out`, and (I - γ P) y into `through`.

    With t = (D - L)⁻¹ x the latter is D t - L y, so that half of the entries need not be read a
    third time (after Eisenstat, SIAM J. Sci. Stat. Comput. 2, 1981).
    """
    states = len(given)
    for state in range(states):
        total, diagonal = 0.0, 1.0
        for i in span(indptr[state], indptr[state + 1]):
            if indices[i] >= state:
                if indices[i] == state:
                    diagonal -= discount * data[i]
                break
            total += data[i] * through[at(indices[i])]
        # No division waits for the state before.
        through[state] = (given[state] + discount * total) * (1.0 / diagonal)
    for number in range(states):
        state = states - 1 - number
        total, diagonal = 0.0, 1.0
        for back in range(indptr[state + 1] - indptr[state]):
            i = at(indptr[state + 1] - 1 - back)
            if indices[i] <= state:
                if indices[i] == state:
                    diagonal -= discount * data[i]
                break
            total += data[i] * out[at(indices[i])]
        out[state] = through[state] + total * (discount / diagonal)
        through[state] *= diagonal
    for state in range(states):
        total = 0.0
        for i in span(indptr[state], indptr[state + 1]):
            if indices[i] >= state:
                break
            total += data[i] * out[at(indices[i])]
        through[state] -= discount * total


@compiled
def residual(
    indptr: Numbers, indices: Numbers, data: Floats, discount: float, value: Floats, out: Floats
) -> None:
    """Write x - γ P x (S,) of `value` x (S,) into `out`."""
    for state in range(len(value)):
        ahead = 0.0
        for i in span(indptr[state], indptr[state + 1]):
            ahead += data[i] * value[at(indices[i])]
        out[state] = value[state] - discount * ahead


@compiled
def dot(left: Floats, right: Floats) -> float:
    """Return the inner product of two vectors (S,)."""
    # Four sums at once: an addition takes as long as four multiplications.
    one, two, three, four = 0.0, 0.0, 0.0, 0.0
    whole = len(left) // 4 * 4
    for i in range(0, whole, 4):
        one += left[at(i)] * right[at(i)]
        two += left[at(i + 1)] * right[at(i + 1)]
        three += left[at(i + 2)] * right[at(i + 2)]
        four += left[at(i + 3)] * right[at(i + 3)]
    for i in range(whole, len(left)):
        one += left[i] * right[i]
    return (one + two) + (three + four)


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

    Where a step breaks down, because the residual is orthogonal to the shadow that it is compared
    with, the method starts again from what it has, with the present residual for a shadow.

    Parameters
    ----------
    constant : (S,)
        b, of magnitude 1 or so.
    rtol : float
        The norm of the residual, as the recurrence has it, is to be at most this part of b's. It is
        not worked out anew, as rounding may have kept it from falling so far.
    room : (6, S)
        To work in.
    """
    states = len(constant)
    r, shadow, p, v, t, y = room[0], room[1], room[2], room[3], room[4], room[5]
    for i in range(states):
        value[i] = 0.0
    goal = rtol * np.sqrt(dot(constant, constant))
    rho, alpha, omega, length, size, fresh = 1.0, 1.0, 1.0, 0.0, 0.0, True
    for step in range(steps):
        if fresh:
            residual(indptr, indices, data, discount, value, v)
            for i in range(states):
                r[i] = constant[i] - v[i]
                shadow[i], p[i], v[i] = r[i], 0.0, 0.0
            rho, alpha, omega, fresh = 1.0, 1.0, 1.0, False
            length = size = np.sqrt(dot(r, r))
        if size <= goal:
            return step
        before, rho = rho, dot(shadow, r)
        beta = (rho / before) * (alpha / omega)
        for i in range(states):
            p[i] = r[i] + beta * (p[i] - omega * v[i])
        applied(indptr, indices, data, discount, p, y, v)
        along = dot(shadow, v)
        fresh = not (
            abs(rho) > LEAST * length * size and abs(along) > LEAST * length * np.sqrt(dot(v, v))
        )
        if fresh:
            continue
        alpha = rho / along
        for i in range(states):
            value[i] += alpha * y[i]
            r[i] -= alpha * v[i]
        size = np.sqrt(dot(r, r))
        if size <= goal:
            return step + 1
        applied(indptr, indices, data, discount, r, y, t)
        square = dot(t, t)
        omega = dot(t, r) / square
        fresh = not abs(omega) * np.sqrt(square) > LEAST * size
        if fresh:
            continue
        for i in range(states):
            value[i] += omega * y[i]
            r[i] -= omega * t[i]
        size = np.sqrt(dot(r, r))
        if not np.isfinite(size):
            return -1
    return -1


@compiled
def gmres(
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    discount: float,
    constant: Floats,
    rtol: float,
    steps: int,
    value: Floats,
    basis: Floats,
    small: Floats,
) -> int:
    """Write x into `value` (S,); return the steps taken, or -1 where `steps` do not suffice.

    Restarted every m steps: where BiCGSTAB swings, its residual never grows.

    Parameters
    ----------
    constant, rtol
        As for `bicgstab`.
    basis : (m + 2, S)
        To work in: the directions, and one that is being made.
    small : (m + 4, m + 1)
        To work in: the Hessenberg matrix, its rotations, and the right-hand side.
    """
    states, most = len(constant), len(basis) - 2
    y, cosine, sine, right = basis[most + 1], small[most + 1], small[most + 2], small[most + 3]
    for i in range(states):
        value[i] = 0.0
    goal = rtol * np.sqrt(dot(constant, constant))
    done = 0
    while done <= steps:
        first = basis[0]
        residual(indptr, indices, data, discount, value, first)
        for i in range(states):
            first[i] = constant[i] - first[i]
        size = np.sqrt(dot(first, first))
        if size <= goal:
            return done
        if not np.isfinite(size) or done == steps:
            return -1
        for i in range(states):
            first[i] /= size
        right[0], used = size, 0
        while used < most and done < steps and abs(right[used]) > goal:
            k, new = used, basis[used + 1]
            applied(indptr, indices, data, discount, basis[k], y, new)
            before = np.sqrt(dot(new, new))
            for j in range(k + 1):
                along = dot(new, basis[j])
                small[j, k] = along
                for i in range(states):
                    new[i] -= along * basis[j, i]
            length = np.sqrt(dot(new, new))
            for j in range(k):
                one, two = small[j, k], small[j + 1, k]
                small[j, k] = cosine[j] * one + sine[j] * two
                small[j + 1, k] = cosine[j] * two - sine[j] * one
            whole = np.hypot(small[k, k], length)
            if not whole > LEAST * before:
                return -1  # the matrix is singular to rounding
            cosine[k], sine[k], small[k, k] = small[k, k] / whole, length / whole, whole
            right[k + 1] = -sine[k] * right[k]
            right[k] = cosine[k] * right[k]
            used, done = used + 1, done + 1
            if not length > LEAST * before:
                break  # the directions hold the solution
            for i in range(states):
                new[i] /= length
        for number in range(used):
            k = used - 1 - number
            for j in range(k + 1, used):
                right[k] -= small[k, j] * right[j]
            right[k] /= small[k, k]
        # The first direction is needed no more; the sum takes its place.
        for i in range(states):
            total = 0.0
            for k in range(used):
                total += right[k] * basis[k, i]
            first[i] = total
        applied(indptr, indices, data, discount, first, y, basis[1])
        for i in range(states):
            value[i] += y[i]
        if abs(right[used]) <= goal:
            return done
    return -1
