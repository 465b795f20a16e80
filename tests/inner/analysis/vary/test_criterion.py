"""What results say of their criterion."""

import pytest

from exact_mdp import MDP, curve, gradient, study
from exact_mdp.analysis.vary.criterion import OfCriterion


def test_results_say_what_their_values_are() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 2)])], "1/2")
    for criterion, measure, words in (
        ("total", "value", {}),
        ("average", "average reward", {"criterion": "average reward per step"}),
    ):
        for result in (
            study(mdp, {"reward.2": [1]}, criterion=criterion),
            gradient(mdp, criterion=criterion),
            curve(mdp, "reward.2", (1, 3), criterion=criterion),
        ):
            assert isinstance(result, OfCriterion)
            assert result.criterion == criterion
            assert result.measure == measure
            facts = result.criterion_facts
            assert {name: fact.text for name, fact in facts.items()} == words
            assert all(fact.value == criterion for fact in facts.values())


@pytest.mark.parametrize("criterion", ["total", "average"])
def test_values_of_both_criteria(criterion: str) -> None:
    """2 a step: 4 in all at discount 1/2."""
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 2)])], "1/2")
    wanted = {"total": 4, "average": 2}[criterion]
    assert gradient(mdp, criterion=criterion).start_value == wanted
    assert curve(mdp, "reward.2", (1, 3), criterion=criterion).at(2) == wanted
