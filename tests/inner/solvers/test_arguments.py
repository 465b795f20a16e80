"""A model is an object, a scenario or a file; a criterion is refused where it asks nothing."""

from pathlib import Path

import pytest

from exact_mdp import MDP, Column, ModelError, Scenario, StateSpace, curve, gradient, study
from exact_mdp.solvers.arguments import (
    OfCriterion,
    is_average,
    mdp_of,
    require_average_applies,
    require_no_horizon,
)

CHAIN = MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0], labels={"end": [1]})


def test_a_model_is_taken_as_an_object_or_a_file(tmp_path: Path) -> None:
    path = tmp_path / "chain.json"
    CHAIN.save(path)
    assert mdp_of(CHAIN) is CHAIN
    assert mdp_of(path) == mdp_of(str(path)) == CHAIN
    scenario = Scenario.load("yuan2025")
    assert mdp_of(scenario) == scenario.compile()
    with pytest.raises(ModelError, match="list is not a model"):
        mdp_of([CHAIN])


def test_criteria_are_known_by_name() -> None:
    assert [is_average(name) for name in ("total", "average")] == [False, True]
    with pytest.raises(ModelError, match="mean"):
        is_average("mean")


def test_an_average_has_neither_horizon_nor_target() -> None:
    require_no_horizon(None)
    require_average_applies(CHAIN)
    with pytest.raises(ModelError, match="has no horizon"):
        require_no_horizon(0)
    with pytest.raises(ModelError, match="has no target"):
        require_average_applies(CHAIN.reaching("end"))


def test_runs_that_stop_after_some_steps_have_no_average(tmp_path: Path) -> None:
    """Neither if the model was read again; a time of day, which comes back, is another matter."""
    path = tmp_path / "steps.npz"
    CHAIN.within(2).save(path)
    for stopped in (CHAIN.within(2), MDP.load(path)):
        with pytest.raises(ModelError, match="has no horizon"):
            require_average_applies(stopped)
    space = StateSpace(columns=(Column(name="time", size=2), Column(name="state", size=1)))
    day = MDP.from_outcomes([(0, 0, [(1, 1, 2)]), (1, 0, [(1, 0, 0)])], space=space)
    require_average_applies(day)


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
