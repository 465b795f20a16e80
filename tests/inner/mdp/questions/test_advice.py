"""Models whose total is infinite or says nothing: where that is, and what else to ask."""

import numpy as np
import pytest
from refusal_tables import refused

from exact_mdp import MDP
from exact_mdp.mdp.questions.advice import (
    other_question,
    require_termination,
    warn_of_zero_reward,
    ways_out,
    where_endless,
)


def test_a_policy_that_does_not_end_is_named() -> None:
    rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 2, 0)]), (1, 0, [(1, 0, 0)]), (2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(rows, states=["left", "right", "end"], actions=["go", "stop"])
    refused(
        lambda: require_termination(mdp), "every policy to end, and some policy does not",
        "it stays forever in (state left) with action go, (state right) with action go",
        "choose a discount below 1 (--discount 0.95",
    )  # fmt: skip
    require_termination(mdp.with_(discount="1/2"))
    refused(lambda: require_termination(MDP.from_arrays([np.eye(9)], np.ones(9))), "", "and 5 more")


def test_advice_for_a_run_that_ends_outside_the_goal() -> None:
    rows = [(0, 0, [("1/2", 1, 1), ("1/2", 2, 1)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(
        rows, states=["way", "home", "ditch"], labels={"home": [False, True, False]}
    )
    assert "--horizon N" in ways_out(mdp)
    assert "--criterion average" in other_question(mdp)
    asking = mdp.until("home")
    refused(lambda: require_termination(asking), "a run that ends outside the goal is worth")
    assert where_endless(asking) == "it ends outside the goal in (state ditch)"
    assert "--horizon" not in ways_out(asking)
    assert "--reach LABEL" in other_question(asking)


def test_a_reward_of_0_everywhere_is_said_if_a_component_says_more() -> None:
    rows = [(0, 0, [(1, 1, {"gain": 2, "loss": -2})]), (1, 0, [(1, 1, {"gain": 0, "loss": 0})])]
    mdp = MDP.from_outcomes(rows)
    with pytest.warns(UserWarning, match="the components gain, loss do not count"):
        warn_of_zero_reward(mdp)
    warn_of_zero_reward(mdp.earning("gain"))  # no warning, which would be an error
