"""A policy that is held fixed is counted in each draw whose optimum it was."""

import numpy as np
import pytest

from exact_mdp import MDP, Scenario, psa
from exact_mdp.analysis.vary.distributions import row_family, uncertainty
from exact_mdp.analysis.vary.psa import POOL
from exact_mdp.analysis.vary.study import solver_of


def chain() -> MDP:
    """Return eight states with two chances to go on in each: 128 policies, each of them best."""
    rows = [(s, a, [("1/2", s + 1, 1), ("1/2", 8, 0)]) for s in range(8) for a in range(2)]
    return MDP.from_outcomes([*rows, (8, 0, [(1, 8, 0)])])


@pytest.mark.parametrize(
    "model",
    [Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).parametric(), row_family(chain())],
    ids=["care", "rows"],
)
def test_a_policy_is_counted_in_every_draw_whose_optimum_it_was(model) -> None:
    """However seldom that is."""
    how = {"uncertain": uncertainty(model, default=4), "rng": 0}
    draws = psa(model, 150, **how)
    solver, counts = solver_of(model, draws.names), np.bincount(draws.table.which)
    assert len(counts) > 2 * POOL
    for number in (int(np.flatnonzero(counts == counts.min())[-1]), int(counts.argmax())):
        policy = solver.hold_policy(draws.table.rows[number])
        assert np.array_equal(solver.to_action_numbers(policy), draws.table.rows[number])
        assert psa(model, 150, policy=policy, **how).candidates[0].frequency == counts[number]
