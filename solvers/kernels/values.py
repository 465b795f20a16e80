"""Values of many policies of an acyclic model, one pass from the end for each."""

from __future__ import annotations

from mdp.table import Floats, Numbers
from solvers.kernels.compiling import at, compiled, span


@compiled
def policy_values(
    order: Numbers,
    key: Numbers,
    pair: Numbers,
    indptr: Numbers,
    indices: Numbers,
    probability: Floats,
    reward: Floats,
    discount: float,
    start: Floats,
    policies: Numbers,
    v: Floats,
    w: Floats,
    value: Floats,
    size: Floats,
) -> None:
    """Write start values of the `policies` (U, K) of an acyclic model into `value` (U,).

    Parameters
    ----------
    order : (M,) int64
        States to compute, each behind those that it leads to; all others are worth 0.
    pair : (S, A) int64
        Pair of each state and action; the only one of a state without choice.
    start : (S,)
        First states' probabilities.
    v, w : (S,)
        Room to work in, 0 in the states that are not computed.
    size : (U,)
        The same sums over absolute values, to bound the rounding errors with.
    """
    for number in range(len(policies)):
        policy, total, magnitude = policies[number], 0.0, 0.0
        for state in order:
            taken = pair[state, policy[key[state]]]
            ahead, beyond = 0.0, 0.0
            for i in span(indptr[taken], indptr[taken + 1]):
                ahead += probability[i] * v[at(indices[i])]
                beyond += probability[i] * w[at(indices[i])]
            v[state] = reward[taken] + discount * ahead
            w[state] = abs(reward[taken]) + discount * beyond
            total += start[state] * v[state]
            magnitude += start[state] * w[state]
        value[number], size[number] = total, magnitude
