"""Many care models at once: the optimum of every draw, and the value of every policy.

A draw sets some parameters of a scenario; the others keep their value. Each draw is solved by
backward induction over subtasks and trials, or policies are evaluated in it, by compiled loops that
never form the model (see `solvers.kernels.care`; rounding errors are bounded in advance, see
`solvers.care_layout`). Draws are given to threads in blocks; no result depends on its block.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mdp.errors import ModelError
from mdp.table import Floats
from solvers.care_layout import MOST_ACTIONS, as_policies, bounds, finite, prepared, warn_of_draws

if TYPE_CHECKING:
    from mdp.scenario import Scenario
    from solvers.kernels.care import Care, Room

BLOCK = 512  # draws, or policies, that a thread takes at a time


@dataclass(frozen=True, kw_only=True, eq=False)
class CareValues:
    """The optimum of each of D draws.

    Attributes
    ----------
    start : (D,)
        Optimal start values.
    error : (D,)
        How far each may be from the exact optimum of its draw.
    gaps : (D, V, A), optional
        What an action loses to the best one, in each status vector at subtask 0, trial 0; twice
        `error` bounds the error of a gap.
    actions : (D, K, trials, flags, V) int8, optional
        An optimal action in each state, the first one with the largest value. The flag is 1 where
        a subtask of the task was skipped; there is one flag unless the task bonus asks for two.
    """

    start: Floats
    error: Floats
    gaps: Floats | None
    actions: NDArray[np.int8] | None

    def optimal(self, tolerance: float = 0.0) -> NDArray[np.bool_]:
        """Return (D, V, A) whether an action loses at most `tolerance` at subtask 0, trial 0."""
        if self.gaps is None:
            raise ModelError("gaps were not kept", where="optimal", fix="ask for gaps=True")
        return np.asarray(self.gaps <= tolerance)


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyMoments:
    """Mean and variance of the return of N policies in D draws.

    Attributes
    ----------
    mean, variance : (D, N)
        `variance` is None where it was not asked for.
    error, variance_error : (D,)
        How far each may be from the exact one.
    """

    mean: Floats
    variance: Floats | None
    error: Floats
    variance_error: Floats | None


def optimal(
    scenario: Scenario,
    names: Sequence[str] = (),
    draws: ArrayLike | None = None,
    *,
    gaps: bool = False,
    actions: bool = False,
    threads: int | None = None,
    warn: bool = True,
) -> CareValues:
    """Return the optimum of a scenario at every draw of some of its parameters.

    Parameters
    ----------
    names : Q parameter names, "discount" among them where it is drawn too.
    draws : (D, Q)
        Left out: the scenario's own values, D = 1.
    gaps, actions : bool
        Whether to keep them.
    threads : int, optional
        All cores that this process may use, unless given. Results are the same bits.
    warn : bool
        Whether a `mdp.ScenarioWarning` says in how many draws a chance is cut off at 1.

    Raises
    ------
    ModelError
        For an unknown name, a value outside its parameter's range, rewards that overflow, more
        than 6 statuses, or more than 127 actions where they are to be kept.

    Examples
    --------
    >>> from mdp import Scenario
    >>> scenario = Scenario.load("yuan2025")
    >>> found = optimal(scenario, ["base.anger"], [[0.05], [0.1]], gaps=True)
    >>> found.start.round(6).tolist(), found.optimal()[0, 0].tolist()
    ([146.235871, 143.338709], [False, False, True, False])
    """
    from solvers.kernels.care import optimal_values

    care, base, positions, table = layout = prepared(scenario, names, draws)
    if warn:
        warn_of_draws(scenario, names, layout)
    error, _ = finite(bounds(care, base, positions, table), scenario)
    if actions and len(care.assist) > MOST_ACTIONS:
        raise ModelError(
            f"{len(care.assist)} actions, more than {MOST_ACTIONS}",
            where=f"scenario {scenario.name}",
            fix="leave out actions=True, or solve the models: solve(scenario.compile())",
        )
    count, vectors, number = len(table), care.bits.shape[0], len(care.assist)
    start = np.empty(count)
    kept = np.empty((count if gaps else 0, vectors, number))
    shape = (count if actions else 0, len(care.last), care.trials, care.flags, vectors)
    taken = np.empty(shape, dtype=np.int8)

    def block(first: int, last: int, room: Room) -> None:
        optimal_values(care, base, positions, table, first, last, room, start, kept, taken)

    _in_blocks(block, count, care, base, threads)
    for array in (start, error, kept, taken):
        array.setflags(write=False)
    return CareValues(
        start=start, error=error, gaps=kept if gaps else None, actions=taken if actions else None
    )


def policy_values(
    scenario: Scenario,
    names: Sequence[str],
    draws: ArrayLike | None,
    policies: ArrayLike,
    *,
    second_moment: bool = False,
    threads: int | None = None,
    warn: bool = True,
) -> PolicyMoments:
    """Return mean, and variance, of the return of every policy in every draw.

    Parameters
    ----------
    names, draws, threads, warn
        As in `optimal`.
    policies : (N, V) or (N, K, trials, flags, V) ints, or the same with a last axis A of floats
        Actions by status vector, or by state; with the axis A, probabilities of actions.
    second_moment : bool
        Whether the variance is wanted.

    Raises
    ------
    ModelError
        As `optimal` does; also for policies of another shape, or that are no distribution.

    Examples
    --------
    >>> from mdp import Scenario
    >>> scenario = Scenario.load("yuan2025")
    >>> always = np.repeat(np.arange(4)[:, None], 16, axis=1)
    >>> found = policy_values(scenario, (), None, always, second_moment=True)
    >>> found.mean.round(6).tolist(), np.sqrt(found.variance[0, 3]).round(4).item()
    ([[-57.695564, 18.697715, 68.335496, 64.363644]], 92.4196)
    """
    (found,) = policy_values_of_last(
        scenario,
        names,
        draws,
        policies,
        (None,),
        second_moment=second_moment,
        threads=threads,
        warn=warn,
    )
    return found


def policy_values_of_last(
    scenario: Scenario,
    names: Sequence[str],
    draws: ArrayLike | None,
    policies: ArrayLike,
    lengths: Sequence[int | None],
    *,
    second_moment: bool = False,
    threads: int | None = None,
    warn: bool = True,
) -> list[PolicyMoments]:
    """Return what `policy_values` does, of the last so many subtasks alone, for every length.

    Backward induction comes by them on its way: a task of 2 subtasks is the end of one of 6.

    Parameters
    ----------
    lengths : ints from 1 to the number of subtasks, or None for all subtasks

    Examples
    --------
    >>> from mdp import Scenario
    >>> long, short = (Scenario.load("yuan2025").with_(tasks=[size]) for size in (6, 2))
    >>> always = np.full((1, 16), 3)
    >>> (found,) = policy_values_of_last(long, (), None, always, [2])
    >>> bool(found.mean == policy_values(short, (), None, always).mean)
    True
    """
    from solvers.kernels.care import policy_moments

    care, base, positions, table = layout = prepared(scenario, names, draws)
    if warn:
        warn_of_draws(scenario, names, layout)
    chosen, shares = as_policies(care, policies)
    subtasks = len(care.last)
    ends = [subtasks if length is None else int(length) for length in lengths]
    if not all(1 <= end <= subtasks for end in ends):
        raise ModelError(
            f"lengths {ends} of {subtasks} subtasks", where="lengths", fix=f"give 1 to {subtasks}"
        )
    if np.ndim(policies) > 3 and set(ends) != {subtasks}:
        raise ModelError(
            "policies by state, of another task", where="lengths", fix="give them by status"
        )
    errors = [
        finite(
            bounds(care._replace(last=care.last[-end:]), base, positions, table),
            scenario,
            second=second_moment,
        )
        for end in ends
    ]
    count, many = len(table), max(len(chosen), len(shares))
    rows = 1 if set(ends) == {subtasks} else subtasks
    mean = np.empty((rows, count, many))
    variance = np.empty((rows, count, many) if second_moment else (rows, 0, 0))

    def by_draw(first: int, last: int, room: Room) -> None:
        moments(first, last, 0, many, room)

    def by_policy(low: int, high: int, room: Room) -> None:
        moments(0, count, low, high, room)

    def moments(first: int, last: int, low: int, high: int, room: Room) -> None:
        policy_moments(
            care,
            base,
            positions,
            table,
            first,
            last,
            chosen,
            shares,
            low,
            high,
            room,
            second_moment,
            mean,
            variance,
        )

    if count >= many:
        _in_blocks(by_draw, count, care, base, threads, 1 + BLOCK // max(many, 1))
    else:
        _in_blocks(by_policy, many, care, base, threads, 1 + BLOCK // count)
    found = []
    for end, (error, variance_error) in zip(ends, errors, strict=True):
        row = 0 if rows == 1 else end - 1
        found.append(
            PolicyMoments(
                mean=_fixed(mean[row]),
                variance=_fixed(variance[row]) if second_moment else None,
                error=_fixed(error),
                variance_error=_fixed(variance_error) if second_moment else None,
            )
        )
    return found


def _fixed(array: Floats) -> Floats:
    array.setflags(write=False)
    return array


# ---- threads ------------------------------------------------------------------------------------


def _room(care: Care, base: Floats) -> Room:
    from solvers.kernels.care import Room

    vectors, rows = care.bits.shape[0], care.step.shape[1]
    return Room(
        numbers=np.empty(len(base)),
        chance=np.empty(len(care.terms)),
        weight=np.empty(5),
        assist=np.empty(len(care.assist)),
        p=np.empty(rows),
        q=np.empty(rows),
        law=np.empty((vectors, rows)),
        skip=np.empty((vectors, vectors)),
        own=np.empty((vectors, vectors)),
        vector=np.zeros((10, vectors)),
        ahead=np.zeros((2, care.flags, vectors)),
        here=np.zeros((2, care.flags, vectors)),
    )


def _in_blocks(
    work: Callable[[int, int, Any], None],
    count: int,
    care: Care,
    base: Floats,
    threads: int | None,
    size: int = BLOCK,
) -> None:
    """Call `work` (first, last, room) for blocks of 0 … count-1, in threads."""
    workers = _threads(threads)
    blocks = list(_blocks(count, size))
    if workers == 1 or len(blocks) == 1:
        work(0, count, _room(care, base))
        return
    with ThreadPoolExecutor(min(workers, len(blocks))) as pool:
        tasks = [pool.submit(work, *block, _room(care, base)) for block in blocks]
        for task in tasks:
            task.result()


def _blocks(count: int, size: int) -> Iterator[tuple[int, int]]:
    for first in range(0, count, size):
        yield first, min(first + size, count)


def _threads(threads: int | None) -> int:
    if threads is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    if isinstance(threads, bool) or not isinstance(threads, int) or threads < 1:
        raise ModelError(f"threads is {threads!r}", where="threads", fix="give a whole number > 0")
    return threads
