"""What is counted beside the reward, also where nothing is earned, against all small policies."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from objective_models import (
    LIMITS,
    best_under,
    quiet_models,
    totals,
    totals_within,
    vertices,
    with_components,
)
from oracle import each_choice

from exact_mdp import MDP, MDPEnv, ModelError, Policy, check, evaluate, solve, tradeoff

F = Fraction
SENSE = {"max": 1, "min": -1}
# State 1 earns nothing, and its second action is an effort for ever.
WORK = MDP.from_pairs(
    [0, 1, 1], [0, 0, 1], [[0, 1]] * 3, [1, 0, 0], "1/2", components={"effort": [0, 0, 1]}
)


def test_a_state_that_earns_nothing_is_not_over_where_an_amount_is_counted() -> None:
    assert WORK.terminal.tolist() == [False, True]
    assert (WORK.over.any(), WORK.ends.must_choose.tolist()) == (False, [False, True])
    assert WORK.ends.alike.tolist() == [True, False]
    with pytest.raises(ModelError, match=r"rows are missing|no action"):
        Policy.of(WORK, {0: 0})
    env = MDPEnv(WORK)
    env.reset(seed=0)
    assert env.step(0)[2] is False
    over = WORK.with_(components={"effort": [1, 0, 0]})
    assert over.over.tolist() == [False, True]
    assert Policy.of(over, {0: 0}).weights(over).tolist() == [1, 1, 0]
    assert Policy.of(over, np.array([[1, -np.inf], [np.nan] * 2]), kind="q").rule.tolist() == [
        0,
        -1,
    ]


def test_within_n_steps_an_amount_is_counted_n_times() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 0)])], "1/2", components={"u": ["1/2"]})
    assert evaluate(mdp, [0], horizon=2).components["u"] == 3 / 4
    assert solve(WORK, horizon=3, subject_to={"effort": ["<= 1/2", ">= 1/2"]}).feasible


@settings(max_examples=150)
@given(quiet_models(), st.sampled_from([None, None, 1, 2]), st.data())
def test_limits_fronts_and_gates_agree_with_every_policy(
    mdp: MDP, steps: int | None, data: st.DataObject
) -> None:
    sense, names = SENSE[mdp.sense], ["reward", "c0", "c1"]
    every = [list(mdp.pairs_of(state)) for state in range(mdp.n_states)]
    points = sorted(totals_within(mdp, every, steps) if steps else set(totals(mdp, names)))
    limits = []
    for k in data.draw(st.sampled_from([[1], [2], [1, 2]])):
        ends = [bound(point[k] for point in points) for bound in (min, max)]
        part = data.draw(st.sampled_from([F(0), F(1, 3), F(1, 2), F(1), F(5, 4)]))
        sign = data.draw(st.sampled_from([1, -1]))
        limits.append((k, sign, ends[0] + part * (ends[1] - ends[0])))
    bounds = {names[k]: f"{'>=' if sign > 0 else '<='} {bound}" for k, sign, bound in limits}
    best = best_under(points, limits, sense)
    solution = solve(mdp, subject_to=bounds, horizon=steps)
    assert (solution.feasible, solution.violations()) == (best is not None, [])
    assert best in (None, solution.start_value)

    choice = [data.draw(st.sampled_from(pairs)) for pairs in every]
    q = np.where(mdp.by_action(np.ones(mdp.n_pairs), 0) > 0, -F(sense), np.nan).astype(float)
    q[range(mdp.n_states), mdp.pair_action[choice]] = sense
    q[mdp.over] = np.nan
    mine = (
        totals_within(mdp, [[pair] for pair in choice], steps)
        if steps
        else {totals(mdp, names)[[*each_choice(mdp)].index(tuple(choice))]}
    )
    total = mine.pop()
    audit = check(mdp, q, subject_to=bounds, horizon=steps, kind="q")
    keeps = all(sign * (total[k] - bound) >= 0 for k, sign, bound in limits)
    assert audit.criterion.totals == {names[k]: total[k] for k, _, _ in limits}
    assert audit.passed == (keeps and total[0] == best)
    assert audit.q_error is None  # under limits the optimal action values are not of the reward

    front = tradeoff(mdp.within(steps) if steps else mdp, ["c0", "c1"])
    assert {*front.vertices} == vertices([point[1:] for point in points], sense)
    assert front.violations() == []


# ---- under limits --------------------------------------------------------------------------------


@settings(max_examples=40)
@given(mdp=with_components(1), bound=LIMITS, data=st.data())
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
