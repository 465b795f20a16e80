"""Claims: a number and how far it can be trusted.

A number leaves the toolkit as one of four types, so that a table or a plot cannot confuse them:
`Certified` (an exact rational with a proof), `Bounded` (a float and a sound bound on its error),
`Checked` (it depends on the degree of polynomials, which was checked at points but not proven; see
sensitivity) and `Estimated` (a sample mean and its standard error). A solver that reaches no such
number raises a `SolverError`, whose `Status` says why and what helps.

Numbers compare with plain numbers and with each other. With ends [a, b] and [c, d], x ≤ y holds if
b ≤ c, does not hold if a > d, and is open otherwise, which raises an error.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, replace
from decimal import Decimal
from enum import StrEnum
from fractions import Fraction
from math import inf, isinf, nan
from numbers import Real
from typing import Any, ClassVar, TypeVar

import numpy as np

from exact_mdp.mdp.errors import ModelError, warn_user
from exact_mdp.mdp.sense import Sense
from exact_mdp.mdp.table import Floats, exact

LowHigh = tuple[Fraction | float, Fraction | float]

NORMAL = 1.959963984540054  # the 97.5 % quantile of the standard normal distribution


class Claim(StrEnum):
    """How far a number can be trusted."""

    CERTIFIED = "certified"
    BOUNDED = "bounded"
    CHECKED = "checked"
    ESTIMATED = "estimated"


class Status(StrEnum):
    """How a solver ended: a message, with a suggested fix on failure."""

    CONVERGED = "the error bound meets the tolerance"
    DIRECT = "solved directly; the error bound is what rounding may have left"
    PRECISION = (
        "double precision reaches its limit above the tolerance; "
        "allow a larger tol, or use certify(), which computes in rational arithmetic"
    )
    ITERATION_LIMIT = (
        "the iteration limit was reached first; "
        "raise max_iterations, or use PolicyIteration, which does not depend on mixing, "
        "or certify(), which computes in rational arithmetic"
    )
    NO_BOUND = (
        "double precision cannot bound the error of this model; "
        "use certify(), which computes in rational arithmetic"
    )
    TOO_LARGE = (
        "number the states so that most transitions are to near numbers, or lower the discount"
    )
    PROGRAM_FAILED = (
        "the optimiser did not reach an optimum of the linear program; "
        "try another one, or PolicyIteration"
    )
    # With sets of rows, which certify() does not know:
    SETS_PRECISION = (
        "double precision reaches its limit above the tolerance; "
        "allow a larger tol in solve_robust(), or keep to the bounds, which hold"
    )
    SETS_ITERATION_LIMIT = (
        "the iteration limit was reached first; "
        "raise max_iterations in solve_robust(), or allow a larger tol"
    )
    SETS_NO_BOUND = (
        "double precision cannot bound the error with these sets of rows; "
        "scale the rewards if they are large, else choose smaller sets, or a lower discount"
    )

    @property
    def with_sets(self) -> Status:
        """The status that says what helps with sets of rows."""
        return Status.__members__.get(f"SETS_{self.name}", self)


class PrecisionWarning(UserWarning):
    """The tolerance is beyond double precision; the error bound says how near the result came."""


def warn_of_precision(error: float, *, status: Status = Status.PRECISION) -> None:
    """Issue a PrecisionWarning."""
    warn_user(f"the error bound is {error:.2g}: {status}", PrecisionWarning)


class SolverError(RuntimeError):
    """A solver failed to reach its goal.

    Attributes
    ----------
    status : Status
    solution : Solution or None
        The best solution so far, with its error bound, if there is one.

    Examples
    --------
    >>> print(SolverError(Status.PROGRAM_FAILED, "CLARABEL says infeasible"))
    CLARABEL says infeasible: the optimiser did not reach an optimum of the linear program; ...
    """

    def __init__(self, status: Status, detail: str = "", solution: Any = None) -> None:
        self.status, self.detail, self.solution = status, detail, solution
        message = str(status)
        if detail:
            message = f"{detail}: {status}"
        super().__init__(message)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.status, self.detail, self.solution)


class Ordered(ABC):
    """A quantity between two ends, which compares with numbers.

    A comparison holds, or does not hold, wherever between the ends the quantity is; if that differs
    it raises a `ModelError`.
    """

    @property
    @abstractmethod
    def advice(self) -> str:
        """The fix if a comparison is open."""

    @property
    @abstractmethod
    def bounds(self) -> LowHigh:
        """The two ends between which the quantity lies; they are equal if it is exact."""

    def __le__(self, other: object) -> bool:
        if not isinstance(other, Ordered | Real):
            return NotImplemented
        return _decide_at_most(self, other)

    def __lt__(self, other: object) -> bool:
        if not isinstance(other, Ordered | Real):
            return NotImplemented
        return not _decide_at_most(other, self)

    def __ge__(self, other: object) -> bool:
        if not isinstance(other, Ordered | Real):
            return NotImplemented
        return _decide_at_most(other, self)

    def __gt__(self, other: object) -> bool:
        if not isinstance(other, Ordered | Real):
            return NotImplemented
        return not _decide_at_most(self, other)


def _decide_at_most(one: Ordered | Real, other: Ordered | Real) -> bool:
    """Return whether one number is at most the other; raise ModelError if that is open."""
    decision = is_at_most(_find_bounds(one), _find_bounds(other))
    if decision is not None:
        return decision
    unsure, against = one, other
    if not isinstance(unsure, Ordered) or is_at_most(unsure.bounds, unsure.bounds):
        unsure, against = other, one
    assert isinstance(unsure, Ordered)
    low, high = unsure.bounds
    raise ModelError(
        f"{unsure} is known to lie from {low} to {high}, which does not decide how it compares "
        f"with {against}",
        where="comparison of two numbers",
        fix=unsure.advice,
    )


def _find_bounds(number: Ordered | Real) -> LowHigh:
    """Return the ends between which a number lies; both are the number if it is a plain one."""
    if isinstance(number, Ordered):
        return number.bounds
    if number in (inf, -inf):
        return float(number), float(number)
    plain = exact(number, "comparison of two numbers")
    return plain, plain


class ClaimedNumber(Ordered):
    """A number with a claim: it compares, converts, rounds and formats as a plain number does.

    `f"{number:.3f}"` and `round` are of `float(number)`; without a format, the text says the claim.
    `==` never raises: a certified number equals plain numbers of its value; any other equals those
    of its own type with the same fields, and no plain number. In an `if`, all are true, also 0.
    """

    @abstractmethod
    def __float__(self) -> float:
        """Return the number alone, without its error."""

    def __format__(self, spec: str) -> str:
        if not spec:
            return str(self)
        return format(float(self), spec)

    def __round__(self, digits: int | None = None) -> float:
        return round(float(self), digits)


@dataclass(frozen=True, kw_only=True)
class Certified(ClaimedNumber):
    """An exact number that a certificate proves; a total reward at discount 1 may be infinite.

    Examples
    --------
    >>> print(Certified(value=Fraction(1, 3)))
    1/3 (certified)
    >>> Certified(value=Fraction(1, 3)) <= 0.5, f"{Certified(value=Fraction(1, 3)):.2f}"
    (True, '0.33')
    >>> Certified(value=Fraction(10) ** 400).interval
    (1.79...e+308, inf)
    """

    value: Fraction | float

    claim: ClassVar[Claim] = Claim.CERTIFIED
    advice = "nan stands for no number: under limits, ask audit.feasible first"

    @property
    def bounds(self) -> LowHigh:
        """The number, twice."""
        return self.value, self.value

    @property
    def interval(self) -> tuple[float, float]:
        """The number itself, rounded outward by less than one part in 10^15."""
        if isinstance(self.value, float):
            return self.value, self.value
        rounded = float(self)
        return float(np.nextafter(rounded, -np.inf)), float(np.nextafter(rounded, np.inf))

    def __str__(self) -> str:
        if isinstance(self.value, float):
            top, below = (1, 1)
        else:
            top, below = self.value.as_integer_ratio()
        # Short fractions are written exactly. Others become decimals: Python does not write
        # integers of over 4,300 digits, and floats would overflow.
        if max(top.bit_length(), below.bit_length()) <= 80:
            text = str(self.value)
            if len(text) <= 24:
                return f"{text} ({self.claim})"
        return f"≈ {Decimal(top) / Decimal(below):.12g} ({self.claim})"

    def __float__(self) -> float:
        return in_float(self.value)

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Certified):
            return self.value == other.value
        if isinstance(other, Real):
            return bool(self.value == other)
        return NotImplemented

    def __hash__(self) -> int:
        return hash(self.value)

    def __neg__(self) -> Certified:
        return Certified(value=-self.value)

    def __abs__(self) -> Certified:
        if self.value < 0:
            return -self
        return self

    def __sub__(self, other: Number) -> Number:
        if isinstance(other, Certified):
            return Certified(value=self.value - other.value)
        if not isinstance(other, Bounded):
            return NotImplemented
        return _subtract_bounded(self, other)


@dataclass(frozen=True, kw_only=True)
class Bounded(ClaimedNumber):
    """A float whose distance from the true number is at most `error`, rounding included.

    Comparing it with a number within this distance raises a `ModelError`.

    Examples
    --------
    >>> print(Bounded(value=0.5, error=1e-12))
    0.5 ± 1e-12 (bounded)
    >>> Bounded(value=0.5, error=1e-12) < 0.6
    True
    """

    value: float
    error: float

    claim: ClassVar[Claim] = Claim.BOUNDED
    advice = (
        "compare float(number), which leaves the error out; exact numbers decide: "
        "check(…, exact_values=True), certify(model)"
    )

    @property
    def bounds(self) -> LowHigh:
        """The ends of the interval."""
        return self.interval

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper bound."""
        if not np.isfinite(self.error):
            return -np.inf, np.inf
        low, high = self.value - self.error, self.value + self.error
        return float(np.nextafter(low, -np.inf)), float(np.nextafter(high, np.inf))

    def __str__(self) -> str:
        return f"{self.value:.12g} ± {self.error:.1g} ({self.claim})"

    def __float__(self) -> float:
        return self.value

    def __neg__(self) -> Bounded:
        return Bounded(value=0.0 - self.value, error=self.error)

    def __abs__(self) -> Bounded:
        return Bounded(value=abs(self.value), error=self.error)

    def __sub__(self, other: Certified | Bounded) -> Bounded:
        if not isinstance(other, Certified | Bounded):
            return NotImplemented
        return _subtract_bounded(self, other)


Number = TypeVar("Number", Bounded, Certified | Bounded)


def _subtract_bounded(one: Certified | Bounded, other: Certified | Bounded) -> Bounded:
    """Return the difference of two numbers, of which one at least is a float."""
    value = float(one) - float(other)
    low = np.nextafter(one.interval[0] - other.interval[1], -inf)
    high = np.nextafter(one.interval[1] - other.interval[0], inf)
    return Bounded(value=value, error=float(np.nextafter(max(value - low, high - value), inf)))


def compute_regret(best: Number, own: Number, sense: Sense = Sense.MAX) -> Number:
    """Return the optimal value less a policy's value (for costs, the reverse); never below 0."""
    lost: Number = sense.loss(best, own)
    if isinstance(lost, Certified):
        return lost
    low, high = (max(0.0, end) for end in lost.interval)
    value = max(0.0, lost.value)
    return Bounded(value=value, error=max(value - low, high - value))


def compute_regrets(best: Floats, own: Floats, error: Floats, sense: Sense = Sense.MAX) -> Floats:
    """Return the losses of policy values; 0 if an error of at most `error` may explain one."""
    lost = sense.loss(best, own)
    return np.where(np.abs(lost) > error, lost, 0.0)


@dataclass(frozen=True, kw_only=True)
class Estimated(ClaimedNumber):
    """A sample mean, its standard error, and a bound on the part that was cut off.

    Comparisons use its 95 % interval, which may miss the true mean.

    Attributes
    ----------
    value, standard_error : float
    cut_off : float
        A proven bound on the change of the mean if episodes had not been cut off.

    Examples
    --------
    >>> Estimated(value=2.0, standard_error=0.5).interval
    (1.0..., 2.9...)
    >>> print(Estimated(value=2.0, standard_error=0.5, cut_off=0.25))
    2 ± 0.5 s.e. ± 0.25 cut off (estimated)
    """

    value: float
    standard_error: float
    cut_off: float = 0.0

    claim: ClassVar[Claim] = Claim.ESTIMATED
    advice = "compare float(number), the mean alone, or estimate it from more draws"

    @property
    def bounds(self) -> LowHigh:
        """The ends of the 95 % interval."""
        return self.interval

    @property
    def interval(self) -> tuple[float, float]:
        """The normal 95 % interval, widened by `cut_off` on both sides."""
        half = NORMAL * self.standard_error + self.cut_off
        return self.value - half, self.value + half

    def __float__(self) -> float:
        return self.value

    def __abs__(self) -> Estimated:
        return replace(self, value=abs(self.value))

    def __str__(self) -> str:
        cut = ""
        if self.cut_off:
            cut = f" ± {self.cut_off:.2g} cut off"
        if isinf(self.standard_error):
            return f"{self.value:.6g}{cut} ({self.claim}, of one draw)"
        error = float(f"{self.standard_error:.2g}")
        return f"{self.value:.6g} ± {error:g} s.e.{cut} ({self.claim})"


def is_at_most(one: LowHigh, other: LowHigh) -> bool | None:
    """Return whether a number between two ends is at most another one; None if that is open."""
    if one[1] <= other[0]:
        return True
    if one[0] > other[1]:
        return False
    return None


def in_decimals(numbers: Iterable[Fraction | float | None]) -> list[float]:
    """Return numbers as floats: infinite beyond the range of floats, NaN for None."""
    return [nan if number is None else in_float(number) for number in numbers]


def in_float(number: Fraction | float) -> float:
    """Return a number as a float, which is infinite beyond the range of floats."""
    try:
        return float(number)
    except OverflowError:
        if number > 0:
            return inf
        return -inf
