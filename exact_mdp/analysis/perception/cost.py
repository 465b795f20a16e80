"""A policy's value where the confusion of statuses is known from counts only.

The rows of the confusion are drawn from their posterior (`mdp.care.perception`), and the policy is
evaluated under each draw: mean and quantiles are estimates, of what the labels leave open.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.perception.values import Passes
from exact_mdp.mdp.care.perception import LEVEL, Counted
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats
from exact_mdp.mdp.validate import RNG, seed_of
from exact_mdp.solvers.solution import Bounded, Estimated

if TYPE_CHECKING:
    from pandas import DataFrame


BATCH = 256  # matrices evaluated at once


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class UncertainValue(Result):
    """A policy's value where the confusion is known from counts only.

    Attributes
    ----------
    at_mean : Bounded
        Under the posterior mean of the confusion.
    value : Estimated
        The mean over matrices drawn from the posterior.
    interval : (low, high)
        The credible interval, between quantiles of the draws.
    level : float
    draws : (N,)
        The values.
    """

    at_mean: Bounded
    value: Estimated
    interval: tuple[float, float]
    level: float
    draws: Floats

    @property
    def error(self) -> float:
        """The standard error of the mean."""
        return self.value.standard_error

    def frame(self) -> DataFrame:
        """Return one row for each draw."""
        import pandas

        return pandas.DataFrame({"value (reward)": self.draws})


def value_under_counts(
    model: MDP,
    policy: PolicyLike,
    counts: Counted,
    *,
    rng: RNG,
    n: int = 2000,
    level: float = LEVEL,
) -> UncertainValue:
    """Return the value of a policy under a confusion of which only counts are known.

    The policy reads the perceived status; n matrices are drawn from the posterior of the counts,
    which have a prior.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> seen = Counted(counts=50 * np.eye(16, dtype=int), prior=1 / 16)
    >>> found = value_under_counts(mdp, "optimal", seen, rng=0, n=200)
    >>> found.interval[0] < found.at_mean.value < found.interval[1]
    True
    """
    if n < 1 or not 0 < level < 1:
        raise ModelError(
            f"{n} draws, level {level}",
            where="value_under_counts",
            fix="give 1 or more, and such as 0.95",
        )
    drawn = rng if isinstance(rng, np.random.Generator) else np.random.default_rng(seed_of(rng))
    passes = Passes(model)
    table = passes.table(policy)
    sizes = [min(BATCH, n - first) for first in range(0, n, BATCH)]
    matrices = (counts.samples(drawn, size) for size in sizes)
    draws = np.concatenate([passes.worth(table, some) for some in matrices])
    draws.setflags(write=False)
    tail = (1 - level) / 2
    low, high = np.quantile(draws, [tail, 1 - tail]).tolist()
    error = float(draws.std(ddof=1) / np.sqrt(n)) if n > 1 else inf
    return UncertainValue(
        at_mean=Bounded(
            value=float(passes.worth(table, counts.mean[None])[0]), error=passes.rounding
        ),
        value=Estimated(value=float(draws.mean()), standard_error=error),
        interval=(low, high),
        level=level,
        draws=draws,
    )
