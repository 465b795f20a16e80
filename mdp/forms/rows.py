"""Rows of a sparse matrix taken over in one pass: copied, put in order, and checked.

A row of a model is a distribution over states, each named once. While a row is in the cache its
numbers are looked at and added up, and it is copied; where its columns are in no order, each entry
goes to the place that the number of smaller ones says. That takes a comparison for each two entries
of a row, but no decision that the processor would have to guess. Longer rows are sorted by the
digits of their columns, the last one first (Knuth, The Art of Computer Programming 3, 1998, section
5.2.5); in those that name all states, each entry's place is known. Rows of which anything is wrong
are left to `mdp.build`.
"""

from __future__ import annotations

import numpy as np

from exact_mdp.mdp.forms.compiling import at, compiled, inlined, span
from exact_mdp.mdp.table import Floats, Numbers

COMPARED = 32  # entries of a row at most that are compared each with each
DIGIT, DIGITS = 8, 256  # bits, and numbers, of a digit
PLACE = 32  # bits of an entry's place in its row
NEAR = 5e-10  # how far from 1 a sum may be, in whatever order it is added up


@inlined
def by_digits(begin: int, end: int, states: int, indices: Numbers, room: Numbers) -> int:
    """Sort columns begin … end-1, each with its place in the row; return where in `room` they are.

    `room` (3, ·) is twice for the row, and for how many entries there are of each digit.
    """
    side, digit = 0, PLACE
    for i in range(end - begin):
        room[0, i] = (np.int64(indices[at(begin + i)]) << PLACE) | i
    while (states - 1) >> (digit - PLACE) > 0:
        room[2, :DIGITS] = 0
        for i in span(0, end - begin):
            room[2, at((room[side, i] >> digit) & (DIGITS - 1))] += 1
        before = np.int64(0)
        for number in span(0, DIGITS):
            before += room[2, number]
            room[2, number] = before - room[2, number]
        for i in span(0, end - begin):
            number = at((room[side, i] >> digit) & (DIGITS - 1))
            room[1 - side, at(room[2, number])] = room[side, i]
            room[2, number] += 1
        side, digit = 1 - side, digit + DIGIT
    return side


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
    room: Numbers,
) -> bool:
    """Copy rows first … last-1 into `columns` and `weights` (N,), columns rising in each.

    `room` (3, ·) is for the longest of them, and `DIGITS` at least; columns fit in 31 bits.

    Return whether each row is one of positive numbers, of different states, with sum 1.
    """
    for row in range(first, last):
        begin, end = indptr[row], indptr[row + 1]
        sound, rising, total, other = begin < end, True, 0.0, 0.0
        for i in span(begin, end):
            sound &= (data[i] > 0) & (indices[i] >= 0) & (indices[i] < states)
        for i in range(begin + 1, end):
            rising &= bool(indices[at(i)] > indices[at(i - 1)])
        half = begin + (end - begin) // 2
        for i in range(half - begin):  # two sums, as each addition waits for the one before
            total += data[at(begin + i)]
            other += data[at(half + i)]
        if (end - begin) % 2:
            total += data[at(end - 1)]
        total += other
        if not (sound and abs(total - 1) <= NEAR):
            return False
        if rising:
            for i in span(begin, end):
                columns[i], weights[i] = indices[i], data[i]
            continue
        if end - begin == states and states > COMPARED:
            room[0, :states] = -1
            for i in span(begin, end):
                room[0, at(indices[i])] = i
            for column in span(0, states):
                place = max(room[0, column], begin)
                sound &= bool(place == room[0, column])
                columns[at(begin + column)], weights[at(begin + column)] = column, data[at(place)]
            if not sound:
                return False
            continue
        if end - begin > COMPARED:
            side, before = by_digits(begin, end, states, indices, room), np.int64(-1)
            for i in range(end - begin):
                key = room[side, i]
                column = key >> PLACE
                sound &= bool(column > before)
                before = column
                columns[at(begin + i)] = column
                weights[at(begin + i)] = data[at(begin + (key & ((1 << PLACE) - 1)))]
            if not sound:
                return False
            continue
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
