"""The pieces of a parameter's range on which the set of optimal actions stays as it is.

On a section between two breakpoints, rows are polynomials of the parameter. A policy stays optimal
until the first root at which one of its gap polynomials turns negative. At a point just beyond it
the policy is improved, and the new policy's gaps show that it is optimal from that very root on:
none of them may turn negative between the root and the point, else the point is moved closer. So no
threshold is passed over, however close two of them lie. The policy that is optimal at the end of a
section is where the next one begins, so that one model is solved, once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from itertools import chain, count, pairwise
from math import ceil, floor
from typing import TYPE_CHECKING

import flint
import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.gate.regret import proven
from exact_mdp.analysis.vary.base_case import unending
from exact_mdp.analysis.vary.curves.checker import Bracket, CurvePiece, RationalFunction, Section
from exact_mdp.analysis.vary.curves.gap_polynomials import Gaps, Rows, Values
from exact_mdp.analysis.vary.curves.real_roots import Root, roots, sign, simple, variations
from exact_mdp.analysis.vary.ranges import Range
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import rational
from exact_mdp.mdp.graph import endless
from exact_mdp.mdp.model import MDP, once
from exact_mdp.mdp.parametric import DISCOUNT, Parametric
from exact_mdp.mdp.parametric.polynomial_rows import PolynomialRows
from exact_mdp.mdp.parametric.row_change import Piece, RowChange, row_change, transition_entries
from exact_mdp.mdp.table import Integers, shown
from exact_mdp.solvers.bounds.bounds import levels
from exact_mdp.solvers.solution import Bounded, Certified

if TYPE_CHECKING:
    from flint import fmpq_poly


WIDTH = Fraction(1, 10**12)
GRID = 10**13
ATTEMPTS = 200

NEARLY_ONE = 1 - Fraction(1, 2**40)

Mask = NDArray[np.bool_]
At = Callable[[Fraction], MDP]


class Sweep:
    """A walk over one piece (low, high) of a parameter, whose rows are polynomials there."""

    def __init__(self, rows: Rows, low: Fraction, high: Fraction, sign: int) -> None:
        self.rows, self.origin, self.sign = rows, rows.change.origin, sign
        self.low, self.high = low - self.origin, high - self.origin
        self.section = Section(low=low, high=high, origin=self.origin)
        self.gaps = Gaps(rows, (self.low, self.high))
        self.simple: dict[int, fmpq_poly] = {}
        self.first: dict[int, Root | None] = {}
        self.touching: dict[int, list[Root]] = {}
        self.policy: Integers = np.empty(0, dtype=np.int64)

    def pieces(self, policy: Integers) -> Iterator[CurvePiece]:
        """Yield the pieces, beginning with a policy (S,) that may not be optimal."""
        self._follow(policy)
        here, before = self._settle(), (self.low, self.low)
        while found := self._next(here):
            root = found.narrowed(WIDTH / 16)
            optimal, touches = self._optimal(), self._touches(here, root.low)
            values = self.gaps.values
            here, after = self._cross(root, here)
            yield self._piece(before, after, optimal, touches, values)
            before = after
        touches, optimal = self._touches(here, self.high), self._optimal()
        piece = self._piece(before, (self.high,) * 2, optimal, touches, self.gaps.values)
        end = rational(self.high)
        yield replace(piece, ended=np.array([poly(end) == 0 for poly in self.gaps.gap]))

    def _piece(
        self,
        before: Bracket,
        after: Bracket,
        optimal: Mask,
        touches: list[tuple[Fraction, Fraction, int]],
        values: Values,
    ) -> CurvePiece:
        return CurvePiece(
            low=(before[0] + self.origin, before[1] + self.origin),
            high=(after[0] + self.origin, after[1] + self.origin),
            optimal=optimal,
            value=self.ratio(values),
            section=self.section,
            values=values,
            touches=tuple(touches),
        )

    def ratio(self, values: Values) -> RationalFunction:
        """Return the value at the start as a function of the parameter, with the sign of costs."""
        top, below = self.rows.worth(values)
        shared = top.gcd(below)
        shift = flint.fmpq_poly([rational(-self.origin), 1])
        return RationalFunction.of((self.sign * (top / shared)(shift), (below / shared)(shift)))

    def _optimal(self) -> Mask:
        return np.array([poly.degree() < 0 for poly in self.gaps.gap])

    def _touches(self, low: Fraction, high: Fraction) -> list[tuple[Fraction, Fraction, int]]:
        found = []
        for pair, touching in self.touching.items():
            for root in touching:
                near = root.narrowed(WIDTH)
                if low <= near.low and near.high <= high:
                    found.append((near.low + self.origin, near.high + self.origin, pair))
        return sorted(found)

    # ---- the next root -----------------------------------------------------------------------

    def _next(self, here: Fraction) -> Root | None:
        """Return the first root beyond `here` at which a gap turns negative."""
        best: Root | None = None
        for pair, poly in enumerate(self.gaps.gap):
            root = None if poly.degree() < 1 else self._first(pair, poly, here)
            if root is not None:
                best = root if best is None else _earlier(best, root)
        return best

    def _first(self, pair: int, poly: fmpq_poly, here: Fraction) -> Root | None:
        if pair in self.first:
            known = self.first[pair]
            if known is None or known.low >= here:
                return known
        self.first[pair], self.touching[pair] = None, []
        if variations(poly, here, self.high) == 0:
            return None
        for root in roots(self._simple(pair, poly), here, self.high):
            if _turns(poly, root):
                # Narrow at once, so that comparing it with others needs no more, again and again.
                self.first[pair] = root.narrowed((self.high - self.low) / 2**8)
                break
            self.touching[pair].append(root)
        return self.first[pair]

    def _simple(self, pair: int, poly: fmpq_poly) -> fmpq_poly:
        if pair not in self.simple:
            self.simple[pair] = simple(poly)
        return self.simple[pair]

    # ---- beyond a root -----------------------------------------------------------------------

    def _settle(self) -> Fraction:
        """Follow the policy that is optimal from the lower end on; return a point beyond it."""
        root = Root(poly=flint.fmpq_poly([rational(-self.low), 1]), low=self.low, high=self.low)
        step = (self.high - self.low) / 64
        for _ in range(ATTEMPTS):
            point = self.low + step
            if self._fits(root, (self.low, point)):
                return point
            step = step * 3 / 64
        raise RuntimeError("no policy is optimal beyond a point: thresholds without end")

    def _cross(self, root: Root, here: Fraction) -> tuple[Fraction, Bracket]:
        """Follow the policy beyond a root; return a point where it is optimal, and the bracket."""
        width = WIDTH / 16
        for _ in range(ATTEMPTS):
            for bracket in self._brackets(root, here):
                if self._fits(root, bracket):
                    return bracket[1], bracket
            width /= 1024
            root = root.narrowed(width)
        raise RuntimeError("two thresholds cannot be told apart")

    def _brackets(self, root: Root, here: Fraction) -> Iterator[Bracket]:
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

    def _fits(self, root: Root, bracket: Bracket) -> bool:
        """Whether the policy that is optimal at the bracket's end is so from the root on.

        The policy is followed if it is.
        """
        (low, high), former = bracket, self.policy
        self._improve(low, high)
        for pair, poly in enumerate(self.gaps.gap):
            if poly.degree() < 0 or self._far(pair, low, high):
                continue
            if pair not in self.first and variations(poly, low, self.high) == 0:
                self.first[pair], self.touching[pair] = None, []
                if sign(poly, high) > 0:
                    continue
            if not self._clear(pair, poly, root, low, high):
                self._follow(former)
                return False
        return True

    def _improve(self, low: Fraction, high: Fraction) -> None:
        """Follow a policy that is optimal at the end of a bracket (policy iteration)."""
        while True:
            at, pairs = rational(high), self.policy.copy()
            falls = [
                (gap, pair)
                for pair, poly in enumerate(self.gaps.gap)
                if poly.degree() >= 0 and not self._far(pair, low, high) and (gap := poly(at)) < 0
            ]
            for _, pair in sorted(falls, reverse=True):  # the best pair of a state is the last
                pairs[self.rows.state[pair]] = pair
            if not falls:
                return
            self._follow(pairs)

    def _follow(self, policy: Integers) -> None:
        self.policy = policy
        self.gaps.follow(policy)
        for pair in self.gaps.renewed:
            self.simple.pop(pair, None)
            self.first.pop(pair, None)
            self.touching.pop(pair, None)

    def _far(self, pair: int, low: Fraction, high: Fraction) -> bool:
        """Whether a gap's next roots are known, and outside a bracket: it is positive there."""
        if pair not in self.first:
            return False
        first, touching = self.first[pair], self.touching[pair]
        beyond = first is None or first.low > high
        return beyond and not any(each.low <= high and low <= each.high for each in touching)

    def _clear(self, pair: int, poly: fmpq_poly, root: Root, low: Fraction, high: Fraction) -> bool:
        """Whether a gap has no root in (low, high], that of the threshold itself apart."""
        if sign(poly, high) <= 0:
            return False
        found = list(roots(self._simple(pair, poly), low, high))
        if not found or low == root.low == root.high:
            return not found
        return len(found) == 1 and root.equals(self._simple(pair, poly)) is not None


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


# ---- sections ----------------------------------------------------------------------------------


@once
def optimum(mdp: MDP) -> tuple[Integers, Certified | Bounded]:
    """Return an optimal pair of each state, and the proven value at the start, of a model."""
    certificate = proven(mdp)
    optimal = np.flatnonzero(certificate.optimal_pairs)
    return optimal[np.searchsorted(optimal, mdp.pair_offsets[:-1])], certificate.start


def pieces_of(
    family: Parametric, name: str, span: Range, sign: int
) -> tuple[list[CurvePiece], list[Sweep]]:
    """Return the pieces over a range, and the sections that they are on; sign is -1 for costs.

    Raises ModelError where some policy never ends at discount 1.
    """
    inside = (cut for cut in family.breakpoints(name) if span.low < cut < span.high)

    @lru_cache
    def at(value: Fraction) -> MDP:
        return family.at({name: value})

    found, sweeps, policy = list[CurvePiece](), list[Sweep](), None
    for low, high in pairwise(sorted({span.low, *inside, span.high})):
        base, change = _middle(family, at, name, low, high)
        if _endless(at, base, change):
            raise unending(f"for some {name} from {shown(low)} to {shown(high)}")
        sweep = Sweep(Rows(base, change), low, high, sign)
        found += sweep.pieces(optimum(base)[0] if policy is None else policy)
        policy = sweep.policy
        sweeps.append(sweep)
    return found, sweeps


def below_one(family: Parametric, name: str, span: Range) -> Range:
    """Return a range of the discount that ends below 1 where some policy never ends at 1."""
    if name != DISCOUNT or span.high < 1 or not endless(family.at({name: 1})):
        return span
    if span.low >= NEARLY_ONE:
        raise ModelError(
            "at discount 1 some policy never ends",
            where=f"parameter {name}",
            fix=f"choose a range that begins below {shown(NEARLY_ONE)}",
        )
    return Range(low=span.low, high=NEARLY_ONE)


def _middle(
    family: Parametric, at: At, name: str, low: Fraction, high: Fraction
) -> tuple[MDP, RowChange]:
    """Return the model in the middle of a section, and how it changes; next to it if a chance is 0.

    What may happen there may then happen next to it, too. A chance that moves is 0 at few points.
    """
    for share in chain([Fraction(1, 2)], (Fraction(37 + k, 97 + 2 * k) for k in count())):
        origin = low + (high - low) * share
        base = at(origin)
        change = row_change(family, name, Piece(low=low, high=high), origin=origin, base=base)
        if np.isin(change.transition.key, transition_entries(base)[0]).all():
            break
    return base, change


def _endless(at: At, mdp: MDP, change: RowChange) -> bool:
    """Return whether some policy never ends in a section, its ends included, at discount 1.

    Or earns where all is over, which is then over at one value of the parameter alone.
    """
    pairs = np.concatenate([change.reward.key, change.transition.key // mdp.n_states])
    earns = mdp.discount_exact == 1 and not change.discount and mdp.terminal[mdp.pair_state[pairs]]
    if endless(mdp) or np.any(earns):
        return True
    if mdp.discount_exact < 1 or change.discount or levels(mdp) is not None:
        return False
    low, high = change.piece.low, change.piece.high
    assert low is not None
    assert high is not None
    for end in (low, high):
        there = at(end)
        if endless(there) or (there.terminal != mdp.terminal).any():
            return True
    return any(
        low < high or endless(at(low))
        for low, high in _gone(PolynomialRows.of(mdp, change), low, high)
    )


def _gone(rows: PolynomialRows, low: Fraction, high: Fraction) -> Iterator[Bracket]:
    """Yield brackets of the values between two at which some chance becomes 0."""
    origin = rows.change.origin
    for poly in {str(p): p for p in rows.moving}.values():
        for root in roots(simple(poly), low - origin, high - origin):
            near = root.narrowed(WIDTH).simplest()
            yield near.low + origin, near.high + origin
