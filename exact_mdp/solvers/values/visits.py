"""Expected visits of a policy, its steps until the end, and the probability of events.

    d(s') = μ(s') + γ Σ_s d(s) P_π(s, s')         expected discounted visits
    τ(s)  = 1 + Σ_s' P_π(s, s') τ(s')             expected steps until a terminal state
    h(s)  = Σ p + Σ' p h(s')                      probability that an event ever happens

where the first sum of the last line runs over the outcomes with the event and the second over the
others. d, spread over the pairs that the policy takes, is the occupancy measure (Puterman, Markov
Decision Processes, 1994, section 6.9; absorption: Kemeny and Snell, Finite Markov Chains, 1960,
chapter 3).
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.graph import closure
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import gamma
from exact_mdp.solvers.bounds.linear import FixedPoint, LinearSystem
from exact_mdp.solvers.values.policy_chain import Equations, Mask, PolicyChain


def pair_visits(chain: PolicyChain, found: FixedPoint) -> Floats:
    """Return (L,) the expected discounted number of uses of each pair, from discounted visits.

    Below discount 1 they sum to 1 / (1 - γ), terminal states included, in which a policy stays for
    ever. At discount 1 the pairs of terminal states are left at 0.
    """
    mdp = chain.mdp
    stay = 0.0 if mdp.discount_exact == 1 else float(1 / (1 - mdp.discount_exact))
    return (found.value * np.where(mdp.terminal, stay, 1.0))[mdp.pair_state] * chain.weights


def steps(chain: PolicyChain) -> FixedPoint:
    """Return (S,) expected steps until a terminal state, 0 where it may not come."""
    return chain.undiscounted.solve((chain.ends & ~chain.mdp.terminal).astype(np.float64))


def ever(chain: PolicyChain, happens: Mask) -> FixedPoint:
    """Return (S,) the probability that one of the marked outcomes (N,) ever happens."""
    states, source, following = chain.mdp.n_states, chain.source, chain.table.next
    live = ~chain.mdp.terminal[source]  # nothing happens in an end
    chance = chain.total(np.where(happens & live, chain.probability, 0.0))
    # Elsewhere the probability is 0; among these states the equation has a single solution.
    possible = closure(chain.graph.T.tocsr(), chance > 0)
    on = ~happens & possible[source] & possible[following] & live
    entries = (chain.probability[on], (source[on], following[on]))
    matrix = sp.csr_array(entries, (states, states))
    roundings = chain.roundings + int(chain.outcomes.max())
    system = LinearSystem(matrix, 1.0, order=chain.order, roundings=roundings)
    equations = Equations(chain=chain, rate=Fraction(1), live=possible, system=system, left_out=~on)
    found = equations.solve(chance, gamma(chain.outcomes + chain.roundings) * chance)
    return FixedPoint(value=np.clip(found.value, 0.0, 1.0), error=found.error)
