"""Numeric lifting: solutions of sparse integer systems A x = b, digit by digit, from float factors.

A is factored once in floats. The digits of x to the base 2^k then come out one after the other,

    d = round(A⁻¹ (2^k r + β)),    r ← 2^k r + β - A d,    β the next digit of b

(Wan, Journal of Symbolic Computation 41, 2006). A digit is only as accurate as floats, but r is
exact: it is never larger than A, and is needed only modulo 2^64. If some bits of a number x are
known, its denominator q is the number that brings q x far closer to an integer than chance would
(Wang, Guy and Davenport, SIGSAM Bulletin 16, 1982): (q, q x mod 1) is the shortest vector of a
lattice. The solution is checked in integers, A n = q b; if it fails, more digits are taken.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice, pairwise
from operator import mul
from typing import TYPE_CHECKING, Any

import flint
import numpy as np
import scipy.sparse as sp
from scipy.sparse import linalg

from exact_mdp.mdp.table import Integers, Numbers, row_sums

if TYPE_CHECKING:
    from flint import fmpz


# Bits of a digit, in whole bytes: wide digits need fewer solves, narrow ones less accurate floats.
WIDTHS = (40, 24)
# Bits by which a fraction is closer than by chance; one wrong one in 2⁴⁰ fails the check.
SPARE = 40

Rows = Sequence[tuple[Sequence[int], Sequence[int]]]  # columns and entries


class Lifting:
    """A square matrix of K rows, factored in floats, and split into limbs for digits of a width."""

    def __init__(self, offsets: Integers, column: Integers, entry: Numbers) -> None:
        """Take M entries, row by row; row i has the entries offsets[i] … offsets[i+1]-1."""
        # Scale each row by a power of 2 to about 1 before it is factored in floats.
        self.size, self._entries = len(offsets) - 1, (offsets, column, entry)
        norms = row_sums(np.abs(entry), offsets).tolist()
        self.bits = np.array([int(number).bit_length() for number in norms])
        bits = np.repeat(self.bits, np.diff(offsets))
        if entry.dtype == object:  # beyond the floats, at times
            spare = np.maximum(bits - 512, 0)
            entry, bits = entry >> spare.astype(object), bits - spare
        near = (np.ldexp(entry.astype(np.float64), -bits), column, offsets)
        self._widths = list(WIDTHS)
        try:
            matrix = sp.csr_array(near, (self.size, self.size)).tocsc()
            self._factors = linalg.splu(matrix, permc_spec="MMD_AT_PLUS_A")
        except RuntimeError:  # singular, up to rounding
            self._widths = []
        self._split_limbs()

    @property
    def width(self) -> int:
        """Bits of a digit; 0 if floats are too inaccurate for digits of any width."""
        if self._widths:
            return self._widths[0]
        return 0

    def _split_limbs(self) -> None:
        """Split the entries into limbs whose products with digits add up within 64 bits."""
        offsets, column, left = self._entries
        lengths = np.diff(offsets)
        self._limb = 61 - self.width - int(lengths.max()).bit_length()
        # The lower limbs hold `_limb` bits each; the last one holds the rest, with the sign.
        parts = []
        for _ in range(-(-(int(self.bits.max()) - 61) // self._limb)):
            parts.append((left & ((1 << self._limb) - 1)).astype(np.int64))
            left = left >> self._limb
        parts.append(left.astype(np.int64))
        # Stack the limbs as one sparse matrix, so that one product serves all of them.
        count = len(parts)
        ends = np.cumsum(np.concatenate([[0], np.tile(lengths, count)]))
        data = (np.concatenate(parts), np.tile(column, count), ends)
        self._limbs = sp.csr_array(data, (count * self.size, self.size))
        shifts = [self.width + self._limb * place for place in range(count)]
        with np.errstate(over="ignore"):  # infinite beside entries that are far longer: floats fail
            self._scales = [np.ldexp(1.0, shift - self.bits) for shift in shifts]

    def solve(
        self, side: Sequence[Any], rows: Rows, known: fmpz | None = None
    ) -> tuple[list[fmpz], fmpz] | None:
        """Return the solution as integers over one denominator; None if floats cannot start.

        `rows` are the rows of the matrix, for the check; `known` is a denominator to try first.
        """
        while self.width:
            solution = self._solve_by_digits(side, rows, known)
            if solution is not None:
                return solution
            # Floats are too inaccurate for this width: try the next narrower one.
            del self._widths[0]
            self._split_limbs()
        return None

    def _solve_by_digits(
        self, side: Sequence[Any], rows: Rows, known: fmpz | None
    ) -> tuple[list[fmpz], fmpz] | None:
        """Return the solution from digits of the present width; None if floats fail."""
        size, width = self.size, self.width
        # Digits before the point, of b and of its solution, which is less than 2^54 times as large
        # as b whenever floats can start.
        lead = (max(int(number).bit_length() for number in side) + 54) // width + 1

        def count_digits(below: fmpz) -> int:
            # Some bits more than the known denominator, for factors that may be missing in it.
            return lead + (int(below.bit_length()) + 2 * SPARE) // width + 1

        # Hadamard's bound: as many digits determine the solution for any determinant.
        most = lead + 2 * (int(self.bits.sum()) + SPARE) // width + 1  # whatever det A is
        # A random combination of all unknowns has their common denominator, almost surely.
        share = np.random.default_rng(0).integers(1, max(2, 2 ** (62 - width) // size), size)
        coming, parts, mixed = self._yield_digits(side, lead), list[Integers](), list[Integers]()
        # An early search for a denominator fails, a late one comes after needless digits. Measured:
        # 8 to 60 digits before the first, and 1.2 to 1.5 times as many until the next, take equally
        # long.
        taken, count = 0, lead + 24
        if known is not None:
            count = count_digits(known)
        below = known
        while True:
            with np.errstate(all="ignore"):
                # Digits that are too long show that the float solution is too inaccurate.
                fresh = np.array(list(islice(coming, count - taken)))
            if fresh.max() > 1 << width or fresh.min() < -(1 << width):  # floats fail
                return None
            parts.append(fresh)
            mixed.append(fresh @ share)
            if below is None:
                # Guess the denominator from the combination alone.
                (number,) = _join_digits(np.concatenate(mixed)[:, None], width)
                below = _find_denominator(flint.fmpz(number), width * (count - lead))
            if below is not None:
                digits = np.concatenate(parts)
                # Few digits often suffice; every candidate is checked in exact arithmetic.
                for few in sorted({min(count, count_digits(below)), count}):
                    numbers = _join_digits(digits[:few], width)
                    candidate = _over_one_denominator(numbers, width * (few - lead), below)
                    if candidate is not None and _is_solution(rows, side, *candidate):
                        return candidate
            if count >= most:
                return None
            below, taken, count = None, count, min(most, int(count * 1.2) + 1)

    def _yield_digits(self, side: Sequence[Any], lead: int) -> Iterator[Integers]:
        """Yield the digits (K,) of the solution; the first `lead` stand before the point."""
        size, limb = self.size, self._limb
        coming = _digits_of(side, self.width, lead)
        rest = np.zeros(len(self._scales) * size, dtype=np.int64)
        parts = rest.reshape(-1, size)
        while True:
            # The next digit is the float solution of the present residual, rounded to an integer.
            near = parts[0] * self._scales[0]
            for own, scale in zip(parts[1:], self._scales[1:], strict=True):
                near += own * scale
            # Shift the residual by one digit, and bring in the next digit of the right side.
            rest <<= self.width
            following = next(coming, None)
            if following is not None:
                parts[0] += following
                near += np.ldexp(following, -self.bits)
            digit = np.rint(self._factors.solve(near)).astype(np.int64)
            yield digit
            # Subtract A times the digit exactly, and carry between limbs.
            rest -= self._limbs @ digit
            for own, after in pairwise(parts):
                carry = own >> limb
                own -= carry << limb
                after += carry


def _digits_of(numbers: Sequence[Any], width: int, count: int) -> Iterator[Integers]:
    """Return an iterator over the digits (K,) of signed numbers, the highest first."""
    size = width // 8
    data = b"".join(int(each).to_bytes(count * size, "little", signed=True) for each in numbers)
    # Read the bytes of all numbers at once, and order digits from the highest down.
    digits = np.zeros((len(numbers), count, 8), dtype=np.uint8)
    digits[:, :, :size] = np.frombuffer(data, dtype=np.uint8).reshape(len(numbers), count, size)
    ordered = digits.view(np.int64)[:, ::-1, 0].T
    # The highest digit has the sign.
    ordered[0] -= ordered[0] >> (width - 1) << width
    return iter(ordered)


def _join_digits(digits: Integers, width: int) -> list[int]:
    """Return the numbers with the given digits (T, K) to the base 2^width, the highest first."""
    # Digits may be negative or too long: carry, and keep the lowest bytes of each.
    low = np.empty_like(digits)
    carry = np.zeros(digits.shape[1], dtype=np.int64)
    for own, lowest in zip(digits[::-1], low, strict=True):
        np.add(own, carry, out=lowest)
        carry = lowest >> width
    numbers = list[int]()
    for own, top in zip(low.T, carry.tolist(), strict=True):
        data = np.ascontiguousarray(own).view(np.uint8).reshape(-1, 8)[:, : width // 8].tobytes()
        numbers.append(int.from_bytes(data, "little") + (top << 8 * len(data)))
    return numbers


def _over_one_denominator(
    numbers: Sequence[int], bits: int, below: fmpz
) -> tuple[list[fmpz], fmpz] | None:
    """Return the fractions close to numbers / 2^bits, over a multiple of `below`, or None."""
    top: list[fmpz] = []
    half = flint.fmpz(1) << (bits - 1)
    for number in numbers:
        # The nearest fraction over the denominator found so far.
        product = below * number
        nearest = (product + half) >> bits
        rest = product - (nearest << bits)
        # Too far from it: this number needs another factor in the denominator.
        if rest.bit_length() > bits - SPARE:
            factor = _find_denominator(rest, bits, excess=int(below.bit_length()))
            if factor is None:
                return None
            below, top = below * factor, [value * factor for value in top]
            nearest = (product * factor + half) >> bits
        top.append(nearest)
    return top, below


def _find_denominator(number: fmpz, bits: int, excess: int = 0) -> fmpz | None:
    """Return q with q · number / 2^bits far closer to an integer than by chance, or None."""
    # A short vector of this lattice is such a fraction; its distance may be `excess` bits longer
    # than q.
    basis = flint.fmpz_mat(2, 2, [number, flint.fmpz(1) << excess, flint.fmpz(1) << bits, 0]).lll()
    rest, below = basis[0, 0], abs(basis[0, 1]) >> excess
    if below and below.bit_length() + rest.bit_length() < bits - SPARE:
        return below
    return None


def _is_solution(rows: Rows, side: Sequence[Any], top: list[fmpz], below: fmpz) -> bool:
    """Return whether A n = q b."""
    return all(
        sum(map(mul, map(top.__getitem__, column), entry)) == below * own
        for (column, entry), own in zip(rows, side, strict=True)
    )
