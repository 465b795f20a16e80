"""Likelihood regions of rows, and nature's best choice from them.

With d = x - min x, a scale s > 0, and p the nominal row or the observed frequencies:

    {q : Σ p log(p/q) ≤ β}   min Σ q x ≥ min x - s + e^-β Π (d_i + s)^p_i,   q_i ∝ p_i / (d_i + s)

with equality for the s at which this q lies on the boundary of the set: the likelihood region of
Nilim and El Ghaoui, Operations Research 53, 2005, section 4. Newton's method finds the scale, from
the logarithm of the divergence as a function of log s. The distribution that is returned lies in
the set, and the right side is a lower bound for all members: their distance is a proven tolerance,
however the iteration went.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.graph import Mask
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import UNIT, gamma
from exact_mdp.solvers.robust.sets import Ball, RowBlock

NEAR = 1e-12  # relative accuracy of the divergence: sets how narrow bounds are, not their validity


@dataclass(frozen=True, kw_only=True, eq=False)
class Likelihood(Ball):
    """Distributions under which the nominal row, as observed frequencies, is likely.

    KL(p‖q) ≤ radius. With n observations of a row of k outcomes, a radius (in nats) of
    χ²(k - 1, level) / (2 n) makes this the likelihood-ratio region of that level.
    """

    NAME = "a likelihood radius"

    def keeps_outcomes(self, model: MDP) -> Mask:
        """See `Ambiguity.keeps_outcomes`: without an outcome the divergence would be infinite."""
        kept = model.table.compute_probabilities() > 0
        return np.asarray(np.logical_and.reduceat(kept, model.table.offsets[:-1]))

    @np.errstate(over="ignore", under="ignore")
    def minimise(self, block: RowBlock, payoff: Floats) -> tuple[Floats, Floats]:
        """See `Ambiguity.minimise`."""
        p, beta = block.probability, self.list_radii(block)
        d = payoff - payoff.min(axis=1, keepdims=True)
        # Rows in which the scale is 0 are solved in closed form.
        q, short, left = _solve_at_boundary(p, d, beta)
        span = np.where(left, 0.0, d.max(axis=1))
        # Shrink the region by the rounding error of a divergence. If nothing is left, take the
        # nominal row: by Pinsker's inequality, others are within the root of 2 β in the L1 norm.
        inside = beta - 64 * UNIT * (payoff.shape[1] + 16) * (1 + beta)
        still = (span > 0) & (beta > 0) & (inside <= 0)
        short[still] = span[still] * np.sqrt(2 * beta[still])
        rows = np.flatnonzero((span > 0) & (inside > 0))
        if len(rows):
            # The scale s, and the distribution that belongs to it.
            p, d, beta, s = p[rows], d[rows], beta[rows], span[rows]
            s *= np.exp(_find_scale(p, d / s[:, None], inside[rows] * (1 - 2 * NEAR)))
            u = d / s[:, None]
            worst = p / (1 + u)
            worst /= worst.sum(axis=1, keepdims=True)
            # The lower bound -s + e^-β Π (d_i + s)^p_i, rounded down.
            mean = (p * np.log1p(u)).sum(axis=1)
            low = s * np.expm1(mean - beta)
            low -= gamma(2 * d.shape[1] + 16) * s * (mean + beta) * np.exp(mean - beta)
            low = np.maximum(low - 4 * UNIT * np.abs(low), 0.0)
            q[rows] = worst
            short[rows] = np.maximum((worst * d).sum(axis=1) - low, 0.0)
        return q, short


def _find_scale(p: Floats, d: Floats, edge: Floats) -> Floats:
    """Find the least t (K,) such that s = e^t has a divergence of at most `edge` (K,)."""
    # The divergence falls in t; keep a bracket around the solution.
    # The square of e^500 is still a float.
    farthest = 500.0
    low, high = np.full_like(edge, -farthest), np.full_like(edge, farthest)
    # Far out the divergence is about (variance / 2) e^-2t, and the variance is at most 1/4.
    t = np.minimum(np.log1p(0.5 / np.sqrt(edge)), farthest)
    k = np.arange(len(edge))
    # Newton's method, each of whose steps stays inside the bracket or halves it.
    for _ in range(200):
        # The divergence log Σ p/(1+u) + Σ p log(1+u). Both shares add up to 1: the logarithm is
        # taken from the smaller one, which loses fewer digits.
        u = d[k] / np.exp(t[k])[:, None]
        share = p[k] / (1 + u)
        kept, lost = share.sum(axis=1), (share * u).sum(axis=1)
        log = np.where(lost > 0.5, np.log(kept), np.log1p(-np.minimum(lost, 0.75)))
        value = log + (p[k] * np.log1p(u)).sum(axis=1)
        slope = (share * u / (1 + u)).sum(axis=1) / kept - lost
        # Narrow the bracket.
        above = value > edge[k]
        low[k], high[k] = np.where(above, t[k], low[k]), np.where(above, high[k], t[k])
        # Newton's step for the logarithm of the divergence; outside the bracket, bisect instead.
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
    """Return distributions (K, n), tolerances (K,), and the rows (K,) that these solve (s = 0)."""
    # An outcome of frequency 0 may happen, too. Suppose that all outcomes of the least payoff have
    # frequency 0. If the q_i = p_i / d_i · e^-β Π d_i^p_i of the others sum to at most 1, the
    # remaining mass goes to one of these.
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
