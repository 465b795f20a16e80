"""Rows that make observed frequencies likely, and what nature picks from them.

With d = x - min x, a scale s > 0, and p the nominal row or the observed frequencies:

    {q : Σ p log(p/q) ≤ β}   min Σ q x ≥ min x - s + e^-β Π (d_i + s)^p_i,   q_i ∝ p_i / (d_i + s)

with equality for the s at which that law q lies on the set's edge: the likelihood region of Nilim
and El Ghaoui, Operations Research 53, 2005, section 4. The scale comes from Newton's method on log
divergence over log s. The law that is returned lies in the set, and the right side bounds from
below what any member can do: the distance of the two is a proven tolerance, whatever the iteration
did.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import UNIT, gamma
from exact_mdp.solvers.robust.sets import Ball, RowBlock

STEPS = 200  # of Newton's method, each of which at least halves the bracket or stays inside it
NEAR = 1e-12  # of the divergence, relative: how narrow bounds are, not whether they hold
FARTHEST = 500.0  # |log s / max d| at most: e^500 is within the range of floats, twice over


@dataclass(frozen=True, kw_only=True, eq=False)
class Likelihood(Ball):
    """Laws that make the nominal row, taken for observed frequencies, likely: KL(p‖q) ≤ radius.

    With n observations of a row of k outcomes, a radius (in nats) of χ²(k - 1, level) / (2 n) makes
    this the likelihood-ratio region of that level.
    """

    NAME = "a likelihood radius"

    @np.errstate(over="ignore", under="ignore")
    def least(self, block: RowBlock, payoff: Floats) -> tuple[Floats, Floats]:
        """See `Ambiguity.least`."""
        p, beta = block.probability, self.list_radii(block)
        d = payoff - payoff.min(axis=1, keepdims=True)
        q, short, left = _solve_at_boundary(p, d, beta)
        span = np.where(left, 0.0, d.max(axis=1))
        # What rounding may hide of a divergence is left out of the region. Where that leaves
        # nothing the nominal law stands: by Pinsker's inequality others are within the root of 2 β
        # of it, in the L1 norm.
        inside = beta - 64 * UNIT * (payoff.shape[1] + 16) * (1 + beta)
        still = (span > 0) & (beta > 0) & (inside <= 0)
        short[still] = span[still] * np.sqrt(2 * beta[still])
        rows = np.flatnonzero((span > 0) & (inside > 0))
        if len(rows):
            p, d, beta, s = p[rows], d[rows], beta[rows], span[rows]
            s *= np.exp(_find_scale(p, d / s[:, None], inside[rows] * (1 - 2 * NEAR)))
            u = d / s[:, None]
            law = p / (1 + u)
            law /= law.sum(axis=1, keepdims=True)
            mean = (p * np.log1p(u)).sum(axis=1)
            low = s * np.expm1(mean - beta)
            low -= gamma(2 * d.shape[1] + 16) * s * (mean + beta) * np.exp(mean - beta)
            low = np.maximum(low - 4 * UNIT * np.abs(low), 0.0)  # rounded down
            q[rows] = law
            short[rows] = np.maximum((law * d).sum(axis=1) - low, 0.0)
        return q, short


def _find_scale(p: Floats, d: Floats, edge: Floats) -> Floats:
    """Return about the least t (K,) where s = e^t has a divergence of up to `edge` (K,)."""
    low, high = np.full_like(edge, -FARTHEST), np.full_like(edge, FARTHEST)
    # Far out the divergence is about (variance / 2) e^-2t, and the variance is at most 1/4.
    t = np.minimum(np.log1p(0.5 / np.sqrt(edge)), FARTHEST)
    k = np.arange(len(edge))
    for _ in range(STEPS):
        u = d[k] / np.exp(t[k])[:, None]
        share = p[k] / (1 + u)
        kept, lost = share.sum(axis=1), (share * u).sum(axis=1)  # they add up to 1
        log = np.where(lost > 0.5, np.log(kept), np.log1p(-np.minimum(lost, 0.75)))
        value = log + (p[k] * np.log1p(u)).sum(axis=1)
        slope = (share * u / (1 + u)).sum(axis=1) / kept - lost
        above = value > edge[k]
        low[k], high[k] = np.where(above, t[k], low[k]), np.where(above, high[k], t[k])
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.log(value / edge[k])
            step = t[k] - off * value / slope
        close, going = np.abs(off) < NEAR, high[k] - low[k] >= NEAR
        safe = (step > low[k]) & (step < high[k])
        middle = np.where(going, (low[k] + high[k]) / 2, high[k])
        t[k] = np.where(close, t[k], np.where(safe & going, step, middle))
        k = k[~close & going]
        if not len(k):
            break
    t[k] = high[k]
    return t


def _solve_at_boundary(
    p: Floats, d: Floats, beta: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return laws (K, n), tolerances (K,), and where (K,) they hold: where s is 0."""
    # An outcome of frequency 0 may happen, too. Where all of the least value have frequency 0, and
    # the q_i = p_i / d_i · e^-β Π d_i^p_i of the others add up to no more than 1, what they leave
    # of 1 goes to such an outcome.
    q, short = p.copy(), np.zeros(len(p))
    left = ~((p > 0) & (d == 0)).any(axis=1)
    rows = np.flatnonzero(left)
    if len(rows):
        p, d, beta = p[rows], d[rows], beta[rows]
        log = np.log(np.where(p > 0, d, 1.0))
        mean = (p * log).sum(axis=1) - beta
        share = p * np.exp(mean[:, None] - log)
        total = share.sum(axis=1)
        share[np.arange(len(rows)), d.argmin(axis=1)] += 1 - total
        size = np.abs(log).max(axis=1) + beta + 1
        q[rows], left[rows] = share, total <= 1
        short[rows] = gamma(4 * p.shape[1] + 64) * size * np.exp(mean)
    return q, short, left
