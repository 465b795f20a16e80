"""Sets of laws by the divergence from the nominal row, and what nature picks from them.

Likelihood region (Nilim and El Ghaoui, Operations Research 53, 2005, section 4), p the observed
frequencies: {q : Σ p log(p/q) ≤ β}. For every s ≥ 0, with d = x - min x,

    min Σ q x ≥ min x - s + e^-β Π (d_i + s)^p_i       (weighted means), equal for the s at which
    q_i ∝ p_i / (d_i + s) lies on the region's edge.

An outcome of frequency 0 may happen, too. Where all of the least value have frequency 0, and the
q_i = p_i / d_i · e^-β Π d_i^p_i of the others add up to no more than 1, s is 0: what they leave of
1 goes to such an outcome.

Relative entropy (same paper, section 3; Iyengar, Mathematics of Operations Research 30, 2005):
{q : Σ q log(q/p) ≤ β}. For every s > 0,

    min Σ q x ≥ min x - s log Σ p_i e^(-d_i/s) - s β,  equal for the s at which
    q_i ∝ p_i e^(-d_i/s) lies on the edge.

The scale s comes from Newton's method on log divergence over log s. The law that is returned lies
in the set, and the right side bounds from below what any member can do, so that the distance of the
two is a proven tolerance, whatever the iteration did.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.bounds.gains import UNIT, gamma
from exact_mdp.solvers.robust.sets import Ball, Block

STEPS = 200
NEAR = 1e-12
FARTHEST = 500.0  # |log(s / span)| at most
Divergence = Callable[[Floats, Integers], tuple[Floats, Floats]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Likelihood(Ball):
    """Laws that make the nominal row, taken for observed frequencies, likely: KL(p‖q) ≤ radius.

    With n observations of a row of k outcomes, a radius (in nats) of χ²(k - 1, level) / (2 n) makes
    this the likelihood-ratio region of that level.

    Examples
    --------
    >>> from exact_mdp import MDP
    >>> from exact_mdp.solvers.robust.robust import solve_robust
    >>> toss = [("1/2", 1, 1), ("1/2", 1, 0)]
    >>> mdp = MDP.from_outcomes([(0, 0, toss), (1, 0, [(1, 1, 0)])])
    >>> round(solve_robust(mdp, Likelihood(radius=0.5)).start.value, 4)  # 4 q (1 - q) = 1/e
    0.1025
    """

    NAME = "a likelihood radius"

    def least(self, block: Block, payoff: Floats) -> tuple[Floats, Floats]:
        """See `Ambiguity.least`."""

        def divergence(p: Floats, d: Floats, s: Floats) -> tuple[Floats, Floats]:
            u = d / s
            share = p / (1 + u)
            inside, lost = share.sum(axis=1), (share * u).sum(axis=1)  # they add up to 1
            small = np.log1p(-np.minimum(lost, 0.75))
            log = np.where(lost > 0.5, np.log(inside), small)
            slope = (share * u / (1 + u)).sum(axis=1) / inside - lost
            return log + _mean_log(p, u), slope

        def law(p: Floats, d: Floats, s: Floats) -> Floats:
            return np.asarray(p / (1 + d / s))

        def bound(p: Floats, d: Floats, s: Floats, beta: Floats) -> Floats:
            """Return the bound less min x, rounded down."""
            mean = _mean_log(p, d / s)
            bound_of = s[:, 0] * np.expm1(mean - beta)
            doubt = (
                float(gamma(2 * d.shape[1] + 16)) * s[:, 0] * (mean + beta) * np.exp(mean - beta)
            )
            return np.asarray(bound_of - doubt - 4 * UNIT * np.abs(bound_of))

        p, beta = block.probability, self.radii(block)
        q, short, left = _leaving(p, payoff, beta)
        rest = np.flatnonzero(~left)
        if len(rest):
            bound_of = _least(p[rest], payoff[rest], beta[rest], divergence, law, bound)
            q[rest], short[rest] = bound_of
        return q, short


@dataclass(frozen=True, kw_only=True, eq=False)
class RelativeEntropy(Ball):
    """Laws of small relative entropy to the nominal row: KL(q‖p) ≤ radius, in nats."""

    NAME = "an entropy radius"

    def least(self, block: Block, payoff: Floats) -> tuple[Floats, Floats]:
        """See `Ambiguity.least`."""

        def divergence(p: Floats, d: Floats, s: Floats) -> tuple[Floats, Floats]:
            u = d / s
            weight = p * np.exp(-u)
            total = weight.sum(axis=1)
            q = weight / total[:, None]
            mean = (q * u).sum(axis=1)
            off = np.where(q > 0, u - mean[:, None], 0.0)  # no square of a large u overflows
            spread = (q * off**2).sum(axis=1)
            return -mean - _log_total(p, u, total), -spread

        def law(p: Floats, d: Floats, s: Floats) -> Floats:
            return np.asarray(p * np.exp(-d / s))

        def bound(p: Floats, d: Floats, s: Floats, beta: Floats) -> Floats:
            """Return the bound less min x, rounded down."""
            u = d / s
            log = _log_total(p, u, (p * np.exp(-u)).sum(axis=1))
            bound_of = -s[:, 0] * (log + beta)
            doubt = float(gamma(2 * d.shape[1] + 16)) * s[:, 0] * (np.abs(log) + beta)
            return np.asarray(bound_of - doubt - 4 * UNIT * np.abs(bound_of))

        p, beta = block.probability, self.radii(block)
        return _least(p, payoff, beta, divergence, law, bound)


def _leaving(p: Floats, payoff: Floats, beta: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return laws (K, n), tolerances (K,), and where (K,) they hold: where s is 0."""
    apart = payoff - payoff.min(axis=1, keepdims=True)
    q, short = p.copy(), np.zeros(len(p))
    left = ~((p > 0) & (apart == 0)).any(axis=1)
    rows = np.flatnonzero(left)
    if not len(rows):
        return q, short, left
    p, apart, beta = p[rows], apart[rows], beta[rows]
    log = np.log(np.where(p > 0, apart, 1.0))
    mean = (p * log).sum(axis=1) - beta
    share = p * np.exp(mean[:, None] - log)
    total = share.sum(axis=1)
    share[np.arange(len(rows)), apart.argmin(axis=1)] += 1 - total
    size = np.abs(log).max(axis=1) + beta + 1
    q[rows] = share
    short[rows] = float(gamma(4 * p.shape[1] + 64)) * size * np.exp(mean)
    left[rows] = total <= 1
    return q, short, left


def _mean_log(p: Floats, u: Floats) -> Floats:
    return np.asarray((p * np.log1p(u)).sum(axis=1))


def _log_total(p: Floats, u: Floats, total: Floats) -> Floats:
    """Return log Σ p e^-u, accurate where u is small."""
    with np.errstate(divide="ignore"):
        return np.where(
            total < 0.5, np.log(total), np.log1p(np.maximum((p * np.expm1(-u)).sum(axis=1), -0.75))
        )


@np.errstate(over="ignore", under="ignore")
def _least(
    p: Floats,
    payoff: Floats,
    beta: Floats,
    divergence: Callable[[Floats, Floats, Floats], tuple[Floats, Floats]],
    law: Callable[[Floats, Floats, Floats], Floats],
    bound: Callable[[Floats, Floats, Floats, Floats], Floats],
) -> tuple[Floats, Floats]:
    least = payoff.min(axis=1, keepdims=True)
    apart = payoff - least
    span = apart.max(axis=1)
    # What rounding may hide of a divergence is left out of the region.
    inside = beta - 64 * UNIT * (payoff.shape[1] + 16) * (1 + beta)
    moves = (span > 0) & (inside > 0)
    q, short = p.copy(), np.zeros(len(p))
    # Where that leaves nothing the nominal law stands: by Pinsker's inequality others are within
    # the root of 2 β of it, in the L1 norm.
    still = (span > 0) & (beta > 0) & ~moves
    short[still] = span[still] * np.sqrt(2 * beta[still])
    if not moves.any():
        return q, short
    rows = np.flatnonzero(moves)
    p_, d_, edge = p[rows], apart[rows], inside[rows]
    scale = span[rows][:, None]

    def at(t: Floats, some: Integers) -> tuple[Floats, Floats]:
        return divergence(p_[some], d_[some], scale[some] * np.exp(t)[:, None])

    t = _scale(at, edge)
    s = scale * np.exp(t)[:, None]
    at_beta = law(p_, d_, s)
    at_beta /= at_beta.sum(axis=1, keepdims=True)
    q[rows] = at_beta
    attained = (at_beta * d_).sum(axis=1)
    low = np.maximum(bound(p_, d_, s, beta[rows]), 0.0)
    short[rows] = np.maximum(attained - low, 0.0)
    return q, short


def _scale(at: Divergence, edge: Floats) -> Floats:
    """Return t (K,) with divergence at most `edge`, and as near to it as floats allow.

    The divergence falls in t; where it stays below `edge` for all t, the lowest t is returned.
    """
    target = np.log(edge)
    low, high = np.full_like(edge, -FARTHEST), np.full_like(edge, FARTHEST)
    # Far out the divergence is about (variance / 2) e^-2t, and the variance is at most 1/4.
    t = np.minimum(np.log1p(0.5 / np.sqrt(edge)), FARTHEST)
    open_rows = np.arange(len(edge))
    for _ in range(STEPS):
        k = open_rows
        value, slope = at(t[k], k)
        above = value > edge[k]
        low[k], high[k] = np.where(above, t[k], low[k]), np.where(above, high[k], t[k])
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.log(value) - target[k]
            step = t[k] - off * value / slope
        going = (np.abs(off) >= NEAR) & (high[k] - low[k] >= NEAR)
        safe = (step > low[k]) & (step < high[k])
        t[k] = np.where(~going, t[k], np.where(safe, step, (low[k] + high[k]) / 2))
        open_rows = k[going]
        if not len(open_rows):
            break
    open_rows, reach = np.arange(len(edge)), NEAR
    for _ in range(60):  # outward until inside the set
        value, _slope = at(t[open_rows], open_rows)
        open_rows = open_rows[value > edge[open_rows]]
        if not len(open_rows):
            return t
        t[open_rows] = np.minimum(t[open_rows] + reach, FARTHEST)
        reach *= 4
    t[open_rows] = high[open_rows]
    return t
