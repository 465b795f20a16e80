"""Sets of laws by the divergence from the nominal row, and what nature picks from them.

With d = x - min x, a scale s > 0, and p the nominal row or the observed frequencies:

    {q : Σ p log(p/q) ≤ β}   min Σ q x ≥ min x - s + e^-β Π (d_i + s)^p_i,   q_i ∝ p_i / (d_i + s)
    {q : Σ q log(q/p) ≤ β}   min Σ q x ≥ min x - s log Σ p_i e^(-d_i/s) - s β,  q_i ∝ p_i e^(-d_i/s)

with equality for the s at which that law q lies on the set's edge: the likelihood region and the
relative entropy of Nilim and El Ghaoui, Operations Research 53, 2005, sections 4 and 3 (Iyengar,
Mathematics of Operations Research 30, 2005). The scale comes from Newton's method on log divergence
over log s. The law that is returned lies in the set, and the right side bounds from below what any
member can do: the distance of the two is a proven tolerance, whatever the iteration did.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.bounds.gains import UNIT, gamma
from exact_mdp.solvers.robust.sets import Ball, Block

STEPS = 200  # of Newton's method, each of which at least halves the bracket or stays inside it
NEAR = 1e-12  # of the divergence, relative: how narrow bounds are, not whether they hold
FARTHEST = 500.0  # |log s / max d| at most: e^500 is within the range of floats, twice over


@dataclass(frozen=True, kw_only=True, eq=False)
class Divergence(Ball):
    """Laws of a small divergence; in the methods p and d are (K, n), s is (K, 1), beta (K,)."""

    @abstractmethod
    def at(self, p: Floats, d: Floats, s: Floats) -> tuple[Floats, Floats]:
        """Return the divergence (K,) of the laws at a scale, and its slope over log s."""

    @abstractmethod
    def law(self, p: Floats, d: Floats, s: Floats) -> Floats:
        """Return the laws (K, n) at a scale, but for a factor."""

    @abstractmethod
    def bound(self, p: Floats, d: Floats, s: Floats, beta: Floats) -> Floats:
        """Return the bound (K,) less min x, rounded down."""

    def least(self, block: Block, payoff: Floats) -> tuple[Floats, Floats]:
        """See `Ambiguity.least`."""
        return self._least(block.probability, payoff, self.radii(block))

    @np.errstate(over="ignore", under="ignore")
    def _least(self, p: Floats, payoff: Floats, beta: Floats) -> tuple[Floats, Floats]:
        d = payoff - payoff.min(axis=1, keepdims=True)
        span, q, short = d.max(axis=1), p.copy(), np.zeros(len(p))
        # What rounding may hide of a divergence is left out of the region. Where that leaves
        # nothing the nominal law stands: by Pinsker's inequality others are within the root of 2 β
        # of it, in the L1 norm.
        inside = beta - 64 * UNIT * (payoff.shape[1] + 16) * (1 + beta)
        still = (span > 0) & (beta > 0) & (inside <= 0)
        short[still] = span[still] * np.sqrt(2 * beta[still])
        rows = np.flatnonzero((span > 0) & (inside > 0))
        if len(rows):
            p, d, scale = p[rows], d[rows], span[rows][:, None]
            s = scale * np.exp(self._scale(p, d, scale, inside[rows]))[:, None]
            law = self.law(p, d, s)
            law /= law.sum(axis=1, keepdims=True)
            low = np.maximum(self.bound(p, d, s, beta[rows]), 0.0)
            q[rows] = law
            short[rows] = np.maximum((law * d).sum(axis=1) - low, 0.0)
        return q, short

    def _scale(self, p: Floats, d: Floats, scale: Floats, edge: Floats) -> Floats:
        """Return about the least t (K,) where s = scale e^t has a divergence below `edge` (K,)."""

        def at(t: Floats, rows: Integers) -> tuple[Floats, Floats]:
            return self.at(p[rows], d[rows], scale[rows] * np.exp(t)[:, None])

        low, high = np.full_like(edge, -FARTHEST), np.full_like(edge, FARTHEST)
        # Far out the divergence is about (variance / 2) e^-2t, and the variance is at most 1/4.
        t = np.minimum(np.log1p(0.5 / np.sqrt(edge)), FARTHEST)
        k = np.arange(len(edge))
        for _ in range(STEPS):
            value, slope = at(t[k], k)
            above = value > edge[k]
            low[k], high[k] = np.where(above, t[k], low[k]), np.where(above, high[k], t[k])
            with np.errstate(divide="ignore", invalid="ignore"):
                off = np.log(value / edge[k])
                step = t[k] - off * value / slope
            going = (np.abs(off) >= NEAR) & (high[k] - low[k] >= NEAR)
            safe = (step > low[k]) & (step < high[k])
            t[k] = np.where(~going, t[k], np.where(safe, step, (low[k] + high[k]) / 2))
            k = k[going]
            if not len(k):
                break
        k, reach = np.arange(len(edge)), NEAR
        while len(k) and reach < FARTHEST:  # outward until inside the set
            value, _slope = at(t[k], k)
            k = k[value > edge[k]]
            t[k] = np.minimum(t[k] + reach, FARTHEST)
            reach *= 4
        t[k] = high[k]
        return t


@dataclass(frozen=True, kw_only=True, eq=False)
class Likelihood(Divergence):
    """Laws that make the nominal row, taken for observed frequencies, likely: KL(p‖q) ≤ radius.

    With n observations of a row of k outcomes, a radius (in nats) of χ²(k - 1, level) / (2 n) makes
    this the likelihood-ratio region of that level.
    """

    NAME = "a likelihood radius"

    def least(self, block: Block, payoff: Floats) -> tuple[Floats, Floats]:
        """See `Ambiguity.least`."""
        p, beta = block.probability, self.radii(block)
        q, short, left = _leaving(p, payoff, beta)
        rest = np.flatnonzero(~left)
        if len(rest):
            q[rest], short[rest] = self._least(p[rest], payoff[rest], beta[rest])
        return q, short

    def at(self, p: Floats, d: Floats, s: Floats) -> tuple[Floats, Floats]:
        """See `Divergence.at`."""
        u = d / s
        share = p / (1 + u)
        inside, lost = share.sum(axis=1), (share * u).sum(axis=1)  # they add up to 1
        log = np.where(lost > 0.5, np.log(inside), np.log1p(-np.minimum(lost, 0.75)))
        mean, falling = (p * np.log1p(u)).sum(axis=1), (share * u / (1 + u)).sum(axis=1)
        return log + mean, falling / inside - lost

    def law(self, p: Floats, d: Floats, s: Floats) -> Floats:
        """See `Divergence.law`."""
        return np.asarray(p / (1 + d / s))

    def bound(self, p: Floats, d: Floats, s: Floats, beta: Floats) -> Floats:
        """See `Divergence.bound`."""
        mean, scale = (p * np.log1p(d / s)).sum(axis=1), s[:, 0]
        bound = scale * np.expm1(mean - beta)
        doubt = gamma(2 * d.shape[1] + 16) * scale * (mean + beta) * np.exp(mean - beta)
        return np.asarray(bound - doubt - 4 * UNIT * np.abs(bound))


@dataclass(frozen=True, kw_only=True, eq=False)
class RelativeEntropy(Divergence):
    """Laws of small relative entropy to the nominal row: KL(q‖p) ≤ radius, in nats."""

    NAME = "an entropy radius"

    def at(self, p: Floats, d: Floats, s: Floats) -> tuple[Floats, Floats]:
        """See `Divergence.at`."""
        u = d / s
        weight = self.law(p, d, s)
        total = weight.sum(axis=1)
        q = weight / total[:, None]
        mean = (q * u).sum(axis=1)
        off = np.where(q > 0, u - mean[:, None], 0.0)  # no square of a large u overflows
        return -mean - _log_total(p, u, total), -(q * off**2).sum(axis=1)

    def law(self, p: Floats, d: Floats, s: Floats) -> Floats:
        """See `Divergence.law`."""
        return np.asarray(p * np.exp(-d / s))

    def bound(self, p: Floats, d: Floats, s: Floats, beta: Floats) -> Floats:
        """See `Divergence.bound`."""
        log, scale = _log_total(p, d / s, self.law(p, d, s).sum(axis=1)), s[:, 0]
        bound = -scale * (log + beta)
        doubt = gamma(2 * d.shape[1] + 16) * scale * (np.abs(log) + beta)
        return np.asarray(bound - doubt - 4 * UNIT * np.abs(bound))


def _leaving(p: Floats, payoff: Floats, beta: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return laws (K, n), tolerances (K,), and where (K,) they hold: where s is 0."""
    # An outcome of frequency 0 may happen, too. Where all of the least value have frequency 0, and
    # the q_i = p_i / d_i · e^-β Π d_i^p_i of the others add up to no more than 1, what they leave
    # of 1 goes to such an outcome.
    apart = payoff - payoff.min(axis=1, keepdims=True)
    q, short = p.copy(), np.zeros(len(p))
    left = ~((p > 0) & (apart == 0)).any(axis=1)
    rows = np.flatnonzero(left)
    if len(rows):
        p, apart, beta = p[rows], apart[rows], beta[rows]
        log = np.log(np.where(p > 0, apart, 1.0))
        mean = (p * log).sum(axis=1) - beta
        share = p * np.exp(mean[:, None] - log)
        total = share.sum(axis=1)
        share[np.arange(len(rows)), apart.argmin(axis=1)] += 1 - total
        size = np.abs(log).max(axis=1) + beta + 1
        q[rows], left[rows] = share, total <= 1
        short[rows] = gamma(4 * p.shape[1] + 64) * size * np.exp(mean)
    return q, short, left


def _log_total(p: Floats, u: Floats, total: Floats) -> Floats:
    """Return log Σ p e^-u, accurate where u is small."""
    with np.errstate(divide="ignore"):
        return np.where(
            total < 0.5, np.log(total), np.log1p(np.maximum((p * np.expm1(-u)).sum(axis=1), -0.75))
        )
