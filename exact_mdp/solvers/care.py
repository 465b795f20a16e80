"""Many care models at once: the optimum of every draw, and the value of every policy.

A draw sets some parameters of a scenario; the others keep their value. Each draw is solved by
backward induction over subtasks and trials, or policies are evaluated in it, by compiled loops that
never form the model (see `solvers.kernels.care`; the rules are those of `mdp.care.rules`).

Rounding. An exact chance is a sum of n numbers, cut off at 1, and a law a product of n chances: as
computed, its row is off by at most κ = 2 n γ(n) + γ(2n + 1) in the sum of absolute values. A stage
adds one or two such sums of 2^n products, so that with R the largest reward of a timestep in
absolute value and h the timesteps that are left, a stage adds at most

    (2 κ + γ(2^(n+1) + 4 A + 24)) R h

to the error of a value: in total c u R H (H + 1) / 2 where H = K (M + 1) timesteps are the most
(γ and u as in `solvers.bounds.gains`; Higham, Accuracy and Stability of Numerical Algorithms, SIAM
2002, 3.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exact_mdp.mdp.care.laws import chances
from exact_mdp.mdp.care.rules import PLACES, Rules
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.parametric import DISCOUNT
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.solvers.bounds.gains import SLACK, UNIT, gamma

if TYPE_CHECKING:
    from exact_mdp.solvers.kernels.care import Care


MOST_STATUSES = 6
MOST_ACTIONS = 127  # optimal actions are int8
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
    gaps : (D, V, A)
        What an action loses to the best one, in each status vector at subtask 0, trial 0; twice
        `error` bounds the error of a gap.
    actions : (D, K, trials, flags, V) int8
        An optimal action in each state, the first one with the largest value. The flag is 1 where
        a subtask of the task was skipped; there is one flag unless the task bonus asks for two.
    """

    start: Floats
    error: Floats
    gaps: Floats
    actions: NDArray[np.int8]


class Batch:
    """A scenario and draws of some of its numbers, as the compiled loops take them: `care`.

    `base` (P+2,) holds today's parameters, 0, and the discount; `positions` (Q,) says which of
    these are drawn, `draws` (D, Q).
    """

    def __init__(self, scenario: Scenario, names: Sequence[str], draws: ArrayLike) -> None:
        self.scenario, statuses, none = scenario, scenario.statuses, len(scenario.names)
        place = {name: number for number, name in enumerate(scenario.names)} | {DISCOUNT: none + 1}
        self.draws = _read_only(np.asarray(draws, dtype=np.float64))
        wide = -np.inf, np.inf
        ends = {each.name: (each.low, each.high) for each in scenario.parameters}
        ends[DISCOUNT] = Fraction(0), Fraction(1)
        for name, column in zip(names, self.draws.T, strict=True):
            both = zip(wide, ends[name], strict=True)
            low, high = (all_ if end is None else float(end) for all_, end in both)
            outside = column[~(np.isfinite(column) & (column >= low) & (column <= high))]
            if len(outside):
                raise ModelError(
                    f"{name} is drawn as {outside[0]:g}, outside [{low:g}, {high:g}]",
                    where=f"parameter {name}",
                    fix="draw finite values in that range",
                )
        numbers = [float(parameter.value) for parameter in scenario.parameters]
        self.base = np.array([*numbers, 0.0, float(scenario.discount)])
        self.positions = np.array([place[name] for name in names], dtype=np.int64)
        rules, base = Rules(scenario), chances(scenario)
        # Each sum of weights once; `gains` says which of them an event earns.
        rows: dict[tuple[int, ...], int] = {}
        gains = np.zeros((len(EVENTS), len(PLACES), 2), dtype=np.int64)
        for event, p, f in np.ndindex(gains.shape):
            charged = tuple(place[f"reward.{name}"] for name in rules.charged(EVENTS[event], p, f))
            gains[event, p, f] = rows.setdefault(charged, len(rows))
        widest = max(map(len, rows))
        from exact_mdp.solvers.kernels import care as loops

        self.care: Care = loops.Care(
            terms=base.terms,
            step=np.ascontiguousarray(base.step.transpose(2, 1, 0).reshape(len(statuses), -1)),
            skip=np.ascontiguousarray(base.skip.T),
            bits=base.bits.astype(bool),
            statuses=np.array([place[f"reward.{scenario.weights[s]}"] for s in statuses]),
            assist=np.array([place[f"reward.assist.{action}"] for action in scenario.actions]),
            charges=np.array([[*row, *[none] * (widest - len(row))] for row in rows]),
            gains=gains,
            places=rules.places,
            kept=rules.kept,
            trials=rules.trials,
            flags=rules.flags,
            now=rules.now,
            next=rules.next,
            own=rules.own,
        )

    def errors(self) -> Floats:
        """Return (D,) bounds on the errors of start values.

        Numbers so large that sums of them may overflow are refused: a bound is more than u times
        the largest number on the way, which is R H.
        """
        care = self.care
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
        vectors, bits = care.bits.shape
        law = 2 * bits * float(gamma(bits)) + float(gamma(2 * bits + 1))
        unit = (2 * law + float(gamma(2 * vectors + 4 * len(care.assist) + 24))) * SLACK
        steps = len(care.places) * (care.trials + 1)
        error = reward * unit * (steps * (steps + 1) / 2) * SLACK + UNIT
        if not error.max() < UNIT * np.finfo(float).max / 16:
            raise ModelError(
                "reward weights so large that returns overflow",
                where=f"scenario {self.scenario.name}",
                fix="state rewards in a larger unit, or draw them with a smaller spread",
            )
        return np.broadcast_to(error, len(self.draws)).copy()

    def values(self, shares: Floats) -> tuple[Floats, Floats, NDArray[np.int8]]:
        """Return what policies (N, G, V, A) are worth, or the optimum, its gaps and its actions."""
        from exact_mdp.solvers.kernels import care as loops

        care, count, optimum = self.care, len(self.draws), not len(shares)
        vectors, rows = len(care.bits), care.step.shape[1]
        room = loops.Room(
            numbers=np.empty(len(self.base)),
            chance=np.empty(len(care.terms)),
            gain=np.empty(len(care.charges)),
            assist=np.empty(len(care.assist)),
            p=np.empty(rows),
            q=np.empty(rows),
            law=np.empty((vectors, rows)),
            skip=np.empty((vectors, vectors)),
            own=np.empty((vectors, vectors)),
            vector=np.zeros((6, vectors)),
            ahead=np.zeros((care.flags, vectors)),
            here=np.zeros((care.flags, vectors)),
        )
        value = np.empty((count, 1 if optimum else len(shares)))
        gaps = np.empty((count * optimum, vectors, len(care.assist)))
        stages = len(care.places), care.trials, care.flags, vectors
        actions = np.empty((count * optimum, *stages), dtype=np.int8)
        drawn = care, self.base, self.positions, self.draws
        loops.values(*drawn, room, _read_only(shares), value, gaps, actions)
        return value, gaps, actions


def _read_only(array: Numbers) -> Numbers:
    """Return the array as one that cannot be written, so that loops are compiled for one kind."""
    view = np.ascontiguousarray(array).view()
    view.setflags(write=False)
    return view


def cut_off(model: Scenario, names: Sequence[str], draws: ArrayLike) -> NDArray[np.bool_]:
    """Return (D,) whether the numbers that add up to some chance pass 1, so that it is cut off.

    Examples
    --------
    >>> cut_off(Scenario.load("yuan2025"), ["base.anger"], [[0.05], [0.9]]).tolist()
    [False, True]
    """
    batch = Batch(model, names, draws)
    numbers = np.repeat(batch.base[:, None], len(batch.draws), axis=1)
    numbers[batch.positions] = batch.draws.T
    cut = np.zeros(len(batch.draws), dtype=bool)
    for places in batch.care.terms.tolist():
        cut |= sum(numbers[place] for place in places) > 1 + 2.0**-50
    return cut


def optimal(model: Scenario, names: Sequence[str], draws: ArrayLike) -> CareValues:
    """Return the optimum of a scenario at every draw (D, Q) of Q of its parameters.

    "discount" may be among them. Raises ModelError for a value outside its parameter's range, and
    for rewards that overflow.

    Examples
    --------
    >>> scenario = Scenario.load("yuan2025")
    >>> optima = optimal(scenario, ["base.anger"], [[0.05], [0.1]])
    >>> optima.start.round(6).tolist(), optima.gaps[0, 0].argmin().item()
    ([146.235871, 143.338709], 2)
    """
    batch = Batch(model, names, draws)
    error, care = batch.errors(), batch.care
    value, gaps, actions = batch.values(np.empty((0, 1, len(care.bits), len(care.assist))))
    return CareValues(start=value[:, 0], error=error, gaps=gaps, actions=actions)


def policy_values(
    model: Scenario, names: Sequence[str], draws: ArrayLike, policies: Floats
) -> tuple[Floats, Floats]:
    """Return the start value (D, N) of every policy in every draw, and its error (D,).

    Policies are probabilities of actions by state, (N, K, trials, flags, V, A). Raises ModelError
    as `optimal` does.

    Examples
    --------
    >>> always = np.broadcast_to(np.eye(4)[:, None, None, None, None], (4, 3, 5, 1, 16, 4))
    >>> value, _ = policy_values(Scenario.load("yuan2025"), (), np.empty((1, 0)), always)
    >>> value.round(6).tolist()
    [[-57.695564, 18.697715, 68.335496, 64.363644]]
    """
    batch = Batch(model, names, draws)
    error, shares = batch.errors(), np.asarray(policies, dtype=np.float64)
    shares = shares.reshape(len(shares), -1, *shares.shape[-2:])
    if (shares == shares[:, :1]).all():  # the same at every stage
        shares = shares[:, :1]
    # What the bound of the errors speaks of is the policy whose shares sum to 1.
    return batch.values(shares / shares.sum(axis=-1, keepdims=True))[0], error
