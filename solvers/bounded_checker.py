"""Checks a bounded certificate against the model alone, in floats, however it was found.

If w > γ P w in all rows for some w > 0, then the Bellman equations have one solution V. If also
U ≥ r + γ P U for all pairs and L ≤ r + γ P L for those of a policy π, then L ≤ V^π ≤ V ≤ U: applied
again and again, the right sides only move the vectors towards V and V^π (Puterman, Markov Decision
Processes, 1994, theorem 6.2.2). Every rounding error is counted (Higham, Accuracy and Stability of
Numerical Algorithms, SIAM 2002, section 3.1).
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from mdp.model import MDP
from mdp.table import Floats
from solvers.certificate_checker import not_of, policy_pairs

if TYPE_CHECKING:
    from solvers.certificate import BoundedCertificate

UNIT, TINY, SLACK = 2.0**-53, 2.0**-1000, 1 + 2.0**-20
CHUNK = 2**21


def bounded_violations(found: BoundedCertificate, mdp: MDP) -> list[str]:
    """Return what does not hold of a bounded certificate, in words; nothing where it is sound."""
    vectors = {"lower": found.lower, "upper": found.upper, "weight": found.weight}
    wrong = not_of(mdp, found.model, *vectors.values())
    wrong += [
        f"{name} is of type {array.dtype} and shape {array.shape}"
        for name, array, kind in (
            *((name, vector, "f8") for name, vector in vectors.items()),
            ("policy", found.policy, f"i{found.policy.dtype.itemsize}"),
        )
        if array.dtype.str[1:] != kind or array.ndim != 1
    ]
    pairs = None if wrong else policy_pairs(mdp, found.policy)
    if pairs is None:
        return wrong or ["the policy takes an action that is not available"]
    live = ~mdp.terminal
    open_pairs = live[mdp.pair_state]
    wrong += [
        f"{name} is not finite, or not 0 in terminal states"
        for name, vector in vectors.items()
        if not np.isfinite(vector).all() or vector[~live].any()
    ]
    gain, error = gains(mdp, found.weight, earning=False)
    if not ((found.weight[live] > 0).all() and (gain < -error)[open_pairs].all()):
        wrong.append("the weights do not prove that the Bellman equations have one solution")
    gain, error = gains(mdp, found.upper)
    if not (gain <= -error)[open_pairs].all():
        wrong.append("the upper values are not proven to be above the optimal ones")
    gain, error = gains(mdp, found.lower)
    if not (gain >= error)[pairs[live]].all():
        wrong.append("the lower values are not proven to be below the policy's")
    return wrong


def gains(mdp: MDP, value: Floats, *, earning: bool = True) -> tuple[Floats, Floats]:
    """Return r + γ P V - V(s) for each pair (L,) with a bound (L,) on its rounding error."""
    table, matrix, rate = mdp.table, mdp.transition, mdp.discount
    terms = np.diff(table.offsets) * 1.0
    steps, flow, total = np.empty(mdp.n_pairs), np.empty(mdp.n_pairs), np.empty(mdp.n_pairs)
    cuts = np.unique([*np.searchsorted(matrix.indptr, range(0, matrix.nnz, CHUNK)), mdp.n_pairs])
    with np.errstate(all="ignore"):
        for first, last in pairwise(cuts.tolist()):
            begin, end = matrix.indptr[first], matrix.indptr[last]
            own = np.repeat(
                value[mdp.pair_state[first:last]], np.diff(matrix.indptr[first : last + 1])
            )
            share, begins = matrix.data[begin:end], matrix.indptr[first:last] - begin
            term = share * (value[matrix.indices[begin:end]] - own)
            steps[first:last] = np.add.reduceat(term, begins)
            flow[first:last] = np.add.reduceat(np.abs(term), begins)
            total[first:last] = np.add.reduceat(share, begins)
        own = value[mdp.pair_state]
        leak = float(1 - mdp.discount_exact)  # of 1 - γ Σ P, where rows sum to 1
        reward, reward_error = mdp.reward * earning, UNIT * np.abs(mdp.reward) * earning
        floats = np.float64 in (table.weight.dtype, table.gain.dtype)
        if earning and floats and table.joint:
            size = np.add.reduceat(
                table.probabilities() * np.abs(table.gains()), table.offsets[:-1]
            )
            reward_error = (terms + 4) * UNIT * size
        error = (2 * terms + 8) * UNIT * rate * flow + reward_error
        error += 4 * UNIT * (np.abs(reward) + np.abs(leak * own))
        if not table.sums_to_one:
            error += rate * (np.abs(total - 1) + 2 * terms * UNIT) * np.abs(own)
        error = error * SLACK + TINY * (terms + 1) * (1 + np.abs(value).max())
        return np.asarray(reward + rate * steps - leak * own), np.asarray(error)
