"""Elimination for x = c + γ P x: along an order, within a band, or sparse, where there is room.

    substitution(chain, γ, order)      the chain only falls along the order: nothing to eliminate
    band(chain, γ, reach)              all transitions are to near numbers: nothing fills outside
    sparse(chain, γ)                   SuperLU; refused where its factors would be too large

Each returns a function of c (S,). Rows, or columns, dominated by their diagonal need no exchanges
for the sake of stability. So the fill is known beforehand: it is at most that of the Cholesky
factor with the pattern of P + Pᵀ in the same order, which is counted, without forming it
(`solvers.kernels.linear.fill`; George and Liu, Computer Solution of Large Sparse Positive
Definite Systems, 1981, chapter 5). The order is that of COLAMD, read from an incomplete factor that
SuperLU drops nearly everything from; for very large chains, for which finding it takes minutes,
that of Reverse Cuthill and McKee.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import lapack
from scipy.sparse import csgraph, linalg

from exact_mdp.mdp.table import COMPILED, Floats, Integers, Numbers
from exact_mdp.solvers.solution import SolverError, Status

MOST_ENTRIES = 100_000_000  # in each factor: 1.2 GB with their places, 2.4 GB for both
MOST_OPERATIONS = 1e11  # about a minute or two
ENTRY = 12  # bytes
MOST_ORDERED = 1_000_000  # transitions that COLAMD orders within seconds, whatever they are
ROOM = 20
NO_FALL = "the chain does not fall along the order given"

Solve = Callable[[Floats], Floats]


class TooLarge(SolverError):
    """Factors that are not made, because they would fill the memory."""

    def __init__(self, detail: str) -> None:
        super().__init__(Status.TOO_LARGE, detail)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.detail,)


def reach(chain: sp.csr_array, order: Numbers | None = None) -> tuple[int, int]:
    """Return how far transitions (S, S) lead down and up at most, in number or in an `order`."""
    if order is not None:
        place = np.empty(chain.shape[0], dtype=chain.indices.dtype)
        place[order] = np.arange(chain.shape[0])
        ahead = place[chain.indices]
        ahead -= np.repeat(place, np.diff(chain.indptr))
        return int(-ahead.min(initial=0)), int(ahead.max(initial=0))
    if chain.nnz >= COMPILED:
        ends, ended = (chain.indptr[:-1], chain.indptr[1:]), np.zeros(chain.shape[0], dtype=bool)
        from exact_mdp.solvers.kernels import linear as kernel

        down, up, _ = kernel.reach(*ends, chain.indices, ended)
        return int(down), int(up)
    row = np.repeat(np.arange(chain.shape[0]), np.diff(chain.indptr))
    ahead = chain.indices - row
    return int(-ahead.min(initial=0)), int(ahead.max(initial=0))


def matrix_of(chain: sp.csr_array, discount: float) -> sp.csr_array:
    """Return I - γ P (S, S)."""
    return sp.csr_array(sp.eye_array(chain.shape[0], format="csr") - discount * chain)


def substitution(chain: sp.csr_array, discount: float, order: Integers) -> Solve:
    """Return forward substitution in the given order, by which the matrix is triangular.

    Large chains are read as they are by a compiled loop; small ones are put in order for SciPy's.
    """
    sequence = np.argsort(order, kind="stable")
    if chain.nnz >= COMPILED:
        from exact_mdp.solvers.kernels import linear as kernel

        if not kernel.falls(chain.indptr, chain.indices, order):
            raise ValueError(NO_FALL)

        from exact_mdp.solvers.kernels.linear import Rows

        def substituted(constant: Floats) -> Floats:
            value = np.empty(len(constant))
            rows = Rows(chain.indptr, chain.indices, chain.data)
            kernel.substitute(rows, float(discount), sequence, constant, value)
            return value

        return substituted
    place = np.empty_like(sequence)
    place[sequence] = np.arange(len(sequence))
    rows = chain[sequence]
    column = place[rows.indices]
    row = np.repeat(np.arange(len(sequence)), np.diff(rows.indptr))
    if (column >= row).any():
        raise ValueError(NO_FALL)
    flow = sp.csr_array((-discount * rows.data, column, rows.indptr), rows.shape)
    matrix = _narrow((flow + sp.eye_array(len(sequence), format="csr")).tocsr())
    matrix.sort_indices()

    def solve(constant: Floats) -> Floats:
        found = linalg.spsolve_triangular(
            matrix, constant[sequence], lower=True, unit_diagonal=True
        )
        return np.asarray(found[place])

    return solve


def _narrow(matrix: sp.csr_array) -> sp.csr_array:
    """Return the matrix with the places that SuperLU takes: C's int.

    `splu` and `spilu` cast them. `spsolve_triangular` does so from SciPy 1.17.1 on, and raises a
    TypeError before. They fit: what comes here has fewer transitions than `COMPILED`.
    """
    places = matrix.indices.astype(np.intc, copy=False), matrix.indptr.astype(np.intc, copy=False)
    return sp.csr_array((matrix.data, *places), matrix.shape)


def band(chain: sp.csr_array, discount: float, within: tuple[int, int]) -> Solve:
    """Return LAPACK's elimination within the band, from `within` below to above the diagonal."""
    lower, upper = within
    row = np.repeat(np.arange(chain.shape[0]), np.diff(chain.indptr))
    places = np.zeros((2 * lower + upper + 1, chain.shape[0]), order="F")
    places[lower + upper + row - chain.indices, chain.indices] = -discount * chain.data
    places[lower + upper] += 1.0
    return factored(places, within)


def factored(places: Floats, within: tuple[int, int]) -> Solve:
    """Return elimination of a matrix in LAPACK's `places` for a band, which are used up."""
    lower, upper = within
    factors, exchanged, failed = lapack.dgbtrf(places, lower, upper, overwrite_ab=True)
    if failed:
        raise SolverError(Status.NO_BOUND, f"elimination failed (pivot of state {failed - 1})")
    return lambda constant: np.asarray(lapack.dgbtrs(factors, lower, upper, constant, exchanged)[0])


def sparse(chain: sp.csr_array, discount: float) -> Solve:
    """Return sparse elimination by SuperLU."""
    matrix = matrix_of(chain, discount).tocsc()
    if chain.nnz < COMPILED:
        return _superlu(matrix)
    order = fill_order(matrix)
    matrix = matrix[order][:, order].tocsc()
    if fill(matrix) is None:
        raise TooLarge(
            f"iteration does not converge, and elimination of {chain.shape[0]:,} equations with "
            f"{chain.nnz:,} transitions would take factors of more than "
            f"{2 * MOST_ENTRIES * ENTRY / 1e9:.1f} GB or {MOST_OPERATIONS:.0e} operations"
        )
    # The order is kept, but for changes that leave the fill of a symmetric pattern as it is.
    inner = _superlu(matrix, permc_spec="NATURAL", options={"SymmetricMode": True})
    return reordered(inner, order)


def reordered(inner: Solve, order: Numbers) -> Solve:
    """Return the same for states (S,) in their own order, of elimination in another."""

    def solve(constant: Floats) -> Floats:
        value = np.empty(len(constant))
        value[order] = inner(constant[order])
        return value

    return solve


def in_room(chain: sp.csr_array, discount: float) -> Solve | None:
    """Return elimination whose factors have at most `ROOM` times the entries of the matrix.

    Where they would have more, SuperLU drops small ones: the caller has to look at the residual.
    None where it fails.
    """
    matrix: Any = _narrow(matrix_of(chain, discount)).tocsc()
    try:
        factors: Any = linalg.spilu(matrix, drop_tol=0.0, fill_factor=ROOM)
    except RuntimeError:
        return None
    return lambda constant: np.asarray(factors.solve(constant))


def fill(matrix: sp.csc_array) -> int | None:
    """Return the most entries that a factor of a `matrix` (S, S) may have; None if too many."""
    states = matrix.shape[0]
    row = matrix.indices
    column = np.repeat(np.arange(states, dtype=row.dtype), np.diff(matrix.indptr))
    # The pattern and its mirror image, below the diagonal.
    ends = (np.maximum(row, column), np.minimum(row, column))
    pattern = sp.csr_array((np.ones(len(row), dtype=np.int8), ends), matrix.shape)
    room = np.empty((3, states), dtype=np.int64)
    limits = (MOST_ENTRIES, float(MOST_OPERATIONS))
    from exact_mdp.solvers.kernels import linear as kernel

    found = int(kernel.fill(pattern.indptr, pattern.indices, *limits, room[0], room[1], room[2]))
    return None if found < 0 else found


def near_order(matrix: sp.csr_array | sp.csc_array) -> Numbers:
    """Return the states (S,) in the order of Reverse Cuthill and McKee, neighbours near."""
    parts = ((matrix.data != 0).astype(np.int8), matrix.indices, matrix.indptr)
    one = type(matrix)(parts, matrix.shape)  # bytes in place of floats
    pattern = (one + one.T).tocsr()
    return np.asarray(csgraph.reverse_cuthill_mckee(pattern, symmetric_mode=True))


def fill_order(matrix: sp.csc_array) -> Numbers:
    """Return the states (S,) in an order that keeps the fill low."""
    if matrix.nnz > MOST_ORDERED:
        return near_order(matrix)
    try:
        nearly: Any = linalg.spilu(matrix, drop_tol=1.0, fill_factor=1.0, permc_spec="COLAMD")
    except RuntimeError as error:
        raise SolverError(Status.NO_BOUND, f"elimination failed ({error})") from error
    return np.argsort(nearly.perm_c)


def _superlu(matrix: sp.csc_array, **settings: Any) -> Solve:
    try:
        factors: Any = linalg.splu(matrix, diag_pivot_thresh=0.0, **settings)
    except RuntimeError as error:
        raise SolverError(Status.NO_BOUND, f"elimination failed ({error})") from error
    return lambda constant: np.asarray(factors.solve(constant))
