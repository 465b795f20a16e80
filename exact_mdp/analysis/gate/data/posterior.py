"""The posterior distribution of a policy's regret, given what was recorded.

Rows of different pairs are independent. Before the records each is Dirichlet with the same
parameter for every state that may follow, which add up to `prior` (1 unless given; 1/S for each of
S states is Perks's prior, Journal of the Institute of Actuaries 73, 1947); after them the counts
are added. The start is such a row, too, unless it was given. So a state that was never seen to
follow stays possible. A reward is one of those that were seen with that next state, in proportion
to Dirichlet weights of their own counts (Rubin's Bayesian bootstrap, Annals of Statistics 9, 1981),
and the mean of the pair where a next state was never seen to follow.

Every draw is a model: it is solved by policy iteration, the policy is evaluated in it, and the
difference at the start is one draw of the regret. Draws come in blocks with a stream of random
numbers each: the same seed gives the same bytes wherever the work is done.

The credible interval goes from 0 to an order statistic of the draws that is at least the
posterior's quantile of the confidence in 97.5 % of samples, so that more draws narrow it: the k-th
smallest of n, with the least k of P(Binomial(n, confidence) < k) ≥ 0.975. Of too few draws not even
the greatest is one, and they are refused: 72 are enough at a confidence of 0.95, 368 at 0.99, 3,688
at 0.999. It has no lower end above 0, because none would be honest: the regret is a maximum, so
that the noise of every draw adds to it. Where the policy is optimal, as where actions tie, the true
regret is 0, but some other action looks better in nearly every draw, the more states there are, and
an interval of equal tails misses the 0 in nearly every data set. To the upper end the same bias
only adds. So a posterior lets a policy pass, or leaves it open with the probability that it is
within the limit (`within`); it proves no loss. That the upper end holds in the stated share of data
sets nobody guarantees either: for that take `robust`. The equal tails are in `found`, as what the
draws show.

Draws are dense: (L, S) numbers each, which fits into memory up to about 10^8 of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.random import SeedSequence

from exact_mdp.analysis.gate.data.interval import (
    RegretInterval,
    cut_off,
    named,
    observations_of,
    of_process,
)
from exact_mdp.analysis.vary.base_case import digest
from exact_mdp.analysis.vary.intervals import (
    quantiles,
    require_draws,
    share_of,
    upper_quantile,
    wilson,
)
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.questions import by_time
from exact_mdp.mdp.table import Floats, Integers, exact
from exact_mdp.mdp.validate import RNG, counted, seed_of
from exact_mdp.solvers.parallel import Arrays, joined, many, seeded
from exact_mdp.solvers.solution import Estimated
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.policy_chain import PolicyChain

DRAWS = 2000
BLOCK = 250  # draws in a piece of work
ROOM = 2**22  # numbers that are worked on at once
MOST_ROOM = 10**8  # of one draw
ROUNDED = 1e-10  # of the values: differences that are rounding
LONGEST = 1e9  # steps of an episode, at discount 1
IMPROVEMENTS = 200


@dataclass(frozen=True, kw_only=True)
class Probability(Estimated):
    """A share of draws, with Wilson's 95 % interval, which is sound where all or none agree."""

    low: float
    high: float

    @classmethod
    def of(cls, found: int, count: int) -> Probability:
        """Return the share of some draws among all."""
        share, (low, high) = share_of(found, count), wilson(found, count)
        return cls(
            value=share.value,
            standard_error=share.standard_error,
            low=float(low),
            high=float(high),
        )

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval."""
        return self.low, self.high


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PosteriorInterval(RegretInterval):
    """A credible interval, from 0 upward.

    Attributes
    ----------
    draws : (D,)
        The regret in each model drawn.
    """

    draws: Floats

    def within(self, limit: Fraction) -> Probability:
        """Return the probability that the regret is at most `limit`, as the draws show it."""
        found = int((self.draws <= float(exact(limit))).sum())
        return Probability.of(found, len(self.draws))


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """A credible upper bound of the regret under a Dirichlet prior.

    It has no guaranteed coverage over data sets, and no lower end above 0.

    Attributes
    ----------
    prior : number
        Observations that each row begins with, spread evenly over all states.
    n : int
        Draws; few do not show a high quantile, and are refused.
    rng : int or Generator
    n_jobs, folder, progress
        Where the work is done, as `solvers.parallel.many` takes it; results do not change.

    Examples
    --------
    >>> import pandas as pd
    >>> names = ["episode", "state", "action", "reward", "next_state"]
    >>> rows = [(n, "ill", "wait", n % 2, None) for n in range(40)]
    >>> rows += [(n + 40, "ill", "treat", n % 4 > 0, None) for n in range(40)]
    >>> mdp = MDP.from_transitions(pd.DataFrame(rows, columns=names), discount="1/2")
    >>> chain = PolicyChain.of(mdp, "always:treat")
    >>> found = Posterior(n=500).interval(mdp, chain, Fraction(19, 20))
    >>> found.low, found.high < 0.1, found.within(Fraction(0)).value > 0.95
    (0.0, True, True)
    """

    prior: object = 1
    n: int = DRAWS
    rng: RNG = 0
    n_jobs: int | None = 1
    folder: str | Path | None = None
    progress: bool = False
    by: ClassVar[str] = "posterior"

    def interval(
        self, mdp: MDP, chain: PolicyChain, confidence: Fraction, horizon: int | None = None
    ) -> PosteriorInterval:
        """Return the interval; raises ModelError without counts, for a bad prior or few draws."""
        unknown = cut_off(mdp)
        # By the prior an episode may begin in any state, and go to any: after one step from a start
        # that is known it is over, and nothing of them matters.
        over = horizon == 1 and mdp.episodes is None and not mdp.start_distribution[unknown].any()
        if unknown.any() and not over:
            raise ModelError(
                f"episodes were cut off in {named(mdp, unknown)}, which no record leaves: no prior "
                "says what follows there",
                where="posterior",
                fix="ask for a robust interval, or record what follows",
            )
        prior, seed = _prior(self.prior), seed_of(self.rng)
        count = counted(self.n, "the number of draws, n,", 2)
        require_draws(count, float(confidence))
        own = chain.weights if horizon is None else by_time(mdp, chain.weights, horizon)
        model = _Model.of(mdp, own, prior)
        pieces, _ = seeded(seed, count, BLOCK)
        key = {
            "model": fingerprint(mdp),
            "counts": digest(observations_of(mdp).astype(np.float64)),
            "episodes": mdp.episodes,
            "policy": digest(own),
            "horizon": horizon,
            "prior": prior,
            "seed": seed,
            "draws_per_file": BLOCK,
        }
        if self.folder is not None:
            key["draws"] = count
        blocks = many(
            partial(_block, model),
            pieces,
            key=key,
            n_jobs=self.n_jobs,
            folder=self.folder,
            progress=self.progress,
            what="draws",
        )
        draws = joined(blocks)["regret"]
        tail = float((1 - confidence) / 2)
        low, high = quantiles(draws, [tail, 1 - tail])
        return PosteriorInterval(
            low=0.0,
            high=upper_quantile(draws, float(confidence)),
            confidence=float(confidence),
            by=self.by,
            assumptions=(
                *of_process(mdp),
                f"before the records, rows are Dirichlet, each worth {prior:g} observations that "
                "are spread evenly over all states",
                "rewards are among those that were seen",
                "of the draws the upper end is one that is at least the posterior's quantile in "
                "97.5 % of samples",
                "the confidence is a probability by the posterior, no share of data sets; no lower "
                "end above 0 is stated, as draws of a maximum do not tell a small loss from none",
            ),
            found={
                "mean": float(draws.mean()),
                "equal_tails": (low.low, high.high),
                "draws": count,
                "prior": prior,
                "seed": seed,
            },
            draws=draws,
        )


def _prior(given: object) -> float:
    try:
        found = float(exact(given))
    except (ModelError, OverflowError) as error:
        raise ModelError(f"the prior is {given!r}", where="prior", fix="give a number") from error
    if not 1e-6 <= found <= 1e9:
        raise ModelError(
            f"the prior is {found:g} observations", where="prior", fix="give 1e-6 to 1e9, such as 1"
        )
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class _Model:
    """What every draw starts from, in arrays that can be sent to other processes.

    Entries are (pair, next state) of counted pairs, N of them with a reward each, and M of states
    that were never seen to follow.
    """

    discount: float
    pair_offsets: Integers
    start: Floats
    start_weight: Floats | None  # (S,) Dirichlet parameters, where the start is from records
    own: Floats  # (L,) the policy; (N, L) with a horizon
    first: Integers  # (S,) the pairs of the estimated optimum
    over: Integers  # states where all is over
    transition: Floats  # (L, S) rows that are certain; the others are 0
    reward: Floats  # (L,)
    seen: tuple[Integers, Integers]  # (N,), (N,)
    seen_weight: Floats  # (N,) Dirichlet parameters
    seen_reward: Floats  # (N,)
    unseen: tuple[Integers, Integers]  # (M,), (M,)
    unseen_weight: float

    @classmethod
    def of(cls, mdp: MDP, own: Floats, prior: float) -> _Model:
        observed, model = observations_of(mdp), mdp.maximised
        states, pairs = model.n_states, model.n_pairs
        if states * pairs > MOST_ROOM:
            raise ModelError(
                f"a draw has {states * pairs:,} numbers, more than {MOST_ROOM:,}",
                where="posterior",
                fix="ask for a robust interval, or group the states",
            )
        table, counted = model.table, observed > 0
        kept = np.repeat(counted, np.diff(table.offsets))
        row = np.repeat(np.arange(pairs), np.diff(table.offsets))[kept]
        then = table.next[kept].astype(np.int64)
        place = row * states + then
        _, which, many_rewards = np.unique(place, return_inverse=True, return_counts=True)
        never = np.ones((pairs, states), dtype=bool)
        never[row, then] = False
        never[~counted] = False
        unseen = np.nonzero(never)
        certain = model.transition.toarray()
        certain[counted] = 0.0
        terminal = model.terminal & np.logical_and.reduceat(~counted, model.pair_offsets[:-1])
        return cls(
            discount=model.discount,
            pair_offsets=np.array(model.pair_offsets),
            start=np.array(model.start_distribution),
            start_weight=None
            if model.episodes is None
            else model.start_distribution * model.episodes + prior / states,
            own=np.array(own),
            first=np.array(solve(model).pairs),
            over=np.flatnonzero(terminal),
            transition=certain,
            reward=np.array(model.reward),
            seen=(row, then),
            seen_weight=table.weight[kept] + prior / states / many_rewards[which],
            seen_reward=table.gains()[kept],
            unseen=(unseen[0], unseen[1]),
            unseen_weight=prior / states,
        )

    def drawn(self, rng: np.random.Generator, count: int) -> tuple[Floats, Floats, Floats]:
        """Return `count` models: rows (count, L, S), rewards (count, L), starts (count, S)."""
        shape = (count, *self.transition.shape)
        rows = np.zeros(shape)
        weight = rng.gamma(self.seen_weight, size=(count, len(self.seen_weight)))
        unseen = rng.gamma(self.unseen_weight, size=(count, len(self.unseen[0])))
        draw = np.arange(count)[:, None]
        np.add.at(rows, (draw, *self.seen), weight)
        rows[(draw, *self.unseen)] = unseen
        total = rows.sum(axis=2)
        sure = total == 0
        rows /= np.where(sure, 1.0, total)[:, :, None]
        rows += self.transition
        # An outcome that was seen has its own reward in place of the mean of its pair.
        earned = np.zeros(shape[:2])
        pair = self.seen[0]
        np.add.at(earned, (draw, pair), weight * (self.seen_reward - self.reward[pair]))
        reward = self.reward + earned / np.where(sure, 1.0, total)
        if self.start_weight is None:
            return rows, reward, np.tile(self.start, (count, 1))
        begun = rng.gamma(self.start_weight, size=(count, len(self.start)))
        return rows, reward, begun / begun.sum(axis=1, keepdims=True)

    def regret(self, rows: Floats, reward: Floats, start: Floats) -> Floats:
        """Return (D,) the regret at the start in each of the models drawn."""
        first = self.pair_offsets[:-1]
        if self.own.ndim == 2:
            return self.staged(rows, reward, start)
        state = np.repeat(np.arange(len(first)), np.diff(self.pair_offsets))
        draw = np.arange(len(rows))[:, None]
        chosen = np.tile(self.first, (len(rows), 1))
        for _ in range(IMPROVEMENTS):
            value = self.value(rows[draw, chosen], reward[draw, chosen])
            worth = reward + self.discount * np.einsum("dls,ds->dl", rows, value)
            best = np.maximum.reduceat(worth, first, axis=1)
            size = np.abs(value).max(axis=1) + np.abs(reward).max(axis=1)
            noise = ROUNDED * size[:, None]
            better = best > worth[draw, chosen] + noise
            if not better.any():
                break
            number = np.where(worth == best[:, state], np.arange(worth.shape[1]), worth.shape[1])
            chosen = np.where(better, np.minimum.reduceat(number, first, axis=1), chosen)
        else:
            raise ModelError(
                f"a model that was drawn needs more than {IMPROVEMENTS} policies to be solved",
                where="posterior",
                fix="ask for a robust interval, or group the states",
            )
        share = self.own[None, :, None]
        mixed = np.add.reduceat(rows * share, first, axis=1)
        own = self.value(mixed, np.add.reduceat(reward * self.own, first, axis=1))
        lost = np.einsum("ds,ds->d", value - own, start)
        return np.where(lost > noise[:, 0], lost, 0.0)

    def staged(self, rows: Floats, reward: Floats, start: Floats) -> Floats:
        """Return the same of episodes that stop after N steps, by backward induction."""
        first = self.pair_offsets[:-1]
        best = own = np.zeros((len(rows), len(first)))
        for taken in self.own[::-1]:
            ahead = np.einsum("dls,dsv->dlv", rows, np.stack([best, own], axis=2))
            worth = reward[:, :, None] + self.discount * ahead
            best = np.maximum.reduceat(worth[:, :, 0], first, axis=1)
            own = np.add.reduceat(worth[:, :, 1] * taken, first, axis=1)
        noise = ROUNDED * (np.abs(best).max(axis=1) + np.abs(reward).max(axis=1))
        lost = np.einsum("ds,ds->d", best - own, start)
        return np.where(lost > noise, lost, 0.0)

    def value(self, rows: Floats, reward: Floats) -> Floats:
        """Return (D, S) the values of chains (D, S, S) with rewards (D, S)."""
        rows = rows * self.discount
        rows[:, self.over] = 0.0
        reward = reward.copy()
        reward[:, self.over] = 0.0
        given = np.stack([reward, np.ones_like(reward)], axis=2)
        try:
            found = np.linalg.solve(np.eye(rows.shape[1]) - rows, given)
        except np.linalg.LinAlgError:
            found = np.full_like(given, np.inf)
        steps = found[:, :, 1]
        if not ((steps > 0.5) & (steps < LONGEST)).all():
            raise ModelError(
                "in a model drawn from the posterior some episode never ends",
                where="posterior",
                fix="choose a discount below 1, or a larger prior",
            )
        return np.asarray(found[:, :, 0])


def _block(model: _Model, piece: tuple[SeedSequence, int]) -> Arrays:
    sequence, count = piece
    rng = np.random.default_rng(sequence)
    size = max(1, ROOM // model.transition.size)
    found = [
        model.regret(*model.drawn(rng, min(size, count - done))) for done in range(0, count, size)
    ]
    return {"regret": np.concatenate(found)}
