"""The care model without a matrix: many parameter draws solved, many policies evaluated.

With the rows r = (a, s) as the inner index, the law of the next status vector is built bit by bit,

    K(s', r) = Π_i p_i(r)^{s'_i} (1 - p_i(r))^{1 - s'_i},

and a stage (subtask, trial) is Q(r) = K(0, r) (c + assist_a) + Σ_{s' ≠ 0} K(s', r) u(s'), where c
and u hold what completing and failing earn and lead to. Sums run over s' in one order, so that
neither blocks nor threads change a bit. What each event charges and where it leads are numbers
here, made from `mdp.care.rules`.
"""

from __future__ import annotations

from typing import NamedTuple

from exact_mdp.mdp.forms.compiling import compiled, inlined
from exact_mdp.mdp.table import Floats, Numbers

COMPLETE, FAIL, SKIP = 0, 1, 2


class Care(NamedTuple):
    """How a care model follows from the numbers of its tables; made by `solvers.care`.

    A vector of numbers holds the P parameters, 0, and the discount.
    """

    terms: Numbers  # (U, n) positions of the numbers that add up to each of U different chances
    step: Numbers  # (n, A·V) which chance each status has in each row, under each action,
    skip: Numbers  # (n, V) and on a skip
    bits: Numbers  # (V, n) bool
    statuses: Numbers  # (n,) positions of the reward weights of statuses
    assist: Numbers  # (A,) and of actions
    charges: Numbers  # (G, C) positions of the weights that add up to each of G different gains
    gains: Numbers  # (3, 3, 2) which gain each event earns, by place of the subtask and flag
    places: Numbers  # (K,) from here on as in `mdp.care.rules.Rules`
    kept: Numbers
    trials: int
    flags: int
    now: int
    next: int
    own: bool


class Room(NamedTuple):
    """Arrays to work in, one set for each thread; every array is written before it is read."""

    numbers: Floats  # (P+2,)
    chance: Floats  # (U,)
    gain: Floats  # (G,)
    assist: Floats  # (A,)
    p: Floats  # (A·V,)
    q: Floats  # (A·V,)
    law: Floats  # (V, A·V) next vector first, as in the following two
    skip: Floats  # (V, V)
    own: Floats  # (V, V) a policy's law
    vector: Floats  # (6, V), see below
    ahead: Floats  # (flags, V) values at the start of the next subtask
    here: Floats  # (flags, V) and of this one


# Costs (next, present), what a skip returns, a stage's continuation and value, and what an action's
# own reward adds.
NEXT, PRESENT, BEYOND, U, M, EXTRA = range(6)


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
def beyond(care: Care, room: Room, k: int, discount: float) -> None:
    """Write what failing the last trial of a subtask with vector s' earns and leads to."""
    vectors, at = care.bits.shape[0], care.places[k]
    vector, skip, to = room.vector, room.skip, care.kept[at, 1]
    earned, failed = room.gain[care.gains[SKIP, at, 1]], room.gain[care.gains[FAIL, at, 0]]
    mean = vector[BEYOND]
    for s in range(vectors):
        mean[s] = 0.0
    for z in range(vectors):
        later = discount * room.ahead[to, z] + (vector[NEXT, z] if care.own else 0.0)
        for s in range(vectors):
            mean[s] += skip[z, s] * later
    for s in range(vectors):
        value = earned + mean[s]
        if care.own:  # a timestep in which *skip* is the only action
            value = discount * (vector[PRESENT, s] + value)
        mean[s] = failed + vector[NEXT, s] + value


@inlined
def completing(care: Care, room: Room, k: int, flag: int, discount: float) -> float:
    """Return what completing a subtask earns and leads to, but for the action's own reward."""
    at = care.places[k]
    later = discount * room.ahead[care.kept[at, flag], 0]
    return float(room.gain[care.gains[COMPLETE, at, flag]] + later)


@inlined
def continuation(care: Care, room: Room, k: int, t: int, discount: float) -> None:
    """Write what failing trial t with vector s' earns and leads to, into U."""
    vector, failed = room.vector, room.gain[care.gains[FAIL, care.places[k], 0]]
    for s in range(care.bits.shape[0]):
        if t == care.trials - 1:
            vector[U, s] = vector[BEYOND, s]
        else:
            vector[U, s] = failed + vector[NEXT, s] + discount * vector[M, s]


@inlined
def best(care: Care, room: Room, done: float) -> None:
    """Write the values Q of a stage, and the greatest of each vector into M."""
    vectors, rows = care.bits.shape[0], care.step.shape[1]
    vector, law, q = room.vector, room.law, room.q
    for a in range(len(care.assist)):
        total = done + room.assist[a]
        for s in range(vectors):
            q[a * vectors + s] = law[0, a * vectors + s] * total
    for s2 in range(1, vectors):
        total = vector[U, s2]
        for r in range(rows):
            q[r] += law[s2, r] * total
    for s in range(vectors):
        vector[M, s] = q[s]
    for a in range(1, len(care.assist)):
        for s in range(vectors):
            value = q[a * vectors + s]
            most = vector[M, s]
            vector[M, s] = value if value > most else most


@inlined
def follow(care: Care, room: Room, shares: Floats) -> None:
    """Write the law of a policy (V, A), and the mean of its own reward for completing."""
    vectors, number = care.bits.shape[0], len(care.assist)
    law, own, vector = room.law, room.own, room.vector
    own[:] = 0.0
    for s in range(vectors):
        vector[EXTRA, s] = 0.0
        for a in range(number):
            share, r = shares[s, a], a * vectors + s
            if share > 0.0:
                vector[EXTRA, s] += share * law[0, r] * room.assist[a]
                for s2 in range(vectors):
                    own[s2, s] += share * law[s2, r]


@inlined
def followed(care: Care, room: Room, done: float) -> None:
    """Write what a policy is worth at a stage into M."""
    vector, own = room.vector, room.own
    for s in range(care.bits.shape[0]):
        vector[M, s] = own[0, s] * done + vector[EXTRA, s]
    for s2 in range(1, care.bits.shape[0]):
        total = vector[U, s2]
        for s in range(care.bits.shape[0]):
            vector[M, s] += own[s2, s] * total


@compiled
def values(
    care: Care,
    base: Floats,
    positions: Numbers,
    draws: Floats,
    room: Room,
    shares: Floats,
    value: Floats,
    gaps: Floats,
    actions: Numbers,
) -> None:
    """Write the start values (D, N) of policies (N, G, V, A) at all draws (D, Q).

    G is 1 for a policy that is the same at every stage, else K·trials·flags. Without a policy it is
    the optimum that is written, (D, 1), with `gaps` and `actions` of `solvers.care.CareValues`.
    `base` (P+2,) holds parameters, 0, discount; `positions` (Q,) says which of them are drawn.
    """
    vectors, number, given = care.bits.shape[0], len(care.assist), len(shares) > 0
    vector, q = room.vector, room.q
    for d in range(len(draws)):
        discount = place(care, base, positions, draws[d], room)
        for n in range(value.shape[1]):
            if given:
                follow(care, room, shares[n, 0])
            room.ahead[:] = 0.0
            for k in range(len(care.places) - 1, -1, -1):
                beyond(care, room, k, discount)
                for f in range(care.flags):
                    done = completing(care, room, k, f, discount)
                    for t in range(care.trials - 1, -1, -1):
                        continuation(care, room, k, t, discount)
                        if given:
                            if shares.shape[1] > 1:
                                stage = (k * care.trials + t) * care.flags + f
                                follow(care, room, shares[n, stage])
                            followed(care, room, done)
                        else:
                            best(care, room, done)
                            for s in range(vectors):
                                a = 0
                                while q[a * vectors + s] != vector[M, s]:
                                    a += 1
                                actions[d, k, t, f, s] = a
                            if k == 0 and t == 0 and f == 0:
                                for s in range(vectors):
                                    for a in range(number):
                                        gaps[d, s, a] = vector[M, s] - q[a * vectors + s]
                        for s in range(vectors):
                            vector[M, s] += vector[PRESENT, s]
                    for s in range(vectors):
                        room.here[f, s] = vector[M, s]
                for f in range(care.flags):
                    for s in range(vectors):
                        room.ahead[f, s] = room.here[f, s]
            value[d, n] = room.ahead[0, 0]
