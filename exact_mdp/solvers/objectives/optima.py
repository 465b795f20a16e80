"""Weighted optima of several totals in rational arithmetic, ties settled one weight after another.

    V_w(s) = max over pairs l of s of  w · c(l) + γ Σ_s' P(l, s') V_w(s')

Among the policies that take optimal pairs alone, all of them optimal for w, the next weights choose
again. Where the weights span all directions, one vector of totals is left: an extreme point of what
policies attain (lexicographic optima: Isermann, OR Spektrum 4, 1982).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import lcm
from typing import TYPE_CHECKING, Any

import flint
import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from exact_mdp.mdp.exact import rational
from exact_mdp.mdp.graph import termination
from exact_mdp.mdp.table import Integers, Numbers, common, integers, spans
from exact_mdp.solvers.exact.find import best, evaluated, nearly
from exact_mdp.solvers.exact.levels import Level, quotient
from exact_mdp.solvers.exact.linear import Matrix
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.checker import Attained, Rank, Values, slack

if TYPE_CHECKING:
    from flint import fmpq


STEPS = 100  # of policy iteration in floats
NOISE = 2.0**-40  # relative, far above the rounding of a few operations

Weights = Sequence[int] | Sequence[Fraction]


@dataclass(frozen=True, kw_only=True, eq=False)
class Optimum:
    """The optimum of weighted objectives: its value at the start, and the pairs that attain it."""

    total: Fraction
    values: Values
    optimal: Integers  # (K,) pairs


def optimum(of: Objectives, weights: Weights, pairs: Integers | None = None) -> Optimum:
    """Return the optimum for weights of at least 0 over some pairs, by default all."""
    whole, below = common([Fraction(w) for w in weights])
    chosen = np.arange(of.mdp.n_pairs) if pairs is None else pairs
    rows = of.restricted(chosen, of.weighted(whole))
    _, level, sign = best(rows, nearly(rows, rows.pair_offsets[:-1]))
    values = _values(level, below)
    optimal = (sign == 0) | rows.terminal[rows.pair_state]
    return Optimum(total=of.at_start(*values), values=values, optimal=chosen[optimal])


def extreme(of: Objectives, weights: Weights, first: Optimum) -> Attained:
    """Return a policy whose totals no others dominate or mix to, of those optimal for weights.

    `first` is their optimum. Its values and those of the weights that settle ties are values of the
    policy, and as many as there are objectives, so that they give the value of each.
    """
    size = len(weights)
    ties = [tuple(int(i == k) for i in range(size)) for k in range(size)]
    if not all(weights):
        ties.insert(0, (1,) * size)
    own: list[Any] = [rational(w) for w in weights]
    chosen, found, pairs = [own], [first.values], first.optimal
    for tie in ties:
        if len(chosen) == size:
            break
        if flint.fmpq_mat([*chosen, list(tie)]).rank() > len(chosen):
            next_ = optimum(of, tie, pairs)
            chosen, pairs = [*chosen, list(tie)], next_.optimal
            found.append(next_.values)
    state = of.mdp.pair_state[pairs]
    values = tuple(_mixed(found, row) for row in flint.fmpq_mat(chosen).inv().tolist())
    return Attained(
        pairs=pairs[np.flatnonzero(np.diff(state, prepend=-1))],
        values=values,
        total=tuple(of.at_start(*own) for own in values),
    )


def proposed(of: Objectives, weights: Sequence[Fraction], pairs: Integers) -> Integers:
    """Return (S,) pairs that floats take for optimal, by policy iteration from some pairs on."""
    try:
        return _iterated(of, weights, pairs)
    except (OverflowError, RuntimeError):  # beyond the floats, or singular in them
        return pairs


def _iterated(of: Objectives, weights: Sequence[Fraction], pairs: Integers) -> Integers:
    rows, state = of.rows, of.mdp.pair_state
    moves, amounts = of.in_floats
    gain, chosen = np.array([float(w) for w in weights]) @ amounts, pairs.copy()
    stay = sparse.eye_array(len(rows.scale), format="csc")
    for _ in range(STEPS):
        value = linalg.splu((stay - moves[chosen]).tocsc()).solve(gain[chosen])
        worth = gain + moves @ value
        best = np.maximum.reduceat(worth, rows.pair_offsets[:-1])
        better = best > worth[chosen] + NOISE * (np.abs(best) + np.abs(value).max())
        if not better.any():
            break
        leads = np.flatnonzero(worth == best[state])
        chosen[better] = leads[np.searchsorted(state[leads], np.flatnonzero(better))]
    return chosen


class Losses:
    """What each pair loses against a policy, for all weights: a linear function of the weights.

    Floats tell the sign of a loss where they can, and integers where they cannot.
    """

    def __init__(self, of: Objectives, policy: Attained) -> None:
        self.policy, below = policy, [values.below for values in policy.values]
        each = [slack(of, a, v) for a, v in zip(of.amounts, policy.values, strict=True)]
        self.exact = [numbers.tolist() for numbers in each]
        self.times = [lcm(*below) // own for own in below]
        near = [[quotient(n, b) for n in own] for own, b in zip(self.exact, below, strict=True)]
        self.near = np.array(near)

    def signs(self, weights: Sequence[int]) -> Integers:
        """Return (L,) the sign of each pair's loss for weights of at least 0."""
        shares = np.array([w / sum(weights) for w in weights])
        with np.errstate(invalid="ignore"):
            parts = shares[:, None] * self.near
            total = parts.sum(axis=0)
            known = np.abs(total) > NOISE * np.abs(parts).sum(axis=0)
        found = np.where(known, np.sign(total), 0).astype(np.int64)
        for pair in np.flatnonzero(~known).tolist():
            each = zip(weights, self.times, self.exact, strict=True)
            loss = sum(w * t * own[pair] for w, t, own in each)
            found[pair] = (loss > 0) - (loss < 0)
        return found

    def optimum(self, of: Objectives, weights: Sequence[int], signs: Integers) -> Optimum:
        """Return the optimum for weights for which no pair's loss is negative."""
        values = _mixed(self.policy.values, [flint.fmpq(w) for w in weights])
        return Optimum(
            total=of.at_start(*values), values=values, optimal=np.flatnonzero(signs == 0)
        )


def known_optimum(of: Objectives, weights: Sequence[int], policy: Attained) -> Values | None:
    """Return the weighted values of a policy where no pair gains on them: then they are optimal."""
    values = _mixed(policy.values, [flint.fmpq(w) for w in weights])
    return None if (slack(of, of.weighted(weights), values) < 0).any() else values


def _mixed(values: Sequence[Values], factors: Sequence[fmpq]) -> Values:
    """Return a linear combination of values."""
    below = lcm(*(own.below * int(f.q) for own, f in zip(values, factors, strict=True)))
    parts = [
        [number * (int(f.p) * (below // (own.below * int(f.q)))) for number in own.top]
        for own, f in zip(values, factors, strict=True)
        if f
    ]
    return Values([sum(numbers) for numbers in zip(*parts, strict=True)], below)


def attained(of: Objectives, pairs: Integers) -> Attained:
    """Return the totals of the policy that takes one pair (S,) of each state."""
    found = [_values(level, 1) for level in evaluated(of.rows, pairs, of.amounts)]
    return Attained(pairs=pairs, values=tuple(found), total=tuple(of.at_start(*v) for v in found))


def equations(
    of: Objectives,
    live: Integers,
    chosen: Integers,
    limited: Sequence[Numbers] = (),
    *,
    steps: bool = False,
) -> Matrix:
    """Return the equations of pairs, states' first, over the values of live states and prices.

    `limited` are the amounts, of each pair, that have prices; with `steps`, the last equation says
    that prices sum to 1.
    """
    states, size, state = len(live), len(live) + len(limited), of.mdp.pair_state[chosen]
    place = np.full(of.mdp.n_states, -1)
    place[live] = np.arange(states)
    first, last = of.rows.offsets[chosen], of.rows.offsets[chosen + 1]
    entries, number = spans(first, last), np.arange(len(chosen))
    ahead = place[of.rows.next[entries]]
    inside = ahead >= 0
    row = [np.repeat(number, last - first)[inside], number, *[number for _ in limited]]
    column = [ahead[inside], place[state], *[number * 0 + states + k for k in range(len(limited))]]
    entry = [-of.rows.weight[entries][inside].astype(object), of.rows.scale[state].astype(object)]
    entry += [-own for own in limited]
    if steps:
        row.append(np.full(len(limited), size - 1))
        column.append(np.arange(states, size))
        entry.append(np.full(len(limited), 1, dtype=object))
    return Matrix.of(
        size, np.concatenate(row), np.concatenate(column), integers(np.concatenate(entry).tolist())
    )


def rank_of(of: Objectives) -> Rank:
    """Return what proves that the equations of every policy have one solution."""
    return termination(of.ending).rank if of.mdp.discount_exact == 1 else None


def _values(level: Level, times: int) -> Values:
    """Return values over one denominator, which is `times` as large."""
    top, below = level.over_one(range(len(level.top)), level.group.tolist())
    return Values(top, below * times)
