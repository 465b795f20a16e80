"""Exact values of many deterministic policies that read some columns of the state.

    V(s) = r(l) + γ Σ_s' P(l, s') V(s'),   l the pair that the policy takes in s,

is computed for each policy in one pass from the end where the model has no cycles; otherwise policy
by policy. The error bound counts every rounding: a state's value is a sum of n products, so with
d the length of the longest path and W the same recursion over absolute values, it is at most
γ(d (n + 6)) W (Higham, Accuracy and Stability of Numerical Algorithms, 2002, section 3.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exact_mdp.mdp.chain import reachable
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.bounds.bounds import levels
from exact_mdp.solvers.bounds.gains import SLACK, TINY, gamma
from exact_mdp.solvers.learning.sampler import Rows, as_policy
from exact_mdp.solvers.values.evaluate import evaluate


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyValues:
    """Start values of U policies, and how far each may be from the exact one.

    Attributes
    ----------
    value, error : (U,)
    """

    value: Floats
    error: Floats


def policy_values(mdp: MDP, rows: Rows, policies: Numbers) -> PolicyValues:
    """Return the value of each policy from the start distribution, at the model's discount.

    Parameters
    ----------
    rows : Rows
        What the policies read.
    policies : (U, K) ints
        Action number of every row; in a state without choice its only action is taken.

    Raises
    ------
    ModelError, SolverError
        At discount 1, where a policy need not end.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.solvers.learning.sampler import rows_of
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> found = policy_values(mdp, rows_of(mdp), np.full((1, 16), 3))
    >>> round(float(found.value[0]), 6), bool(found.error[0] < 1e-9)
    (64.363644, True)
    """
    level = levels(mdp)
    if level is None:
        found = [evaluate(mdp, as_policy(mdp, rows.space, policy)) for policy in policies]
        return PolicyValues(
            value=np.array([each.mean for each in found]),
            error=np.array([each.error_bound for each in found]),
        )
    from exact_mdp.solvers import kernels

    asked = np.flatnonzero(reachable(mdp) & ~mdp.terminal)
    order = asked[np.argsort(level[asked], kind="stable")]
    matrix = mdp.transition
    value, size = np.empty(len(policies)), np.empty(len(policies))
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
    return PolicyValues(value=value, error=error)


def _pairs(mdp: MDP) -> Numbers:
    """Return (S, A) the pair of each state and action; of a forced state its only one; else -1."""
    pair = np.full((mdp.n_states, mdp.n_actions), -1, dtype=np.int64)
    pair[mdp.pair_state, mdp.pair_action] = np.arange(mdp.n_pairs)
    pair[mdp.forced] = mdp.pair_offsets[:-1][mdp.forced][:, None]
    return pair
