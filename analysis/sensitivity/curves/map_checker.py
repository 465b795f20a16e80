"""Checks a map of two parameters: in each cell its policy is optimal, and cells cover all.

For the policy of a cell, what it falls short of every action has to be a polynomial h(x, y) ≥ 0
there (`.plane`; the model is acyclic, so that the Bellman equations have one solution). Between two
neighbouring x of the map, with f the irreducible factors of all h that have both signs in the
rectangle, and those whose roots separate cells,

    the leading coefficients of all f in y, their discriminants, the resultants of each two of
    them, and all f on the lower and the upper side of the rectangle

must have no root. Then the roots y(x) of all f neither meet, nor end, nor leave, and each f has one
sign between two of them (Basu, Pollack and Roy, Algorithms in Real Algebraic Geometry, 2006,
chapter 5). So the signs at points between the roots above one x prove those of the whole slab.

That nothing has a root is counted by Sturm's theorem; no model is solved.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.sensitivity.curves.plane import (
    Box,
    Bracket,
    Plane,
    leading,
    one_sign,
    sliced,
    undecided,
)
from exact_mdp.analysis.sensitivity.curves.real_roots import roots, sign, simple, variations
from exact_mdp.analysis.sensitivity.curves.signs import vanishes
from exact_mdp.mdp.table import shown

if TYPE_CHECKING:
    from flint import fmpq_mpoly, fmpq_poly

FINE = Fraction(1, 10**15)  # of the height of the rectangle: roots are told apart so far


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


def map_violations(
    plane: Plane, box: Box, slabs: Sequence[Slab], optimal: Sequence[NDArray[np.bool_]]
) -> list[str]:
    """Return what does not hold of a map, in words: nothing where it is sound."""
    across = box[0]
    ends = [(across.low, across.low), *(slab.high for slab in slabs)]
    if (
        not slabs
        or [slab.low for slab in slabs] != ends[:-1]
        or ends[-1] != (across.high, across.high)
        or any(not a[0] <= a[1] < b[0] for a, b in pairwise(ends))
    ):
        return ["the slabs do not cover the rectangle"]
    wrong = list[str]()
    open_: dict[int, list[fmpq_mpoly]] = {}
    for number in sorted({policy for slab in slabs for policy in slab.policies}):
        pairs = (plane.mdp.pairs_of(s) for s in plane.order if not plane.terminal[s])
        if not all(any(optimal[number][pair] for pair in own) for own in pairs):
            return [f"policy {number} takes no pair of some state"]
        every = plane.gaps(optimal[number])
        wrong += _not_marked(plane, optimal[number], every, number)
        open_[number] = undecided(every, box)
    factors = {
        str(f): f
        for polynomials in [*open_.values(), [f for slab in slabs for f, _ in slab.curves]]
        for poly in polynomials
        for f, _ in poly.factor()[1]
        if not one_sign(f, box)
    }
    critical = _critical(list(factors.values()), box)
    for slab in slabs:
        low, high = slab.low[1], slab.high[0]
        if any(_has_root(poly, low, high) for poly in critical):
            wrong.append(f"lines meet or end between {shown(low)} and {shown(high)}")
        elif not _signs_hold(slab, box, list(factors.values()), open_):
            wrong.append(f"a policy is not optimal between {shown(low)} and {shown(high)}")
    return wrong


def _not_marked(
    plane: Plane, optimal: NDArray[np.bool_], gaps: Sequence[fmpq_mpoly], number: int
) -> Iterator[str]:
    """Yield where the pairs said to be optimal are not all that lose nothing anywhere."""
    for state in plane.order:
        pairs = plane.mdp.pairs_of(state)
        marked = [bool(optimal[pair]) for pair in pairs]
        zero = [bool(gaps[pair].is_zero()) for pair in pairs]
        if not plane.terminal[state] and marked != zero:
            yield f"the pairs of policy {number} in state {state} are others"


def _critical(factors: Sequence[fmpq_mpoly], box: Box) -> list[fmpq_poly]:
    """Return the polynomials of x that must not have roots inside of slabs, without double ones.

    A line along a side of the rectangle is never inside.
    """
    across, along = box
    found: dict[str, fmpq_poly] = {}
    curved = [f for f in factors if f.degrees()[1]]
    every = [sliced(f, 1, 0) for f in factors if not f.degrees()[1]]
    every += [sliced(f.resultant(g, "y"), 1, 0) for f, g in combinations(curved, 2)]
    for f in curved:
        sides = (sliced(f, 1, y) for y in (along.low, along.high))
        every += [leading(f, f.degrees()[1]), *(each for each in sides if each.degree() >= 0)]
        every += [sliced(f.discriminant("y"), 1, 0)] if f.degrees()[1] > 1 else []
    for poly in every:
        single = simple(poly)
        if single.degree() > 0 and variations(single, across.low, across.high):
            found[str(single / single[single.degree()])] = single
        elif single.degree() < 0:
            found["0"] = single
    return list(found.values())


def _has_root(poly: fmpq_poly, low: Fraction, high: Fraction) -> bool:
    """Whether a polynomial without double roots has one between; 0 has them everywhere."""
    return poly.degree() < 0 or (variations(poly, low, high) > 0 and vanishes(poly, low, high))


def _signs_hold(
    slab: Slab, box: Box, factors: Sequence[fmpq_mpoly], open_: dict[int, list[fmpq_mpoly]]
) -> bool:
    """Whether, above one x, no policy of the slab is worse than any action at points of its cell.

    There is a point between each two roots of the factors; lines without a root there are none.
    """
    along = box[1]
    x = (slab.low[1] + slab.high[0]) / 2
    heights = list[tuple[Fraction, Fraction, str, int]]()
    for f in factors:
        column = sliced(f, 0, x) if f.degrees()[1] else None
        for number, root in enumerate(roots(column, along.low, along.high) if column else ()):
            near = root
            while near.low < near.high and near.high - near.low > FINE * (along.high - along.low):
                near = near.narrowed((near.high - near.low) / 1024)
            heights.append((near.low, near.high, str(f), number))
    heights.sort()
    lines = [(str(f), number) for f, number in slab.curves]
    if len(slab.policies) != len(lines) + 1:
        return False
    edges = [along.low, *(y for low, high, _, _ in heights for y in (low, high)), along.high]
    cell = 0
    for place, (below, above) in enumerate(zip(edges[::2], edges[1::2], strict=True)):
        if place and cell < len(lines) and heights[place - 1][2:] == lines[cell]:
            cell += 1
        y = (below + above) / 2
        if not below < above or any(
            sign(sliced(h, 0, x), y) < 0 for h in open_[slab.policies[cell]]
        ):
            return False
    return cell == len(lines)
