"""Compiled loops over episodes of a learner, and of a policy.

Random numbers are xoshiro256++ (Blackman and Vigna, ACM Transactions on Mathematical Software 47,
2021); a double is made of the upper 53 bits. The compiler may neither reassociate nor fuse
operations, so that the same seed gives the same bits as the same formulas in plain Python.

Outcomes are drawn from alias tables: a pair with n outcomes has n columns, each holding an outcome
of its own and an alias; u · n picks a column, and the fraction left over decides between the two
(Walker 1977; built as in Vose, IEEE Transactions on Software Engineering 17, 1991).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exact_mdp.mdp.forms.compiling import compile_loop, inline_loop, unsigned_index
from exact_mdp.mdp.table import Floats, Numbers

# In the order of METHODS and TIES in `solvers.learning.q_learning`.
Q_LEARNING, SARSA, EXPECTED_SARSA, DOUBLE_Q = range(4)
FIRST, LAST, RANDOM = range(3)


class SamplingTables(NamedTuple):
    """A model laid out for sampling; made by `solvers.learning.sampler`.

    A position is the number of a pair. Further positions stand for the actions of terminal states,
    for a learner that looks beyond the end. An entry is an index of a flat (K·A,) Q-table.
    """

    low: Numbers  # (S,) positions of each state's actions: low[s] … high[s]-1
    high: Numbers
    entry: Numbers  # (L+X,) entry of the Q-table that each position reads
    offsets: Numbers  # (L+1,) alias columns of pair l are offsets[l] … offsets[l+1]-1
    cut: Floats  # (N,) the fraction of each column that belongs to its own outcome
    next: Numbers  # (2N,) next state of column i itself at 2i, of its alias at 2i + 1
    gain: Floats  # (2N,) rewards, in the same order
    terminal: Numbers  # (S,) bool
    start: Numbers  # (B,) first states
    start_total: Floats  # (B,) their cumulative probabilities
    row_offsets: Numbers  # (K+1,) entries that a greedy policy compares in each of the K rows
    row_entry: Numbers


@compile_loop
def alias_tables(
    offsets: Numbers,
    probability: Floats,
    cut: Floats,
    alias: Numbers,
    small: Numbers,
    large: Numbers,
) -> None:
    """Fill `cut` and `alias` (N,) for rows of probabilities (N,) that `offsets` (L+1,) delimit.

    `small` and `large` (N,) are working memory.
    """
    for pair in range(len(offsets) - 1):
        first, last = offsets[pair], offsets[pair + 1]
        total = 0.0
        for i in range(first, last):
            total += probability[i]
        # Scale probabilities to a mean of 1; columns below 1 are small, the others large.
        few, many = 0, 0
        for i in range(first, last):
            cut[i], alias[i] = probability[i] / total * (last - first), i
            if cut[i] < 1.0:
                small[few] = i
                few += 1
            else:
                large[many] = i
                many += 1
        # Fill up each small column from a large one, which may become small by that.
        while few > 0 and many > 0:
            few -= 1
            giver = large[many - 1]
            alias[small[few]] = giver
            cut[giver] = (cut[giver] + cut[small[few]]) - 1.0
            if cut[giver] < 1.0:
                many -= 1
                small[few] = giver
                few += 1
        # The remaining columns are 1 up to rounding and keep their own outcome.
        for i in range(few):
            cut[small[i]] = 1.0
        for i in range(many):
            cut[large[i]] = 1.0


@inline_loop
def sample_uniform(rng: Numbers) -> float:
    """Return a double in [0, 1), and advance the (4,) uint64 state."""
    a, b, c, d = rng[0], rng[1], rng[2], rng[3]
    total = a + d
    drawn = ((total << np.uint64(23)) | (total >> np.uint64(41))) + a
    c ^= a
    d ^= b
    rng[0] = a ^ d
    rng[1] = b ^ c
    rng[2] = c ^ (b << np.uint64(17))
    rng[3] = (d << np.uint64(45)) | (d >> np.uint64(19))
    # Its upper 53 bits, scaled to [0, 1).
    return np.float64(np.int64(drawn >> np.uint64(11))) * 2.0**-53


@inline_loop
def first_state(rng: Numbers, tables: SamplingTables) -> int:
    """Return a first state; if there is only one, no random number is drawn."""
    start, total = tables.start, tables.start_total
    if len(start) == 1:
        return int(start[0])
    drawn = sample_uniform(rng)
    for i in range(len(start) - 1):
        if drawn < total[i]:
            return int(start[i])
    return int(start[-1])


@inline_loop
def sample_pair_outcome(rng: Numbers, offsets: Numbers, cut: Floats, pair: int) -> int:
    """Return the number in (2N,) of an outcome of a pair."""
    first = offsets[unsigned_index(pair)]
    scaled = sample_uniform(rng) * (offsets[unsigned_index(pair + 1)] - first)
    column = int(scaled)
    number = first + column
    return int(2 * number + (1 if scaled - column >= cut[unsigned_index(number)] else 0))


@inline_loop
def find_largest(q: Floats, entry: Numbers, low: int, high: int) -> tuple[float, int]:
    """Return the largest value among the positions low … high-1, and the first that has it."""
    # Written without a branch, which compiles to faster code.
    best, where = q[unsigned_index(entry[unsigned_index(low)])], low
    for i in range(low + 1, high):
        value = q[unsigned_index(entry[unsigned_index(i)])]
        where = i if value > best else where
        best = value if value > best else best
    return best, where


@inline_loop
def choose_greedy_position(
    rng: Numbers, q: Floats, entry: Numbers, low: int, high: int, ties: int
) -> int:
    """Return the position among low … high-1 with the largest value."""
    where: int
    best, where = find_largest(q, entry, low, high)
    if ties == FIRST:
        return where
    # Count the ties; for a random one, draw its number and look for it.
    equal, last = 0, where
    for i in range(where, high):
        if q[unsigned_index(entry[unsigned_index(i)])] == best:
            equal += 1
            last = i
    if ties == LAST or equal == 1:
        return last
    wanted = int(sample_uniform(rng) * equal)
    for i in range(where, high):
        if q[unsigned_index(entry[unsigned_index(i)])] == best:
            if wanted == 0:
                return i
            wanted -= 1
    return where


@inline_loop
def choose_position(
    rng: Numbers, q: Floats, entry: Numbers, low: int, high: int, chance: float, ties: int
) -> int:
    """Return the position that an ε-greedy actor takes; one draw decides between all and greedy."""
    drawn = sample_uniform(rng)
    if drawn < chance:
        return int(low + min(int(drawn / chance * (high - low)), high - low - 1))
    return int(choose_greedy_position(rng, q, entry, low, high, ties))


@inline_loop
def greedy_policy(
    rng: Numbers, q: Floats, tables: SamplingTables, ties: int, n_actions: int, policy: Numbers
) -> None:
    """Write the greedy action of every row of a flat Q-table into `policy` (K,).

    Ties go to the first action, or to the last if the actor also takes the last.
    """
    entry, offsets = tables.row_entry, tables.row_offsets
    # No random ties: writing a policy must not draw random numbers.
    taken = FIRST
    if ties == LAST:
        taken = LAST
    for row in range(len(policy)):
        low, high = offsets[row], offsets[row + 1]
        where = choose_greedy_position(rng, q, entry, low, high, taken)
        policy[row] = entry[where] - row * n_actions


@compile_loop
def run_learner(
    tables: SamplingTables,
    rng: Numbers,
    q: Floats,
    acting: Floats,
    counts: Numbers,
    n_actions: int,
    epsilon: Floats,
    rate: Floats,
    power: float,
    discount: float,
    episodes: int,
    method: int,
    ties: int,
    bootstrap_end: bool,
    max_steps: int,
    snapshot: int,
    snapshots: Numbers,
    last: Numbers,
    returns: Floats,
    first: int,
    budget: int,
) -> tuple[int, int, int]:
    """Learn action values by acting, starting with episode number `first` of all epochs.

    Return the numbers of steps and of episodes cut short, and the number of the next episode. The
    loop returns at the end of the episode in which `budget` steps are exceeded, so that Python can
    handle an interruption.
    """
    low, high, entry, terminal = tables.low, tables.high, tables.entry, tables.terminal
    offsets, cut, following, gains = tables.offsets, tables.cut, tables.next, tables.gain
    double = method == DOUBLE_Q
    steps, cut_short, count, total = 0, 0, len(epsilon) * episodes, 0.0
    if first % episodes > 0:
        total = returns[first // episodes]  # of the finished episodes of this epoch
    for number in range(first, count):
        epoch, episode = number // episodes, number % episodes
        chance, alpha, left = epsilon[epoch], rate[epoch], count - 1 - number
        if episode == 0:
            total = 0.0
        state = first_state(rng, tables)
        # SARSA has planned the next action when it learns; others choose it in the next step.
        planned, step = -1, 0
        while not terminal[unsigned_index(state)]:
            if step == max_steps:
                cut_short += 1
                break
            step += 1
            taken = planned
            if taken < 0:
                taken = choose_position(
                    rng,
                    acting,
                    entry,
                    low[unsigned_index(state)],
                    high[unsigned_index(state)],
                    chance,
                    ties,
                )
            drawn = sample_pair_outcome(rng, offsets, cut, taken)
            gain, state, changed = (
                gains[unsigned_index(drawn)],
                following[unsigned_index(drawn)],
                entry[unsigned_index(taken)],
            )
            total += gain
            # Double Q-learning tosses a coin for the table that learns.
            table = 0
            if double and sample_uniform(rng) < 0.5:
                table = 1
            # U, the value of the next state as the method estimates it; 0 at the end.
            planned, ahead = -1, 0.0
            if bootstrap_end or not terminal[unsigned_index(state)]:
                lo, hi = low[unsigned_index(state)], high[unsigned_index(state)]
                if method == Q_LEARNING:
                    ahead = find_largest(acting, entry, lo, hi)[0]
                elif method == SARSA:
                    planned = choose_position(rng, acting, entry, lo, hi, chance, ties)
                    ahead = acting[entry[planned]]
                elif method == EXPECTED_SARSA:
                    mean = 0.0
                    for i in range(lo, hi):
                        mean += acting[entry[i]] / (hi - lo)
                    ahead = (1.0 - chance) * find_largest(acting, entry, lo, hi)[0] + chance * mean
                else:
                    chosen = choose_greedy_position(rng, q[table], entry, lo, hi, ties)
                    ahead = q[1 - table, entry[chosen]]
            # Q ← Q + α (r + γ U - Q), with α n^-power in the n-th update of an entry.
            size = alpha
            if power != 0.0:
                counts[changed] += 1
                size = alpha * float(counts[changed]) ** -power
            target = gain + discount * ahead
            if double:
                q[table, changed] += size * (target - q[table, changed])
                acting[changed] = q[0, changed] + q[1, changed]
            else:
                acting[changed] += size * (target - acting[unsigned_index(changed)])
        steps += step
        # Record greedy policies, and the mean return at the end of an epoch.
        if episode + 1 == snapshot:
            greedy_policy(rng, acting, tables, ties, n_actions, snapshots[epoch])
        if left < len(last):
            place = last[len(last) - 1 - left]
            greedy_policy(rng, acting, tables, ties, n_actions, place)
        returns[epoch] = total
        if episode + 1 == episodes:
            returns[epoch] = total / episodes
        # Episodes count, too, as they may have no steps.
        if steps + number - first >= budget:
            return steps, cut_short, number + 1
    return steps, cut_short, count


@compile_loop
def sample_returns(
    tables: SamplingTables,
    rng: Numbers,
    scores: Floats,
    which: Numbers,
    chance: float,
    discount: float,
    max_steps: int,
    returns: Floats,
) -> int:
    """Write sampled returns of policies into `returns` (E, episodes); return episodes cut short.

    Episodes of row e act greedily in the flat table scores[which[e]], and at random with
    probability `chance`.
    """
    cut_short = 0
    for row in range(len(which)):
        q = scores[which[row]]
        for episode in range(returns.shape[1]):
            state = first_state(rng, tables)
            total, weight, step = 0.0, 1.0, 0
            while not tables.terminal[state]:
                # Count an episode that is cut short as far as it went.
                if step == max_steps:
                    cut_short += 1
                    break
                step += 1
                # One step: an action, an outcome, its discounted reward.
                low, high = tables.low[state], tables.high[state]
                taken = choose_position(rng, q, tables.entry, low, high, chance, FIRST)
                drawn = sample_pair_outcome(rng, tables.offsets, tables.cut, taken)
                total += weight * tables.gain[drawn]
                weight *= discount
                state = tables.next[drawn]
            returns[row, episode] = total
    return cut_short
