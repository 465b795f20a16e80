"""Compiled loops for linear systems x = c + γ P x: sweeps, and a preconditioner for BiCGSTAB.

The preconditioner is symmetric Gauss-Seidel,

    M = (D - L) D⁻¹ (D - U),   I - γ P = D - L - U

(van der Vorst, SIAM J. Sci. Stat. Comput. 13, 1992; Saad, Iterative Methods for Sparse Linear
Systems, 2003, section 10.2). It carries values along a whole chain of states numbered in order, in
either direction, so that queues and grids need few steps. Columns are sorted within each row.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exact_mdp.mdp.forms.compiling import compile_loop, inline_loop, unsigned_index, unsigned_range
from exact_mdp.mdp.table import Floats, Integers, Numbers


class SparseRows(NamedTuple):
    """The rows of a sparse matrix: row r has the entries indptr[r] … indptr[r+1]-1."""

    indptr: Numbers
    indices: Numbers
    data: Floats


@inline_loop
def compute_expectation(rows: SparseRows, state: int, value: Floats) -> float:
    """Return Σ P(s, s') x(s') of a state."""
    total = 0.0
    for i in unsigned_range(rows.indptr[state], rows.indptr[state + np.uint64(1)]):
        total += rows.data[i] * value[unsigned_index(rows.indices[i])]
    return total


@compile_loop
def sweep_states(
    rows: SparseRows,
    row: Integers,
    discount: float,
    constant: Floats,
    whole: bool,
    enough: float,
    fine: float,
    most: int,
    tried: int,
    value: Floats,
    room: Floats,
) -> bool:
    """Improve `value` (S,) until its residual r = c + γ P x - x is `enough`; return whether it is.

    `row` (S,) is the row of each state. If rows are `whole`, they sum to 1 and γ < 1; then all
    values lack about m / (1 - γ), with m the middle of the range of r. The next residual is
    γ (P r - m), which falls as fast as the chain mixes. Sweeps end as soon as `most` of them would
    not suffice at their present rate. Each sweep computes r afresh and so refines x: with `fine`
    above 0, sweeps continue until the residual is that part of the values.
    """
    states, before = len(constant), np.inf
    for sweep in range(most):
        # The residual of each state, and its range.
        low, high, size = np.inf, -np.inf, 0.0
        for number in unsigned_range(0, states):
            state = unsigned_index(number)
            left = constant[state] + (
                discount * compute_expectation(rows, unsigned_index(row[state]), value)
                - value[state]
            )
            room[state] = left
            low, high = min(low, left), max(high, left)
            if fine > 0:
                size = max(size, abs(value[state]), abs(constant[state]))
        # Add the residual to each value, and the common shift to all of them.
        middle, more = 0.0, 0.0
        if whole:
            middle = (low + high) / 2
            more = discount * middle / (1 - discount)
        error = discount * max(high - middle, middle - low)
        for number in range(states):
            value[number] += room[number] + more
        limit = enough
        if fine > 0:
            limit = fine * size
        if error <= limit:
            return True
        # Give up if the remaining sweeps, each as good as the last, would not reach the limit.
        if sweep >= tried and not (
            error < before and error * (error / before) ** (most - sweep) <= max(limit, enough)
        ):
            return error <= enough
        before = error
    return before <= enough


@compile_loop
def compute_inner_product(left: Floats, right: Floats) -> float:
    """Return the inner product of two vectors (S,), in four sums that a processor overlaps."""
    one, two, three, four = 0.0, 0.0, 0.0, 0.0
    whole = len(left) // 4 * 4
    for i in range(0, whole, 4):
        one += left[unsigned_index(i)] * right[unsigned_index(i)]
        two += left[unsigned_index(i + 1)] * right[unsigned_index(i + 1)]
        three += left[unsigned_index(i + 2)] * right[unsigned_index(i + 2)]
        four += left[unsigned_index(i + 3)] * right[unsigned_index(i + 3)]
    for i in range(whole, len(left)):
        one += left[i] * right[i]
    return (one + two) + (three + four)


@compile_loop
def write_residual(rows: SparseRows, discount: float, value: Floats, out: Floats) -> None:
    """Write x - γ P x (S,) of `value` x (S,) into `out`."""
    for number in unsigned_range(0, len(value)):
        state = unsigned_index(number)
        out[state] = value[state] - discount * compute_expectation(rows, state, value)


@compile_loop
def apply_preconditioner(rows: SparseRows, discount: float, given: Floats, out: Floats) -> None:
    """Write y = M⁻¹ x (S,) of a `given` x (S,) into `out`."""
    (indptr, indices, data), states = rows, len(given)
    # Forward: solve with D - L, reading each row up to its diagonal.
    for state in range(states):
        total, diagonal = 0.0, 1.0
        for i in unsigned_range(indptr[state], indptr[state + 1]):
            if indices[i] >= state:
                if indices[i] == state:
                    diagonal -= discount * data[i]
                break
            total += data[i] * out[unsigned_index(indices[i])]
        out[state] = (given[state] + discount * total) * (1.0 / diagonal)
    # Backward: solve with D⁻¹ (D - U), reading each row from its end down to its diagonal.
    for number in range(states):
        state = states - 1 - number
        total, diagonal = 0.0, 1.0
        for back in range(indptr[state + 1] - indptr[state]):
            i = unsigned_index(indptr[state + 1] - 1 - back)
            if indices[i] <= state:
                if indices[i] == state:
                    diagonal -= discount * data[i]
                break
            total += data[i] * out[unsigned_index(indices[i])]
        out[state] += total * (discount / diagonal)
