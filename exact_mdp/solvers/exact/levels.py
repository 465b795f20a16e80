"""Levels: exact numbers of the states as integers, and the advantages of pairs over them.

With d(x) = Σ P(l, s') x(s') - x(s) for each pair l of state s, the levels of a certificate satisfy

    d(g) ≤ 0;    where d(g) = 0:  r - g + d(h) ≤ 0;    where this is also 0:  d(w) - h ≤ 0

(`solvers.exact.checker`). A certificate with V alone satisfies r + γ P V - V ≤ 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import lcm
from operator import mul

import flint
import numpy as np

from exact_mdp.mdp.exact import BellmanRows, from_flint
from exact_mdp.mdp.table import Floats, Integers, Numbers, divide, to_common_denominator


def make_fraction(top: int, bottom: int) -> Fraction:
    """Return the Fraction top / bottom, for a positive bottom, in little more than linear time."""
    # FLINT's gcd is much faster than Python's for long integers.
    return from_flint(flint.fmpq(top, bottom))


@dataclass(frozen=True, kw_only=True, eq=False)
class Level:
    """Numbers of the states, x(s) = top[s] / below[group[s]].

    States share denominators in groups. If these are long and differ, a single denominator for all
    states would be many times as long.
    """

    top: list[int]
    below: list[int]
    group: Integers
    _times: dict[frozenset[int], tuple[int, dict[int, int]]] = field(
        default_factory=dict, init=False, repr=False
    )

    @classmethod
    def of(cls, numbers: Sequence[Fraction]) -> Level:
        """Return rationals over one denominator."""
        top, below = to_common_denominator(numbers)
        return cls.from_groups(top, [below], np.zeros(len(top), dtype=np.int64))

    @classmethod
    def from_groups(cls, top: list[int], below: Sequence[int], group: Integers) -> Level:
        """Return integers over several denominators, without the denominators that none uses."""
        used, group = np.unique(group, return_inverse=True)
        return cls(top=top, below=[*map(below.__getitem__, used.tolist())], group=group)

    @property
    def each_below(self) -> list[int]:
        """The denominator of each state."""
        return [*map(self.below.__getitem__, self.group.tolist())]

    def to_fractions(self, sign: int = 1) -> Numbers:
        """Return the numbers (S,) as Fractions, times a sign."""
        numbers = np.empty(len(self.top), dtype=object)
        for state, (a, b) in enumerate(zip(self.top, self.each_below, strict=True)):
            numbers[state] = make_fraction(sign * a, b)
        numbers.setflags(write=False)
        return numbers

    def to_floats(self, sign: int = 1) -> Floats:
        """Return the numbers (S,) as floats, each rounded once, times a sign."""
        numbers = divide(sign * np.array(self.top, object), np.array(self.each_below, object))
        numbers.setflags(write=False)
        return numbers

    def over_one(self, states: Sequence[int], group: Sequence[int]) -> tuple[list[int], int]:
        """Return the numbers of some states over a common denominator.

        `group` is `self.group` as a list, which the caller converts only once.
        """
        numbers = [*map(self.top.__getitem__, states)]
        if len(self.below) == 1:
            return numbers, self.below[0]
        # The same groups meet again and again: keep their common multiple and its factors.
        own = [*map(group.__getitem__, states)]
        groups = frozenset(own)
        if groups not in self._times:
            unit = lcm(*map(self.below.__getitem__, groups))
            self._times[groups] = unit, {each: unit // self.below[each] for each in groups}
        unit, times = self._times[groups]
        return [*map(mul, numbers, map(times.__getitem__, own))], unit

    def compute_mean(self, weights: Iterable[tuple[int, Fraction]]) -> Fraction:
        """Return Σ weight · x(s) over (state, weight) pairs."""
        listed = [*weights]
        values, unit = self.over_one([state for state, _ in listed], self.group.tolist())
        parts, below = to_common_denominator([share for _, share in listed])
        return make_fraction(sum(map(mul, values, parts)), unit * below)


def combine_levels(levels: Sequence[Level], weights: Sequence[int | Fraction]) -> Level:
    """Return Σ weight · x of levels with the same denominators, for rational weights."""
    whole, unit = to_common_denominator([Fraction(weight) for weight in weights])
    tops = zip(*(level.top for level in levels), strict=True)
    first = levels[0]
    return Level(
        top=[sum(map(mul, whole, each)) for each in tops],
        below=[unit * below for below in first.below],
        group=first.group,
    )


Step = tuple[Level, list[int], list[int]]
"""A level x, and the rewards (L,) beside it times the scale of their states: top, below."""


def list_level_steps(rows: BellmanRows, *levels: Level) -> list[Step]:
    """Return each level with its rewards: r for a single V; 0, r - g and -h for g, h and w."""
    constant, ones = rows.constant.tolist(), [1] * len(rows.constant)
    if len(levels) == 1:
        return [(levels[0], constant, ones)]
    # All rewards are multiplied by the scale of their state, and g and h have denominators.
    g, h, w = levels
    scale, state = rows.scale.tolist(), rows.pair_state.tolist()
    mean, bias = g.each_below, h.each_below
    each = []
    for own, s in zip(constant, state, strict=True):
        each.append((own, s, mean[s], scale[s]))
    return [
        (g, [0] * len(state), ones),
        (h, [own * m - k * g.top[s] for own, s, m, k in each], [m for _, _, m, _ in each]),
        (w, [-scale[s] * h.top[s] for s in state], [bias[s] for s in state]),
    ]


def yield_level_advantages(
    rows: BellmanRows, step: Step, pairs: Integers | None = None
) -> Iterator[tuple[int, int, int]]:
    """Yield the advantages of pairs, all by default, over one level: reward + γ P x - x.

    Each is an integer and two positive factors of its denominator.
    """
    x, tops, belows = step
    offsets, following, weight = rows.offsets.tolist(), rows.next.tolist(), rows.weight.tolist()
    scale, state, group = rows.scale.tolist(), rows.pair_state.tolist(), x.group.tolist()
    numbers: Iterable[int] = range(len(state))
    if pairs is not None:
        numbers = pairs.tolist()
    for pair in numbers:
        own, here = state[pair], slice(offsets[pair], offsets[pair + 1])
        # γ P x - x over the scale of the state and the common denominator of x; then the reward.
        values, unit = x.over_one([*following[here], own], group)
        flow = sum(map(mul, weight[here], values)) - scale[own] * values[-1]
        yield tops[pair] * unit + flow * belows[pair], unit, scale[own] * belows[pair]


def compute_surpluses(
    rows: BellmanRows, *levels: Level, pairs: Integers | None = None
) -> list[list[tuple[int, int]]]:
    """Return the advantages of pairs, all by default, over one level V, or over g, h and w.

    That is r + γ P V - V, or d(g), r - g + d(h) and d(w) - h, each as numerator and denominator.
    """
    surpluses = []
    for step in list_level_steps(rows, *levels):
        advantages = yield_level_advantages(rows, step, pairs)
        surpluses.append([(top, unit * below) for top, unit, below in advantages])
    return surpluses


def compute_surplus_signs(rows: BellmanRows, step: Step, known: Integers | None = None) -> Integers:
    """Return the sign (L,) of each advantage; it is 0, without being computed, for `known` pairs.

    These are the pairs of the policy, whose advantages are 0 by definition of its values, and
    those that an earlier level has decided.
    """
    others = np.ones(len(rows.constant), dtype=bool)
    if known is not None:
        others[known] = False
    sign = np.zeros(len(others), dtype=np.int64)
    each = yield_level_advantages(rows, step, np.flatnonzero(others))
    sign[others] = [(top > 0) - (top < 0) for top, _, _ in each]
    return sign
