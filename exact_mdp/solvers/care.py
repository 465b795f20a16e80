"""Many care models at once: the optimum of every draw, and the value of every policy.

A draw sets some parameters of a scenario; the others keep their value. Each draw is solved by
backward induction over subtasks and trials, or policies are evaluated in it, by compiled loops that
never form the model (see `solvers.kernels.care`; the laws are those of `mdp.care.laws`).

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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exact_mdp.mdp.care.laws import Laws
from exact_mdp.mdp.care.rules import rules_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.parametric import DISCOUNT
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import SLACK, UNIT, gamma

MOST_STATUSES = 6
MOST_ACTIONS = 127  # optimal actions are int8
TOGETHER = 2**9  # draws whose chances and gains are worked out together


@dataclass(frozen=True, kw_only=True, eq=False)
class CareValues:
    """The optimum of each of D draws.

    A flag is 1 where a subtask of the task was skipped; there is one flag unless the task bonus
    asks for two.
    """

    start: Floats  # (D,) optimal start values
    error: Floats  # (D,) how far each may be from the exact optimum of its draw
    # (D, V, A) what an action loses to the best one, in each status vector at subtask 0, trial 0;
    # twice `error` bounds the error of a gap.
    gaps: Floats
    # (D, K, trials, flags, V) the first of the optimal actions in each state.
    actions: NDArray[np.int8]


class Batch:
    """A scenario and draws of some of its numbers; `numbers` (P+2,) are today's, 0, and discount.

    `positions` (Q,) says which of these are drawn, `draws` (D, Q).
    """

    def __init__(self, scenario: Scenario, names: Sequence[str], draws: ArrayLike) -> None:
        self.scenario, self.rules, none = scenario, rules_of(scenario), len(scenario.names)
        place = self.rules.position | {DISCOUNT: none + 1}
        self.draws = np.asarray(draws, dtype=np.float64)
        ends = {each.name: (each.low, each.high) for each in scenario.parameters}
        ends[DISCOUNT] = Fraction(0), Fraction(1)
        for name, column in zip(names, self.draws.T, strict=True):
            least, most = ends[name]
            low = -np.inf if least is None else float(least)
            high = np.inf if most is None else float(most)
            outside = column[~(np.isfinite(column) & (column >= low) & (column <= high))]
            if len(outside):
                raise ModelError(
                    f"{name} is drawn as {outside[0]:g}, outside [{low:g}, {high:g}]",
                    where=f"parameter {name}",
                    fix="draw finite values in that range",
                )
        numbers = [float(parameter.value) for parameter in scenario.parameters]
        self.numbers = np.array([*numbers, 0.0, float(scenario.discount)])
        self.positions = np.array([place[name] for name in names], dtype=np.int64)

    def parts(self) -> Iterator[tuple[slice, Laws, Floats]]:
        """Yield the laws, and the discounts, of so many draws at a time."""
        for begin in range(0, len(self.draws), TOGETHER):
            some = slice(begin, begin + TOGETHER)
            drawn = self.draws[some]
            numbers = np.repeat(self.numbers[None], len(drawn), axis=0)
            numbers[:, self.positions] = drawn
            yield some, Laws.drawn(self.scenario, numbers[:, :-1]), numbers[:, -1].copy()

    def values(self, shares: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.int8]]:
        """Return what policies (N, G, V, A) are worth, or the optimum, and its error (D,).

        Beside an optimum, its gaps and its actions, too.
        """
        from exact_mdp.solvers.kernels import care as loops

        rules, count, optimum = self.rules, len(self.draws), not len(shares)
        vectors, number, bits = rules.vectors, rules.assistive, rules.bits.shape[1]
        step = rules.step.transpose(1, 0, 2).reshape(-1, bits)
        which = np.concatenate([step, rules.skip]).T.copy()
        room = loops.Room(
            chance=np.empty((2, *which.shape)),
            law=np.empty((vectors, which.shape[1])),
            policy=np.empty((vectors, vectors)),
            q=np.empty(number * vectors),
            vector=np.zeros((4, vectors)),
            starts=np.zeros((2, rules.flags, vectors)),
        )
        value, error = np.empty((count, 1 if optimum else len(shares))), np.empty(count)
        gaps = np.empty((count * optimum, vectors, number))
        stages = len(rules.places), rules.trials, rules.flags, vectors
        actions = np.empty((count * optimum, *stages), dtype=np.int8)
        for some, laws, discount in self.parts():
            error[some] = self.errors(laws)
            draws = loops.Draws(
                which=which,
                gains=rules.gains,
                places=rules.places,
                flag_after=rules.flag_after,
                trials=rules.trials,
                flags=rules.flags,
                own=rules.own,
                chance=laws.top,
                gain=laws.gain,
                assist=laws.assist,
                present=rules.now * laws.cost,
                following=rules.next * laws.cost,
                discount=discount,
            )
            loops.values(draws, room, shares, value[some], gaps[some], actions[some])
        return value, error, gaps, actions

    def errors(self, laws: Laws) -> Floats:
        """Return (D,) bounds on the errors of start values.

        Numbers so large that sums of them may overflow are refused: a bound is more than u times
        the largest number on the way, which is R H.
        """
        rules, bits = self.rules, self.rules.bits.shape[1]
        # At most one of completing, with its own reward, and failing, with status costs and a skip.
        with np.errstate(over="ignore"):  # refused below
            sizes = replace(laws, reward=np.abs(laws.reward))
            complete, fail, skip = (sizes.gain[:, each].max(axis=(1, 2)) for each in rules.gains)
            reward = np.maximum(complete + sizes.assist.max(axis=1), fail + skip)
            reward += sizes.cost[:, -1]
        law = 2 * bits * float(gamma(bits)) + float(gamma(2 * bits + 1))
        unit = (2 * law + float(gamma(2 * rules.vectors + 4 * rules.assistive + 24))) * SLACK
        steps = len(rules.places) * (rules.trials + 1)
        error = reward * unit * (steps * (steps + 1) / 2) * SLACK + UNIT
        if not error.max() < UNIT * np.finfo(float).max / 16:
            raise ModelError(
                "reward weights so large that returns overflow",
                where=f"scenario {self.scenario.name}",
                fix="state rewards in a larger unit, or draw them with a smaller spread",
            )
        return np.asarray(error)


def cut_off(model: Scenario, names: Sequence[str], draws: ArrayLike) -> NDArray[np.bool_]:
    """Return (D,) whether the numbers that add up to some chance pass 1, so that it is cut off."""
    batch = Batch(model, names, draws)
    cut = np.zeros(len(batch.draws), dtype=bool)
    for some, laws, _ in batch.parts():
        cut[some] = (laws.sums > 1 + 2.0**-50).any(axis=1)
    return cut


def optimal(model: Scenario, names: Sequence[str], draws: ArrayLike) -> CareValues:
    """Return the optimum of a scenario at every draw (D, Q) of Q of its parameters.

    "discount" may be among them. Raises ModelError for a value outside its parameter's range, and
    for rewards that overflow.
    """
    batch = Batch(model, names, draws)
    none = np.empty((0, 1, batch.rules.vectors, batch.rules.assistive))
    value, error, gaps, actions = batch.values(none)
    return CareValues(start=value[:, 0], error=error, gaps=gaps, actions=actions)


def policy_values(
    model: Scenario, names: Sequence[str], draws: ArrayLike, policies: Floats
) -> tuple[Floats, Floats]:
    """Return the start value (D, N) of every policy in every draw, and its error (D,).

    Policies are probabilities of actions by state, (N, K, trials, flags, V, A). Raises ModelError
    as `optimal` does.
    """
    batch = Batch(model, names, draws)
    shares = np.asarray(policies, dtype=np.float64)
    shares = shares.reshape(len(shares), -1, *shares.shape[-2:])
    if (shares == shares[:, :1]).all():  # the same at every stage
        shares = shares[:, :1]
    # What the bound of the errors speaks of is the policy whose shares sum to 1.
    return batch.values(shares / shares.sum(axis=-1, keepdims=True))[:2]
