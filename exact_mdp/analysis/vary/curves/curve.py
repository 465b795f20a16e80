"""The optimal value at the start as an exact function of one parameter, piece by piece.

The value is a total, or the average reward per step.

Between two thresholds one policy π stays optimal, and its value is a ratio of polynomials,

    V*(θ) = V_π(θ) = N(θ) / D(θ),      D = 1 if the model is acyclic, else det(I - γ P_π),

in lowest terms (`.walk`). A threshold is known up to 1e-12. Within such a bracket V* is the greater
of the values on both sides, as both belong to policies, one optimal up to the threshold and one
from it on. The value of a policy held fixed is such a ratio, too, between the points at which rows
change from one polynomial to another.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import prod
from operator import attrgetter
from typing import Any

import numpy as np
from flint import fmpq_poly

from exact_mdp.analysis.gate.regret import limit_of
from exact_mdp.analysis.optimum import actions_of
from exact_mdp.analysis.vary.curves.average_equations import AverageEquations
from exact_mdp.analysis.vary.curves.checker import Bracket, CurvePiece, piece_violations
from exact_mdp.analysis.vary.curves.equations import PolicyPairs, SectionEquations, sum_weighted
from exact_mdp.analysis.vary.curves.roots import (
    compute_sign,
    isolate_roots,
    remove_double_roots,
    roots_on,
)
from exact_mdp.analysis.vary.curves.walk import pieces_of
from exact_mdp.analysis.vary.ranges import Range, range_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, named_options
from exact_mdp.mdp.exact import fingerprint, to_flint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import DISCOUNT, Parametric, parameter_of, parametric
from exact_mdp.mdp.policies.choices import of_every_state
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.questions.advice import warn_of_zero_reward
from exact_mdp.mdp.report import Report, Shown, Table
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import exact, format_rational
from exact_mdp.solvers.arguments import OfCriterion, is_average, require_average_applies
from exact_mdp.solvers.claims import Claim
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.policy_chain import PolicyChain

# The equations of totals and of averages.
EQUATIONS: dict[bool, type[SectionEquations]] = {False: SectionEquations, True: AverageEquations}
# The greatest width of the brackets in which the ends of limits are proven to lie.
WIDTH = Fraction(1, 10**12)
# The end of a range of discounts that cannot include 1: about 10^12 steps still count there.
NEARLY_ONE = 1 - Fraction(1, 2**40)


@dataclass(frozen=True, kw_only=True)
class ParameterInterval:
    """An interval of a parameter, ends included; each end is known up to a bracket.

    An interval whose ends share a bracket is at most 1e-12 wide, and may be empty.
    """

    low: Bracket
    high: Bracket


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ValueFunction(OfCriterion, Pictured):
    """The optimal value at the start over a range of one parameter."""

    parameter: Parameter
    range: Range
    pieces: tuple[CurvePiece, ...]  # each begins in the bracket in which the one before ends
    mdp: MDP  # the model today
    family: Parametric  # the models at all values; costs are negated and maximised
    chain: PolicyChain | None = None  # the policy held fixed, in the model today
    checked: int | None = None  # points at which an unproven degree was checked; else None
    criterion: str = "total"  # or "average": the value is the reward per step

    def __repr__(self) -> str:
        low, high = format_rational(self.range.low), format_rational(self.range.high)
        return (
            f"ValueFunction({self.parameter.name} from {low} to {high}: {len(self.pieces)} pieces, "
            f"{self.claim})"
        )

    @property
    def claim(self) -> Claim:
        """Certified, or checked if the degree of the rows is checked and not proven."""
        if self.checked is None:
            return Claim.CERTIFIED
        return Claim.CHECKED

    def _parse_value(self, value: object) -> Fraction:
        return exact(value, f"parameter {self.parameter.name}")

    def around(self, value: object) -> list[CurvePiece]:
        """Return the piece that holds a value of the parameter, or the two that share it."""
        at = self._parse_value(value)
        pieces = [piece for piece in self.pieces if piece.low[0] <= at <= piece.high[1]]
        if not pieces:
            raise ModelError(
                f"{self.parameter.name} is {format_rational(at)}, outside the range of the curve",
                where=f"parameter {self.parameter.name}",
                fix=f"choose a value from {self.range.low} to {self.range.high}",
            )
        return pieces

    def at(self, value: object) -> Fraction:
        """Return the optimal value at the start, for a value of the parameter in its range."""
        where = self._parse_value(value)
        best: Fraction = self.mdp.sense.best_of(each.value.at(where) for each in self.around(where))
        return best

    def fixed_at(self, value: object) -> Fraction | None:
        """Return the value of the policy held fixed, None without one; see `at`."""
        where = self._parse_value(value)
        fixed = self.around(where)[0].fixed
        if fixed is None:
            return None
        return fixed.at(where)

    def slope(self, value: object) -> tuple[Fraction | None, Fraction | None]:
        """Return the left and the right derivative of the optimal value; None beyond the range.

        They differ at a threshold, and at a breakpoint of the rows.
        """
        at = self._parse_value(value)
        best = self.at(at)
        # One piece, or two if the value is an end that they share.
        slopes = [p.value.slope(at) for p in self.around(at) if p.value.at(at) == best]
        left: Fraction | None = slopes[0]
        right: Fraction | None = slopes[-1]
        if at == self.range.low:
            left = None
        if at == self.range.high:
            right = None
        return left, right

    def within(
        self, max_regret: object | None = None, max_relative_regret: object | None = None
    ) -> tuple[ParameterInterval, ...]:
        """Return the values of the parameter for which the policy held fixed keeps a limit.

        Parameters
        ----------
        max_regret : number or "p/q", optional
            Greatest regret at the start; 0 if neither limit is given.
        max_relative_regret : number or "p/q", optional
            Greatest regret over the absolute optimal value, instead.

        Returns
        -------
        tuple of ParameterInterval
            In ascending order.

        Examples
        --------
        >>> rows = [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 5)]), (1, 0, [(1, 1, 0)])]
        >>> mdp = MDP.from_outcomes(rows, "1/2")  # max(5, 1 / (1 - γ)) from the start
        >>> value_curve = curve(mdp, "discount", (0, "99/100"), policy=[1, 0])
        >>> [(str(each.low[0]), str(each.high[1])) for each in value_curve.within(5)]
        [('0', '9/10')]
        """
        where = f"curve of {self.parameter.name}"
        if self.chain is None:
            fix = "give a policy that is held fixed"
            raise ModelError("there is no policy to compare with", where=where, fix=fix)
        if max_regret is not None and max_relative_regret is not None:
            raise ModelError("two limits of the regret", where=where, fix="give one of them")
        if max_regret is None:
            max_regret = 0
        if max_relative_regret is None:
            max_relative_regret = 0
        most = limit_of("max_regret", max_regret)
        share = limit_of("max_relative_regret", max_relative_regret)
        # `left` and `right`: whether the limit is kept up to the bracket, and from it on.
        intervals, begun, left = list[ParameterInterval](), self.pieces[0].low, False
        for at, root, open_, right in self._yield_brackets(most, share):
            if left and (open_ or not right):
                intervals.append(ParameterInterval(low=begun, high=at))
            if right and (open_ or not left):
                begun = at
            if root and not left and not right:
                # The limit is kept at the root alone.
                intervals.append(ParameterInterval(low=at, high=at))
            left = right
        return tuple(intervals)

    def _yield_brackets(
        self, most: Fraction, share: Fraction
    ) -> Iterator[tuple[Bracket, bool, bool, bool]]:
        """Yield the brackets in which a limit may begin or cease to be kept, in ascending order.

        With each comes whether some margin has a root in it, whether the bracket has inner points
        at which the limit is undecided, and whether it is kept from there up to the next bracket.
        """
        last, before = self.pieces[-1], fmpq_poly([1])
        for piece in self.pieces:
            # The roots of all margins: in the bracket where the piece begins, then inside.
            sides = self._build_margins(piece, most, share)
            every = prod((side for side in sides if side), start=fmpq_poly([1]))
            at, root = piece.low, roots_on(before * every, *piece.low) > 0
            open_, here, end = root and at[0] < at[1], piece.low[1], piece.high[0]
            for inside in isolate_roots(remove_double_roots(every), here, end):
                near = inside.isolate_beyond(here, WIDTH)
                yield at, root, open_, _is_limit_kept(sides, here, near.low)
                at, root, open_, here = (near.low, near.high), True, False, near.high
            yield at, root, open_, _is_limit_kept(sides, here, end)
            before = every
        yield last.high, roots_on(before, *last.high) > 0, False, False

    def _build_margins(self, piece: CurvePiece, most: Fraction, share: Fraction) -> list[fmpq_poly]:
        """Return two polynomials; the limit is kept wherever one of them is not negative.

        With V* = N / D and V_π = M / E, both D and E > 0, V* - V_π ≤ x + ρ |V*| is
        x D E ± ρ N E - (N E - M D) ≥ 0 for one sign.
        """
        assert piece.fixed_values is not None
        start = [(number, self.mdp.sense.sign * weight) for number, weight in piece.start]
        (tops, d), (fixed_tops, e) = piece.values, piece.fixed_values
        best, mine = sum_weighted(start, tops), sum_weighted(start, fixed_tops)
        room = to_flint(most) * d * e - (best * e - mine * d)
        return [room + to_flint(share) * best * e, room - to_flint(share) * best * e]

    def violations(self) -> list[str]:
        """Return the violations of the function, in words; none if it is sound.

        A checker that knows no solver proves that the values are optimal for every value of the
        parameter: on each piece, and in the brackets between them (`.checker`).
        """
        wrong = list[str]()
        ends = [(self.range.low,) * 2, *(piece.high for piece in self.pieces)]
        for end, piece in zip(ends, self.pieces, strict=False):
            if piece.low != end or [*piece.low, *piece.high] != sorted([*piece.low, *piece.high]):
                wrong.append(f"no piece covers {format_rational(end[1])}")
        if ends[-1] != (self.range.high,) * 2:
            wrong.append(f"no piece covers {format_rational(self.range.high)}")
        if fingerprint(self.mdp.maximised) != fingerprint(self.family.at({})):
            wrong.append("the model is not the model of today's values")
        name, held, sign = (
            self.parameter.name,
            _to_rational_weights(self.chain),
            self.mdp.sense.sign,
        )
        kind, proven = EQUATIONS[is_average(self.criterion)], self.checked is None
        found = piece_violations(
            self.family, name, self.pieces, held, sign, proven=proven, kind=kind
        )
        return [*wrong, *found]

    def report(self, within: Sequence[ParameterInterval] | None = None) -> Report:
        """Return the pieces; `within` are the intervals in which a fixed policy keeps a limit."""
        pieces = []
        for each in self.pieces:
            piece = _describe_interval(each.low, each.high) | vars(each.value)
            if each.fixed is not None:
                piece["fixed"] = vars(each.fixed)
            first_actions = [best for best, *_ in actions_of(self.mdp, each.optimal)]
            piece["policy"] = of_every_state(self.mdp, first_actions)
            pieces.append(piece)
        facts: dict[str, Any] = {
            **self.criterion_facts,
            "parameter": self.parameter.name,
            "claim": self.claim,
            "pieces": pieces,
        }
        if within is not None:
            ends = [_describe_interval(each.low, each.high) for each in within]
            words = [f"{float(each['from']):.10g} to {float(each['to']):.10g}" for each in ends]
            said = "; ".join(words) or "nowhere"
            facts["within"] = Shown(ends, f"the policy keeps the limit: {said}")
        table = Table(
            title=f"pieces of the optimal {self.measure} at the start",
            rows=self.frame(),
            columns={
                "from": "low:.10g",
                "to": "high:.10g",
                "value from": "value_low:.10g",
                "value to": "value_high:.10g",
                "degree": "degree",
            },
            note="each is a ratio of polynomials with exact coefficients",
        )
        return Report(title="curve", facts=facts, tables={"pieces": table})

    def frame(self) -> DataFrame:
        """Return one row for each piece."""
        rows = []
        for piece in self.pieces:
            rows.append(
                {
                    "parameter": self.parameter.name,
                    "low": float(piece.low[0]),
                    "high": float(piece.high[1]),
                    "degree": len(piece.value.numerator) - 1,
                    "value_low": float(piece.value.at(piece.low[1])),
                    "value_high": float(piece.value.at(piece.high[0])),
                    "claim": str(self.claim),
                }
            )
        return data_frame(rows)


def _is_limit_kept(sides: Sequence[fmpq_poly], low: Fraction, high: Fraction) -> bool:
    """Whether a limit is kept between two points without a root in between."""
    return any(compute_sign(side, (low + high) / 2) >= 0 for side in sides)


def _describe_interval(low: Bracket, high: Bracket) -> dict[str, Any]:
    ends = {"from": _choose_simple_fraction(low), "to": _choose_simple_fraction(high)}
    return ends | {"from_bracket": low, "to_bracket": high}


def _choose_simple_fraction(bracket: Bracket) -> Fraction:
    """Return a fraction with a small denominator between two ends, or the end if both are equal."""
    low, high = bracket
    middle, most = (low + high) / 2, 1
    while True:
        near = middle.limit_denominator(most)
        if low <= near <= high:
            return near
        most *= 10


@named_options
def curve(
    model: Scenario | MDP | Parametric,
    name: str,
    ranges: Any = None,
    *,
    relative: object | None = None,
    policy: PolicyLike | None = None,
    criterion: str = "total",
) -> ValueFunction:
    """Return the optimal value at the start as an exact function of a parameter.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    name : str
        The parameter; the others are held fixed.
    ranges : (low, high) or {name: (low, high)}, optional
        The range; by default all values that the parameter may have or, if these are unbounded,
        today's value ± 100 %. A discount goes up to 1 - 2^-40 if values at 1 do not exist.
    relative : number, optional
        Today's value ± this share instead.
    policy : PolicyLike, optional
        A policy held fixed, whose value is computed, too.
    criterion : "total" or "average"
        As for `study`.

    Returns
    -------
    ValueFunction

    Raises
    ------
    ModelError
        As `thresholds` raises it.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])]
    >>> line = curve(MDP.from_outcomes(rows, "1/2"), "discount", (0, "99/100"))
    >>> len(line.pieces), line.at("1/2"), line.at("19/20")  # Puterman (1994), section 3.1
    (2, Fraction(9, 1), Fraction(-60, 7))
    """
    family = parametric(model)
    mdp = family.at({})
    if mdp.sense.costs:
        family = family.with_question(attrgetter("maximised"))
    span = range_of(family, name, ranges, "whole" if relative is None else relative)

    average = is_average(criterion)
    if average:
        require_average_applies(mdp)
        if isinstance(policy, str) and policy == "optimal":
            policy = solve(mdp, criterion=criterion)

    # A range of discounts ends below 1 if some policy is improper there.
    elif name == DISCOUNT:
        if ranges is None and relative is None and span.high < 1:
            span = Range(low=span.low, high=NEARLY_ONE)
        if span.high == 1 and family.at({DISCOUNT: 1}).ends.has_improper_policy:
            if span.low >= NEARLY_ONE:
                raise ModelError(
                    "at discount 1 some policy never ends",
                    where=f"parameter {DISCOUNT}",
                    fix=f"choose a range that begins below {format_rational(NEARLY_ONE)}",
                )
            span = Range(low=span.low, high=NEARLY_ONE)

    chain = undecided = None
    if policy is not None:
        chain, undecided = PolicyChain.held_fixed(mdp, policy)
    held, kind = _to_rational_weights(chain), EQUATIONS[average]
    pieces, sections = pieces_of(family, name, span, mdp.sense.sign, held, kind=kind)

    # The policy must name an action in every state that has a choice somewhere in the range.
    if chain is not None and undecided is not None and undecided.any():
        for equations in sections:
            for state in np.flatnonzero(undecided).tolist():
                if equations.has_different_actions(state):
                    raise ModelError(
                        "the policy held fixed names no action in a state where the choice does "
                        "not matter today, but matters elsewhere in the range",
                        where=f"{mdp.space.place(state)}, for some {name}",
                        fix="give an action there, too, by a mapping or an array over all states",
                    )
    values = [value for each in pieces for value in (each.value, each.fixed) if value is not None]
    if not any(any(each.numerator) for each in values):
        warn_of_zero_reward(mdp)
    checks = [each.change.checked for each in sections if each.change.checked is not None]
    return ValueFunction(
        parameter=parameter_of(family, name),
        range=span,
        pieces=tuple(pieces),
        mdp=mdp,
        family=family,
        chain=chain,
        checked=checks[0] if checks else None,
        criterion=criterion,
    )


def _to_rational_weights(chain: PolicyChain | None) -> PolicyPairs | None:
    """Return the pairs that a policy takes in each state, with FLINT's rationals as weights."""
    if chain is None:
        return None
    weights = map(chain.exact_weights, range(chain.mdp.n_states))
    rows = []
    for each in weights:
        rows.append([(pair, to_flint(weight)) for pair, weight in each.items()])
    return rows
