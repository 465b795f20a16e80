"""Where a solver begins: with a known policy, or with values near the optimum.

Bounds hold around any values (`solvers.bounds.bounds`), and policy iteration improves any policy,
so that what is known beforehand changes how long a solver takes, never what its answer claims.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, ShapeError
from exact_mdp.mdp.forms.numbers import refuse_masked
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.bounds.bounds import levels
from exact_mdp.solvers.bounds.linear import LinearSystem, policy_chain
from exact_mdp.solvers.solution import Solution


def pairs_of(mdp: MDP, start: Any) -> Integers:
    """Return (S,) the pairs of a known policy."""
    policy = Policy.of(mdp, start)
    if not policy.deterministic:
        raise ModelError(
            "the policy is mixed: it draws its actions",
            where="start",
            fix="give a solution of this model, a deterministic policy, or an action number for "
            "each state",
        )
    return np.flatnonzero(policy.weights(mdp))


def values_of(mdp: MDP, start: Any) -> Floats:
    """Return (S,) known values, 0 where all is over: those given, or those of a policy."""
    value = np.zeros(mdp.n_states) if start is None else given_values(mdp, start)
    if value is None:
        value = evaluated(mdp, pairs_of(mdp, start))
    return np.where(mdp.terminal, 0.0, value)


def evaluated(mdp: MDP, pairs: Integers) -> Floats:
    """Return (S,) the values of the policy that takes `pairs` (S,), up to rounding."""
    chain, reward = policy_chain(mdp, pairs)
    return LinearSystem(chain, mdp.discount, order=levels(mdp)).approximate(reward)


def given_values(mdp: MDP, start: Any) -> Floats | None:
    """Return (S,) values that are given, of a solution or as an array of floats; else None."""
    refuse_masked(start, "start")
    array = start.value if isinstance(start, Solution) else _floats(start)
    if array is None:
        return None
    if array.shape != (mdp.n_states,) or not np.isfinite(array).all():
        raise ShapeError(
            f"values of shape {array.shape}, or not finite, for {mdp.n_states} states",
            where="start",
            fix="give one finite float for each state, or a policy",
        )
    return np.asarray(array, dtype=np.float64)


def _floats(start: Any) -> Floats | None:
    """Return an array or a list of floats as an array (S,); None for others."""
    if isinstance(start, list | tuple) and start and all(isinstance(x, float) for x in start):
        start = np.array(start)
    found = isinstance(start, np.ndarray) and start.dtype.kind == "f" and start.ndim == 1
    return start if found else None


def opposite(mdp: MDP, start: Any) -> Any:
    """Return what is known for the model of the other sense: values negated, a policy as it is."""
    if isinstance(start, Solution):
        return start.negated(start.mdp.maximised) if start.mdp.sense == "min" else start.policy
    value = None if start is None else given_values(mdp, start)
    return start if value is None else -value
