"""The pieces of a parameter's range on which the set of optimal actions stays as it is.

On a section between two breakpoints, rows are polynomials of the parameter. A policy stays optimal
until the first root at which one of its gap polynomials turns negative. At a point just beyond it
the policy is improved, and the new policy's gaps show that it is optimal from that very root on:
none of them may turn negative between the root and the point, else the point is moved closer. So no
threshold is passed over, however close two of them lie. The policy that is optimal at the end of a
section is where the next one begins, so that one model is solved, once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from functools import lru_cache, reduce
from itertools import chain, count, islice, pairwise
from math import ceil, floor

import flint
import numpy as np

from exact_mdp.analysis.gate.regret import proven
from exact_mdp.analysis.vary.base_case import unending
from exact_mdp.analysis.vary.curves.checker import (
    Bracket,
    CurvePiece,
    Mix,
    RationalFunction,
    Section,
    Values,
    different,
    weighed,
)
from exact_mdp.analysis.vary.curves.gap_polynomials import Gaps
from exact_mdp.analysis.vary.curves.roots import Root, odd_part, roots, sign, simple, variations
from exact_mdp.analysis.vary.ranges import Range
from exact_mdp.mdp.exact import rational
from exact_mdp.mdp.graph import endless
from exact_mdp.mdp.model import MDP, once
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.parametric.row_change import (
    PolynomialRows,
    RowChange,
    row_change,
    transition_entries,
)
from exact_mdp.mdp.table import Integers, shown
from exact_mdp.solvers.bounds.bounds import levels
from exact_mdp.solvers.solution import Bounded, Certified

WIDTH = Fraction(1, 10**12)
GRID = 10**13
ATTEMPTS = 400

At = Callable[[Fraction], MDP]


class Sweep:
    """A walk over one section of a parameter, on which rows are polynomials; `mix` is held."""

    def __init__(
        self, base: MDP, section: Section, change: RowChange, sign: int, mix: Mix | None
    ) -> None:
        self.section, self.origin, self.sign = section, section.origin, sign
        self.low, self.high = section.low - self.origin, section.high - self.origin
        self.gaps = Gaps(base, change, self.low, self.high)
        self.fixed = None if mix is None else self.gaps.values_of(mix)
        self.ahead: dict[int, list[tuple[Root, bool]]] = {}
        self.policy: Integers = np.empty(0, dtype=np.int64)

    def pieces(self, policy: Integers) -> Iterator[CurvePiece]:
        """Yield the pieces, beginning with a policy (S,) that may not be optimal."""
        self._follow(policy)
        first = Root(poly=flint.fmpq_poly([rational(-self.low), 1]), low=self.low, high=self.low)
        steps = ((self.high - self.low) / 64 * Fraction(3, 64) ** k for k in count())
        here = self._cross(first, ((self.low, self.low + step) for step in steps))[1]
        before: Bracket = (self.low, self.low)
        last = False
        while not last:
            root = self._next(here)
            optimal = np.array([poly.degree() < 0 for poly in self.gaps.gap])
            values, ended, last = self.gaps.values, None, root is None
            touches = self._touches(here, self.high if root is None else root.low)
            if root is None:
                after, end = (self.high, self.high), rational(self.high)
                ended = np.array([poly(end) == 0 for poly in self.gaps.gap])
            else:
                after = self._cross(root, self._brackets(root, here))
            yield CurvePiece(
                low=(before[0] + self.origin, before[1] + self.origin),
                high=(after[0] + self.origin, after[1] + self.origin),
                optimal=optimal,
                value=self.ratio(values),
                fixed=None if self.fixed is None else self.ratio(self.fixed),
                section=self.section,
                values=values,
                fixed_values=self.fixed,
                touches=tuple(touches),
                ended=ended,
            )
            here, before = after[1], after

    def ratio(self, values: Values) -> RationalFunction:
        """Return the value at the start as a function of the parameter, with the sign of costs."""
        top, below = weighed(self.gaps.rows.mdp.start, values[0]), values[1]
        shared = top.gcd(below)
        shift = flint.fmpq_poly([rational(-self.origin), 1])
        return RationalFunction.of((self.sign * (top / shared)(shift), (below / shared)(shift)))

    # ---- the roots ahead -------------------------------------------------------------------------

    def _roots(self, pair: int, here: Fraction) -> list[tuple[Root, bool]]:
        """Return the roots of a gap beyond a point, and at which of them its sign changes."""
        known = self.ahead.get(pair)
        if known is None or (known and known[0][0].low < here):
            poly = self.gaps.gap[pair]
            self.ahead[pair] = known = []
            if poly.degree() > 0 and variations(poly, here, self.high):
                part = simple(poly)
                odd = None if part.degree() == poly.degree() else odd_part(poly)
                for root in roots(part, here, self.high):
                    # Narrow at once, so that comparing it with others needs no more, ever again.
                    near = root.narrowed((self.high - self.low) / 2**8)
                    known.append((near, odd is None or near.is_of(odd)))
        return known

    def _next(self, here: Fraction) -> Root | None:
        """Return the first root beyond `here` at which a gap turns negative."""
        every = (self._roots(pair, here) for pair in range(len(self.gaps.gap)))
        turning = ([root for root, turns in known if turns] for known in every)
        first = [each[0] for each in turning if each]
        return reduce(_earlier, first).narrowed(WIDTH / 16) if first else None

    def _touches(self, low: Fraction, high: Fraction) -> list[tuple[Fraction, Fraction, int]]:
        """Return the brackets between two points, and pairs, of gaps that are 0 at one point."""
        touches = []
        for pair in range(len(self.gaps.gap)):
            for root, turns in self._roots(pair, low):
                near = root if turns else root.narrowed(WIDTH)
                if not turns and low <= near.low and near.high <= high:
                    touches.append((near.low + self.origin, near.high + self.origin, pair))
        return sorted(touches)

    # ---- beyond a root ---------------------------------------------------------------------------

    def _cross(self, root: Root, brackets: Iterable[Bracket]) -> Bracket:
        """Follow the policy that is optimal from a root on; return the bracket that shows it."""
        former = self.policy
        for bracket in islice(brackets, ATTEMPTS):
            self._improve(*bracket)
            if all(self._clear(pair, root, *bracket) for pair in range(len(self.gaps.gap))):
                return bracket
            self.ahead.clear()
            self._follow(former)
        raise RuntimeError("thresholds without end, or two that cannot be told apart")

    def _brackets(self, root: Root, here: Fraction) -> Iterator[Bracket]:
        """Yield ever narrower intervals around a root, with short decimals where they are such."""
        width = WIDTH / 16
        while True:
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
            width /= 1024
            root = root.narrowed(width)

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
                pairs[self.gaps.state[pair]] = pair
            if not falls:
                return
            self._follow(pairs)

    def _follow(self, policy: Integers) -> None:
        self.policy = policy
        self.gaps.follow(policy)
        for pair in self.gaps.renewed:
            self.ahead.pop(pair, None)

    def _far(self, pair: int, low: Fraction, high: Fraction) -> bool:
        """Whether a gap's roots are known, and outside a bracket, so that its sign is, too."""
        known = self.ahead.get(pair)
        return known is not None and all(r.high < low or high < r.low for r, _ in known)

    def _clear(self, pair: int, root: Root, low: Fraction, high: Fraction) -> bool:
        """Whether a gap has no root in (low, high], that of the threshold itself apart."""
        poly = self.gaps.gap[pair]
        if poly.degree() < 0 or self._far(pair, low, high):
            return True
        if sign(poly, high) <= 0:
            return False
        if not self._roots(pair, low):
            return True
        part = simple(poly)
        inside = len([*roots(part, low, high)])
        return inside == 0 or (inside == 1 and low < root.high and root.is_of(part))


def _earlier(one: Root, other: Root) -> Root:
    """Return the smaller of two roots."""
    while not (one.high <= other.low or other.high <= one.low):
        low, high = max(one.low, other.low), min(one.high, other.high)
        if (low < high or sign(one.poly, low) == 0) and Root(
            poly=one.poly, low=low, high=high
        ).is_of(other.poly):
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
    family: Parametric, name: str, span: Range, sign: int, mix: Mix | None
) -> tuple[list[CurvePiece], list[Sweep]]:
    """Return the pieces over a range, and their sections; sign is -1 for costs, `mix` is held."""
    cuts = {*family.breakpoints(name)}
    inside = (cut for cut in cuts if span.low < cut < span.high)
    at = lru_cache(lambda value: family.at({name: value}))
    pieces, sweeps, policy = list[CurvePiece](), list[Sweep](), None
    for low, high in pairwise(sorted({span.low, *inside, span.high})):
        section, base, change = _middle(family, at, name, low, high)
        for cut in {low, high} & cuts if change.checked is not None else ():  # refuse a jump there
            row_change(family, name, section, origin=cut, base=at(cut))
        if _endless(at, base, section, change):
            raise unending(f"for some {name} from {shown(low)} to {shown(high)}")
        sweep = Sweep(base, section, change, sign, mix)
        pieces += sweep.pieces(optimum(base)[0] if policy is None else policy)
        policy = sweep.policy
        sweeps.append(sweep)
    return pieces, sweeps


def _middle(
    family: Parametric, at: At, name: str, low: Fraction, high: Fraction
) -> tuple[Section, MDP, RowChange]:
    """Return the model in the middle of a section, and how it changes; next to it if a chance is 0.

    What may happen there may then happen next to it, too. A chance that moves is 0 at few points.
    """
    for share in chain([Fraction(1, 2)], (Fraction(37 + k, 97 + 2 * k) for k in count())):
        section = Section(low=low, high=high, origin=low + (high - low) * share)
        base = at(section.origin)
        change = row_change(family, name, section, origin=section.origin, base=base)
        if np.isin(change.transition.key, transition_entries(base)[0]).all():
            break
    return section, base, change


def _endless(at: At, mdp: MDP, section: Section, change: RowChange) -> bool:
    """Return whether some policy never ends in a section, its ends included, at discount 1.

    Or earns where all is over, which is then over at one value of the parameter alone.
    """
    pairs = np.concatenate([change.reward.key, change.transition.key // mdp.n_states])
    earns = mdp.discount_exact == 1 and not change.rate and mdp.terminal[mdp.pair_state[pairs]]
    if endless(mdp) or np.any(earns):
        return True
    if mdp.discount_exact < 1 or change.rate or levels(mdp) is not None:
        return False
    for end in (section.low, section.high):
        there = at(end)
        if endless(there) or (there.terminal != mdp.terminal).any():
            return True
    origin = section.origin
    low, high = section.low - origin, section.high - origin
    for chance in different(PolynomialRows(mdp, change).moving):
        for root in roots(simple(chance), low, high):  # what may happen where it becomes 0
            near = root.apart(low, WIDTH)
            if near.low < near.high or endless(at(near.low + origin)):
                return True
    return False
