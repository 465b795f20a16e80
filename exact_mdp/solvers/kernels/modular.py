"""Sparse elimination modulo a prime, and p-adic lifting with its factors.

A = L U modulo a prime p < 2³¹, in the order given, where both factors have the pattern that a
Cholesky factor of the symmetrised matrix would have. With these factors the p-adic digits of the
solution of A x = b come out one by one (Dixon, Numerische Mathematik 40, 1982):

    y = A⁻¹ r mod p,    r ← (r - A y) / p + next digit of b

The remainders r are integers of several limbs, as are the entries of A: limb q counts 2^(width q).
Limbs are so narrow that a row's products with a digit add up within 64 bits. Products modulo p are
added up in 64 bits too: their upper and lower halves apart, or 2 p² taken off where it is reached.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from exact_mdp.mdp.table import Integers, Numbers
from exact_mdp.solvers.kernels.compiling import at, compiled, inlined, span


class Pattern(NamedTuple):
    """Where the factors of K equations have entries, N of them besides the diagonal."""

    first: Integers  # (K+1,) where the rows of U begin
    column: Numbers  # (N,) columns of U, rising in each row
    back: Integers  # (K+1,) where the rows of L begin
    left: Numbers  # (N,) columns of L, rising in each row


class Factors(NamedTuple):
    """Both factors modulo a prime; L has a diagonal of ones."""

    upper: Numbers  # (N,) uint64
    lower: Numbers  # (N,) uint64
    inverse: Numbers  # (K,) uint64, of the diagonal of U


class Limbs(NamedTuple):
    """The entries of A, row by row with rising columns, as Q signed limbs each."""

    indptr: Integers  # (K+1,)
    indices: Numbers  # (M,)
    limb: Numbers  # (Q, M) int32
    width: int  # bits of a limb


@compiled
def structure(
    indptr: Numbers,
    indices: Numbers,
    parent: Numbers,
    seen: Numbers,
    place: Numbers,
    column: Numbers,
) -> None:
    """Write the columns (N,) of each row of U, where `place` (K,) says that the rows begin.

    `indptr` and `indices` are the symmetrised pattern below the diagonal, `parent` its elimination
    tree: see `solvers.kernels.linear.fill`.
    """
    for i in range(len(indptr) - 1):
        seen[i] = i
        for e in range(indptr[i], indptr[i + 1]):
            k = indices[e]
            while k < i and seen[k] != i:
                seen[k] = i
                column[place[k]] = i
                place[k] += 1
                k = parent[k]


@compiled
def inverse_of(number: int, prime: int) -> int:
    """Return the inverse of a number modulo a prime."""
    high, low, before, found = prime, number, 0, 1
    while low > 1:
        quotient = high // low
        high, low, before, found = low, high - quotient * low, found, before - quotient * found
    return found % prime


@compiled
def eliminate(
    indptr: Numbers,
    indices: Numbers,
    residue: Numbers,
    prime: int,
    pattern: Pattern,
    factors: Factors,
    row: Numbers,
) -> int:
    """Write the factors of a matrix whose entries are `residue` (M,); `row` (K,) is all zeros.

    Returns the first place where the diagonal of U is 0 modulo the prime, -1 where there is none.
    """
    first, column, back, left = pattern
    upper, lower, inverse = factors
    p, most = np.uint64(prime), np.uint64(2) * np.uint64(prime) * np.uint64(prime)
    for i in range(len(inverse)):
        for e in span(indptr[i], indptr[i + 1]):
            row[at(indices[e])] = residue[e]
        for b in span(back[i], back[i + 1]):
            k = at(left[b])
            share = (row[k] % p) * inverse[k] % p
            row[k] = 0
            lower[b] = share
            if share:
                less = p - share
                for f in span(first[k], first[k + np.uint64(1)]):
                    j = at(column[f])
                    total = row[j] + less * upper[f]
                    row[j] = total - most if total >= most else total
        pivot = row[i] % p
        row[i] = 0
        if pivot == 0:
            return i
        inverse[i] = inverse_of(np.int64(pivot), prime)
        for f in span(first[i], first[i + 1]):
            j = at(column[f])
            upper[f] = row[j] % p
            row[j] = 0
    return -1


@inlined
def product(
    begin: int, end: int, prime: int, entry: Numbers, column: Numbers, value: Numbers
) -> Any:
    """Return the product of a part of a factor with a vector, modulo the prime."""
    low, high = np.uint64(0), np.uint64(0)
    if begin < end and column[end - 1] - column[begin] == end - begin - 1:  # nothing to look up
        ahead = np.uint64(column[begin]) - np.uint64(begin)
        for e in span(begin, end):
            term = entry[e] * value[e + ahead]
            low += term & np.uint64(0xFFFFFFFF)
            high += term >> np.uint64(32)
    else:
        for e in span(begin, end):
            term = entry[e] * value[at(column[e])]
            low += term & np.uint64(0xFFFFFFFF)
            high += term >> np.uint64(32)
    p = np.uint64(prime)
    return (high % p * np.uint64((1 << 32) % prime) + low) % p


@compiled
def substitute(prime: int, pattern: Pattern, factors: Factors, value: Numbers) -> None:
    """Replace b (K,) by the solution of L U x = b modulo the prime."""
    first, column, back, left = pattern
    upper, lower, inverse = factors
    p = np.uint64(prime)
    for i in range(len(value)):
        value[i] = (value[i] + p - product(back[i], back[i + 1], prime, lower, left, value)) % p
    for i in range(len(value) - 1, -1, -1):
        later = product(first[i], first[i + 1], prime, upper, column, value)
        value[i] = (value[i] + p - later) * inverse[i] % p


@compiled
def lift(
    prime: int,
    matrix: Limbs,
    pattern: Pattern,
    factors: Factors,
    known: Integers,
    rest: Integers,
    work: Numbers,
    digits: Integers,
) -> bool:
    """Write the next digits (T, K) of x, for digits `known` (T, K) of b and remainders `rest`.

    `rest` (K, R) are the limbs, the last ones signed, of what is left; `work` (K,) is scratch. The
    answer is False where a division by p leaves something, which cannot be.
    """
    indptr, indices, limb, width = matrix
    size, limbs, mask = len(work), rest.shape[1], (1 << width) - 1
    radix = np.int64((1 << width) % prime)
    for step in range(len(digits)):
        for i in range(size):
            rest[i, 0] += known[step, i]
            residue = np.int64(0)
            for q in range(limbs):
                residue = (residue * radix + rest[i, limbs - 1 - q]) % prime
            work[i] = residue
        substitute(prime, pattern, factors, work)
        for i in range(size):
            digits[step, i] = work[i]
        for i in range(size):
            begin, end = indptr[i], indptr[i + 1]
            for q in range(len(limb)):
                total = np.int64(0)
                if indices[end - 1] - indices[begin] == end - begin - 1:
                    ahead = np.uint64(indices[begin]) - np.uint64(begin)
                    for e in span(begin, end):
                        total += limb[q, e] * digits[step, e + ahead]
                else:
                    for e in span(begin, end):
                        total += limb[q, e] * digits[step, at(indices[e])]
                rest[i, q] -= total
            carry = np.int64(0)
            for q in range(limbs - 1):
                carry += rest[i, q]
                rest[i, q] = carry & mask
                carry >>= width
            rest[i, limbs - 1] += carry
            carry = np.int64(0)
            for q in range(limbs):
                carry = (carry << width) + rest[i, limbs - 1 - q]
                rest[i, limbs - 1 - q] = carry // prime
                carry -= rest[i, limbs - 1 - q] * prime
            if carry != 0:
                return False
    return True
