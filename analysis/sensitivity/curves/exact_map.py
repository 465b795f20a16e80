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
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.gate.regret import proven
from exact_mdp.analysis.sensitivity.curves.map_checker import Slab, map_violations
from exact_mdp.analysis.sensitivity.curves.plane import (
    Box,
    Bracket,
    Plane,
    leading,
    one_sign,
    sliced,
    undecided,
)
from exact_mdp.analysis.sensitivity.curves.real_roots import Root, roots, simple
from exact_mdp.analysis.sensitivity.ranges import Range
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.parametric.symbolic import rational
from exact_mdp.mdp.table import exact, shown
from exact_mdp.solvers.solution import Claim

if TYPE_CHECKING:
    from flint import fmpq_mpoly, fmpq_poly

flint = later("flint")

WIDTH = Fraction(1, 10**12)
FACTORS = 80  # polynomials with a root in the rectangle
DEGREE = 8  # of each of them in either parameter


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
    family : Parametric
    names : (str, str)
        The parameters.
    """

    box: Box
    slabs: tuple[Slab, ...]
    optimal: tuple[NDArray[np.bool_], ...]
    checked: int | None
    family: Parametric
    names: tuple[str, str]

    @property
    def claim(self) -> Claim:
        """Certified, or checked where the degree of the rows is checked and not proven."""
        return Claim.CERTIFIED if self.checked is None else Claim.CHECKED

    @cached_property
    def _known(self) -> list[_Known]:
        """What may be negative of each policy's h."""
        plane = Plane(self.family, *self.names, self.box)
        each = ((own, undecided(plane.gaps(own), self.box)) for own in self.optimal)
        return [_Known(optimal=own, open=open_) for own, open_ in each]

    def at(self, x: object, y: object) -> set[int]:
        """Return the numbers of the policies that are optimal at a point: on a line, several.

        No h of theirs is negative there: the point may be on a line or where lines end.
        """
        place, height = exact(x), exact(y)
        if not all(e.low <= at <= e.high for e, at in zip(self.box, (place, height), strict=True)):
            raise ModelError(
                f"({shown(place)}, {shown(height)}) is outside the rectangle", where="two-way"
            )
        return {number for number, own in enumerate(self._known) if own.holds(place, height)}

    def violations(self) -> list[str]:
        """Return what does not hold of the map, in words: nothing where it is sound."""
        plane = Plane(self.family, *self.names, self.box)
        return map_violations(plane, self.box, self.slabs, self.optimal)

    def heights(self, slab: Slab, x: Fraction) -> list[Fraction]:
        """Return where the cells of a slab begin and end above an x inside of it, to 1e-12."""
        found = [self.box[1].low]
        for f, number in slab.curves:
            root, _ = _isolated([sliced(f, 0, x)], self.box[1])[number]
            found.append((root.low + root.high) / 2)
        return [*found, self.box[1].high]


def exact_map(family: Parametric, x: str, y: str, box: Box) -> ExactMap:
    """Return the map of a rectangle; raises ModelError with the reason where none is proven."""
    plane, known, lines = Plane(family, x, y, box), list[_Known](), _Lines(box)
    while not isinstance(made := _cells(known, lines, box), tuple):
        optimal = proven(family.at({x: made.x, y: made.y})).optimal_pairs
        every = plane.gaps(optimal)
        known.append(
            _Known(
                optimal=np.array([h.is_zero() for h in every]),
                open=undecided(every, box),
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
    return ExactMap(
        box=box,
        slabs=made,
        optimal=optimal_pairs,
        checked=plane.checked,
        family=family,
        names=(x, y),
    )


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


class _Lines:
    """The factors of polynomials that have roots in the rectangle, and the x where cells change."""

    def __init__(self, box: Box) -> None:
        self.box, self.factors = box, dict[str, Any]()
        self.critical = dict[str, Any]()

    def add(self, polynomials: Sequence[fmpq_mpoly]) -> None:
        """Add the factors of some polynomials."""
        for poly in polynomials:
            for factor, _ in poly.factor()[1]:
                if str(factor) in self.factors or one_sign(factor, self.box):
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
        found = [sliced(new, 1, 0)] if up == 0 else []
        if up:
            sides = (self.box[1].low, self.box[1].high)
            found += [leading(new, up), *(sliced(new, 1, side) for side in sides)]
            found += [sliced(new.discriminant("y"), 1, 0)] if up > 1 else []
            found += [
                sliced(new.resultant(other, "y"), 1, 0)
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
        columns = {key: sliced(f, 0, x) for key, f in lines.factors.items() if f.degrees()[1]}
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
