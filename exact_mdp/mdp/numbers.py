"""Exact numbers in Python and in FLINT."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import flint

if TYPE_CHECKING:
    from flint import fmpq


def rational(number: Fraction | int) -> fmpq:
    """Return a number as FLINT's rational."""
    found: fmpq = flint.fmpq(number.numerator, number.denominator)
    return found


def fraction(number: fmpq) -> Fraction:
    """Return FLINT's rational as Python's."""
    return Fraction(int(number.p), int(number.q))
