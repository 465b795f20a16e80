"""Signs and real roots of rational polynomials: proved, counted, isolated and compared exactly.

Descartes' rule of signs on an interval (a, b), after the substitution x = (a + b t) / (1 + t):
without a variation of signs no root lies inside, with one variation exactly one. Intervals with
more are halved (Vincent, Collins and Akritas; see Rouillier and Zimmermann, Journal of
Computational and Applied Mathematics 162, 2004). A polynomial is not negative on an interval if no
coefficient after the substitution is. All arithmetic is rational, so no root is missed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise

from flint import fmpq_poly, fmpz_poly

from exact_mdp.mdp.exact import from_flint, to_flint


@dataclass(frozen=True, kw_only=True)
class Root:
    """The only root of `poly` in an open interval; if low = high, the root itself.

    `poly` has no double roots.
    """

    poly: fmpq_poly
    low: Fraction
    high: Fraction

    def narrow_to_width(self, width: Fraction) -> Root:
        """Return the root in an interval of at most this width."""
        low, high = self.low, self.high
        if low == high or high - low <= width:
            return self
        # The sign between this root and `high`, also if the ends are roots themselves.
        right = (
            compute_sign(self.poly, high)
            or -compute_sign(self.poly, low)
            or -compute_sign(self.poly.derivative(), high)
        )
        # Bisection, in FLINT's rationals, which are many times faster than Python's.
        begin, end, wide = to_flint(low), to_flint(high), to_flint(width)
        while end - begin > wide:
            middle = (begin + end) / 2
            value = self.poly(middle)
            if not value:
                begin = end = middle
            elif (value > 0) == (right > 0):
                end = middle
            else:
                begin = middle
        return replace(self, low=from_flint(begin), high=from_flint(end))

    def lies_between(self, low: Fraction, high: Fraction) -> bool:
        """Return whether the root is in a closed interval."""
        root = self
        for end in (low, high):
            while root.low < end < root.high and compute_sign(root.poly, end) != 0:
                root = root.narrow_to_width((root.high - root.low) / 4)
            if root.low < end < root.high:
                return True  # the end is the root
        return low <= root.low and root.high <= high

    def isolate_beyond(self, point: Fraction, width: Fraction) -> Root:
        """Return the root in an interval of this width beyond a point, whose ends are not roots.

        If the root is a fraction with a small denominator, return that.
        """
        near = self.narrow_to_width(width)
        # Up to 12 digits, as the curves ask for a width of 1e-12.
        for digits in range(1, 13):
            short = ((near.low + near.high) / 2).limit_denominator(10**digits)
            if near.low < short < near.high and compute_sign(self.poly, short) == 0:
                return replace(self, low=short, high=short)
        while near.low < near.high and (
            near.low <= point
            or 0 in (compute_sign(self.poly, near.low), compute_sign(self.poly, near.high))
        ):
            near = near.narrow_to_width((near.high - near.low) / 4)
        return near

    def is_of(self, poly: fmpq_poly) -> bool:
        """Whether another polynomial has this root, too."""
        if self.low == self.high:
            return compute_sign(poly, self.low) == 0
        return any(True for _ in isolate_roots(self.poly.gcd(poly), self.low, self.high))


def compute_sign(poly: fmpq_poly, x: Fraction) -> int:
    """Return the sign of a polynomial at a rational point."""
    value = poly(to_flint(x))
    return int(value > 0) - int(value < 0)


def compute_coefficient_signs(poly: fmpq_poly, low: Fraction, high: Fraction) -> list[bool]:
    """Return for each nonzero coefficient after the substitution whether it is positive."""
    moved = poly(_make_line_polynomial(low, high)).numer()
    turned = fmpz_poly(moved.coeffs()[::-1])(fmpz_poly([1, 1]))
    return [c > 0 for c in turned.coeffs() if c]


@lru_cache(maxsize=16)
def _make_line_polynomial(low: Fraction, high: Fraction) -> fmpq_poly:
    """Return low + (high - low) t, cached because many polynomials share an interval."""
    line: fmpq_poly = fmpq_poly([to_flint(low), to_flint(high - low)])
    return line


def count_sign_variations(poly: fmpq_poly, low: Fraction, high: Fraction) -> int:
    """Return the number of sign variations: at least the number of roots, and equal if 0 or 1."""
    return sum(a != b for a, b in pairwise(compute_coefficient_signs(poly, low, high)))


def remove_double_roots(poly: fmpq_poly) -> fmpq_poly:
    """Return the polynomial with the same roots, none of them double."""
    if poly.degree() <= 1:
        return poly
    return poly / poly.gcd(poly.derivative())


def odd_part(poly: fmpq_poly) -> fmpq_poly:
    """Return the polynomial with the roots at which the sign changes, none of them double."""
    _, factors = poly.numer().factor_squarefree()
    odd: fmpq_poly = fmpq_poly([1])
    for factor, times in factors:
        if times % 2:
            odd = odd * factor
    return odd


def isolate_roots(poly: fmpq_poly, low: Fraction, high: Fraction) -> Iterator[Root]:
    """Yield the roots of a polynomial without double ones on an open interval, from the left."""
    most = count_sign_variations(poly, low, high)
    if most == 1:
        yield Root(poly=poly, low=low, high=high)
    elif most:
        middle = (low + high) / 2
        yield from isolate_roots(poly, low, middle)
        if compute_sign(poly, middle) == 0:
            yield Root(poly=poly, low=middle, high=middle)
        yield from isolate_roots(poly, middle, high)


def roots_on(poly: fmpq_poly, low: Fraction, high: Fraction) -> int:
    """Return the number of roots on a closed interval, double ones counted once."""
    if low == high:
        return int(compute_sign(poly, low) == 0)
    part = remove_double_roots(poly)
    ends = (compute_sign(part, low), compute_sign(part, high)).count(0)
    return ends + sum(1 for _ in isolate_roots(part, low, high))


def is_nonnegative(poly: fmpq_poly, low: Fraction, high: Fraction) -> bool:
    """Whether a polynomial is nowhere negative on a closed interval."""
    if all(compute_coefficient_signs(poly, low, high)):
        return True
    if low < high and any(True for _ in isolate_roots(odd_part(poly), low, high)):
        return False
    # No sign changes inside: the sign at any point that is not a root is the sign everywhere, and
    # one of degree + 1 points is not a root.
    steps = poly.degree() + 2
    inside = (low + (high - low) * Fraction(k, steps) for k in range(1, steps))
    return all(compute_sign(poly, y) >= 0 for y in inside)


def is_positive(poly: fmpq_poly, low: Fraction, high: Fraction) -> bool:
    """Whether a polynomial is positive on a closed interval."""
    return (
        compute_sign(poly, low) > 0
        and compute_sign(poly, high) > 0
        and not roots_on(poly, low, high)
    )
