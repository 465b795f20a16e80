"""The values of a policy in every state, with bounds on their errors: V(s) = E[r + γ V(s')].

The equation has one solution below discount 1, and at discount 1 among the states that end surely.
If a run may earn forever, the mean return is the optimum of the model whose only actions are those
of the policy.
"""

from __future__ import annotations

import warnings
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import COMPILED, Floats
from exact_mdp.solvers.bounds.gains import SLACK, BoundedVector
from exact_mdp.solvers.claims import PrecisionWarning, SolverError
from exact_mdp.solvers.dynamic.methods import ModifiedPolicyIteration
from exact_mdp.solvers.dynamic.values import NEARLY_ONE
from exact_mdp.solvers.total import solve_total
from exact_mdp.solvers.values.policy_chain import PolicyChain, split_infinite_returns


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyValues(BoundedVector):
    """The values (S,) of a policy, with the chain that has them.

    NaN and infinity if a mean is unknown: at discount 1 in states that no episode visits, if the
    policy may go on forever in some of them.
    """

    chain: PolicyChain  # classes of states without rewards are terminal
    settled: bool = True  # False if an episode may go on forever and earn rewards


def find_policy_values(given: PolicyChain) -> PolicyValues:
    """Return the mean return of a policy from every state.

    Raises ModelError and SolverError as `evaluate` does.
    """
    # At discount 1, make classes without rewards terminal. If a run may earn forever, there is
    # nothing to add up: the mean is the optimum of the model that has no other actions.
    chain = given
    lost: object = True
    with suppress(ModelError):  # the return may have no limit while the mean return has one
        chain, lost = split_infinite_returns(given)
    if lost:
        alone = solve_total(given.model)
        return PolicyValues(chain=given, value=alone.value, error=alone.state_error, settled=False)
    mdp = chain.mdp
    # V = r + γ P V has one solution in states that end surely, and everywhere below discount 1.
    if mdp.discount_exact == 1:
        known = chain.reaches_goal
    else:
        known = np.ones_like(mdp.terminal)
    reward, error = chain.reward
    point = _evaluate_closely(
        chain, np.where(known, reward, 0.0), np.where(known, error, 0.0) * SLACK
    )
    value, bound = np.where(known, point.value, np.nan), np.where(known, point.error, np.inf)
    # The other states lie off the policy's way from the start; a solver may know their values.
    if not known.all():
        with suppress(ModelError, SolverError):
            alone = solve_total(given.model)
            value = np.where(known, value, alone.value)
            bound = np.where(known, bound, alone.state_error)
    return PolicyValues(chain=chain, value=value, error=bound)


def _evaluate_closely(chain: PolicyChain, reward: Floats, error: Floats) -> BoundedVector:
    """Return a policy's values by its equations, or next to discount 1 by iteration."""
    mdp = chain.mdp
    # Next to 1 the equations are ill-conditioned; modified policy iteration has closer bounds.
    near = mdp.discount > NEARLY_ONE and mdp.discount_exact != 1
    if near and (chain.pure or mdp.n_transitions < COMPILED):
        with suppress(ModelError, SolverError), warnings.catch_warnings():
            warnings.simplefilter("ignore", PrecisionWarning)
            alone = ModifiedPolicyIteration().solve(chain.model)
            return BoundedVector(value=np.array(alone.value), error=np.array(alone.state_error))
    return chain.discounted.solve(reward, error)
