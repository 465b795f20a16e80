"""The care model without a matrix: many parameter draws solved, many policies evaluated.

With the rows r = (a, s) as the inner index, the law of the next status vector is built bit by bit,

    K(s', r) = Π_i p_i(r)^{s'_i} (1 - p_i(r))^{1 - s'_i},

and a stage (subtask, trial) is Q(r) = K(0, r) (c + assist_a) + Σ_{s' ≠ 0} K(s', r) u(s'), where c
and u hold what completing and failing earn and lead to. The variance of the return has no
cancellation (Sobel, Journal of Applied Probability 19, 1982):

    Var(s) = Σ_s' K(s, s') [(u(s') - m(s))² + γ² Var(s')].

Sums run over s' in one order, so that neither blocks nor threads change a bit. What each event
charges and where it leads are numbers here, made from `mdp.care.rules`.
"""

from __future__ import annotations

from typing import NamedTuple

from exact_mdp.mdp.forms.compiling import compiled, inlined
from exact_mdp.mdp.table import Floats, Numbers

COMPLETE, FAIL, SKIP = 0, 1, 2


class Care(NamedTuple):
    """How a care model follows from the numbers of its tables; made by `solvers.care`.

    A vector of numbers holds the P parameters, 0, and the discount.

    Attributes
    ----------
    terms : (U, n) int64
        Positions of the numbers that add up to each of U different chances.
    step, skip : (n, A·V), (n, V) int64
        Which chance each status has in each row: under each action, and on a skip.
    bits : (V, n) bool
    statuses, assist : (n,), (A,) int64
        Positions of the reward weights of statuses and of actions.
    charges : (G, C) int64
        Positions of the weights that add up to each of G different gains.
    gains : (3, 3, 2) int64
        Which gain each event earns, by place of the subtask and flag.
    places, kept : (K,), (3, 2) int64
    trials, flags, now, next : int
    own : bool
        As in `mdp.care.rules.Rules`.
    """

    terms: Numbers
    step: Numbers
    skip: Numbers
    bits: Numbers
    statuses: Numbers
    assist: Numbers
    charges: Numbers
    gains: Numbers
    places: Numbers
    kept: Numbers
    trials: int
    flags: int
    now: int
    next: int
    own: bool


class Room(NamedTuple):
    """Arrays to work in, one set for each thread; every array is written before it is read.

    Attributes
    ----------
    numbers : (P+2,)
    chance, gain, assist : (U,), (G,), (A,)
    p, q : (A·V,)
    law, skip : (V, A·V), (V, V)
        Next vector first.
    own : (V, V)
        A policy's law.
    vector : (10, V)
        Costs (next, present), returns beyond a skip, a stage's continuation and value, and the
        same of their variance; what an action's own reward adds, and its spread.
    ahead, here : (2, flags, V)
        Values and variances at the start of the next and of this subtask.
    """

    numbers: Floats
    chance: Floats
    gain: Floats
    assist: Floats
    p: Floats
    q: Floats
    law: Floats
    skip: Floats
    own: Floats
    vector: Floats
    ahead: Floats
    here: Floats


NEXT, PRESENT, BEYOND, U, M, BEYOND2, U2, M2, EXTRA, EXTRA2 = range(10)


@inlined
def product_law(chance: Floats, which: Numbers, p: Floats, law: Floats) -> None:
    """Write the law of independent bits, next vector first, into `law` (V, R)."""
    rows = which.shape[1]
    for r in range(rows):
        law[0, r] = 1.0
    for i in range(which.shape[0]):
        for r in range(rows):
            p[r] = chance[which[i, r]]
        for prefix in range((1 << i) - 1, -1, -1):
            before, without, having = law[prefix], law[2 * prefix], law[2 * prefix + 1]
            for r in range(rows):
                having[r] = before[r] * p[r]
            for r in range(rows):
                without[r] = before[r] * (1.0 - p[r])


@inlined
def place(care: Care, base: Floats, positions: Numbers, drawn: Floats, room: Room) -> float:
    """Work out the laws and the rewards of one draw; return its discount."""
    numbers = room.numbers
    for i in range(len(base)):
        numbers[i] = base[i]
    for i in range(len(positions)):
        numbers[positions[i]] = drawn[i]
    for i in range(care.terms.shape[0]):
        total = numbers[care.terms[i, 0]]
        for j in range(1, care.terms.shape[1]):
            total += numbers[care.terms[i, j]]
        room.chance[i] = min(total, 1.0)
    product_law(room.chance, care.step, room.p, room.law)
    product_law(room.chance, care.skip, room.p, room.skip)
    for i in range(len(care.assist)):
        room.assist[i] = numbers[care.assist[i]]
    for i in range(care.charges.shape[0]):
        total = numbers[care.charges[i, 0]]
        for j in range(1, care.charges.shape[1]):
            total += numbers[care.charges[i, j]]
        room.gain[i] = total
    for s in range(care.bits.shape[0]):
        cost = 0.0
        for i in range(care.bits.shape[1]):
            if care.bits[s, i]:
                cost += numbers[care.statuses[i]]
        room.vector[NEXT, s] = care.next * cost
        room.vector[PRESENT, s] = care.now * cost
    return float(numbers[len(base) - 1])


@inlined
def beyond(care: Care, room: Room, k: int, discount: float, second: bool) -> None:
    """Write what failing the last trial of a subtask with vector s' earns and leads to."""
    vectors, at = care.bits.shape[0], care.places[k]
    vector, ahead, skip = room.vector, room.ahead, room.skip
    to, earned, failed = (
        care.kept[at, 1],
        room.gain[care.gains[SKIP, at, 1]],
        room.gain[care.gains[FAIL, at, 0]],
    )
    mean, spread = vector[BEYOND], vector[BEYOND2]
    for s in range(vectors):
        mean[s] = 0.0
        spread[s] = 0.0
    for z in range(vectors):
        later = discount * ahead[0, to, z] + (vector[NEXT, z] if care.own else 0.0)
        for s in range(vectors):
            mean[s] += skip[z, s] * later
    if second:
        for z in range(vectors):
            later = discount * ahead[0, to, z] + (vector[NEXT, z] if care.own else 0.0)
            noise = discount * discount * ahead[1, to, z]
            for s in range(vectors):
                off = later - mean[s]
                spread[s] += skip[z, s] * (off * off + noise)
    for s in range(vectors):
        value = earned + mean[s]
        if care.own:  # a timestep in which *skip* is the only action
            value = discount * (vector[PRESENT, s] + value)
            spread[s] *= discount * discount
        mean[s] = failed + vector[NEXT, s] + value


@inlined
def completing(care: Care, room: Room, k: int, flag: int, discount: float) -> float:
    """Return what completing a subtask earns and leads to, but for the action's own reward."""
    at = care.places[k]
    later = discount * room.ahead[0, care.kept[at, flag], 0]
    return float(room.gain[care.gains[COMPLETE, at, flag]] + later)


@inlined
def continuation(care: Care, room: Room, k: int, t: int, discount: float, second: bool) -> None:
    """Write what failing trial t with vector s' earns and leads to, into U and U2."""
    vector, failed = room.vector, room.gain[care.gains[FAIL, care.places[k], 0]]
    vectors = care.bits.shape[0]
    if t == care.trials - 1:
        for s in range(vectors):
            vector[U, s] = vector[BEYOND, s]
            vector[U2, s] = vector[BEYOND2, s]
        return
    for s in range(vectors):
        vector[U, s] = failed + vector[NEXT, s] + discount * vector[M, s]
    if second:
        for s in range(vectors):
            vector[U2, s] = discount * discount * vector[M2, s]


@inlined
def pass_on(care: Care, room: Room) -> None:
    """Let what was worked out for this subtask be what follows the one before it."""
    for of in range(2):
        for f in range(care.flags):
            for s in range(care.bits.shape[0]):
                room.ahead[of, f, s] = room.here[of, f, s]


@compiled
def optimal_values(
    care: Care,
    base: Floats,
    positions: Numbers,
    draws: Floats,
    room: Room,
    start: Floats,
    gaps: Floats,
    actions: Numbers,
) -> None:
    """Solve all draws (D, Q).

    `base` (P+2,) holds parameters, 0, discount; `positions` (Q,) says which of them are drawn.
    `start`, `gaps` and `actions` are those of `solvers.care.CareValues`, empty where not wanted.
    """
    vectors, rows, number = care.bits.shape[0], care.step.shape[1], len(care.assist)
    vector, law, q = room.vector, room.law, room.q
    for d in range(len(draws)):
        discount = place(care, base, positions, draws[d], room)
        room.ahead[:] = 0.0
        for k in range(len(care.places) - 1, -1, -1):
            beyond(care, room, k, discount, False)
            for f in range(care.flags):
                done = completing(care, room, k, f, discount)
                for t in range(care.trials - 1, -1, -1):
                    continuation(care, room, k, t, discount, False)
                    for a in range(number):
                        worth = done + room.assist[a]
                        for s in range(vectors):
                            q[a * vectors + s] = law[0, a * vectors + s] * worth
                    for s2 in range(1, vectors):
                        worth = vector[U, s2]
                        for r in range(rows):
                            q[r] += law[s2, r] * worth
                    for s in range(vectors):
                        vector[M, s] = q[s]
                    for a in range(1, number):
                        for s in range(vectors):
                            value = q[a * vectors + s]
                            best = vector[M, s]
                            vector[M, s] = value if value > best else best
                    if len(actions) > 0:
                        for s in range(vectors):
                            a = 0
                            while q[a * vectors + s] != vector[M, s]:
                                a += 1
                            actions[d, k, t, f, s] = a
                    if len(gaps) > 0 and k == 0 and t == 0 and f == 0:
                        for s in range(vectors):
                            for a in range(number):
                                gaps[d, s, a] = vector[M, s] - q[a * vectors + s]
                    for s in range(vectors):
                        vector[M, s] += vector[PRESENT, s]
                for s in range(vectors):
                    room.here[0, f, s] = vector[M, s]
            pass_on(care, room)
        start[d] = room.ahead[0, 0, 0]


@inlined
def follow(
    care: Care, room: Room, chosen: Numbers, shares: Floats, n: int, g: int, mixed: bool
) -> None:
    """Write a policy's law, and the mean and spread of its own reward on completing."""
    vectors, number = care.bits.shape[0], len(care.assist)
    law, own, vector = room.law, room.own, room.vector
    if not mixed:
        for s in range(vectors):
            r = chosen[n, g, s] * vectors + s
            vector[EXTRA, s] = room.assist[chosen[n, g, s]]
            vector[EXTRA2, s] = 0.0
            for s2 in range(vectors):
                own[s2, s] = law[s2, r]
        return
    for s2 in range(vectors):
        for s in range(vectors):
            own[s2, s] = 0.0
            for a in range(number):
                own[s2, s] += shares[n, g, s, a] * law[s2, a * vectors + s]
    for s in range(vectors):
        total, spread = 0.0, 0.0
        for a in range(number):
            total += shares[n, g, s, a] * law[0, a * vectors + s] * room.assist[a]
        mean = total / own[0, s] if own[0, s] > 0.0 else 0.0
        for a in range(number):
            off = room.assist[a] - mean
            spread += shares[n, g, s, a] * law[0, a * vectors + s] * (off * off)
        vector[EXTRA, s] = mean
        vector[EXTRA2, s] = spread


@inlined
def change(care: Care, room: Room, chosen: Numbers, n: int, held: int, g: int) -> None:
    """Write what a deterministic policy's law is at stage g, where it is not as at stage `held`."""
    vectors = care.bits.shape[0]
    for s in range(vectors):
        a = chosen[n, g, s]
        if a != chosen[n, held, s]:
            room.vector[EXTRA, s] = room.assist[a]
            for s2 in range(vectors):
                room.own[s2, s] = room.law[s2, a * vectors + s]


@compiled
def policy_moments(
    care: Care,
    base: Floats,
    positions: Numbers,
    draws: Floats,
    chosen: Numbers,
    shares: Floats,
    room: Room,
    second: bool,
    mean: Floats,
    variance: Floats,
) -> None:
    """Evaluate all policies at all draws.

    Parameters
    ----------
    chosen : (N, G, V) int16
        Action of each vector; G is 1 (the same at every stage) or K·trials·flags.
    shares : (N, G, V, A), or (0, …) for deterministic policies
    mean, variance : (C, D, N)
        Of the return from the start, of all subtasks where C is 1; where C is K, row i is of the
        last i + 1 subtasks alone. `variance` is (C, 0, 0) where it is not asked for.
    """
    vectors = care.bits.shape[0]
    vector, own = room.vector, room.own
    mixed = len(shares) > 0
    staged = (shares.shape[1] if mixed else chosen.shape[1]) > 1
    for d in range(len(draws)):
        discount = place(care, base, positions, draws[d], room)
        for n in range(mean.shape[2]):
            held = 0
            follow(care, room, chosen, shares, n, 0, mixed)
            room.ahead[:] = 0.0
            for k in range(len(care.places) - 1, -1, -1):
                beyond(care, room, k, discount, second)
                for f in range(care.flags):
                    done = completing(care, room, k, f, discount)
                    to = care.kept[care.places[k], f]
                    noise = discount * discount * room.ahead[1, to, 0]
                    for t in range(care.trials - 1, -1, -1):
                        continuation(care, room, k, t, discount, second)
                        if staged:
                            stage = (k * care.trials + t) * care.flags + f
                            if mixed:
                                follow(care, room, chosen, shares, n, stage, mixed)
                            else:
                                change(care, room, chosen, n, held, stage)
                            held = stage
                        for s in range(vectors):
                            vector[M, s] = own[0, s] * (done + vector[EXTRA, s])
                        for s2 in range(1, vectors):
                            worth = vector[U, s2]
                            for s in range(vectors):
                                vector[M, s] += own[s2, s] * worth
                        if second:
                            for s in range(vectors):
                                off = done + vector[EXTRA, s] - vector[M, s]
                                vector[M2, s] = own[0, s] * (off * off + noise) + vector[EXTRA2, s]
                            for s2 in range(1, vectors):
                                worth, spread = vector[U, s2], vector[U2, s2]
                                for s in range(vectors):
                                    off = worth - vector[M, s]
                                    vector[M2, s] += own[s2, s] * (off * off + spread)
                        for s in range(vectors):
                            vector[M, s] += vector[PRESENT, s]
                    for s in range(vectors):
                        room.here[0, f, s] = vector[M, s]
                        room.here[1, f, s] = vector[M2, s]
                pass_on(care, room)
                of = len(mean) - 1 - k  # a value of the subtasks from here on
                if of >= 0:
                    mean[of, d, n] = room.ahead[0, 0, 0]
                    if second:
                        variance[of, d, n] = room.ahead[1, 0, 0]
