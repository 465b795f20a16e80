"""Compiled loops for the care model without a matrix: solve draws, evaluate policies.

With the rows r = (a, s) as the inner index, and the distribution K(s', r) of the next status
vector, a stage (subtask, trial) is Q(r) = K(0, r) (c + assist_a) + Σ_{s' ≠ 0} K(s', r) u(s'). Here
c and u are the rewards of completing and failing, plus the values that follow. Sums run over s' in
one order, so that neither blocks nor threads change a bit. `mdp.care.laws` computes the rewards.
"""

from __future__ import annotations

from typing import NamedTuple

from exact_mdp.mdp.care.laws import fill_joint_distribution
from exact_mdp.mdp.care.rules import COMPLETE, FAIL, SKIPPED
from exact_mdp.mdp.forms.compiling import compile_loop, inline_loop
from exact_mdp.mdp.table import Floats, Numbers


class CareDraws(NamedTuple):
    """The rules, as in `mdp.care.rules.Rules`, and the numbers of D draws.

    Row a V + s belongs to action a and vector s; the rows of a skip follow.
    """

    which: Numbers  # (n, (A+1)·V) the number of each status's chance in each row
    gains: Numbers  # (3, 3, 2)
    places: Numbers  # (K,)
    flag_after: Numbers  # (3, 2)
    trials: int
    flags: int
    own: bool
    chance: Floats  # (D, U)
    gain: Floats  # (D, G)
    assist: Floats  # (D, A)
    present: Floats  # (D, V) status costs of the present vector in a step
    following: Floats  # (D, V) status costs of the next vector
    discount: Floats  # (D,)


class Room(NamedTuple):
    """Working memory; every array is written before it is read."""

    chance: Floats  # (2, n, (A+1)·V) the chances of 1 and of 0
    law: Floats  # (V, (A+1)·V) the distribution of the next vector, which is the first index
    policy: Floats  # (V, V) the same under a policy
    q: Floats  # (A·V,)
    # (4, V) the value of failing with s', the same in the last trial, the stage's value, and the
    # expected reward for the actions' own successes.
    vector: Floats
    starts: Floats  # (2, flags, V) values at the start of the next subtask, and of this one


product = inline_loop(fill_joint_distribution)


@inline_loop
def write_distributions(
    which: Numbers, chance: Floats, one: Floats, none: Floats, law: Floats
) -> None:
    """Write the distribution of every row, given the chances of a draw."""
    for i in range(which.shape[0]):
        for r in range(which.shape[1]):
            one[i, r] = chance[which[i, r]]
            none[i, r] = 1.0 - one[i, r]
    product(one, none, law)


@inline_loop
def write_failure_values(
    draws: CareDraws, d: int, law: Floats, ahead: Floats, at: int, mean: Floats
) -> None:
    """Write the value of failing the last trial of a subtask, for each next vector s'."""
    vectors, gain, discount = len(mean), draws.gain[d], draws.discount[d]
    present, following = draws.present[d], draws.following[d]
    to, skip = draws.flag_after[at, 1], law.shape[1] - vectors
    earned = gain[draws.gains[SKIPPED, at, 1]]
    # The mean over the vectors after the skip.
    for s in range(vectors):
        mean[s] = 0.0
    for z in range(vectors):
        later = discount * ahead[to, z] + (following[z] if draws.own else 0.0)
        for s in range(vectors):
            mean[s] += law[z, skip + s] * later
    # Failing and skipping: in one timestep, or with a timestep of its own for the skip.
    for s in range(vectors):
        value = earned + mean[s]
        if draws.own:
            value = discount * (present[s] + value)
        mean[s] = gain[draws.gains[FAIL, at, 0]] + following[s] + value


@inline_loop
def maximise_actions(
    assist: Floats, law: Floats, done: float, u: Floats, q: Floats, most: Floats
) -> None:
    """Write the values Q of a stage, and the greatest of each vector."""
    vectors = len(most)
    # Completing leads to vector 0; failing leads to all others.
    for a in range(len(assist)):
        total = done + assist[a]
        for s in range(vectors):
            q[a * vectors + s] = law[0, a * vectors + s] * total
    for s2 in range(1, vectors):
        total = u[s2]
        for r in range(len(q)):
            q[r] += law[s2, r] * total
    for s in range(vectors):
        most[s] = q[s]
    for a in range(1, len(assist)):
        for s in range(vectors):
            value, known = q[a * vectors + s], most[s]
            most[s] = value if value > known else known


@inline_loop
def write_policy_rows(
    assist: Floats, law: Floats, shares: Floats, policy: Floats, extra: Floats
) -> None:
    """Write the distribution under a policy (V, A), and its expected reward for completing."""
    vectors = len(extra)
    policy[:] = 0.0
    for s in range(vectors):
        extra[s] = 0.0
        for a in range(len(assist)):
            share, r = shares[s, a], a * vectors + s
            if share > 0.0:
                extra[s] += share * law[0, r] * assist[a]
                for s2 in range(vectors):
                    policy[s2, s] += share * law[s2, r]


@compile_loop
def evaluate_draws(
    draws: CareDraws, room: Room, shares: Floats, value: Floats, gaps: Floats, actions: Numbers
) -> None:
    """Write the start values (D, N) of policies (N, G, V, A) in all draws.

    G is 1 for a policy that is the same at every stage, else K·trials·flags. Without a policy, the
    optimum (D, 1) is written, with the `gaps` and `actions` of `solvers.care.CareValues`.
    """
    vectors, number, given = draws.present.shape[1], draws.assist.shape[1], len(shares) > 0
    law, policy, q, ahead, here = room.law, room.policy, room.q, room.starts[0], room.starts[1]
    u, last, worth, extra = room.vector[0], room.vector[1], room.vector[2], room.vector[3]
    for d in range(len(draws.gain)):
        assist, discount, gain = draws.assist[d], draws.discount[d], draws.gain[d]
        present, following = draws.present[d], draws.following[d]
        write_distributions(draws.which, draws.chance[d], room.chance[0], room.chance[1], law)
        for n in range(value.shape[1]):
            if given:
                write_policy_rows(assist, law, shares[n, 0], policy, extra)
            # Backward over subtasks: `ahead` holds the values at the start of the next one.
            ahead[:] = 0.0
            for k in range(len(draws.places) - 1, -1, -1):
                at = draws.places[k]
                write_failure_values(draws, d, law, ahead, at, last)
                failed = gain[draws.gains[FAIL, at, 0]]
                for f in range(draws.flags):
                    done = gain[draws.gains[COMPLETE, at, f]]
                    done += discount * ahead[draws.flag_after[at, f], 0]
                    # Backward over trials: `u` is the value of failing, `worth` of the stage.
                    for t in range(draws.trials - 1, -1, -1):
                        for s in range(vectors):
                            if t == draws.trials - 1:
                                u[s] = last[s]
                            else:
                                u[s] = failed + following[s] + discount * worth[s]
                        # The values of a policy, or the greatest Q with its first action.
                        if given:
                            if shares.shape[1] > 1:
                                stage = (k * draws.trials + t) * draws.flags + f
                                write_policy_rows(assist, law, shares[n, stage], policy, extra)
                            for s in range(vectors):
                                worth[s] = policy[0, s] * done + extra[s]
                            for s2 in range(1, vectors):
                                total = u[s2]
                                for s in range(vectors):
                                    worth[s] += policy[s2, s] * total
                        else:
                            maximise_actions(assist, law, done, u, q, worth)
                            for s in range(vectors):
                                a = 0
                                while q[a * vectors + s] != worth[s]:
                                    a += 1
                                actions[d, k, t, f, s] = a
                            if k == 0 and t == 0 and f == 0:
                                for s in range(vectors):
                                    for a in range(number):
                                        gaps[d, s, a] = worth[s] - q[a * vectors + s]
                        for s in range(vectors):
                            worth[s] += present[s]
                    for s in range(vectors):
                        here[f, s] = worth[s]
                for f in range(draws.flags):
                    for s in range(vectors):
                        ahead[f, s] = here[f, s]
            value[d, n] = ahead[0, 0]
