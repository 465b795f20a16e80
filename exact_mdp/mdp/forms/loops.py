"""Compiled loops over rows: those of a sparse matrix taken over, floats settled.

While a row is in the cache its numbers are looked at, added up exactly, settled and copied; where
its columns are in no order, each entry goes to the place that the number of smaller ones says,
which needs no decision that the processor would have to guess. Longer rows out of order, and rows
of which anything is wrong, are left to `mdp.build`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from exact_mdp.mdp.forms.compiling import compile_loop, inline_loop, unsigned_index, unsigned_range
from exact_mdp.mdp.forms.rows import (
    COARSE,
    FLOAT_ROW_TOLERANCE,
    NEXT,
    WHOLE,
    Floats,
    Integers,
    Numbers,
)

COMPARED = 128  # entries of a row at most that are compared each with each
TWO = int(np.float64(2).view(np.int64))


@inline_loop
def split_into_units(share: float, scale: float) -> tuple[Any, Any]:
    """Return a number from 0 to 2 in multiples of `COARSE`, the rest in those of 1 / `scale`."""
    coarse = np.rint(share / COARSE)
    return np.int64(coarse), np.int64(np.rint((share - coarse * COARSE) * scale))


@inline_loop
def float_from_bits(bits: Any) -> Any:
    """Return the float of these bits."""
    return np.int64(bits).view(np.float64)


@compile_loop
def normalize_in_passes(begin: int, end: int, weight: Floats, fine: float) -> bool:
    """Do for one row what `mdp.forms.rows` does; return whether it is a distribution."""
    scale = 1 / fine
    while True:
        sound, most, count, whole, rest = True, 0.0, 0, np.int64(0), np.int64(0)
        for i in unsigned_range(begin, end):
            share = weight[i]
            sound &= (share > 0) & (share < 2)
            coarse, left = split_into_units(share, scale)
            whole, rest = whole + coarse, rest + left
            count = 1 if share > most else count + (share == most)
            most = max(most, share)
        excess = (whole - 2**40) * COARSE + rest * fine
        if not (sound and abs(excess) <= FLOAT_ROW_TOLERANCE):
            return False
        written, total = True, 0.0
        for i in range(begin, end):
            top = np.rint(weight[unsigned_index(i)] * WHOLE)
            total += top
            if abs(top / WHOLE - weight[unsigned_index(i)]) > NEXT * weight[unsigned_index(i)]:
                written = False
                break
        if written and total == WHOLE:
            for i in unsigned_range(begin, end):
                weight[i] = np.rint(weight[i] * WHOLE) / WHOLE
            return True
        given = most - excess / count
        if given == most:
            return True
        for i in unsigned_range(begin, end):
            if weight[i] == most:
                weight[i] = given


@inline_loop
def normalize_row(begin: int, end: int, weight: Floats, bits: Integers, fine: float) -> bool:
    """Do as `normalize_in_passes`, in one pass if a row's smallest number is not a short fraction.

    Such a row means its floats, but for the largest. Positive floats have the order of their bits.
    """
    scale, low, high = 1 / fine, np.int64(TWO), np.int64(0)
    whole, rest = np.int64(0), np.int64(0)
    for i in unsigned_range(begin, end):
        low, high = min(low, bits[i]), max(high, bits[i])
        coarse, left = split_into_units(weight[i], scale)
        whole, rest = whole + coarse, rest + left
    if not (low > 0 and high < TWO):
        return False
    least, most = float_from_bits(low), float_from_bits(high)
    near = abs(np.rint(least * WHOLE) / WHOLE - least) <= NEXT * least
    if near or low == high:
        return bool(normalize_in_passes(begin, end, weight, fine))
    whole -= 2**40
    excess = whole * COARSE + rest * fine
    if not abs(excess) <= FLOAT_ROW_TOLERANCE:
        return False
    if most - excess == most:
        return True
    count, second = np.int64(0), np.int64(0)
    for i in unsigned_range(begin, end):
        count += np.int64(bits[i] == high)
        second = max(second, bits[i] if bits[i] < high else np.int64(0))
    given = most
    while True:
        before, given = given, given - excess / count
        if given == before or given <= float_from_bits(second):
            break
        (first, more), (old, less) = split_into_units(given, scale), split_into_units(before, scale)
        whole, rest = whole + count * (first - old), rest + count * (more - less)
        excess = whole * COARSE + rest * fine
    for i in unsigned_range(begin, end):
        if weight[i] == most:
            weight[i] = given
    return given == before or bool(normalize_in_passes(begin, end, weight, fine))


@compile_loop
def normalize_block(
    first: int, last: int, offsets: Integers, weight: Floats, bits: Integers, fine: float
) -> bool:
    """Settle rows first … last-1; return whether all are distributions of positive numbers."""
    sound = True
    for row in range(first, last):
        sound &= normalize_row(offsets[row], offsets[row + 1], weight, bits, fine)
    return sound


@compile_loop
def copy_block(
    first: int,
    last: int,
    offsets: Integers,
    states: int,
    indices: Numbers,
    data: Floats,
    columns: Numbers,
    weight: Floats,
    bits: Integers,
    fine: float,
) -> bool:
    """Copy rows first … last-1 into `columns` and `weight` (N,), columns rising, and settle them.

    Return whether each is a distribution over different states, in order or short.
    """
    for row in range(first, last):
        begin, end = offsets[row], offsets[row + 1]
        sound, falls = begin < end, np.int64(0)
        for i in unsigned_range(begin, end):
            weight[i] = data[i]
        for i in unsigned_range(begin, end):
            columns[i] = indices[i]
            sound &= (indices[i] >= 0) & (indices[i] < states)
        if not sound:
            return False
        for i in range(begin + 1, end):
            falls += np.int64(indices[unsigned_index(i)] <= indices[unsigned_index(i - 1)])
        if falls > 0:
            if end - begin > COMPARED:
                return False
            places = np.int64(0)
            for i in unsigned_range(begin, end):
                column, smaller = indices[i], np.int64(0)
                for k in unsigned_range(begin, end):
                    smaller += indices[k] < column
                (
                    columns[unsigned_index(begin + smaller)],
                    weight[unsigned_index(begin + smaller)],
                ) = column, data[i]
                places += smaller
            if 2 * places < (end - begin) * (end - begin - 1):  # two entries have one place
                return False
        if not normalize_row(begin, end, weight, bits, fine):
            return False
    return True
