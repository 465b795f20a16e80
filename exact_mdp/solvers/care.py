"""Solve many care models at once: the optimum of every draw, and the value of every policy.

A draw sets some parameters of a scenario; the others keep their value. Each draw is solved by
backward induction over subtasks and trials, or policies are evaluated in it, by compiled loops that
never form the model (see `solvers.kernels.care`; `mdp.care.laws` has the distributions).

Rounding. An exact chance is a sum of n numbers, cut off at 1, and the distribution of the next
status vector is a product of n chances: in floats, the absolute errors of a row sum to at most κ =
2 n γ(n) + γ(2n + 1). A stage adds one or two such sums of 2^n products, so that with R the largest
reward of a timestep in absolute value and h remaining timesteps, a stage adds at most

    (2 κ + γ(2^(n+1) + 4 A + 24)) R h

to the error of a value: in total c u R H (H + 1) / 2, where H = K (M + 1) is the greatest number of
timesteps (γ and u as in `solvers.bounds.gains`; Higham, Accuracy and Stability of Numerical
Algorithms, SIAM 2002, 3.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exact_mdp.mdp.care.laws import Laws
from exact_mdp.mdp.care.rules import rules_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.parametric import DISCOUNT
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import SLACK, UNIT, gamma


@dataclass(frozen=True, kw_only=True, eq=False)
class CareValues:
    """The optimum of each of D draws.

    The flag of a state is 1 if a subtask of the task was skipped. Flags have two values if the task
    bonus depends on skips, else one.
    """

    start: Floats  # (D,) optimal start values
    error: Floats  # (D,) bounds on their errors
    # (D, V, A) the suboptimality gap of each action in each status vector at subtask 0, trial 0;
    # twice `error` bounds the error of a gap.
    gaps: Floats
    # (D, K, trials, flags, V) the first of the optimal actions in each state.
    actions: NDArray[np.int8]
    cut: NDArray[np.bool_]  # (D,) whether the numbers that add up to some chance exceed 1


def solve_care_draws(model: Scenario, names: Sequence[str], draws: ArrayLike) -> CareValues:
    """Return the optimum of a scenario at every draw (D, Q) of Q of its parameters.

    "discount" may be among them. Raises ModelError for rewards that overflow.
    """
    rules = rules_of(model)
    return _compute_draw_values(
        model, names, draws, np.empty((0, 1, rules.vectors, rules.assistive))
    )[1]


def evaluate_care_policies(
    model: Scenario, names: Sequence[str], draws: ArrayLike, policies: Floats
) -> tuple[Floats, Floats]:
    """Return the start value (D, N) of every policy in every draw, and its error (D,).

    Policies are probabilities of actions by state, (N, K, trials, flags, V, A). Raises ModelError
    as `solve_care_draws` does.
    """
    shares = np.asarray(policies, dtype=np.float64)
    shares = shares.reshape(len(shares), -1, *shares.shape[-2:])
    if (shares == shares[:, :1]).all():  # the same at every stage
        shares = shares[:, :1]
    # The error bounds belong to the policy whose probabilities sum to 1.
    value, beside = _compute_draw_values(
        model, names, draws, shares / shares.sum(axis=-1, keepdims=True)
    )
    return value, beside.error


def _compute_draw_values(
    scenario: Scenario, names: Sequence[str], given: ArrayLike, shares: Floats
) -> tuple[Floats, CareValues]:
    """Return the values (D, N) of policies (N, G, V, A), or the optimum (D, 1), with details."""
    from exact_mdp.solvers.kernels import care as loops

    rules, drawn = rules_of(scenario), np.asarray(given, dtype=np.float64)
    # One row of numbers for each draw: the scenario's parameters, 0, and the discount.
    zero = len(scenario.names)
    today = [float(parameter.value) for parameter in scenario.parameters]
    numbers = np.array([*today, 0.0, float(scenario.discount)])
    places = rules.position | {DISCOUNT: zero + 1}
    columns = [places[name] for name in names]
    count, optimum = len(drawn), not len(shares)
    vectors, number, bits = rules.vectors, rules.assistive, rules.bits.shape[1]
    # The chances that each status depends on, in the rows of all actions and of a skip.
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
    # Results; gaps and actions belong to the optimum alone.
    columns_of_values, draws_of_actions = len(shares), 0
    if optimum:
        columns_of_values, draws_of_actions = 1, count
    value = np.empty((count, columns_of_values))
    stages = len(rules.places), rules.trials, rules.flags, vectors
    beside = CareValues(
        start=value[:, 0],
        error=np.empty(count),
        gaps=np.empty((draws_of_actions, vectors, number)),
        actions=np.empty((draws_of_actions, *stages), dtype=np.int8),
        cut=np.empty(count, dtype=bool),
    )
    # The chances and rewards of some draws are in memory at the same time.
    together = 2**9
    for begin in range(0, count, together):
        some = slice(begin, begin + together)
        # Set the drawn parameters, and compute chances, rewards and error bounds of these draws.
        every = np.repeat(numbers[None], len(drawn[some]), axis=0)
        every[:, columns] = drawn[some]
        laws = Laws.from_draws(scenario, every[:, :-1])
        beside.error[some] = _bound_start_errors(scenario, laws)
        # A sum that is exactly 1 stays below this after eight roundings.
        beside.cut[some] = (laws.sums > 1 + 8 * UNIT).any(axis=1)
        draws = loops.CareDraws(
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
            discount=every[:, -1].copy(),
        )
        loops.evaluate_draws(
            draws, room, shares, value[some], beside.gaps[some], beside.actions[some]
        )
    return value, beside


def _bound_start_errors(scenario: Scenario, laws: Laws) -> Floats:
    """Return (D,) bounds on the errors of start values; raises ModelError if sums overflow."""
    rules = rules_of(scenario)
    bits = rules.bits.shape[1]
    # R: a timestep completes the subtask, with the action's reward, or fails, possibly with a
    # skip; either way status costs are added. Overflow is refused below.
    with np.errstate(over="ignore"):
        sizes = replace(laws, reward=np.abs(laws.reward))
        complete, fail, skip = (sizes.gain[:, each].max(axis=(1, 2)) for each in rules.gains)
        reward = np.maximum(complete + sizes.assist.max(axis=1), fail + skip)
        reward += sizes.cost[:, -1]
    # κ, the factor of R h, and the sum over at most H timesteps, as in the header of this module.
    law = 2 * bits * float(gamma(bits)) + float(gamma(2 * bits + 1))
    unit = (2 * law + float(gamma(2 * rules.vectors + 4 * rules.assistive + 24))) * SLACK
    steps = len(rules.places) * (rules.trials + 1)
    error = reward * unit * (steps * (steps + 1) / 2) * SLACK + UNIT
    # The bound exceeds u R H, and no intermediate number exceeds R H: a small bound excludes
    # overflow.
    if not error.max() < UNIT * np.finfo(float).max / 16:
        raise ModelError(
            "reward weights so large that returns overflow",
            where=f"scenario {scenario.name}",
            fix="state rewards in a larger unit, or draw them with a smaller spread",
        )
    return np.asarray(error)
