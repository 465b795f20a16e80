"""Costs to minimise: what the law of costs, in `test_laws`, does not show."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from exact_mdp import MDP, SOLVERS, ModelError, Policy, best_policy, certify, check, evaluate

F = Fraction
COSTS = MDP.from_arrays(
    [[["1/2", "1/2", 0], [0, "1/3", "2/3"], [0, 0, 1]], [[0, 0, 1], [0, 0, 1], [0, 0, 1]]],
    [[2, 7], [1, 3], [0, 0]],
    "9/10",
    sense="min",
)


@pytest.mark.parametrize("name", SOLVERS)
def test_solvers_themselves_take_costs(name: str) -> None:
    """Whoever calls a solver without `solve` gets the least costs as well, not the greatest."""
    mdp = COSTS.within(30) if name == "backward-induction" else COSTS
    solution, least = SOLVERS[name]().solve(mdp), certify(mdp).start_value
    assert solution.start.interval[0] <= least <= solution.start.interval[1]
    if solution.program:
        assert solution.program.lower <= least <= solution.program.upper


def test_a_table_of_costs_is_read_by_its_least_entries() -> None:
    value = certify(COSTS).value_float
    q = np.full((3, 2), np.inf)
    q[COSTS.pair_state, COSTS.pair_action] = COSTS.backup(value)
    audit = check(COSTS, q, kind="q")
    assert audit.passed
    assert audit.q_error is not None
    assert audit.q_error.largest < 1e-14
    assert audit.q_error.promised == pytest.approx(value[0])
    whole = np.array([[2, 1], [1, 2], [0, 0]], dtype=np.uint8)
    assert Policy.of(COSTS, whole, kind="q").rule.tolist() == [1, 0, 0]
    with pytest.raises(ModelError, match=r"an action value is -inf(.|\n)*\+inf for one never"):
        check(COSTS, [[-np.inf, 1], [1, 2], [0, 0]], kind="q")


def test_what_columns_cannot_express_of_costs() -> None:
    """The best policy that reads nothing has the least costs of the two constant policies."""
    means = [evaluate(COSTS, f"always:{action}").mean for action in COSTS.actions]
    best = best_policy(COSTS, ())
    assert best.value.value == pytest.approx(min(means))
    assert best.upper_bound <= best.value.value + 1e-9
    audit = check(COSTS, "always:0")
    assert audit.representation is None or audit.representation.loss.value >= 0
