"""Many rationals in lowest terms, quickly, where their denominators share a few small primes.

Values of a model have denominators that are products of its rows' denominators: thousands of
digits, but few primes. A common factor of numerator and denominator then is found by remainders of
small numbers, at a fraction of what a greatest common divisor of long ones costs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from math import gcd, lcm
from numbers import Rational
from typing import cast

import flint
import numpy as np

from exact_mdp.mdp.table import Integers, Numbers

SMALL = 512  # bits: products of primes that are longer do not pay


@dataclass(frozen=True, slots=True)
class _LowestTerms:
    """What `Fraction` takes over as it is, as it does every rational."""

    numerator: int
    denominator: int


Rational.register(_LowestTerms)


def fractions(top: Iterable[int | None], bottom: Iterable[int], primes: int) -> Numbers:
    """Return an array of the Fractions top / bottom, and None where `top` is None."""
    found = [
        None if a is None else _fraction(a, b, primes) for a, b in zip(top, bottom, strict=True)
    ]
    array = np.empty(len(found), dtype=object)
    array[:] = found
    array.setflags(write=False)
    return array


def fraction(top: int, bottom: int) -> Fraction:
    """Return the Fraction top / bottom, in little more than linear time, for a positive bottom."""
    numerator, denominator = flint.fmpz(top), flint.fmpz(bottom)
    shared = numerator.gcd(denominator)
    lowest = _LowestTerms(int(numerator // shared), int(denominator // shared))
    return Fraction(cast(Rational, lowest))


def on_average(
    weights: Iterable[tuple[int, Fraction]],
    top: Sequence[int],
    group: Integers,
    bottom: Sequence[int],
) -> Fraction:
    """Return Σ weight · top[s] / bottom[group[s]] over states s; one divisor is taken out at last.

    Examples
    --------
    >>> on_average([(0, Fraction(1, 2)), (1, Fraction(1, 3))], [1, 1], np.array([0, 1]), [3, 5])
    Fraction(7, 30)
    """
    listed = list(weights)
    parts = lcm(*(weight.denominator for _, weight in listed))
    below = lcm(*(bottom[group[state]] for state, _ in listed))
    times = {g: below // bottom[g] for g in {int(group[state]) for state, _ in listed}}
    total = sum(
        weight.numerator * (parts // weight.denominator) * top[state] * times[int(group[state])]
        for state, weight in listed
    )
    return fraction(total, parts * below)


def primes_of(numbers: Sequence[int]) -> int:
    """Return a number that every prime of the given positive integers divides.

    It is small where each is a small multiple of the one before.
    """
    found = numbers[0]
    for before, number in pairwise(numbers):
        factor, rest = divmod(number, before)
        found = lcm(found, number if rest else factor)
    return found


def _fraction(top: int, bottom: int, primes: int) -> Fraction:
    if primes.bit_length() > SMALL:
        return fraction(top, bottom)
    if top == 0:
        return Fraction(0)
    # Once no prime of the denominator divides both, they are in lowest terms.
    while gcd(top % primes, bottom % primes, primes) > 1:
        power = primes ** (1 + SMALL // primes.bit_length())
        shared = gcd(top % power, bottom % power, power)
        top, bottom = top // shared, bottom // shared
    return Fraction(cast(Rational, _LowestTerms(top, bottom)))
