"""Sets of laws around a row: intervals and L1 balls, and what nature picks from them.

Intervals (Givan, Leach and Dean, Artificial Intelligence 122, 2000; Nilim and El Ghaoui,
Operations Research 53, 2005):

    {q : lower_i ≤ q_i ≤ upper_i, Σ q_i = 1}

Least Σ q x: outcomes in rising order of x get their upper bound as long as the rest can still have
its lower bound. L1 balls {q : Σ |q_i - p_i| ≤ ρ} (Strehl and Littman, Journal of Computer and
System Sciences 74, 2008): ρ/2 of the mass moves from the greatest x to the least. Both are exact up
to rounding. Outcomes that a row does not have stay impossible. Sets of all rows are independent,
and nature chooses anew whenever a pair is used, knowing state and action (a dynamic model; Iyengar,
Mathematics of Operations Research 30, 2005): for the stationary policies here a nature that chooses
once and for all does as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import FLOAT_ROW_TOLERANCE, Floats, Integers, exact, float_array
from exact_mdp.solvers.bounds.gains import UNIT
from exact_mdp.solvers.robust.rows import Block


@dataclass(frozen=True, kw_only=True, eq=False)
class Intervals:
    """Every probability within its own interval, by outcome of the model's table.

    Attributes
    ----------
    lower, upper : (N,)
        In the order of `mdp.table.next`. Make them with `relative`, `absolute` or
        `interval_model`.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> found = Intervals.relative(mdp, 0.2)
    >>> found.lower.tolist(), found.upper.tolist()
    ([0.4, 0.4, 0.8], [0.6, 0.6, 1.0])
    """

    lower: Floats
    upper: Floats

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            array = float_array(getattr(self, name)).copy()
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def relative(cls, mdp: MDP, share: object) -> Intervals:
        """Return p (1 ± share) within [0, 1]; below a share of 1 every outcome stays possible."""
        part = radius_of(share, "a relative radius")
        p = mdp.table.probabilities()
        return cls(lower=np.maximum(p * (1 - part), 0.0), upper=np.minimum(p * (1 + part), 1.0))

    @classmethod
    def absolute(cls, mdp: MDP, width: object) -> Intervals:
        """Return p ± width within [0, 1]."""
        part = radius_of(width, "a radius")
        p = mdp.table.probabilities()
        return cls(lower=np.maximum(p - part, 0.0), upper=np.minimum(p + part, 1.0))

    def check(self, mdp: MDP) -> None:
        """Raise ModelError where a row has no law within its intervals."""
        shape = mdp.table.next.shape
        if self.lower.shape != shape or self.upper.shape != shape:
            raise ModelError(
                f"bounds of shapes {self.lower.shape} and {self.upper.shape}, not {shape}",
                where="intervals",
                fix="give one bound for each outcome of the model's table",
            )
        first = mdp.table.offsets[:-1]
        good = (self.lower >= 0) & (self.lower <= self.upper) & (self.upper <= 1)  # no NaN passes
        least, most = np.add.reduceat(self.lower, first), np.add.reduceat(self.upper, first)
        bad = ~np.logical_and.reduceat(good, first)
        bad |= ~((least <= 1 + FLOAT_ROW_TOLERANCE) & (most >= 1 - FLOAT_ROW_TOLERANCE))
        if bad.any():
            pair = int(np.flatnonzero(bad)[0])
            raise ModelError(
                "no law lies within the intervals of a row: lower bounds sum to "
                f"{least[pair]:g}, upper bounds to {most[pair]:g}",
                where=mdp.where(pair),
                fix="give 0 ≤ lower ≤ upper ≤ 1 with sums below and above 1",
            )

    def least(self, block: Block, payoff: Floats) -> tuple[Floats, Floats]:
        """See `Ambiguity.least`."""
        lower = np.where(block.filled, 0.0, self.lower[block.outcome])
        room = np.where(block.filled, 0.0, self.upper[block.outcome]) - lower
        order = np.argsort(payoff, axis=1)
        room = np.take_along_axis(room, order, axis=1)
        before = np.cumsum(room, axis=1) - room
        given = np.clip(1 - lower.sum(axis=1)[:, None] - before, 0.0, room)
        given += np.take_along_axis(lower, order, axis=1)
        np.put_along_axis(lower, order, given, axis=1)
        return lower, np.zeros(len(lower))


@dataclass(frozen=True, kw_only=True, eq=False)
class L1Ball:
    """Laws within an L1 distance of the nominal row: Σ |q - p| ≤ radius, from 0 to 2.

    Attributes
    ----------
    radius : float or (L,)
        One for all pairs, or one for each.
    """

    radius: Any

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", radii_of(self.radius, "an L1 radius"))

    def check(self, mdp: MDP) -> None:
        """Raise ModelError unless there is a radius for each pair."""
        check_radii(self.radius, mdp)

    def least(self, block: Block, payoff: Floats) -> tuple[Floats, Floats]:
        """See `Ambiguity.least`."""
        p = block.probability
        order = np.argsort(-payoff, axis=1)
        lowest = order[:, -1:]
        mass = np.take_along_axis(p, order, axis=1)
        free = 1 - mass[:, -1]
        moved = np.minimum(of_pairs(self.radius, block) / 2, free)[:, None]
        before = np.cumsum(mass, axis=1) - mass
        taken = np.clip(moved - before, 0.0, mass)
        # An outcome that is taken all but for rounding is taken whole: it becomes impossible.
        mass = np.where(taken >= mass - 8 * UNIT, 0.0, mass - taken)
        q = np.empty_like(p)
        np.put_along_axis(q, order, mass, axis=1)
        gained = np.take_along_axis(q, lowest, axis=1) + moved
        np.put_along_axis(q, lowest, gained, axis=1)
        return q, np.zeros(len(q))


def interval_model(
    rows: Iterable[tuple[int, int, Sequence[tuple[Any, Any, int, Any]]]],
    discount: object = 1,
    **names: Any,
) -> tuple[MDP, Intervals]:
    """Return an interval MDP: a model with a law inside the intervals of each row, and these.

    Parameters
    ----------
    rows : (state, action, [(lower, upper, next state, reward), …]), …
    discount, **names
        As in `MDP.from_outcomes`.

    Raises
    ------
    ModelError
        Where a row has no law within its intervals.

    Examples
    --------
    >>> mdp, intervals = interval_model(
    ...     [
    ...         (0, 0, [("0.4", "0.9", 1, 1), ("0.5", "0.8", 2, 0)]),
    ...         (1, 0, [(1, 1, 1, 0)]),
    ...         (2, 0, [(1, 1, 2, 0)]),
    ...     ]
    ... )
    >>> mdp.table.row(0)[0][0], intervals.lower[:2].tolist()
    (Fraction(37, 80), [0.4, 0.5])
    """
    outcomes = []
    bounds: dict[tuple[int, int], list[tuple[int, Fraction, Fraction, Fraction, Fraction]]] = {}
    for state, action, listed in rows:
        row = [(exact(low), exact(high), to, exact(gain)) for low, high, to, gain in listed]
        least = sum((low for low, *_ in row), Fraction(0))
        room = sum((high - low for low, high, *_ in row), Fraction(0))
        wrong = any(not 0 <= low <= high <= 1 for low, high, *_ in row)
        if wrong or not least <= 1 <= least + room:
            raise ModelError(
                "no law lies within the intervals of a row",
                where=f"state {state}, action {action}",
                fix="give 0 ≤ lower ≤ upper ≤ 1 with sums below and above 1",
            )
        share = (1 - least) / room if room else Fraction(0)
        law = [(low + share * (high - low), to, gain) for low, high, to, gain in row]
        outcomes.append((state, action, [each for each in law if each[0]]))
        for (low, high, *_), (p, to, gain) in zip(row, law, strict=True):
            if p:
                bounds.setdefault((state, action), []).append((to, gain, p, low, high))
    mdp = MDP.from_outcomes(outcomes, discount, **names)
    lower, upper = [], []
    for pair in range(mdp.n_pairs):
        waiting = list(bounds[int(mdp.pair_state[pair]), int(mdp.pair_action[pair])])
        for p, to, gain in mdp.table.row(pair):
            found = next((k for k, each in enumerate(waiting) if each[:3] == (to, gain, p)), None)
            if found is None:  # outcomes alike in state and reward were added up
                alike = [each for each in waiting if each[:2] == (to, gain)]
                waiting = [each for each in waiting if each[:2] != (to, gain)]
                low = sum((each[3] for each in alike), Fraction(0))
                high = min(sum((each[4] for each in alike), Fraction(0)), Fraction(1))
            else:
                _, _, _, low, high = waiting.pop(found)
            lower.append(float(low))
            upper.append(float(high))
    intervals = Intervals(lower=np.array(lower), upper=np.array(upper))
    intervals.check(mdp)
    return mdp, intervals


def radius_of(given: object, what: str) -> float:
    """Return a radius as a float; raises ModelError unless it is finite and at least 0."""
    number = float(given) if isinstance(given, float | int | np.number) else float(exact(given))
    if not 0 <= number < np.inf:
        raise ModelError(f"{what} of {number:g}", where="radius", fix="choose one from 0 up")
    return number


def radii_of(given: object, what: str) -> float | Floats:
    """Return one radius, or one for each pair (L,), checked as `radius_of` does."""
    if not isinstance(given, np.ndarray | list | tuple):
        return radius_of(given, what)
    numbers = float_array(given).copy()
    if numbers.ndim != 1 or not np.all((numbers >= 0) & (numbers < np.inf)):
        raise ModelError(f"{what} that is negative or no number", where="radius", fix="mend it")
    numbers.setflags(write=False)
    return numbers


def check_radii(radius: float | Floats, mdp: MDP) -> None:
    """Raise ModelError unless there is one radius, or one for each pair."""
    if isinstance(radius, np.ndarray) and len(radius) != mdp.n_pairs:
        raise ModelError(
            f"{len(radius)} radii for {mdp.n_pairs} pairs", where="radius", fix="give one for each"
        )


def of_pairs(radius: float | Floats, block: Block) -> Floats:
    """Return (K,) the radius of each row of a block."""
    each: Integers = block.pair
    return radius[each] if isinstance(radius, np.ndarray) else np.full(len(each), radius)
