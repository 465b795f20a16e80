"""The compiled passes again, pair by pair in plain Python: slow, and easy to believe."""

from __future__ import annotations

import numpy as np

from exact_mdp import MDP


def gains_of(mdp: MDP, value: np.ndarray, shift: float, margin: np.ndarray) -> np.ndarray:
    """Return (L,) what each pair adds to V = value + shift, the shift weighed by the margins."""
    matrix = mdp.transition
    found = np.empty(mdp.n_pairs)
    for pair in range(mdp.n_pairs):
        own, ahead = value[mdp.pair_state[pair]], 0.0
        for i in range(matrix.indptr[pair], matrix.indptr[pair + 1]):
            ahead += matrix.data[i] * (value[matrix.indices[i]] - own)
        leak = float(1 - mdp.discount_exact)
        found[pair] = mdp.reward[pair] + mdp.discount * ahead - leak * own - shift * margin[pair]
    return found


def relaxed(mdp: MDP, value: np.ndarray, *, backward: bool) -> np.ndarray:
    """Return `value` (S,) after one sweep of Gauss-Seidel, with 1 - γ P(l, s) divided out."""
    value, matrix = value.copy(), mdp.transition.toarray()
    states = range(mdp.n_states)
    for state in reversed(states) if backward else states:
        if mdp.terminal[state]:
            continue
        best = -np.inf
        for pair in mdp.pairs_of(state):
            stay = matrix[pair, state]
            others = mdp.discount * (matrix[pair] @ value - stay * value[state])
            best = max(best, (mdp.reward[pair] + others) / (1 - mdp.discount * stay))
        value[state] = best
    return value


def factor_pattern(pattern: np.ndarray) -> np.ndarray:
    """Return (S, S) where factors of a dense pattern and its mirror image may have entries."""
    found: np.ndarray = pattern | pattern.T
    for pivot in range(len(found)):
        later = np.flatnonzero(found[pivot, pivot + 1 :]) + pivot + 1
        found[np.ix_(later, later)] = True
    return found
