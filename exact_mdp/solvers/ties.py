"""Near ties, decided as closely as floats allow.

Solvers stop once the values are known well enough, and two actions whose values differ by less
count as tied. Their difference is known far more closely than either of them, as what the rows
have in common cancels:

    q(b) - q(a) = r_b - r_a + γ Σ (P_b - P_a) V,     with an error of γ Σ |P_b - P_a| |V - V*|

Actions that cannot be told apart even so differ by less than the error of the values.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.solution import Solution

ROUNDOFF = 2.0**-53


def settled(solution: Solution) -> Solution:
    """Return the solution with the better one of each two actions that float values can tell apart.

    Its values and bounds hold as before: no state takes a pair that is worse.
    """
    mdp, value, error = solution.mdp, solution.value, solution.state_error
    if not np.isfinite(value).all():
        return solution
    matrix, rate = mdp.transition, mdp.discount
    q = mdp.reward + rate * (matrix @ value)
    size = np.abs(mdp.reward) + rate * float(np.abs(value).max())
    doubt = (np.diff(matrix.indptr) + 8) * ROUNDOFF * size + rate * float(error.max())
    first, state = mdp.pair_offsets[:-1], mdp.pair_state
    best = np.maximum.reduceat(q - doubt, first)[state]
    near = (q + doubt >= best) & ~mdp.terminal[state]
    near[solution.pairs] = False
    rivals = np.flatnonzero(near)
    if not len(rivals):
        return solution
    pairs = solution.pairs.copy()
    turn = np.arange(len(rivals)) - np.searchsorted(state[rivals], state[rivals])
    for number in range(int(turn.max()) + 1):  # each state's first rival, then its second, …
        rival = rivals[turn == number]
        holder = pairs[state[rival]]
        earned = mdp.reward[rival] - mdp.reward[holder]
        difference = (matrix[rival] - matrix[holder]).tocoo()
        row, next_state, share = difference.row, difference.col, difference.data
        # Both rows sum to 1: values may be counted from any other. Counted from that of the
        # likeliest next state, the number that was rounded to make the row sum to 1 drops out.
        step = share * (value[next_state] - value[_likeliest(matrix[holder])][row])
        more = earned + rate * np.bincount(row, step, len(rival))
        terms = np.bincount(row, minlength=len(rival)) + 8
        moved = np.abs(earned) + rate * np.bincount(row, np.abs(step), len(rival))
        unknown = rate * np.bincount(row, np.abs(share) * error[next_state], len(rival))
        better = more > terms * ROUNDOFF * moved + unknown
        pairs[state[rival[better]]] = rival[better]
    return solution if np.array_equal(pairs, solution.pairs) else replace(solution, pairs=pairs)


def _likeliest(rows: Any) -> Integers:
    """Return the likeliest next state of each row of a sparse matrix."""
    counts = np.diff(rows.indptr)
    most = np.repeat(np.maximum.reduceat(rows.data, rows.indptr[:-1]), counts)
    places = np.where(rows.data == most, np.arange(rows.nnz), rows.nnz)
    return np.asarray(rows.indices[np.minimum.reduceat(places, rows.indptr[:-1])])
