"""Compiled passes over a model's transitions: improve, judge, follow a policy, relax in place.

For an iterate V = h + c w, held as h (S,) and the shift c, the loops compute from

    d(l) = r(l) + γ Σ_s' P(l, s') (h(s') - h(s)) - leak(l) h(s),    d_c(l) = d(l) - c m(l)

what pair l of state s would add to V(s); see `solvers.bounds.gains` for the form and its rounding
errors, and `solvers.bounds.bounds` for weights w and margins m. Each reads a transition at most
once: a sum, its flow, the greatest gain, the pair that has it and both bounds come out of one pass.
All but `relax` write to each state's own place alone, so that blocks of states may run on several
threads and give the same bits whatever their number.
"""

from __future__ import annotations

import numpy as np

from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.kernels.compiling import at, compiled, inlined, span

UNIT = 2.0**-53
TINY = 2.0**-1000
SLACK = 1 + 2.0**-20


@inlined
def gamma(terms: float) -> float:
    """As `solvers.bounds.gains.gamma`."""
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

    Sums are of integers, and so exact: of the multiples of 2^-40 in each p, and of the multiples of
    2^-84 in what is left of it. What is then left is less than 2^-84.
    """
    worst = 0.0
    for row in range(first, last):
        whole, rest = np.int64(-(2**40)), np.int64(0)
        for i in span(offsets[row], offsets[row + 1]):
            scaled = weight[i] * 2.0**40
            part = np.int64(scaled)
            whole += part
            rest += np.int64((scaled - part) * 2.0**44)
        excess = discount * (whole * 2.0**-40 + rest * 2.0**-84)
        lost = (offsets[row + 1] - offsets[row]) * 2.0**-84
        out[row] = leak - excess
        worst = max(worst, 2 * UNIT * leak + 8 * UNIT * abs(excess) + lost)
    return worst


@inlined
def ahead_of(
    first: int, last: int, indices: Numbers, data: Floats, value: Floats, own: float
) -> float:
    """Return Σ p (V' - V) of transitions first … last-1."""
    ahead = 0.0
    for i in span(first, last):
        ahead += data[i] * (value[at(indices[i])] - own)
    return ahead


@inlined
def added(
    first: int, last: int, indices: Numbers, data: Floats, value: Floats, own: float
) -> tuple[float, float]:
    """Return Σ p (V' - V) and Σ p |V' - V| of transitions first … last-1."""
    ahead, flow = 0.0, 0.0
    for i in span(first, last):
        term = data[i] * (value[at(indices[i])] - own)
        ahead += term
        flow += abs(term)
    return ahead, flow


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
        begin, end, own = indptr[pair], indptr[pair + 1], value[pair_state[pair]]
        steps[pair], flow[pair] = added(begin, end, indices, data, value, own)


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
    ended: Numbers,
    weight: Floats,
    tiny: float,
    out: Floats,
) -> float:
    """Write the margins w(s) - γ P_l w of pairs first … last-1 into `out` (L,); see `improve`.

    Returns the greatest error. Pairs of terminal states are given a margin of 1.
    """
    worst = 0.0
    for pair in range(first, last):
        state = pair_state[pair]
        if ended[state]:
            out[pair] = 1.0
            continue
        own = weight[state]
        ahead, flow = added(indptr[pair], indptr[pair + 1], indices, data, weight, own)
        lost = leak[pair] * own
        terms = merged[pair] if len(merged) else indptr[pair + 1] - indptr[pair]
        error = gamma(terms + 8) * discount * flow + gamma(4) * abs(lost)
        error = (error + leak_error * abs(own) + tiny * (terms + 1)) * SLACK
        out[pair] = lost - discount * ahead
        if not error <= worst:
            worst = error
    return worst


@compiled
def climb(value: Floats, before: Floats) -> float:
    """Return the greatest rise of any value (S,) since `before` (S,), which is brought up to it."""
    most = -np.inf
    for state in range(len(value)):
        most = max(most, value[state] - before[state])
        before[state] = value[state]
    return most


@inlined
def copy_row(
    state: int,
    pair: int,
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    reward: Floats,
    leak: Floats,
    margin: Floats,
    slots: Numbers,
    ends: Numbers,
    chain_indices: Numbers,
    chain_data: Floats,
    chain: Floats,
) -> None:
    """Put the row of a pair where the policy's row of its state belongs; see `follow`."""
    place = slots[state]
    for i in range(indptr[pair], indptr[pair + 1]):
        chain_indices[place], chain_data[place] = indices[i], data[i]
        place += 1
    ends[state] = place
    chain[0, state], chain[1, state], chain[2, state] = reward[pair], leak[pair], margin[pair]


@compiled
def improve(
    first: int,
    last: int,
    pair_offsets: Numbers,
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    reward: Floats,
    leak: Floats,
    margin: Floats,
    ended: Numbers,
    discount: float,
    value: Floats,
    shift: float,
    known: bool,
    rise: float,
    error: float,
    ceilings: Floats,
    slots: Numbers,
    ends: Numbers,
    chain_indices: Numbers,
    chain_data: Floats,
    chain: Floats,
    step: Floats,
    pairs: Numbers,
    extremes: Floats,
) -> None:
    """Write the greatest d_c (S,) and its pair (S,) of states first … last-1.

    The pair that the policy had before, or else the one that promises most, is looked at first, and
    stays where no other is better. Others are passed over where their ceiling says that they are
    not.

    Parameters
    ----------
    margin : (L,)
        The margins m.
    ended : (S,) bool
        Terminal states; they are passed over.
    known : bool
        Whether `pairs` and the policy's rows hold anything yet.
    rise : float
        How much γ P_l h has risen in all, at most.
    error : float
        Greatest error of any d, and of what is written into `ceilings`.
    ceilings : (L,)
        In and out: r(l) + γ P_l h is at most this and `rise`. Renewed for pairs that are looked at,
        other than those of the policy.
    slots, ends, chain_indices, chain_data, chain
        In and out: the rows of `pairs`, see `follow`.
    pairs : (S,) int64
        In and out: the policy.
    extremes : (2,)
        Out: the least d / m of the policy found, and the greatest of pairs that were looked at.
    """
    low, high = np.inf, -np.inf
    for number in range(first, last):
        state = at(number)
        begin, end = pair_offsets[state], pair_offsets[at(number + 1)]
        if ended[state]:
            step[state], pairs[state] = 0.0, begin
            continue
        own = value[state]
        if known:
            before, start, stop = pairs[state], slots[state], ends[state]
            ahead = ahead_of(start, stop, chain_indices, chain_data, value, own)
        else:
            before = begin
            for pair in range(begin + 1, end):
                if ceilings[pair] > ceilings[before]:
                    before = pair
            ahead = ahead_of(indptr[before], indptr[before + 1], indices, data, value, own)
        first_gain = reward[before] + (discount * ahead - leak[before] * own)
        best, chosen = first_gain, before
        high = max(high, first_gain / margin[at(before)])
        for pair in range(begin, end):
            place = at(pair)
            if pair == before or ceilings[place] + (rise - own) < best:
                continue
            ahead = ahead_of(indptr[place], indptr[at(pair + 1)], indices, data, value, own)
            gain = reward[place] + (discount * ahead - leak[place] * own)
            ceilings[place] = gain + error + (own - rise)
            high = max(high, gain / margin[place])
            if gain > best:
                best, chosen = gain, pair
        if chosen != before or not known:
            ceilings[before] = first_gain + error + (own - rise)
            model = (indptr, indices, data, reward, leak, margin)
            copy_row(state, chosen, *model, slots, ends, chain_indices, chain_data, chain)
        step[state], pairs[state] = best - shift * chain[2, state], chosen
        low = min(low, best / chain[2, state])
    extremes[0], extremes[1] = low, high


@compiled
def judge(
    first: int,
    last: int,
    pair_offsets: Numbers,
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    reward: Floats,
    leak: Floats,
    margin: Floats,
    ended: Numbers,
    discount: float,
    reward_error: Floats,
    leak_error: float,
    margin_error: float,
    merged: Numbers,
    tiny: float,
    rounding: Floats,
    value: Floats,
    shift: float,
    strict: bool,
    still: bool,
    known: bool,
    rise: float,
    spare: float,
    alike: float,
    ceilings: Floats,
    policy: Numbers,
    slots: Numbers,
    ends: Numbers,
    chain_indices: Numbers,
    chain_data: Floats,
    chain: Floats,
    step: Floats,
    pairs: Numbers,
    room: Floats,
    extremes: Floats,
) -> None:
    """Write the greatest d_c (S,) and its pair (S,) of states first … last-1, and proven bounds.

    A pair is passed over where its ceiling proves that it is beaten, and that it does not set the
    upper bound.

    Parameters
    ----------
    reward_error : (L,)
        How far each reward may be from the exact one; of length 0 where it is rounded once.
    leak_error, margin_error : float
        Greatest errors of `leak` and of `margin`.
    merged : (L,) ints
        Roundings in a row; of length 0 where there is one for each transition.
    tiny : float
        What underflow may cost each term.
    rounding : (K,)
        γ(n + 8) of rows of n roundings.
    strict : bool
        Whether to take pairs for tied only where the errors of d let them be.
    still : bool
        Whether all values are the same, so that transitions add nothing and need not be read.
    known, rise, ceilings, slots, ends, chain_indices, chain_data, chain
        What improving passes left; see `improve`. Nothing of it is changed.
    spare, alike : float
        Bounds over all pairs: of -c m(l) and how far from the best a pair may be for a tie; of
        m(l) / m(l') from below.
    policy : (S,) int64
        The pairs of those rows.
    pairs : (S,) int64
        Out: the first pair that no other beats by more than rounding.
    room : (2, K)
        For the K pairs of a state at most.
    extremes : (3,)
        Out: the least (d - error) / m of these pairs, the greatest (d + error) / m of all pairs,
        and the greatest noise; NaN where a number is beyond the range of floats. A ratio is divided
        out only where it seems to be beyond the last; the seeming is off by a rounding or two.
    """
    low, high, loudest, sound, few = np.inf, -np.inf, 0.0, True, gamma(4)
    for state in range(first, last):
        begin, end = pair_offsets[state], pair_offsets[state + 1]
        if ended[state]:
            step[state], pairs[state] = 0.0, begin
            continue
        own, before = value[state], policy[state] if known else begin
        best, sure, limit = -np.inf, -np.inf, -np.inf
        for turn in range(begin - 1, end):  # the pair of the policy comes first
            if turn == before:
                continue
            pair = before if turn < begin else turn
            place = pair - begin
            if turn >= begin:
                ceiling = ceilings[pair] + (rise - own)
                ceiling += 4 * UNIT * (abs(ceilings[pair]) + (abs(rise) + abs(own)))
                if ceiling + spare < sure and ceiling <= limit:
                    room[1, place] = -np.inf
                    continue
            ahead, flow, earned, lost = 0.0, 0.0, reward[pair], leak[pair] * own
            start, stop = indptr[pair], indptr[pair + 1]
            if known and turn < begin:
                ahead, flow = added(
                    slots[state], ends[state], chain_indices, chain_data, value, own
                )
            elif not still:
                ahead, flow = added(start, stop, indices, data, value, own)
            flow *= discount
            gain = earned + (discount * ahead - lost)
            terms = merged[pair] if len(merged) else stop - start
            error = rounding[terms] * flow + few * (abs(earned) + abs(lost))
            error += leak_error * abs(own) + tiny * (terms + 1)
            error += reward_error[pair] if len(reward_error) else UNIT * abs(earned) + TINY
            error *= SLACK
            noise = rounding[terms] * (flow + abs(own) + abs(earned)) + error
            if not noise < np.inf:
                sound = False
            above = gain + error
            divisor = margin[pair] + (-margin_error if above > 0 else margin_error)
            if above > high * divisor:
                high = above / divisor
            limit = max(limit, above * alike if above > 0 else above / alike)
            loudest = max(loudest, noise)
            shifted = gain - shift * margin[pair]
            tied = error if strict else noise
            room[0, place], room[1, place] = error - gain, shifted + tied
            best, sure = max(best, shifted), max(sure, shifted - tied)
        chosen = begin
        while chosen < end - 1 and not room[1, chosen - begin] >= sure:
            chosen += 1
        step[state], pairs[state] = best, chosen
        below = room[0, chosen - begin]
        divisor = margin[chosen] + (-margin_error if below > 0 else margin_error)
        if -below < low * divisor:
            low = -below / divisor
    extremes[0], extremes[1], extremes[2] = low, high, loudest
    if not sound:
        extremes[:] = np.nan


@compiled
def follow(
    first: int,
    last: int,
    slots: Numbers,
    ends: Numbers,
    indices: Numbers,
    data: Floats,
    chain: Floats,
    ended: Numbers,
    discount: float,
    value: Floats,
    shift: float,
    step: Floats,
    extremes: Floats,
) -> None:
    """Write d_c (S,) of the one pair of each of the states first … last-1 that a policy takes.

    Parameters
    ----------
    slots, ends : (S+1,), (S,)
        The row of state s is slots[s] … ends[s]-1, which is no further than slots[s+1].
    indices, data
        Next states and probabilities.
    chain : (3, S)
        Reward, leak and margin of the pairs.
    extremes : (2,)
        Out: the least and the greatest d_c / m.
    """
    low, high = np.inf, -np.inf
    for state in span(first, last):
        if ended[state]:
            step[state] = 0.0
            continue
        own, margin = value[state], chain[2, state]
        ahead = ahead_of(slots[state], ends[state], indices, data, value, own)
        gain = chain[0, state] + (discount * ahead - chain[1, state] * own) - shift * margin
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
    margin: Floats,
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
            ahead, stay = 0.0, 0.0
            for i in span(indptr[pair], indptr[pair + 1]):
                ahead += data[i] * (value[at(indices[i])] - own)
                if indices[i] == state:
                    stay = data[i]
            gain = reward[pair] + (discount * ahead - leak[pair] * own)
            gain -= shift * margin[pair]
            best = max(best, gain / (1 - discount * stay))
        value[state] = own + best
        largest = max(largest, abs(best))
    return largest
