"""Policies under limits: against enumeration, and as the command reports them."""

from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from objective_models import totals, with_components
from oracle import each_choice

from exact_mdp import MDP, check, solve

F = Fraction
BOUNDS = st.sampled_from([F(-3), F(-1), F(-1, 3), F(0), F(1, 7), F(1), F(5, 2)])


@settings(max_examples=40)
@given(mdp=with_components(1), bound=BOUNDS, data=st.data())
def test_each_policy_against_the_best_mixture(mdp: MDP, bound: F, data: Any) -> None:
    """Passed is within the limit at no regret; states and the room left explain the regret."""
    every = totals(mdp, [*mdp.component_names])
    choices = list(each_choice(mdp))
    number = data.draw(st.integers(0, len(choices) - 1))
    total, earned = every[number][0], sum(every[number], F(0))
    policy = [int(mdp.pair_action[pair]) for pair in choices[number]]
    limit = {"c0": f">= {bound}"}
    audit, best = check(mdp, policy, subject_to=limit), solve(mdp, subject_to=limit)
    assert audit.criterion.best.feasible is best.feasible
    assert (audit.criterion.totals, audit.criterion.earned) == ({"c0": total}, earned)
    if not best.feasible:
        assert not audit.passed
        assert total < bound
        return
    sign = 1 if mdp.sense == "max" else -1
    assert audit.value.value == sign * (best.start_value - earned)
    assert audit.passed is (total >= bound and audit.value.value <= 0)
    explained = sum(each.cost for each in audit.disagreements) + float(audit.criterion.room)
    assert explained == pytest.approx(float(audit.value.value), abs=1e-6)
    assert check(mdp, best.policy, subject_to=limit).passed


def test_nothing_is_forgiven_under_limits() -> None:
    """0.1 + 0.2 is more than 0.3, as floats, which without limits is forgiven."""
    rows = [(0, 0, [(1, 2, 0.3)]), (0, 1, [(1, 1, 0.1)]), (1, 0, [(1, 2, 0.2)])]
    mdp, limit = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])]), {"steps": "<= 5"}
    less, most = (check(mdp, [action, 0, 0], subject_to=limit) for action in (0, 1))
    assert (less.passed, less.forgiven, most.passed) == (False, 0, True)
    assert check(mdp, [0, 0, 0]).passed
