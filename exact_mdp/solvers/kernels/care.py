"""The care model without a matrix: many parameter draws solved, many policies evaluated.

With the rows r = (a, s) as the inner index, and the law K(s', r) of the next status vector, a stage
(subtask, trial) is Q(r) = K(0, r) (c + assist_a) + Σ_{s' ≠ 0} K(s', r) u(s'), where c and u hold
what completing and failing earn and lead to. Sums run over s' in one order, so that neither blocks
nor threads change a bit. What each event earns is worked out in `mdp.care.laws`.
"""

from __future__ import annotations

from typing import NamedTuple

from exact_mdp.mdp.care.laws import independent
from exact_mdp.mdp.forms.compiling import compiled, inlined
from exact_mdp.mdp.table import Floats, Numbers

COMPLETE, FAIL, SKIPPED = 0, 1, 2  # as in `mdp.care.rules`


class Layout(NamedTuple):
    """What all draws have in common, as in `mdp.care.rules.Rules`.

    Rows r are those of each action and vector, a V + s, and behind them those of a skip.
    """

    which: Numbers  # (n, (A+1)·V) which chance each status has in each row
    gains: Numbers  # (3, 3, 2)
    places: Numbers  # (K,)
    flag_after: Numbers  # (3, 2)
    trials: int
    flags: int
    own: bool


class Draws(NamedTuple):
    """The numbers of D draws."""

    chance: Floats  # (D, U)
    gain: Floats  # (D, G)
    assist: Floats  # (D, A)
    present: Floats  # (D, V) what a step charges for its present vector
    following: Floats  # (D, V) and for its next one
    discount: Floats  # (D,)


class Room(NamedTuple):
    """Arrays to work in; every array is written before it is read."""

    chance: Floats  # (2, n, (A+1)·V) of 1 and of 0
    law: Floats  # (V, (A+1)·V) of the next vector, which comes first
    policy: Floats  # (V, V) its law
    q: Floats  # (A·V,)
    vector: Floats  # (4, V), see below
    ahead: Floats  # (flags, V) values at the start of the next subtask
    here: Floats  # (flags, V) and of this one


# What a skip and what any other stage leads to from s', the stage's value, and what the actions'
# own rewards add to that.
BEYOND, U, M, EXTRA = range(4)


product = inlined(independent)


@inlined
def place(layout: Layout, chance: Floats, room: Room) -> None:
    """Write the law of every row at the chances (U,)."""
    one, none = room.chance[0], room.chance[1]
    for i in range(layout.which.shape[0]):
        for r in range(layout.which.shape[1]):
            one[i, r] = chance[layout.which[i, r]]
            none[i, r] = 1.0 - one[i, r]
    product(one, none, room.law)


@inlined
def beyond(layout: Layout, draws: Draws, d: int, room: Room, at: int) -> None:
    """Write what failing the last trial of a subtask with vector s' earns and leads to."""
    vectors, gain, discount = room.law.shape[0], draws.gain[d], draws.discount[d]
    present, following = draws.present[d], draws.following[d]
    law, to, mean = room.law, layout.flag_after[at, 1], room.vector[BEYOND]
    skip, earned = len(room.q), gain[layout.gains[SKIPPED, at, 1]]
    for s in range(vectors):
        mean[s] = 0.0
    for z in range(vectors):
        later = discount * room.ahead[to, z] + (following[z] if layout.own else 0.0)
        for s in range(vectors):
            mean[s] += law[z, skip + s] * later
    for s in range(vectors):
        value = earned + mean[s]
        if layout.own:  # a timestep in which *skip* is the only action
            value = discount * (present[s] + value)
        mean[s] = gain[layout.gains[FAIL, at, 0]] + following[s] + value


@inlined
def best(assist: Floats, room: Room, done: float) -> None:
    """Write the values Q of a stage, and the greatest of each vector into M."""
    law, vector, q = room.law, room.vector, room.q
    vectors = law.shape[0]
    for a in range(len(assist)):
        total = done + assist[a]
        for s in range(vectors):
            q[a * vectors + s] = law[0, a * vectors + s] * total
    for s2 in range(1, vectors):
        total = vector[U, s2]
        for r in range(len(q)):
            q[r] += law[s2, r] * total
    for s in range(vectors):
        vector[M, s] = q[s]
    for a in range(1, len(assist)):
        for s in range(vectors):
            value = q[a * vectors + s]
            most = vector[M, s]
            vector[M, s] = value if value > most else most


@inlined
def follow(assist: Floats, room: Room, shares: Floats) -> None:
    """Write the law of a policy (V, A), and the mean of its own reward for completing."""
    law, policy, vector = room.law, room.policy, room.vector
    vectors = law.shape[0]
    policy[:] = 0.0
    for s in range(vectors):
        vector[EXTRA, s] = 0.0
        for a in range(len(assist)):
            share, r = shares[s, a], a * vectors + s
            if share > 0.0:
                vector[EXTRA, s] += share * law[0, r] * assist[a]
                for s2 in range(vectors):
                    policy[s2, s] += share * law[s2, r]


@inlined
def followed(room: Room, done: float) -> None:
    """Write what a policy is worth at a stage into M."""
    vector, policy = room.vector, room.policy
    vectors = len(policy)
    for s in range(vectors):
        vector[M, s] = policy[0, s] * done + vector[EXTRA, s]
    for s2 in range(1, vectors):
        total = vector[U, s2]
        for s in range(vectors):
            vector[M, s] += policy[s2, s] * total


@compiled
def values(
    layout: Layout,
    draws: Draws,
    room: Room,
    shares: Floats,
    value: Floats,
    gaps: Floats,
    actions: Numbers,
) -> None:
    """Write the start values (D, N) of policies (N, G, V, A) in all draws.

    G is 1 for a policy that is the same at every stage, else K·trials·flags. Without a policy it is
    the optimum that is written, (D, 1), with `gaps` and `actions` of `solvers.care.CareValues`.
    """
    vectors, number, given = room.law.shape[0], draws.assist.shape[1], len(shares) > 0
    vector, q = room.vector, room.q
    for d in range(len(draws.gain)):
        assist, discount, gain = draws.assist[d], draws.discount[d], draws.gain[d]
        present, following = draws.present[d], draws.following[d]
        place(layout, draws.chance[d], room)
        for n in range(value.shape[1]):
            if given:
                follow(assist, room, shares[n, 0])
            room.ahead[:] = 0.0
            for k in range(len(layout.places) - 1, -1, -1):
                at = layout.places[k]
                beyond(layout, draws, d, room, at)
                failed = gain[layout.gains[FAIL, at, 0]]
                for f in range(layout.flags):
                    later = discount * room.ahead[layout.flag_after[at, f], 0]
                    done = gain[layout.gains[COMPLETE, at, f]] + later
                    for t in range(layout.trials - 1, -1, -1):
                        for s in range(vectors):
                            if t == layout.trials - 1:
                                vector[U, s] = vector[BEYOND, s]
                            else:
                                vector[U, s] = failed + following[s] + discount * vector[M, s]
                        if given:
                            if shares.shape[1] > 1:
                                stage = (k * layout.trials + t) * layout.flags + f
                                follow(assist, room, shares[n, stage])
                            followed(room, done)
                        else:
                            best(assist, room, done)
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
                            vector[M, s] += present[s]
                    for s in range(vectors):
                        room.here[f, s] = vector[M, s]
                for f in range(layout.flags):
                    for s in range(vectors):
                        room.ahead[f, s] = room.here[f, s]
            value[d, n] = room.ahead[0, 0]
