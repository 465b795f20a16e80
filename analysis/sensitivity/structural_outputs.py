"""What is told of one reading of a scenario: values, optimal actions, and what weighs most."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.sensitivity.base_case import digest
from analysis.sensitivity.carried import Today, best_pairs
from analysis.sensitivity.gradient import gradient
from analysis.sensitivity.joint import joint_radius
from analysis.sensitivity.sampled import values
from mdp.errors import ModelError, ScenarioWarning
from mdp.model import MDP
from mdp.perception import perceived
from mdp.policy import Policy
from mdp.scenario import Scenario
from mdp.scenario_family import ScenarioFamily
from mdp.table import Floats, Integers
from solvers import evaluate, solve

if TYPE_CHECKING:
    from solvers.solution import Solution

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
    value = values(model, names, draws)
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
