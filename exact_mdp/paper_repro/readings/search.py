"""Every reading of the paper's text, with every policy that it may mean: exact mean and variance.

The readings are all combinations of `mdp.care.tables.READINGS`, of the tasks that the experiments
may have run, and of how the reported returns may be discounted: 6,912. What the paper says of its
three learned policies (Yuan et al. 2025, Section 4.1) leaves 512 completions: the actions in four
statuses, and which of 1000 and 0100 gets "directive or non-directive, respectively". For each of
these 3 · 512 · 6,912 the first two moments of the return are those of `solvers.care`: dynamic
programming in double precision, no sampling.

Three completions are named. With the order as written the open statuses are filled in so that the
final policy has its highest exact value: this is the policy that "reported" names. The same with
the order swapped is the second. The third judges the three reported averages: of those that
training can be expected to end with (`readings.completions`) the one that fits them best,

    χ²(completion) = Σ (mean - reported average)² / (variance / n) over the three policies.

The best fit of all stands beside it, and the range over all completions beside every number that
depends on them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.readings import ReadingSpace, equivalent
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.care.tables import READINGS
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.mdp.validate import as_discount
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.completions import learnable
from exact_mdp.paper_repro.reported import COMPLETIONS, NUMBER, STARTS
from exact_mdp.solvers.care import optimal, policy_values, policy_values_of_last
from exact_mdp.solvers.parallel import many

REPORTED = np.array(list(reported.AVERAGE_RETURN.values()))
TASKS = ((3,), (3, 1), (2,), (4,), (1, 1, 1), (6,))
DISCOUNTS = (Fraction(1), Fraction(19, 20))
BLOCK = 48  # scenarios in a piece of work
ARRAYS = (
    "mean", "variance", "error", "variance_error", "random_mean", "random_variance", "optimum",
    "gaps",
)  # fmt: skip

PAPER_READINGS = ReadingSpace(
    options={**READINGS, "tasks": TASKS, "evaluation_discount": DISCOUNTS}
)
"""The readings of the paper, the evaluation discount moving fastest."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Averages:
    """Exact moments of the return under every completion, of one reading or of R readings."""

    mean: Floats  # (C, 3) or (R, C, 3), last axis: the action in 0000, in the order of `STARTS`
    variance: Floats  # the same
    error: float | Floats  # (R,) how far a mean may be from the exact one
    log_weights: Floats | None = None  # (…, C) of the completions; None where all are alike

    @cached_property
    def score(self) -> Floats:
        """(…, C, 3) exact less reported, in exact standard errors of the reported average."""
        return np.asarray((self.mean - REPORTED) / np.sqrt(self.variance / reported.EXPERIMENTS))

    @cached_property
    def chi_squared(self) -> Floats:
        """(…, C) sum of the three squared scores."""
        return np.asarray((self.score**2).sum(axis=-1))

    @cached_property
    def learnable(self) -> NDArray[np.bool_]:
        """(…, C) the completions that training can be expected to end with."""
        if self.log_weights is None:
            return np.ones(self.chi_squared.shape, dtype=bool)
        return learnable(self.log_weights)

    @cached_property
    def fitting(self) -> Integers:
        """(…) the learnable completion that fits the three reported averages best, together."""
        return np.asarray(np.where(self.learnable, self.chi_squared, np.inf).argmin(axis=-1))

    @cached_property
    def fitting_of_all(self) -> Integers:
        """(…) the completion that fits them best, learnable or not."""
        return np.asarray(self.chi_squared.argmin(axis=-1))

    def at_fitting(self, values: Floats) -> Floats:
        """Return (…, 3) those of values (…, C, 3) that belong to the best fit."""
        return np.take_along_axis(values, self.fitting[..., None, None], axis=-2)[..., 0, :]

    @cached_property
    def probabilities(self) -> Floats:
        """(…, C) chance of a χ² on three degrees of freedom above that of each completion."""
        from scipy import stats

        return np.asarray(stats.chi2.sf(self.chi_squared, len(STARTS)))

    @cached_property
    def probability(self) -> Floats:
        """(…) that of the learnable completion that fits best."""
        at = self.fitting[..., None]
        return np.take_along_axis(self.probabilities, at, axis=-1)[..., 0]

    @cached_property
    def expected_probability(self) -> Floats:
        """(…) the chances averaged over all completions, by their weights."""
        if self.log_weights is None:
            return np.asarray(self.probabilities.mean(axis=-1))
        return np.asarray((np.exp(self.log_weights) * self.probabilities).sum(axis=-1))

    # ---- of one reading ----

    def best(self, order: str = "as written") -> int:
        """Return the completion of an order that gives the final policy its highest value."""
        return max(of_order(order), key=lambda number: float(self.mean[number, 0]))

    @property
    def named(self) -> dict[str, int]:
        """The completions that numbers are given for."""
        return {
            "as written": self.best(),
            "swapped": self.best("swapped"),
            "best learnable fit": int(self.fitting),
            "best fit of all": int(self.fitting_of_all),
        }

    def range(self, start: str) -> tuple[float, float]:
        """Return the lowest and highest mean of the policy with an action in 0000."""
        mean = self.mean[:, STARTS.index(start)]
        return float(mean.min()), float(mean.max())


def of_order(order: str) -> Sequence[int]:
    """Return the completions that follow an order of "respectively"."""
    return [n for n, each in enumerate(COMPLETIONS) if reported.order(each) == order]


def averages(scenario: Scenario) -> Averages:
    """Evaluate the three reported policies under every completion, side by side."""
    rate, policies = [[float(as_discount(scenario.discount))]], reported.policies()
    found = policy_values(scenario, ["discount"], rate, policies, second_moment=True, threads=1)
    assert found.variance is not None
    mean, variance = (x[0].reshape(-1, len(STARTS)) for x in (found.mean, found.variance))
    return Averages(mean=mean, variance=variance, error=float(found.error[0]))


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadingSearch:
    """Exact figures of R readings, C completions and the three reported policies.

    Errors are the bounds of `solvers.care`, which hold a priori.
    """

    scenario: Scenario  # the default reading
    space: ReadingSpace  # the readings; R of them
    completions: tuple[Mapping[str, str], ...]  # actions by status, where the text leaves them open
    mean: Floats  # (R, C, 3) of the return; last axis: the action in 0000, in the order of `STARTS`
    variance: Floats  # the same
    random_mean: Floats  # (R,) of the random strategy
    random_variance: Floats  # (R,)
    optimum: Floats  # (R,) at the evaluation discount, over policies that know subtask and trial
    gaps: Floats  # (R, 16, 4) what an action loses by status, in the first trial of all
    error: Floats  # (R,) of the means and the optimum
    variance_error: Floats  # (R,)

    def __post_init__(self) -> None:
        for name in ARRAYS:
            getattr(self, name).setflags(write=False)

    @property
    def evaluations(self) -> int:
        """Number of policies evaluated, the random strategy once in each reading."""
        return int(self.mean.size + self.random_mean.size)

    @cached_property
    def averages(self) -> Averages:
        """The three averages under every completion of each reading, beside the reported ones."""
        return Averages(mean=self.mean, variance=self.variance, error=self.error)

    @cached_property
    def regret(self) -> Floats:
        """(R, C) what the final policy loses against the optimum."""
        return np.asarray(self.optimum[:, None] - self.mean[:, :, 0])

    def policy(self, completion: int, start: str) -> dict[str, str]:
        """Return a reported policy by status, completed in one way."""
        return reported.policy(start, self.completions[completion])

    def reading(self, number: int) -> Scenario:
        """Return the scenario under one reading, at its evaluation discount."""
        return self.space.apply(self.scenario, number)

    def optimal_under(self, status: str, action: str) -> NDArray[np.bool_]:
        """Return (R,) whether an action is optimal in a status, in the first trial of all.

        Where it loses less than twice the bound on the errors, it counts as optimal.
        """
        gaps = self.gaps[:, int(status, 2), NUMBER[action]]
        return np.asarray(gaps <= 2 * self.error)

    def equivalent(self) -> Integers:
        """Return (R,) for each reading the first one whose figures are all the same.

        All: means and variances of every policy of the search, and the optimum; up to rounding.
        """
        size = len(self.space)
        means = [self.mean.reshape(size, -1), self.random_mean[:, None], self.optimum[:, None]]
        spreads = [self.variance.reshape(size, -1), self.random_variance[:, None]]
        same = equivalent(np.concatenate(means, axis=1), 2 * float(self.error.max()))
        whole = np.concatenate([same[:, None], *spreads], axis=1)
        return equivalent(whole, 2 * float(self.variance_error.max()))


def search(
    scenario: Scenario | None = None,
    *,
    space: ReadingSpace = PAPER_READINGS,
    out: str | Path | None = None,
    **how: Any,
) -> ReadingSearch:
    """Evaluate every compatible policy under every reading; the last one is `evaluation_discount`.

    An interrupted search goes on from the folder `out`. In `n_jobs` processes or
    with `progress`, as `solvers.parallel.many` says. Raises ModelError where the folder holds
    another search or a damaged file.
    """
    if space.names[-1:] != ("evaluation_discount",):
        raise ModelError(
            "the last reading is not evaluation_discount", where="search", fix="put it last"
        )
    base = Scenario.load("yuan2025") if scenario is None else scenario
    policies = reported.policies()
    scenarios = range(0, len(space), len(space.options["evaluation_discount"]))
    pieces = [list(scenarios[i : i + BLOCK]) for i in range(0, len(scenarios), BLOCK)]
    found = many(
        partial(_evaluate, base, space, policies),
        pieces,
        key={
            "readings": {name: [str(o) for o in values] for name, values in space.options.items()},
            "parameters": {name: str(value) for name, value in base.values().items()},
            "max_trial": base.max_trial,
            "policies": (policies @ (4 ** np.arange(16))).tolist(),
            "block": BLOCK,
        },
        folder=out,
        what="readings",
        **how,
    )
    joined: dict[str, Any] = {
        name: np.concatenate([piece[name] for piece in found]) for name in ARRAYS
    }
    for name in ("mean", "variance"):
        joined[name] = joined[name].reshape(len(space), len(COMPLETIONS), len(STARTS))
    return ReadingSearch(
        scenario=base,
        space=space,
        completions=COMPLETIONS,
        **joined,
    )


def searched(out: Path | None, space: ReadingSpace = PAPER_READINGS) -> bool:
    """Return whether a folder holds a whole search, which is then read at once."""
    scenarios = len(space) // len(space.options["evaluation_discount"])
    return out is not None and len(list(out.glob("*.npz"))) == -(-scenarios // BLOCK)


def _evaluate(
    base: Scenario, space: ReadingSpace, policies: Integers, numbers: Sequence[int]
) -> dict[str, Numbers]:
    """Return the figures of some scenarios, at every evaluation discount.

    A probability above 1 under a reading is not warned of here, for thousands of readings; it is
    when one of them is compiled.
    """
    draws = np.array([[float(as_discount(rate))] for rate in space.options["evaluation_discount"]])
    anything = np.full((1, 16, len(NUMBER)), 1 / len(NUMBER))
    found: dict[int, dict[str, Any]] = {}
    for longest, ends in _ends_of(base, space, numbers).items():
        scenario = space.apply(base, longest)
        given, random = (
            policy_values_of_last(
                scenario,
                ["discount"],
                draws,
                each,
                list(ends.values()),
                second_moment=True,
                threads=1,
                warn=False,
            )
            for each in (policies, anything)
        )
        for number, of_given, of_random in zip(ends, given, random, strict=True):
            there = space.apply(base, number)
            best = optimal(there, ["discount"], draws, gaps=True, threads=1, warn=False)
            assert of_random.variance is not None
            found[number] = {
                "mean": of_given.mean,
                "variance": of_given.variance,
                "error": np.maximum(of_given.error, best.error),
                "variance_error": of_given.variance_error,
                "random_mean": of_random.mean[:, 0],
                "random_variance": of_random.variance[:, 0],
                "optimum": best.start,
                "gaps": best.gaps,
            }
    return {name: np.concatenate([found[number][name] for number in numbers]) for name in ARRAYS}


def _ends_of(
    base: Scenario, space: ReadingSpace, numbers: Sequence[int]
) -> dict[int, dict[int, int]]:
    """Return which scenarios are the end of a longer one, so that one backward induction does both.

    Keys are scenarios to evaluate; values say which scenarios are their last k subtasks. The
    tasks [2] and [3] are the end of [6], [1] of [3, 1]; only where all other readings agree.
    """
    alike: dict[tuple[object, ...], list[tuple[list[bool], int]]] = {}
    for number in numbers:
        settings: dict[str, Any] = space.settings(number)
        tasks: Sequence[int] = settings.pop("tasks", base.tasks)
        # Whether a subtask is the last one of its task, from the end.
        ends = [i == 0 for size in reversed(tasks) for i in range(size)]
        alike.setdefault(tuple(settings.values()), []).append((ends, number))
    found: dict[int, dict[int, int]] = {}
    for group in alike.values():
        taken: list[tuple[list[bool], int]] = []
        for ends, number in sorted(group, key=lambda one: -len(one[0])):
            size = len(ends)
            longest = next((n for longer, n in taken if longer[:size] == ends), None)
            if longest is None:
                taken.append((ends, number))
                longest = number
            found.setdefault(longest, {})[number] = size
    return found
