"""Rows of a sparse matrix taken over in one pass: copied, put in order, and checked.

A row of a model is a distribution over states, each named once. While a row is in the cache its
numbers are looked at and added up, and it is copied; where its columns are in no order, each entry
goes to the place that the number of smaller ones says. That takes a comparison for each two entries
of a row, but no decision that the processor would have to guess. Rows of which anything is wrong,
and long ones in no order, are left to `mdp.build`.
"""

from __future__ import annotations

import numpy as np

from exact_mdp.mdp.forms.compiling import at, compiled, span
from exact_mdp.mdp.table import Floats, Numbers

LONGEST = 64  # entries of a row that is sorted here
NEAR = 5e-10  # how far from 1 a sum may be, in whatever order it is added up


@compiled
def taken(
    first: int,
    last: int,
    states: int,
    indptr: Numbers,
    indices: Numbers,
    data: Floats,
    columns: Numbers,
    weights: Floats,
) -> bool:
    """Copy rows first … last-1 into `columns` and `weights` (N,), columns rising in each.

    Return whether each row is one of positive numbers, of different states, with sum 1.
    """
    for row in range(first, last):
        begin, end = indptr[row], indptr[row + 1]
        before, sound, rising, total = np.int64(-1), begin < end, True, 0.0
        for i in span(begin, end):
            column, weight = np.int64(indices[i]), data[i]
            sound &= (weight > 0) & (column >= 0) & (column < states)
            rising &= bool(column > before)
            before = column
            total += weight
        if not (sound and abs(total - 1) <= NEAR):
            return False
        if rising:
            for i in span(begin, end):
                columns[i], weights[i] = indices[i], data[i]
            continue
        if end - begin > LONGEST:
            return False
        same = 0
        for i in span(begin, end):
            column, place = indices[i], begin
            for k in span(begin, end):
                place += indices[k] < column
                same += indices[k] == column
            columns[at(place)], weights[at(place)] = column, data[i]
        if same > end - begin:
            return False
    return True
