"""What a policy falls short of each action, as polynomials of two parameters on a rectangle.

Rows are polynomials of both parameters where they are of each one, whatever the other's value. The
rules of a care scenario say so, between values at which chances are cut off: a chance is a sum of
products in which no parameter stands twice, so that it is cut off nowhere inside if it is so on no
side of the rectangle. For other families it is checked at points.

Maps are made (`.exact_map`) and checked (`.map_checker`) from these polynomials; nothing is solved.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.sensitivity.base_case import held_at
from exact_mdp.analysis.sensitivity.curves.gap_polynomials import interpolated
from exact_mdp.analysis.sensitivity.ranges import Range
from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.chain import topological_levels
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.parametric.family import unposed
from exact_mdp.mdp.parametric.polynomial_rows import PolynomialRows
from exact_mdp.mdp.parametric.row_change import Piece, row_change
from exact_mdp.mdp.parametric.symbolic import rational

if TYPE_CHECKING:
    from flint import fmpq_mpoly, fmpq_poly

flint = later("flint")

Bracket = tuple[Fraction, Fraction]
Box = tuple[Range, Range]


class Plane:
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
        order = topological_levels(self.mdp)
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


def sliced(f: fmpq_mpoly, axis: int, value: Fraction | int) -> fmpq_poly:
    """Return a polynomial at a value of x (axis 0) or of y (axis 1), in the other one."""
    found = [rational(0)] * (f.degrees()[1 - axis] + 1)
    for powers, c in f.to_dict().items():
        found[powers[1 - axis]] += c * rational(value) ** powers[axis]
    poly: fmpq_poly = flint.fmpq_poly(found)
    return poly


def leading(f: fmpq_mpoly, up: int) -> fmpq_poly:
    """Return the coefficient of the greatest power of y."""
    found = [rational(0)] * (f.degrees()[0] + 1)
    for (i, j), c in f.to_dict().items():
        if j == up:
            found[i] = c
    poly: fmpq_poly = flint.fmpq_poly(found)
    return poly


def one_sign(f: fmpq_mpoly, box: Box) -> bool:
    """Whether all coefficients in Bernstein's basis of the rectangle are above, or below, 0."""
    degrees = f.degrees()
    left, right = (_basis(degree, span) for degree, span in zip(degrees, box, strict=True))
    middle = flint.fmpq_mat(degrees[0] + 1, degrees[1] + 1)
    for (i, j), c in f.to_dict().items():
        middle[i, j] = c
    entries = (left.transpose() * middle * right).entries()
    return all(c > 0 for c in entries) or all(c < 0 for c in entries)


def undecided(gaps: Sequence[fmpq_mpoly], box: Box) -> list[fmpq_mpoly]:
    """Return the h that are negative in the rectangle, or may be."""
    corner = [rational(span.low) for span in box]
    return [h for h in gaps if not h.is_zero() and not (one_sign(h, box) and h(*corner) > 0)]


def _basis(degree: int, span: Range) -> Any:
    """Return in row i the coefficients of (a + b t)^i (1 + t)^(d - i)."""
    ends, one = flint.fmpq_poly([rational(span.low), rational(span.high)]), flint.fmpq_poly([1, 1])
    rows = [ends**i * one ** (degree - i) for i in range(degree + 1)]
    entries = [row[k] for row in rows for k in range(degree + 1)]
    return flint.fmpq_mat(degree + 1, degree + 1, entries)
