"""What a row of floats means: in a model every row sums to 1 exactly.

Floats may miss 1 by 1e-9. A row of them means (1) the fractions n / WHOLE that sum to 1, where each
float is next to its fraction or a neighbour of that float: 1/3, 1/3, 1/3 or 1/10, 1/5, 7/10 are
what somebody wrote down; else (2) the binary fractions that the floats are, except that the largest
is what the others leave of 1; several largest ones share it equally. The model keeps the floats
next to these numbers, and the rule holds of them as they are. Exact numbers beside floats in a row
stay.

Two things are put right first. A float from -1e-9 to 0 is 0: rounding leaves such numbers, and the
rest of the row has to sum to 1 within 1e-9 all the same. A row of numbers that are all float32
values is divided by its sum if that misses 1 by no more than single precision rounds n numbers that
were divided by their sum, (n + 1) 2^-24 / (1 - (n + 1) 2^-24).

The values alone decide, neither places nor order, so that symmetric actions stay tied; and exact
numbers do not grow, as all denominators are divisors of WHOLE or powers of two, times the number of
the largest. Dividing each row by its sum makes 895 digits of the value of FrozenLake 8 x 8 at
discount 99/100 and 8,037 of 60 layers of 10 states, this rule 89 and 1,154. WHOLE has the
denominators that people write, decimals of six places among them; any up to 10,000 would let the
common multiples of rows grow.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from math import fsum, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Numbers = NDArray[Any]

WHOLE = 2**6 * 3**2 * 5**6 * 7
FLOAT_ROW_TOLERANCE = 1e-9  # how far from 1 floats of a row may sum: LONG roundings are 5e-10
NEXT = 2.0**-52  # of a number: no farther from it are its neighbours among the floats
SINGLE = 2.0**-24  # what single precision may round away of a number, in proportion
COARSE, FINEST, LONG = 2.0**-40, -93, 2**22  # of sums: their units, and the most terms of a row


def rationalize_row(row: Sequence[Fraction | float]) -> list[Fraction | float]:
    """Return the exact numbers that a row means; a row that is no distribution stays as it is.

    Examples
    --------
    >>> rationalize_row([0.1, 0.2, 0.7])
    [Fraction(1, 10), Fraction(1, 5), Fraction(7, 10)]
    >>> rationalize_row([Fraction(1, 3), 1 / 6, 0.5])
    [Fraction(1, 3), Fraction(1, 6), Fraction(1, 2)]
    """
    floats = [number for number in row if isinstance(number, float)]
    if not floats or not all(isfinite(number) and number >= 0 for number in floats):
        return list(row)
    left = 1 - sum((number for number in row if isinstance(number, Fraction)), Fraction(0))
    if abs(sum(map(Fraction, floats)) - left) > Fraction(FLOAT_ROW_TOLERANCE):
        return list(row)
    tops = {number: round(number * WHOLE) for number in floats}
    near = all(abs(top / WHOLE - number) <= NEXT * number for number, top in tops.items())
    if near and sum(tops[number] for number in floats) == left * WHOLE:
        return [Fraction(tops[x], WHOLE) if isinstance(x, float) else x for x in row]
    largest = max(floats)
    others = sum(Fraction(number) for number in floats if number != largest)
    share = (left - others) / floats.count(largest)
    if share <= 0:
        return list(row)
    rounded = float(share)
    if rounded != largest:  # another one may be the largest then
        return rationalize_row(
            [rounded if isinstance(x, float) and x == largest else x for x in row]
        )
    exact = {number: Fraction(number) for number in floats} | {largest: share}
    return [exact[x] if isinstance(x, float) else x for x in row]


def put_right(weight: Numbers, offsets: Integers) -> Numbers:
    """Return numbers (N,) without negative ones of rounding, and rows of float32 that sum to 1.

    Examples
    --------
    >>> put_right(np.array([1.0, -4e-16]), np.array([0, 2])).tolist()
    [1.0, 0.0]
    >>> put_right(np.float32([0.1, 0.2, 0.7]), np.array([0, 3])).sum().item()
    1.0
    """
    if weight.dtype == object:
        floats = [number if isinstance(number, float) else np.nan for number in weight]
        numbers = np.array(floats, dtype=np.float64)
    elif weight.dtype.kind == "f":
        numbers = weight.astype(np.float64)
    else:
        return weight
    lengths = np.diff(offsets)
    row = np.repeat(np.arange(len(lengths)), lengths)
    right = np.where((numbers < 0) & (numbers >= -FLOAT_ROW_TOLERANCE), 0.0, numbers)
    with np.errstate(over="ignore", invalid="ignore"):
        total = np.bincount(row, right, len(lengths))  # NaN where a number is exact
        rounding = np.minimum((lengths + 1) * SINGLE, 0.5)
        off = np.abs(total - 1)
        single = (off > FLOAT_ROW_TOLERANCE) & (off <= rounding / (1 - rounding))
        if single.any():
            others = (right != right.astype(np.float32)) | (right < 0)
            single &= np.bincount(row, others, len(lengths)) == 0
            right = np.where(single[row], right / total[row], right)
    changed = right != numbers
    changed &= right == right
    if not changed.any():
        return weight
    return np.where(changed, right, weight)


def normalize_rows_in_numpy(weight: Floats, offsets: Integers) -> bool:
    """Write the floats next to what rows mean in their place; what is no distribution stays.

    Return whether all rows are distributions of positive numbers.
    """
    lengths, begins = np.diff(offsets), offsets[:-1]
    bits = weight.view(np.int64)  # which have the order of positive floats, and are compared faster
    changed = True
    while changed:  # another one may be the largest then
        least, most = (each.reduceat(bits, begins) for each in (np.minimum, np.maximum))
        largest = bits == np.repeat(most, lengths)
        least, most = least.view(np.float64), most.view(np.float64)
        excess, count = (
            _compute_excess(weight, offsets),
            np.add.reduceat(largest, begins, dtype=np.int64),
        )
        sound = (least > 0) & (most < 2) & (np.abs(excess) <= FLOAT_ROW_TOLERANCE)
        share = most - excess / count
        moved = sound & (share != most)
        changed = False
        # A least number that is no fraction, and not changed for being the largest, says no.
        near = np.abs(np.rint(least * WHOLE) / WHOLE - least) <= NEXT * least
        if (sound & (near | (least == most)) & (least != 1)).any():
            top, read = _match_fractions(weight, offsets)
            moved &= ~read
            written = np.where(np.repeat(read & sound, lengths), top / WHOLE, weight)
            changed = bool((written.view(np.int64) != bits).any())  # a NaN is not itself
            weight[:] = written
        if moved.any():
            np.copyto(weight, np.repeat(share, lengths), where=largest & np.repeat(moved, lengths))
            changed = True
    return bool(sound.all())


def rows_to_integers(weight: Floats, offsets: Integers) -> tuple[Numbers, Numbers]:
    """Return what settled rows mean: integers (N,), over a denominator for each row (L,).

    Examples
    --------
    >>> top, bottom = rows_to_integers(np.array([0.1, 0.2, 0.7, 0.5, 0.5]), np.array([0, 3, 5]))
    >>> top.tolist(), bottom.tolist()
    ([1, 2, 7, 1, 1], [10, 2])
    """
    lengths, begins = np.diff(offsets), offsets[:-1]
    top, bottom = to_dyadic_integers(weight, offsets)
    written, read = _match_fractions(weight, offsets)
    missing = np.asarray(bottom - np.add.reduceat(top, begins))
    rows = np.flatnonzero(~read & np.asarray(missing != 0, dtype=bool))
    if len(rows):
        largest = weight == np.repeat(np.maximum.reduceat(weight, begins), lengths)
        count = np.add.reduceat(largest, begins, dtype=np.int64)
        times = np.ones(len(lengths), dtype=missing.dtype)
        times[rows] = count[rows] // np.gcd(missing[rows], count[rows])
        if top.dtype != object and int(bottom.max()) * int(times.max()) >= 2**62:
            top, bottom = top.astype(object), bottom.astype(object)
            missing, times = missing.astype(object), times.astype(object)
        more = np.zeros(len(lengths), dtype=missing.dtype)
        more[rows] = missing[rows] * times[rows] // count[rows]
        bottom = bottom * times
        top = top * np.repeat(times, lengths) + largest * np.repeat(more, lengths)
    if read.any():
        whole = written[np.repeat(read, lengths)].astype(np.int64)
        begins = np.cumsum(lengths[read]) - lengths[read]
        shared = np.gcd(np.gcd.reduceat(whole, begins), WHOLE)
        top[np.repeat(read, lengths)] = whole // np.repeat(shared, lengths[read])
        bottom[read] = WHOLE // shared
    return top, bottom


def _match_fractions(weight: Floats, offsets: Integers) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the tops (N,) of fractions n / WHOLE, and which rows (L,) mean these."""
    top = np.rint(weight * WHOLE)
    near = np.abs(top / WHOLE - weight) <= NEXT * weight
    read = np.logical_and.reduceat(near, offsets[:-1])
    return top, read & (np.add.reduceat(top, offsets[:-1]) == WHOLE)


def _compute_excess(weight: Floats, offsets: Integers) -> Floats:
    """Return Σ p - 1 of each row (L,), rounded once, as the compiled loops do."""
    longest = int(np.diff(offsets).max())
    if longest >= LONG:
        rows = [weight[first:last].tolist() for first, last in pairwise(offsets.tolist())]
        return np.array([fsum([-1.0, *row]) for row in rows])
    fine, begins = fine_unit(longest), offsets[:-1]
    scaled = np.rint(weight / COARSE)
    left = np.rint((weight - scaled * COARSE) / fine)
    whole = np.add.reduceat(scaled.astype(np.int64), begins) - 2**40
    rest = np.add.reduceat(left.astype(np.int64), begins)
    return np.asarray(whole * COARSE + rest * fine)


def fine_unit(longest: int) -> float:
    """Return the unit in which to add up what multiples of `COARSE` leave of a row's floats.

    These are at most 2^-41 each, so that the sum of so many stays below 2^62, and is exact but for
    half a unit for each term. Turning the sum into a float costs no more.
    """
    return float(2.0 ** max(FINEST, longest.bit_length() - 103))


def to_dyadic_integers(values: Numbers, offsets: Integers) -> tuple[Numbers, Numbers]:
    """Return finite floats as integers over one power of two for each row."""
    mantissa, exponent = np.frexp(np.asarray(values, dtype=np.float64))
    whole = np.ldexp(mantissa, 53).astype(np.int64)
    zeros = np.where(whole == 0, 1, whole)
    twos = np.log2((zeros & -zeros).astype(np.float64)).astype(np.int64)
    power = np.where(whole == 0, 0, exponent.astype(np.int64) - 53 + twos)
    whole = whole >> twos
    lengths = np.diff(offsets)
    lowest = np.zeros(len(lengths), dtype=np.int64)
    filled = lengths > 0
    lowest[filled] = np.minimum.reduceat(power, offsets[:-1][filled])
    lowest = np.minimum(lowest, 0)
    shift = power - np.repeat(lowest, lengths)
    size = np.frexp(np.abs(whole).astype(np.float64))[1] + shift
    if values.size and int(size.max()) <= 62 and int(-lowest.min()) <= 62:
        return whole << shift, np.left_shift(np.int64(1), -lowest)
    top = np.empty(len(whole), dtype=object)
    top[:] = [int(a) << int(s) for a, s in zip(whole, shift, strict=True)]
    bottom = np.empty(len(lowest), dtype=object)
    bottom[:] = [1 << int(-p) for p in lowest]
    return top, bottom
