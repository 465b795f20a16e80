"""The gate on rewards per step: the exact regret, its price by state, and what is forgiven."""

from fractions import Fraction as F
from math import prod
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from made_models import forest
from oracle import best_average, gain_and_bias
from strategies import Rows, models

from exact_mdp import MDP, Certified, assert_policy_optimal, check, solve


@given(models(discounts=[F(1, 2)]), st.randoms(use_true_random=False))
@settings(max_examples=25)
def test_the_regret_is_exact_and_has_its_price_in_each_state(rows: Rows, rng: Random) -> None:
    counts = np.bincount([s for s, *_ in rows.pairs])
    assume(prod(counts.tolist()) <= 40)
    chosen = [rng.choice([r for r in rows.pairs if r[0] == s]) for s in range(rows.n_states)]
    policy = np.array([a for _, a, *_ in chosen])
    wanted = best_average(rows.pairs)[0][0] - gain_and_bias(chosen)[0][0]
    audit = check(rows.model(), policy, criterion="average")
    assert audit.value == Certified(value=wanted)
    assert audit.passed is (wanted == 0)
    priced = sum(each.cost for each in audit.disagreements)
    assert priced == pytest.approx(float(wanted), rel=1e-9, abs=1e-9 * float(1 + abs(wanted)))
    loose = check(rows.model(), policy, criterion="average", exact_values=False, max_regret=10**12)
    assert loose.value.interval[0] <= wanted <= loose.value.interval[1]
    assert loose.passed
    elsewhere = policy != solve(rows.model(), criterion="average").policy.rule
    assert loose.unclear == (elsewhere & loose.mdp.ends.must_choose).sum()


def test_cutting_the_oldest_forest_costs_what_it_earns_less() -> None:
    audit = check(forest("9/10"), [0, 0, 1], criterion="average")
    assert audit.value == Certified(value=F(81, 25) - F(162, 271))
    (wrong,) = audit.disagreements
    assert (wrong.label, wrong.learned, wrong.optimal) == ("state 2", "1", ("0",))
    assert wrong.expected_visits == pytest.approx(81 / 271)
    assert audit.agreement_by_visits == pytest.approx(190 / 271)
    assert "failed: the regret is not zero: it is 2.642" in audit.message()
    with pytest.raises(AssertionError, match=r"loses 8\.84 x 0\.298893 visits"):
        assert_policy_optimal(forest("9/10"), [0, 0, 1], criterion="average")
    assert_policy_optimal(forest("9/10"), "optimal", 0, criterion="average")


def test_what_the_rounding_of_floats_can_cause_is_forgiven() -> None:
    """0.1 + 0.2 every step, or 0.3; and every second step, after a detour."""
    table = [
        (0, 0, [(0.5, 0, 0.1), (0.5, 0, 0.1)]),
        (0, 1, [(0.1, 1, 0.3), (0.2, 1, 0.3), (0.7, 0, 0.3)]),
        (0, 2, [(0.3, 1, 0.1 + 0.2), (0.7, 0, 0.3)]),
        (1, 0, [(1.0, 0, 0.1 + 0.2)]),
    ]
    mdp = MDP.from_outcomes(table)
    lost = [check(mdp, [a, 0], criterion="average") for a in range(3)]
    assert [audit.passed for audit in lost] == [False, True, True]
    assert len({audit.regret.learned.value for audit in lost}) == 3
    assert all(0 < audit.forgiven < 1e-15 for audit in lost)
    assert not any(audit.disagreements for audit in lost[1:])
    strict = [check(mdp, [a, 0], max_regret=0, criterion="average").passed for a in (1, 2)]
    assert sorted(strict) == [False, True]


@pytest.mark.parametrize("also", [0, 1])
def test_a_huge_reward_on_the_way_forgives_nothing_of_a_small_loss(also: int) -> None:
    """A bias of 1e10 once stood for the gains of 1e-100 that a step on the way is judged by."""
    half, least = [(0.5, 1, 0), (0.5, 2, 0)], 1e-100
    rows = [(0, 0, half), (0, 1, [half[0], (0.5, 3, 0)]), (1, 0, [(1, 2, 1e10)])]
    rows += [(2, 0, [(1, 2, least)]), (3, 0, [(1, 3, 0)]), (3, 1, [(1, 3, -least)])]
    audit = check(MDP.from_outcomes(rows), [1, 0, 0, also], criterion="average")
    costs = {each.state: each.cost for each in audit.disagreements}
    assert costs == pytest.approx({0: 5e-101, **({3: 5e-101} if also else {})}, rel=1e-12)
    assert sum(costs.values()) == pytest.approx(float(audit.value), rel=1e-12)


@pytest.mark.parametrize("digits", [3, 8, 12, 14, 40])
@pytest.mark.parametrize("criterion", ["total", "average"])
def test_what_is_lost_adds_up_however_slowly_a_class_is_left(criterion: Any, digits: int) -> None:
    """States 2 and 3 are come to with the chances 1/4 and 3/4; in total state 4 is an end."""
    q = F(1, 10**digits)
    rows = [[0, 1 - q, q / 4, 3 * q / 4], [F(2, 3), F(1, 3), 0, 0], [0, 0, 1, 0], [0, 0, 1, 0],
            [0, 0, 0, 1], [0, 0, 0, 1]]  # fmt: skip
    reward, policy, states = [1, 0, -1, 0, 0, -5], [0, 0, 0, 1], [0, 1, 2, 2, 3, 3]
    if criterion == "total":
        end = [0, 0, 0, 0, 1]
        rows = [*([*row, 0] for row in rows[:3]), end, [0, 0, 0, 1, 0], end, end]
        reward, policy, states = [0, 0, 0, 1, 0, 5, 0], [0] * 5, [*states, 4]
    actions, start = [0, 0, 0, 1, 0, 1, 0][: len(rows)], [1, *[0] * (len(policy) - 1)]
    mdp = MDP.from_pairs(states, actions, rows, reward, start=start)
    audit = check(mdp, policy, criterion=criterion)
    assert audit.regret.at_start.value == 4
    costs = {each.state: each.cost for each in audit.disagreements}
    assert costs == {3: pytest.approx(3.75, rel=1e-12), 2: pytest.approx(0.25, rel=1e-12)}
    assert audit.visits[0] == pytest.approx(float(1 / q), rel=1e-12)
