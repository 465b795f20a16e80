"""Amounts in floats, whose rounded sum is the reward: the objective is the reward itself."""

from __future__ import annotations

from fractions import Fraction as F

import pytest

from exact_mdp import MDP, certify, check, rationalize, solve, tradeoff

PARTS = {"a": [0.1, 0.7, 0.0], "b": [0.2, 0.0, 0.0], "c": [0.3, 0.0, 0.0]}
REWARD = [0.1 + 0.2 + 0.3, 0.7, 0.0]


def model(first: str = "a") -> MDP:
    parts = {first if name == "a" else name: amount for name, amount in PARTS.items()}
    rows = [[0, 1], [0, 1], [0, 1]]
    return MDP.from_pairs([0, 0, 1], [0, 1, 0], rows, REWARD, components=parts)


@pytest.mark.parametrize("first", ["a", "reward"])
def test_the_optimum_under_limits_is_one_of_the_reward(first: str) -> None:
    """Also where a component is called as the reward is."""
    mdp = model(first)
    assert mdp.component_names == (first, "b", "c")
    assert sum(map(F, (0.1, 0.2, 0.3))) != F(REWARD[0])
    free = solve(mdp, subject_to={first: "<= 9"})
    assert (free.start_value, free.violations()) == (certify(mdp).start_value, [])
    solution = solve(mdp, subject_to={first: "<= 1/2"})
    share = (F(1, 2) - F(0.1)) / (F(0.7) - F(0.1))
    assert solution.start_value == (1 - share) * F(REWARD[0]) + share * F(0.7)
    assert solution.violations() == []
    audit = check(mdp, [0, 0], subject_to={first: "<= 1/2"})
    assert audit.regret.at_start.value == solution.start_value - F(REWARD[0])


def test_fronts_and_weights_are_of_the_amounts_as_given() -> None:
    mdp = model()
    front = tradeoff(mdp, ["a", "reward"])
    assert front.violations() == []
    assert front.vertices == [(F(0.7), F(0.7))]
    least_change = rationalize(mdp, [0, 0])
    assert least_change.violations() == []
    assert least_change.possible
    assert rationalize(mdp, [1, 0]).change == 0
