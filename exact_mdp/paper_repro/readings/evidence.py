"""How likely each reading makes what the paper reports, and what cannot hold together.

An average over n independent experiments is N(m, v / n), with the exact mean m and variance v of
the return, and is reported rounded to one decimal: its likelihood is

    P(x - 0.05 ≤ average ≤ x + 0.05) / 0.1.

Numbers read off a plot ("around 70", "approximately 140") are taken as N(m, d²) with a stated
tolerance d. Rounding to the nearest ten alone has a standard deviation of 10/√12 = 2.9; the eye's
average over a noisy curve comes on top: d = 5 unless asked otherwise, and `variants` show what
depends on it. The learned strategy's curve is set against the mean of the three learned policies.
The statuses that the text leaves open are a nuisance: `marginal` is the average over all
completions, weighed by how often training ends with each (`readings.completions`), all alike
without such weights; `completion` is the one that has the largest part in it.

Statements can contradict each other. Each is a distance from what a reading and a completion imply,
in standard deviations of the number that is reported. Statements can hold together where some
reading and completion leaves none of them further off than three:

    score(set) = min over readings and completions of the max over the set of the distance.

A set that cannot is a contradiction; the smallest ones are those without a smaller one inside.

Source: Yuan et al. (2025), Sections 3.2 and 4.1.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import log, pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import special

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
from exact_mdp.paper_repro.readings.search import REPORTED, ReadingSearch
from exact_mdp.paper_repro.reported import AVERAGE_RETURN, NUMBER, ORDERS, STARTS

ROUNDING = 0.05  # the averages are reported with one decimal
TOLERANCE = 5.0  # standard deviation of a number read off a plot
EXPERIMENTS = (reported.EXPERIMENTS, 10_000)  # Section 4.1 says 1,000, Section 3.2 10,000


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """Log likelihoods of R readings and C completions, part by part."""

    search: ReadingSearch
    experiments: int  # runs behind each reported average
    # Standard deviations of the numbers read off the plot; None leaves the number out.
    random_tolerance: float | None
    converged_tolerance: float | None
    averages: Floats  # (R, C) of the three reported averages
    log_weights: Floats | None = None  # (R, C) of the completions; None where all are alike

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
    def completion(self) -> Integers:
        """(R,) the completion that fits best and is learned often, taken together."""
        return np.asarray(self._weighed.argmax(axis=1))

    @cached_property
    def marginal(self) -> Floats:
        """(R,) log likelihood averaged over the completions with their weights."""
        return np.asarray(special.logsumexp(self._weighed, axis=1))

    @property
    def _weighed(self) -> Floats:
        """(R, C) log likelihood and log weight."""
        if self.log_weights is None:
            return self.total - log(self.total.shape[1])
        return self.total + self.log_weights

    @cached_property
    def weights(self) -> Floats:
        """(R,) posterior weights of the readings, from `marginal` and a uniform prior."""
        return posterior(self.marginal)

    @cached_property
    def ranking(self) -> Integers:
        """(R,) readings, the best supported first."""
        return np.argsort(-self.marginal, kind="stable")

    def rank(self, reading: int = 0) -> int:
        """Return the place of a reading in the ranking, from 1 on."""
        return int(np.flatnonzero(self.ranking == reading)[0]) + 1

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

    def completion_support(self) -> list[OptionSupport]:
        """Support of the actions in statuses that the text leaves open, readings averaged out.

        By the reported numbers alone, whatever training ends with: a factor, not a weight.

        With it, under the name `respectively`, that of the two orders of the actions in 1000 and
        0100: "as written" (directive, non-directive), or "swapped".
        """
        logs = special.logsumexp(self.total, axis=0) - log(len(self.total))
        options: dict[str, tuple[object, ...]] = {"respectively": ("as written", "swapped")}
        options |= dict.fromkeys(reported.UNSTATED, reported.ACTIONS)
        return support(ReadingSpace(options=options), logs)


def evidence(
    search: ReadingSearch,
    *,
    experiments: int = reported.EXPERIMENTS,
    random_tolerance: float | None = TOLERANCE,
    converged_tolerance: float | None = TOLERANCE,
    log_weights: Floats | None = None,
) -> Evidence:
    """Return how likely each reading and completion makes what the paper reports."""
    if experiments < 1:
        raise ModelError(f"{experiments} experiments", where="evidence", fix="give 1 or more")
    averages = np.zeros(search.mean.shape[:2])
    for place, average in enumerate(REPORTED.tolist()):
        spread = np.sqrt(search.variance[:, :, place] / experiments)
        averages += _rounded(average, search.mean[:, :, place], spread)
    return Evidence(
        search=search,
        experiments=experiments,
        random_tolerance=random_tolerance,
        converged_tolerance=converged_tolerance,
        averages=averages,
        log_weights=log_weights,
    )


def spread_of_average(variance: Floats, experiments: int) -> Floats:
    """Return the standard deviation of a reported average: of n runs, and of the rounding."""
    return np.asarray(np.sqrt(variance / experiments + (2 * ROUNDING) ** 2 / 12))


def _rounded(average: float, mean: Floats, spread: Floats) -> Floats:
    """Return log of P(average ± 0.05) / 0.1 under N(mean, spread²), far out in the tails too."""
    near = np.abs(average - mean)  # the density is symmetric: the interval is put above the mean
    # P(low < Z < high) = Φ(-low) - Φ(-high)
    low, high = (near - ROUNDING) / spread, (near + ROUNDING) / spread
    outer, inner = special.log_ndtr(-high), special.log_ndtr(-low)
    return np.asarray(inner + np.log1p(-np.exp(outer - inner)) - log(2 * ROUNDING))


def _read_off(number: float, mean: Floats, tolerance: float | None) -> Floats:
    if tolerance is None:
        return np.zeros(mean.shape)
    score = (number - mean) / tolerance
    return np.asarray(-0.5 * score**2 - log(tolerance * sqrt(2 * pi)))


# ---- what depends on the tolerances -----------------------------------------------------------

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
ALIKE = "all completions alike"


def variants(main: Evidence) -> dict[str, Evidence]:
    """Return the evidence under each of `VARIANTS`, and with all completions `ALIKE`."""
    few, many = EXPERIMENTS
    weights = main.log_weights
    known = {few: main, many: evidence(main.search, experiments=many, log_weights=weights)}
    found = {
        name: replace(known[experiments], random_tolerance=random, converged_tolerance=converged)
        for name, (experiments, random, converged) in VARIANTS.items()
    }
    return found | {ALIKE: replace(main, log_weights=None)}


# ---- what can hold together --------------------------------------------------------------------

TOGETHER = 3.0  # standard deviations
PART = 128  # readings at a time
SHORT = {start: f"a{NUMBER[start]}" for start in STARTS}
Singles = NDArray[np.float32]

# What the paper says, by a short name: in a sentence, and on an axis.
STATEMENTS = {
    **{
        SHORT[start]: (
            f"{SHORT[start]} in 0000 returned {average} on average",
            f"{SHORT[start]} in 0000 returns {average}",
        )
        for start, average in AVERAGE_RETURN.items()
    },
    "converged": (
        f"the learned policies return about {reported.CONVERGED_RETURN}",
        f"learned policies: about {reported.CONVERGED_RETURN}",
    ),
    "random": (
        f"the random strategy returns around {reported.RANDOM_RETURN}",
        f"random strategy: around {reported.RANDOM_RETURN}",
    ),
    "ranking": ("a2 in 0000 is better than a3, and a3 than a1", "a2 above a3 above a1"),
    "respectively": (
        "1000 gets directive and 0100 non-directive, in the order of the sentence",
        "1000: a3 and 0100: a2, as written",
    ),
    "optimal": (
        "the final policy is optimal, as far as its experiments can tell",
        "the final policy is optimal",
    ),
}


@dataclass(frozen=True, kw_only=True)
class Joint:
    """How well some statements can hold together under one reading and completion."""

    statements: tuple[str, ...]  # keys of `STATEMENTS`
    score: float  # the least, over those, of the largest distance, in standard deviations
    reading: int  # where it is least
    completion: int
    readings: int  # how many readings let them hold together with some completion

    @property
    def possible(self) -> bool:
        """Whether each statement can be within three standard deviations at once."""
        return self.score <= TOGETHER


def distances(found: Evidence) -> dict[str, Floats]:
    """Return (R, C) the distance of every statement, in standard deviations; 0 where it holds.

    The ranking is off by what it lacks, in standard errors of the difference of two averages; the
    final policy by its regret, in standard errors of its average: an optimum that the experiments
    could not tell from it counts as reached. The order of a sentence holds (0) or does not (∞).
    """
    search = found.search
    error = search.variance / found.experiments
    spread = spread_of_average(search.variance, found.experiments)
    scores = np.abs(search.mean - REPORTED) / spread
    gaps = np.diff(search.mean, axis=2) / np.sqrt(error[:, :, :-1] + error[:, :, 1:])
    written = [
        0.0 if ORDERS["as written"].items() <= each.items() else np.inf
        for each in search.completions
    ]
    shape = scores.shape[:2]
    random = np.abs(search.random_mean - reported.RANDOM_RETURN)
    converged = np.abs(search.mean.mean(axis=2) - reported.CONVERGED_RETURN)
    return {
        **{SHORT[start]: scores[:, :, place] for place, start in enumerate(STARTS)},
        "converged": converged / (found.converged_tolerance or TOLERANCE),
        "random": np.broadcast_to((random / (found.random_tolerance or TOLERANCE))[:, None], shape),
        "ranking": np.maximum(gaps.max(axis=2), 0.0),
        "respectively": np.broadcast_to(np.array(written), shape),
        "optimal": np.maximum(search.regret, 0.0) / np.sqrt(error[:, :, 0]),
    }


def joint(found: Evidence) -> list[Joint]:
    """Return how well every set of statements can hold together, small sets first."""
    # Single precision: half the memory.
    single = {name: each.astype(np.float32) for name, each in distances(found).items()}
    merged: dict[tuple[str, ...], Joint] = {}
    # A part of the readings at a time, so that the arrays stay near the processor.
    for first in range(0, len(found.search.space), PART):
        part = {name: array[first : first + PART] for name, array in single.items()}
        for each in _sets(part, (), np.zeros(1, dtype=np.float32)):
            moved = replace(each, reading=each.reading + first)
            merged[each.statements] = _better(merged.get(each.statements), moved)
    order = list(STATEMENTS)
    return sorted(
        merged.values(),
        key=lambda each: (len(each.statements), [order.index(name) for name in each.statements]),
    )


def _better(known: Joint | None, other: Joint) -> Joint:
    """Return the nearer of two, the first where they are alike, with the readings of both."""
    if known is None:
        return other
    nearer = other if other.score < known.score else known
    return replace(nearer, readings=known.readings + other.readings)


def _sets(parts: Mapping[str, Singles], names: tuple[str, ...], worst: Singles) -> Iterator[Joint]:
    """Yield every set that adds statements behind the last one of `names`, depth first."""
    left = list(parts)
    behind = left.index(names[-1]) + 1 if names else 0
    for name in left[behind:]:
        both = np.maximum(worst, parts[name])
        nearest = both.min(axis=1)
        reading = int(nearest.argmin())
        yield Joint(
            statements=(*names, name),
            score=float(nearest[reading]),
            reading=reading,
            completion=int(both[reading].argmin()),
            readings=int((nearest <= TOGETHER).sum()),
        )
        yield from _sets(parts, (*names, name), both)


def contradictions(found: Sequence[Joint]) -> list[Joint]:
    """Return the smallest sets of statements that cannot hold together under any reading."""
    cannot = [each for each in found if not each.possible]
    return [each for each in cannot if not any(_inside(other, each) for other in cannot)]


def largest_possible(found: Sequence[Joint]) -> list[Joint]:
    """Return the largest sets of statements that can hold together under some reading."""
    can = sorted((each for each in found if each.possible), key=lambda each: -len(each.statements))
    return [each for each in can if not any(_inside(each, other) for other in can)]


def _inside(small: Joint, large: Joint) -> bool:
    return set(small.statements) < set(large.statements)
