"""Exact values of many deterministic policies that read some columns of the state.

    V(s) = r(l) + γ Σ_s' P(l, s') V(s'),   l the pair that the policy takes in s,

is computed for each policy in one pass from the end where the model has no cycles; otherwise policy
by policy. The error bound counts every rounding: a state's value is a sum of n products, so with
d the length of the longest path and W the same recursion over absolute values, it is at most
γ(d (n + 6)) W (Higham, Accuracy and Stability of Numerical Algorithms, 2002, section 3.1).
"""

from __future__ import annotations

import numpy as np

from exact_mdp.mdp.graph import reachable
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Numbers
from exact_mdp.solvers.bounds.bounds import levels
from exact_mdp.solvers.bounds.gains import SLACK, TINY, gamma
from exact_mdp.solvers.bounds.linear import FixedPoint
from exact_mdp.solvers.learning.sampler import Rows, as_policy
from exact_mdp.solvers.values.evaluate import evaluate


def policy_values(mdp: MDP, rows: Rows, policies: Numbers) -> FixedPoint:
    """Return the start values (U,) of policies (U, K), an action number for each of K rows."""
    level = levels(mdp)
    if level is None:
        found = [evaluate(mdp, as_policy(mdp, rows.space, policy)) for policy in policies]
        return FixedPoint(
            value=np.array([each.mean for each in found]),
            error=np.array([each.start.error for each in found]),
        )
    asked = np.flatnonzero(reachable(mdp) & ~mdp.terminal)
    order = asked[np.argsort(level[asked], kind="stable")]
    matrix = mdp.transition
    value, size = np.empty(len(policies)), np.empty(len(policies))
    from exact_mdp.solvers import kernels

    kernels.policy_values(
        order,
        rows.key,
        _pairs(mdp),
        matrix.indptr.astype(np.int64),
        matrix.indices.astype(np.int64),
        np.array(matrix.data),
        np.array(mdp.reward),
        mdp.discount,
        np.array(mdp.start_distribution),
        np.ascontiguousarray(policies, dtype=np.int16),
        np.zeros(mdp.n_states),
        np.zeros(mdp.n_states),
        value,
        size,
    )
    longest = int(np.diff(matrix.indptr).max())
    depth = int(level[asked].max(initial=0))
    terms = depth * (longest + 6) + mdp.n_states + 4
    error = (gamma(terms) * size + TINY * terms) * SLACK
    return FixedPoint(value=value, error=error)


def _pairs(mdp: MDP) -> Numbers:
    """Return (S, A) the pair of each state and action; of a forced state its only one; else -1."""
    pair = np.full((mdp.n_states, mdp.n_actions), -1, dtype=np.int64)
    pair[mdp.pair_state, mdp.pair_action] = np.arange(mdp.n_pairs)
    pair[mdp.forced] = mdp.pair_offsets[:-1][mdp.forced][:, None]
    return pair
