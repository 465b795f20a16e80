"""Linear systems (I - γ P) x = b: sweeps, BiCGSTAB, substitution along an order, and fill counted.

BiCGSTAB is preconditioned by Gauss-Seidel up and down,

    M = (D - L) D⁻¹ (D - U),   I - γ P = D - L - U

(van der Vorst, SIAM J. Sci. Stat. Comput. 13, 1992; Saad, Iterative Methods for Sparse Linear
Systems, 2003, algorithm 7.7 and section 10.2). A sweep carries news along a whole chain of states
numbered in order, either way, so that queues and grids take few steps. Columns are sorted within
each row. All sums are formed in one order: the answer does not depend on threads, nor on a library
for linear algebra.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exact_mdp.mdp.forms.compiling import at, compiled, span
from exact_mdp.mdp.table import Floats, Numbers

LEAST = 1e-14  # a cosine that is nothing but rounding


class Rows(NamedTuple):
    """The rows of a sparse matrix: row r has the entries indptr[r] … indptr[r+1]-1."""

    indptr: Numbers
    indices: Numbers
    data: Floats


@compiled
def reach(slots: Numbers, ends: Numbers, indices: Numbers, ended: Numbers) -> tuple[int, int, int]:
    """Return how far rows slots[s] … ends[s]-1 lead down and up at most, and their entries."""
    down, up, entries = 0, 0, 0
    for state in range(len(ended)):
        if not ended[state]:
            entries += ends[state] - slots[state]
            for i in span(slots[state], ends[state]):
                ahead = indices[i] - state
                down, up = max(down, -ahead), max(up, ahead)
    return down, up, entries


@compiled
def applied(
    rows: Rows,
    discount: float,
    given: Floats,
    out: Floats,
    through: Floats,
) -> None:
    """Write y = M⁻¹ x (S,) of a `given` x (S,) into `out`, and (I - γ P) y into `through`.

    With t = (D - L)⁻¹ x the latter is D t - L y, so that half of the entries need not be read a
    third time (after Eisenstat, SIAM J. Sci. Stat. Comput. 2, 1981).
    """
    (indptr, indices, data), states = rows, len(given)
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
def residual(rows: Rows, discount: float, value: Floats, out: Floats) -> None:
    """Write x - γ P x (S,) of `value` x (S,) into `out`."""
    indptr, indices, data = rows
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
    rows: Rows,
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
    """
    states = len(constant)
    r, shadow, p, v, t, y = room[0], room[1], room[2], room[3], room[4], room[5]
    for i in range(states):
        value[i] = 0.0
    goal = rtol * np.sqrt(dot(constant, constant))
    rho, alpha, omega, length, size, fresh = 1.0, 1.0, 1.0, 0.0, 0.0, True
    for step in range(steps):
        if fresh:
            residual(rows, discount, value, v)
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
        applied(rows, discount, p, y, v)
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
        applied(rows, discount, r, y, t)
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
def swept(
    rows: Rows,
    discount: float,
    constant: Floats,
    enough: float,
    fine: float,
    most: int,
    tried: int,
    close: float,
    value: Floats,
    room: Floats,
) -> bool:
    """Write x into `value` (S,) with a residual r of at most `enough`, where sweeps x + r lead.

    Where all rows sum to 1 and γ < 1, what r is in the middle of its range is what all values still
    lack, divided by 1 - γ: with m for that middle, the next residual is γ (P r - m), and so falls
    as fast as the chain mixes. Where all columns do, as in equations of visits, x sums to Σ c
    divided by 1 - γ, and what begins with that sum keeps it: r sums to 0, and falls as fast. Sweeps
    end once `most` of them would not do, as they go on. Each finds r anew, so that they refine x,
    too: those that are `enough` go on to a residual of `fine` of the values, or while it falls.
    `solvers.bounds.linear.sweeping` says the same in NumPy, bit for bit.
    """
    indptr, indices, data = rows
    states, before, whole, mass = len(constant), np.inf, discount < 1, 0.0
    earned = 0.0
    for state in range(states):
        value[state] = 0.0
    for state in range(states):
        total = 0.0
        for i in span(indptr[state], indptr[state + 1]):
            total += data[i]
            value[at(indices[i])] += data[i]
        whole &= abs(total - 1) < close
        mass += constant[state]
        earned = max(earned, abs(constant[state]))
        room[state] = constant[state]
    kept = discount < 1 and not whole
    for state in range(states):
        kept &= abs(value[state] - 1) < close
    begin = mass / (1 - discount) / states if kept else 0.0
    for state in range(states):
        value[state] = begin
    largest = max(earned, abs(begin))  # no value is larger: none is looked at without need
    for sweep in range(most):
        low, high = np.inf, -np.inf
        for state in range(states):
            left = room[state]
            if sweep > 0 or kept:
                ahead = 0.0
                for i in span(indptr[state], indptr[state + 1]):
                    ahead += data[i] * value[at(indices[i])]
                left = room[state] = constant[state] + discount * ahead - value[state]
            low, high = min(low, left), max(high, left)
        middle = (low + high) / 2 if whole else 0.0
        error = max(high - middle, middle - low)
        more = discount * middle / (1 - discount) if whole else 0.0
        for state in range(states):
            value[state] += room[state] + more
        largest = (largest + (max(-low, high) + abs(more))) * (1 + 2.0**-20)
        if fine > 0:
            if error * discount <= fine * largest:
                size = earned
                for state in range(states):
                    size = max(size, abs(value[state]))
                if error * discount <= fine * size:
                    return True
        elif error * discount <= enough:
            return True
        if sweep >= tried:
            falls = error < before and error * (error / before) ** (most - sweep) <= enough
            if not falls:
                return bool(error <= enough)
        before = error
    return bool(before <= enough)


@compiled
def falls(indptr: Numbers, indices: Numbers, order: Numbers) -> bool:
    """Return whether every entry (s, t) has order[t] < order[s]."""
    for state in range(len(indptr) - 1):
        for i in range(indptr[state], indptr[state + 1]):
            if order[indices[i]] >= order[state]:
                return False
    return True


@compiled
def substitute(
    rows: Rows,
    discount: float,
    sequence: Numbers,
    constant: Floats,
    value: Floats,
) -> None:
    """Write x (S,) into `value`, state after state of `sequence`, each after all it leads to."""
    indptr, indices, data = rows
    for state in sequence:
        ahead = 0.0
        for i in span(indptr[state], indptr[state + 1]):
            ahead += data[i] * value[at(indices[i])]
        value[state] = constant[state] + discount * ahead


@compiled
def fill(
    indptr: Numbers,
    indices: Numbers,
    most: int,
    operations: float,
    parent: Numbers,
    seen: Numbers,
    count: Numbers,
) -> int:
    """Return the entries of L, diagonal included, for a symmetric pattern in the order given.

    Row i of L holds what is met on the way from each k < i of row i of the matrix up the
    elimination tree (Liu, SIAM J. Matrix Anal. Appl. 11, 1990). Counting stops, with -1, where
    there are more than `most`, or where elimination takes more than this many operations.
    """
    states = len(indptr) - 1
    total, work = 0, 0.0
    for i in range(states):
        parent[i], seen[i], count[i] = -1, i, 1
        total, work = total + 1, work + 1.0
        for place in range(indptr[i], indptr[i + 1]):
            k = indices[place]
            while k < i and seen[k] != i:
                if parent[k] < 0:
                    parent[k] = i
                seen[k] = i
                total, work = total + 1, work + 2.0 * count[k] + 1.0
                count[k] += 1
                k = parent[k]
        if total > most or work > operations:
            return -1
    return total
