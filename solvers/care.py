"""How a care model is laid out for the compiled loops, and how far rounding can carry them.

Rounding. An exact chance is a sum of n numbers, cut off at 1, and a law a product of n chances: as
computed, its row is off by at most κ = 2 n γ(n) + γ(2n + 1) in the sum of absolute values. A stage
adds one or two such sums of 2^n products, so that with R the largest reward of a timestep in
absolute value and h the timesteps that are left, a stage adds at most

    (2 κ + γ(2^(n+1) + 4 A + 24)) R h

to the error of a value: in total c u R H (H + 1) / 2 where H = K (M + 1) timesteps are the most.
The bound holds before anything is computed, and is some hundred times what is seen (γ and u as in
`solvers.bounds.gains`; Higham, Accuracy and Stability of Numerical Algorithms, SIAM 2002, 3.1).

Many care models at once: the optimum of every draw, and the value of every policy.

A draw sets some parameters of a scenario; the others keep their value. Each draw is solved by
backward induction over subtasks and trials, or policies are evaluated in it, by compiled loops that
never form the model (see `solvers.kernels.care`; rounding errors are bounded in advance, see
`solvers.care`). Draws are given to threads in blocks; no result depends on its block.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exact_mdp.mdp.care.laws import chances, warn_of_excess
from exact_mdp.mdp.care.tables import SHARED_WEIGHTS
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.parametric import DISCOUNT
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.solvers.bounds.gains import SLACK, UNIT, gamma

if TYPE_CHECKING:
    from exact_mdp.mdp.care.scenario import Scenario
    from exact_mdp.solvers.kernels.care import Care, Room


MOST_STATUSES = 6
MOST_ACTIONS = 127  # of which optimal ones can be kept, as int8
BONUS = {"always": 0, "last-subtask-completed": 1, "no-subtask-skipped": 2}
MOST_KEPT = 32

Structure = tuple[Integers, Integers, Integers, NDArray[np.bool_]]
_kept: dict[tuple[object, ...], Structure] = {}


def prepared(
    scenario: Scenario, names: Sequence[str], draws: ArrayLike | None
) -> tuple[Care, Floats, Integers, Floats]:
    """Return the layout, all numbers of it, which of them are drawn, and the draws (D, Q)."""
    from exact_mdp.solvers.kernels.care import Care

    statuses = scenario.statuses
    if len(statuses) > MOST_STATUSES:
        raise ModelError(
            f"{len(statuses)} statuses, more than {MOST_STATUSES}",
            where=f"scenario {scenario.name}",
            fix="compile and solve the model instead: solve(scenario.compile())",
        )
    known = scenario.names
    place = {name: number for number, name in enumerate(known)} | {DISCOUNT: len(known) + 1}
    names = list(names)
    for name in names:
        if name not in place:
            raise ModelError(
                f"unknown parameter {name!r}",
                where=f"scenario {scenario.name}",
                fix=suggest(name, list(place)),
            )
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ModelError(f"{twice} is drawn twice", where="names", fix="give each name once")
    table = _table(scenario, names, draws)
    terms, step, skip, bits = _structure(scenario)
    tasks = scenario.tasks
    readings = scenario.readings
    rule = BONUS[readings["task_bonus"]]
    care = Care(
        terms=terms,
        step=step,
        skip=skip,
        bits=bits,
        statuses=_places(place, [scenario.weights[status] for status in statuses]),
        shared=_places(place, SHARED_WEIGHTS),
        assist=_places(place, [f"assist.{action}" for action in scenario.actions]),
        last=np.array([i == size - 1 for size in tasks for i in range(size)]),
        trials=scenario.trials,
        flags=2 if rule == BONUS["no-subtask-skipped"] else 1,
        bonus=rule,
        following=readings["status_cost"] == "next",
        every=readings["trial_cost"] == "every-trial",
        own=readings["skip_timestep"] == "own",
    )
    numbers = [parameter.value for parameter in scenario.parameters]
    base = np.array([*map(float, numbers), 0.0, float(scenario.discount)])
    return care, base, np.array([place[name] for name in names], dtype=np.int64), table


def _places(place: dict[str, int], weights: Sequence[str]) -> Integers:
    return np.array([place[f"reward.{weight}"] for weight in weights], dtype=np.int64)


def _table(scenario: Scenario, names: Sequence[str], draws: ArrayLike | None) -> Floats:
    """Return the draws as (D, Q), each number within its parameter's range."""
    table = np.empty((1, 0)) if draws is None else np.asarray(draws, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != len(names) or len(table) == 0:
        raise ModelError(
            f"draws of shape {table.shape} for {len(names)} parameters",
            where="draws",
            fix="give a row for each draw, at least one, and a column for each name",
        )
    table = _read_only(table)
    if not names:
        return table
    least, most = table.min(axis=0), table.max(axis=0)
    limits: dict[str, tuple[float, float]] = {DISCOUNT: (0.0, 1.0)}
    for parameter in scenario.parameters:
        low = -np.inf if parameter.low is None else float(parameter.low)
        limits[parameter.name] = (low, np.inf if parameter.high is None else float(parameter.high))
    for name, low_drawn, high_drawn in zip(names, least, most, strict=True):
        low, high = limits[name]
        finite = np.isfinite(low_drawn) and np.isfinite(high_drawn)
        if not (finite and low <= low_drawn and high_drawn <= high):
            wrong = low_drawn if not low <= low_drawn or not finite else high_drawn
            raise ModelError(
                f"{name} is drawn as {float(wrong):g}, outside [{low:g}, {high:g}]",
                where=f"parameter {name}",
                fix="draw finite values in that range",
            )
    return table


def _structure(scenario: Scenario) -> Structure:
    """Return which parameters add up to which chance; the same for many readings, so kept."""
    readings = scenario.readings
    key = (
        scenario.names,
        scenario.statuses,
        scenario.actions,
        tuple(sorted(scenario.others.items())),
        *(readings[n] for n in ("influence_orientation", "influence_on_present", "skip_onset")),
    )
    if key in _kept:
        return _kept[key]
    found = chances(scenario)
    vectors, number, count, _ = found.step.shape
    lists = np.concatenate([found.step.reshape(-1, count), found.skip.reshape(-1, count)])
    terms, which = np.unique(lists, axis=0, return_inverse=True)
    which = which.reshape(-1)
    step = which[: vectors * number * count].reshape(vectors, number, count)
    skip = which[vectors * number * count :].reshape(vectors, count)
    if len(_kept) >= MOST_KEPT:
        _kept.clear()
    _kept[key] = (
        np.ascontiguousarray(terms, dtype=np.int64),
        np.ascontiguousarray(step.transpose(2, 1, 0).reshape(count, -1), dtype=np.int64),
        np.ascontiguousarray(skip.T, dtype=np.int64),
        np.ascontiguousarray(found.bits.astype(bool)),
    )
    return _kept[key]


def as_policies(care: Care, policies: ArrayLike) -> tuple[Numbers, Floats]:
    """Return policies as (N, G, V) actions or (N, G, V, A) shares, the other one empty."""
    vectors, number = care.bits.shape[0], len(care.assist)
    stages = (len(care.last), care.trials, care.flags)
    given = np.asarray(policies)
    shapes = {
        (vectors,): 1,
        (*stages, vectors): int(np.prod(stages)),
        (vectors, number): 1,
        (*stages, vectors, number): int(np.prod(stages)),
    }
    groups = shapes.get(given.shape[1:])
    if groups is None or len(given) == 0:
        raise ModelError(
            f"policies of shape {given.shape}",
            where="policies",
            fix=f"give (N, {vectors}) actions, (N, {vectors}, {number}) probabilities, or either "
            f"by state: (N, {', '.join(map(str, stages))}, {vectors}, …)",
        )
    mixed = given.ndim in (3, 6)
    if not mixed:
        whole = given.dtype.kind in "iu"
        if not whole or given.min() < 0 or given.max() >= number:
            raise ModelError(
                "actions that are not whole numbers, or that there are not",
                where="policies",
                fix=f"number the actions from 0 to {number - 1}",
            )
        chosen = given.reshape(len(given), groups, vectors).astype(np.int16)
        return _read_only(chosen), _read_only(np.empty((0, 1, vectors, number)))
    shares = _read_only(given.reshape(len(given), groups, vectors, number).astype(np.float64))
    sums = shares.sum(axis=-1)
    if not (np.isfinite(shares).all() and shares.min() >= 0 and np.abs(sums - 1).max() < 1e-12):
        raise ModelError(
            "probabilities that are negative or do not sum to 1",
            where="policies",
            fix="give a distribution over actions for each status vector",
        )
    # What the bound of the errors speaks of is the policy whose shares sum to 1.
    shares = _read_only(shares / sums[..., None])
    return _read_only(np.empty((0, groups, vectors), dtype=np.int16)), shares


def _read_only(array: Numbers) -> Numbers:
    """Return the array as one that cannot be written, so that loops are compiled for one kind."""
    found = np.ascontiguousarray(array).view()
    found.setflags(write=False)
    return found


def bounds(care: Care, base: Floats, positions: Integers, draws: Floats) -> tuple[Floats, Floats]:
    """Return (D,) bounds on the errors of a start value and of a variance."""
    rewards = np.concatenate([care.shared, care.statuses, care.assist])
    same = not np.isin(positions, rewards).any()
    rows = draws[:1] if same else draws  # where no reward is drawn, one draw tells of all

    def size(places: Integers) -> Floats:
        """Return (D, …) absolute values of some numbers in each draw."""
        found = np.broadcast_to(np.abs(base[places]), (len(rows), len(places))).copy()
        for column, where in enumerate(positions):
            found[:, places == where] = np.abs(rows[:, column, None])
        return found

    shared, statuses, assist = size(care.shared), size(care.statuses), size(care.assist)
    # At most one of completing, with its own reward, and failing, with status costs and a skip.
    trial, complete, skipped, timestep, task = shared.T
    with np.errstate(over="ignore"):  # see `finite`
        reward = timestep + trial + task + statuses.sum(axis=1)
        reward = reward + np.maximum(complete + assist.max(axis=1), skipped)
        square = reward**2
    vectors, count = care.bits.shape
    law = 2 * count * float(gamma(count)) + float(gamma(2 * count + 1))
    unit = (2 * law + float(gamma(2 * vectors + 4 * len(care.assist) + 24))) * SLACK
    steps = np.arange(1, len(care.last) * (care.trials + 1) + 1)
    mean = unit * np.cumsum(steps)  # in units of the largest reward
    # |u - m| and the variance's root are at most h rewards; each of both means is off by `mean`.
    spread = 2 * (4 * steps * mean + 4 * unit * steps**2)
    error = np.broadcast_to(reward * mean[-1] * SLACK + UNIT, len(draws)).copy()
    square = square * float(spread.sum()) * SLACK + UNIT
    return error, np.broadcast_to(square, len(draws)).copy()


def finite(
    found: tuple[Floats, Floats], scenario: Scenario, *, second: bool = False
) -> tuple[Floats, Floats]:
    """Return the bounds, or refuse numbers so large that sums of them may overflow.

    A bound is more than u times the largest number on the way, which is R H, or its square.
    """
    error, variance_error = found
    most = UNIT * np.finfo(float).max / 16
    if not (error.max() < most and (not second or variance_error.max() < most)):
        raise ModelError(
            "reward weights so large that returns overflow",
            where=f"scenario {scenario.name}",
            fix="state rewards in a larger unit, or draw them with a smaller spread",
        )
    return found


def cut_off(scenario: Scenario, names: Sequence[str], draws: ArrayLike) -> NDArray[np.bool_]:
    """Return (D,) whether the numbers that add up to some chance pass 1, so that it is cut off.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> cut_off(Scenario.load("yuan2025"), ["base.anger"], [[0.05], [0.9]]).tolist()
    [False, True]
    """
    return _cut_off(*prepared(scenario, names, draws))


def warn_of_draws(
    scenario: Scenario, names: Sequence[str], layout: tuple[Care, Floats, Integers, Floats]
) -> None:
    """Warn once, of the first draw in which a chance is cut off at 1, with the number of them.

    Parameters
    ----------
    layout : as `prepared` returns it
    """
    cut, draws = _cut_off(*layout), layout[3]
    if cut.any():
        first = int(cut.argmax())
        there = scenario.with_(parameters=dict(zip(names, draws[first].tolist(), strict=True)))
        where = f", {int(cut.sum())} of {len(draws)} draws, the first of them draw {first}"
        warn_of_excess(there, where=where if names else "", stacklevel=4)


def _cut_off(care: Care, base: Floats, positions: Integers, table: Floats) -> NDArray[np.bool_]:
    found = np.zeros(len(table), dtype=bool)
    numbers = np.repeat(base[:, None], len(table), axis=1)
    numbers[positions] = table.T
    for places in care.terms.tolist():
        total = numbers[places[0]]
        for place in places[1:]:
            total = total + numbers[place]
        found |= total > 1 + 2.0**-50
    return found


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
    >>> from exact_mdp import Scenario
    >>> scenario = Scenario.load("yuan2025")
    >>> found = optimal(scenario, ["base.anger"], [[0.05], [0.1]], gaps=True)
    >>> found.start.round(6).tolist(), found.optimal()[0, 0].tolist()
    ([146.235871, 143.338709], [False, False, True, False])
    """
    from exact_mdp.solvers.kernels.care import optimal_values

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
    >>> from exact_mdp import Scenario
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
    >>> from exact_mdp import Scenario
    >>> long, short = (Scenario.load("yuan2025").with_(tasks=[size]) for size in (6, 2))
    >>> always = np.full((1, 16), 3)
    >>> (found,) = policy_values_of_last(long, (), None, always, [2])
    >>> bool(found.mean == policy_values(short, (), None, always).mean)
    True
    """
    from exact_mdp.solvers.kernels.care import policy_moments

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
    from exact_mdp.solvers.kernels.care import Room

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
