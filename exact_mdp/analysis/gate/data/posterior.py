"""The posterior distribution of a policy's regret, given the records.

Rows of different pairs, and a start that was not given, are independent and Dirichlet: the prior
has the same parameter for every state, `prior` in all, and the posterior adds the counts. A reward
is drawn among the recorded rewards of the same next state, with Dirichlet weights from their counts
(Rubin, The Bayesian bootstrap, Annals of Statistics 9, 1981). Every draw is a model that is solved.

The interval goes from 0 to an order statistic that is at least the posterior's quantile in 97.5 %
of samples. Its lower end is 0: the regret is a maximum, so noise adds to it in every draw, and
if actions tie, nearly every draw shows a loss. A posterior therefore proves no loss.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.random import SeedSequence

from exact_mdp.analysis.gate.data.interval import (
    RegretInterval,
    cut_off,
    format_states,
    observations_of,
    of_process,
)
from exact_mdp.analysis.vary.intervals import estimate_quantiles, require_draws, upper_quantile
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import BLOCK, MOST_NUMBERS, Floats, exact, format_rational
from exact_mdp.mdp.validate import RNG, require_count, seed_of
from exact_mdp.solvers.bounds.gains import SLACK, gamma
from exact_mdp.solvers.claims import compute_regrets
from exact_mdp.solvers.parallel import Arrays, join_blocks, run_pieces, seed_blocks
from exact_mdp.solvers.stacked import StackedModel, StackedStructure


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """A credible upper bound on the regret under a Dirichlet prior.

    It has no guaranteed coverage over data sets, and no lower end above 0.

    Attributes
    ----------
    prior : number
        Observations with which each row begins, spread evenly over all states.
    n : int
        Number of draws; too few for a high quantile are refused.
    rng : int or Generator
    n_jobs, progress
        Number of workers and progress bar, as in `solvers.parallel.run_pieces`; results do not
        depend on them.

    Examples
    --------
    >>> import pandas as pd
    >>> from exact_mdp import check
    >>> names = ["episode", "state", "action", "reward", "next_state"]
    >>> rows = [(n, "ill", "wait", n % 2, None) for n in range(40)]
    >>> rows += [(n + 40, "ill", "treat", n % 4 > 0, None) for n in range(40)]
    >>> mdp = MDP.from_transitions(pd.DataFrame(rows, columns=names), discount="1/2")
    >>> interval = check(mdp, "always:treat", confidence=0.95, by=Posterior(n=500)).interval
    >>> interval.low, interval.high < 0.1, interval.within(Fraction(0)).value > 0.95
    (0.0, True, True)
    """

    prior: object = 1
    n: int = 2000
    rng: RNG = 0
    n_jobs: int | None = 1
    progress: bool = False
    by: ClassVar[str] = "posterior"

    def interval(self, mdp: MDP, own: Floats, confidence: Fraction) -> RegretInterval:
        """Return the interval; raise ModelError without counts, for a bad prior or few draws."""
        # No prior covers states whose continuation was never seen.
        unknown = cut_off(mdp)
        if unknown.any():
            raise ModelError(
                f"episodes were cut off in {format_states(mdp, unknown)}, "
                "which no record leaves: no prior says what follows there",
                where="posterior",
                fix="ask for a robust interval, or record what follows",
            )
        if mdp.n_states * mdp.n_pairs > MOST_NUMBERS:
            raise ModelError(
                f"a draw has {mdp.n_states * mdp.n_pairs:,} numbers, more than {MOST_NUMBERS:,}",
                where="posterior",
                fix="ask for a robust interval, or group the states",
            )
        given, seed, level = exact(self.prior, "prior"), seed_of(self.rng), float(confidence)
        if not 1e-6 <= given <= 1e9:
            what = f"the prior is {format_rational(given)} observations"
            raise ModelError(what, where="prior", fix="give 1e-6 to 1e9, such as 1")
        prior = float(given)
        # Enough draws for the quantile; each block of draws has a seed of its own.
        n = require_count(self.n, "the number of draws, n,", 2)
        require_draws(n, level)
        blocks = run_pieces(
            partial(_sample_regrets, mdp.maximised, observations_of(mdp) > 0, own, prior),
            seed_blocks(seed, n, 250),  # draws with a seed of their own
            key={},
            n_jobs=self.n_jobs,
            progress=self.progress,
            what="draws",
        )
        # The upper end is an order statistic; equal tails are stated for comparison.
        draws = join_blocks(blocks)["regret"]
        low, high = estimate_quantiles(draws, [(1 - level) / 2, (1 + level) / 2])
        return RegretInterval(
            low=0.0,
            high=upper_quantile(draws, level),
            confidence=level,
            by=self.by,
            assumptions=(
                *of_process(mdp),
                f"the prior of each row is Dirichlet, with the weight of {prior:g} observations "
                "spread evenly over all states",
                "rewards are among those that were seen",
                "the upper end is a draw that is at least the posterior's quantile in 97.5 % of "
                "samples",
                "the confidence is a posterior probability, not a share of data sets; the lower "
                "end is 0, as draws of a maximum do not tell a small loss from none",
            ),
            found={
                "mean": float(draws.mean()),
                "equal_tails": (low["low"], high["high"]),
                "draws": n,
                "prior": prior,
                "seed": seed,
            },
            draws=draws,
        )


def sample_models(
    mdp: MDP, known: np.ndarray, prior: float, rng: np.random.Generator, count: int
) -> StackedModel:
    """Return models drawn from the posterior; rows of pairs without counts stay as they are.

    `known` (L,) marks the pairs with counts.
    """
    table, shape, part = mdp.table, mdp.transition.shape, prior / mdp.n_states
    seen = known[table.pair]
    pair, following, gain = table.pair[seen], table.next[seen], table.compute_gains()[seen]
    # A next state that was seen with several rewards spreads its part of the prior over them.
    _, place, rewards = np.unique(
        pair * shape[1] + following, return_inverse=True, return_counts=True
    )
    never = np.tile(known[:, None], shape[1])
    never[pair, following] = False
    pairs, states = np.nonzero(never)

    # A Dirichlet row is a row of gamma variates over their sum.
    weight = rng.gamma(table.weight[seen] + part / rewards[place], size=(count, len(pair)))
    rows, earned = np.zeros((count, *shape)), np.zeros((count, shape[0]))
    draw = np.arange(count)[:, None]
    rows[:, pairs, states] = rng.gamma(part, size=(count, len(pairs)))
    np.add.at(rows, (draw, pair, following), weight)
    np.add.at(earned, (draw, pair), weight * (gain - mdp.reward[pair]))
    total = np.where(known, rows.sum(axis=2), 1.0)
    rows /= total[:, :, None]
    rows[:, ~known] = mdp.transition[~known].toarray()

    # The start, if it was estimated from episodes.
    begun = np.tile(mdp.start_distribution, (count, 1))
    if mdp.episodes is not None:
        begun = rng.gamma(begun * mdp.episodes + part)
        begun /= begun.sum(axis=1, keepdims=True)

    # At discount 1 terminal states without counts stay terminal.
    ended = mdp.terminal & ~np.logical_or.reduceat(known, mdp.pair_offsets[:-1])
    lost = float(1 - mdp.discount_exact)
    live = ~ended | (lost > 0)
    # Every state may follow every pair.
    outcomes = np.arange(shape[0] * shape[1])
    structure = StackedStructure(
        state=np.array(mdp.pair_state),
        first=np.array(mdp.pair_offsets),
        offsets=np.arange(shape[0] + 1) * shape[1],
        column=outcomes % shape[1],
        number=outcomes,
        earned=np.arange(shape[0]),
        ended=~live,
    )
    return StackedModel(
        structure=structure,
        steps=None,
        chances=rows.reshape(count, -1).T,
        amounts=(mdp.reward + earned / total).T,
        reward_error=np.zeros((1, 1)),
        rate=np.full(count, mdp.discount),
        leak=np.array([[lost]]),
        terms=mdp.n_states,
        live=np.tile(live, (count, 1)),
        start=begun,
    )


def drawn_regrets(models: StackedModel, own: Floats) -> Floats:
    """Return the regrets (D,) of a policy (L,) in some models; 0 if rounding may explain them.

    A policy (N, L) by time is for episodes of N steps, which backward induction solves.
    """
    if own.ndim == 1:
        optimum = models.optimum()
        if optimum is None:
            raise ModelError(
                "a model drawn from the posterior has no solution: an episode may never end",
                where="posterior",
                fix="choose a discount below 1, or a larger prior",
            )
        best, error = models.at_start(*optimum[:2])
        value, off = models.evaluate([own])
        return compute_regrets(best, value[:, 0], error + off[:, 0])
    # Backward induction with two values for each state: of the optimum, and of the policy.
    first = models.structure.first[:-1]
    value = np.zeros((*models.start.shape, 2))
    for taken in own[::-1]:
        ahead = models.rate[0] * np.einsum("dls,dsv->dlv", models.rows, value)
        q = models.reward[:, :, None] + ahead
        best = np.maximum.reduceat(q[:, :, 0], first, axis=1)
        value = np.stack([best, np.add.reduceat(q[:, :, 1] * taken, first, axis=1)], axis=2)
    best, mine = np.einsum("dsv,ds->vd", value, models.start)
    # Each value is a sum over N steps, with at most L + S + 4 roundings in each.
    size = len(own) * np.abs(models.reward).max(axis=1)
    noise = 2 * gamma(len(own) * (sum(models.rows.shape[1:]) + 4)) * size * SLACK
    return compute_regrets(best, mine, noise)


def _sample_regrets(
    mdp: MDP, known: np.ndarray, own: Floats, prior: float, piece: tuple[SeedSequence, int]
) -> Arrays:
    """Draw and solve one piece of the models, as many at once as memory allows."""
    sequence, count = piece
    rng, size = np.random.default_rng(sequence), max(1, BLOCK // mdp.n_pairs // mdp.n_states)
    regrets = []
    for done in range(0, count, size):
        models = sample_models(mdp, known, prior, rng, min(size, count - done))
        regrets.append(drawn_regrets(models, own))
    return {"regret": np.concatenate(regrets)}
