"""Every reading of the paper's text, with every policy that it may mean: exact mean and variance.

The readings are all combinations of `mdp.care.scenario.READINGS`, of the tasks that the experiments
may have run, and of how the reported returns may be discounted: 6,912. What the paper says of its
three learned policies (Yuan et al. 2025, Section 4.1) leaves 512 completions: the actions in four
statuses, and which of 1000 and 0100 gets "directive or non-directive, respectively". For each of
these 3 · 512 · 6,912 the first two moments of the return are those of `solvers.care`: dynamic
programming in double precision, no sampling.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.readings import ReadingSpace, equivalent
from exact_mdp.mdp import ModelError, Scenario
from exact_mdp.mdp.care.tables import READINGS
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.mdp.validate import as_discount
from exact_mdp.paper_repro import reported
from exact_mdp.solvers.parallel.many import many

TASKS = ((3,), (3, 1), (2,), (4,), (1, 1, 1), (6,))
DISCOUNTS = (Fraction(1), Fraction(19, 20))
STARTS = tuple(reported.AVERAGE_RETURN)
BLOCK = 48  # scenarios in a piece of work
FIGURES = (
    "mean",
    "variance",
    "error",
    "variance_error",
    "random_mean",
    "random_variance",
    "optimum",
    "gaps",
)

PAPER_READINGS = ReadingSpace(
    options={**READINGS, "tasks": TASKS, "evaluation_discount": DISCOUNTS}
)
"""The readings of the paper, the evaluation discount moving fastest."""


def completions() -> tuple[Mapping[str, str], ...]:
    """Return the actions that the paper's text leaves open, in every way that it can be read.

    Examples
    --------
    >>> len(completions()), completions()[0]["1000"], completions()[256]["1000"]
    (512, 'directive', 'non-directive')
    """
    return tuple(reported.completions())


def policies(filled: Sequence[Mapping[str, str]], starts: Sequence[str] = STARTS) -> Integers:
    """Return (C · starts, 16) action numbers by status vector, the action in 0000 moving fastest.

    Examples
    --------
    >>> policies(completions()[:1]).tolist()[0]
    [2, 0, 1, 1, 2, 0, 1, 1, 3, 0, 1, 1, 3, 0, 1, 1]
    """
    number = {action: place for place, action in enumerate(reported.ACTIONS)}
    return np.array(
        [
            [number[action] for _, action in sorted(reported.policy(start, dict(each)).items())]
            for each in filled
            for start in starts
        ],
        dtype=np.int64,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadingSearch:
    """Exact figures of R readings, C completions and the three reported policies.

    Attributes
    ----------
    scenario : Scenario
        The default reading.
    space : ReadingSpace
        The readings; R of them.
    completions : tuple of mapping
        Actions by status, for the statuses whose action the text leaves open.
    mean, variance : (R, C, 3)
        Of the return; last axis: the action in 0000, in the order of `STARTS`.
    random_mean, random_variance : (R,)
        The same of the random strategy.
    optimum : (R,)
        Optimal value at the evaluation discount, over policies that know subtask and trial.
    gaps : (R, 16, 4)
        What each action loses to the best one by status vector, in the first trial of the first
        subtask, at the evaluation discount.
    error, variance_error : (R,)
        How far the means and the optimum, and the variances, may be from the exact ones: the
        bounds of `solvers.care`, which hold a priori.
    seconds : float
        What the search took, this time.
    """

    scenario: Scenario
    space: ReadingSpace
    completions: tuple[Mapping[str, str], ...]
    mean: Floats
    variance: Floats
    random_mean: Floats
    random_variance: Floats
    optimum: Floats
    gaps: Floats
    error: Floats
    variance_error: Floats
    seconds: float

    def __post_init__(self) -> None:
        for name in FIGURES:
            getattr(self, name).setflags(write=False)

    @property
    def evaluations(self) -> int:
        """Number of policies evaluated, the random strategy once in each reading."""
        return int(self.mean.size + self.random_mean.size)

    def policy(self, completion: int, start: str) -> dict[str, str]:
        """Return a reported policy by status, completed in one way."""
        return reported.policy(start, dict(self.completions[completion]))

    def reading(self, number: int) -> Scenario:
        """Return the scenario under one reading, at its evaluation discount."""
        return self.space.apply(self.scenario, number)

    def optimal_under(self, status: str, action: str) -> NDArray[np.bool_]:
        """Return (R,) whether an action is optimal in a status, in the first trial of all.

        Where it loses less than twice the bound on the errors, it counts as optimal.
        """
        number = reported.ACTIONS.index(action)
        return np.asarray(self.gaps[:, int(status, 2), number] <= 2 * self.error)

    def equivalent(self) -> Integers:
        """Return (R,) for each reading the first one whose figures are all the same.

        All: means and variances of every policy of the search, and the optimum; up to rounding.
        """
        size = len(self.space)
        means = [self.mean.reshape(size, -1), self.random_mean[:, None], self.optimum[:, None]]
        spreads = [self.variance.reshape(size, -1), self.random_variance[:, None]]
        same = equivalent(np.concatenate(means, axis=1), 2 * float(self.error.max()))
        first = equivalent(
            np.concatenate([same[:, None], *spreads], axis=1), 2 * float(self.variance_error.max())
        )
        return first


def search(
    scenario: Scenario | None = None,
    *,
    space: ReadingSpace = PAPER_READINGS,
    n_jobs: int | None = None,
    scheduler: str | None = None,
    out: str | Path | None = None,
    progress: bool = False,
) -> ReadingSearch:
    """Evaluate every compatible policy under every reading.

    Parameters
    ----------
    scenario : Scenario, optional
        The paper's model unless given.
    space : ReadingSpace
        The readings; the last one is `evaluation_discount`.
    n_jobs : int, optional
        Processes; all cores where None.
    scheduler : str, optional
        A Dask cluster instead, "tcp://host:port" or "local"; see `solvers.parallel.many.many`.
    out : path, optional
        Folder for finished pieces; an interrupted search goes on from there.
    progress : bool
        Show a bar on standard error where that is a terminal.

    Raises
    ------
    ModelError
        For other readings than these, and where the folder holds another search or a damaged file.
    """
    if space.names[-1:] != ("evaluation_discount",):
        raise ModelError(
            "the last reading is not evaluation_discount", where="search", fix="put it last"
        )
    started = time.perf_counter()
    base = Scenario.load("yuan2025") if scenario is None else scenario
    filled = completions()
    chosen = policies(filled)
    scenarios = range(0, len(space), len(space.options["evaluation_discount"]))
    pieces = [list(scenarios[i : i + BLOCK]) for i in range(0, len(scenarios), BLOCK)]
    found = many(
        partial(_evaluate, base, space, chosen),
        pieces,
        key={
            "readings": {name: [str(o) for o in values] for name, values in space.options.items()},
            "parameters": {name: str(value) for name, value in base.values().items()},
            "max_trial": base.max_trial,
            "policies": [int(number) for number in _code(chosen)],
            "block": BLOCK,
        },
        n_jobs=n_jobs,
        scheduler=scheduler,
        folder=out,
        progress=progress,
        what="readings",
    )
    joined = {name: np.concatenate([piece[name] for piece in found]) for name in found[0]}
    shape = (len(space), len(filled), len(STARTS))
    joined["mean"] = joined["mean"].reshape(shape)
    joined["variance"] = joined["variance"].reshape(shape)
    return ReadingSearch(
        scenario=base,
        space=space,
        completions=filled,
        **joined,
        seconds=time.perf_counter() - started,
    )


def _code(chosen: Integers) -> Integers:
    """Return each policy as one number."""
    return np.asarray(chosen @ (4 ** np.arange(16)))


def _evaluate(
    base: Scenario, space: ReadingSpace, chosen: Integers, numbers: Sequence[int]
) -> dict[str, Numbers]:
    """Return the figures of some scenarios, at every evaluation discount.

    Where chances pass 1 under a reading nothing is told here, for thousands of them; whoever
    compiles one is told.
    """
    from exact_mdp.solvers.care import optimal, policy_values_of_last

    draws = np.array([[float(as_discount(rate))] for rate in space.options["evaluation_discount"]])
    anything = np.full((1, 16, len(reported.ACTIONS)), 1 / len(reported.ACTIONS))
    found: dict[int, dict[str, Floats]] = {}
    for longest, others in _on_the_way(base, space, numbers).items():
        scenario = space.apply(base, longest)
        lengths = list(others.values())
        given, random = (
            policy_values_of_last(
                scenario,
                ["discount"],
                draws,
                each,
                lengths,
                second_moment=True,
                threads=1,
                warn=False,
            )
            for each in (chosen, anything)
        )
        for number, of_given, of_random in zip(others, given, random, strict=True):
            there = space.apply(base, number)
            best = optimal(there, ["discount"], draws, gaps=True, threads=1, warn=False)
            assert best.gaps is not None
            assert of_given.variance is not None
            assert of_given.variance_error is not None
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
    return {name: np.concatenate([found[number][name] for number in numbers]) for name in FIGURES}


def _on_the_way(
    base: Scenario, space: ReadingSpace, numbers: Sequence[int]
) -> dict[int, dict[int, int]]:
    """Return which scenarios backward induction of others comes by.

    Keys are scenarios to evaluate; values say which scenarios are their last so many subtasks. The
    tasks [2] and [3] are the end of [6], [1] of [3, 1]; only where all other readings agree.
    """
    alike: dict[tuple[object, ...], list[tuple[list[bool], int]]] = {}
    for number in numbers:
        settings = space.settings(number)
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
