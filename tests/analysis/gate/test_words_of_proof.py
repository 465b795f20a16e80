"""Words of proof beside the gate: "proven", "optimal", "stationary" are said of what is so."""

from fractions import Fraction as F
from itertools import product

import numpy as np
import pytest
from cli_runner import run

from exact_mdp.analysis.gate.column_policies import best_policy
from exact_mdp.analysis.sensitivity import psa, sobol
from exact_mdp.mdp import MDP, ModelError, Policy
from exact_mdp.mdp.parametric import moving

STEPS = 5
REWARDS = [[0, -5, 0], [3, 2, 12], [-1, 0, -10], [-12, -5, -10]]
TARGETS = [[3, 0, 3], [2, 2, 3], [1, 1, 1], [1, 2, 2]]


@pytest.mark.parametrize("unit", [F(1), F(1, 10**15), F(1, 10**100)])
def test_the_best_policy_of_small_rewards_is_the_best(unit: F) -> None:
    """A search that stops at 1e-13 has proven nothing about rewards of 1e-15."""
    rows = [(s, a, [(1, TARGETS[s][a], REWARDS[s][a] * unit)]) for s in range(4) for a in range(3)]
    worth = []
    for choice in product(range(3), repeat=4):
        state, total = 0, F(0)
        for _ in range(STEPS):
            total += REWARDS[state][choice[state]] * unit
            state = TARGETS[state][choice[state]]
        worth.append(total)
    best = best_policy(MDP.from_outcomes(rows).within(STEPS), ("state",))
    assert best.proven
    assert best.value.value == pytest.approx(float(max(worth)), rel=1e-9, abs=0)
    assert best.upper_bound >= float(max(worth)) * (1 - 1e-12)


def test_a_state_that_cannot_be_reached_makes_no_action_optimal() -> None:
    """In every draw the second action gives up 5, whatever another state is worth."""
    half = F(1, 2)
    rows = [(0, 0, [(half, 1, 5), (half, 2, 5)]), (0, 1, [(half, 1, 0), (half, 2, 0)])]
    rows += [(1, 0, [(1, 3, 0)]), (2, 0, [(1, 3, 0)]), (3, 0, [(1, 3, 0)])]
    mdp = MDP.from_outcomes([*rows, (4, 0, [(1, 3, 10**13)])])
    share, _, _ = psa(moving(mdp, {"p": [(0, 1)]}), 20, rng=1).probability_optimal()
    assert np.array(share).tolist() == [[1.0, 0.0]]


def test_a_loose_tolerance_does_not_make_an_optimum_stationary() -> None:
    """Here the best action of a status changes with the trial: bounds may not deny it."""
    model = ["solve", "yuan2025", "--set", "readings.influence_orientation=column-to-row", "--json"]
    found = [
        run(*model, *more).result["stationary"]
        for more in (["--certify"], [], ["--method", "value-iteration", "--tol", "50"])
    ]
    assert found == [False, False, None]
    usual = run("solve", "yuan2025", "--json").result["stationary"]
    assert usual is True


def test_the_spread_of_small_rewards_is_a_spread() -> None:
    """Shares of variance do not depend on the unit of reward."""
    half, found = F(1, 2), []
    for unit in (F(1), F(1, 2**40)):
        rows = [(0, 0, [(half, 1, 5 * unit), (half, 2, 0)]), (1, 0, [(1, 3, unit)])]
        rows += [(2, 0, [(F(1, 3), 3, 0), (F(2, 3), 1, 2 * unit)]), (3, 0, [(1, 3, 0)])]
        model = moving(MDP.from_outcomes(rows), {"p": [(0, 1)], "q": [(2, 1)]})
        found.append(sobol(model, n=32, rng=1).optimal)
    assert found[1].sd == pytest.approx(found[0].sd / 2**40, rel=1e-9, abs=0)
    assert found[1].total == pytest.approx(found[0].total)


def test_action_numbers_that_are_not_whole_are_refused() -> None:
    """0.9 is not action 0."""
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])])
    with pytest.raises(ModelError, match="not whole"):
        Policy.by(mdp, ("state",), [0.9, 0.0])
    assert Policy.by(mdp, ("state",), [1, 0]).weights(mdp).tolist() == [0.0, 1.0, 1.0]
