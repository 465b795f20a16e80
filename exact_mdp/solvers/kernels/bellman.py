"""Compiled passes over a model's transitions: improve, judge, follow a policy, relax in place.

For an iterate V = h + c w, held as h (S,) and the shift c, the loops compute from

    d(l) = r(l) + γ Σ_s' P(l, s') (h(s') - h(s)) - (1 - γ) h(s),    d_c(l) = d(l) - c m(l)

what pair l of state s would add to V(s); see `solvers.bounds.gains` for the form and its rounding
errors, and `solvers.bounds.bounds` for weights w and margins m. Each reads a transition at most
once: a sum, its flow, the greatest gain, the pair that has it and both bounds come out of one pass.
All but `relax` write to each state's own place alone, so that blocks of states may run on several
threads and give the same bits whatever their number.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exact_mdp.mdp.forms.compiling import at, compiled, inlined, span
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.solvers.kernels.linear import Rows

UNIT = 2.0**-53
TINY = 2.0**-1000
SLACK = 1 + 2.0**-20


class Model(NamedTuple):
    """A model's pairs: their rows, rewards r and margins m (L,); `ended` (S,); the leak 1 - γ."""

    offsets: Numbers
    indptr: Numbers
    indices: Numbers
    data: Floats
    reward: Floats
    margin: Floats
    ended: Numbers
    discount: float
    leak: float


class Slow(NamedTuple):
    """When sweeps are too slow: see `solvers.bounds.sweeps`."""

    first: int
    apart: int
    least: float


class Facts(NamedTuple):
    """Rounding errors: of rewards (L,) or (0,), the leak and margins; `rounding[n]` is γ(n + 8).

    `merged` (L,) counts the roundings in a row, (0,) where there is one for each transition, and
    `tiny` is what underflow may cost each term.
    """

    reward_error: Floats
    leak_error: float
    margin_error: float
    merged: Numbers
    tiny: float
    rounding: Floats


class Known(NamedTuple):
    """What earlier passes left: a policy (S,), its rows, and ceilings (L,).

    The row of state s is slots[s] … ends[s]-1 of `indices` and `data`, which are the model's own
    or, where rows are copied to stand side by side, those that can be written to as `columns` and
    `weights`; these have room for the longest row of each state, or are empty. `numbers` (2, S) are
    the reward and margin of its pair. r(l) + γ P_l h is at most the ceiling and `rise`, how
    much γ P_l h has risen in all. Where not `known`, there is no policy yet.
    """

    slots: Numbers
    ends: Numbers
    indices: Numbers
    data: Floats
    numbers: Floats
    pairs: Numbers
    ceilings: Floats
    rise: float
    known: bool
    columns: Numbers
    weights: Floats


@inlined
def gamma(terms: float) -> float:
    """As `solvers.bounds.gains.gamma`."""
    count = terms * UNIT
    return count / (1 - count) * (1 + 4 * UNIT)


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
    rows: Rows,
    value: Floats,
    steps: Floats,
    flow: Floats,
) -> None:
    """Write Σ p (V' - V) and Σ p |V' - V| of pairs first … last-1 into `steps` and `flow` (L,)."""
    indptr, indices, data = rows
    for pair in range(first, last):
        begin, end, own = indptr[pair], indptr[pair + 1], value[pair_state[pair]]
        steps[pair], flow[pair] = added(begin, end, indices, data, value, own)


@compiled
def climb(value: Floats, before: Floats) -> float:
    """Return the greatest rise of any value (S,) since `before` (S,), which is brought up to it."""
    most = -np.inf
    for state in range(len(value)):
        most = max(most, value[state] - before[state])
        before[state] = value[state]
    return most


@inlined
def take_row(state: int, pair: int, model: Model, policy: Known) -> None:
    """Make the row of a pair the policy's row of its state."""
    if len(policy.weights) > 0:
        place = policy.slots[state]
        for i in range(model.indptr[pair], model.indptr[pair + 1]):
            policy.columns[place], policy.weights[place] = model.indices[i], model.data[i]
            place += 1
        policy.ends[state] = place
    else:
        policy.slots[state], policy.ends[state] = model.indptr[pair], model.indptr[pair + 1]
    policy.numbers[0, state], policy.numbers[1, state] = model.reward[pair], model.margin[pair]


@compiled
def improve(
    first: int,
    last: int,
    model: Model,
    policy: Known,
    value: Floats,
    shift: float,
    error: float,
    spare: float,
    step: Floats,
    extremes: Floats,
) -> None:
    """Write the greatest d_c of states first … last-1 into `step` (S,), its pair into the policy.

    The pair that the policy had before, or else the one that promises most, is looked at first, and
    stays where no other is better. Others are passed over where their ceiling says that they are
    not; those of the pairs looked at are renewed. `error` bounds that of any d and ceiling, `spare`
    bounds -c m(l).
    `extremes` (2,) are the least d / m of the policy found, and the greatest of pairs looked at.
    """
    indptr, indices, data = model.indptr, model.indices, model.data
    reward, leak, margin, discount = model.reward, model.leak, model.margin, model.discount
    pairs, ceilings, rise, known = policy.pairs, policy.ceilings, policy.rise, policy.known
    low, high = np.inf, -np.inf
    for number in range(first, last):
        state = at(number)
        begin, end = model.offsets[state], model.offsets[at(number + 1)]
        if model.ended[state]:
            step[state], pairs[state] = 0.0, begin
            continue
        own = value[state]
        if known:
            before, start, stop = pairs[state], policy.slots[state], policy.ends[state]
            ahead = ahead_of(start, stop, policy.indices, policy.data, value, own)
        else:
            before = begin
            for pair in range(begin + 1, end):
                if ceilings[pair] > ceilings[before]:
                    before = pair
            ahead = ahead_of(indptr[before], indptr[before + 1], indices, data, value, own)
        first_gain = reward[before] + (discount * ahead - leak * own)
        best, chosen, most = first_gain - shift * margin[at(before)], before, first_gain
        high = max(high, first_gain / margin[at(before)])
        for pair in range(begin, end):
            place = at(pair)
            if pair == before or ceilings[place] + (rise - own) + spare < best:
                continue
            ahead = ahead_of(indptr[place], indptr[at(pair + 1)], indices, data, value, own)
            gain = reward[place] + (discount * ahead - leak * own)
            ceilings[place] = gain + error + (own - rise)
            high = max(high, gain / margin[place])
            if gain - shift * margin[place] > best:
                best, chosen, most = gain - shift * margin[place], pair, gain
        if chosen != before or not known:
            ceilings[before] = first_gain + error + (own - rise)
            take_row(state, chosen, model, policy)
        step[state], pairs[state] = best, chosen
        low = min(low, most / policy.numbers[1, state])
    extremes[0], extremes[1] = low, high


@compiled
def judge(
    first: int,
    last: int,
    model: Model,
    facts: Facts,
    policy: Known,
    value: Floats,
    shift: float,
    strict: bool,
    still: bool,
    spare: float,
    alike: float,
    kept: Numbers,
    step: Floats,
    pairs: Numbers,
    room: Floats,
    extremes: Floats,
) -> None:
    """Write the greatest d_c (S,) and its pair (S,) of states first … last-1, and proven bounds.

    A pair is passed over where its ceiling proves that it is beaten, and that it does not set the
    upper bound: `spare` bounds -c m(l) and how far from the best a pair may be for a tie, `alike`
    bounds m(l) / m(l') from below; none is where ceilings are infinite. The first pair that no
    other beats by more than rounding is taken, or that of `kept` (S,) where it is one of these;
    (0,) keeps none. `strict` counts the rounding of d alone. Where
    values are `still`, all of them the same, transitions add nothing and are not read. `room`
    (2, K) is for the K pairs of a state at most.
    `extremes` (3,) are the least (d - error) / m of the pairs taken, the greatest (d + error) / m
    of all, and the greatest noise; NaN where a number is beyond the range of floats.
    """
    indptr, indices, data = model.indptr, model.indices, model.data
    reward, leak, margin, discount = model.reward, model.leak, model.margin, model.discount
    ceilings, rise, known = policy.ceilings, policy.rise, policy.known
    reward_error, merged, rounding = facts.reward_error, facts.merged, facts.rounding
    leak_error, margin_error, tiny = facts.leak_error, facts.margin_error, facts.tiny
    low, high, loudest, sound, few = np.inf, -np.inf, 0.0, True, gamma(4)
    for state in range(first, last):
        begin, end = model.offsets[state], model.offsets[state + 1]
        if model.ended[state]:
            step[state], pairs[state] = 0.0, begin
            continue
        own, before = value[state], policy.pairs[state] if known else begin
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
            ahead, flow, earned, lost = 0.0, 0.0, reward[pair], leak * own
            start, stop = indptr[pair], indptr[pair + 1]
            if known and turn < begin:
                begins, done = policy.slots[state], policy.ends[state]
                ahead, flow = added(begins, done, policy.indices, policy.data, value, own)
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
            high = max(high, above / divisor)
            limit = max(limit, above * alike if above > 0 else above / alike)
            loudest = max(loudest, noise)
            shifted = gain - shift * margin[pair]
            tied = error if strict else noise
            room[0, place], room[1, place] = error - gain, shifted + tied
            best, sure = max(best, shifted), max(sure, shifted - tied)
        chosen = begin
        if len(kept) and room[1, kept[state] - begin] >= sure:
            chosen = kept[state]
        while chosen < end - 1 and not room[1, chosen - begin] >= sure:
            chosen += 1
        step[state], pairs[state] = best, chosen
        below = room[0, chosen - begin]
        divisor = margin[chosen] + (-margin_error if below > 0 else margin_error)
        low = min(low, -below / divisor)
    extremes[0], extremes[1], extremes[2] = low, high, loudest
    if not sound:
        extremes[:] = np.nan


@compiled
def follow(
    first: int,
    last: int,
    model: Model,
    policy: Known,
    value: Floats,
    shift: float,
    step: Floats,
    extremes: Floats,
) -> None:
    """Write d_c (S,) of the one pair of each of the states first … last-1 that a policy takes.

    `extremes` (2,) are the least and the greatest d_c / m.
    """
    low, high = np.inf, -np.inf
    for state in span(first, last):
        if model.ended[state]:
            step[state] = 0.0
            continue
        own, margin = value[state], policy.numbers[1, state]
        begin, end = policy.slots[state], policy.ends[state]
        ahead = ahead_of(begin, end, policy.indices, policy.data, value, own)
        gain = policy.numbers[0, state] + (model.discount * ahead - model.leak * own)
        gain -= shift * margin
        step[state] = gain
        ratio = gain / margin
        low, high = min(low, ratio), max(high, ratio)
    extremes[0], extremes[1] = low, high


@compiled
def settle(
    model: Model,
    policy: Known,
    weights: Floats,
    value: Floats,
    shift: float,
    goal: float,
    most: int,
    slow: Slow,
    uniform: bool,
    step: Floats,
    errors: Floats,
) -> tuple[bool, float]:
    """As `solvers.bounds.sweeps.Sweeps.settle`, all in one call; `errors` (most + 2,) is room."""
    states, extremes, least = len(value), errors[most:], np.inf
    for count in range(most):
        follow(0, states, model, policy, value, shift, step, extremes)
        low, high = extremes[0], extremes[1]
        error = (high - low) / 2
        middle, idle = (low + high) / 2, goal == 0 and count > 0 and not error < least
        if not uniform and (idle or not error > goal) and abs(middle) > error:
            for state in range(states):
                value[state] += middle * weights[state]
            return True, shift
        if idle:
            return True, shift
        for state in range(states):
            value[state] += step[state]
        if uniform:
            shift += model.discount * middle
        if not error > goal:
            return True, shift
        errors[count], least = error, min(least, error)
        if count + 1 >= slow.first:
            rate = (error / errors[count + 1 - slow.apart]) ** (1 / (slow.apart - 1))
            far = max(goal, slow.least * errors[0])
            if error * rate ** (most - (count + 1)) > far:
                return False, shift
    return False, shift


@compiled
def hold(model: Model, pairs: Numbers, policy: Known) -> None:
    """Make the rows of the `pairs` (S,) of a policy those held."""
    for state in range(len(pairs)):
        take_row(state, pairs[state], model, policy)


@compiled
def relax(backward: bool, model: Model, value: Floats, shift: float) -> float:
    """Make `value` (S,) satisfy the equation of each state in turn; return the greatest change.

    Gauss-Seidel, upward or downward in number: a state's gain is divided by 1 - γ P(l, s), so that
    staying is summed up at once.
    """
    states, largest, discount = len(value), 0.0, model.discount
    for number in range(states):
        state = states - 1 - number if backward else number
        if model.ended[state]:
            continue
        own, best = value[state], -np.inf
        for pair in range(model.offsets[state], model.offsets[state + 1]):
            ahead, stay = 0.0, 0.0
            for i in span(model.indptr[pair], model.indptr[pair + 1]):
                ahead += model.data[i] * (value[at(model.indices[i])] - own)
                if model.indices[i] == state:
                    stay = model.data[i]
            gain = model.reward[pair] + (discount * ahead - model.leak * own)
            gain -= shift * model.margin[pair]
            best = max(best, gain / (1 - discount * stay))
        value[state] = own + best
        largest = max(largest, abs(best))
    return largest


@compiled
def best_pairs(
    states: Integers,
    pair_offsets: Integers,
    rows: Rows,
    constant: Floats,
    pivot: Floats,
    value: Floats,
    best: Integers,
) -> None:
    """Write into `best` (S,) the pair of the greatest Q, and into `value` (S,) that Q.

    pivot · Q = constant + Σ data · value, the sum over the row of the pair.
    """
    for k in range(len(states)):
        state = at(states[k])
        highest, chosen = 0.0, np.int64(-1)
        for pair in span(pair_offsets[state], pair_offsets[state + np.uint64(1)]):
            total = constant[pair]
            for i in span(rows.indptr[pair], rows.indptr[pair + np.uint64(1)]):
                total += rows.data[i] * value[at(rows.indices[i])]
            total /= pivot[pair]
            if chosen < 0 or total > highest:
                highest, chosen = total, np.int64(pair)
        value[state], best[state] = highest, chosen
