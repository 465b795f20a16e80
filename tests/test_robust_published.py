"""Interval MDPs that other tools publish answers for."""

from fractions import Fraction

import numpy as np
import pytest
from cases.intervals import INTERVAL_CASES, IntervalCase, total_reward

from exact_mdp.mdp import ModelError
from exact_mdp.solvers.robust.robust import solve_robust
from exact_mdp.solvers.robust.sets import interval_model


@pytest.mark.parametrize("case", INTERVAL_CASES, ids=str)
def test_published_answer(case: IntervalCase) -> None:
    mdp, intervals = interval_model(case.rows, case.discount, start=case.start)
    for (objective, nature), values in case.values.items():
        found = solve_robust(mdp, intervals, nature=nature, objective=objective)
        assert found.error_bound < 1e-5
        for state, value in values.items():
            room = found.state_error[state] + case.tolerance
            assert abs(found.value[state] - float(value)) <= room, (objective, nature, state)


@pytest.mark.parametrize("case", INTERVAL_CASES, ids=str)
def test_the_chain_it_returns_earns_what_it_says(case: IntervalCase) -> None:
    mdp, intervals = interval_model(case.rows, case.discount, start=case.start)
    for objective, nature in case.values:
        found = solve_robust(mdp, intervals, nature=nature, objective=objective)
        matrix = np.eye(mdp.n_states) - mdp.discount * found.transition.toarray()
        earned = np.linalg.solve(matrix, found.reward)
        assert earned == pytest.approx(found.value, abs=1e-7 + 2 * found.error_bound)


def test_an_infinite_total_is_refused() -> None:
    case = total_reward(Fraction(1))
    mdp, intervals = interval_model(case.rows, 1)
    with pytest.raises(ModelError, match="every episode to end") as caught:
        solve_robust(mdp, intervals)
    assert "(state 2)" in str(caught.value)
