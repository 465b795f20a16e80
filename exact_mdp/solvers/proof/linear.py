"""Exact solutions of A x = b for sparse integer matrices, by p-adic lifting.

A is factored once, modulo a prime p < 2³¹ (`solvers.kernels.modular`). Then the p-adic digits of x
come out one after the other (Dixon, Numerische Mathematik 40, 1982), so that after t of them

    A X = b  modulo  M = p^t.

A denominator d is found by rational reconstruction (Wang, Guy and Davenport, SIGSAM Bulletin 16,
1982) from a combination of the entries of X, and is put to the test: N = d X modulo M, symmetric
around 0, satisfies A N = d b modulo M, and both sides are smaller than M / 2 where

    |A| |N| < M / 2,   |d| |b| < M / 2.

Then they are equal, and x = N / d is proven; no bound on the size of x is needed. Otherwise more
digits are taken. So short solutions are found early. Once d is known, half the digits that it took
to find it are enough for N, so that another right side of the same equations, or of their
transpose, takes half the time: its denominator is that of the first one, as a rule.

Cycles of small models are long and thin: elimination in rationals is then faster. It comes first,
and is given up once it takes longer, or longer than loading compiled loops where they are not.

A pivot may vanish modulo p: another prime is taken. A few equations, and those that no prime of a
few suits, as all singular ones, are left to FLINT's dense solver.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING, Any

import flint
import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import COMPILED, Integers, Numbers
from exact_mdp.solvers.bounds.elimination import fill_order

if TYPE_CHECKING:
    from flint import fmpz


LARGEST_PRIME = 2**31 - 1
PRIMES = 4  # tried before A is taken to be singular
FEW, MANY = 40, 4_000  # equations that FLINT solves faster, or that are too many for it
FIRST, GROWTH = 16, 1.3  # digits before the first test, and how many more before the next
THIN, SLOW = 4, 20_000  # steps of elimination: for each entry; those as long as to load numba
SPARE = 40  # bits by which a reconstruction has to be shorter than chance makes it
LEAF = 8  # digits to a prime below 2³¹ that 32-bit limbs hold, with a sign
LACKING = 300  # bits, half of which a factor may have that a guess of the denominator lacks
SHORT = 600  # bits that Euclid's algorithm takes off at once


@dataclass(frozen=True, kw_only=True, eq=False)
class Equations:
    """A = diag(pivot) - W, of K rows; the M entries of W are listed row by row.

    The last `border` rows and columns are long ones, which are eliminated last. `long` solutions
    are taken to be as long as det A, and not looked for before.
    """

    pivot: Sequence[int]
    row: Integers  # (M,)
    column: Integers  # (M,)
    weight: Numbers  # (M,)
    border: int = 0
    long: bool = False

    def transposed(self) -> Equations:
        """Return the equations with rows for columns."""
        return replace(self, row=self.column, column=self.row)

    def solve(self, right: Sequence[fmpz], below: fmpz | None = None) -> tuple[list[fmpz], fmpz]:
        """Return x as integers over one positive denominator; ZeroDivisionError: A is singular.

        `below` is a guess of the denominator, which saves half the time where it is one.
        """
        found = None
        if len(self.pivot) > FEW:
            most = THIN * len(self.row) if len(self.row) >= COMPILED else SLOW
            found = self.eliminated(right, most) or self.lifting(right, below)
        return found or self.dense(right)

    def eliminated(self, right: Sequence[fmpz], most: int) -> tuple[list[fmpz], fmpz] | None:
        """Return x by elimination in rationals, None if a pivot is 0, or over `most` steps long.

        The equation with the fewest entries goes first, so that long thin cycles stay thin
        (after Markowitz, Management Science 3, 1957).
        """
        size, work = len(self.pivot), 0
        value = [flint.fmpq(number) for number in right]
        rows = [{k: flint.fmpq(number)} for k, number in enumerate(self.pivot)]
        users: list[set[int]] = [set() for _ in range(size)]
        none = flint.fmpq(0)
        entries = zip(self.row.tolist(), self.column.tolist(), self.weight.tolist(), strict=True)
        for i, j, weight in entries:
            rows[i][j] = rows[i].get(j, none) - weight
            if i != j:
                users[j].add(i)
        waiting = [(len(rows[k]) * len(users[k]), k) for k in range(size)]
        heapify(waiting)
        order = list[int]()
        gone = [False] * size
        while waiting:
            price, k = heappop(waiting)
            if gone[k]:
                continue
            if price < len(rows[k]) * len(users[k]):
                heappush(waiting, (len(rows[k]) * len(users[k]), k))
                continue
            work += price
            pivot = rows[k].pop(k)
            if pivot == 0 or work > most:
                return None
            gone[k] = True
            order.append(k)
            own = rows[k] = {j: number / pivot for j, number in rows[k].items()}
            value[k] /= pivot
            for j in own:
                users[j].discard(k)
            for i in users[k]:
                row = rows[i]
                share = row.pop(k)
                value[i] -= share * value[k]
                for j, number in own.items():
                    row[j] = row.get(j, none) - share * number
                    if i != j:
                        users[j].add(i)
                heappush(waiting, (len(row) * len(users[i]), i))
        for k in reversed(order):
            for j, number in rows[k].items():
                value[k] -= number * value[j]
        below = flint.fmpz(1)
        for number in value:
            below = below.lcm(number.q)
        return [number.p * (below // number.q) for number in value], below

    def lifting(
        self, right: Sequence[fmpz], below: fmpz | None = None
    ) -> tuple[list[fmpz], fmpz] | None:
        """Return x by lifting; None where no prime of a few suits, as where A is singular."""
        each = (self.lifted(right, prime, below) for prime in _primes())
        return next((found for found in each if found is not None), None)

    def dense(self, right: Sequence[fmpz]) -> tuple[list[fmpz], fmpz]:
        """Return what FLINT's dense solver finds."""
        size = len(self.pivot)
        if size > MANY:
            raise ModelError(
                f"the equations of a cycle of {size} states are singular, or nearly so",
                fix="use certify(mdp, bounded=True), which proves bounds in floating point",
            )
        matrix = np.zeros((size, size), dtype=object)
        matrix[self.row, self.column] = -self.weight
        matrix[np.arange(size), np.arange(size)] = self.pivot
        dense = flint.fmpz_mat(size, size, matrix.ravel().tolist())
        found: Any = dense.solve(flint.fmpz_mat(size, 1, list(right)))
        numerator, denominator = found.numer_denom()
        return numerator.entries(), denominator

    def lifted(
        self, right: Sequence[fmpz], prime: int, below: fmpz | None = None
    ) -> tuple[list[fmpz], fmpz] | None:
        """Return x by lifting with one prime, None where a pivot vanishes modulo it."""
        size = len(self.pivot)
        own = np.empty(size, dtype=object)
        own[:] = self.pivot
        row = np.concatenate([self.row, np.arange(size)])
        column = np.concatenate([self.column, np.arange(size)])
        entry = np.concatenate([-self.weight.astype(object), own])
        dominant = np.where(row == column, size + 1.0, 1.0)
        order = fill_order(sp.csc_array((dominant, (row, column)), (size, size)))
        order = order[np.argsort(order >= size - self.border, kind="stable")]
        place = np.argsort(order)
        row, column = place[row], place[column]
        sequence = np.lexsort((column, row))
        row, column, entry = row[sequence], column[sequence], entry[sequence]
        indptr = np.searchsorted(row, np.arange(size + 1))
        pattern = _pattern(row, column, size)
        entries = len(pattern.column)
        from exact_mdp.solvers.kernels import modular

        factors = modular.Factors(*(np.zeros(n, np.uint64) for n in (entries, entries, size)))
        residue, scratch = (entry % prime).astype(np.uint64), np.zeros(size, dtype=np.uint64)
        if modular.eliminate(indptr, column, residue, prime, pattern, factors, scratch) >= 0:
            return None
        norms = np.add.reduceat(np.abs(entry), indptr[:-1])
        norm = int(norms.max())
        width = min(22, 31 - int(np.diff(indptr).max()).bit_length())
        matrix = modular.Limbs(indptr, column, _limbs(entry, width), width)
        rest = np.zeros((size, (norm.bit_length() + 33) // width + 2), dtype=np.int64)
        given = [right[state] for state in order.tolist()]
        largest = max(abs(int(number)) for number in given)
        bits = prime.bit_length() - 1
        known = _expanded(given, prime, largest.bit_length() // bits + 2)
        # How much longer than their denominator numerators may be; all digits that det A needs.
        inner = size - self.border
        excess = max(0, largest.bit_length() - min(int(p).bit_length() for p in own[:inner]))
        lengths = [int(p).bit_length() for p in (*own[:inner], *norms[inner:])]
        full = (2 * sum(lengths) + excess + 3 * SPARE) // bits

        def enough(below: fmpz) -> int:
            return int(below.bit_length() + excess + norm.bit_length() + LACKING) // bits + 2

        share = np.random.default_rng(size).integers(1, 1024, size)
        mixed, parts = list[int](), list[Numbers]()
        start = max(1, full) if self.long else FIRST
        count = start if below is None else enough(below)
        while True:
            fresh = np.empty((count - len(mixed), size), dtype=np.int32)
            brought = np.zeros(fresh.shape, dtype=np.int64)
            coming = known[len(mixed) : count]
            brought[: len(coming)] = coming
            if not modular.lift(prime, matrix, pattern, factors, brought, rest, scratch, fresh):
                raise RuntimeError("a remainder of p-adic lifting is not divisible by the prime")
            parts.append(fresh)
            mixed += (fresh @ share).tolist()
            modulus = flint.fmpz(prime) ** count
            if below is None:
                below = _denominator(_evaluated(mixed, prime) % modulus, modulus, excess)
            if below is not None:
                for few in sorted({min(count, enough(below)), count}):
                    digits = np.concatenate(parts)[:few]
                    found = _rationals(digits, below, prime, norm, largest, excess)
                    if found is not None:
                        return [found[0][i] for i in place.tolist()], found[1]
                below = None
            more = int(count * GROWTH) + 1
            count = full if count < full < more * GROWTH else more


def _primes() -> Iterator[int]:
    prime = LARGEST_PRIME
    for _ in range(PRIMES):
        while not flint.fmpz(prime).is_prime():
            prime -= 2
        yield prime
        prime -= 2


def _pattern(row: Integers, column: Integers, size: int) -> Any:
    """Return where the factors of a matrix have entries, whatever its numbers are."""
    ends = (np.maximum(row, column), np.minimum(row, column))
    below = sp.csr_array((np.ones(len(row), dtype=np.int8), ends), (size, size))
    parent, seen, count = np.empty((3, size), dtype=np.int64)
    from exact_mdp.solvers.kernels import linear

    entries = linear.fill(below.indptr, below.indices, 2**62, np.inf, parent, seen, count) - size
    first = np.concatenate([[0], np.cumsum(count - 1)])
    found = np.empty(entries, dtype=np.int32)
    seen[:] = -1
    from exact_mdp.solvers.kernels import modular

    modular.structure(below.indptr, below.indices, parent, seen, first[:-1].copy(), found)
    owner = np.repeat(np.arange(size, dtype=np.int32), np.diff(first))
    back = np.concatenate([[0], np.cumsum(np.bincount(found, minlength=size))])
    return modular.Pattern(first, found, back, owner[np.argsort(found, kind="stable")])


def _limbs(numbers: Numbers, width: int) -> Numbers:
    """Return integers as limbs (Q, M), each of the sign of its number."""
    left, sign, found = np.abs(numbers), np.where(numbers < 0, -1, 1), []
    while True:
        found.append((left & (1 << width) - 1).astype(np.int64) * sign)
        left = left >> width
        if not left.any():
            return np.array(found, dtype=np.int32)


def _expanded(numbers: list[fmpz], base: int, length: int) -> Integers:
    """Return numbers as rows (T, K) of digits, the lowest first, all but the last not negative.

    T is `length` or a little more. Parts of LEAF digits are cut off; arrays divide all of these,
    of as many 32-bit limbs, by the base, again and again.
    """

    def split(values: list[fmpz], leaves: int) -> list[list[fmpz]]:
        if leaves == 1:
            return [values]
        power = flint.fmpz(base) ** (LEAF * (leaves // 2))
        parts = [divmod(value, power) for value in values]
        low = split([part[1] for part in parts], leaves // 2)
        return low + split([part[0] for part in parts], leaves - leaves // 2)

    leaves = split(numbers, -(-length // LEAF))
    data = [
        int(value).to_bytes(4 * LEAF, "little", signed=True) for part in leaves for value in part
    ]
    limbs = np.frombuffer(b"".join(data), dtype="<u4").reshape(-1, LEAF).T.astype(np.int64)
    limbs[-1] = limbs[-1].astype(np.uint32).view(np.int32)
    digits = np.empty((LEAF, limbs.shape[1]), dtype=np.int64)
    for digit in digits:
        rest = np.zeros(limbs.shape[1], dtype=np.int64)
        for limb in limbs[::-1]:
            rest = (rest << 32) + limb
            limb[:] = rest // base
            rest -= limb * base
        digit[:] = rest
    digits[-1] += limbs[-1] * base  # -1 where the number is negative
    found: Integers = digits.reshape(LEAF, len(leaves), -1).swapaxes(0, 1)
    return found.reshape(LEAF * len(leaves), -1)


def _evaluated(digits: list[int], base: int) -> fmpz:
    found: fmpz = flint.fmpz_poly(digits)(flint.fmpz(base))
    return found


def _rationals(
    digits: Integers, below: fmpz, prime: int, norm: int, largest: int, excess: int
) -> tuple[list[fmpz], fmpz] | None:
    """Return the proven rationals whose p-adic digits (T, K) are given, None where too few are.

    `below` is a first denominator; where one number needs another, the least common one is taken.
    """
    modulus = flint.fmpz(prime) ** len(digits)
    longest = modulus.bit_length() - norm.bit_length() - 2
    found: list[fmpz] = []
    paired = digits[::2].astype(np.int64)
    paired[: len(digits) // 2] += digits[1::2] * np.int64(prime)
    for column in paired.T:
        product = _symmetric(below * _evaluated(column.tolist(), prime**2), modulus)
        if product.bit_length() > longest:
            # Numerators are longer than the factor that is missing by the denominator so far.
            factor = _denominator(product % modulus, modulus, excess + int(below.bit_length()))
            if factor is None:
                return None
            below, found = below * factor, [value * factor for value in found]
            product = _symmetric(product * factor, modulus)
        found.append(product)
    most = max(int(abs(value)) for value in found)
    proven = 2 * norm * most < modulus and 2 * int(below) * largest < modulus
    return (found, below) if proven else None


def _symmetric(number: fmpz, modulus: fmpz) -> fmpz:
    rest = number % modulus
    return rest - modulus if 2 * rest > modulus else rest


def _denominator(number: fmpz, modulus: fmpz, excess: int) -> fmpz | None:
    """Return d > 0 with d · number = n modulo the modulus, both short; None where there are none.

    n may be about `excess` bits longer than d.
    """
    length = modulus.bit_length()
    end = max(0, min((length + excess) // 2, length - SPARE))
    high, low, before, below = modulus, number, flint.fmpz(0), flint.fmpz(1)
    while low.bit_length() > end:
        quotient, rest = divmod(high, low)
        high, low, before, below = low, rest, below, before - quotient * below
        if low.bit_length() > end:
            a, b, c, d = _steps(high, low, low.bit_length() - end)
            high, low = a * high + b * low, c * high + d * low
            before, below = a * before + b * below, c * before + d * below
            if abs(low) > abs(high):
                high, low, before, below = low, high, below, before
            if high * low < 0:
                low, below = -low, -below
            if high < 0:
                high, low, before, below = -high, -low, -before, -below
    short = below.bit_length() + low.bit_length() < length - SPARE
    return abs(below) if short and below else None


def _steps(high: fmpz, low: fmpz, bits: int) -> tuple[fmpz, fmpz, fmpz, fmpz]:
    """Return a matrix (a, b; c, d) of steps of Euclid's algorithm that take about `bits` bits off.

    They are those of the leading digits, which hardly differ (Lehmer, American Mathematical Monthly
    45, 1938); many bits are taken off in two halves.
    """
    spare = max(0, high.bit_length() - 2 * bits - 64)
    high, low = high >> spare, low >> spare
    end = high.bit_length() - bits
    a, b, c, d = flint.fmpz(1), flint.fmpz(0), flint.fmpz(0), flint.fmpz(1)
    while low.bit_length() > end:
        if bits > SHORT and low.bit_length() - end > bits // 4:
            e, f, g, h = _steps(high, low, (low.bit_length() - end) // 2)
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
