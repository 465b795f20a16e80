"""The exact distribution that a row of floats stands for: in a model every row sums to 1 exactly.

The sum of a row of floats may miss 1 by 1e-9. Such a row stands for

1. the fractions n / WHOLE that sum to 1, if each float is the nearest float to its fraction, or a
   neighbour of it: 1/3, 1/3, 1/3 and 1/10, 1/5, 7/10 are numbers that somebody wrote down; else
2. the binary fractions that the floats are, except the largest, which is 1 less the others. If
   several are the largest, each is an equal share.

The model stores the floats nearest to these numbers, and the rule gives the same numbers for them
again. Exact numbers in a row with floats are kept.

Two errors are corrected before. A float from -1e-9 to 0 becomes 0: rounding leaves such numbers,
and the remaining row still has to sum to 1 within 1e-9. A row in which all numbers are float32
values is divided by its sum, if the sum misses 1 by at most the error of n numbers that were
divided by their sum in single precision, (n + 1) 2^-24 / (1 - (n + 1) 2^-24).

The result depends on the values only, not on places or order, so symmetric actions remain tied. And
exact numbers stay short, since all denominators are divisors of WHOLE or powers of two, times the
number of largest floats: with rows divided by their sums instead, the value of FrozenLake 8 x 8 at
discount 99/100 has 895 digits instead of 89, and the value of a model with 60 layers of 10 states
8,037 instead of 1,154. WHOLE has the denominators that people write, including decimals of six
places; if it had all up to 10,000, the common multiples of rows would grow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from math import fsum, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Numbers = NDArray[Any]

WHOLE = 2**6 * 3**2 * 5**6 * 7  # the common denominator of fractions that people write
FLOAT_ROW_TOLERANCE = 1e-9  # a row of LONG floats may miss 1 by 2^22 roundings, which are 5e-10
NEXT = 2.0**-52  # the neighbours of a float x are at most NEXT * x away
# Sums of rows are exact in integers, multiples of COARSE and of a finer unit: see `fine_unit`.
# Longer rows than LONG are added up by `math.fsum`.
COARSE, LONG = 2.0**-40, 2**22


def rationalize_row(row: Sequence[Fraction | float]) -> list[Fraction | float]:
    """Return the exact distribution that a row stands for; any other row is returned unchanged.

    Examples
    --------
    >>> rationalize_row([0.1, 0.2, 0.7])
    [Fraction(1, 10), Fraction(1, 5), Fraction(7, 10)]
    >>> rationalize_row([Fraction(1, 3), 1 / 6, 0.5])
    [Fraction(1, 3), Fraction(1, 6), Fraction(1, 2)]
    """
    # The floats must sum, within the tolerance, to what the exact numbers leave of 1.
    floats = [number for number in row if isinstance(number, float)]
    if not floats or not all(isfinite(number) and number >= 0 for number in floats):
        return list(row)
    left = 1 - sum((number for number in row if isinstance(number, Fraction)), Fraction(0))
    if abs(sum(map(Fraction, floats)) - left) > Fraction(FLOAT_ROW_TOLERANCE):
        return list(row)
    # Rule 1: fractions n / WHOLE.
    tops = {number: round(number * WHOLE) for number in floats}
    near = all(abs(top / WHOLE - number) <= NEXT * number for number, top in tops.items())
    if near and sum(tops[number] for number in floats) == left * WHOLE:
        return _replace_floats(row, {number: Fraction(top, WHOLE) for number, top in tops.items()})
    # Rule 2: the largest is 1 less the others.
    largest = max(floats)
    others = sum(Fraction(number) for number in floats if number != largest)
    share = (left - others) / floats.count(largest)
    if share <= 0:
        return list(row)
    # If its float changes by this, another one may be the largest: apply the rule again.
    rounded = float(share)
    if rounded != largest:
        return rationalize_row(_replace_floats(row, {largest: rounded}))
    return _replace_floats(row, {number: Fraction(number) for number in floats} | {largest: share})


def _replace_floats(
    row: Sequence[Fraction | float], values: Mapping[float, Fraction | float]
) -> list[Fraction | float]:
    """Return a row with the floats in `values` replaced by their values."""
    replaced = []
    for number in row:
        if isinstance(number, float):
            number = values.get(number, number)
        replaced.append(number)
    return replaced


def put_right(weight: Numbers, offsets: Integers) -> Numbers:
    """Return probabilities (N,) with the two rounding errors of the module's header corrected.

    Examples
    --------
    >>> put_right(np.array([1.0, -4e-16]), np.array([0, 2])).tolist()
    [1.0, 0.0]
    >>> put_right(np.float32([0.1, 0.2, 0.7]), np.array([0, 3])).sum().item()
    1.0
    """
    # Exact numbers are NaN here, so no comparison holds of them.
    if weight.dtype == object:
        if set(map(type, weight)) == {Fraction}:
            return weight
        floats = [np.nan] * len(weight)
        for place, number in enumerate(weight):
            if isinstance(number, float):
                floats[place] = number
        numbers = np.array(floats, dtype=np.float64)
    elif weight.dtype.kind == "f":
        numbers = weight.astype(np.float64)
    else:
        return weight
    lengths = np.diff(offsets)
    row = np.repeat(np.arange(len(lengths)), lengths)
    # Negative numbers that rounding has left become 0.
    right = np.where((numbers < 0) & (numbers >= -FLOAT_ROW_TOLERANCE), 0.0, numbers)
    with np.errstate(over="ignore", invalid="ignore"):
        # Rows that miss 1 by more than double precision would, but not more than single precision.
        total = np.bincount(row, right, len(lengths))  # NaN if a number is exact
        # Single precision rounds x by at most 2^-24 x.
        rounding = np.minimum((lengths + 1) * 2.0**-24, 0.5)
        off = np.abs(total - 1)
        single = (off > FLOAT_ROW_TOLERANCE) & (off <= rounding / (1 - rounding))
        if single.any():
            # Divide by the sum if all numbers of the row are float32 values.
            others = (right != right.astype(np.float32)) | (right < 0)
            single &= np.bincount(row, others, len(lengths)) == 0
            right = np.where(single[row], right / total[row], right)
    changed = right != numbers
    changed &= right == right  # not where NaN stands for an exact number
    if not changed.any():
        return weight
    return np.where(changed, right, weight)


def normalize_rows_in_numpy(weight: Floats, offsets: Integers) -> bool:
    """Normalize rows in place: write the nearest floats to the exact distribution of each.

    Rows that are not distributions stay as they are. Return whether all rows are distributions of
    positive numbers.
    """
    lengths, begins = np.diff(offsets), offsets[:-1]
    # The bits of positive floats, as integers, have the same order and are compared faster.
    bits = weight.view(np.int64)
    # Rule 2 changes the largest number of a row. Another one may be the largest afterwards, so the
    # rule is applied until no row changes.
    changed = True
    while changed:
        least, most = np.minimum.reduceat(bits, begins), np.maximum.reduceat(bits, begins)
        largest = bits == np.repeat(most, lengths)
        least, most = least.view(np.float64), most.view(np.float64)
        excess = _compute_excess(weight, offsets)
        count = np.add.reduceat(largest, begins, dtype=np.int64)
        sound = (least > 0) & (most < 2) & (np.abs(excess) <= FLOAT_ROW_TOLERANCE)
        share = most - excess / count
        moved = sound & (share != most)
        changed = False
        # Rule 1 needs a pass over all numbers. It can be skipped if the least number of each row is
        # not near a fraction n / WHOLE, unless the least is also the largest, which rule 2 changes.
        near = np.abs(np.rint(least * WHOLE) / WHOLE - least) <= NEXT * least
        if (sound & (near | (least == most)) & (least != 1)).any():
            top, read = _match_fractions(weight, offsets)
            moved &= ~read
            written = np.where(np.repeat(read & sound, lengths), top / WHOLE, weight)
            changed = bool((written.view(np.int64) != bits).any())  # a NaN is not itself
            weight[:] = written
        # Rule 2.
        if moved.any():
            np.copyto(weight, np.repeat(share, lengths), where=largest & np.repeat(moved, lengths))
            changed = True
    return bool(sound.all())


def rows_to_integers(weight: Floats, offsets: Integers) -> tuple[Numbers, Numbers]:
    """Return the exact distributions of normalized rows: integers (N,) over denominators (L,).

    Examples
    --------
    >>> top, bottom = rows_to_integers(np.array([0.1, 0.2, 0.7, 0.5, 0.5]), np.array([0, 3, 5]))
    >>> top.tolist(), bottom.tolist()
    ([1, 2, 7, 1, 1], [10, 2])
    """
    # All rows as binary fractions, which sum to bottom - missing over bottom.
    lengths, begins = np.diff(offsets), offsets[:-1]
    top, bottom = to_dyadic_integers(weight, offsets)
    written, read = _match_fractions(weight, offsets)
    missing = np.asarray(bottom - np.add.reduceat(top, begins))
    rows = np.flatnonzero(~read & np.asarray(missing != 0, dtype=bool))
    if len(rows):
        # Rule 2: the `count` largest numbers of a row share the missing amount. If `count` does not
        # divide it, all numerators and the denominator are multiplied first.
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
        # Rule 1: fractions n / WHOLE, in lowest terms for each row.
        whole = written[np.repeat(read, lengths)].astype(np.int64)
        begins = np.cumsum(lengths[read]) - lengths[read]
        shared = np.gcd(np.gcd.reduceat(whole, begins), WHOLE)
        top[np.repeat(read, lengths)] = whole // np.repeat(shared, lengths[read])
        bottom[read] = WHOLE // shared
    return top, bottom


def _match_fractions(weight: Floats, offsets: Integers) -> tuple[Floats, NDArray[np.bool_]]:
    """Return numerators n (N,) of fractions n / WHOLE, and the rows (L,) that stand for them."""
    top = np.rint(weight * WHOLE)
    near = np.abs(top / WHOLE - weight) <= NEXT * weight
    read = np.logical_and.reduceat(near, offsets[:-1])
    return top, read & (np.add.reduceat(top, offsets[:-1]) == WHOLE)


def _compute_excess(weight: Floats, offsets: Integers) -> Floats:
    """Return Σ p - 1 of each row (L,), rounded once; the compiled loops give the same numbers."""
    longest = int(np.diff(offsets).max())
    if longest >= LONG:
        rows = [weight[first:last].tolist() for first, last in pairwise(offsets.tolist())]
        return np.array([fsum([-1.0, *row]) for row in rows])
    # Split each float into a multiple of COARSE and a multiple of a finer unit, and add up both in
    # integers; 2^40 multiples of COARSE are 1.
    fine, begins = fine_unit(longest), offsets[:-1]
    scaled = np.rint(weight / COARSE)
    left = np.rint((weight - scaled * COARSE) / fine)
    whole = np.add.reduceat(scaled.astype(np.int64), begins) - 2**40
    rest = np.add.reduceat(left.astype(np.int64), begins)
    return np.asarray(whole * COARSE + rest * fine)


def fine_unit(longest: int) -> float:
    """Return the unit for the sum of the remainders of floats after multiples of `COARSE`.

    A remainder is at most 2^-41, so the sum of `longest` remainders is below 2^62 units, and each
    adds an error of at most half a unit. Rounding the sum to a float does not add a larger error.
    At 2^-93 a remainder has 52 digits: a finer unit would bring nothing.
    """
    return float(2.0 ** max(-93, longest.bit_length() - 103))


def to_dyadic_integers(values: Numbers, offsets: Integers) -> tuple[Numbers, Numbers]:
    """Return finite floats (N,) as integers (N,) over a power of two for each row (L,)."""
    # A float is an odd integer `whole` times 2^power; 0 is 0 times 1.
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
    # The denominator of a row is 2^-lowest, for the lowest power in it.
    lowest = np.minimum(lowest, 0)
    shift = power - np.repeat(lowest, lengths)
    # Shifted to this denominator, the numbers may need more than 64 bits.
    size = np.frexp(np.abs(whole).astype(np.float64))[1] + shift
    if values.size and int(size.max()) <= 62 and int(-lowest.min()) <= 62:
        return whole << shift, np.left_shift(np.int64(1), -lowest)
    top = [a << s for a, s in zip(whole.tolist(), shift.tolist(), strict=True)]
    bottom = [1 << -p for p in lowest.tolist()]
    return np.array(top, dtype=object), np.array(bottom, dtype=object)
