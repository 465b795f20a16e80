"""Exact solutions of A x = b for sparse integer matrices, by long division with a float inverse.

A = diag(pivot) - W with W ≥ 0 is an M-matrix: the equations of one policy. Its floats are factored
once. Then, as in long division, digits of b are brought down and digits of x come out:

    r ← 2³² r + next digit of b,    y ← A⁻¹ r in floats, rounded,    r ← r - A y exactly

so that x = Σ y 2⁻³²ᵏ, to as many digits as wanted at the price of one sparse solve each (Wan,
Journal of Symbolic Computation 41, 2006). Every denominator divides det A, whose size the floats
tell, and with it the number of digits that determine x; a continued fraction then gives the
denominator. The result is put into the equations; where it is wrong, and for few equations, p-adic
lifting of the dense matrix takes over (Dixon, Numerische Mathematik 40, 1982).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log2
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.table import Integers, Numbers, magnitude

if TYPE_CHECKING:
    from flint import fmpz

flint = later("flint")
linalg = later("scipy.sparse.linalg")

LONGEST = 900  # bits of a pivot that floats hold, its remainders too
WRAPPING = 2**58  # pivots below this leave remainders that 64 bits tell apart
FARTHEST, STRETCHED = 2.0**62, 2.0**30  # digits and inverses that are too large to go on
SPARE = 64  # bits beyond those that determine x
FEW, MANY = 40, 4_000  # equations that p-adic lifting solves faster, or that are too many for it


@dataclass(frozen=True, kw_only=True, eq=False)
class Equations:
    """A = diag(pivot) - W, of K rows; the M entries of W are listed row by row."""

    pivot: Sequence[int]
    row: Integers  # (M,)
    column: Integers  # (M,)
    weight: Numbers  # (M,)

    def solve(self, right: Sequence[fmpz]) -> tuple[list[fmpz], fmpz]:
        """Return x as integers over one positive denominator; ZeroDivisionError: A is singular."""
        if len(self.pivot) > FEW:
            found = self.divide(right)
            if found is not None and self._satisfied(*found, right):
                return found
        return self._lifted(right)

    def divide(self, right: Sequence[fmpz]) -> tuple[list[fmpz], fmpz] | None:
        """Return what long division and a continued fraction give, None where floats fail."""
        inverse = _Inverse.of(self)
        if inverse is None:
            return None
        places = 2 * inverse.bits + int(inverse.stretch).bit_length() + SPARE
        found = inverse.digits(right, places)
        return None if found is None else _rationals(*found, inverse.bits)

    def approximate(self, right: Sequence[fmpz], places: int) -> tuple[list[int], int] | None:
        """Return x times 2^places as integers, and the places: a few more than asked for.

        They are off by a few times the greatest row sum of A's inverse; None where floats fail.
        """
        inverse = _Inverse.of(self)
        return None if inverse is None else inverse.digits(right, places)

    def _satisfied(self, value: list[fmpz], below: fmpz, right: Sequence[fmpz]) -> bool:
        rest = [p * v - below * b for p, v, b in zip(self.pivot, value, right, strict=True)]
        entries = zip(self.row.tolist(), self.column.tolist(), self.weight.tolist(), strict=True)
        for row, column, weight in entries:
            rest[row] -= value[column] * weight
        return not any(rest)

    def _lifted(self, right: Sequence[fmpz]) -> tuple[list[fmpz], fmpz]:
        size = len(self.pivot)
        if size > MANY:
            raise ModelError(
                f"a cycle of {size} states is too ill-conditioned to be solved exactly",
                fix="use certify(mdp, bounded=True), which proves bounds in floating point",
            )
        matrix = np.zeros((size, size), dtype=object)
        matrix[self.row, self.column] = -self.weight
        matrix[np.arange(size), np.arange(size)] = self.pivot
        dense = flint.fmpz_mat(size, size, matrix.ravel().tolist())
        found: Any = dense.solve(flint.fmpz_mat(size, 1, list(right)))
        numerator, denominator = found.numer_denom()
        return numerator.entries(), denominator


@dataclass(frozen=True, kw_only=True, eq=False)
class _Inverse:
    """A's factors in floats, each row divided by its pivot."""

    equations: Equations
    factors: Any
    bits: int  # Length of det A in bits, or a little more
    stretch: float  # Greatest row sum of the inverse

    @classmethod
    def of(cls, equations: Equations) -> _Inverse | None:
        """Return the factors, None where floats do not tell A from a singular matrix."""
        pivot, row, size = equations.pivot, equations.row, len(equations.pivot)
        shares = zip(equations.weight.tolist(), row.tolist(), strict=True)
        try:
            share = [weight / pivot[i] for weight, i in shares]
        except OverflowError:
            return None
        moving = sp.csc_array((share, (row, equations.column)), shape=(size, size))
        if max(pivot).bit_length() > LONGEST:
            return None
        try:
            factors = linalg.splu((sp.eye_array(size, format="csc") - moving).tocsc())
        except RuntimeError:
            return None
        with np.errstate(all="ignore"):
            length = sum(map(log2, pivot)) + np.log2(np.abs(factors.U.diagonal())).sum()
            stretch = float(np.abs(factors.solve(np.ones(size))).max())
        if not (np.isfinite(length) and stretch < STRETCHED):
            return None
        bits = max(1, int(length) + 1)
        return cls(equations=equations, factors=factors, bits=bits, stretch=stretch)

    def digits(self, right: Sequence[fmpz], places: int) -> tuple[list[int], int] | None:
        """Return x times 2^places for the next places that are whole digits, and these."""
        pivot, weight = self.equations.pivot, self.equations.weight
        wraps = max(pivot) < WRAPPING and magnitude(weight) < WRAPPING
        kind: Any = np.uint64 if wraps else object
        width = 32 if self.stretch < 2**14 else 16
        known = _digits(right, width)
        digits = np.zeros((len(known) - (-places // width), len(pivot)), dtype=np.int64)
        digits[: len(known)] = known
        first = np.flatnonzero(np.diff(self.equations.row, prepend=-1))
        filled, column = self.equations.row[first], self.equations.column
        own, weight = np.array(pivot, dtype=kind), weight.astype(kind)
        scale = np.array(pivot, dtype=np.float64)
        exact, rest = np.zeros(len(pivot), dtype=kind), np.zeros(len(pivot))
        for digit in digits:
            guess = np.rint(self.factors.solve((rest * 2.0**width + digit) / scale))
            if not np.abs(guess).max() < FARTHEST:
                return None
            exact = exact * 2**width + digit.astype(kind)
            digit[:] = guess
            taken = digit.astype(kind)
            exact -= own * taken
            if len(first):
                exact[filled] += np.add.reduceat(weight * taken[column], first)
            rest = (exact.view(np.int64) if kind is np.uint64 else exact).astype(np.float64)
            if not (np.abs(rest) <= 4 * scale).all():
                return None
        return _joined(digits, width), width * (len(digits) - len(known))


def _digits(numbers: Sequence[fmpz], width: int) -> Integers:
    """Return integers in two's complement as rows of digits, the first signed, the last lowest."""
    listed = [int(number) for number in numbers]
    count = max(number.bit_length() for number in listed) // width + 1
    content = b"".join(n.to_bytes(count * width // 8, "big", signed=True) for n in listed)
    digits = np.frombuffer(content, dtype=f">u{width // 8}").reshape(-1, count).T.astype(np.int64)
    digits[0] -= (digits[0] >> (width - 1)) << width
    return digits


def _joined(digits: Integers, width: int) -> list[int]:
    """Return the integers whose signed digits, of any size, are given in rows."""
    carry = np.zeros(digits.shape[1], dtype=np.int64)
    normal = np.empty(digits.shape, dtype=f">u{width // 8}")
    for place in range(len(digits) - 1, -1, -1):
        carry += digits[place]
        normal[place] = carry & (2**width - 1)
        carry >>= width
    columns = np.ascontiguousarray(normal.T)
    return [
        (high << width * len(digits)) + int.from_bytes(low.tobytes(), "big")
        for high, low in zip(carry.tolist(), columns, strict=True)
    ]


def _rationals(numbers: list[int], places: int, bits: int) -> tuple[list[fmpz], fmpz]:
    """Return the rationals nearest to numbers / 2^places, of denominators below 2^bits."""
    one, half = flint.fmpz(1) << places, flint.fmpz(1) << (places - 1)
    below = flint.fmpz(1)
    found: list[fmpz] = []
    for number in map(flint.fmpz, numbers):
        product = below * number
        nearest = (product + half) >> places
        if abs(product - nearest * one).bit_length() > places - bits:
            factor = _denominator(int(product % one), places, bits)
            below, found = below * factor, [value * factor for value in found]
            nearest = (product * factor + half) >> places
        found.append(nearest)
    return found, below


def _denominator(fraction: int, places: int, bits: int) -> int:
    """Return the denominator of the first convergent as near as 2^-bits to fraction / 2^places."""
    high, low, before, below = 1 << places, fraction, 0, 1
    limit = 1 << (places - bits)
    while low > limit:
        quotient, rest = divmod(high, low)
        high, low, before, below = low, rest, below, quotient * below + before
    return below
