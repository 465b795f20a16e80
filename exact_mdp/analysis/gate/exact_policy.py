"""The value of any policy, and its visits, in rational arithmetic.

The rows Σ_l π(l) P_l and rewards Σ_l π(l) r(l) are built in integers. That the equations have one
solution is known wherever the optimum has been proven: a rank that falls along every pair, or
w > γ P w, holds for mixtures of rows, too.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.solvers.exact.levels import Level, fraction
from exact_mdp.solvers.exact.linear import evaluated, visited
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.totals import Flow
from exact_mdp.solvers.values.policy_chain import PolicyChain


def exact_policy(chain: PolicyChain) -> Level:
    """Return the exact values of a policy whose equations are known to have one solution.

    States from which the policy need not end at discount 1 have no value, and 0 stands for it.
    """
    rows = chain.rows()
    if chain.mdp.discount_exact == 1:
        rows = replace(rows, terminal=rows.terminal | ~chain.ends)
    (level,) = evaluated(rows, np.arange(chain.mdp.n_states))
    return level


def flow_of(of: Objectives, policy: PolicyLike) -> Flow:
    """Return the expected visits of pairs under any policy, of which totals are made."""
    chain = replace(PolicyChain.of(of.mdp, policy), mdp=of.ending)
    level, pairs, visits = exact_visits(chain), list[int](), list[Fraction]()
    for s in np.flatnonzero(chain.reached & ~of.ending.terminal).tolist():
        if number := fraction(level.top[s], level.below[level.group[s]]):
            shares = chain.exact_weights(s)
            pairs += shares
            visits += [share * number for share in shares.values()]
    return Flow(pairs=np.array(pairs, dtype=np.int64), visits=Level.of(visits))


def exact_visits(chain: PolicyChain) -> Level:
    """Return the expected discounted visits from the start; terminal states count arrivals."""
    (visits,) = visited(chain.rows(), chain.reached & ~chain.mdp.terminal, chain.mdp.start)
    return visits
