"""Values of many policies of an acyclic model, one pass from the end for each.

Backward induction over the rows of a sparse model, with its rounding errors, in one pass.

What is computed, and why the errors bound what they do, is said in
`solvers.dynamic.backward_induction`.
"""

from __future__ import annotations

from exact_mdp.mdp.forms.compiling import at, compiled, span
from exact_mdp.mdp.table import Floats, Numbers


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
        States to compute, each behind those that it leads to; all others have the value 0.
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


UNIT = 2.0**-53 * (1 + 2.0**-10)
INFINITY = float("inf")


@compiled
def backward(
    order: Numbers,
    pair_offsets: Numbers,
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    reward: Floats,
    discount: float,
    terminal: Numbers,
    extra: int,
    value: Floats,
    chosen: Numbers,
    level: Numbers,
    above: Floats,
    below: Floats,
    q: Floats,
    doubt: Floats,
) -> int:
    """Fill value, chosen, level (S,) and the rounding errors by level above, below (S+1,).

    Parameters
    ----------
    order : (S,) or (0,) ints
        States, each behind all that it leads to; from the last number to the first if empty.
    extra : int
        How often each probability was rounded.
    q, doubt : (at least the greatest number of pairs of a state,)
        Room to work in.

    Returns
    -------
    int
        The greatest level.
    """
    states, deepest = len(pair_offsets) - 1, 0
    for number in range(states):
        state = order[number] if len(order) > 0 else states - 1 - number
        begin, end = pair_offsets[state], pair_offsets[state + 1]
        if terminal[state]:
            value[state], chosen[state], level[state] = 0.0, begin, 0
            continue
        height, best, worst = 0, -INFINITY, 0.0
        for pair in range(begin, end):
            first, last = indptr[pair], indptr[pair + 1]
            base = value[indices[first]]  # rows sum to 1: differences from it will do
            total, flow = 0.0, 0.0
            for i in span(first, last):
                following = at(indices[i])
                term = data[i] * (value[following] - base)
                total += term
                flow += abs(term)
                height = max(height, level[following])
            ahead = discount * (base + total)
            rounding = (last - first + extra + 8) * UNIT * (discount * flow)
            rounding += 6 * UNIT * (abs(ahead) + abs(reward[pair]))
            q[pair - begin] = reward[pair] + ahead
            doubt[pair - begin] = rounding
            best = max(best, reward[pair] + ahead)
            worst = max(worst, rounding)
        height += 1
        noise, bar = 16 * UNIT * abs(best), -INFINITY
        for i in range(end - begin):
            bar = max(bar, q[i] - (2 * doubt[i] + noise))
        taken = 0
        while taken < end - begin - 1 and q[taken] + (2 * doubt[taken] + noise) < bar:
            taken += 1
        value[state], chosen[state], level[state] = best, begin + taken, height
        above[height] = max(above[height], worst)
        below[height] = max(below[height], doubt[taken] + (best - q[taken]))
        deepest = max(deepest, height)
    return deepest
