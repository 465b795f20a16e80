"""Real roots of rational polynomials: counted, isolated and compared exactly.

Descartes' rule of signs on an interval (a, b), after the substitution x = (a + b t) / (1 + t):
without a variation of signs there is no root in it, with one there is exactly one. Intervals with
more are halved (Vincent, Collins and Akritas; see Rouillier and Zimmermann, Journal of
Computational and Applied Mathematics 162, 2004). Everything is rational, so nothing is missed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING

import flint

from exact_mdp.mdp.exact import fraction, rational

if TYPE_CHECKING:
    from flint import fmpq_poly


@dataclass(frozen=True, kw_only=True)
class Root:
    """The only root of `poly`, which has no double ones, in the open interval, or low = high."""

    poly: fmpq_poly
    low: Fraction
    high: Fraction

    def narrowed(self, width: Fraction) -> Root:
        """Return the root in an interval of at most this width."""
        low, high = self.low, self.high
        if low == high or high - low <= width:
            return self
        # Where both ends are roots themselves, the sign between this root and `high`.
        right = (
            sign(self.poly, high) or -sign(self.poly, low) or -sign(self.poly.derivative(), high)
        )
        # Rationals of FLINT are halved many times faster than Python's.
        begin, end, wide = rational(low), rational(high), rational(width)
        while end - begin > wide:
            middle = (begin + end) / 2
            value = self.poly(middle)
            if not value:
                return Root(poly=self.poly, low=fraction(middle), high=fraction(middle))
            if (value > 0) == (right > 0):
                end = middle
            else:
                begin = middle
        return Root(poly=self.poly, low=fraction(begin), high=fraction(end))

    def simplest(self) -> Root:
        """Return the root at a fraction of small denominator where it is that."""
        for digits in range(1, 13):
            near = ((self.low + self.high) / 2).limit_denominator(10**digits)
            if self.low < near < self.high and sign(self.poly, near) == 0:
                return Root(poly=self.poly, low=near, high=near)
        return self

    def beyond(self, point: Fraction) -> Root:
        """Return a root beyond a point in an interval that is beyond it, too, and ends at none."""
        near = self
        while near.low < near.high and (
            near.low <= point or 0 in (sign(self.poly, near.low), sign(self.poly, near.high))
        ):
            near = near.narrowed((near.high - near.low) / 4)
        return near

    def equals(self, poly: fmpq_poly) -> fmpq_poly | None:
        """Return a factor that has this root in common with another polynomial, or None."""
        if self.low == self.high:
            return poly if sign(poly, self.low) == 0 else None
        shared = self.poly.gcd(poly)
        if shared.degree() > 0 and any(True for _ in roots(shared, self.low, self.high)):
            return shared
        return None


def sign(poly: fmpq_poly, x: Fraction) -> int:
    """Return the sign of a polynomial at a rational point."""
    value = poly(rational(x))
    return int(value > 0) - int(value < 0)


def variations(poly: fmpq_poly, low: Fraction, high: Fraction) -> int:
    """Return the variations of signs of a polynomial on an open interval."""
    moved = poly(_line(low, high)).numer()
    turned = flint.fmpz_poly(moved.coeffs()[::-1])(flint.fmpz_poly([1, 1]))
    signs = [c > 0 for c in turned.coeffs() if c]
    return sum(a != b for a, b in pairwise(signs))


@lru_cache(maxsize=16)
def _line(low: Fraction, high: Fraction) -> fmpq_poly:
    """Return low + (high - low) t; many polynomials are looked at on one interval in turn."""
    line: fmpq_poly = flint.fmpq_poly([rational(low), rational(high - low)])
    return line


def simple(poly: fmpq_poly) -> fmpq_poly:
    """Return the polynomial with the same roots, none of them double."""
    if poly.degree() < 2:
        return poly
    shared = poly.gcd(poly.derivative())
    return poly / shared if shared.degree() else poly


def roots(poly: fmpq_poly, low: Fraction, high: Fraction) -> Iterator[Root]:
    """Yield the roots of a polynomial without double ones on an open interval, from the left."""
    if poly.degree() < 1:
        return
    count = variations(poly, low, high)
    if count == 0:
        return
    if count == 1:
        yield Root(poly=poly, low=low, high=high)
        return
    middle = (low + high) / 2
    yield from roots(poly, low, middle)
    if sign(poly, middle) == 0:
        yield Root(poly=poly, low=middle, high=middle)
    yield from roots(poly, middle, high)
