"""A checker for optimal values that are functions of a parameter, from the models alone.

Nothing here imports a solver. N_s / D are the optimal values for all θ of an interval if

    D > 0,     D h_l ≥ 0 for all pairs,     D h_l = 0 for one pair of each state,

and the Bellman equations have one solution (`.equations`). Signs are proven, never sampled
(`.roots`). Averages have gaps of their own, and need no unique solution (`.average_equations`). A
bracket between two pieces holds one root, at which all changes happen: the left values are optimal
up to it, the right values from it on.
"""

from __future__ import annotations

import copyreg
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, reduce

import numpy as np
from flint import fmpq_poly
from numpy.typing import NDArray

from exact_mdp.analysis.vary.curves.equations import (
    PolicyPairs,
    SectionEquations,
    Values,
    list_pairs,
    sum_weighted,
)
from exact_mdp.analysis.vary.curves.roots import (
    compute_coefficient_signs,
    is_nonnegative,
    is_positive,
    odd_part,
    roots_on,
)
from exact_mdp.mdp.exact import from_flint, to_flint
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.parametric.row_change import Piece
from exact_mdp.mdp.table import format_rational

Bracket = tuple[Fraction, Fraction]
Start = tuple[tuple[int, Fraction], ...]


def _reduce_polynomial(poly: fmpq_poly) -> tuple[type[fmpq_poly], tuple[list[int], int]]:
    """Return a polynomial as the arguments of `fmpq_poly`, for pickling."""
    return fmpq_poly, ([*map(int, poly.numer().coeffs())], int(poly.denom()))


# Curves are pickled, but FLINT does not say how to pickle its polynomials.
copyreg.pickle(fmpq_poly, _reduce_polynomial)


@dataclass(frozen=True, kw_only=True)
class RationalFunction:
    """A ratio of two polynomials, given by their coefficients from the constant term up."""

    numerator: tuple[Fraction, ...]
    denominator: tuple[Fraction, ...]

    @classmethod
    def of(cls, start: Start, values: Values) -> RationalFunction:
        """Return N / D at the start in lowest terms, with 1 as the first nonzero coefficient of D.

        That makes equal functions have equal coefficients.
        """
        top, below = sum_weighted(start, values[0]), values[1]
        shared = top.gcd(below)
        unit = next(c for c in (below / shared).coeffs() if c)
        tops, belows = ((poly / shared / unit).coeffs() for poly in (top, below))
        return cls(
            numerator=tuple(map(from_flint, tops)) or (Fraction(0),),
            denominator=tuple(map(from_flint, belows)),
        )

    def _to_polynomials(self) -> tuple[fmpq_poly, fmpq_poly]:
        top, below = (fmpq_poly([*map(to_flint, c)]) for c in (self.numerator, self.denominator))
        return top, below

    def at(self, value: Fraction) -> Fraction:
        """Return the ratio at a point."""
        top, below = (poly(to_flint(value)) for poly in self._to_polynomials())
        return from_flint(top / below)

    def slope(self, value: Fraction) -> Fraction:
        """Return the derivative at a point."""
        top, below = self._to_polynomials()
        rise = top.derivative() * below - top * below.derivative()
        return from_flint(rise(to_flint(value)) / below(to_flint(value)) ** 2)


@dataclass(frozen=True, kw_only=True, eq=False)
class CurvePiece:
    """The optimal pairs and values between two thresholds."""

    low: Bracket  # encloses the left end
    high: Bracket  # encloses the right end
    section: Piece
    optimal: NDArray[np.bool_]  # (L,) the pairs that are optimal throughout
    start: Start  # weights of the start states; negative for costs
    values: Values  # the values of all states; for costs, the values of negated costs
    fixed_values: Values | None = None  # the values of the policy held fixed

    @cached_property
    def value(self) -> RationalFunction:
        """The optimal value at the start."""
        return RationalFunction.of(self.start, self.values)

    @cached_property
    def fixed(self) -> RationalFunction | None:
        """The value at the start of the policy held fixed; None without one."""
        return self.fixed_values and RationalFunction.of(self.start, self.fixed_values)


def piece_violations(
    family: Parametric,
    name: str,
    pieces: Sequence[CurvePiece],
    held: PolicyPairs | None,
    sign: int,
    *,
    proven: bool = False,
    kind: type[SectionEquations] = SectionEquations,
) -> Iterator[str]:
    """Yield the violations of pieces of a model that maximises; none if all are sound.

    `held` is the policy held fixed; sign is -1 if values at the start are costs. `proven` says that
    the degree of the rows is claimed to be known, not tested at some points. `kind` are the
    equations: for totals or for averages.
    """
    last, turning = None, list[fmpq_poly]()
    for piece in pieces:
        begins = last is None or piece.section is not last.section
        if begins:
            # A new section has equations of its own, which must have one solution.
            equations, open_ = kind(family, name, piece.section), set[int]()
            low, high = equations.low, equations.high
            start = equations.weigh_start(sign)
            if any(low < cut < high for cut in family.breakpoints(name)):
                yield "rows pass to other polynomials inside a section"
            yield from equations.find_faults()
            if proven and equations.change.checked is not None:
                yield "the degree of the rows was tested at some points, not proven"
        # A pair is open if its gap may turn negative in the rest of the section.
        turning = [equations.gap[pair] for pair in open_]
        changed = open_ | equations.update_gaps(piece.values)
        open_ = set()
        for pair in changed:
            if not all(compute_coefficient_signs(equations.gap[pair], piece.low[0], high)):
                open_.add(pair)
        turning += [equations.gap[pair] for pair in open_]
        yield from _not_optimal(equations, piece, open_)
        at = format_rational(piece.low[1])
        if piece.start != start:
            yield f"the value at the start from {at} on is another one"
        if held is not None:
            yield from _not_of(equations, piece, held)
        # Pieces join in a bracket in which all gaps, old and new, turn at one point.
        joined = last is None or last.high == piece.low
        if begins:
            joined = joined and piece.low[0] == piece.low[1]
        if not joined or not (begins or _turn_at_once(turning, piece.low)):
            yield f"nothing proves the optimum next to {at}"
        last = piece


def _not_optimal(equations: SectionEquations, piece: CurvePiece, open_: set[int]) -> Iterator[str]:
    """Yield the reasons why the values of a piece may not be optimal throughout."""
    at = format_rational(piece.low[1])
    if not equations.low <= piece.low[0] <= piece.high[1] <= equations.high:
        yield f"the piece from {at} on is outside its section"
    if not is_positive(piece.values[1], piece.low[0], piece.high[1]):
        yield f"the denominator from {at} on is not positive"
    if equations.improper:
        optimal = np.flatnonzero(piece.optimal).tolist()
        if not equations.can_end(optimal, piece.low[0], piece.high[1]):
            yield f"nothing proves that an optimal policy from {at} on ends"
    if piece.optimal[equations.barred].any():
        yield f"a pair by which a run may miss the goal counts as optimal from {at} on"
    for state, pairs in equations.pairs.items():
        marked = [bool(piece.optimal[pair]) for pair in pairs]
        if not any(marked) or marked != [equations.gap[pair].degree() < 0 for pair in pairs]:
            yield f"the pairs of state {state} from {at} on are not those that are optimal"
    for fault in equations.find_value_faults(piece.values):
        yield f"{fault} from {at} on"
    for place in equations.find_point_faults(piece.values, piece.low[0], piece.high[1]):
        yield f"nothing proves the optimum at {place}, where a transition vanishes"
    for pair in open_:
        if not is_nonnegative(equations.gap[pair], piece.low[1], piece.high[0]):
            yield f"a pair of state {equations.state[pair]} is better from {at} on"


def _not_of(equations: SectionEquations, piece: CurvePiece, held: PolicyPairs) -> Iterator[str]:
    """Yield the reasons why the values of the policy held fixed may be wrong."""
    at, values = format_rational(piece.low[1]), piece.fixed_values
    if values is None:
        yield f"the policy held fixed has no value from {at} on"
        return
    if not is_positive(values[1], piece.low[0], piece.high[1]):
        yield f"the denominator of the policy held fixed from {at} on is not positive"
    for fault in equations.find_value_faults(values):
        yield f"{fault} from {at} on"
    taken = list_pairs(held)
    if not set(taken).isdisjoint(equations.barred):
        yield f"the policy held fixed may miss the goal from {at} on"
        return
    if equations.improper and not equations.can_end(taken, piece.low[0], piece.high[1]):
        yield f"nothing proves that the policy held fixed ends from {at} on"
    for state in equations.find_policy_faults(held, values):
        yield f"the policy held fixed has another value in state {state} from {at} on"


def _turn_at_once(gaps: Iterable[fmpq_poly], bracket: Bracket) -> bool:
    """Whether all gaps that turn negative in a bracket do so at one point, once."""
    # The common divisor of their odd parts then has that root, and no other in the bracket.
    open_ = (odd_part(gap) for gap in gaps if not all(compute_coefficient_signs(gap, *bracket)))
    turning = [odd for odd in open_ if roots_on(odd, *bracket)]
    if not turning:
        return True
    shared = reduce(lambda one, other: one.gcd(other), turning)
    return {roots_on(each, *bracket) for each in [*turning, shared]} == {1}
