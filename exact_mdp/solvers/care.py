"""Many care models at once: the optimum of every draw, and the value of every policy.

A draw sets some parameters of a scenario; the others keep their value. Each draw is solved by
backward induction over subtasks and trials, or policies are evaluated in it, by compiled loops that
never form the model (see `solvers.kernels.care`; the rules are those of `mdp.care.rules`).

Rounding. An exact chance is a sum of n numbers, cut off at 1, and a law a product of n chances: as
computed, its row is off by at most κ = 2 n γ(n) + γ(2n + 1) in the sum of absolute values. A stage
adds one or two such sums of 2^n products, so that with R the largest reward of a timestep in
absolute value and h the timesteps that are left, a stage adds at most

    (2 κ + γ(2^(n+1) + 4 A + 24)) R h

to the error of a value: in total c u R H (H + 1) / 2 where H = K (M + 1) timesteps are the most.
The bound holds before anything is computed, and is some hundred times what is seen (γ and u as in
`solvers.bounds.gains`; Higham, Accuracy and Stability of Numerical Algorithms, SIAM 2002, 3.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exact_mdp.mdp.care.laws import chances
from exact_mdp.mdp.care.rules import PLACES, Rules
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.parametric import DISCOUNT
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.solvers.bounds.gains import SLACK, UNIT, gamma

if TYPE_CHECKING:
    from exact_mdp.solvers.kernels.care import Care, Room


MOST_STATUSES = 6
MOST_ACTIONS = 127  # of which optimal ones can be kept, as int8
EVENTS = ("complete", "fail", "skip")


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


class Batch:
    """A scenario and draws of some of its numbers, as the compiled loops take them.

    Attributes
    ----------
    care : solvers.kernels.care.Care
    base : (P+2,)
        Today's parameters, 0, and the discount.
    positions : (Q,) ints
        Which of these are drawn.
    draws : (D, Q)
    """

    def __init__(self, scenario: Scenario, names: Sequence[str], draws: ArrayLike | None) -> None:
        self.scenario, self.names, where = scenario, list(names), f"scenario {scenario.name}"
        statuses, known = scenario.statuses, scenario.names
        if len(statuses) > MOST_STATUSES:
            raise ModelError(
                f"{len(statuses)} statuses, more than {MOST_STATUSES}",
                where=where,
                fix="compile and solve the model instead: solve(scenario.compile())",
            )
        none = len(known)
        place = {name: number for number, name in enumerate(known)} | {DISCOUNT: none + 1}
        for name in self.names:
            if name not in place:
                raise ModelError(
                    f"unknown parameter {name!r}", where=where, fix=suggest(name, list(place))
                )
            if self.names.count(name) > 1:
                raise ModelError(f"{name} is drawn twice", where="names", fix="give each name once")
        self.draws = self._checked(draws)
        numbers = [parameter.value for parameter in scenario.parameters]
        self.base = np.array([*map(float, numbers), 0.0, float(scenario.discount)])
        self.positions = np.array([place[name] for name in self.names], dtype=np.int64)
        rules, found = Rules(scenario), chances(scenario)
        # Each sum of weights once; `gains` says which of them an event earns.
        rows: dict[tuple[int, ...], int] = {}
        gains = np.zeros((len(EVENTS), len(PLACES), 2), dtype=np.int64)
        for event, p, f in np.ndindex(gains.shape):
            charged = tuple(place[f"reward.{name}"] for name in rules.charged(EVENTS[event], p, f))
            gains[event, p, f] = rows.setdefault(charged, len(rows))
        widest = max(map(len, rows))
        charges = np.array([[*row, *[none] * (widest - len(row))] for row in rows])
        count = len(statuses)
        from exact_mdp.solvers.kernels import care as loops

        self.care: Care = loops.Care(
            terms=found.terms,
            step=np.ascontiguousarray(found.step.transpose(2, 1, 0).reshape(count, -1)),
            skip=np.ascontiguousarray(found.skip.T),
            bits=found.bits.astype(bool),
            statuses=np.array([place[f"reward.{scenario.weights[s]}"] for s in statuses]),
            assist=np.array([place[f"reward.assist.{action}"] for action in scenario.actions]),
            charges=charges,
            gains=gains,
            places=rules.places,
            kept=rules.kept,
            trials=rules.trials,
            flags=rules.flags,
            now=rules.now,
            next=rules.next,
            own=rules.own,
        )

    def _checked(self, draws: ArrayLike | None) -> Floats:
        """Return the draws as (D, Q), each number within its parameter's range."""
        table = np.empty((1, 0)) if draws is None else np.asarray(draws, dtype=np.float64)
        if table.ndim != 2 or table.shape[1] != len(self.names) or len(table) == 0:
            raise ModelError(
                f"draws of shape {table.shape} for {len(self.names)} parameters",
                where="draws",
                fix="give a row for each draw, at least one, and a column for each name",
            )
        parameters = {parameter.name: parameter for parameter in self.scenario.parameters}
        for name, least, most in zip(self.names, table.min(axis=0), table.max(axis=0), strict=True):
            low, high = 0.0, 1.0
            if name != DISCOUNT:
                ends = parameters[name].low, parameters[name].high
                low = -np.inf if ends[0] is None else float(ends[0])
                high = np.inf if ends[1] is None else float(ends[1])
            for drawn in (least, most):
                if not (np.isfinite(drawn) and low <= drawn <= high):
                    raise ModelError(
                        f"{name} is drawn as {float(drawn):g}, outside [{low:g}, {high:g}]",
                        where=f"parameter {name}",
                        fix="draw finite values in that range",
                    )
        return _read_only(table)

    def errors(self, subtasks: int | None = None, *, second: bool = False) -> tuple[Floats, Floats]:
        """Return (D,) bounds on the errors of a start value, and of a variance.

        Numbers so large that sums of them may overflow are refused: a bound is more than u times
        the largest number on the way, which is R H, or its square.
        """
        care, count = self.care, len(self.draws)
        parts = (care.charges, care.statuses, care.assist)
        rewards = np.unique(np.concatenate([part.reshape(-1) for part in parts]))
        moved = np.isin(self.positions, rewards)
        rows = self.draws[:, moved] if moved.any() else np.empty((1, 0))  # else one stands for all
        sizes = np.repeat(np.abs(self.base[rewards])[None], len(rows), axis=0)
        sizes[:, np.searchsorted(rewards, self.positions[moved])] = np.abs(rows)

        def sums(places: Integers) -> Floats:
            """Return (rows, …) the sums over the last axis."""
            return np.asarray(sizes[:, np.searchsorted(rewards, places)].sum(axis=-1))

        # At most one of completing, with its own reward, and failing, with status costs and a skip.
        with np.errstate(over="ignore"):  # refused below
            gains = sums(care.charges)
            complete, fail, skip = (gains[:, e.reshape(-1)].max(axis=1) for e in care.gains)
            assist, statuses = sums(care.assist[:, None]).max(axis=1), sums(care.statuses)
            reward = np.maximum(complete + assist, fail + skip) + (care.now + care.next) * statuses
            square = reward**2
        vectors, bits = care.bits.shape
        law = 2 * bits * float(gamma(bits)) + float(gamma(2 * bits + 1))
        unit = (2 * law + float(gamma(2 * vectors + 4 * len(care.assist) + 24))) * SLACK
        subtasks = len(care.places) if subtasks is None else subtasks
        steps = np.arange(1, subtasks * (care.trials + 1) + 1)
        mean = unit * np.cumsum(steps)  # in units of the largest reward
        # |u - m| and the variance's root are at most h rewards; both means are off by `mean`.
        spread = 2 * (4 * steps * mean + 4 * unit * steps**2)
        error = reward * mean[-1] * SLACK + UNIT
        square = square * float(spread.sum()) * SLACK + UNIT
        most = UNIT * np.finfo(float).max / 16
        if not (error.max() < most and (not second or square.max() < most)):
            raise ModelError(
                "reward weights so large that returns overflow",
                where=f"scenario {self.scenario.name}",
                fix="state rewards in a larger unit, or draw them with a smaller spread",
            )
        return np.broadcast_to(error, count).copy(), np.broadcast_to(square, count).copy()

    def cut(self) -> NDArray[np.bool_]:
        """Return (D,) whether the numbers that add up to some chance pass 1."""
        found = np.zeros(len(self.draws), dtype=bool)
        numbers = np.repeat(self.base[:, None], len(self.draws), axis=1)
        numbers[self.positions] = self.draws.T
        for places in self.care.terms.tolist():
            total = numbers[places[0]]
            for place in places[1:]:
                total = total + numbers[place]
            found |= total > 1 + 2.0**-50
        return found

    def room(self) -> Room:
        """Return arrays to work in."""
        care = self.care
        vectors, rows = len(care.bits), care.step.shape[1]
        from exact_mdp.solvers.kernels import care as loops

        room: Room = loops.Room(
            numbers=np.empty(len(self.base)),
            chance=np.empty(len(care.terms)),
            gain=np.empty(len(care.charges)),
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
        return room

    def policies(self, policies: ArrayLike) -> tuple[Numbers, Floats]:
        """Return policies as (N, G, V) actions or (N, G, V, A) shares, the other one empty."""
        care = self.care
        vectors, number = len(care.bits), len(care.assist)
        stages = len(care.places), care.trials, care.flags
        given = np.asarray(policies)
        shape = given.shape[1:]
        mixed = given.ndim in (3, 6)
        by_status = shape == ((vectors, number) if mixed else (vectors,))
        by_state = shape == (*stages, vectors, *([number] if mixed else []))
        if not (by_status or by_state) or len(given) == 0:
            raise ModelError(
                f"policies of shape {given.shape}",
                where="policies",
                fix=f"give (N, {vectors}) actions, (N, {vectors}, {number}) probabilities, or "
                f"either by state: (N, {', '.join(map(str, stages))}, {vectors}, …)",
            )
        groups = 1 if by_status else int(np.prod(stages))
        if not mixed:
            if given.dtype.kind not in "iu" or given.min() < 0 or given.max() >= number:
                raise ModelError(
                    f"actions that are not whole numbers from 0 to {number - 1}",
                    where="policies",
                    fix="give the numbers of the scenario's actions",
                )
            chosen = given.reshape(len(given), groups, vectors).astype(np.int16)
            return _read_only(chosen), _read_only(np.empty((0, 1, vectors, number)))
        shares = given.reshape(len(given), groups, vectors, number).astype(np.float64)
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


def cut_off(model: Scenario, names: Sequence[str], draws: ArrayLike) -> NDArray[np.bool_]:
    """Return (D,) whether the numbers that add up to some chance pass 1, so that it is cut off.

    Examples
    --------
    >>> cut_off(Scenario.load("yuan2025"), ["base.anger"], [[0.05], [0.9]]).tolist()
    [False, True]
    """
    return Batch(model, names, draws).cut()


def optimal(
    model: Scenario,
    names: Sequence[str] = (),
    draws: ArrayLike | None = None,
    *,
    gaps: bool = False,
    actions: bool = False,
) -> CareValues:
    """Return the optimum of a scenario at every draw of some of its parameters.

    Parameters
    ----------
    model : Scenario
    names : Q parameter names, "discount" among them where it is drawn too.
    draws : (D, Q)
        Left out: the scenario's own values, D = 1.
    gaps, actions : bool
        Whether to keep them.

    Returns
    -------
    CareValues

    Raises
    ------
    ModelError
        For an unknown name, a value outside its parameter's range, rewards that overflow, more
        than 6 statuses, or more than 127 actions where they are to be kept.

    Examples
    --------
    >>> scenario = Scenario.load("yuan2025")
    >>> found = optimal(scenario, ["base.anger"], [[0.05], [0.1]], gaps=True)
    >>> found.start.round(6).tolist(), found.gaps[0, 0].argmin().item()
    ([146.235871, 143.338709], 2)
    """
    batch = Batch(model, names, draws)
    care, count = batch.care, len(batch.draws)
    error, _ = batch.errors()
    vectors, number = len(care.bits), len(care.assist)
    if actions and number > MOST_ACTIONS:
        raise ModelError(
            f"{number} actions, more than {MOST_ACTIONS}",
            where=f"scenario {model.name}",
            fix="leave out actions=True, or solve the models: solve(scenario.compile())",
        )
    start = np.empty(count)
    kept = np.empty((count if gaps else 0, vectors, number))
    shape = (count if actions else 0, len(care.places), care.trials, care.flags, vectors)
    taken = np.empty(shape, dtype=np.int8)

    from exact_mdp.solvers.kernels import care as loops

    drawn = (care, batch.base, batch.positions, batch.draws)
    loops.optimal_values(*drawn, batch.room(), start, kept, taken)
    for array in (start, error, kept, taken):
        array.setflags(write=False)
    return CareValues(
        start=start, error=error, gaps=kept if gaps else None, actions=taken if actions else None
    )


def policy_values(
    model: Scenario,
    names: Sequence[str],
    draws: ArrayLike | None,
    policies: ArrayLike,
    *,
    second_moment: bool = False,
) -> PolicyMoments:
    """Return mean, and variance, of the return of every policy in every draw.

    Parameters
    ----------
    model, names, draws
        As in `optimal`.
    policies : (N, V) or (N, K, trials, flags, V) ints, or the same with a last axis A of floats
        Actions by status vector, or by state; with the axis A, probabilities of actions.
    second_moment : bool
        Whether the variance is wanted.

    Returns
    -------
    PolicyMoments

    Raises
    ------
    ModelError
        As `optimal` does; also for policies of another shape, or that are not distributions.

    Examples
    --------
    >>> always = np.repeat(np.arange(4)[:, None], 16, axis=1)
    >>> found = policy_values(Scenario.load("yuan2025"), (), None, always, second_moment=True)
    >>> found.mean.round(6).tolist(), np.sqrt(found.variance[0, 3]).round(4).item()
    ([[-57.695564, 18.697715, 68.335496, 64.363644]], 92.4196)
    """
    batch = Batch(model, names, draws)
    return _moments(batch, policies, [len(batch.care.places)], second_moment)[0]


def policy_values_of_last(
    model: Scenario,
    names: Sequence[str],
    draws: ArrayLike | None,
    policies: ArrayLike,
    lengths: Sequence[int],
    *,
    second_moment: bool = False,
) -> list[PolicyMoments]:
    """Return what `policy_values` does, of the last k subtasks alone, for every length k.

    Backward induction passes them on its way: a task of 2 subtasks is the end of one of 6.

    Examples
    --------
    >>> long, short = (Scenario.load("yuan2025").with_(tasks=[size]) for size in (6, 2))
    >>> always = np.full((1, 16), 3)
    >>> (found,) = policy_values_of_last(long, (), None, always, [2])
    >>> bool(found.mean == policy_values(short, (), None, always).mean)
    True
    """
    batch = Batch(model, names, draws)
    subtasks = len(batch.care.places)
    if not all(1 <= length <= subtasks for length in lengths):
        raise ModelError(
            f"lengths {lengths} of {subtasks} subtasks",
            where="lengths",
            fix=f"give 1 to {subtasks}",
        )
    if np.ndim(policies) > 3:
        raise ModelError(
            "policies by state, of another task", where="lengths", fix="give them by status"
        )
    return _moments(batch, policies, lengths, second_moment)


def _moments(
    batch: Batch, policies: ArrayLike, lengths: Sequence[int], second: bool
) -> list[PolicyMoments]:
    """Return the moments of the last k subtasks, for every length k."""
    chosen, shares = batch.policies(policies)
    subtasks = len(batch.care.places)
    errors = [batch.errors(length, second=second) for length in lengths]
    count, many = len(batch.draws), max(len(chosen), len(shares))
    rows = 1 if set(lengths) == {subtasks} else subtasks
    mean = np.empty((rows, count, many))
    variance = np.empty((rows, count, many) if second else (rows, 0, 0))

    from exact_mdp.solvers.kernels import care as loops

    care = (batch.care, batch.base, batch.positions, batch.draws)
    loops.policy_moments(*care, chosen, shares, batch.room(), second, mean, variance)
    for array in (mean, variance, *(each for pair in errors for each in pair)):
        array.setflags(write=False)
    return [
        PolicyMoments(
            mean=mean[0 if rows == 1 else length - 1],
            variance=variance[0 if rows == 1 else length - 1] if second else None,
            error=error,
            variance_error=square if second else None,
        )
        for length, (error, square) in zip(lengths, errors, strict=True)
    ]
