"""Expectations over independent events in affine forms, with bounds on their derivatives.

Whether each of n events happens is drawn independently with chance p_i. The expectation of X, which
has a value for each of the 2^n outcomes, is taken event by event,

    X ← X|0 + p_i (X|1 - X|0),     i = 1 … n.

Where a chance p_i is a sum with parameter j in it, the derivative by θ_j is

    ∂_j E X = Σ_i [j in p_i] Δ_i + E ∂_j X,     Δ_i = E[X|1 - X|0],

Δ_i in affine forms (`analysis.sensitivity.affine_forms`), the derivatives of X in intervals.
"""

from __future__ import annotations

import numpy as np

from analysis.sensitivity.affine_forms import Forms, mixed
from mdp.table import Floats

Span = tuple[Floats, Floats]  # lower and upper bounds
OUT = 1e-13  # intervals are widened by this share of their size after each step


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
    for _bit in range(count):  # the most significant bit first
        half = low.shape[-2] // 2
        p, q = least[..., _bit, None, None], most[..., _bit, None, None]
        apart = low[..., half:, :] - low[..., :half, :]
        low = low[..., :half, :] + np.minimum(p * apart, q * apart)
        apart = high[..., half:, :] - high[..., :half, :]
        high = high[..., :half, :] + np.maximum(p * apart, q * apart)
    low, high = low[..., 0, :], high[..., 0, :]
    for bit in range(count):
        ahead = _flip(payoff, chance, bit)
        down, up = ahead.low, ahead.high
        sure, moving = (part[..., bit, :] for part in use)
        down, up = down[..., None], up[..., None]
        low = low + np.where(down < 0, moving * down, sure * down)
        high = high + np.where(up > 0, moving * up, sure * up)
    total = payoff
    for bit in range(count):
        half = total.centre.shape[-1] // 2
        without, having = total[..., :half], total[..., half:]
        total = mixed(without, having, chance[..., bit : bit + 1])
    return total[..., 0], wider(low, high)


def _flip(payoff: Forms, chance: Forms, bit: int) -> Forms:
    """Return E[payoff with the bit - payoff without it] over the other bits."""
    count = chance.centre.shape[-1]
    number = np.arange(2**count)
    on = (number >> (count - 1 - bit)) & 1 == 1
    total = payoff[..., np.flatnonzero(on)] - payoff[..., np.flatnonzero(~on)]
    for other in range(count):
        if other == bit:
            continue
        half = total.centre.shape[-1] // 2
        without, having = total[..., :half], total[..., half:]
        total = mixed(without, having, chance[..., other : other + 1])
    return total[..., 0]


def wider(low: Floats, high: Floats) -> Span:
    """Return intervals that contain what rounding may have left out."""
    room = OUT * (np.abs(low) + np.abs(high))
    return low - room, high + room
