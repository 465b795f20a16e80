"""For which values of a parameter the regret of a fixed policy keeps a limit, exactly.

With V* = N / D and V_π = M / E on a piece (`.checker`), D > 0 and E > 0,

    V* - V_π ≤ x + ρ |V*|   where   x D E ± ρ N E - (N E - M D) ≥ 0   for one sign,

so that the ends of the intervals are roots of these polynomials, or breakpoints of V*. At a root
the limit is kept, and between two of them everywhere or nowhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from math import prod
from typing import TYPE_CHECKING

import flint

from exact_mdp.analysis.vary.curves.checker import Bracket, CurvePiece
from exact_mdp.analysis.vary.curves.real_roots import roots, sign, simple
from exact_mdp.mdp.exact import rational

if TYPE_CHECKING:
    from flint import fmpq_poly


WIDTH = Fraction(1, 10**12)


@dataclass(frozen=True, kw_only=True)
class Interval:
    """An interval of a parameter, ends included; each end is in its bracket.

    One whose ends share a bracket is at most 1e-12 wide, and may be empty.
    """

    low: Bracket
    high: Bracket


def kept(
    pieces: Sequence[CurvePiece],
    start: Sequence[tuple[int, Fraction]],
    *,
    most: Fraction = Fraction(0),
    share: Fraction = Fraction(0),
) -> tuple[Interval, ...]:
    """Return where the regret is at most `most` plus a share of the absolute optimal value."""
    found, begun, before = list[Interval](), None, list[_Limit]()
    for piece in pieces:
        limit = _Limit(piece, start, most, share)
        cells = [*limit.cells()]
        joint, (begins, _) = piece.low, cells[0]
        turns = any(each.turns(joint) for each in (*before, limit))
        if begun is not None and (not begins or (turns and joint[0] < joint[1])):
            found.append(Interval(low=begun, high=joint))
            begun = None
        elif begun is None and turns and not begins:
            found.append(Interval(low=joint, high=joint))
        if begins and begun is None:
            begun = joint
        for (keeps, until), (after, _) in pairwise(cells):
            if not after:
                found.append(Interval(low=until if begun is None else begun, high=until))
            begun = (begun if keeps else until) if after else None
        before = [limit]
    end = pieces[-1].high
    if begun is not None or before[0].turns(end):
        found.append(Interval(low=end if begun is None else begun, high=end))
    return tuple(found)


class _Limit:
    """The limit on one piece: kept where one of its polynomials is not negative."""

    def __init__(
        self,
        piece: CurvePiece,
        start: Sequence[tuple[int, Fraction]],
        most: Fraction,
        share: Fraction,
    ) -> None:
        assert piece.fixed_values is not None
        self.piece, self.origin = piece, piece.section.origin
        (best, d), (mine, e) = (
            (sum((rational(w) * tops[s] for s, w in start), flint.fmpq_poly()), below)
            for tops, below in (piece.values, piece.fixed_values)
        )
        room = rational(most) * d * e - (best * e - mine * d)
        more = rational(share) * best * e
        self.sides: list[fmpq_poly] = [room + more, room - more]
        nonzero = [side for side in self.sides if side.degree() >= 0]
        self.every = simple(prod(nonzero, start=flint.fmpq_poly([1])))

    def cells(self) -> Iterator[tuple[bool, Bracket]]:
        """Yield whether each cell between roots keeps the limit, and the bracket of its end."""
        here, high = self.piece.low[1] - self.origin, self.piece.high[0] - self.origin
        for root in roots(self.every, here, high):
            near = root.narrowed(WIDTH).simplest().beyond(here)
            bracket = near.low + self.origin, near.high + self.origin
            yield self._keeps(here, near.low), bracket
            here = near.high
        yield self._keeps(here, high), self.piece.high

    def _keeps(self, low: Fraction, high: Fraction) -> bool:
        """Whether the limit is kept between two points without a root between them."""
        middle = (low + high) / 2
        return any(sign(side, middle) >= 0 for side in self.sides)

    def turns(self, bracket: Bracket) -> bool:
        """Whether there is a root in a bracket, its ends included."""
        low, high = (end - self.origin for end in bracket)
        at_end = 0 in (sign(self.every, low), sign(self.every, high))
        return at_end or any(True for _ in roots(self.every, low, high))
