"""Affine arithmetic: numbers that depend on shared unknowns, with what is not linear bounded.

    x = c + Σ_j a_j ε_j + r η,    every ε_j in [-1, 1] and shared, η in [-1, 1] its own

Sums are exact but for rounding; a product keeps its linear part and adds what is left to r. Two
numbers that move together keep doing so in their difference, which plain intervals forget, and so
bounds over a box shrink with the square of its width (de Figueiredo and Stolfi, Numerical
Algorithms 37, 2004). Where the box is wide plain intervals may be narrower; each number carries one
beside its form, and both hold. A form whose r is as wide as the interval says nothing more than the
interval does, and is replaced by it, so that r cannot grow from product to product. Rounding errors
are added to each by its own size, so that every bound is sound in floats.

Expectations over independent events in affine forms, with bounds on their derivatives.

Whether each of n events happens is drawn independently with chance p_i. The expectation of X, which
has a value for each of the 2^n outcomes, is taken event by event,

    X ← X|0 + p_i (X|1 - X|0),     i = 1 … n.

Where a chance p_i is a sum with parameter j in it, the derivative by θ_j is

    ∂_j E X = Σ_i [j in p_i] Δ_i + E ∂_j X,     Δ_i = E[X|1 - X|0],

Δ_i in affine forms (`analysis.sensitivity.robust.affine`), the derivatives of X in intervals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import UNIT

ROUNDINGS = 16 * UNIT  # of one operation, relative to the sizes that go into it


Span = tuple[Floats, Floats]  # lower and upper bounds
OUT = 1e-13  # intervals are widened by this share of their size after each step


@dataclass(frozen=True, eq=False)
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
        within: Span | None = None,
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
            **{name: part[longer if name == "slope" else keys] for name, part in vars(self).items()}
        )

    def __add__(self, other: Forms) -> Forms:
        within = self.low + other.low, self.high + other.high
        return self._combined(other, self.centre + other.centre, self.slope + other.slope, within)

    def __sub__(self, other: Forms) -> Forms:
        within = self.low - other.high, self.high - other.low
        return self._combined(other, self.centre - other.centre, self.slope - other.slope, within)

    def _combined(self, other: Forms, centre: Floats, slope: Floats, within: Span) -> Forms:
        rest = self.rest + other.rest + ROUNDINGS * (self.size + other.size)
        return Forms.of(centre, slope, rest, within)

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


def stacked(parts: list[Forms]) -> Forms:
    """Return forms side by side along a new axis, the first."""
    return Forms(*map(np.stack, zip(*(vars(part).values() for part in parts), strict=True)))


def chained(first: Forms, rest: Forms) -> Forms:
    """Return forms (k,) and (n,) one after the other."""
    pairs = zip(vars(first).values(), vars(rest).values(), strict=True)
    return Forms(*(np.concatenate(pair) for pair in pairs))


def expected(payoff: Forms, slopes: Span, chance: Forms, use: Span) -> tuple[Forms, Span]:
    """Return E[payoff] over independent bits, and bounds of its derivatives.

    Parameters
    ----------
    payoff : (…, 2^n) forms
    slopes : (…, 2^n, J) bounds of the derivatives of payoffs
    chance : (…, n) forms
    use : (…, n, J) the least and the greatest share of each unknown in a chance

    Examples
    --------
    >>> chance = Forms.of(np.array([0.5]), np.array([[0.1]]), np.zeros(1))
    >>> payoff, flat = Forms.constant(np.array([0.0, 10.0]), 1), np.zeros((2, 1))
    >>> value, (low, high) = expected(payoff, (flat, flat), chance, (np.ones((1, 1)),) * 2)
    >>> float(value.centre), value.slope.tolist(), low.round(9).tolist(), high.round(9).tolist()
    (5.0, [1.0], [10.0], [10.0])
    """
    count = chance.centre.shape[-1]
    least, most = (np.clip(end, 0.0, 1.0) for end in (chance.low, chance.high))
    low, high = slopes
    for bit in range(count):  # the most significant bit first
        half = low.shape[-2] // 2
        p, q = least[..., bit, None, None], most[..., bit, None, None]
        apart = low[..., half:, :] - low[..., :half, :]
        low = low[..., :half, :] + np.minimum(p * apart, q * apart)
        apart = high[..., half:, :] - high[..., :half, :]
        high = high[..., :half, :] + np.maximum(p * apart, q * apart)
    low, high = low[..., 0, :], high[..., 0, :]
    for bit in range(count):
        on = (np.arange(2**count) >> (count - 1 - bit)) & 1 == 1
        flipped = payoff[..., np.flatnonzero(on)] - payoff[..., np.flatnonzero(~on)]
        ahead = _averaged(flipped, [chance[..., n : n + 1] for n in range(count) if n != bit])
        down, up = ahead.low[..., None], ahead.high[..., None]
        sure, moving = (part[..., bit, :] for part in use)
        low = low + np.where(down < 0, moving * down, sure * down)
        high = high + np.where(up > 0, moving * up, sure * up)
    total = _averaged(payoff, [chance[..., n : n + 1] for n in range(count)])
    return total, wider(low, high)


def _averaged(payoff: Forms, chances: list[Forms]) -> Forms:
    """Return expectations over bits, the most significant first, of (…, 2^n) forms."""
    for chance in chances:
        half = payoff.centre.shape[-1] // 2
        payoff = mixed(payoff[..., :half], payoff[..., half:], chance)
    return payoff[..., 0]


def wider(low: Floats, high: Floats) -> Span:
    """Return intervals that contain what rounding may have left out."""
    room = OUT * (np.abs(low) + np.abs(high))
    return low - room, high + room
