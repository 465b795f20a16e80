"""How often training ends with each way to fill in what the text leaves open.

The text leaves 512 completions: the order of the actions in 1000 and 0100, and the action in each
of four statuses. They are not equally likely: training ends with some of them, and both runs of the
paper ended with the same one (Figure 10: the two policies differ in 0000 alone). Under a reading,
with one run of each schedule s,

    weight(c)  ∝  Π_s Π_part P_s(part of c),

where the parts, the order and the four actions, are taken as independent: a test holds products
against the joint counts of 400 runs. The order counts among the runs that end with either one.
With n of N runs that choose option o out of k, its posterior mean is

    P(o) = (n + κ m_o) / (N + κ),    a Dirichlet law.

Where a reading is looked at alone, κ m_o = 1/2, Jeffreys' prior: an option that was never seen in N
runs has 1 / (2 N + k). Where many readings are weighed, m are the shares over readings that were
drawn at random, and κ is what makes the counts of these likeliest (empirical Bayes with a
Dirichlet-multinomial law: Minka, Estimating a Dirichlet distribution, 2000); a reading that was not
trained has the weights m.

A completion is *learnable* where it belongs to the fewest that hold all of the weight but the
chance of a normal number further off than three standard deviations, 0.27 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import erfc, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import special

from exact_mdp.mdp.randomness import RNG, seed_of
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.reported import ACTIONS, COMPLETIONS, NUMBER, ORDERS, UNSTATED

STANDARD_ERRORS = 3.0
LEFT_OUT = erfc(STANDARD_ERRORS / sqrt(2))  # chance of a normal number further off than that
PARTS = ("respectively", *UNSTATED)
CODES = np.array(
    [
        [list(ORDERS).index(reported.order(each)), *(NUMBER[each[status]] for status in UNSTATED)]
        for each in COMPLETIONS
    ]
)
"""(C, 5) the option of each part that a completion chooses."""

MEANT = np.ones((len(PARTS), len(ACTIONS)), dtype=bool)
"""(5, 4) the options that a part has: two orders, four actions."""
MEANT[0, len(ORDERS) :] = False
JEFFREYS = np.where(MEANT, 0.5, 0.0)
CONCENTRATIONS = np.geomspace(0.5, 5000.0, 81)  # κ that are tried


def counted(final: Numbers) -> Integers:
    """Return (…, 5, 4) how many of final policies (…, S, 16) choose each option of each part."""
    pair = final[..., int("1000", 2)], final[..., int("0100", 2)]
    found = np.zeros((*final.shape[:-2], *MEANT.shape), dtype=np.int64)
    for place, order in enumerate(ORDERS.values()):
        both = (pair[0] == NUMBER[order["1000"]]) & (pair[1] == NUMBER[order["0100"]])
        found[..., 0, place] = both.sum(axis=-1)
    for part, status in enumerate(UNSTATED, start=1):
        taken = final[..., int(status, 2)]
        for action in range(len(ACTIONS)):
            found[..., part, action] = (taken == action).sum(axis=-1)
    return np.asarray(found)


def log_weights(shares: Floats) -> Floats:
    """Return (…, C) log weights of completions from shares (…, schedules, 5, 4)."""
    logs = np.log(shares, out=np.full(shares.shape, -np.inf), where=shares > 0)
    each = sum(logs[..., part, CODES[:, part]] for part in range(len(PARTS)))
    both = np.asarray(each).sum(axis=-2)
    return np.asarray(both - special.logsumexp(both, axis=-1, keepdims=True))


def learnable(logs: Floats, left_out: float = LEFT_OUT) -> NDArray[np.bool_]:
    """Return (…, C) the fewest completions that hold all of the weight but `left_out`.

    >>> learnable(np.log([0.001, 0.5, 0.499])).tolist()
    [False, True, True]
    """
    order = np.argsort(-logs, axis=-1, kind="stable")
    falling = np.exp(np.take_along_axis(logs, order, axis=-1))
    before = np.cumsum(falling, axis=-1) - falling
    found = np.zeros(logs.shape, dtype=bool)
    np.put_along_axis(found, order, before < 1 - left_out, axis=-1)
    return np.asarray(found)


@dataclass(frozen=True, kw_only=True, eq=False)
class LearnedCompletions:
    """What training runs of both schedules end with, as weights of the completions."""

    counts: Integers  # (2, 5, 4) runs by schedule, part and option

    @property
    def posterior(self) -> Floats:
        """(2, 5, 4) parameters of the Dirichlet laws of the shares."""
        return np.asarray(self.counts + JEFFREYS, dtype=np.float64)

    @cached_property
    def shares(self) -> Floats:
        """(2, 5, 4) posterior means."""
        return normalised(self.posterior)

    @cached_property
    def log_weights(self) -> Floats:
        """(C,) log weights of the completions."""
        return log_weights(self.shares)

    @cached_property
    def learnable(self) -> NDArray[np.bool_]:
        """(C,) the completions that training can be expected to end with."""
        return learnable(self.log_weights)

    @property
    def intervals(self) -> Floats:
        """(2, 5, 4, 2) 95 % intervals of the shares by their posterior: low, high."""
        from scipy import stats

        alpha = np.where(MEANT, self.posterior, 1.0)
        rest = np.where(MEANT, self.posterior.sum(axis=-1, keepdims=True) - alpha, 1.0)
        return np.stack([stats.beta.ppf(at, alpha, rest) for at in (0.025, 0.975)], axis=-1)

    def draws(self, n: int, rng: RNG) -> Floats:
        """Return (n, C) log weights under shares drawn from their posterior."""
        generator = np.random.default_rng(seed_of(rng))
        drawn = generator.standard_gamma(self.posterior, (n, *self.counts.shape))
        return log_weights(normalised(drawn))


def normalised(values: Numbers) -> Floats:
    """Return values divided by their sum over the last axis."""
    return np.asarray(values / values.sum(axis=-1, keepdims=True))


def pooled(counts: Integers) -> Floats:
    """Return (2, 5, 4) the prior κ m of a reading's shares, from counts (T, 2, 5, 4) of others."""
    mean = normalised(counts.sum(axis=0) + JEFFREYS)
    totals = counts.sum(axis=-1)
    weights = CONCENTRATIONS[:, None, None, None]
    prior = np.where(MEANT, weights[..., None] * mean, 1.0)
    gamma = special.gammaln
    each = (gamma(prior + counts) - gamma(prior)).sum(axis=-1, where=MEANT)
    fits = (each + gamma(weights) - gamma(weights + totals)).sum(axis=1)  # (κ, 2, 5)
    return np.asarray(CONCENTRATIONS[fits.argmax(axis=0)][..., None] * mean)


def by_reading(sampled: Integers, counts: Integers, place: Integers) -> Floats:
    """Return (R, C) log weights of the completions under each of R readings.

    From counts (T, 2, 5, 4) under readings drawn at random, and counts (U, 2, 5, 4) of readings of
    their own: `place` (R,) says which of these belongs to a reading, -1 that it was not trained.
    """
    own = np.concatenate([counts, np.zeros_like(counts[:1])])  # -1 is the last one
    return np.asarray(log_weights(normalised(own + pooled(sampled)))[place])
