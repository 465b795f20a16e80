"""What pairs lose against values of a common denominator, exactly, for many pairs at once.

    loss(l) = scale(s) V(s) - constant(l) - Σ weight(i) V(next(i)),   all of it times one unit

V times the unit is an integer, written as V_0 + 2³² V_1 + 2⁶⁴ V_2 + …, where all digits but the
last are not negative. Sums over a row are formed digit by digit in 64-bit integers, which hold them
as long as scale(s) and the weights of a row add up to less than 2³⁰; then digits above 2³² are
carried over (Knuth, The Art of Computer Programming, volume 2, 1997, section 4.3.1).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.exact import BellmanRows, row_sums
from exact_mdp.mdp.table import Integers, magnitude, spans

WIDTH, MASK = 32, 2**32 - 1  # bits of a digit
SMALL = 2**29  # a scale, or weights of a row added up, at most


@dataclass(frozen=True, kw_only=True, eq=False)
class Losses:
    """Losses of K pairs, digit by digit; the last digit carries the sign.

    Attributes
    ----------
    digits : (Q, K) int64
    negative, nothing : (K,) bool
    """

    digits: Integers
    negative: NDArray[np.bool_]
    nothing: NDArray[np.bool_]

    def numbers(self, places: Integers) -> list[int]:
        """Return the losses of some pairs as Python integers."""
        data = np.ascontiguousarray(self.digits[:, places].T.astype("<u4")).tobytes()
        size = 4 * len(self.digits)
        return [
            int.from_bytes(data[first : first + size], "little", signed=True)
            for first in range(0, len(data), size)
        ]


def short_rows(rows: BellmanRows) -> bool:
    """Return whether sums over all rows fit, digit by digit."""
    if object in (rows.scale.dtype, rows.weight.dtype):
        return False
    flow = row_sums(rows.weight, rows.offsets)
    return magnitude(rows.scale) < SMALL and magnitude(flow) < SMALL


def losses(
    rows: BellmanRows, pairs: Integers, scaled: Callable[[list[int]], list[int]], unit: int
) -> Losses:
    """Return what some pairs (K,) lose, for `scaled` values of states, which are times `unit`.

    `rows` are short ones (`short_rows`).
    """
    lengths = rows.offsets[pairs + 1] - rows.offsets[pairs]
    entries = spans(rows.offsets[pairs], rows.offsets[pairs + 1])
    after, own = rows.next[entries], rows.pair_state[pairs]
    constant = rows.constant[pairs]
    earning = np.flatnonzero(constant != 0)
    earned = [number * unit for number in constant[earning].tolist()]
    known = distinct(np.concatenate([own, after]), len(rows.scale))
    place = np.empty(len(rows.scale), dtype=np.int64)
    place[known] = np.arange(len(known))
    numbers = scaled(known.tolist()) + earned
    longest = max((max(numbers), -min(numbers)), default=0).bit_length()
    count = longest // WIDTH + 1
    scale, own, after = rows.scale[own], place[own], place[after]
    weight, filled = rows.weight[entries], np.flatnonzero(lengths)
    begin = (np.cumsum(lengths) - lengths)[filled]
    found = np.empty((count + 1, len(pairs)), dtype=np.int64)
    total = np.zeros(len(pairs), dtype=np.int64)  # what is carried over, at first
    for digit, low in zip(_digits(numbers, count), found, strict=False):
        total += digit[own] * scale
        total[earning] -= digit[len(known) :]
        if len(entries):
            total[filled] -= np.add.reduceat(digit[after] * weight, begin)
        np.bitwise_and(total, MASK, out=low)
        total >>= WIDTH
    found[-1] = total
    return Losses(
        digits=found,
        negative=total < 0,
        nothing=np.equal(np.bitwise_or.reduce(found, axis=0), 0),
    )


def distinct(numbers: Integers, limit: int) -> Integers:
    """Return the numbers that occur, of those below the limit, in rising order."""
    if limit > 4 * len(numbers):
        return np.unique(numbers)
    seen = np.zeros(limit, dtype=bool)
    seen[numbers] = True
    return np.flatnonzero(seen)


def _digits(numbers: Sequence[int], count: int) -> Iterator[Integers]:
    """Yield the digits (N,) of integers, lowest ones first; the last one of each has its sign."""
    size = 4 * count
    data = b"".join([number.to_bytes(size, "little", signed=True) for number in numbers])
    digits = np.ascontiguousarray(np.frombuffer(data, dtype="<u4").reshape(-1, count).T)
    for digit in digits[:-1]:
        yield digit.astype(np.int64)
    yield digits[-1].view("<i4").astype(np.int64)
