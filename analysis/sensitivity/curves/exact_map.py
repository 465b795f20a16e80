"""Which policy is optimal where, for two parameters: a proven map of a rectangle.

Where a model is acyclic and its rows are polynomials of x and y on the rectangle, what a policy π
falls short of an action is a polynomial h(x, y) (`.gap_polynomials`), and π is optimal where none
of its h is negative. The signs of all h are those of their irreducible factors f. So the rectangle
is cut into cells along one axis (cylindrical algebraic decomposition: Collins 1975; Basu, Pollack
and Roy, Algorithms in Real Algebraic Geometry, 2006, chapter 5): at each x at which

    the leading coefficient of an f in y, its discriminant, a resultant of two of them, or an f on
    the lower or upper side of the rectangle is 0.

Between two such x, roots y(x) of all f are as many, and in the same order, so that f has one sign
in each cell between two of them. A policy that is optimal at one point of a cell is so in all of
it. The model is solved exactly at points of cells in which no policy that is known is optimal; the
policies that this finds bring new f, until every cell has its policy. Polynomials are left out
whose coefficients in Bernstein's basis of the rectangle have one sign: they have no root there.

Rows are polynomials of both parameters where they are of each one, whatever the other's value. The
rules of a care scenario say so, between values at which chances are cut off: a chance is a sum of
products in which no parameter stands twice, so that it is cut off nowhere inside if it is so on no
side of the rectangle. For other families it is checked at points.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.gate.regret import proven
from exact_mdp.analysis.sensitivity.base_case import held_at
from exact_mdp.analysis.sensitivity.curves.gap_polynomials import interpolated
from exact_mdp.analysis.sensitivity.curves.real_roots import Root, roots, simple
from exact_mdp.analysis.sensitivity.ranges import Range
from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.parametric.family import unposed
from exact_mdp.mdp.parametric.polynomial_rows import PolynomialRows, rational
from exact_mdp.mdp.parametric.row_change import Piece, row_change
from exact_mdp.mdp.table import exact, shown
from exact_mdp.solvers.bounds.bounds import levels
from exact_mdp.solvers.solution import Claim

if TYPE_CHECKING:
    from flint import fmpq_mpoly, fmpq_poly

flint = later("flint")

WIDTH = Fraction(1, 10**12)
FACTORS = 80  # polynomials with a root in the rectangle
DEGREE = 8  # of each of them in either parameter

Bracket = tuple[Fraction, Fraction]
Box = tuple[Range, Range]


@dataclass(frozen=True, kw_only=True, eq=False)
class Slab:
    """Cells above one interval of x, from the lower side of the rectangle to the upper one.

    Attributes
    ----------
    low, high : (Fraction, Fraction)
        Brackets of the ends of the interval.
    curves : tuple of (f, number)
        What separates the cells: the root of f(x, ·) of this number, counted from below.
    policies : tuple of int
        The policy of each cell, one more than curves.
    """

    low: Bracket
    high: Bracket
    curves: tuple[tuple[fmpq_mpoly, int], ...]
    policies: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class ExactMap:
    """A rectangle of two parameters, cut into cells in each of which one policy is optimal.

    Attributes
    ----------
    box : (Range, Range)
    slabs : tuple of Slab
    optimal : tuple of (L,) bool
        The pairs that are optimal wherever a policy is, by its number.
    checked : int or None
        Points at which the degree of a family's rows was checked, where no rules prove it.
    """

    box: Box
    slabs: tuple[Slab, ...]
    optimal: tuple[NDArray[np.bool_], ...]
    checked: int | None

    @property
    def claim(self) -> Claim:
        """Certified, or estimated where the degree of the rows is checked and not proven."""
        return Claim.CERTIFIED if self.checked is None else Claim.ESTIMATED

    def at(self, x: object, y: object) -> set[int]:
        """Return the numbers of policies that are optimal at a point: several next to a line."""
        place, height = exact(x), exact(y)
        if not all(e.low <= at <= e.high for e, at in zip(self.box, (place, height), strict=True)):
            raise ModelError(
                f"({shown(place)}, {shown(height)}) is outside the rectangle", where="two-way"
            )
        found = set[int]()
        for slab in self.slabs:
            if slab.low[0] <= place <= slab.high[1]:
                lines = self.heights(slab, place)
                inside = [low <= height <= high for low, high in pairwise(lines)]
                found |= {p for p, here in zip(slab.policies, inside, strict=True) if here}
        return found

    def heights(self, slab: Slab, x: Fraction) -> list[Fraction]:
        """Return where the cells of a slab begin and end above x, to 1e-12."""
        low, high = self.box[1].low, self.box[1].high
        found = [low]
        for f, number in slab.curves:
            every = [root for root, _ in _isolated([_at(f, 0, x)], self.box[1])]
            near = every[min(number, len(every) - 1)] if every else None
            found.append(found[-1] if near is None else (near.low + near.high) / 2)
        return [*found, high]


def exact_map(family: Parametric, x: str, y: str, box: Box) -> ExactMap:
    """Return the map of a rectangle; raises ModelError with the reason where none is proven."""
    plane, known, lines = _Plane(family, x, y, box), list[_Known](), _Lines(box)
    while not isinstance(made := _cells(known, lines, box), tuple):
        optimal = proven(family.at({x: made.x, y: made.y})).optimal_pairs
        every = plane.gaps(optimal)
        known.append(
            _Known(
                optimal=np.array([h.is_zero() for h in every]),
                open=[h for h in every if not h.is_zero() and not _one_sign(h, box)],
            )
        )
        lines.add(known[-1].open)
        if len(lines.factors) > FACTORS:
            raise ModelError(
                f"more than {FACTORS} switching lines",
                where=f"two-way of {x} and {y}",
                fix="choose a smaller rectangle",
            )
    optimal_pairs = tuple(each.optimal for each in known)
    return ExactMap(box=box, slabs=made, optimal=optimal_pairs, checked=plane.checked)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Known:
    """A policy that is optimal somewhere, and its h that may be negative in the rectangle."""

    optimal: NDArray[np.bool_]
    open: list[fmpq_mpoly]

    def holds(self, x: Fraction, y: Fraction) -> bool:
        return all(h(rational(x), rational(y)) >= 0 for h in self.open)


@dataclass(frozen=True, kw_only=True)
class _Unknown:
    """A point at which no policy that is known is optimal."""

    x: Fraction
    y: Fraction


class _Plane:
    """The rows of a model as polynomials of two parameters."""

    def __init__(self, family: Parametric, x: str, y: str, box: Box) -> None:
        where = f"two-way of {x} and {y}"
        for name, other, span, sides in ((x, y, box[0], box[1]), (y, x, box[1], box[0])):
            for end in (sides.low, sides.high):
                cuts = held_at(family, other, end).breakpoints(name)
                if any(span.low < cut < span.high for cut in cuts):
                    raise ModelError(
                        f"rows pass from one polynomial of {name} to another in the rectangle",
                        where=where,
                        fix="choose a rectangle between these values",
                    )
        across, along = box
        middle, degree = (across.low + across.high) / 2, max(family.degree(y), 1)
        proof = isinstance(unposed(family), ScenarioFamily)
        self.checked = None if proof else degree + 2
        count = degree + 1 if proof else degree + 2
        heights = [
            along.low + (along.high - along.low) * Fraction(k + 1, count + 1) for k in range(count)
        ]
        every = []
        for height in heights:
            here = held_at(family, y, height)
            base = here.at({x: middle})
            piece = Piece(low=across.low, high=across.high)
            change = row_change(here, x, piece, origin=middle, base=base)
            every.append(PolynomialRows.of(base, change))
        self.mdp, self.terminal = every[0].mdp, every[0].terminal
        self.context = flint.fmpq_mpoly_ctx.get(("x", "y"), "lex")
        points, shift = [*map(rational, heights)], flint.fmpq_poly([rational(-middle), 1])

        def both(given: Sequence[fmpq_poly]) -> Any:
            first = given[0]
            if first.degree() < 1 and all(each == first for each in given):
                return self.context.constant(first[0])
            rows = [each(shift) for each in given]
            terms: dict[tuple[int, int], Any] = {}
            for i in range(max(row.degree() for row in rows) + 1):
                column = interpolated(points, [row[i] for row in rows])
                if column.degree() > degree:
                    raise ModelError(
                        f"rows are not polynomials of degree {degree} in {y}",
                        where=where,
                        fix="state the degree of the family in this parameter",
                    )
                terms |= {(i, j): c for j, c in enumerate(column.coeffs()) if c}
            return self.context.from_dict(terms)

        if any(each.terminal != self.terminal for each in every):
            raise ModelError("terminal states change", where=where, fix="choose another rectangle")
        self.reward = [both(given) for given in zip(*(e.reward for e in every), strict=True)]
        self.following: list[list[tuple[int, fmpq_mpoly]]] = []
        nothing = flint.fmpq_poly()
        for given in zip(*(each.following for each in every), strict=True):
            tables = [dict(row) for row in given]
            ends = sorted({to for table in tables for to in table})
            own = [(to, both([table.get(to, nothing) for table in tables])) for to in ends]
            self.following.append(own)
        order = levels(self.mdp)
        state: list[int] = self.mdp.pair_state.tolist()
        if order is None or any(
            order[state[pair]] <= order[to]
            for pair, row in enumerate(self.following)
            for to, _ in row
        ):
            raise ModelError(
                "states lead back to each other",
                where=where,
                fix="give a horizon, or a model without cycles",
            )
        self.order: list[int] = np.argsort(order, kind="stable").tolist()

    def gaps(self, optimal: NDArray[np.bool_]) -> list[fmpq_mpoly]:
        """Return h of all pairs, for the policy that takes the first optimal pair of each state."""
        zero = self.context.constant(0)
        value, found = [zero] * self.mdp.n_states, [zero] * self.mdp.n_pairs
        for state in self.order:
            if self.terminal[state]:
                continue
            pairs = self.mdp.pairs_of(state)
            q = {}
            for pair in pairs:
                q[pair] = self.reward[pair]
                for to, p in self.following[pair]:
                    q[pair] = q[pair] + p * value[to]
            value[state] = q[next(pair for pair in pairs if optimal[pair])]
            for pair in pairs:
                found[pair] = value[state] - q[pair]
        return found


class _Lines:
    """The factors of polynomials that have roots in the rectangle, and the x where cells change."""

    def __init__(self, box: Box) -> None:
        self.box, self.factors = box, dict[str, Any]()
        self.critical = dict[str, Any]()

    def add(self, polynomials: Sequence[fmpq_mpoly]) -> None:
        """Add the factors of some polynomials."""
        for poly in polynomials:
            for factor, _ in poly.factor()[1]:
                if str(factor) in self.factors or _one_sign(factor, self.box):
                    continue
                if max(factor.degrees()) > DEGREE:
                    raise ModelError(
                        f"a switching line of degree {max(factor.degrees())}",
                        where="two-way",
                        fix=f"lines are proven up to degree {DEGREE}; choose other parameters",
                    )
                self._add(factor)

    def _add(self, new: fmpq_mpoly) -> None:
        up = new.degrees()[1]
        found = [_at(new, 1, 0)] if up == 0 else []
        if up:
            sides = (self.box[1].low, self.box[1].high)
            found += [_leading(new, up), *(_at(new, 1, side) for side in sides)]
            found += [_at(new.discriminant("y"), 1, 0)] if up > 1 else []
            found += [
                _at(new.resultant(other, "y"), 1, 0)
                for other in self.factors.values()
                if other.degrees()[1]
            ]
        for poly in found:
            for factor, _ in poly.numer().factor()[1] if poly.degree() > 0 else []:
                self.critical[str(factor)] = flint.fmpq_poly(factor)
        self.factors[str(new)] = new


def _cells(known: list[_Known], lines: _Lines, box: Box) -> tuple[Slab, ...] | _Unknown:
    """Return the slabs, or a point whose policy is not known."""
    across, along = box
    ends: list[Bracket] = [(across.low, across.low)]
    ends += [(root.low, root.high) for root, _ in _isolated(lines.critical.values(), across)]
    ends.append((across.high, across.high))
    slabs = []
    for low, high in pairwise(ends):
        x = (low[1] + high[0]) / 2
        columns = {key: _at(f, 0, x) for key, f in lines.factors.items() if f.degrees()[1]}
        lookup = {id(poly): lines.factors[key] for key, poly in columns.items()}
        found = _isolated(columns.values(), along)
        heights = [
            along.low,
            *(end for root, _ in found for end in (root.low, root.high)),
            along.high,
        ]
        policies: list[int] = []
        for begin, end in zip(heights[::2], heights[1::2], strict=True):
            y = (begin + end) / 2
            order = [*policies[-1:], *range(len(known))]
            policy = next((k for k in order if known[k].holds(x, y)), None)
            if policy is None:
                return _Unknown(x=x, y=y)
            policies.append(policy)
        numbers, curves = dict[int, int](), []
        for _, poly in found:
            numbers[id(poly)] = numbers.get(id(poly), -1) + 1
            curves.append((lookup[id(poly)], numbers[id(poly)]))
        turns = [k for k, (a, b) in enumerate(pairwise(policies)) if a != b]
        slabs.append(
            Slab(
                low=low,
                high=high,
                curves=tuple(curves[k] for k in turns),
                policies=(policies[0], *(policies[k + 1] for k in turns)),
            )
        )
    return tuple(slabs)


def _isolated(polynomials: Iterable[fmpq_poly], span: Range) -> list[tuple[Root, fmpq_poly]]:
    """Return the roots inside of polynomials without common ones, apart and in rising order."""
    found = [
        (root.narrowed(WIDTH), poly)
        for poly in polynomials
        for root in roots(simple(poly), span.low, span.high)
    ]
    width = WIDTH
    while True:
        found.sort(key=lambda each: (each[0].low, each[0].high))
        ends = [span.low, *(end for root, _ in found for end in (root.low, root.high)), span.high]
        if all(a < b for a, b in zip(ends[::2], ends[1::2], strict=True)):
            return found
        width /= 1024
        found = [(root.narrowed(width), poly) for root, poly in found]


def _at(f: fmpq_mpoly, axis: int, value: Fraction | int) -> fmpq_poly:
    """Return a polynomial at a value of x (axis 0) or of y (axis 1), in the other one."""
    found = [rational(0)] * (f.degrees()[1 - axis] + 1)
    for powers, c in f.to_dict().items():
        found[powers[1 - axis]] += c * rational(value) ** powers[axis]
    poly: fmpq_poly = flint.fmpq_poly(found)
    return poly


def _leading(f: fmpq_mpoly, up: int) -> fmpq_poly:
    """Return the coefficient of the greatest power of y."""
    found = [rational(0)] * (f.degrees()[0] + 1)
    for (i, j), c in f.to_dict().items():
        if j == up:
            found[i] = c
    poly: fmpq_poly = flint.fmpq_poly(found)
    return poly


def _one_sign(f: fmpq_mpoly, box: Box) -> bool:
    """Whether all coefficients in Bernstein's basis of the rectangle are above, or below, 0."""
    degrees = f.degrees()
    left, right = (_basis(degree, span) for degree, span in zip(degrees, box, strict=True))
    middle = flint.fmpq_mat(degrees[0] + 1, degrees[1] + 1)
    for (i, j), c in f.to_dict().items():
        middle[i, j] = c
    entries = (left.transpose() * middle * right).entries()
    return all(c > 0 for c in entries) or all(c < 0 for c in entries)


def _basis(degree: int, span: Range) -> Any:
    """Return in row i the coefficients of (a + b t)^i (1 + t)^(d - i)."""
    ends, one = flint.fmpq_poly([rational(span.low), rational(span.high)]), flint.fmpq_poly([1, 1])
    rows = [ends**i * one ** (degree - i) for i in range(degree + 1)]
    entries = [row[k] for row in rows for k in range(degree + 1)]
    return flint.fmpq_mat(degree + 1, degree + 1, entries)
