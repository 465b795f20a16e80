"""Checks an optimal value that is a function of a parameter against the models alone.

Nothing here imports a solver. On a section of the range on which rows are polynomials of
y = θ - θ0, N_s / D are the optimal values for all y of an interval [a, b] because

    D > 0,     D h_l = N_s - D r_l - Σ p(l, s') N_s' ≥ 0 of all pairs,     = 0 of one of each state

and the Bellman equations have one solution: where γ Σ P < 1 throughout, or where γ Σ P ≤ 1 and some
transition of each pair leads to a state that is nearer to the end (see `solvers.exact.checker`).

No sign is sampled (`.roots`). A bracket between two pieces has one root in it at which everything
changes that changes: the left values are optimal up to it, the right ones from it on.
"""

from __future__ import annotations

import copyreg
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from typing import TYPE_CHECKING

import flint
import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.vary.curves.roots import (
    nonnegative,
    odd_part,
    positive,
    roots,
    roots_on,
    sign,
    signs,
    simple,
)
from exact_mdp.mdp.exact import fraction, rational
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.parametric.row_change import Piece, PolynomialRows, row_change
from exact_mdp.mdp.table import shown

if TYPE_CHECKING:
    from flint import fmpq, fmpq_poly


Bracket = tuple[Fraction, Fraction]
Values = tuple[Sequence["fmpq_poly"], "fmpq_poly"]
"""N of each state, and D: values are N / D."""
Mix = Sequence[Sequence[tuple[int, "fmpq"]]]
"""Of each state, the pairs that a policy takes there, with their probabilities."""


def _reduced(poly: fmpq_poly) -> tuple[type[fmpq_poly], tuple[list[int], int]]:
    return flint.fmpq_poly, ([*map(int, poly.numer().coeffs())], int(poly.denom()))


copyreg.pickle(flint.fmpq_poly, _reduced)  # FLINT's polynomials cannot be pickled by themselves


@dataclass(frozen=True, kw_only=True)
class RationalFunction:
    """A ratio of two polynomials, with coefficients from the constant up."""

    numerator: tuple[Fraction, ...]
    denominator: tuple[Fraction, ...]

    @classmethod
    def of(cls, ratio: tuple[fmpq_poly, fmpq_poly]) -> RationalFunction:
        """Return N / D with the constant of D, or its first coefficient that is not 0, made 1."""
        top, below = ([*map(fraction, poly.coeffs())] or [Fraction(0)] for poly in ratio)
        unit = next((c for c in below if c), Fraction(1))
        return cls(
            numerator=tuple(c / unit for c in top), denominator=tuple(c / unit for c in below)
        )

    def polynomials(self) -> tuple[fmpq_poly, fmpq_poly]:
        """Return N and D."""
        top, below = (
            flint.fmpq_poly([*map(rational, c)]) for c in (self.numerator, self.denominator)
        )
        return top, below

    def at(self, value: Fraction) -> Fraction:
        """Return the ratio at a point."""
        top, below = (poly(rational(value)) for poly in self.polynomials())
        return fraction(top / below)

    def slope(self, value: Fraction) -> Fraction:
        """Return the derivative at a point."""
        top, below = self.polynomials()
        rise = top.derivative() * below - top * below.derivative()
        return fraction(rise(rational(value)) / below(rational(value)) ** 2)


@dataclass(frozen=True, kw_only=True, eq=False)
class Section(Piece):
    """An interval on which rows are polynomials of y, the distance from `origin`."""

    low: Fraction
    high: Fraction
    origin: Fraction


@dataclass(frozen=True, kw_only=True, eq=False)
class CurvePiece:
    """What is optimal between two thresholds, and what it is worth."""

    low: Bracket  # of its ends
    high: Bracket
    optimal: NDArray[np.bool_]  # (L,) the pairs that are optimal throughout
    value: RationalFunction  # the optimal value at the start
    fixed: RationalFunction | None = None  # that of the policy held fixed
    section: Section
    # The values of all states; those that are maximised, of a model of costs.
    values: Values
    fixed_values: Values | None = None
    # Brackets of points inside, and pairs that are as good there, and no better.
    touches: tuple[tuple[Fraction, Fraction, int], ...] = ()
    # (L,) the pairs that are optimal at the upper end, where that is the end of a section
    ended: NDArray[np.bool_] | None = None


def piece_violations(
    family: Parametric,
    name: str,
    pieces: Sequence[CurvePiece],
    mix: Mix | None,
    *,
    sign: int = 1,
) -> list[str]:
    """Return what does not hold of pieces of a model that maximises: nothing where all is sound.

    `mix` is the policy held fixed; sign is -1 where values at the start are costs.
    """
    wrong, last = list[str](), pieces[0]
    equations: _Equations | None = None
    for piece in pieces:
        before = None
        if equations is None or piece.section is not last.section:
            joined = equations is None or len({*last.high, *piece.low}) == 1
            equations = _Equations(family, name, piece.section, sign)
            wrong += equations.unsound()
        else:
            joined, before = last.high == piece.low, equations.open
        wrong += equations.not_optimal(piece)
        if mix is not None:
            wrong += equations.not_of(piece, mix)
        if before is not None:
            turning = [*before.values(), *equations.open.values()]
            joined = joined and equations.turn_at_once(turning, piece.low)
        if not joined:
            wrong.append(f"nothing proves what is optimal next to {shown(piece.low[0])}")
        last = piece
    return wrong


class _Equations:
    """The equations of a model over one section.

    `gap` is D h of all pairs, of the last piece, and `open` holds those whose signs the
    substitution leaves open on the whole piece.
    """

    def __init__(self, family: Parametric, name: str, section: Section, sign: int) -> None:
        origin, self.section, self.sign = section.origin, section, sign
        base = family.at({name: origin})
        change = row_change(family, name, section, origin=origin, base=base)
        self.rows, self.cuts = PolynomialRows(base, change), family.breakpoints(name)
        self.state: list[int] = base.pair_state.tolist()
        self.states = [s for s, ends in enumerate(self.rows.terminal) if not ends]
        self.pairs = {s: base.pairs_of(s) for s in self.states}
        self.start = [(s, w) for s, w in base.start if not self.rows.terminal[s]]
        self.slack = {  # 1 - γ Σ P, over states that are not terminal
            pair: flint.fmpq_poly([1]) - sum(p for _, p in self.rows.following[pair])
            for pairs in self.pairs.values()
            for pair in pairs
        }
        self.gap: dict[int, fmpq_poly] = {}
        self.open: dict[int, fmpq_poly] = {}
        self.safe = set[int]()
        self.last: Values = ((), flint.fmpq_poly())

    def _inside(self, low: Fraction, high: Fraction) -> Bracket:
        return low - self.section.origin, high - self.section.origin

    def unsound(self) -> Iterator[str]:
        """Yield why rows may be none, or the Bellman equations have several solutions."""
        section, (low, high) = self.section, self._inside(self.section.low, self.section.high)
        if any(section.low < cut < section.high for cut in self.cuts):
            yield "rows pass to other polynomials inside a section"
        chances = [p for pair in self.slack for _, p in self.rows.following[pair]]
        if not all(nonnegative(p, low, high) for p in different([*chances, *self.slack.values()])):
            yield "a probability is negative, or probabilities pass 1"
        elif not all(positive(s, low, high) for s in different(self.slack.values())):
            falls, ends = self._nearer(None), (self._nearer(low), self._nearer(high))
            if (
                falls is None
                or None in ends
                or any(True for p in falls for _ in roots(simple(p), low, high))
            ):
                yield "nothing proves that the Bellman equations have one solution"

    def _nearer(self, at: Fraction | None) -> list[fmpq_poly] | None:
        """Return the chances of coming nearer to the end, from the end on; None where it stays.

        Nearer at one point of the section, or, without one, at all but some.
        """
        chances: list[fmpq_poly] = []
        near, left = set[int](), self.states
        while left:
            layer = list[int]()
            for state in left:
                falls = [
                    sum((p for to, p in self.rows.following[pair] if to in near), self.slack[pair])
                    for pair in self.pairs[state]
                ]
                if all(p.degree() >= 0 if at is None else sign(p, at) for p in falls):
                    layer.append(state)
                    chances += falls
            if not layer:
                return None
            near.update(layer)
            left = [state for state in left if state not in near]
        return different(chances)

    def not_optimal(self, piece: CurvePiece) -> Iterator[str]:
        """Yield why the values of a piece may not be the optimal ones throughout."""
        self._work_out(piece)
        at = shown(piece.low[1])
        if not self.section.low <= piece.low[0] <= piece.high[1] <= self.section.high:
            yield f"the piece from {at} on is outside its section"
        if not positive(piece.values[1], *self._inside(piece.low[0], piece.high[1])):
            yield f"the denominator from {at} on is not positive"
        for state, pairs in self.pairs.items():
            marked = [bool(piece.optimal[pair]) for pair in pairs]
            if not any(marked) or marked != [self.gap[pair].degree() < 0 for pair in pairs]:
                yield f"the pairs of state {state} from {at} on are not those that are optimal"
        for pair, gap in self.open.items():
            if not nonnegative(gap, *self._inside(piece.low[1], piece.high[0])):
                yield f"a pair of state {self.state[pair]} is better from {at} on"
        yield from self._not_the_start(piece.values, piece.value, at)

    def _work_out(self, piece: CurvePiece) -> None:
        """Work out the gaps on a piece, but for those that have not changed since the last.

        A gap whose sign is known up to the end of the section is `safe` until it changes.
        """
        (new, scale), (old, before) = piece.values, self.last
        low, high = self._inside(piece.low[0], piece.high[1])
        end, self.open = self.section.high - self.section.origin, {}
        for pair in self.slack:
            states = (self.state[pair], *(to for to, _ in self.rows.following[pair]))
            if scale != before or any(new[s] is not old[s] for s in states):
                self.gap[pair] = self._gap(piece.values, pair)
                self.safe.discard(pair)
            if pair not in self.safe:
                if all(signs(self.gap[pair], low, end)):
                    self.safe.add(pair)
                elif not all(signs(self.gap[pair], low, high)):
                    self.open[pair] = self.gap[pair]
        self.last = piece.values

    def _gap(self, values: Values, pair: int) -> fmpq_poly:
        """Return D h of a pair: N - D r - Σ p N."""
        numerators, scale = values
        left = numerators[self.state[pair]] - scale * self.rows.reward[pair]
        return left - sum(p * numerators[to] for to, p in self.rows.following[pair])

    def _not_the_start(self, values: Values, value: RationalFunction, at: str) -> Iterator[str]:
        numerators, scale = values
        shift = flint.fmpq_poly([rational(self.section.origin), 1])
        top, below = (poly(shift) for poly in value.polynomials())
        start = weighed(self.start, numerators)
        if below.degree() < 0 or self.sign * top * scale != start * below:
            yield f"the value at the start from {at} on is another one"

    def not_of(self, piece: CurvePiece, mix: Mix) -> Iterator[str]:
        """Yield why the fixed policy's values may be others."""
        at, values, value = shown(piece.low[1]), piece.fixed_values, piece.fixed
        if values is None or value is None:
            yield f"the policy held fixed has no value from {at} on"
            return
        if not positive(values[1], *self._inside(piece.low[0], piece.high[1])):
            yield f"the denominator of the policy held fixed from {at} on is not positive"
        for state in self.states:
            gaps = (share * self._gap(values, pair) for pair, share in mix[state])
            if sum(gaps, flint.fmpq_poly()):
                yield f"the policy held fixed has another value in state {state} from {at} on"
        yield from self._not_the_start(values, value, at)

    def turn_at_once(self, gaps: Iterable[fmpq_poly], bracket: Bracket) -> bool:
        """Whether all gaps that turn negative in a bracket do so at one point, once."""
        low, high = self._inside(*bracket)
        turning = [odd for gap in gaps if roots_on(odd := odd_part(gap), low, high)]
        if not turning:
            return True
        shared = reduce(lambda one, other: one.gcd(other), turning)
        return {roots_on(each, low, high) for each in [*turning, shared]} == {1}


def weighed(weights: Iterable[tuple[int, Fraction]], polynomials: Sequence[fmpq_poly]) -> fmpq_poly:
    """Return a sum of some of the polynomials, each with a weight."""
    return sum((rational(weight) * polynomials[k] for k, weight in weights), flint.fmpq_poly())


def different(polynomials: Iterable[fmpq_poly]) -> list[fmpq_poly]:
    """Return every polynomial once."""
    return [*{str(p): p for p in polynomials}.values()]
