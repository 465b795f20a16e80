"""Linear systems x = c + γ P x: sweeps, and what BiCGSTAB is preconditioned by.

That is Gauss-Seidel up and down,

    M = (D - L) D⁻¹ (D - U),   I - γ P = D - L - U

(van der Vorst, SIAM J. Sci. Stat. Comput. 13, 1992; Saad, Iterative Methods for Sparse Linear
Systems, 2003, section 10.2). A sweep carries values along a whole chain of states numbered in
order, either way, so that queues and grids take few steps. Columns are sorted within each row.
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
    """Improve `value` (S,) until its residual r = c + γ P x - x is `enough`, where sweeps lead so.

    Each state has its `row` (S,) among the rows. Where these are `whole`, they sum to 1 and γ < 1:
    what r is in the middle of its range is what all values still lack, times 1 - γ. The next
    residual is γ (P r - m), m this middle, and so falls as fast as the chain mixes. Sweeps end once
    `most` of them would not do, as they go on. Each finds r anew, so that they refine x, too: with
    `fine` above 0 they go on to a residual of that part of the values.
    """
    states, before = len(constant), np.inf
    for sweep in range(most):
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
        middle = (low + high) / 2 if whole else 0.0
        error = discount * max(high - middle, middle - low)
        more = discount * middle / (1 - discount) if whole else 0.0
        for number in range(states):
            value[number] += room[number] + more
        limit = fine * size if fine > 0 else enough
        if error <= limit:
            return True
        if sweep >= tried and not (
            error < before and error * (error / before) ** (most - sweep) <= max(limit, enough)
        ):
            return error <= enough
        before = error
    return before <= enough


@compile_loop
def compute_inner_product(left: Floats, right: Floats) -> float:
    """Return the inner product of two vectors (S,), from four sums, which do not wait."""
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
    for state in range(states):
        total, diagonal = 0.0, 1.0
        for i in unsigned_range(indptr[state], indptr[state + 1]):
            if indices[i] >= state:
                if indices[i] == state:
                    diagonal -= discount * data[i]
                break
            total += data[i] * out[unsigned_index(indices[i])]
        out[state] = (given[state] + discount * total) * (1.0 / diagonal)
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
