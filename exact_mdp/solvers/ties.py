"""Break near ties between actions, as closely as floats allow.

Solvers stop once the values are accurate enough, and two actions whose values differ by less count
as tied. Their difference is known far more accurately than either value, because common terms of
the rows cancel:

    q(b) - q(a) = r_b - r_a + γ Σ (P_b - P_a) V,     with an error of γ Σ |P_b - P_a| |V - V*|

Actions that even this cannot distinguish differ by less than the error of the values.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from exact_mdp.solvers.bounds.gains import gamma, rounding_facts
from exact_mdp.solvers.solution import Solution


def break_near_ties(solution: Solution) -> Solution:
    """Return the solution with each pair replaced by a rival that is certainly better.

    Its values and bounds stay valid: no state takes a worse pair than before.
    """
    mdp, value, error = solution.mdp, solution.value, solution.state_error
    if not np.isfinite(value).all():
        return solution
    matrix, rate, facts = mdp.transition, mdp.discount, rounding_facts(mdp)
    # Rivals of a pair: pairs whose values are so near that errors may have hidden the better one.
    q, first, state = mdp.backup(value), mdp.pair_offsets[:-1], mdp.pair_state
    size = facts.size + rate * float(np.abs(value).max())
    doubt = gamma(facts.most + 8) * size + rate * float(error.max())
    near = (q + 2 * doubt >= np.maximum.reduceat(q, first)[state]) & ~mdp.terminal[state]
    near[solution.pairs] = False
    rivals = np.flatnonzero(near)
    if not len(rivals):
        return solution
    pairs = solution.pairs.copy()
    turn = np.arange(len(rivals)) - np.searchsorted(state[rivals], state[rivals])
    # Each state's first rival, then its second, and so on.
    for number in range(int(turn.max()) + 1):
        rival = rivals[turn == number]
        # Compare each rival with the pair that its state takes so far.
        holder = pairs[state[rival]]
        rows, earned = matrix[holder], mdp.reward[rival] - mdp.reward[holder]
        apart = matrix[rival] - rows
        row, share = np.repeat(np.arange(len(rival)), np.diff(apart.indptr)), apart.data
        # Both rows sum to 1, so any constant may be subtracted from the values. With the value
        # of the likeliest next state, the probability that was rounded most has the factor 0.
        most = np.repeat(np.maximum.reduceat(rows.data, rows.indptr[:-1]), np.diff(rows.indptr))
        places = np.where(rows.data == most, np.arange(rows.nnz), rows.nnz)
        likeliest = rows.indices[np.minimum.reduceat(places, rows.indptr[:-1])]
        # The difference of both values, its rounding error, and the effect of the values' errors.
        step = share * (value[apart.indices] - value[likeliest][row])
        unknown = np.abs(share) * error[apart.indices]
        sums = [np.bincount(row, each, len(rival)) for each in (step, np.abs(step), unknown)]
        noise = gamma(np.diff(apart.indptr) + 8) * (np.abs(earned) + rate * sums[1])
        better = earned + rate * sums[0] > noise + rate * sums[2]
        pairs[state[rival[better]]] = rival[better]
    return replace(solution, pairs=pairs)
