"""Exact outcomes of each state-action pair: integers over a denominator.

Outcome i of pair l, one of offsets[l] … offsets[l+1]-1, has probability weight[i] / denominator[l],
leads to state next[i] and earns gain[i] / gain_denominator[l]. Weights are 64-bit integers if they
fit, else Python integers (dtype object); or floats, each the nearest one to the exact probability
for which it stands (`mdp.forms.rows`). Every row of a model sums to 1 exactly. Float rewards are
taken as the dyadic rationals that they are. The float model is derived from this table, every
number rounded once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from decimal import MAX_EMAX, MIN_EMIN, Context, Decimal
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import pairwise
from math import gcd, lcm
from numbers import Rational
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.forms.rows import FLOAT_ROW_TOLERANCE as FLOAT_ROW_TOLERANCE
from exact_mdp.mdp.forms.rows import (
    LONG,
    fine_unit,
    normalize_rows_in_numpy,
    rationalize_row,
    rows_to_integers,
)
from exact_mdp.mdp.forms.rows import Floats as Floats
from exact_mdp.mdp.forms.rows import Integers as Integers
from exact_mdp.mdp.forms.rows import Numbers as Numbers
from exact_mdp.mdp.forms.rows import to_dyadic_integers as to_dyadic_integers
from exact_mdp.mdp.forms.threads import block_ends, run_blocks

# From this number of transitions on, loops are compiled. Loading the compiler takes a third of a
# second, and NumPy is faster than that on smaller models: measured.
COMPILED = 20_000
# Every whole number up to this one is a float; programs that read numbers as floats round others.
EXACT_IN_FLOAT = 2**53
EXACT_IN_INT64 = 2**62  # the sum of two whole numbers below this one fits in 64 bits
FLOAT_RANGE = (Fraction(1, 10**300), Fraction(10**300))  # floats in it keep all their digits
LARGEST = Fraction(2**1024 - 2**971)  # the largest float
# Memory of one table, in bytes. A larger one is refused with a message before it is built, rather
# than left to fill the memory; on a large machine this also refuses some tables that would fit.
MOST_BYTES = 10 * 10**9
BLOCK = 2**22  # numbers of an intermediate array in memory at once: 32 MB
MOST_NUMBERS = 10**8  # numbers of one matrix, which take about a gigabyte
MOST_DIGITS = 4000  # digits of a number given as text: Python itself stops at 4,300


class ByFields:
    """A dataclass that is copied and pickled by its fields only; arrays stay read-only."""

    def __getstate__(self) -> dict[str, Any]:
        parts: Any = self
        return {part.name: getattr(self, part.name) for part in fields(parts)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows(ByFields):
    """The exact distribution of the next state for each of L pairs, with N outcomes in all.

    Rows of floats are normalized once, when this object is made: they become the floats nearest to
    the exact distributions for which they stand (`mdp.forms.rows`).

    Attributes
    ----------
    offsets : (L+1,) int64
        Outcomes of pair l are offsets[l] … offsets[l+1]-1, sorted by next state.
    next : (N,) int32 or int64
    weight, denominator : (N,), (L,)
    sound : bool
        Whether all rows are known to be normalized distributions of positive floats.
    """

    offsets: Integers
    next: Numbers
    weight: Numbers
    denominator: Numbers
    sound: bool = False

    def __post_init__(self) -> None:
        if self.weight.dtype == np.float64 and not self.sound:
            weight = self.weight.copy()
            sound = normalize_rows(weight, self.offsets)
            object.__setattr__(self, "sound", sound)
            if not np.array_equal(weight, self.weight):
                object.__setattr__(self, "weight", weight)

    @cached_property
    def pairs(self) -> int:
        """Number of pairs, L."""
        return len(self.offsets) - 1

    @cached_property
    def rising(self) -> bool:
        """True if the next states of every pair rise strictly: sorted, and none of them twice."""
        offsets = self.offsets
        if len(self.next) < 2**31 and self.next.dtype == np.int32:
            offsets = offsets.astype(np.int32)
        # SciPy tests this property of a matrix; the data of the matrix play no role.
        shape = (self.pairs, int(self.next.max(initial=0)) + 1)
        return bool(sp.csr_array((self.next, self.next, offsets), shape).has_canonical_format)

    @cached_property
    def integers(self) -> tuple[Numbers, Numbers]:
        """The exact rows as integers: (N,) weights over (L,) denominators."""
        if self.weight.dtype != np.float64:
            return self.weight, self.denominator
        weight, denominator = rows_to_integers(self.weight, self.offsets)
        lock_arrays(weight, denominator)
        return weight, denominator

    @cached_property
    def merged(self) -> tuple[Integers, Numbers, Numbers, Numbers]:
        """The exact (L, S) transition matrix in lowest terms, row by row.

        These are offsets (L+1,), next states and weights (M,), and denominators (L,).
        """
        weight, denominator = self.integers
        # Add up the weights of outcomes with the same next state.
        first, offsets = self.find_runs()
        following = self.next
        if len(first) < len(following):
            weight, following = np.asarray(np.add.reduceat(weight, first)), following[first]
        # Cancel the greatest common divisor of each row and its denominator.
        shared = np.gcd(np.gcd.reduceat(weight, offsets[:-1]), denominator)
        weight, denominator = weight // np.repeat(shared, np.diff(offsets)), denominator // shared
        lock_arrays(offsets, weight, denominator)
        return offsets, following, weight, denominator

    def find_runs(self) -> tuple[Integers, Integers]:
        """Return the first outcome of each run with one next state, and each pair's first run."""
        fresh = np.empty(len(self.next), dtype=bool)
        fresh[1:] = self.next[1:] != self.next[:-1]
        fresh[self.offsets[:-1]] = True
        first = np.flatnonzero(fresh)
        return first, np.searchsorted(first, self.offsets).astype(np.int64)

    def build_matrix(self, states: int) -> sp.csr_array:
        """Return the (L, S) transition matrix, each probability rounded once."""
        # Outcomes with the same next state become one entry, the sum of their weights.
        data, indices, indptr = self.weight, self.next, self.offsets
        if not self.rising:
            first, indptr = self.find_runs()
            data, indices = np.asarray(np.add.reduceat(data, first)), indices[first]
        data = divide(data, self.denominator, np.diff(indptr))
        # SciPy wants both index arrays in one type; 32 bits are enough for all but huge matrices.
        if len(data) < 2**31 - 1:
            indptr = indptr.astype(indices.dtype)
        matrix = sp.csr_array((data, indices, indptr), shape=(self.pairs, states), copy=False)
        matrix.has_canonical_format = True
        return matrix


@dataclass(frozen=True, kw_only=True, eq=False)
class OutcomeTable(ByFields):
    """The joint distribution of next state and reward for each of L pairs, with N outcomes in all.

    Attributes
    ----------
    rows : Rows
        The distributions of the next states.
    gain, gain_denominator : (N,), or (L,) if all outcomes of a pair earn the same; (L,)
    event : (N,) uint8, optional
        Bit b is set on outcomes in which the model's event number b happens.
    components, component_denominator : (N, C), or (L, C) if all outcomes have the same; (L,)
        The reward by component, optional; without them the reward is the only component.
    averaged : bool
        Whether components (L, C) are means of amounts that differ between outcomes; in a table
        without components, whether its reward is such a mean. Expectations are then exact, but
        results that need single outcomes, such as variances and quantiles, are unknown.
    """

    rows: Rows
    gain: Numbers
    gain_denominator: Numbers
    event: NDArray[np.uint8] | None = None
    components: Any = None
    component_denominator: Any = None
    averaged: bool = False

    @cached_property
    def pairs(self) -> int:
        """Number of pairs, L."""
        return self.rows.pairs

    @cached_property
    def offsets(self) -> Integers:
        """(L+1,) the outcomes of pair l are offsets[l] … offsets[l+1]-1."""
        return self.rows.offsets

    @cached_property
    def next(self) -> Numbers:
        """(N,) the next state of each outcome."""
        return self.rows.next

    @cached_property
    def weight(self) -> Numbers:
        """(N,) the numerator of the probability of each outcome."""
        return self.rows.weight

    @cached_property
    def denominator(self) -> Numbers:
        """(L,) the denominator of the probabilities of each pair."""
        return self.rows.denominator

    @property
    def pair(self) -> Integers:
        """(N,) the pair of each outcome."""
        return np.repeat(np.arange(self.pairs), np.diff(self.offsets))

    @cached_property
    def joint(self) -> bool:
        """True if rewards are stored by outcome, not by pair."""
        return len(self.gain) == len(self.next) and self.pairs != len(self.next)

    def of_pairs(self, pairs: Integers) -> OutcomeTable:
        """Return the table of the given pairs (K,), in their order."""
        chosen = concatenate_ranges(self.offsets[pairs], self.offsets[pairs + 1])
        return self.map_numbers(
            lambda _, values: values[pairs],
            lambda _, values: values[chosen],
            offsets=np.concatenate([[0], np.cumsum(np.diff(self.offsets)[pairs])]),
            next_states=self.next[chosen],
        )

    def any_outcome(self, name: str) -> NDArray[np.bool_]:
        """Return (L,) True where the array `name` is not 0 for some outcome of the pair."""
        some = np.asarray(getattr(self, name) != 0, dtype=bool)
        if some.ndim == 2:
            some = np.asarray(some.any(axis=1))
        if len(some) == self.pairs:
            return some
        return np.logical_or.reduceat(some, self.offsets[:-1])

    def map_numbers(
        self,
        of_pair: Callable[[str, Numbers], Numbers],
        of_outcome: Callable[[str, Numbers], Any],
        *,
        offsets: Integers,
        next_states: Numbers,
    ) -> OutcomeTable:
        """Apply `of_pair` to each array by pair and `of_outcome` to each array by outcome.

        Both take the name of the array and the array. Rows have to remain distributions; `offsets`
        and `next_states` belong to the new table.
        """
        rows = replace(
            self.rows,
            offsets=offsets,
            next=next_states,
            weight=of_outcome("weight", self.weight),
            denominator=of_pair("denominator", self.denominator),
        )
        functions = {
            "gain": of_outcome,
            "gain_denominator": of_pair,
            "event": of_outcome,
            "components": of_pair,
            "component_denominator": of_pair,
        }
        # Rewards and components are stored in either way.
        if len(self.gain) == self.pairs:
            functions["gain"] = of_pair
        if self.parted_by_outcome:
            functions["components"] = of_outcome
        changed: dict[str, Any] = {}
        for name, function in functions.items():
            array = getattr(self, name)
            if array is not None:
                changed[name] = function(name, array)
        return replace(self, rows=rows, **changed)

    def with_reward(self, gain: Numbers, below: Numbers) -> OutcomeTable:
        """Return the same transitions with another reward, without components."""
        parts: dict[str, Any] = {"components": None, "component_denominator": None}
        return replace(self, gain=gain, gain_denominator=below, averaged=False, **parts)

    def with_component_reward(self, number: int) -> OutcomeTable:
        """Return the same transitions with one component as the reward."""
        if self.components is None:
            return self
        gain = np.ascontiguousarray(self.components[:, number])
        return replace(self.with_reward(gain, self.component_denominator), averaged=self.averaged)

    @cached_property
    def parted_by_outcome(self) -> bool:
        """Whether components are stored by outcome (N, C), not by pair (L, C)."""
        parts = self.components
        return parts is not None and len(parts) == len(self.next) and len(parts) != self.pairs

    def negate_rewards(self) -> OutcomeTable:
        """Return the table with all rewards and components times -1."""
        parts: dict[str, Any] = {"gain": self.gain, "components": self.components}
        for name, array in parts.items():
            if array is None:
                continue
            # -2^63 is the one 64-bit integer without a negative.
            if array.dtype == np.int64 and array.min(initial=0) == np.iinfo(np.int64).min:
                array = array.astype(object)
            parts[name] = -array
        return replace(self, **parts)

    def compute_probabilities(self) -> Floats:
        """Return the (N,) outcome probabilities, each rounded once."""
        return divide(self.weight, self.denominator, np.diff(self.offsets))

    def compute_gains(self) -> Floats:
        """Return the (N,) outcome rewards, each rounded once."""
        gains = self.shared_gains()
        if len(self.gain) == self.pairs:
            return np.repeat(gains, np.diff(self.offsets))
        return gains

    def shared_gains(self) -> Floats:
        """Return the rewards as floats: (L,) if they are stored by pair, else (N,)."""
        if len(self.gain) == self.pairs:
            return divide(self.gain, self.gain_denominator)
        return divide(self.gain, self.gain_denominator, np.diff(self.offsets))

    def expected_gain(self) -> Floats:
        """Return the (L,) expected rewards, each rounded once if all numbers are integers."""
        if len(self.gain) == self.pairs:
            return self.shared_gains()
        if self.weight.dtype == np.float64 or self.gain.dtype == np.float64:
            product = self.compute_probabilities() * self.compute_gains()
            return np.asarray(np.add.reduceat(product, self.offsets[:-1]), dtype=np.float64)
        return divide(*self.expected_gain_exact)

    @cached_property
    def expected_gain_exact(self) -> tuple[Numbers, Numbers]:
        """Integers (L,), (L,) whose ratios are the exact expected rewards."""
        if len(self.gain) == self.pairs:
            return self.integer_gains
        # Outcomes without a reward add nothing; in many models most are of this kind.
        earning = np.asarray(self.gain != 0, dtype=bool)
        offsets = np.concatenate([[0], np.cumsum(earning)])[self.offsets]
        weight, below = self.rows.integers
        gain, gain_below = self.gain[earning], self.gain_denominator
        if gain.dtype == np.float64:
            gain, gain_below = to_dyadic_integers(gain, offsets)
        total = row_sums(multiply(weight[earning], gain), offsets)
        return total, multiply(below, gain_below)

    def expected_components(self) -> Floats:
        """Return the (L, C) expected reward by component, each number rounded once.

        Float amounts by outcome are rounded as in `expected_gain`.
        """
        return np.stack([each.expected_gain() for each in self._each_component()], axis=1)

    def expected_components_exact(self) -> tuple[Numbers, Numbers]:
        """Return the expected reward by component as integers (L, C) over integers (L,)."""
        # Without components, the reward is the only one.
        if self.components is None:
            gain, below = self.expected_gain_exact
            return gain[:, None], below
        if self.parted_by_outcome:
            # Take the expectation of each component, then bring all to one denominator per pair.
            return self.over_one_denominator(
                [part.expected_gain_exact for part in self._each_component()]
            )
        if self.components.dtype != np.float64:
            return self.components, self.component_denominator
        # Floats are dyadic rationals: their common denominator is a power of 2.
        pairs, parts = self.components.shape
        top, below = to_dyadic_integers(self.components.reshape(-1), np.arange(pairs + 1) * parts)
        return top.reshape(pairs, parts), below

    def over_one_denominator(
        self, columns: Sequence[tuple[Numbers, Numbers]]
    ) -> tuple[Numbers, Numbers]:
        """Return columns of integers (L,) or (N,) over (L,) over one denominator of each pair."""
        common = np.lcm.reduce([below.astype(object) for _, below in columns])
        whole = []
        for top, below in columns:
            factor = common // below
            if len(top) != self.pairs:
                factor = factor[self.pair]
            whole.append(top.astype(object) * factor)
        amounts = to_integer_array(np.stack(whole, axis=1).reshape(-1).tolist())
        return amounts.reshape(-1, len(columns)), to_integer_array(common.tolist())

    def _each_component(self) -> list[OutcomeTable]:
        """Return one table for each component, with that component as the reward."""
        if self.components is None:
            return [self]
        return [self.with_component_reward(number) for number in range(self.components.shape[1])]

    @cached_property
    def integer_gains(self) -> tuple[Numbers, Numbers]:
        """The rewards as integers: (N,) or (L,), over (L,) denominators."""
        if self.gain.dtype != np.float64:
            return self.gain, self.gain_denominator
        offsets = self.offsets
        if len(self.gain) == self.pairs:
            offsets = np.arange(self.pairs + 1)
        return to_dyadic_integers(self.gain, offsets)

    def row(self, pair: int) -> list[tuple[Fraction, int, Fraction]]:
        """Return the exact outcomes of one pair: probability, next state, reward.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> mdp = MDP.from_arrays([[[0.3, 0.7], [0.0, 1.0]]], [2, 0])
        >>> mdp.table.row(0)
        [(Fraction(3, 10), 0, Fraction(2, 1)), (Fraction(7, 10), 1, Fraction(2, 1))]
        """
        here = slice(int(self.offsets[pair]), int(self.offsets[pair + 1]))
        weight, below = self.weight[here].tolist(), int(self.denominator[pair])
        # Probabilities: floats stand for rational numbers, integers are numerators.
        if self.weight.dtype == np.float64:
            chances = [exact(number) for number in rationalize_row(weight)]
        else:
            chances = [Fraction(top, below) for top in weight]
        # Rewards: one for each outcome, or one for the pair.
        gains = self.gain[here]
        if len(self.gain) == self.pairs:
            gains = np.repeat(self.gain[pair : pair + 1], len(chances))
        under = int(self.gain_denominator[pair])
        rewards = [exact(top) / under for top in gains.tolist()]
        return list(zip(chances, self.next[here].tolist(), rewards, strict=True))


def row_sums(values: Numbers, offsets: Integers) -> Numbers:
    """Return the exact sums (L,) of integers over the rows given by `offsets` (0 if empty)."""
    lengths = np.diff(offsets)
    if find_magnitude(values) * int(lengths.max(initial=0)) >= EXACT_IN_INT64:
        values = values.astype(object)
    sums = np.zeros(len(lengths), dtype=values.dtype)
    filled = lengths > 0
    if filled.any():
        sums[filled] = np.add.reduceat(values, offsets[:-1][filled])
    return sums


def normalize_rows(weight: Floats, offsets: Integers) -> bool:
    """Normalize float rows in place; return whether all are distributions of positive numbers."""
    # Arrays that do not fit together are left alone: validation refuses them with a message.
    fits = len(offsets) > 1 and offsets[0] == 0 and offsets[-1] == len(weight) == weight.size
    if not (fits and np.diff(offsets).min() > 0):
        return False
    longest = int(np.diff(offsets).max())
    if len(weight) < COMPILED or longest >= LONG:
        with np.errstate(all="ignore"):
            return normalize_rows_in_numpy(weight, offsets)
    from exact_mdp.mdp.forms import loops

    return all_rows(
        loops.normalize_block, offsets, weight, weight.view(np.int64), fine_unit(longest)
    )


def all_rows(look: Callable[..., bool], offsets: Integers, *given: Any) -> bool:
    """Return whether a compiled check of rows first … last-1 is True for all blocks of rows."""
    ends = block_ends(offsets)
    sound = [False] * (len(ends) - 1)

    def check_block(number: int, first: int, last: int) -> None:
        sound[number] = look(first, last, offsets, *given)

    run_blocks(ends, check_block)
    return all(sound)


def lock_arrays(*arrays: Numbers) -> None:
    """Make arrays read-only."""
    for array in arrays:
        array.setflags(write=False)


def reduce_fractions(top: Numbers, bottom: Numbers) -> tuple[Numbers, Numbers]:
    """Return the fractions top / bottom in lowest terms, elementwise."""
    shared = np.gcd(top, bottom)
    return np.asarray(top // shared), np.asarray(bottom // shared)


@lru_cache(4096)
def whole_fraction(number: int) -> Fraction:
    """Return an integer as a Fraction, one object for each: most rewards are few integers."""
    return Fraction(number)


def exact(number: object, where: str = "") -> Fraction:
    """Return a number, "p/q" or decimal as a Fraction; raise ModelError for anything else."""
    # The exact type is compared first: isinstance is slow for abstract classes.
    if type(number) is int:
        return whole_fraction(number)
    if type(number) is Fraction or isinstance(number, Fraction):
        return number
    number = to_python_number(number)
    if isinstance(number, bool) or not isinstance(number, Rational | float | str | Decimal):
        raise ModelError(f"{number!r} is not a number", where=where, fix='write a number, or "p/q"')
    try:
        if isinstance(number, str | Decimal):
            _check_length(str(number), where)
        return Fraction(number)
    except ModelError:
        raise
    except (ValueError, OverflowError, ZeroDivisionError) as error:
        what = f"{number!r} is not a finite rational number"
        raise ModelError(what, where=where, fix='write 0.1 or "1/10"') from error


def to_python_number(number: Any) -> Any:
    """Return a NumPy number as a Python number of the same value; anything else as it is."""
    if isinstance(number, np.longdouble) and np.isfinite(number):
        return Fraction(*number.as_integer_ratio())  # wider than Python's floats
    if isinstance(number, np.generic):
        return number.item()
    return number


def _check_length(text: str, where: str) -> None:
    """Raise ModelError for a number with too many digits, or too large an exponent."""
    if len(text) > MOST_DIGITS:
        what = f"a number of over {MOST_DIGITS:,} characters"
        raise ModelError(what, where=where, fix="round it")
    _, e, exponent = text.lower().partition("e")
    if e and abs(int(exponent)) > MOST_DIGITS:
        what = f"{text!r} has an exponent beyond {MOST_DIGITS:,}"
        raise ModelError(what, where=where, fix="scale the model")


def format_rational(number: Fraction, digits: int = 6) -> str:
    """Return a rational as a decimal for a message, however large it is."""
    if number == 0 or FLOAT_RANGE[0] < abs(number) < FLOAT_RANGE[1]:
        return f"{float(number):.{digits}g}"
    context = Context(prec=digits, Emax=MAX_EMAX, Emin=MIN_EMIN)
    quotient = context.divide(Decimal(number.numerator), Decimal(number.denominator))
    return f"{quotient.normalize(context):e}".replace("e+", "e")


def format_beside_limits(number: Fraction, *limits: Fraction) -> str:
    """Return a rational as a decimal that is on the same side of each limit as the number."""
    text = format_rational(number)
    rounded = Fraction(text)
    for limit in limits:
        # Rounding may have moved the number to the limit or across: show the distance instead.
        if number > limit and not rounded > limit:
            return f"{format_rational(limit)} + {format_rational(number - limit)}"
        if number < limit and not rounded < limit:
            return f"{format_rational(limit)} - {format_rational(limit - number)}"
    return text


def float_of(number: object, where: str) -> float:
    """Return the nearest float to a number that `exact` accepts; raises ModelError as it does."""
    return as_float(exact(number, where), where)


def as_float(number: Fraction | float, where: str = "") -> float:
    """Return a number as a float; raise ModelError if it is too large."""
    try:
        return float(number)
    except OverflowError as error:
        raise _overflow_error(where) from error


def _overflow_error(where: str = "") -> ModelError:
    return ModelError("a number is too large for a float", where=where, fix="choose smaller units")


def to_common_denominator(numbers: Sequence[Fraction]) -> tuple[list[int], int]:
    """Return the numbers as integers over one common denominator."""
    bottom = lcm(*[number.denominator for number in numbers])  # 1 if there are none
    return [number.numerator * (bottom // number.denominator) for number in numbers], bottom


def over_groups(values: Sequence[Fraction], offsets: Integers) -> tuple[Numbers, Numbers]:
    """Return rationals (N,) as integers (N,), with one common denominator for each group."""
    if all(number.denominator == 1 for number in values):
        return to_integer_array(number.numerator for number in values), make_ones(len(offsets) - 1)
    tops: list[int] = []
    bottoms: list[int] = []
    for first, last in pairwise(offsets.tolist()):
        whole, bottom = to_common_denominator(values[first:last])
        tops += whole
        bottoms.append(bottom)
    return to_integer_array(tops), to_integer_array(bottoms)


def find_distinct(values: Sequence[Any]) -> tuple[list[Any], Integers]:
    """Return the different objects among values (N,), and the place (N,) of each value's object.

    Objects are told apart by where they are in memory, without comparing them.
    """
    distinct = dict(zip(map(id, values), values, strict=True))
    number = {place: count for count, place in enumerate(distinct)}
    copies = np.fromiter((number[id(value)] for value in values), np.int64, len(values))
    return list(distinct.values()), copies


def find_nonzero(values: Numbers) -> NDArray[np.bool_]:
    """Return (N,) True for numbers that are not 0."""
    if values.dtype != object:
        return np.asarray(values != 0, dtype=bool)
    distinct, copies = find_distinct(values.tolist())
    return np.array([bool(number) for number in distinct], dtype=bool)[copies]


def hold_same_numbers(left: Numbers, right: Numbers) -> bool:
    """Return whether two arrays of one shape hold equal numbers."""
    if object in (left.dtype, right.dtype):
        return bool(left.tolist() == right.tolist())  # lists compare no object with itself
    return bool((left == right).all())


def to_integer_array(values: Iterable[int]) -> Numbers:
    """Return an array of 64-bit integers if they all fit, else of Python integers."""
    listed = list(values)
    if not listed or (min(listed) > -EXACT_IN_INT64 and max(listed) < EXACT_IN_INT64):
        return np.array(listed, dtype=np.int64)
    return np.array(listed, dtype=object)


def in_proportion(numbers: Sequence[Fraction]) -> list[int]:
    """Return the smallest whole numbers in proportion to nonnegative rationals."""
    whole, _ = to_common_denominator(numbers)
    divisor = gcd(*whole) or 1
    return [number // divisor for number in whole]


@lru_cache(maxsize=16)
def make_ones(length: int) -> Numbers:
    """Return (length,) ones that take no memory, as denominators of integers and floats."""
    return np.broadcast_to(np.int64(1), (length,))


def find_magnitude(array: Numbers) -> int:
    """Return the largest absolute value as a Python integer; 0 for an empty array."""
    if not array.size:
        return 0
    return max(abs(int(array.max())), abs(int(array.min())))


def multiply(left: Numbers, right: Numbers, *, terms: int = 1) -> Numbers:
    """Return the exact products of integer arrays, wide enough for a sum of `terms` of them."""
    narrow = left.dtype != object and right.dtype != object
    if narrow and find_magnitude(left) * find_magnitude(right) * terms < EXACT_IN_INT64:
        return np.asarray(left * right)
    return np.asarray(left.astype(object) * right.astype(object))


def divide(top: Numbers, bottom: Numbers, counts: Integers | None = None) -> Floats:
    """Return top / bottom as floats, rounded once; bottom l serves `counts[l]` numbers."""
    # Floats are their own numerators: they come with denominators of 1.
    if top.dtype == np.float64:
        return np.asarray(top, dtype=np.float64)
    if counts is not None:
        bottom = np.repeat(bottom, counts)
    # If both are floats exactly, IEEE division rounds once; else Python's integers do.
    small = top.dtype != object and bottom.dtype != object
    if small and max(find_magnitude(top), find_magnitude(bottom)) <= EXACT_IN_FLOAT:
        return np.asarray(top.astype(np.float64) / bottom, dtype=np.float64)
    try:
        quotients = [int(a) / int(b) for a, b in zip(top.flat, bottom.flat, strict=True)]
    except OverflowError as error:
        raise _overflow_error() from error
    return np.array(quotients, dtype=np.float64).reshape(top.shape)


def estimate_outcome_bytes(*, wide: bool) -> int:
    """Return the memory of one outcome in bytes, with 64-bit or with Python integers: measured."""
    if wide:
        return 230
    return 45


def concatenate_ranges(first: Numbers, last: Numbers) -> Integers:
    """Return the numbers first[0] … last[0]-1, first[1] … last[1]-1, and so on, in one array."""
    # In its range, a number is its place in the result plus a shift that the range shares.
    lengths = last - first
    ends = np.cumsum(lengths, dtype=np.int64)
    total = int(lengths.sum())
    steps: Integers = np.arange(total) + np.repeat(first - (ends - lengths), lengths)
    return steps
