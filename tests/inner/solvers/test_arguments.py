"""A model is an object, a scenario or a file; a criterion is refused where it asks nothing."""

from pathlib import Path

import pytest

from exact_mdp import MDP, Column, ModelError, Scenario, StateSpace
from exact_mdp.solvers.arguments import (
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
