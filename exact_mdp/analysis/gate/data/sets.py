"""Sets of rows that the records allow: one around each counted row; all of them hold at once.

A pair seen n times, with shares p of m states that followed, has an unknown row q. The likelihood
ratio of a Dirichlet mixture against q has mean 1 at every n, so it ever exceeds 1/δ with
probability at most δ (Ville, 1939). With parameters 1/m,

    n KL(p ‖ q) ≤ log(1/δ) + Σ c_i log p_i - log [ Γ(1) / Γ(n + 1) Π Γ(c_i + 1/m) / Γ(1/m) ]

(with the uniform prior: Jonsson and others, NeurIPS 2020, proposition 1), however actions were
chosen. The mean μ of rewards in a range, scaled to [0, 1], obeys n kl(mean seen, μ) ≤ log((n + 1) /
δ) likewise. Each of K = states × actions, and a start that was not given, gets δ = (1 - confidence)
/ (K + 1), a pair half of it for its rewards unless these are known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import log
from typing import Literal, NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy import special

from exact_mdp.analysis.gate.data.interval import (
    Ends,
    cut_off,
    observations_of,
    parse_range,
)
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT
from exact_mdp.solvers.robust.likelihood import Likelihood
from exact_mdp.solvers.robust.sets import RowBlock, list_entries, side_by_side, solve_inner_problem

KNOWN = "known"
Given = Literal["known"] | tuple[object, object] | None


class Step(NamedTuple):
    """The result of an operator at some values, and the linear piece of it at these values."""

    bound: Floats  # for each state or pair, rounding included
    piece: Callable[[], tuple[sp.csr_array, Floats]]  # computes the matrix and the constant


@dataclass(frozen=True, kw_only=True, eq=False)
class RowSets:
    """A set of rows for each pair of a model with counts."""

    mdp: MDP  # a model of rewards, not costs
    counted: Floats  # (L,) observations; 0 for rows that are as certain as the model says
    doubt: float  # the probability that some row is outside of its set
    known: bool  # whether state, action and next state determine the reward
    rewards: Ends  # their range
    episodes: float | None  # number of episodes from which the start was counted; None if known

    @classmethod
    def of(cls, mdp: MDP, doubt: float, rewards: Given = None) -> RowSets:
        """Return the sets for a model's counts; `rewards` as in `Robust`."""
        # The range of the recorded rewards, of pairs that were seen.
        seen = observations_of(mdp).astype(np.float64)
        table = mdp.table
        gains = table.compute_gains()[(seen > 0)[table.pair]]
        ends = (float(gains.min()), float(gains.max()))
        if rewards is None:
            raise ModelError(
                f"no range of rewards is given: the recorded ones, from {ends[0]:g} to "
                f"{ends[1]:g}, do not rule out others",
                where="rewards",
                fix="state it in the evidence: rewards=(low, high), --evidence rewards=LOW,HIGH; "
                "or rewards='known', --evidence rewards=known, if state, action and next state "
                "determine the reward",
            )
        # Rewards are known for each next state, or lie in a stated range that holds all records.
        known = isinstance(rewards, str)
        if known and rewards != KNOWN:
            fix = "give 'known', or (low, high)"
            raise ModelError(f"rewards are {rewards!r}", where="rewards", fix=fix)
        low, high = ends
        if not known:
            low, high = parse_range(rewards, "rewards") or ends
        if not low <= ends[0] <= ends[1] <= high:
            what = f"rewards from {ends[0]:g} to {ends[1]:g} were seen"
            raise ModelError(what, where="rewards", fix="state a range that holds them")
        return cls(
            mdp=mdp.maximised,
            counted=seen,
            doubt=doubt,
            known=known,
            rewards=mdp.sense.orient_interval(low, high),
            episodes=mdp.episodes,
        )

    @property
    def unknown(self) -> Flags:
        """(S,) states in which episodes were cut off, so no record says what follows."""
        return cut_off(self.mdp)

    @property
    def of_a_step(self) -> Ends:
        """The least and the greatest reward of one step, in any state, ends included."""
        certain = self.mdp.reward[self.counted == 0]
        return min(0.0, self.rewards[0], *certain), max(0.0, self.rewards[1], *certain)

    @cached_property
    def pairs(self) -> Integers:
        """(U,) the pairs that were counted."""
        return np.flatnonzero(self.counted > 0)

    @cached_property
    def share(self) -> float:
        """The doubt of each pair: an equal part of the whole."""
        states = np.unique(self.mdp.pair_state[self.pairs])
        return self.doubt / (len(states) * self.mdp.n_actions + (self.episodes is not None))

    @cached_property
    def radius(self) -> Floats:
        """(L,) the radius of each set, a KL divergence from the recorded shares, in nats."""
        counts, n = self.counts, self.counted[self.pairs]
        row = np.repeat(np.arange(len(n)), np.diff(counts.indptr))
        p = counts.data / np.bincount(row, counts.data)[row]
        radius = np.zeros(self.mdp.n_pairs)
        doubt = self.share
        if not self.known:  # the other half is for the mean reward
            doubt /= 2
        radius[self.pairs] = _compute_radii(p, row, n, self.mdp.n_states, doubt)
        return radius

    def at_start(self, value: Floats, *, most: bool) -> float:
        """Return a bound on the mean of values (S,) over every start that the records allow."""
        weights = self.mdp.start_distribution
        if self.episodes is None:
            # The start is known: only the sum is rounded.
            size = 2 * UNIT * float(weights @ np.abs(value))
            rounding = (np.count_nonzero(weights) + 2) * size
            if not most:
                rounding = -rounding
            return float(weights @ value + rounding)
        # The start is one more counted row, with a set of its own.
        begun, one = sp.csr_array(weights[None]), np.array([0])
        n = np.array([self.episodes])
        radius = _compute_radii(begun.data, 0 * begun.indices, n, self.mdp.n_states, self.share)
        blocks = _with_unseen(one, begun, np.zeros(begun.nnz), 0.0)
        if most:
            unseen = value.max()
        else:
            unseen = value.min()
        worst = solve_inner_problem(
            Likelihood(radius=radius),
            blocks,
            np.append(value, unseen),
            discount=1.0,
            against=not most,
        )
        if most:
            ends = worst.high
        else:
            ends = worst.low
        return float(ends[0])

    @cached_property
    def reward(self) -> tuple[Floats, Floats]:
        """(L,) and (L,) bounds of each pair's expected reward; not used if rewards are known."""
        low, high = self.mdp.reward.copy(), self.mdp.reward.copy()
        least, most = self.rewards
        if most > least:
            # The mean of n rewards, scaled to [0, 1], obeys n kl(mean seen, μ) ≤ log((n + 1) / δ).
            n = self.counted[self.pairs]
            mean = np.clip((low[self.pairs] - least) / (most - least), 0.0, 1.0)
            edge = np.log((n + 1) / (self.share / 2)) / n
            low[self.pairs] = least + (most - least) * (1 - _bound_mean_above(1 - mean, edge))
            high[self.pairs] = least + (most - least) * _bound_mean_above(mean, edge)
        return low, high

    @cached_property
    def counts(self) -> sp.csr_array:
        """(U, S) the counts of each counted pair's next states."""
        counts = self.mdp.counts
        assert counts is not None
        return counts[self.pairs]

    @cached_property
    def gains(self) -> Floats:
        """The reward of each entry of `counts`, if rewards are known."""
        mdp, table = self.mdp, self.mdp.table
        seen = (self.counted > 0)[table.pair]
        row, gain = table.pair[seen], table.compute_gains()[seen]
        entry = row.astype(np.int64) * mdp.n_states + table.next[seen]
        _, first, place = np.unique(entry, return_index=True, return_inverse=True)
        unlike = gain != gain[first][place]
        if unlike.any():
            raise ModelError(
                "two rewards were seen for the same next state, so rewards are not known",
                where=mdp.where(int(row[unlike][0])),
                fix="state where rewards lie (--evidence rewards=LOW,HIGH, rewards=(low, high))",
            )
        return np.asarray(gain[first])

    @cached_property
    def blocks(self) -> list[list[RowBlock]]:
        """The counted rows, with the least and with the most reward for unseen next states."""
        seen = np.zeros(self.counts.nnz)
        if self.known:
            seen = self.gains
        never = (gain * self.known for gain in self.rewards)
        return [_with_unseen(self.pairs, self.counts, seen, gain) for gain in never]

    @cached_property
    def laws(self) -> Likelihood:
        """The sets of rows, as the solvers of robust models take them."""
        return Likelihood(radius=self.radius)

    def solve_inner_problem(self, value: Floats, *, most: bool, rewards: bool = True) -> Step:
        """Return the greatest (`most`) or the least r + γ P V of every pair, for values V (S,).

        The piece consists of the rows (L, S) that attain it, and the rewards (L,) under them.
        """
        # A next state that nobody saw may be any: the best or the worst one for the pair.
        mdp, pairs = self.mdp, self.pairs
        if most:
            extreme = value.argmax()
        else:
            extreme = value.argmin()
        far = int(extreme)
        blocks = self.blocks[most]
        values = solve_inner_problem(
            self.laws,
            blocks,
            np.append(value, value[far]),
            discount=mdp.discount,
            against=not most,
            rewards=rewards and self.known,
        )
        bound = mdp.discount * (mdp.transition @ value)  # for rows that are certain
        # Known rewards of counted pairs are part of the inner problem.
        reward = np.zeros(mdp.n_pairs)
        if rewards and self.known:
            reward = np.where(self.counted > 0, 0.0, mdp.reward)
        elif rewards:
            reward = self.reward[most]
        size = np.abs(value).max() + rewards * (np.abs(reward) + np.abs(self.rewards).max())
        length = np.diff(mdp.transition.indptr) + 8
        rounding = length * 4 * UNIT * size + TINY * (size > 0)
        if most:
            bound[pairs] = values.high
        else:
            bound[pairs], rounding = values.low, -rounding
        bound = bound + reward + rounding

        def compute_piece() -> tuple[sp.csr_array, Floats]:
            place, following, weight, earned = list_entries(blocks, values.distributions)
            following = np.where(following == mdp.n_states, far, following)
            certain = mdp.transition.multiply((self.counted == 0).reshape(-1, 1)).tocoo()
            row = np.concatenate([pairs[place], certain.coords[0]])
            column = np.concatenate([following, certain.coords[1]])
            entries = (np.append(weight, certain.data), (row, column))
            total = reward.copy()
            total[pairs] += earned
            return sp.csr_array(entries, mdp.transition.shape), total

        return Step(bound, compute_piece)


def _with_unseen(
    pairs: Integers, counts: sp.csr_array, gains: Floats, gain: float
) -> list[RowBlock]:
    """Return rows of counts (U, S) with one more outcome that nobody saw, to a state number S."""
    ends = counts.indptr
    following = np.insert(counts.indices, ends[1:], counts.shape[1]).astype(np.int64)
    rows = ends[:-1] + np.arange(len(pairs)), np.diff(ends) + 1
    seen = np.insert(counts.data, ends[1:], 0.0), np.insert(gains, ends[1:], gain)
    return side_by_side(pairs, rows, (following, *seen))


def _compute_radii(p: Floats, row: Integers, n: Floats, states: int, doubt: float) -> Floats:
    """Return the radii (U,) of rows seen n (U,) times, with shares `p` (N,) in rows `row` (N,)."""
    if states == 1:
        return np.zeros(len(n))
    # The formula of the module's head, with the sums over the outcomes of each row.
    part, c = 1 / states, p * n[row]
    seen, mixed, alone = c * np.log(p), special.gammaln(c + part), special.gammaln(part)
    ends = special.gammaln(n + 1) + log(1 / doubt)
    total = np.bincount(row, seen - mixed + alone) + ends
    # Rounding: SciPy's terms are a few units off, and their sum is rounded at each addition.
    size = np.bincount(row, np.abs(seen) + np.abs(mixed) + alone) + ends
    return np.asarray((total + (np.bincount(row) + 64) * UNIT * size) / n)


def _bound_mean_above(mean: Floats, edge: Floats) -> Floats:
    """Return upper bounds (U,) of μ with kl(mean, μ) ≤ edge, for Bernoulli variables."""
    # Bisection of [mean, 1]: the upper end is a bound after any number of halvings, and 60 reach
    # the resolution of doubles.
    low, high = mean.copy(), np.ones_like(mean)
    for _ in range(60):
        middle = (low + high) / 2
        apart = special.rel_entr(mean, middle) + special.rel_entr(1 - mean, 1 - middle)
        beyond = apart > edge + 16 * UNIT * (1 + edge)  # by more than its rounding errors
        low, high = np.where(beyond, [low, middle], [middle, high])
    return np.minimum(high * SLACK, 1.0)
