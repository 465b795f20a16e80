"""Numbers of the states as exact integers, and what each pair gains against them.

With d(x) = Σ P(l, s') x(s') - x(s) for each pair l of state s, the levels of a certificate satisfy

    d(g) ≤ 0;    where d(g) = 0:  r - g + d(h) ≤ 0;    where this is 0, too:  d(w) - h ≤ 0

(`solvers.exact.checker`); where V alone does, r + γ P V - V ≤ 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import lcm
from operator import mul

import numpy as np

from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.mdp.table import Integers, Numbers, common
from exact_mdp.solvers.proof.rationals import fractions, primes_of


@dataclass(frozen=True, kw_only=True, eq=False)
class Level:
    """Numbers of the states, x(s) = top[s] / below[group[s]].

    States share denominators in groups: where these are long, and far apart, one for all would be
    many times as long.
    """

    top: list[int]
    below: list[int]
    group: Integers
    _times: dict[frozenset[int], tuple[int, dict[int, int]]] = field(
        default_factory=dict, init=False, repr=False
    )

    @classmethod
    def over(cls, top: Iterable[int], below: int) -> Level:
        """Return integers over one denominator."""
        listed = list(top)
        return cls(top=listed, below=[below], group=np.zeros(len(listed), dtype=np.int64))

    @classmethod
    def of(cls, numbers: Sequence[Fraction]) -> Level:
        """Return rationals over one denominator."""
        return cls.over(*common(numbers))

    @property
    def each_below(self) -> list[int]:
        """The denominator of each state."""
        return [self.below[group] for group in self.group.tolist()]

    def fractions(self, sign: int = 1) -> Numbers:
        """Return (S,) the numbers as Fractions, times a sign."""
        top = self.top if sign > 0 else [-number for number in self.top]
        return fractions(top, self.each_below, primes_of(self.below))

    def over_one(self, states: Sequence[int], group: Sequence[int]) -> tuple[list[int], int]:
        """Return the numbers of some states over a common denominator; `group` is the list."""
        top = self.top
        if len(self.below) == 1:
            return [top[s] for s in states], self.below[0]
        groups = frozenset([group[s] for s in states])
        if len(groups) == 1:
            return [top[s] for s in states], self.below[group[states[0]]]
        if groups not in self._times:
            unit = lcm(*(self.below[each] for each in groups))
            self._times[groups] = unit, {each: unit // self.below[each] for each in groups}
        unit, times = self._times[groups]
        return [top[s] * times[group[s]] for s in states], unit

    def mean(self, weights: Iterable[tuple[int, Fraction]]) -> Fraction:
        """Return Σ weight · x(s), of pairs of a state and a weight."""
        states, shares = zip(*weights, strict=True)
        values, unit = self.over_one(states, self.group.tolist())
        parts, below = common(shares)
        return Fraction(sum(map(mul, values, parts)), unit * below)


Column = tuple[list[int], list[int]]
"""Numbers of some pairs (K,): integers, and the positive integers that they are over."""


def surplus(rows: BellmanRows, *levels: Level, pairs: Integers | None = None) -> list[Column]:
    """Return what pairs, all by default, gain against one level V, or against g, h and w.

    That is r + γ P V - V, or d(g), r - g + d(h) and d(w) - h. Pairs of a state have the same number
    below where the level has one denominator.
    """
    scale, constant = rows.scale.tolist(), rows.constant.tolist()
    if len(levels) == 1:
        return [_column(rows, levels[0], lambda pair, _: (constant[pair], 1), pairs)]
    g, h, w = levels
    mean, bias = g.each_below, h.each_below
    return [
        _column(rows, g, lambda *_: (0, 1), pairs),
        _column(
            rows, h, lambda l, s: (constant[l] * mean[s] - scale[s] * g.top[s], mean[s]), pairs
        ),
        _column(rows, w, lambda _, s: (-scale[s] * h.top[s], bias[s]), pairs),
    ]


def _column(
    rows: BellmanRows,
    x: Level,
    earned: Callable[[int, int], tuple[int, int]],
    pairs: Integers | None,
) -> Column:
    """Return earned + γ P x - x, where (a, b) earns a / (b · scale of the state)."""
    offsets, following, weight = (p.tolist() for p in (rows.offsets, rows.next, rows.weight))
    scale, state, group = rows.scale.tolist(), rows.pair_state.tolist(), x.group.tolist()
    tops, belows = list[int](), list[int]()
    for pair in range(len(state)) if pairs is None else pairs.tolist():
        own, here = state[pair], slice(offsets[pair], offsets[pair + 1])
        values, unit = x.over_one([*following[here], own], group)
        flow = sum(map(mul, weight[here], values)) - scale[own] * values[-1]
        top, below = earned(pair, own)
        tops.append(top * unit + flow * below)
        belows.append(scale[own] * unit * below)
    return tops, belows
