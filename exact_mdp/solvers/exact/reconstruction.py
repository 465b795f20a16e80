"""Fractions from approximations in binary, by continued fractions.

Of a number x = n / q some bits are known. Euclid's algorithm finds the denominators of its
convergents. One of them is q, and it shows: q x is far closer to an integer than chance would make
it (Wang, Guy and Davenport, SIGSAM Bulletin 16, 1982).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import flint

if TYPE_CHECKING:
    from flint import fmpz


SPARE = 40  # bits by which a fraction has to be closer than chance would make it
SHORT = 600  # bits that Euclid's algorithm removes before long numbers are updated


def over_one_denominator(
    numbers: Sequence[int], bits: int, below: fmpz
) -> tuple[list[fmpz], fmpz] | None:
    """Return the fractions close to numbers / 2^bits, over a multiple of `below`.

    None where the numbers are too short for their denominators.
    """
    top: list[fmpz] = []
    half = flint.fmpz(1) << (bits - 1)
    for number in numbers:
        product = below * number
        nearest = (product + half) >> bits
        rest = product - (nearest << bits)
        if rest.bit_length() > bits - SPARE:
            _, factor, fits = convergents(rest, bits, excess=int(below.bit_length()))
            if not fits:
                return None
            below, top = below * abs(factor), [value * abs(factor) for value in top]
            nearest = (product * abs(factor) + half) >> bits
        top.append(nearest)
    return top, below


def convergents(
    number: fmpz, bits: int, start: Sequence[fmpz] = (), excess: int = 0
) -> tuple[fmpz, fmpz, bool]:
    """Return two denominators of convergents of number / 2^bits, and whether the second one fits.

    They may be negative. Their distance from integers may be `excess` bits longer than they are.
    `start` are two that a less precise number gave, from which to go on.
    """
    unit = flint.fmpz(1) << bits
    before, below = start or (flint.fmpz(0), flint.fmpz(1))
    high, low = (_nearest_rest(own * number, unit) if own else unit for own in (before, below))
    if high < 0:
        high, before = -high, -before
    if low < 0:
        low, below = -low, -below
    if high < low:
        high, low, before, below = low, high, below, before
    a, b, c, d = _steps(high, low, high.bit_length() - (bits + excess) // 2)
    before, below, low = a * before + b * below, c * before + d * below, c * high + d * low
    return before, below, bool(below) and below.bit_length() + low.bit_length() < bits - SPARE


def _nearest_rest(number: fmpz, unit: fmpz) -> fmpz:
    rest = number % unit
    return rest - unit if 2 * rest > unit else rest


def _steps(high: fmpz, low: fmpz, bits: int) -> tuple[fmpz, fmpz, fmpz, fmpz]:
    """Return a matrix (a, b; c, d) of steps of Euclid's algorithm that remove about `bits` bits.

    They are those of the leading digits, which hardly differ (Lehmer, American Mathematical Monthly
    45, 1938); many bits are removed in parts.
    """
    spare = max(0, high.bit_length() - 2 * bits - 64)
    high, low = high >> spare, low >> spare
    end = high.bit_length() - bits
    a, b, c, d = flint.fmpz(1), flint.fmpz(0), flint.fmpz(0), flint.fmpz(1)
    while (left := low.bit_length() - end) > 0:
        if bits > SHORT:
            e, f, g, h = _steps(high, low, left if left <= SHORT else left // 2)
            a, b, c, d = e * a + f * c, e * b + f * d, g * a + h * c, g * b + h * d
            high, low = e * high + f * low, g * high + h * low
            if low < 0:
                low, c, d = -low, -c, -d
            if high < low:
                high, low, a, b, c, d = low, high, c, d, a, b
        if low.bit_length() > end:
            quotient, rest = divmod(high, low)
            high, low = low, rest
            a, b, c, d = c, d, a - quotient * c, b - quotient * d
    return a, b, c, d
