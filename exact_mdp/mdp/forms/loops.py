"""Compiled loops over rows of floats: copy the rows of a sparse matrix, sort and normalize them.

While a row is in the cache, its numbers are checked, added up exactly, normalized as
`mdp.forms.rows` defines it, and copied. If its columns are not sorted, the place of each entry is
the number of smaller columns, which a processor counts without branches. Long unsorted rows, and
rows with an error, are left to `mdp.forms.columns`.
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

TWO = int(np.float64(2).view(np.int64))  # the bits of 2.0


@inline_loop
def split_into_units(share: float, scale: float) -> tuple[Any, Any]:
    """Return a number in [0, 2) as multiples of `COARSE`, and its rest in multiples of 1/scale."""
    coarse = np.rint(share / COARSE)
    return np.int64(coarse), np.int64(np.rint((share - coarse * COARSE) * scale))


@inline_loop
def float_from_bits(bits: Any) -> Any:
    """Return the float with the given bits."""
    return np.int64(bits).view(np.float64)


@compile_loop
def normalize_in_passes(begin: int, end: int, weight: Floats, fine: float) -> bool:
    """Normalize one row as `mdp.forms.rows` defines it; return whether it is a distribution."""
    scale = 1 / fine
    while True:
        # One pass: check the numbers, add them up in integers, count the largest ones.
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
        # Rule 1: are all numbers near fractions n / WHOLE that sum to 1?
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
        # Rule 2: the largest numbers share the excess. Then another one may be the largest: again.
        given = most - excess / count
        if given == most:
            return True
        for i in unsigned_range(begin, end):
            if weight[i] == most:
                weight[i] = given


@inline_loop
def normalize_row(begin: int, end: int, weight: Floats, bits: Integers, fine: float) -> bool:
    """Normalize one row like `normalize_in_passes`, in one pass if rule 1 cannot apply.

    Rule 1 cannot apply if the smallest number of the row is not near a fraction n / WHOLE. Positive
    floats are compared by their bits, which have the same order.
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
    # If rule 1 may apply, or all numbers are equal, the general loop decides.
    near = abs(np.rint(least * WHOLE) / WHOLE - least) <= NEXT * least
    if near or low == high:
        return bool(normalize_in_passes(begin, end, weight, fine))
    whole -= 2**40
    excess = whole * COARSE + rest * fine
    if not abs(excess) <= FLOAT_ROW_TOLERANCE:
        return False
    if most - excess == most:
        return True
    # Rule 2: change the `count` largest numbers until their float no longer changes, or they fall
    # to the second largest. The sum is updated by the change alone, without another pass.
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
    """Normalize rows first … last-1; return whether all are positive distributions."""
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
    """Copy rows first … last-1 into `columns` and `weight` (N,), sorted, and normalize them.

    Return whether each is a distribution over different states, and sorted or short.
    """
    for row in range(first, last):
        # Copy the row, and check its columns.
        begin, end = offsets[row], offsets[row + 1]
        sound, falls = begin < end, np.int64(0)
        for i in unsigned_range(begin, end):
            weight[i] = data[i]
        for i in unsigned_range(begin, end):
            columns[i] = indices[i]
            sound &= (indices[i] >= 0) & (indices[i] < states)
        if not sound:
            return False
        # Sort the row by counting, if some column is not above the one before.
        for i in range(begin + 1, end):
            falls += np.int64(indices[unsigned_index(i)] <= indices[unsigned_index(i - 1)])
        if falls > 0:
            # The work is quadratic in the length: a general sort is faster for long rows.
            if end - begin > 128:
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
            # The places 0 … n-1 sum to n (n - 1) / 2, unless two entries have the same column.
            if 2 * places < (end - begin) * (end - begin - 1):
                return False
        if not normalize_row(begin, end, weight, bits, fine):
            return False
    return True
