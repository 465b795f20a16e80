"""How likely each reading makes what the paper reports.

An average over n independent experiments is N(m, v / n), with the exact mean m and variance v of
the return, and is reported rounded to one decimal: its likelihood is

    P(x - 0.05 ≤ average ≤ x + 0.05) / 0.1.

Numbers read off a plot ("around 70", "approximately 140") are taken as N(m, d²) with a stated
tolerance d. Rounding to the nearest ten alone has a standard deviation of 10/√12 = 2.9; the eye's
average over a noisy curve comes on top: d = 5 unless asked otherwise, and `variants` show what
hangs on it. The learned strategy's curve is set against the mean of the three learned policies.
The statuses that the text leaves open are a nuisance: `profile` takes the completion that fits
best, `marginal` the average over all of them. Source: Yuan et al. (2025), Sections 3.2 and 4.1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import log, pi, sqrt

import numpy as np

from exact_mdp.analysis.readings import (
    OptionSupport,
    ReadingSpace,
    credible,
    effective_number,
    posterior,
    support,
)
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.search import STARTS, ReadingSearch

ROUNDING = 0.05  # the averages are reported with one decimal
TOLERANCE = 5.0  # standard deviation of a number read off a plot
EXPERIMENTS = (reported.EXPERIMENTS, 10_000)  # Section 4.1 says 1,000, Section 3.2 10,000


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """Log likelihoods of R readings and C completions, part by part.

    Attributes
    ----------
    search : ReadingSearch
    experiments : int
        Runs behind each reported average.
    random_tolerance, converged_tolerance : float or None
        Standard deviations of the numbers read off the plot; None leaves the number out.
    averages : (R, C)
        Of the three reported averages.
    """

    search: ReadingSearch
    experiments: int
    random_tolerance: float | None
    converged_tolerance: float | None
    averages: Floats

    def __post_init__(self) -> None:
        for name in ("random_tolerance", "converged_tolerance"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ModelError(f"{name} is {value}", where="evidence", fix="give one above 0")

    @cached_property
    def random(self) -> Floats:
        """(R,) log likelihood of about 70 for the random strategy."""
        return _read_off(reported.RANDOM_RETURN, self.search.random_mean, self.random_tolerance)

    @cached_property
    def converged(self) -> Floats:
        """(R, C) log likelihood of about 140 after convergence."""
        return _read_off(
            reported.CONVERGED_RETURN, self.search.mean.mean(axis=2), self.converged_tolerance
        )

    @cached_property
    def total(self) -> Floats:
        """(R, C) log likelihood of all of it."""
        return self.averages + self.converged + self.random[:, None]

    @cached_property
    def profile(self) -> Floats:
        """(R,) log likelihood with the completion that fits best."""
        return np.asarray(self.total.max(axis=1))

    @cached_property
    def completion(self) -> Integers:
        """(R,) the completion that fits best."""
        return np.asarray(self.total.argmax(axis=1))

    @cached_property
    def marginal(self) -> Floats:
        """(R,) log likelihood averaged over the completions."""
        from scipy.special import logsumexp

        return np.asarray(logsumexp(self.total, axis=1) - log(self.total.shape[1]))

    @cached_property
    def weights(self) -> Floats:
        """(R,) posterior weights of the readings, from `marginal` and a uniform prior."""
        return posterior(self.marginal)

    @cached_property
    def ranking(self) -> Integers:
        """(R,) readings, the best supported first."""
        return np.argsort(-self.marginal, kind="stable")

    @property
    def effective_number(self) -> float:
        """Number of equally supported readings with the same entropy."""
        return effective_number(self.weights)

    def credible(self, share: float = 0.95) -> Integers:
        """Return the fewest readings that hold a share of the weight."""
        return credible(self.weights, share)

    @cached_property
    def support(self) -> list[OptionSupport]:
        """Support of each option with the other readings and completions averaged out."""
        return support(self.search.space, self.marginal)

    @cached_property
    def profile_support(self) -> list[OptionSupport]:
        """The same from `profile`."""
        return support(self.search.space, self.profile)

    def scores(self, reading: int, completion: int) -> Floats:
        """Return (3,) the reported averages' distances from the exact means, in standard errors."""
        mean = self.search.mean[reading, completion]
        spread = spread_of_average(self.search.variance[reading, completion], self.experiments)
        return np.asarray((reported_averages() - mean) / spread)

    def completion_support(self) -> list[OptionSupport]:
        """Support of the actions in statuses that the text leaves open, readings averaged out.

        With it, under the name `respectively`, that of the two orders of the actions in 1000 and
        0100: "as written" (directive, non-directive), or "swapped".
        """
        from scipy.special import logsumexp

        logs = logsumexp(self.total, axis=0) - log(len(self.total))
        options: dict[str, tuple[object, ...]] = {"respectively": ("as written", "swapped")}
        options |= dict.fromkeys(reported.UNSTATED, reported.ACTIONS)
        return support(ReadingSpace(options=options), logs)


def evidence(
    search: ReadingSearch,
    *,
    experiments: int = reported.EXPERIMENTS,
    random_tolerance: float | None = TOLERANCE,
    converged_tolerance: float | None = TOLERANCE,
) -> Evidence:
    """Return how likely each reading and completion makes what the paper reports."""
    if experiments < 1:
        raise ModelError(f"{experiments} experiments", where="evidence", fix="give 1 or more")
    averages = np.zeros(search.mean.shape[:2])
    for place, average in enumerate(reported_averages()):
        spread = np.sqrt(search.variance[:, :, place] / experiments)
        averages += _rounded(average, search.mean[:, :, place], spread)
    return Evidence(
        search=search,
        experiments=experiments,
        random_tolerance=random_tolerance,
        converged_tolerance=converged_tolerance,
        averages=averages,
    )


def reported_averages() -> Floats:
    """Return (3,) the averages that the paper reports, in the order of `STARTS`."""
    return np.array([reported.AVERAGE_RETURN[start] for start in STARTS])


def spread_of_average(variance: Floats, experiments: int) -> Floats:
    """Return the standard deviation of a reported average: of n runs, and of the rounding."""
    return np.asarray(np.sqrt(variance / experiments + (2 * ROUNDING) ** 2 / 12))


def _rounded(average: float, mean: Floats, spread: Floats) -> Floats:
    """Return log of P(average ± 0.05) / 0.1 under N(mean, spread²), far out in the tails too."""
    from scipy.special import log_ndtr

    near = np.abs(average - mean)  # the density is symmetric: the interval is put above the mean
    # P(low < Z < high) = Φ(-low) - Φ(-high)
    low, high = (near - ROUNDING) / spread, (near + ROUNDING) / spread
    outer, inner = log_ndtr(-high), log_ndtr(-low)
    return np.asarray(inner + np.log1p(-np.exp(outer - inner)) - log(2 * ROUNDING))


def _read_off(number: float, mean: Floats, tolerance: float | None) -> Floats:
    if tolerance is None:
        return np.zeros(mean.shape)
    score = (number - mean) / tolerance
    return np.asarray(-0.5 * score**2 - log(tolerance * sqrt(2 * pi)))


# ---- what hangs on the tolerances --------------------------------------------------------------

VARIANTS: dict[str, tuple[int, float | None, float | None]] = {
    "1,000 experiments, tolerance 5": (EXPERIMENTS[0], TOLERANCE, TOLERANCE),
    "10,000 experiments, tolerance 5": (EXPERIMENTS[1], TOLERANCE, TOLERANCE),
    "tolerance 2.5": (EXPERIMENTS[0], 2.5, 2.5),
    "tolerance 10": (EXPERIMENTS[0], 10.0, 10.0),
    "tolerance 20 for the random strategy": (EXPERIMENTS[0], 20.0, TOLERANCE),
    "without the random strategy": (EXPERIMENTS[0], None, TOLERANCE),
    "the three averages alone": (EXPERIMENTS[0], None, None),
}
"""Experiments, and tolerances for the random strategy and after convergence, to be compared."""


def variants(search: ReadingSearch) -> dict[str, Evidence]:
    """Return the evidence under each of `VARIANTS`, the first being `evidence` as it is."""
    known = {experiments: evidence(search, experiments=experiments) for experiments in EXPERIMENTS}
    return {
        name: replace(known[experiments], random_tolerance=random, converged_tolerance=converged)
        for name, (experiments, random, converged) in VARIANTS.items()
    }
