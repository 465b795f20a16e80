"""Solutions: values, a policy, and a claim about each number.

A number leaves the toolkit as one of four types, so that a table or a plot cannot confuse them:
`Certified` (an exact rational with a proof), `Bounded` (a float and a sound bound on its error),
`Checked` (it depends on the degree of polynomials, which was checked at points but not proven; see
sensitivity) and `Estimated` (a sample mean and its standard error).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from enum import StrEnum
from fractions import Fraction
from functools import cached_property
from math import inf, isinf, nan
from typing import Any, ClassVar, Protocol, Self, TypeVar

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.questions.ending import describe_sense
from exact_mdp.mdp.report import Report
from exact_mdp.mdp.result import ROWS_SHOWN, DataFrame, Pictured, data_frame, plain_report
from exact_mdp.mdp.sense import Sense
from exact_mdp.mdp.table import Floats, Integers

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


class PrecisionWarning(UserWarning):
    """The tolerance is beyond double precision; the error bound says how near the result came."""


def warn_of_precision(error: float, *, stacklevel: int = 2) -> None:
    """Issue a PrecisionWarning; `stacklevel` is 2 for the line that called the caller."""
    message = f"the error bound is {error:.2g}: {Status.PRECISION}"
    warnings.warn(message, PrecisionWarning, stacklevel=stacklevel + 1)


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

    def __init__(self, status: Status, detail: str = "", solution: Solution | None = None) -> None:
        self.status, self.detail, self.solution = status, detail, solution
        message = str(status)
        if detail:
            message = f"{detail}: {status}"
        super().__init__(message)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.status, self.detail, self.solution)


@dataclass(frozen=True, kw_only=True)
class Certified:
    """An exact number that a certificate proves; a total reward at discount 1 may be infinite.

    Examples
    --------
    >>> print(Certified(value=Fraction(1, 3)))
    1/3 (certified)
    >>> Certified(value=Fraction(10) ** 400).interval
    (1.79...e+308, inf)
    """

    value: Fraction | float

    claim: ClassVar[Claim] = Claim.CERTIFIED

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

    def __neg__(self) -> Certified:
        return Certified(value=-self.value)

    def __sub__(self, other: Number) -> Number:
        if isinstance(other, Certified):
            return Certified(value=self.value - other.value)
        return _subtract_bounded(self, other)


@dataclass(frozen=True, kw_only=True)
class Bounded:
    """A float whose distance from the true number is at most `error`, rounding included.

    Examples
    --------
    >>> print(Bounded(value=0.5, error=1e-12))
    0.5 ± 1e-12 (bounded)
    """

    value: float
    error: float

    claim: ClassVar[Claim] = Claim.BOUNDED

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

    def __sub__(self, other: Certified | Bounded) -> Bounded:
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
class Estimated:
    """A sample mean, its standard error, and a bound on the part that was cut off.

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

    @property
    def interval(self) -> tuple[float, float]:
        """The normal 95 % interval, widened by `cut_off` on both sides."""
        half = NORMAL * self.standard_error + self.cut_off
        return self.value - half, self.value + half

    def __float__(self) -> float:
        return self.value

    def __str__(self) -> str:
        cut = ""
        if self.cut_off:
            cut = f" ± {self.cut_off:.2g} cut off"
        if isinf(self.standard_error):
            return f"{self.value:.6g}{cut} ({self.claim}, of one draw)"
        error = float(f"{self.standard_error:.1g}")
        return f"{self.value:.6g} ± {error:g} s.e.{cut} ({self.claim})"


class Valued:
    """A result with the `value` (S,) of each state of an `mdp`, and its `error` bound (S,)."""

    @property
    def error_bound(self) -> float:
        """The greatest error of a state whose value is known."""
        own: Any = self
        return float(own.error.max(where=~np.isnan(own.value), initial=0.0))

    @cached_property
    def start(self) -> Bounded:
        """The value of the start distribution with its error bound."""
        own: Any = self
        return at_start(own.mdp, own)

    @property
    def start_value(self) -> float:
        """The value of the start distribution."""
        return self.start.value


def at_start(mdp: MDP, valued: Any) -> Bounded:
    """Return the expectation of numbers `valued.value` (S,) over the start, with its error."""
    states = np.flatnonzero(mdp.start_distribution)
    weights = mdp.start_distribution[states]
    value, error = valued.value[states], valued.error[states]
    # An infinite total reward has no error.
    if not np.isfinite(value).all():
        return Bounded(value=float(weights @ value), error=0.0)
    # The sum over the start rounds; a single state of probability 1 does not.
    units = (len(states) + 3) * 2.0**-52  # twice as many as there are roundings
    rounding = units
    if weights.tolist() == [1.0]:
        rounding = 0.0
    bound = float(weights @ (error + rounding * np.abs(value))) * (1 + 2 * units)
    return Bounded(value=float(weights @ value), error=bound)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Found(Valued):
    """Values with error bounds in every state, and a policy: the base of all solutions."""

    mdp: MDP
    value: Floats  # (S,)
    pairs: Integers | None  # (S,) the pair that the policy takes in each state
    state_error: Floats  # (S,)
    status: Status
    iterations: int
    seconds: float
    claim: Claim = Claim.BOUNDED

    @cached_property
    def policy(self) -> Any:
        """The policy, whose `rule` (S,) holds action numbers; None if it was given."""
        if self.pairs is None:
            return None
        mdp = self.mdp
        return Policy(space=mdp.space, actions=mdp.actions, rule=mdp.pair_action[self.pairs])

    @property
    def error(self) -> Floats:
        """(S,) the error bound of each value."""
        return self.state_error

    def frame(self) -> DataFrame:
        """Return the value, its error bound and the action of each state."""
        return self._tabulate_states(self.mdp.n_states)

    def _tabulate_states(self, n: int) -> DataFrame:
        columns = {"value": self.value[:n], "error": self.error[:n]}
        if self.pairs is None:
            taken = {}
        else:
            taken = {"action": self.mdp.pair_action[self.pairs[:n]]}
        return tabulate_by_state(self.mdp, columns | taken)

    def report(self) -> Report:
        """Return the facts of the result and a table of its first states."""
        return plain_report(self, self._tabulate_states(ROWS_SHOWN), self.mdp.n_states)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Solution(Found, Pictured):
    """Values and policy of a solved model, with bounds that hold in every state.

    Attributes
    ----------
    mdp : MDP
    value : (S,)
        State values V.
    pairs : (S,) int64
        The pair that the policy takes in each state.
    state_error : (S,)
        Upper bounds on |V(s) - V*(s)| and |V(s) - V^π(s)|, for the policy π of this solution.
    regret_bound : float
        An upper bound on V*(s) - V^π(s), or for costs V^π(s) - V*(s), in every state.
    status : Status
    method, solver : str
        Name of the algorithm, as in `SOLVERS`, and the solver with its settings.
    iterations : int
    seconds : float
    claim : Claim

    Examples
    --------
    >>> from exact_mdp.solvers import solve
    >>> solution = solve(MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]]))
    >>> solution.value.tolist(), solution.policy.rule.tolist(), solution.start.interval
    ([3.0, 0.0], [1, 0], (2.99..., 3.00...))
    >>> solution.frame().action.tolist(), solution.q.tolist(), solution.gap_table.tolist()
    (['1', '0'], [[1.0, 3.0], [0.0, 0.0]], [[2.0, 0.0], [0.0, 0.0]])
    """

    pairs: Integers
    regret_bound: float
    method: str
    solver: str

    @property
    def q(self) -> Floats:
        """(S, A) action values r + γ P V; -inf (for costs inf) if an action is not available."""
        return self.mdp.by_action(self.mdp.backup(self.value), self.mdp.sense.worst)

    @property
    def gap_table(self) -> Floats:
        """(S, A) the suboptimality gap of each action; NaN if it is not available."""
        here, there = self.value[self.mdp.pair_state], self.mdp.backup(self.value)
        return self.mdp.by_action(self.mdp.sense.losses(here, there))

    def negated(self, mdp: MDP) -> Self:
        """Return this solution for `mdp`, the model with negated rewards."""
        return replace(self, mdp=mdp, value=0.0 - self.value)

    def __repr__(self) -> str:
        asked = describe_sense(self.mdp)
        asked = asked and f" ({asked})"
        return (
            f"{type(self).__name__}({self.method}: start value {self.start}{asked}, "
            f"regret at most {self.regret_bound:.1g}, iterations: {self.iterations}, "
            f"{self.seconds:.3g} s; {self.status})"
        )


class Answer(Protocol):
    """An answer about a model of maximised rewards, which can be turned into one about costs."""

    def negated(self, mdp: MDP) -> Self:
        """Return this answer for `mdp`, the model with negated rewards."""


AnswerOf = TypeVar("AnswerOf", bound=Answer)


def answer_maximised(mdp: MDP, answer: Callable[[MDP], AnswerOf]) -> AnswerOf:
    """Return the answer of a model, given a function that knows maximised rewards alone.

    A model of costs is answered by its negation, even by the solution in a SolverError.
    """
    if not mdp.sense.costs:
        return answer(mdp)
    try:
        return answer(mdp.maximised).negated(mdp)
    except SolverError as error:
        if error.solution is not None:
            error.solution = error.solution.negated(mdp)
        raise


def tabulate_by_state(mdp: MDP | None, columns: Mapping[str, Any]) -> DataFrame:
    """Return columns beside the labels of the first states, or their numbers without a model."""
    states = range(len(next(iter(columns.values()))))
    if mdp is None:
        return data_frame({"state": states, **columns})
    names = {"state": mdp.space.labels(states), **columns}
    if "action" in columns:
        names["action"] = [mdp.actions[action] for action in columns["action"].tolist()]
    return data_frame(names)


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
