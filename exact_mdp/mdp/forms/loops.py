"""Compiled loops over rows: those of a sparse matrix taken over, floats settled.

A row of a model is a distribution over states, each named once. While a row is in the cache its
numbers are looked at and added up, and it is copied; where its columns are in no order, each entry
goes to the place that the number of smaller ones says. That takes a comparison for each two entries
of a row, but no decision that the processor would have to guess. Longer rows out of order, and rows
of which anything is wrong, are left to `mdp.build`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from exact_mdp.mdp.forms.compiling import at, compiled, inlined, span
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
NEAR = 5e-10  # how far from 1 the sum of a row that is taken as it is may be


@inlined
def parted(share: float, scale: float) -> tuple[Any, Any]:
    """Return a number from 0 to 2 in multiples of `COARSE`, and the rest in those of 1 / `scale`.

    So that sums of many are exact: see `mdp.forms.rows.fine_unit`.
    """
    coarse = np.rint(share / COARSE)
    return np.int64(coarse), np.int64(np.rint((share - coarse * COARSE) * scale))


@compiled
def settle(first: int, last: int, offsets: Integers, weight: Floats, fine: float) -> None:
    """Do for rows first … last-1 what `mdp.forms.rows.settle` does."""
    scale = 1 / fine
    for row in range(first, last):
        begin, end = offsets[row], offsets[row + 1]
        while True:
            sound, most, count, whole, rest = True, 0.0, 0, np.int64(0), np.int64(0)
            for i in span(begin, end):
                share = weight[i]
                sound &= (share > 0) & (share < 2)
                coarse, left = parted(share, scale)
                whole, rest = whole + coarse, rest + left
                count = 1 if share > most else count + (share == most)
                most = max(most, share)
            excess = (whole - 2**40) * COARSE + rest * fine
            if not (sound and abs(excess) <= FLOAT_ROW_TOLERANCE):
                break
            written, total = True, 0.0
            for i in range(begin, end):
                top = np.rint(weight[at(i)] * WHOLE)
                total += top
                if abs(top / WHOLE - weight[at(i)]) > NEXT * weight[at(i)]:
                    written = False
                    break
            if written and total == WHOLE:
                for i in span(begin, end):
                    weight[i] = np.rint(weight[i] * WHOLE) / WHOLE
                break
            given = most - excess / count
            if given == most:
                break
            for i in span(begin, end):
                if weight[i] == most:
                    weight[i] = given


@partial(compiled, fastmath={"reassoc"})  # in any order: the sum is only held against `NEAR`
def taken(
    first: int,
    last: int,
    states: int,
    offsets: Integers,
    indices: Numbers,
    data: Floats,
    columns: Numbers,
    weights: Floats,
) -> bool:
    """Copy rows first … last-1 into `columns` and `weights` (N,), columns rising in each.

    Return whether each row is one of positive numbers, of different states, with sum 1, and in
    order or short.
    """
    for row in range(first, last):
        begin, end = offsets[row], offsets[row + 1]
        sound, falls, total = begin < end, np.int64(0), 0.0
        for i in span(begin, end):
            weights[i] = data[i]
            sound &= (data[i] > 0) & (data[i] < 2)
            total += data[i]
        for i in span(begin, end):
            columns[i] = indices[i]
            sound &= (indices[i] >= 0) & (indices[i] < states)
        if not (sound and abs(total - 1) <= NEAR):
            return False
        for i in range(begin + 1, end):
            falls += np.int64(indices[at(i)] <= indices[at(i - 1)])
        if falls == 0:
            continue
        if end - begin > COMPARED:
            return False
        places = np.int64(0)
        for i in span(begin, end):
            column, smaller = indices[i], np.int64(0)
            for k in span(begin, end):
                smaller += indices[k] < column
            columns[at(begin + smaller)], weights[at(begin + smaller)] = column, data[i]
            places += smaller
        if 2 * places < (end - begin) * (end - begin - 1):  # two entries have one place
            return False
    return True
