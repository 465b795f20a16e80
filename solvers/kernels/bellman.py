"""Compiled passes over a model's transitions: improve, follow a policy, relax in place.

For an iterate V = h + c w, held as h (S,) and the shift c, the three loops compute from

    d(l) = r(l) + γ Σ_s' P(l, s') (h(s') - h(s)) - leak(l) h(s),    d_c(l) = d(l) - c m(l)

what pair l of state s would add to V(s); see `solvers.gains` for the form and its rounding errors,
and `solvers.bounds` for weights w and margins m. Each reads a transition once: a sum, its flow, the
greatest gain, the pair that has it and both bounds come out of one pass. `improve` and `follow`
write to each state's own place alone, so that blocks of states may run on several threads and give
the same bits whatever their number.
"""

from __future__ import annotations

import numpy as np

from mdp.table import Floats, Numbers
from solvers.kernels.compiling import compiled, inlined

UNIT = 2.0**-53
TINY = 2.0**-1000
SLACK = 1 + 2.0**-20


@inlined
def gamma(terms: float) -> float:
    """As `solvers.rounding.gamma`."""
    count = terms * UNIT
    return count / (1 - count) * (1 + 4 * UNIT)


@compiled
def leaks(
    first: int,
    last: int,
    offsets: Numbers,
    weight: Floats,
    discount: float,
    leak: float,
    out: Floats,
) -> float:
    """Write 1 - γ Σ p of pairs first … last-1 of floats into `out` (L,); return the worst error.

    The sum is compensated: with the roundings of its additions added up beside it, Σ p - 1 is off
    by its own rounding and γ(n)² (Σ p + 1) (Ogita, Rump and Oishi, SIAM J. Sci. Comput. 26, 2005,
    proposition 4.5).
    """
    worst = 0.0
    for row in range(first, last):
        total, lost = -1.0, 0.0
        for i in range(offsets[row], offsets[row + 1]):
            term = weight[i]
            after = total + term
            part = after - total
            lost += (total - (after - part)) + (term - part)
            total = after
        excess = discount * (total + lost)
        terms = offsets[row + 1] - offsets[row] + 1
        out[row] = leak - excess
        worst = max(worst, 2 * UNIT * leak + 8 * UNIT * abs(excess) + 4 * gamma(terms) ** 2)
    return worst


@compiled
def gains(
    first: int,
    last: int,
    pair_state: Numbers,
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    value: Floats,
    steps: Floats,
    flow: Floats,
) -> None:
    """Write Σ p (V' - V) and Σ p |V' - V| of pairs first … last-1 into `steps` and `flow` (L,)."""
    for pair in range(first, last):
        own, ahead, size = value[pair_state[pair]], 0.0, 0.0
        for i in range(indptr[pair], indptr[pair + 1]):
            term = data[i] * (value[indices[i]] - own)
            ahead += term
            size += abs(term)
        steps[pair], flow[pair] = ahead, size


@compiled
def margins(
    first: int,
    last: int,
    pair_state: Numbers,
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    leak: Floats,
    leak_error: float,
    merged: Numbers,
    discount: float,
    weight: Floats,
    tiny: float,
    least: Floats,
    most: Floats,
) -> None:
    """Write bounds (L,) of the margins w(s) - γ P_l w of pairs first … last-1; see `improve`."""
    for pair in range(first, last):
        own, ahead, flow = weight[pair_state[pair]], 0.0, 0.0
        for i in range(indptr[pair], indptr[pair + 1]):
            term = data[i] * (weight[indices[i]] - own)
            ahead += term
            flow += abs(term)
        lost = leak[pair] * own
        terms = merged[pair] if len(merged) else indptr[pair + 1] - indptr[pair]
        error = gamma(terms + 8) * discount * flow + gamma(4) * abs(lost)
        error = (error + leak_error * abs(own) + tiny * (terms + 1)) * SLACK
        margin = lost - discount * ahead
        least[pair], most[pair] = margin - error, margin + error


@compiled
def improve(
    first: int,
    last: int,
    pair_offsets: Numbers,
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    reward: Floats,
    reward_error: Floats,
    leak: Floats,
    leak_error: float,
    least: Floats,
    most: Floats,
    ended: Numbers,
    discount: float,
    merged: Numbers,
    value: Floats,
    shift: float,
    tiny: float,
    strict: bool,
    still: bool,
    step: Floats,
    pairs: Numbers,
    room: Floats,
    extremes: Floats,
) -> None:
    """Write the greatest d_c (S,) and its pair (S,) of states first … last-1, and the bounds.

    Parameters
    ----------
    reward_error : (L,)
        How far each reward may be from the exact one; of length 0 where it is rounded once.
    leak_error : float
        Greatest error of `leak`.
    least, most : (L,)
        Bounds of the margins m.
    ended : (S,) bool
        Terminal states; they are passed over.
    merged : (L,) ints
        Roundings in a row; of length 0 where there is one for each transition.
    tiny : float
        What underflow may cost each term.
    strict : bool
        Whether to take pairs for tied only where the errors of d let them be.
    still : bool
        Whether all values are the same, so that transitions add nothing and need not be read.
    pairs : (S,) int64
        Out: the first pair that no other beats by more than rounding.
    room : (2, K)
        For the K pairs of a state at most.
    extremes : (3,)
        Out: the least (d - error) / m of these pairs, the greatest (d + error) / m of all pairs,
        and the greatest noise; NaN where a number is beyond the range of floats. A ratio is divided
        out only where it seems to be beyond the last; the seeming is off by a rounding or two.
    """
    low, high, loudest, sound = np.inf, -np.inf, 0.0, True
    length, rounded, few = -1, 0.0, gamma(4)
    for state in range(first, last):
        begin, end = pair_offsets[state], pair_offsets[state + 1]
        if ended[state]:
            step[state], pairs[state] = 0.0, begin
            continue
        own = value[state]
        best, sure = -np.inf, -np.inf
        for pair in range(begin, end):
            ahead, flow = 0.0, 0.0
            after = indptr[pair] if still else indptr[pair + 1]
            for i in range(indptr[pair], after):
                term = data[i] * (value[indices[i]] - own)
                ahead += term
                flow += abs(term)
            earned, lost = reward[pair], leak[pair] * own
            flow *= discount
            gain = earned + (discount * ahead - lost)
            terms = merged[pair] if len(merged) else indptr[pair + 1] - indptr[pair]
            if terms != length:
                length, rounded = terms, gamma(terms + 8)
            error = rounded * flow + few * (abs(earned) + abs(lost))
            error += leak_error * abs(own) + tiny * (terms + 1)
            error += reward_error[pair] if len(reward_error) else UNIT * abs(earned) + TINY
            error *= SLACK
            noise = rounded * (flow + abs(own) + abs(earned)) + error
            if not noise < np.inf:
                sound = False
            above = gain + error
            margin = least[pair] if above > 0 else most[pair]
            if above > high * margin:
                high = above / margin
            loudest = max(loudest, noise)
            shifted = gain - shift * (0.5 * (least[pair] + most[pair]))
            tied = error if strict else noise
            room[0, pair - begin], room[1, pair - begin] = error - gain, shifted + tied
            best, sure = max(best, shifted), max(sure, shifted - tied)
        chosen = begin
        while chosen < end - 1 and not room[1, chosen - begin] >= sure:
            chosen += 1
        step[state], pairs[state] = best, chosen
        below = room[0, chosen - begin]
        margin = least[chosen] if below > 0 else most[chosen]
        if -below < low * margin:
            low = -below / margin
    extremes[0], extremes[1], extremes[2] = low, high, loudest
    if not sound:
        extremes[:] = np.nan


@compiled
def follow(
    first: int,
    last: int,
    pairs: Numbers,
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    reward: Floats,
    leak: Floats,
    least: Floats,
    most: Floats,
    ended: Numbers,
    discount: float,
    value: Floats,
    shift: float,
    step: Floats,
    extremes: Floats,
) -> None:
    """Write d_c (S,) of the policy's `pairs` (S,) in states first … last-1.

    Parameters
    ----------
    extremes : (2,)
        Out: the least and the greatest d_c / m.
    """
    low, high = np.inf, -np.inf
    for state in range(first, last):
        if ended[state]:
            step[state] = 0.0
            continue
        pair, own, ahead = pairs[state], value[state], 0.0
        for i in range(indptr[pair], indptr[pair + 1]):
            ahead += data[i] * (value[indices[i]] - own)
        margin = 0.5 * (least[pair] + most[pair])
        gain = reward[pair] + (discount * ahead - leak[pair] * own) - shift * margin
        step[state] = gain
        if gain < low * margin:
            low = gain / margin
        if gain > high * margin:
            high = gain / margin
    extremes[0], extremes[1] = low, high


@compiled
def relax(
    backward: bool,
    pair_offsets: Numbers,
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    reward: Floats,
    leak: Floats,
    least: Floats,
    most: Floats,
    ended: Numbers,
    discount: float,
    value: Floats,
    shift: float,
) -> float:
    """Make `value` (S,) satisfy the equation of each state in turn; return the greatest change.

    Gauss-Seidel, upward or downward in number: a state's gain is divided by 1 - γ P(l, s), so that
    staying is summed up at once.
    """
    states, largest = len(value), 0.0
    for number in range(states):
        state = states - 1 - number if backward else number
        if ended[state]:
            continue
        own, best = value[state], -np.inf
        for pair in range(pair_offsets[state], pair_offsets[state + 1]):
            ahead, away = 0.0, 0.0
            for i in range(indptr[pair], indptr[pair + 1]):
                if indices[i] != state:
                    ahead += data[i] * (value[indices[i]] - own)
                    away += data[i]
            gain = reward[pair] + (discount * ahead - leak[pair] * own)
            gain -= shift * (0.5 * (least[pair] + most[pair]))
            best = max(best, gain / (discount * away + leak[pair]))
        value[state] = own + best
        largest = max(largest, abs(best))
    return largest
