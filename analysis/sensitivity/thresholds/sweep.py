"""From one end of a piece to the other: every point at which an optimal action changes.

A policy π stays optimal until the first root at which one of its gap polynomials turns negative.
Just beyond it the model is solved exactly, and the new policy's gaps show that it is optimal from
that very root on: none of them may turn negative between the root and the point of solving, else
that point is moved closer. So no threshold is passed over, however close two of them lie.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.gate.regret import proven
from exact_mdp.analysis.sensitivity.thresholds.gaps import Gaps, Rows
from exact_mdp.analysis.sensitivity.thresholds.roots import Root, roots, sign, simple
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers

if TYPE_CHECKING:
    from flint import fmpq_poly

WIDTH = Fraction(1, 10**12)
GRID = 10**13
ATTEMPTS = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class Stretch:
    """An open interval in which the set of optimal actions stays as it is.

    Attributes
    ----------
    before : (Fraction, Fraction)
        Bracket of its lower end.
    after : (Fraction, Fraction)
        Bracket of its upper end; both are values of the parameter.
    optimal : (L,) bool
        The pairs that are optimal throughout.
    policy : (S,) int64
        Pairs of one optimal policy.
    touches : list of (low, high, pair)
        Points inside at which one more pair is as good, and no better.
    """

    before: tuple[Fraction, Fraction]
    after: tuple[Fraction, Fraction]
    optimal: np.ndarray
    policy: Integers
    touches: list[tuple[Fraction, Fraction, int]]


class Sweep:
    """A walk over one piece (low, high) of a parameter, whose rows are polynomials there."""

    def __init__(
        self, rows: Rows, at: Callable[[Fraction], MDP], low: Fraction, high: Fraction
    ) -> None:
        self.rows, self.at, self.origin = rows, at, rows.change.origin
        self.low, self.high = low - self.origin, high - self.origin
        self.gaps = Gaps(rows, (self.low, self.high))
        self.simple: dict[int, fmpq_poly] = {}
        self.first: dict[int, Root | None] = {}
        self.touching: dict[int, list[Root]] = {}
        self.policy: Integers = np.empty(0, dtype=np.int64)

    def __iter__(self) -> Iterator[Stretch]:
        begin = Root(poly=self._line(self.low), low=self.low, high=self.low)
        before, here = (self.low, self.low), self._settle(begin, self.high)
        while True:
            found = self._next(here)
            if found is None:
                yield self._stretch(before, (self.high, self.high), here)
                return
            root = found.narrowed(WIDTH / 16)
            policy, optimal, start = self.policy, self._optimal(), here
            touches = self._touches(start, root.low)
            here, bracket = self._cross(root, start)
            yield Stretch(
                before=self._shift(before),
                after=self._shift(bracket),
                optimal=optimal,
                policy=policy,
                touches=touches,
            )
            before = bracket

    # ---- the next root -----------------------------------------------------------------------

    def _next(self, here: Fraction) -> Root | None:
        """Return the first root beyond `here` at which a gap turns negative."""
        best: Root | None = None
        for pair, poly in enumerate(self.gaps.gap):
            if poly.degree() < 1:
                continue
            root = self._first(pair, poly, here)
            if root is not None:
                best = root if best is None else _earlier(best, root)
        return best

    def _first(self, pair: int, poly: fmpq_poly, here: Fraction) -> Root | None:
        if pair in self.first:
            known = self.first[pair]
            if known is None or known.low >= here:
                return known
        self.first[pair], self.touching[pair] = None, []
        for root in roots(self._simple(pair, poly), here, self.high):
            if _turns(poly, root):
                self.first[pair] = root
                break
            self.touching[pair].append(root)
        return self.first[pair]

    def _simple(self, pair: int, poly: fmpq_poly) -> fmpq_poly:
        if pair not in self.simple:
            self.simple[pair] = simple(poly)
        return self.simple[pair]

    def _follow(self, policy: Integers) -> None:
        self.policy = policy
        self.gaps.follow(policy)
        for pair in self.gaps.renewed:
            for known in (self.simple, self.first, self.touching):
                known.pop(pair, None)

    # ---- beyond a root -----------------------------------------------------------------------

    def _settle(self, root: Root, limit: Fraction) -> Fraction:
        """Follow the policy that is optimal from a rational point on; return a point beyond it."""
        step = (limit - root.high) / 64
        for _ in range(ATTEMPTS):
            point = root.high + step
            if self._fits(root, (root.high, point)):
                return point
            step = step * 3 / 64
        raise RuntimeError("no policy is optimal beyond a point: thresholds without end")

    def _cross(self, root: Root, here: Fraction) -> tuple[Fraction, tuple[Fraction, Fraction]]:
        """Follow the policy beyond a root; return a point where it is optimal, and the bracket."""
        width = WIDTH / 16
        for _ in range(ATTEMPTS):
            for low, high in self._brackets(root, here):
                if self._fits(root, (low, high)):
                    return high, (low, high)
            width /= 1024
            root = root.narrowed(width)
        raise RuntimeError("two thresholds cannot be told apart")

    def _brackets(self, root: Root, here: Fraction) -> Iterator[tuple[Fraction, Fraction]]:
        """Yield intervals around a root: with short decimals first, then with any ends."""
        low = Fraction(floor((root.low + self.origin) * GRID), GRID) - self.origin
        high = Fraction(ceil((root.high + self.origin) * GRID), GRID) - self.origin
        if low == high:
            low, high = low - Fraction(1, GRID), high + Fraction(1, GRID)
        if here < low and high < self.high and high - low <= WIDTH:
            yield low, high
        low, high = root.low, root.high
        if low == high:
            reach = min(WIDTH / 4, (low - here) / 4, (self.high - high) / 4)
            low, high = low - reach, high + reach
        yield low, high

    def _fits(self, root: Root, bracket: tuple[Fraction, Fraction]) -> bool:
        """Whether the policy that is optimal at the bracket's end is so from the root on.

        The policy is followed if there is any; also proves the old policy at the other end.
        """
        low, high = bracket
        if low < root.low or root.low < root.high:  # not where a walk begins
            certificate = proven(self.at(low + self.origin))
            if not certificate.optimal_pairs[self.policy].all():
                return False
        certificate = proven(self.at(high + self.origin))
        optimal = certificate.optimal_pairs
        pairs = np.flatnonzero(optimal)
        first = np.searchsorted(pairs, self.rows.mdp.pair_offsets[:-1])
        former, keeps = self.policy, None
        if len(former):  # where nothing has changed, nothing is worked out again
            keeps = optimal[former]
        policy = pairs[first] if keeps is None else np.where(keeps, former, pairs[first])
        self._follow(policy)
        for pair, poly in enumerate(self.gaps.gap):
            if poly.degree() < 0:
                continue
            if sign(poly, high) <= 0 or not self._clear(pair, poly, root, low, high):
                if len(former):
                    self._follow(former)
                else:
                    self.policy = former
                return False
        return True

    def _clear(self, pair: int, poly: fmpq_poly, root: Root, low: Fraction, high: Fraction) -> bool:
        """Whether a gap has no root in (low, high], that of the threshold itself apart."""
        found = list(roots(self._simple(pair, poly), low, high))
        if not found or low == root.low == root.high:
            return not found
        return len(found) == 1 and root.equals(self._simple(pair, poly)) is not None

    # ---- what is told ------------------------------------------------------------------------

    def _optimal(self) -> np.ndarray:
        return np.array([poly.degree() < 0 for poly in self.gaps.gap])

    def _touches(self, low: Fraction, high: Fraction) -> list[tuple[Fraction, Fraction, int]]:
        found = []
        for pair, touching in self.touching.items():
            for root in touching:
                near = root.narrowed(WIDTH)
                if low <= near.low and near.high <= high:
                    found.append((near.low + self.origin, near.high + self.origin, pair))
        return sorted(found)

    def _stretch(
        self, before: tuple[Fraction, Fraction], after: tuple[Fraction, Fraction], here: Fraction
    ) -> Stretch:
        return Stretch(
            before=self._shift(before),
            after=self._shift(after),
            optimal=self._optimal(),
            policy=self.policy,
            touches=self._touches(here, after[0]),
        )

    def _shift(self, bracket: tuple[Fraction, Fraction]) -> tuple[Fraction, Fraction]:
        return bracket[0] + self.origin, bracket[1] + self.origin

    def _line(self, point: Fraction) -> fmpq_poly:
        from flint import fmpq_poly

        from exact_mdp.analysis.sensitivity.exact_chain import rational

        return fmpq_poly([rational(-point), 1])


def _turns(poly: fmpq_poly, root: Root) -> bool:
    """Whether a polynomial, not negative before, is negative just beyond a root."""
    if root.low == root.high:
        multiplicity, rest = 0, poly
        while sign(rest, root.low) == 0:
            multiplicity, rest = multiplicity + 1, rest.derivative()
        return multiplicity % 2 == 1
    # The root may be the end of an interval next to another root, where the sign is 0.
    near = root.narrowed((root.high - root.low) / 4)
    while near.low != near.high and sign(poly, near.high) == 0:
        near = near.narrowed((near.high - near.low) / 4)
    if near.low == near.high:
        return _turns(poly, near)
    return sign(poly, near.high) < 0


def _earlier(one: Root, other: Root) -> Root:
    """Return the smaller of two roots."""
    while not (one.high <= other.low or other.high <= one.low):
        low, high = max(one.low, other.low), min(one.high, other.high)
        shared = Root(poly=one.poly, low=low, high=high).equals(other.poly)
        if shared is not None and (low < high or sign(one.poly, low) == 0):
            return one if one.high - one.low <= other.high - other.low else other
        width = max(one.high - one.low, other.high - other.low) / 4
        one, other = one.narrowed(width), other.narrowed(width)
    return one if one.high <= other.low else other
