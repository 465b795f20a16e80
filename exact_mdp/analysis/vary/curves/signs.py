"""The sign of a rational polynomial on a whole interval, proved without a solver.

A polynomial is not negative on an interval if its coefficients in Bernstein's basis are not; if one
is, Sturm's theorem counts the roots of odd multiplicity, of which there must be none inside (Basu,
Pollack and Roy, Algorithms in Real Algebraic Geometry, 2006, chapters 2 and 10).
"""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING

import flint

from exact_mdp.mdp.exact import rational

if TYPE_CHECKING:
    from flint import fmpq_poly


def nonnegative(poly: fmpq_poly, low: Fraction, high: Fraction) -> bool:
    """Whether a polynomial is nowhere negative on a closed interval."""
    if bernstein(poly, low, high):
        return True
    if roots_inside(odd_part(poly), low, high):
        return False
    steps = poly.degree() + 2  # one of so many points is no root
    inside = (low + (high - low) * Fraction(k, steps) for k in range(1, steps))
    return all(poly(rational(y)) >= 0 for y in inside)


def positive(poly: fmpq_poly, low: Fraction, high: Fraction) -> bool:
    """Whether a polynomial is positive on a closed interval."""
    ends = min(poly(rational(low)), poly(rational(high))) > 0
    return bool(ends and (bernstein(poly, low, high) or not roots_on(simple_part(poly), low, high)))


def vanishes(poly: fmpq_poly, low: Fraction, high: Fraction) -> bool:
    """Whether a polynomial that is not 0 has a root between two points."""
    return roots_inside(simple_part(poly), low, high) > 0


def bernstein(poly: fmpq_poly, low: Fraction, high: Fraction) -> bool:
    """Whether no coefficient in Bernstein's basis of an interval is negative."""
    moved = poly(flint.fmpq_poly([rational(low), rational(high - low)])).numer()
    turned = flint.fmpz_poly(moved.coeffs()[::-1])(flint.fmpz_poly([1, 1]))
    return all(c >= 0 for c in turned.coeffs())


def odd_part(poly: fmpq_poly) -> fmpq_poly:
    """Return the product of the factors of odd multiplicity, each once."""
    _, factors = poly.numer().factor_squarefree()
    odd: fmpq_poly = flint.fmpq_poly([1])
    for factor, times in factors:
        odd = odd * factor if times % 2 else odd
    return odd


def simple_part(poly: fmpq_poly) -> fmpq_poly:
    """Return the product of all factors, each once."""
    found: fmpq_poly = poly / poly.gcd(poly.derivative()) if poly.degree() > 0 else poly
    return found


def roots_on(poly: fmpq_poly, low: Fraction, high: Fraction) -> int:
    """Return the number of roots on a closed interval of a polynomial with simple ones (Sturm)."""
    if poly.degree() < 1:
        return 0
    chain = [poly, poly.derivative()]
    while chain[-1].degree() > 0:
        left = (chain[-2] % chain[-1]).numer()
        chain.append(-flint.fmpq_poly(left) / left.content())
    changes = []
    for at in (low, high):
        signs = [value > 0 for each in chain if (value := each(rational(at)))]
        changes.append(sum(a != b for a, b in pairwise(signs)))
    return changes[0] - changes[1] + (poly(rational(low)) == 0)


def roots_inside(poly: fmpq_poly, low: Fraction, high: Fraction) -> int:
    """Return the same on the open interval."""
    return roots_on(poly, low, high) - sum(poly(rational(y)) == 0 for y in {low, high})
