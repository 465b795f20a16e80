"""Which rows the records allow: a set around each counted row, all of them right at once.

A pair seen n times, with shares p of m states that followed, has an unknown row q. The likelihood
ratio of a Dirichlet mixture against q has mean 1 at every n, so that it ever exceeds 1/δ with
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
    of_sense,
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
HALVINGS = 60  # of [0, 1]: fewer leave a bound sound, but wider
Given = Literal["known"] | tuple[object, object] | None


class Step(NamedTuple):
    """An operator at some values: a bound of each state's or pair's, rounding included."""

    bound: Floats
    piece: Callable[[], tuple[sp.csr_array, Floats]]  # works out the linear piece it is of


@dataclass(frozen=True, kw_only=True, eq=False)
class RowSets:
    """A set of rows for each pair of a model with counts."""

    mdp: MDP  # of rewards, not costs
    counted: Floats  # (L,) observations; 0 for rows that are as certain as the model says
    doubt: float  # the probability that some row is outside of its set
    known: bool  # whether state, action and next state decide the reward
    rewards: Ends  # where they lie
    episodes: float | None  # how many the start was counted from; None where it is known

    @classmethod
    def of(cls, mdp: MDP, doubt: float, rewards: Given = None) -> RowSets:
        """Return the sets of a model's counts; `rewards` as `Robust` has them."""
        seen = observations_of(mdp).astype(np.float64)
        table = mdp.table
        gains = table.compute_gains()[(seen > 0)[table.pair]]
        ends = (float(gains.min()), float(gains.max()))
        if rewards is None:
            raise ModelError(
                f"nothing says where rewards lie: those seen, from {ends[0]:g} to {ends[1]:g}, do "
                "not prove that no other comes",
                where="rewards",
                fix="state it in the evidence: rewards=(low, high), --evidence rewards=LOW,HIGH; "
                "or rewards='known', --evidence rewards=known, where state, action and next state "
                "decide the reward",
            )
        known = isinstance(rewards, str)
        if known and rewards != KNOWN:
            fix = "give 'known', or (low, high)"
            raise ModelError(f"rewards are {rewards!r}", where="rewards", fix=fix)
        low, high = ends if known else parse_range(rewards, "rewards") or ends
        if not low <= ends[0] <= ends[1] <= high:
            what = f"rewards from {ends[0]:g} to {ends[1]:g} were seen"
            raise ModelError(what, where="rewards", fix="state a range that holds them")
        return cls(
            mdp=mdp.maximised,
            counted=seen,
            doubt=doubt,
            known=known,
            rewards=of_sense(mdp, (low, high)),
            episodes=mdp.episodes,
        )

    @property
    def unknown(self) -> Flags:
        """(S,) states of which nobody knows what follows: episodes were cut off there."""
        return cut_off(self.mdp)

    @property
    def of_a_step(self) -> Ends:
        """What one step may earn at least and at most, in every state, ends among them."""
        certain = self.mdp.reward[self.counted == 0]
        return min(0.0, self.rewards[0], *certain), max(0.0, self.rewards[1], *certain)

    @cached_property
    def pairs(self) -> Integers:
        """(U,) the pairs that were counted."""
        return np.flatnonzero(self.counted > 0)

    @cached_property
    def share(self) -> float:
        """The doubt that is left to each pair."""
        states = np.unique(self.mdp.pair_state[self.pairs])
        return self.doubt / (len(states) * self.mdp.n_actions + (self.episodes is not None))

    @cached_property
    def radius(self) -> Floats:
        """(L,) how far a row may be, by KL divergence from the shares that were seen; in nats."""
        counts, n = self.counts, self.counted[self.pairs]
        row = np.repeat(np.arange(len(n)), np.diff(counts.indptr))
        p = counts.data / np.bincount(row, counts.data)[row]
        radius = np.zeros(self.mdp.n_pairs)
        doubt = self.share if self.known else self.share / 2
        radius[self.pairs] = _compute_radii(p, row, n, self.mdp.n_states, doubt)
        return radius

    def at_start(self, value: Floats, *, most: bool) -> float:
        """Return a bound, rounding included, of values (S,) at the start: of all that it may be."""
        weights = self.mdp.start_distribution
        if self.episodes is None:
            size = 2 * UNIT * float(weights @ np.abs(value))
            rounding = (np.count_nonzero(weights) + 2) * size
            return float(weights @ value + (rounding if most else -rounding))
        begun, one = sp.csr_array(weights[None] / weights.sum()), np.array([0])
        n = np.array([self.episodes])
        radius = _compute_radii(begun.data, 0 * begun.indices, n, self.mdp.n_states, self.share)
        blocks = _with_unseen(one, begun, np.zeros(begun.nnz), 0.0)
        values = np.append(value, value.max() if most else value.min())
        worst = solve_inner_problem(
            Likelihood(radius=radius), blocks, values, discount=1.0, against=not most
        )
        return float(worst.high[0] if most else worst.low[0])

    @cached_property
    def reward(self) -> tuple[Floats, Floats]:
        """(L,) and (L,) bounds of each pair's expected reward; unless rewards are known."""
        low, high = self.mdp.reward.copy(), self.mdp.reward.copy()
        least, most = self.rewards
        if most > least:
            n = self.counted[self.pairs]
            mean = np.clip((low[self.pairs] - least) / (most - least), 0.0, 1.0)
            edge = np.log((n + 1) / (self.share / 2)) / n * SLACK
            low[self.pairs] = least + (most - least) * (1 - _bound_mean_above(1 - mean, edge))
            high[self.pairs] = least + (most - least) * _bound_mean_above(mean, edge)
        return low, high

    @cached_property
    def counts(self) -> sp.csr_array:
        """(U, S) how often each counted pair was seen to lead to each state."""
        counts = self.mdp.counts
        assert counts is not None
        return counts[self.pairs]

    @cached_property
    def gains(self) -> Floats:
        """The reward of each entry of `counts`, where rewards are known."""
        mdp, table = self.mdp, self.mdp.table
        seen = (self.counted > 0)[table.pair]
        row, gain = table.pair[seen], table.compute_gains()[seen]
        entry = row.astype(np.int64) * mdp.n_states + table.next[seen]
        _, first, place = np.unique(entry, return_index=True, return_inverse=True)
        if (unlike := gain != gain[first][place]).any():
            raise ModelError(
                "two rewards were seen for the same next state, so that rewards are not known",
                where=mdp.where(int(row[unlike][0])),
                fix="state where rewards lie (--evidence rewards=LOW,HIGH, rewards=(low, high))",
            )
        return np.asarray(gain[first])

    @cached_property
    def blocks(self) -> list[list[RowBlock]]:
        """The counted rows; with the least reward where nobody saw one, and with the most."""
        seen = self.gains if self.known else np.zeros(self.counts.nnz)
        never = (gain * self.known for gain in self.rewards)
        return [_with_unseen(self.pairs, self.counts, seen, gain) for gain in never]

    @cached_property
    def laws(self) -> Likelihood:
        """What rows may be."""
        return Likelihood(radius=self.radius)

    def solve_inner_problem(self, value: Floats, *, most: bool, rewards: bool = True) -> Step:
        """Return what nature makes of every pair at values (S,): as much or as little as it can.

        The piece has the laws (L, S) that it chose, and the rewards (L,) under them.
        """
        mdp, pairs = self.mdp, self.pairs
        far = int(value.argmax() if most else value.argmin())
        blocks = self.blocks[most]
        values = solve_inner_problem(
            self.laws,
            blocks,
            np.append(value, value[far]),
            discount=mdp.discount,
            against=not most,
            rewards=rewards and self.known,
        )
        sign = 1 if most else -1
        bound = mdp.discount * (mdp.transition @ value)  # of rows that are certain
        reward = self.reward[most] if rewards and not self.known else np.zeros(mdp.n_pairs)
        if rewards and self.known:
            reward = np.where(self.counted > 0, 0.0, mdp.reward)
        bound[pairs] = values.high if most else values.low
        size = np.abs(value).max() + rewards * (np.abs(reward) + np.abs(self.rewards).max())
        length = np.diff(mdp.transition.indptr) + 8
        bound = bound + reward + sign * (length * 4 * UNIT * size + TINY * (size > 0))

        def compute_piece() -> tuple[sp.csr_array, Floats]:
            place, following, weight, earned = list_entries(blocks, values.laws)
            following = np.where(following == mdp.n_states, far, following)
            certain = mdp.transition.multiply((self.counted == 0).reshape(-1, 1)).tocoo()
            row = np.concatenate([pairs[place], certain.coords[0]])
            column = np.concatenate([following, certain.coords[1]])
            laws = (np.append(weight, certain.data), (row, column))
            total = reward.copy()
            total[pairs] += earned
            return sp.csr_array(laws, mdp.transition.shape), total

        return Step(bound, compute_piece)


def _with_unseen(
    pairs: Integers, counts: sp.csr_array, gains: Floats, gain: float
) -> list[RowBlock]:
    """Return rows of counts (U, S) with one more outcome that nobody saw, its state number S."""
    ends = counts.indptr
    following = np.insert(counts.indices, ends[1:], counts.shape[1]).astype(np.int64)
    rows = ends[:-1] + np.arange(len(pairs)), np.diff(ends) + 1
    seen = np.insert(counts.data, ends[1:], 0.0), np.insert(gains, ends[1:], gain)
    return side_by_side(pairs, rows, (following, *seen))


def _compute_radii(p: Floats, row: Integers, n: Floats, states: int, doubt: float) -> Floats:
    """Return (U,) the radii of rows, each seen n (U,) times with shares `p` at their `row` (N,)."""
    if states == 1:
        return np.zeros(len(n))
    part, c = 1 / states, p * n[row]
    seen, mixed, alone = c * np.log(p), special.gammaln(c + part), special.gammaln(part)
    ends = special.gammaln(n + 1) + log(1 / doubt)
    total = np.bincount(row, seen - mixed + alone) + ends
    # A sum of numbers that SciPy leaves a few units off, and that are rounded as often as they add.
    size = np.bincount(row, np.abs(seen) + np.abs(mixed) + alone) + ends
    return np.asarray((total + (np.bincount(row) + 64) * UNIT * size) / n)


def _bound_mean_above(mean: Floats, edge: Floats) -> Floats:
    """Return (U,) no less than the greatest μ with kl(mean, μ) ≤ edge, kl that of two coins."""
    low, high = mean.copy(), np.ones_like(mean)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        apart = special.rel_entr(mean, middle) + special.rel_entr(1 - mean, 1 - middle)
        beyond = apart > edge + 16 * UNIT * (1 + edge)  # by more than its rounding errors
        low, high = np.where(beyond, [low, middle], [middle, high])
    return np.minimum(high * SLACK, 1.0)
