"""Exact outcomes: what can happen after each state-action pair, as integers over a denominator.

Pair l has outcomes i in offsets[l] … offsets[l+1]-1. Outcome i has probability
weight[i] / denominator[l], leads to state next[i] and earns gain[i] / gain_denominator[l].
Weights are 64-bit integers where they fit, Python integers (dtype object) where they do not, or
floats, each taken as the exact dyadic rational that it is. The float model is derived from this
table, every number rounded once; there is no second source.

What a row of floats means: its probabilities are the numbers given, nothing is scaled. So they may
sum to a little more or less than 1, by up to `ROW_TOLERANCE`; only what is binary may: a row with a
float in it, or one whose numbers all have a power of two below the line, as floats do. Every other
row sums to 1 exactly. The expected reward of a pair is Σ p r where rewards are of outcomes; where
they are of pairs (an array of shape (L,)) it is r, whatever the probabilities sum to.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from decimal import MAX_EMAX, MIN_EMIN, Context, Decimal
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import pairwise
from math import gcd, lcm, ulp
from numbers import Rational
from typing import Any, Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from exact_mdp.mdp.errors import ModelError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Numbers = NDArray[Any]

# Transitions from which compiled loops are used. Below, NumPy takes less time than it takes to load
# the compiler, a third of a second.
COMPILED = 20_000
EXACT_IN_FLOAT = 2**53
EXACT_IN_INT64 = 2**62
EXPONENT = 0x7FF << 52  # the bits of a double that hold its exponent
FLOAT_ROW_TOLERANCE = 1e-9
FLOAT_RANGE = (Fraction(1, 10**300), Fraction(10**300))  # where floats keep all their digits
LARGEST = Fraction(2**1024 - 2**971)  # the largest float
COARSE, FINEST, LONG = 2.0**-40, -93, 2**22  # of sums: their units, and the most terms of a row
MOST_BYTES = 10 * 10**9  # of the outcomes of one table
MOST_DIGITS = 4000  # of a number that is given as text: Python itself stops at 4,300
NARROW, WIDE = 45, 230  # bytes for each outcome, 64-bit integers or Python's
ROW_TOLERANCE = Fraction(1, 10**9)


class Given(Fraction):
    """The exact value of a number of a model, and what else is known of it.

    It calculates as any `Fraction` does; the results are plain ones, but for a change of sign.
    `rounding` says how far the value may lie from the number that it was rounded from: more than 0
    where it was given as a float. `certain` says of a reward that it is the pair's own, earned in
    full whatever the probabilities sum to.

    Examples
    --------
    >>> number = Given(Fraction(1, 4), rounding=2.0**-55)
    >>> number, number + 1, (-number).rounding == number.rounding
    (Fraction(1, 4), Fraction(5, 4), True)
    """

    __slots__ = ("certain", "rounding")
    rounding: float
    certain: bool

    def __new__(
        cls,
        value: Any = 0,
        denominator: int | None = None,
        *,
        rounding: float = 0.0,
        certain: bool = False,
    ) -> Self:
        """Return a number, given in any way that `Fraction` takes, with what is known of it."""
        found = super().__new__(cls, value, denominator)
        found.rounding, found.certain = rounding, certain
        return found

    def __neg__(self) -> Given:
        return Given(super().__neg__(), rounding=self.rounding, certain=self.certain)

    def __repr__(self) -> str:
        return f"Fraction({self.numerator}, {self.denominator})"

    def __reduce__(self) -> tuple[Any, ...]:
        value = Fraction(self.numerator, self.denominator)
        return _again, (value, self.rounding, self.certain)

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: Any) -> Self:
        return self


def _again(value: Fraction, rounding: float, certain: bool) -> Given:
    return Given(value, rounding=rounding, certain=certain)


@dataclass(frozen=True, kw_only=True, eq=False)
class OutcomeTable:
    """The joint law of next state and reward after each of L pairs, N outcomes in all.

    Attributes
    ----------
    offsets : (L+1,) int64
        Outcomes of pair l are offsets[l] … offsets[l+1]-1, sorted by next state.
    next : (N,) int32 or int64
        Next states.
    weight, denominator : (N,), (L,)
        Probability of outcome i of pair l is weight[i] / denominator[l].
    gain, gain_denominator : (N,) or (L,), (L,)
        Reward of an outcome; of shape (L,) where the pair alone decides it.
    event : (N,) uint8, optional
        Bit b is set on outcomes where the model's event number b happens.
    weight_doubt, gain_doubt : (N,), (N,) or (L,) float64, optional
        How far each number may lie from what it was rounded from, where that does not follow from
        the arrays: of floats among exact numbers, of sums, of floats shorter than 64 bits.
    """

    offsets: Integers
    next: Numbers
    weight: Numbers
    denominator: Numbers
    gain: Numbers
    gain_denominator: Numbers
    event: NDArray[np.uint8] | None = None
    weight_doubt: Floats | None = None
    gain_doubt: Floats | None = None

    @property
    def pairs(self) -> int:
        """Number of pairs, L."""
        return len(self.offsets) - 1

    @property
    def pair(self) -> Integers:
        """(N,) the pair that each outcome belongs to."""
        return np.repeat(np.arange(self.pairs), np.diff(self.offsets))

    @property
    def joint(self) -> bool:
        """True where the reward differs between outcomes of a pair."""
        return len(self.gain) == len(self.next) and self.pairs != len(self.next)

    @cached_property
    def rising(self) -> bool:
        """True where the next states of every pair rise strictly: sorted, none of them twice."""
        offsets = self.offsets
        if len(self.next) < 2**31 and self.next.dtype == np.int32:
            offsets = offsets.astype(np.int32)
        # A matrix of any numbers with these rows: what is asked does not depend on the numbers.
        shape = (self.pairs, int(self.next.max(initial=0)) + 1)
        return bool(sp.csr_array((self.next, self.next, offsets), shape).has_canonical_format)

    @cached_property
    def sums_to_one(self) -> bool:
        """True where all rows sum to 1 exactly; rows of floats are taken not to."""
        if self.weight.dtype == np.float64:
            return False
        return bool((self.row_sums() == self.denominator).all())

    def row_sums(self) -> Numbers:
        """Return (L,) sums of the weights of each pair, exact where these are integers."""
        weight = self.weight
        if weight.dtype == np.int64:
            longest = int(np.diff(self.offsets).max(initial=1))
            if magnitude(weight) * longest >= EXACT_IN_INT64:
                weight = weight.astype(object)
        with np.errstate(over="ignore"):  # infinity is not 1 either
            return np.asarray(np.add.reduceat(weight, self.offsets[:-1]))

    def of_pairs(self, pairs: Integers) -> OutcomeTable:
        """Return the table of some pairs (K,), in the order given."""
        chosen = spans(self.offsets[pairs], self.offsets[pairs + 1])
        found = replace(
            self.mapped(lambda _, values: values[pairs], lambda _, values: values[chosen]),
            offsets=np.concatenate([[0], np.cumsum(np.diff(self.offsets)[pairs])]),
            next=self.next[chosen],
        )
        return found if len(self.gain) == self.pairs else by_outcome(found)

    def mapped(
        self, of_pair: Callable[[str, Numbers], Numbers], of_outcome: Callable[[str, Numbers], Any]
    ) -> OutcomeTable:
        """Return a table whose numbers, by name, are what functions make of (L,) and (N,) ones."""
        by_pair = len(self.gain) == self.pairs
        parts = {
            "weight": of_outcome,
            "denominator": of_pair,
            "gain": of_pair if by_pair else of_outcome,
            "gain_denominator": of_pair,
            "event": of_outcome,
            "weight_doubt": of_outcome,
            "gain_doubt": of_pair if by_pair else of_outcome,
        }
        known = {name: getattr(self, name) for name in parts}
        changed = {
            name: parts[name](name, array) for name, array in known.items() if array is not None
        }
        return replace(self, **changed)

    def probabilities(self) -> Floats:
        """Return the (N,) outcome probabilities, each rounded once."""
        return divide(self.weight, self.denominator, np.diff(self.offsets))

    def gains(self) -> Floats:
        """Return the (N,) outcome rewards, each rounded once."""
        lengths = np.diff(self.offsets)
        if len(self.gain) == self.pairs:
            return np.repeat(divide(self.gain, self.gain_denominator), lengths)
        return divide(self.gain, self.gain_denominator, lengths)

    def expected_gain(self) -> Floats:
        """Return the (L,) expected rewards, each rounded once where the table is rational."""
        if len(self.gain) == self.pairs:
            return divide(self.gain, self.gain_denominator)
        if self.weight.dtype == np.float64 or self.gain.dtype == np.float64:
            product = self.probabilities() * self.gains()
            return np.asarray(np.add.reduceat(product, self.offsets[:-1]), dtype=np.float64)
        return divide(*self.expected_gain_exact())

    def expected_gain_exact(self) -> tuple[Numbers, Numbers]:
        """Return integers (L,), (L,): the exact expected reward of pair l is their ratio."""
        if len(self.gain) == self.pairs:
            return self.integer_gains()
        earning = np.asarray(self.gain != 0, dtype=bool)
        offsets = np.concatenate([[0], np.cumsum(earning)])[self.offsets]
        weight, below = self.weight[earning], self.denominator
        if weight.dtype == np.float64:
            weight, below = dyadic(weight, offsets)
        gain, gain_below = self.gain[earning], self.gain_denominator
        if gain.dtype == np.float64:
            gain, gain_below = dyadic(gain, offsets)
        lengths = np.diff(offsets)
        product = multiply(weight, gain, terms=int(lengths.max(initial=1)))
        total, filled = np.zeros(self.pairs, dtype=product.dtype), lengths > 0
        total[filled] = np.add.reduceat(product, offsets[:-1][filled])
        return total, multiply(below, gain_below)

    def integer_weights(self) -> tuple[Numbers, Numbers]:
        """Return (N,), (L,) integers: floats become integers over a power of two for each row."""
        if self.weight.dtype != np.float64:
            return self.weight, self.denominator
        return dyadic(self.weight, self.offsets)

    def integer_gains(self) -> tuple[Numbers, Numbers]:
        """Return the rewards as integers: (N,) or (L,), over (L,) denominators."""
        if self.gain.dtype != np.float64:
            return self.gain, self.gain_denominator
        each = np.arange(self.pairs + 1) if len(self.gain) == self.pairs else self.offsets
        return dyadic(self.gain, each)

    def weight_rounding(self) -> Floats:
        """Return (N,) how far each probability may lie from what it was rounded from.

        Half a unit in the last place of a given float; 0 for an exact number, and for 0.0.

        Examples
        --------
        >>> table = OutcomeTable(
        ...     offsets=np.array([0, 2]),
        ...     next=np.array([0, 1]),
        ...     weight=np.array([0.5, 0.5]),
        ...     denominator=ones(1),
        ...     gain=np.array([3]),
        ...     gain_denominator=ones(1),
        ... )
        >>> table.weight_rounding().tolist() == [2.0**-54] * 2, table.gain_rounding().tolist()
        (True, [0.0])
        """
        return _half_ulp(self.weight) if self.weight_doubt is None else self.weight_doubt

    def gain_rounding(self) -> Floats:
        """Return (N,) or (L,) the same of each reward."""
        return _half_ulp(self.gain) if self.gain_doubt is None else self.gain_doubt

    def row(self, pair: int) -> list[tuple[Fraction, int, Fraction]]:
        """Return the exact outcomes of one pair: probability, next state, reward.

        Numbers that were given as floats know that (`Given`), and so do rewards of a pair whose
        probabilities do not sum to 1: a model built of such rows is the same in all.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> mdp = MDP.from_arrays([np.full((10, 10), 0.1)], np.arange(10.0), discount=0.9)
        >>> rows = [(state, 0, mdp.table.row(state)) for state in range(10)]
        >>> sum(p for p, _, _ in rows[0][2]) - 1  # not 0: a float is taken as it is
        Fraction(1, 18014398509481984)
        >>> MDP.from_outcomes(rows, 0.9).table.row(0) == mdp.table.row(0)
        True
        """
        here = slice(int(self.offsets[pair]), int(self.offsets[pair + 1]))
        of_pair = len(self.gain) == self.pairs
        earned = slice(pair, pair + 1) if of_pair else here
        chances = _rationals(self.weight, self.denominator[pair], self.weight_doubt, here)
        gains = _rationals(self.gain, self.gain_denominator[pair], self.gain_doubt, earned)
        if of_pair:
            if gains[0] and sum(chances) != 1:
                gains = [Given(gains[0], rounding=rounding_of(gains[0]), certain=True)]
            gains *= len(chances)
        return list(zip(chances, self.next[here].tolist(), gains, strict=True))


def merged(table: OutcomeTable) -> tuple[Integers, Numbers, Numbers, Numbers]:
    """Return the exact (L, S) transition matrix in lowest terms, row by row.

    These are offsets (L+1,), next states and weights (M,), and denominators (L,): pair l leads to
    next[i] with probability weight[i] / denominator[l].
    """
    weight, denominator = table.integer_weights()
    first, offsets = distinct(table)
    following = table.next
    if len(first) < len(following):
        weight, following = np.asarray(np.add.reduceat(weight, first)), following[first]
    shared = np.gcd(np.gcd.reduceat(weight, offsets[:-1]), denominator)
    return offsets, following, weight // np.repeat(shared, np.diff(offsets)), denominator // shared


def distinct(table: OutcomeTable) -> tuple[Integers, Integers]:
    """Return where runs of outcomes to the same next state begin, and each pair's first run."""
    fresh = np.empty(len(table.next), dtype=bool)
    fresh[1:] = table.next[1:] != table.next[:-1]
    fresh[table.offsets[:-1]] = True
    first = np.flatnonzero(fresh)
    return first, np.searchsorted(first, table.offsets).astype(np.int64)


def reduced(top: Numbers, bottom: Numbers) -> tuple[Numbers, Numbers]:
    """Return the fractions top / bottom in lowest terms, elementwise."""
    shared = np.gcd(top, bottom)
    return np.asarray(top // shared), np.asarray(bottom // shared)


def by_outcome(table: OutcomeTable) -> OutcomeTable:
    """Return a table whose rewards belong to outcomes beyond doubt.

    With one outcome for each pair, rewards of outcomes look like rewards of pairs. That is the same
    unless a probability is only nearly 1; such outcomes are split into two exact halves. Other
    probabilities make no model, and stay as they are for the message that says so.
    """
    if len(table.next) != table.pairs or (table.weight == table.denominator).all():
        return table
    if (2 * table.weight < table.denominator).any() or (table.weight > 2 * table.denominator).any():
        return table
    floats = table.weight.dtype == np.float64
    below = table.denominator if floats else multiply(table.denominator, integers([2]))
    doubts = (table.weight_doubt, table.gain_doubt)
    return replace(
        table,
        offsets=2 * table.offsets,
        next=np.repeat(table.next, 2),
        weight=np.repeat(table.weight / 2 if floats else table.weight, 2),
        denominator=below,
        gain=np.repeat(table.gain, 2),
        weight_doubt=None if doubts[0] is None else np.repeat(doubts[0] / 2, 2),
        gain_doubt=None if doubts[1] is None else np.repeat(doubts[1], 2),
    )


def exact(number: object) -> Fraction:
    """Return the exact rational that a number, "p/q" or decimal string stands for.

    Examples
    --------
    >>> exact("0.1"), exact("1/3"), exact(0.5)
    (Fraction(1, 10), Fraction(1, 3), Fraction(1, 2))
    """
    if isinstance(number, Fraction):
        return number
    if isinstance(number, np.longdouble) and np.isfinite(number):
        return Fraction(*number.as_integer_ratio())  # wider than Python's floats
    if isinstance(number, np.generic):
        number = number.item()
    if isinstance(number, bool) or not isinstance(number, Rational | float | str | Decimal):
        raise ModelError(f"{number!r} is not a number", fix='write a number, or "p/q"')
    try:
        if isinstance(number, str | Decimal):
            _check_length(str(number))
        return Fraction(number)
    except ModelError:
        raise
    except (ValueError, OverflowError, ZeroDivisionError) as error:
        raise ModelError(
            f"{number!r} is not a finite rational number", fix='write 0.1 or "1/10"'
        ) from error


def _check_length(text: str) -> None:
    """Raise ModelError for a number whose digits, written out, are too many to work with."""
    if len(text) > MOST_DIGITS:
        raise ModelError(f"a number of over {MOST_DIGITS:,} characters", fix="round it")
    _, e, exponent = text.lower().partition("e")
    if e and abs(int(exponent)) > MOST_DIGITS:
        raise ModelError(f"{text!r} has an exponent beyond {MOST_DIGITS:,}", fix="scale the model")


def given(number: object) -> Fraction:
    """Return the exact value of a number, and of a float with its rounding: half an ulp of it.

    Examples
    --------
    >>> given("1/3"), given(0.5), given(0.5).rounding == 2.0**-54
    (Fraction(1, 3), Fraction(1, 2), True)
    """
    value = exact(number)
    if isinstance(number, float) and value != 0:
        return Given(value, rounding=ulp(number) / 2)
    if isinstance(number, np.floating) and value != 0:
        return Given(value, rounding=float(np.spacing(np.abs(number))) / 2)
    return value


def rounding_of(number: object) -> float:
    """Return how far a number, as it was given, may lie from what it was rounded from."""
    if isinstance(number, Given):
        return number.rounding
    return ulp(number) / 2 if isinstance(number, float) and number != 0 else 0.0


def shown(number: Fraction, digits: int = 6) -> str:
    """Return a rational in decimals for a message, however large it is.

    Examples
    --------
    >>> shown(Fraction(2, 3)), shown(Fraction(-(10**400))), shown(Fraction(1, 3 * 10**400))
    ('0.666667', '-1e400', '3.33333e-401')
    """
    if number == 0 or FLOAT_RANGE[0] < abs(number) < FLOAT_RANGE[1]:
        return f"{float(number):.{digits}g}"
    context = Context(prec=digits, Emax=MAX_EMAX, Emin=MIN_EMIN)
    quotient = context.divide(Decimal(number.numerator), Decimal(number.denominator))
    return f"{quotient.normalize(context):e}".replace("e+", "e")


def beside(number: Fraction, *limits: Fraction) -> str:
    """Return a rational in decimals that is on the same side of every limit as the number is."""
    text = shown(number)
    rounded = Fraction(text)
    for limit in limits:
        if (rounded > limit) - (rounded < limit) != (number > limit) - (number < limit):
            sign = "+" if number > limit else "-"
            return f"{shown(limit)} {sign} {shown(abs(number - limit))}"
    return text


def as_float(number: Fraction | float) -> float:
    """Return a number as a float; raises ModelError where it is too large for one."""
    try:
        return float(number)
    except OverflowError as error:
        raise _too_large() from error


def _too_large() -> ModelError:
    return ModelError("a rational too large for a float", fix="scale the rewards down")


def common(numbers: Sequence[Fraction]) -> tuple[list[int], int]:
    """Return integers over one common denominator."""
    bottom = lcm(*(number.denominator for number in numbers)) if numbers else 1
    return [number.numerator * (bottom // number.denominator) for number in numbers], bottom


def over_groups(values: Sequence[Fraction], offsets: Integers) -> tuple[Numbers, Numbers]:
    """Return rationals (N,) as integers over one denominator for each group of them."""
    found = [common(values[first:last]) for first, last in pairwise(offsets.tolist())]
    return integers(top for tops, _ in found for top in tops), integers(b for _, b in found)


def integers(values: Iterable[int]) -> Numbers:
    """Return an array of 64-bit integers where they fit, of Python integers where not."""
    listed = list(values)
    if not listed or (min(listed) > -EXACT_IN_INT64 and max(listed) < EXACT_IN_INT64):
        return np.array(listed, dtype=np.int64)
    array = np.empty(len(listed), dtype=object)
    array[:] = listed
    return array


def in_proportion(numbers: Sequence[Fraction]) -> list[int]:
    """Return whole numbers in proportion to rationals of at least 0, as small as they can be.

    Examples
    --------
    >>> in_proportion([Fraction(9, 10), Fraction(1, 10), Fraction(0)])
    [9, 1, 0]
    """
    shared = lcm(*(number.denominator for number in numbers))
    whole = [int(number * shared) for number in numbers]
    divisor = gcd(*whole) or 1
    return [number // divisor for number in whole]


@lru_cache(maxsize=16)
def ones(length: int) -> Numbers:
    """Return (length,) ones that take no memory: the denominators of integers and floats."""
    return np.broadcast_to(np.int64(1), (length,))


def magnitude(array: Numbers) -> int:
    """Return the largest absolute value as a Python integer."""
    return max(abs(int(array.max())), abs(int(array.min()))) if array.size else 0


def multiply(left: Numbers, right: Numbers, *, terms: int = 1) -> Numbers:
    """Return the exact product of integer arrays, wide enough to add up `terms` of them."""
    narrow = left.dtype != object and right.dtype != object
    if narrow and magnitude(left) * magnitude(right) * terms < EXACT_IN_INT64:
        return np.asarray(left * right)
    return np.asarray(left.astype(object) * right.astype(object))


def fine_unit(longest: int) -> float:
    """Return the unit in which to add up what multiples of `COARSE` leave of a row's floats.

    Sums of floats up to 1 are exact in integers: of multiples of 2^-40, and of what these leave, at
    most 2^-41 each, in a unit so small that the sum of so many stays below 2^62. Each of the terms
    is off by half that unit, and turning their sum into a float costs no more.

    Examples
    --------
    >>> fine_unit(1000) == 2.0**-93, 2**20 * 2.0**-41 / fine_unit(2**20) < 2**62
    (True, True)
    """
    return float(2.0 ** max(FINEST, longest.bit_length() - 103))


def divide(top: Numbers, bottom: Numbers, counts: Integers | None = None) -> Floats:
    """Return top / bottom as floats, each correctly rounded once.

    With `counts` each denominator is that of this many numbers, one group after the other.
    """
    if top.dtype == np.float64:
        return np.asarray(top, dtype=np.float64)
    if counts is not None:
        bottom = np.repeat(bottom, counts)
    small = top.dtype != object and bottom.dtype != object
    if small and max(magnitude(top), magnitude(bottom)) <= EXACT_IN_FLOAT:
        return np.asarray(top.astype(np.float64) / bottom, dtype=np.float64)
    try:
        quotients = [int(a) / int(b) for a, b in zip(top.flat, bottom.flat, strict=True)]
    except OverflowError as error:
        raise _too_large() from error
    return np.array(quotients, dtype=np.float64).reshape(top.shape)


def float_array(values: ArrayLike) -> Floats:
    """Return a float array, or raise ModelError where the values are not numbers."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ModelError("an array holds something that is not a number") from error


def _rationals(top: Numbers, bottom: Any, doubt: Floats | None, here: slice) -> list[Fraction]:
    """Return the numbers of a row, those that are floats as `Given` ones."""
    if doubt is None and top.dtype == np.float64:
        return [given(value) for value in top[here].tolist()]
    below = int(bottom)
    found = [exact(value) / below for value in top[here].tolist()]
    if doubt is None:
        return found
    known = zip(found, doubt[here].tolist(), strict=True)
    return [Given(value, rounding=off) if off else value for value, off in known]


def _half_ulp(values: Numbers) -> Floats:
    """Return half a unit in the last place of floats, 0 of exact numbers and of 0.0."""
    if values.dtype != np.float64:
        return np.zeros(len(values))
    # A number without the digits after its first is the power of two that its unit goes by.
    found: Floats = (values.view(np.int64) & EXPONENT).view(np.float64)
    found *= 2.0**-53
    return found


def dyadic(values: Numbers, offsets: Integers) -> tuple[Numbers, Numbers]:
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


def spans(first: Numbers, last: Numbers) -> Integers:
    """Return the numbers first[0] … last[0]-1, first[1] … last[1]-1, and so on, in one array.

    Examples
    --------
    >>> spans(np.array([3, 8]), np.array([5, 9])).tolist()
    [3, 4, 8]
    """
    lengths = last - first
    ends = np.cumsum(lengths, dtype=np.int64)
    total = int(ends[-1]) if len(ends) else 0
    steps: Integers = np.arange(total) + np.repeat(first - (ends - lengths), lengths)
    return steps
