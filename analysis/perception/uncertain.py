"""A policy's value where the confusion of statuses is known from counts only.

The rows of the confusion are drawn from their posterior (`mdp.care.counts`), and the policy
is evaluated under each draw: mean and quantiles are estimates, of what the labels leave open.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from exact_mdp.analysis.perception.policies import chosen_policy
from exact_mdp.mdp.care.counts import LEVEL, Counted
from exact_mdp.mdp.care.process import Process
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.pomdp.values import acting, at_start, rounding, values
from exact_mdp.solvers.solution import Bounded, Claim


@dataclass(frozen=True, kw_only=True, eq=False)
class UncertainValue:
    """A policy's value where the confusion is known from counts only.

    Attributes
    ----------
    at_mean : Bounded
        Under the posterior mean of the confusion.
    mean, standard_error : float
        Of the value over matrices drawn from the posterior: an estimate.
    interval : (low, high)
        The credible interval, between quantiles of the draws.
    level : float
    draws : (N,) values
    """

    at_mean: Bounded
    mean: float
    standard_error: float
    interval: tuple[float, float]
    level: float
    draws: Floats

    @property
    def claim(self) -> Claim:
        """What is claimed of mean and interval."""
        return Claim.ESTIMATED


def value_under_counts(
    mdp: MDP,
    policy: object,
    counts: Counted,
    *,
    seed: int | np.random.Generator,
    draws: int = 2000,
    level: float = LEVEL,
) -> UncertainValue:
    """Return the value of a policy under a confusion of which only counts are known.

    Parameters
    ----------
    policy : "optimal", or anything that `Policy.of` takes; it reads the perceived status
    counts : Counted, with a prior
    seed : whole number or generator
    draws : matrices drawn from the posterior
    level : of the credible interval

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> seen = Counted(counts=50 * np.eye(16, dtype=int), prior=1 / 16)
    >>> found = value_under_counts(mdp, "optimal", seen, seed=0, draws=200)
    >>> found.interval[0] < found.at_mean.value < found.interval[1]
    True
    """
    if draws < 1 or not 0 < level < 1:
        raise ModelError(
            f"{draws} draws, level {level}",
            where="value_under_counts",
            fix="give 1 or more, and such as 0.95",
        )
    generator = seed if isinstance(seed, np.random.Generator) else np.random.default_rng(seed)
    process = Process.of(mdp, counts.mean)
    table = process.table(chosen_policy(mdp, policy))
    found = []
    for first in range(0, draws, 256):
        matrices = counts.samples(generator, min(256, draws - first))
        found.append(at_start(process, values(process, acting(process, table, matrices))[0]))
    drawn = np.concatenate(found)
    drawn.setflags(write=False)
    tail = (1 - level) / 2
    low, high = np.quantile(drawn, [tail, 1 - tail]).tolist()
    middle, _ = values(process, acting(process, table))
    return UncertainValue(
        at_mean=Bounded(value=float(at_start(process, middle)[0]), error=rounding(process)),
        mean=float(drawn.mean()),
        standard_error=float(drawn.std(ddof=1) / np.sqrt(draws)) if draws > 1 else inf,
        interval=(low, high),
        level=level,
        draws=drawn,
    )
