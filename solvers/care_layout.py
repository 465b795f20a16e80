"""How a care model is laid out for the compiled loops, and how far rounding can carry them.

Rounding. An exact chance is a sum of n numbers, cut off at 1, and a law a product of n chances: as
computed, its row is off by at most κ = 2 n γ(n) + γ(2n + 1) in the sum of absolute values. A stage
adds one or two such sums of 2^n products, so that with R the largest reward of a timestep in
absolute value and h the timesteps that are left, a stage adds at most

    (2 κ + γ(2^(n+1) + 4 A + 24)) R h

to the error of a value: in total c u R H (H + 1) / 2 where H = K (M + 1) timesteps are the most.
The bound holds before anything is computed, and is some hundred times what is seen (γ and u as in
`solvers.rounding`; Higham, Accuracy and Stability of Numerical Algorithms, SIAM 2002, 3.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mdp.chances import chances, warn_of_excess
from mdp.errors import ModelError, suggest
from mdp.parametric import DISCOUNT
from mdp.scenario import SHARED_WEIGHTS
from mdp.table import Floats, Integers, Numbers
from solvers.rounding import SLACK, UNIT, gamma

if TYPE_CHECKING:
    from mdp.scenario import Scenario
    from solvers.kernels.care import Care

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
    from solvers.kernels.care import Care

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
    >>> from mdp import Scenario
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
