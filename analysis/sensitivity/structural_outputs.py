"""Today's optimum under another reading of the text, and whether it is an optimum there as well.

A state of the reading is the state of today's model with the same columns. Where there is none,
because the tasks are others or because today's model leaves no choice there, it is the state with
the same status at subtask 0, trial 0. Let A(s) be the actions that are optimal today in the state
that s is, and B(s) those that are optimal in s. Today's optimum is one under the reading, too,
where some policy with π(s) ∈ A(s) ∩ B(s) never leaves the states that have such an action: the
greatest set of states from which that can be kept up contains the start. The policy that is
carried over takes such actions there, and today's optimal ones elsewhere, so that it loses
something exactly where the optimum changes.

What is told of one reading of a scenario: values, optimal actions, and what weighs most.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.sensitivity.base import digest
from exact_mdp.analysis.sensitivity.draws.sampled import sampled
from exact_mdp.analysis.sensitivity.gradient import gradient
from exact_mdp.analysis.sensitivity.thresholds.joint import joint_radius
from exact_mdp.mdp.care.perception import perceived
from exact_mdp.mdp.care.scenario import Scenario, ScenarioFamily
from exact_mdp.mdp.errors import ModelError, ScenarioWarning
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers import evaluate, solve
from exact_mdp.solvers.solution import Solution

if TYPE_CHECKING:
    from exact_mdp.solvers.solution import Solution


Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Today:
    """The optimal actions of the model as it is.

    Attributes
    ----------
    tasks : tuple of int
    space : StateSpace
    free : (S,) bool
        Where there is a choice.
    optimal : (S, A) bool
        By the scenario's actions; all False where none of them is available.
    actions : (S,)
        One of them.
    """

    tasks: tuple[int, ...]
    space: StateSpace
    free: Mask
    optimal: Mask
    actions: Integers

    @classmethod
    def of(cls, scenario: Scenario, mdp: MDP, solution: Solution) -> Today:
        """Return the optimal actions, those that differ by rounding alone included."""
        optimal = np.zeros((mdp.n_states, len(scenario.actions)), dtype=bool)
        number = _numbers(scenario, mdp)
        mine = number >= 0
        optimal[mdp.pair_state[mine], number[mine]] = best_pairs(mdp, solution)[mine]
        of_action = {mdp.action(name): k for k, name in enumerate(scenario.actions)}
        actions = np.array([of_action.get(each, 0) for each in solution.policy.tolist()])
        return cls(
            tasks=scenario.tasks,
            space=mdp.space,
            free=~mdp.forced,
            optimal=optimal,
            actions=actions,
        )

    def carried(self, scenario: Scenario, mdp: MDP, solution: Solution) -> tuple[Integers, bool]:
        """Return today's optimum under a reading, (S,) actions, and whether the optimum changes."""
        state = self._states(scenario, mdp)
        number = _numbers(scenario, mdp)
        alike = self.optimal[state[mdp.pair_state], number] & (number >= 0)
        alike |= mdp.forced[mdp.pair_state]
        both = alike & best_pairs(mdp, solution)
        while True:
            kept = np.logical_or.reduceat(both, mdp.pair_offsets[:-1])
            leaves = _can_reach(mdp, ~kept)
            if not (both & leaves).any():
                break
            both &= ~leaves
        begins = [state for state, weight in mdp.start if weight]
        changes = not kept[begins].all()
        names = [mdp.action(name) for name in scenario.actions]
        choices = np.array(names, dtype=np.int64)[self.actions[state]]
        forced = mdp.pair_action[mdp.pair_offsets[:-1]]
        choices = np.where(mdp.forced, forced, choices)
        pairs = np.flatnonzero(both)[::-1]  # the first of several is written last
        choices[mdp.pair_state[pairs]] = mdp.pair_action[pairs]
        return choices, bool(changes)

    def _states(self, scenario: Scenario, mdp: MDP) -> Integers:
        """Return (S,) the state of today's model that each state of a reading is."""
        values: Mapping[str, Integers] = {
            name: np.maximum(mdp.space.values(name), 0) for name in mdp.space.names
        }
        nothing = np.zeros(mdp.n_states, dtype=np.int64)
        fits = np.full(mdp.n_states, self.tasks == scenario.tasks)
        same, first = nothing, nothing
        for column in self.space.columns:
            value = values.get(column.name, nothing)
            fits &= value < column.size
            same = same * column.size + np.minimum(value, column.size - 1)
            first = first * column.size + (value if column.name == "status" else 0)
        return np.where(fits & self.free[same], same, first)


def best_pairs(mdp: MDP, solution: Solution) -> Mask:
    """Return (L,) whether a pair is optimal, up to rounding."""
    return np.asarray(solution.q >= solution.value[mdp.pair_state] - 2 * solution.error_bound)


def _numbers(scenario: Scenario, mdp: MDP) -> Integers:
    """Return (L,) which of the scenario's actions a pair takes; -1 for none of them."""
    place = np.full(mdp.n_actions, -1, dtype=np.int64)
    for number, name in enumerate(scenario.actions):
        place[mdp.action(name)] = number
    return place[mdp.pair_action]


def _can_reach(mdp: MDP, states: Mask) -> Mask:
    """Return (L,) whether a pair may lead to one of the states in one step."""
    return np.asarray(mdp.transition @ states.astype(np.float64) > 0)


STEP = Fraction(1, 10_000)  # of a difference, as a share of the parameter
MOST_TRIED = 5
PRESENT = "as it is"


def quiet_outputs(*given: Any) -> dict[str, Any]:
    """Return `outputs` without warnings of chances that are cut off, which the caller gives."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        return outputs(*given)


def outputs(
    today: Today,
    names: Sequence[str],
    forms: Sequence[object],
    perception: Floats | None,
    elasticities: bool,
    stability: bool,
    piece: tuple[str, Scenario],
) -> dict[str, Any]:
    """Return what is told of one reading, (label, scenario), as arrays.

    Parameters
    ----------
    today : the optimum as it is, held fixed before the others
    names, forms : the other policies held fixed
    perception : (Z, Z) confusion that they act on, or None
    """
    label, scenario = piece
    mdp = scenario.compile()
    solution = solve(mdp)
    choices, changes = today.carried(scenario, mdp, solution)
    held = [("optimum", choices), *zip(names, forms, strict=True)]
    policies = [_policy(mdp, label, name, form, perception) for name, form in held]
    values = [solution.start, *(evaluate(mdp, each).numbers["mean"] for each in policies)]
    optimal, actions = _first_actions(scenario, mdp, solution)
    top, elasticity = _top(scenario) if elasticities else ("", np.nan)
    return {
        "states": np.int64(mdp.n_states),
        "value": np.array([each.value for each in values]),
        "error": np.array([each.error for each in values]),
        "sd": np.float64(evaluate(mdp, solution.policy).sd),
        "changes": np.bool_(changes),
        "optimal_actions": optimal,
        "actions": actions,
        "top": np.array(top),
        "elasticity": np.float64(elasticity),
        "stability": np.float64(joint_radius(scenario).share if stability else np.nan),
    }


def _first_actions(
    scenario: Scenario, mdp: MDP, solution: Solution
) -> tuple[NDArray[np.bool_], Integers]:
    """Return (V, A) whether an action is optimal, and (V,) one that is, at subtask 0, trial 0."""
    size = mdp.space.column("status").size
    good = best_pairs(mdp, solution)
    optimal = np.zeros((size, len(scenario.actions)), dtype=bool)
    actions = np.zeros(size, dtype=np.int64)
    for value in range(size):
        state = mdp.space.index(subtask=0, trial=0, status=value)
        for pair in mdp.pairs_of(state):
            number = scenario.actions.index(mdp.actions[mdp.pair_action[pair]])
            optimal[value, number] = good[pair]
        actions[value] = scenario.actions.index(mdp.actions[solution.policy[state]])
    return optimal, actions


def _top(scenario: Scenario) -> tuple[str, float]:
    """Return the table's parameter of largest elasticity, and the elasticity.

    Differences of the optimum's values put the parameters in order; the derivative of the first
    one then comes from the envelope theorem. One without a single derivative is passed over.
    """
    slopes = _slopes(scenario)
    for name in sorted(slopes, key=lambda each: -abs(slopes[each]))[:MOST_TRIED]:
        elasticity = gradient(scenario, names=[name], exact=False)[name].elasticity
        if elasticity is not None:
            return name, elasticity
    return "", np.nan


def _slopes(scenario: Scenario) -> dict[str, float]:
    """Return θ dV*/dθ of every parameter that is not 0, by differences within its range."""
    model = ScenarioFamily(scenario=scenario)
    moving = [parameter for parameter in scenario.parameters if parameter.value]
    names = [parameter.name for parameter in moving]
    today = np.array([float(parameter.value) for parameter in moving])
    ends = np.array([[float(p.value * (1 - STEP)), float(p.value * (1 + STEP))] for p in moving])
    for row, parameter in enumerate(moving):
        low = -np.inf if parameter.low is None else float(parameter.low)
        high = np.inf if parameter.high is None else float(parameter.high)
        ends[row] = np.clip(ends[row], low, high)
    draws = np.tile(today, (2 * len(names), 1))
    rows = np.arange(len(names))
    draws[2 * rows, rows], draws[2 * rows + 1, rows] = ends.T
    value = sampled(model, names, draws).optimal
    steps = (ends[:, 1] - ends[:, 0]) / today
    return dict(zip(names, ((value[1::2] - value[::2]) / steps).tolist(), strict=True))


def _policy(
    mdp: MDP, label: str, name: str, form: object, perception: Floats | None = None
) -> Floats:
    try:
        policy = Policy.of(mdp, form)
        return (policy if perception is None else perceived(mdp, policy, perception)).weights(mdp)
    except ModelError as error:
        where = f"policy {name}, reading {label}: {error.where}"
        raise ModelError(error.what, where=where, fix=error.fix) from error


def hashed(mdp: MDP, name: str, form: object, perception: Floats | None = None) -> str:
    """Return a policy's name and the hash of what it does; raises ModelError where it cannot."""
    weights = _policy(mdp, PRESENT, name, form, perception)
    return f"{name} {digest(weights)}"
