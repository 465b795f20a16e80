"""The values with which a search begins: zeros, given values, or the values of a given policy."""

from __future__ import annotations

from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, ShapeError
from exact_mdp.mdp.forms.numbers import refuse_masked
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.bounds import evaluate_pairs
from exact_mdp.solvers.solution import Solution


def read_start_values(mdp: MDP, start: Any) -> Floats:
    """Return the values (S,) to begin with: given values, or the values of a given policy."""
    if start is None:
        return np.zeros(mdp.n_states)
    value = given_values(mdp, start)
    if value is None:
        policy = Policy.of(mdp, start)
        if not policy.deterministic:
            raise ModelError(
                "the policy is mixed: it draws its actions",
                where="start",
                fix="give a solution of this model, a deterministic policy, or an action number "
                "for each state",
            )
        return evaluate_pairs(mdp, np.flatnonzero(policy.weights(mdp)))
    return np.where(mdp.terminal, 0.0, value)


def given_values(mdp: MDP, start: Any) -> Floats | None:
    """Return the values (S,) of a solution or an array of floats; None for anything else."""
    refuse_masked(start, "start")
    if isinstance(start, Solution):
        start = start.value
    if isinstance(start, list | tuple) and start and all(isinstance(x, float) for x in start):
        start = np.array(start)
    if not (isinstance(start, np.ndarray) and start.dtype.kind == "f" and start.ndim == 1):
        return None
    if start.shape != (mdp.n_states,) or not np.isfinite(start).all():
        raise ShapeError(
            f"values of shape {start.shape}, or not finite, for {mdp.n_states} states",
            where="start",
            fix="give one finite float for each state, or a policy",
        )
    return np.asarray(start, dtype=np.float64)


def orient_start(mdp: MDP, start: Any) -> Any:
    """Return the start for maximised rewards: values of costs negated, a policy unchanged."""
    if not mdp.sense.costs:
        return start
    if isinstance(start, Solution):
        return start.policy
    if start is None:
        return None
    value = given_values(mdp, start)
    if value is None:
        return start
    return -value
