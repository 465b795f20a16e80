"""Substitution, elimination within a band, and how far elimination would fill a matrix.

    I - γ P = L U,   L with ones on its diagonal

without exchanges of rows: what rows (or columns) dominated by their diagonal do not need, and then
nothing outside the band is ever filled (Golub and Van Loan, Matrix Computations, 2013, sections
4.1.2 and 4.3.1). Row s of `band` holds columns s - lower … s + upper, first of the matrix, then of
both factors. Multipliers that are 0 are passed over.
"""

from __future__ import annotations

from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.kernels.compiling import at, compiled, span


@compiled
def reach(indptr: Numbers, indices: Numbers, found: Numbers) -> None:
    """Write how far entries lie below and above the diagonal at most into `found` (2,)."""
    found[0] = found[1] = 0
    for state in range(len(indptr) - 1):
        for i in range(indptr[state], indptr[state + 1]):
            found[0] = max(found[0], state - indices[i])
            found[1] = max(found[1], indices[i] - state)


@compiled
def factor(
    indptr: Numbers, indices: Numbers, data: Floats, discount: float, lower: int, band: Floats
) -> int:
    """Write L - I and U into `band` (S, lower + 1 + upper); return -1, or where it breaks down."""
    states, width = band.shape
    for state in range(states):
        for k in range(width):
            band[state, k] = 0.0
        band[state, lower] = 1.0
        for i in range(indptr[state], indptr[state + 1]):
            band[state, lower + indices[i] - state] -= discount * data[i]
        for k in range(max(0, lower - state), lower):
            if band[state, k] != 0.0:
                pivot = state - lower + k
                multiplier = band[state, k] / band[pivot, lower]
                band[state, k] = multiplier
                for j in range(1, width - lower):
                    band[state, k + j] -= multiplier * band[pivot, lower + j]
        if not band[state, lower] > 0.0:
            return state
    return -1


@compiled
def solve(band: Floats, lower: int, value: Floats) -> None:
    """Turn the constant in `value` (S,) into the solution, with the factors in `band`."""
    states, width = band.shape
    for state in range(states):
        total = value[state]
        for k in range(max(0, lower - state), lower):
            total -= band[state, k] * value[state - lower + k]
        value[state] = total
    for number in range(states):
        state = states - 1 - number
        total = value[state]
        for k in range(lower + 1, min(width, lower + states - state)):
            total -= band[state, k] * value[state - lower + k]
        value[state] = total / band[state, lower]


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
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    discount: float,
    sequence: Numbers,
    constant: Floats,
    value: Floats,
) -> None:
    """Write x (S,) into `value`, state after state of `sequence`, each after all it leads to."""
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
    there are more than `most`, or where elimination takes more than so many operations.

    Parameters
    ----------
    operations : float
        Most multiplications: the squares of the columns' counts, added up.
    parent, seen, count : (S,)
        To work in; `count` ends up with the entries of each column of L.
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
