"""Affine arithmetic: numbers that depend on shared unknowns, with what is not linear bounded.

    x = c + Σ_j a_j ε_j + r η,    every ε_j in [-1, 1] and shared, η in [-1, 1] its own

Sums are exact but for rounding; a product keeps its linear part and adds what is left to r. Two
numbers that move together keep doing so in their difference, which plain intervals forget, and so
bounds over a box shrink with the square of its width (de Figueiredo and Stolfi, Numerical
Algorithms 37, 2004). Where the box is wide plain intervals may be narrower; each number carries one
beside its form, and both hold. A form whose r is as wide as the interval says nothing more than the
interval does, and is replaced by it, so that r cannot grow from product to product. Rounding errors
are added to each by its own size, so that every bound is sound in floats.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from mdp.table import Floats
from solvers.rounding import UNIT

ROUNDINGS = 16 * UNIT  # of one operation, relative to the sizes that go into it


@dataclass(frozen=True, kw_only=True, eq=False)
class Forms:
    """An array of numbers, each an affine form over J unknowns and an interval.

    Attributes
    ----------
    centre : (…)
    slope : (…, J)
    rest : (…)
        Not negative.
    low, high : (…)
        The number lies within, too.

    Examples
    --------
    >>> x = Forms.of(np.array(2.0), np.array([1.0]), np.array(0.0))
    >>> [round(float(end), 9) for end in (x.low, x.high)]
    [1.0, 3.0]
    >>> y = x - x.scaled(0.5)
    >>> [round(float(end), 9) for end in (y.low, y.high)]
    [0.5, 1.5]
    """

    centre: Floats
    slope: Floats
    rest: Floats
    low: Floats
    high: Floats

    @classmethod
    def of(
        cls,
        centre: Floats,
        slope: Floats,
        rest: Floats,
        within: tuple[Floats, Floats] | None = None,
    ) -> Self:
        """Return forms, each with the narrowest interval known: its own range, or `within`.

        `within` holds numbers that were rounded in their last operation.
        """
        count = slope.shape[-1] + 2
        reach = np.abs(slope).sum(axis=-1) + rest
        half = reach * (1 + 2 * count * UNIT) + 4 * UNIT * np.abs(centre)
        low, high = np.asarray(centre - half), np.asarray(centre + half)
        if within is not None:
            room = ROUNDINGS * (np.abs(within[0]) + np.abs(within[1]))
            low = np.maximum(low, within[0] - room)
            high = np.minimum(high, within[1] + room)
            # In whatever is linear in the number, r alone then weighs more than the interval.
            middle = (low + high) / 2
            half = np.maximum(high - middle, middle - low) * (1 + 4 * UNIT)
            idle = (rest > half) & (half > 0)
            centre, rest = np.where(idle, middle, centre), np.where(idle, half, rest)
            slope = np.where(idle[..., None], 0.0, slope)
        return cls(centre=centre, slope=slope, rest=rest, low=low, high=high)

    @classmethod
    def constant(cls, value: Floats, unknowns: int) -> Self:
        """Return numbers that depend on nothing."""
        centre = np.asarray(value, dtype=np.float64)
        return cls.of(centre, np.zeros((*centre.shape, unknowns)), np.zeros(centre.shape))

    @property
    def radius(self) -> Floats:
        """(…) how far the affine forms may be from their centres."""
        count = self.slope.shape[-1] + 2
        return np.asarray((np.abs(self.slope).sum(axis=-1) + self.rest) * (1 + count * 2 * UNIT))

    @property
    def size(self) -> Floats:
        """(…) an upper bound of the absolute values of what the forms may be."""
        return np.asarray(np.abs(self.centre) + self.radius)

    def __getitem__(self, key: object) -> Forms:
        """Return some of the forms; the key is one of the axes of `centre`."""
        keys = key if isinstance(key, tuple) else (key,)
        open_end = any(part is Ellipsis for part in keys)
        longer = (*keys, slice(None)) if open_end else (*keys, ...)
        return Forms(
            centre=self.centre[keys],
            slope=self.slope[longer],
            rest=self.rest[keys],
            low=self.low[keys],
            high=self.high[keys],
        )

    def __add__(self, other: Forms) -> Forms:
        centre, slope = self.centre + other.centre, self.slope + other.slope
        rest = self.rest + other.rest + ROUNDINGS * (self.size + other.size)
        return Forms.of(centre, slope, rest, (self.low + other.low, self.high + other.high))

    def __sub__(self, other: Forms) -> Forms:
        centre, slope = self.centre - other.centre, self.slope - other.slope
        rest = self.rest + other.rest + ROUNDINGS * (self.size + other.size)
        return Forms.of(centre, slope, rest, (self.low - other.high, self.high - other.low))

    def scaled(self, factor: Floats | float) -> Forms:
        """Return the forms times constants (…) of at least 0."""
        number = np.asarray(factor, dtype=np.float64)
        rest = number * (self.rest + ROUNDINGS * self.size)
        within = self.low * number, self.high * number
        return Forms.of(self.centre * number, self.slope * number[..., None], rest, within)

    def total(self, axis: int) -> Forms:
        """Return sums along an axis of `centre`, counted from the front."""
        share = self.centre.shape[axis] * ROUNDINGS
        doubt = share * self.size.sum(axis=axis)
        room = share * np.maximum(np.abs(self.low), np.abs(self.high)).sum(axis=axis)
        within = self.low.sum(axis=axis) - room, self.high.sum(axis=axis) + room
        return Forms.of(
            self.centre.sum(axis=axis),
            self.slope.sum(axis=axis),
            self.rest.sum(axis=axis) + doubt,
            within,
        )


def mixed(without: Forms, having: Forms, chance: Forms) -> Forms:
    """Return (1 - p) x + p y for a chance p in [0, 1], of which x and y need not be independent.

    That is x + p (y - x) with what is left of x and y weighed by p, too, not added up.

    Examples
    --------
    >>> one = Forms.constant(np.array(1.0), 1)
    >>> p = Forms.of(np.array(0.5), np.array([0.25]), np.array(0.0))
    >>> found = mixed(one, one.scaled(3.0), p)
    >>> round(float(found.low), 9), round(float(found.high), 9), found.slope.tolist()
    (1.5, 2.5, [0.5])
    """
    p = np.clip(chance.centre, 0.0, 1.0)
    moved = np.abs(chance.centre - p)
    apart = having.centre - without.centre
    slope = having.slope - without.slope
    rest = (1 - p) * without.rest + p * having.rest
    rest = rest + np.abs(apart) * (chance.rest + moved)
    rest = rest + (chance.radius + moved) * (
        np.abs(slope).sum(axis=-1) + without.rest + having.rest
    )
    least, most = np.clip(chance.low, 0.0, 1.0), np.clip(chance.high, 0.0, 1.0)
    below, above = having.low - without.low, having.high - without.high
    # Rounded several times: by the sizes of what goes in, form and interval each by its own.
    under = ROUNDINGS * (np.abs(without.low) + np.abs(having.low))
    over = ROUNDINGS * (np.abs(without.high) + np.abs(having.high))
    within = (
        without.low + np.minimum(least * below, most * below) - under,
        without.high + np.maximum(least * above, most * above) + over,
    )
    return Forms.of(
        without.centre + p * apart,
        without.slope + p[..., None] * slope + apart[..., None] * chance.slope,
        rest + 2 * ROUNDINGS * (without.size + having.size),
        within,
    )


def stacked(parts: list[Forms], axis: int = 0) -> Forms:
    """Return forms side by side along a new axis, counted from the front."""
    return Forms(
        centre=np.stack([part.centre for part in parts], axis=axis),
        slope=np.stack([part.slope for part in parts], axis=axis),
        rest=np.stack([part.rest for part in parts], axis=axis),
        low=np.stack([part.low for part in parts], axis=axis),
        high=np.stack([part.high for part in parts], axis=axis),
    )


def chained(first: Forms, rest: Forms) -> Forms:
    """Return forms (k,) and (n,) one after the other."""
    return Forms(
        centre=np.concatenate([first.centre, rest.centre]),
        slope=np.concatenate([first.slope, rest.slope]),
        rest=np.concatenate([first.rest, rest.rest]),
        low=np.concatenate([first.low, rest.low]),
        high=np.concatenate([first.high, rest.high]),
    )
