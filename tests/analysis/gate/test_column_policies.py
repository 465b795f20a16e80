"""The best policy that reads some columns only: proven by enumeration and by relaxations."""

from fractions import Fraction as F
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import policy_by
from strategies import tables

from exact_mdp import (
    MDP,
    Column,
    Policy,
    Scenario,
    StateSpace,
    best_policy,
    certify,
    check,
    evaluate,
    solve,
)

CARE = Scenario.load("yuan2025")
TEMPTING = CARE.with_(
    tasks=[2],
    max_trial=3,
    parameters={"reward.assist.directive": -30, "reward.trial": 0, "reward.timestep": 0},
)


def every_policy(mdp: MDP, columns: tuple[str, ...]) -> list[float]:
    """The values of all policies that take one action where these columns agree."""
    read = [
        tuple(mdp.space.as_dict(state)[c] for c in columns) for state in range(mdp.space.regular)
    ]
    rows = sorted(set(read))
    policies = []
    for choice in product(range(mdp.n_actions), repeat=len(rows)):
        actions = [choice[rows.index(each)] for each in read]
        actions += [0] * (mdp.n_states - len(actions))
        policies.append(evaluate(mdp, Policy.of(mdp, actions)).mean)
    return policies


@settings(max_examples=80)
@given(tables())
def test_the_best_policy_is_the_best_of_all(mdp: MDP) -> None:
    for columns in ((), ("row",)):
        values = every_policy(mdp, columns)
        best = best_policy(mdp, columns)
        assert best.proven
        assert best.value.value == pytest.approx(max(values), abs=1e-9)
        assert best.value.error < 1e-9
        assert max(values) <= best.upper_bound + 1e-12 <= best.value.value + 1e-8
        assert evaluate(mdp, best.policy).mean == pytest.approx(best.value.value, abs=1e-9)
        assert best.policy.columns == columns
        cut = best_policy(mdp, columns, node_limit=1)
        assert max(values) - 1e-12 <= cut.upper_bound <= best.mixed_upper_bound + 1e-12
        assert best.upper_bound <= cut.upper_bound
        assert cut.value.value <= max(values) + 1e-9
        assert cut.proven == (cut.upper_bound - cut.value.value < 1e-8)
    exact = float(certify(mdp).start_value)
    assert best_policy(mdp, ("time", "row")).value.value == pytest.approx(exact, abs=1e-9)
    assert best.mixed_upper_bound == pytest.approx(exact, abs=1e-9)


def test_little_beside_a_large_value_is_not_proven_to_be_nothing() -> None:
    """Cut short, the search leaves 1/4000 beside 10⁶ open: far more than rounding."""
    ways = [("1/2", 1, 10**6), ("1/2", 2, 10**6)]
    rows = [(0, 0, ways), (0, 1, ways), (1, 0, [(1, 3, "1/2000")]), (1, 1, [(1, 3, 0)])]
    rows += [(2, 0, [(1, 3, 0)]), (2, 1, [(1, 3, "3/5000")]), (3, 0, [(1, 3, 0)])]
    mdp = MDP.from_outcomes(rows)
    cut, best = best_policy(mdp, (), node_limit=1), best_policy(mdp, ())
    assert (cut.proven, best.proven) == (False, True)
    assert cut.upper_bound - 10**6 == pytest.approx(0.00055, abs=1e-7)
    assert best.upper_bound - 10**6 == pytest.approx(0.0003, abs=1e-7)


def test_what_a_status_policy_cannot_express() -> None:
    mdp = TEMPTING.compile()
    best = best_policy(mdp)
    more = [("subtask", "status"), ("trial", "status"), ("subtask", "trial", "status")]
    others = [best_policy(mdp, columns) for columns in more]
    optimal = float(certify(mdp).start_value)
    assert best.columns == ("status",)
    assert best.proven
    assert optimal - best.value.value > 0.005  # what is best changes with the trial
    assert [each.columns for each in others] == more
    for each in others:
        assert each.proven
        assert best.value.value - 1e-9 <= each.value.value <= optimal + 1e-9
    assert others[-1].value.value == pytest.approx(optimal, abs=1e-9)
    audit = check(mdp, best.policy)
    why = audit.representation
    assert why is not None
    assert not audit.passed
    assert float(why.learning_error.value) == 0
    assert why.rows == ()
    assert why.loss == audit.regret.at_start
    assert check(mdp, others[-1].policy).representation is None


@settings(max_examples=40)
@given(tables(), st.data())
def test_rows_whose_change_alone_gains_are_named(mdp: MDP, data: st.DataObject) -> None:
    rows, numbers = mdp.space.column("row").size, range(mdp.n_actions)
    own = [data.draw(st.sampled_from(numbers)) for _ in range(rows)]

    def changed_mean(row: int, action: int) -> float:
        changed = [action if k == row else a for k, a in enumerate(own)]
        return evaluate(mdp, policy_by(mdp, ["row"], changed)).mean

    now = changed_mean(0, own[0])
    most = {f"row {row}": max(changed_mean(row, a) for a in numbers) - now for row in range(rows)}
    why = check(mdp, policy_by(mdp, ["row"], own)).representation
    assert why is not None
    gains = {each["row"]: each["gain"] for each in why.rows}
    assert gains == pytest.approx({row: gain for row, gain in most.items() if gain > 1e-9})


def test_a_row_is_changed_to_what_its_states_offer_alone() -> None:
    """States 0 and 2 have two actions, 1 and 3 a third one; action a costs a + 1."""
    rows = [(s, a, [(1, min(s + 2, 4), -a - 1)]) for s in range(4) for a in range(2 + s % 2)]
    columns = (Column(name="time", size=2), Column(name="row", size=2))
    mdp = MDP.from_outcomes([*rows, (4, 0, [(1, 4, 0)])], start=["1/2", "1/2", 0, 0, 0])
    mdp = mdp.with_(space=StateSpace(columns=columns, extra=("end",)))
    why = check(mdp, policy_by(mdp, ["row"], [1, 2])).representation
    assert why is not None
    assert [(each["row"], each["best"], each["gain"]) for each in why.rows] == [
        ("row 1", "0", pytest.approx(2)), ("row 0", "0", pytest.approx(1)),
    ]  # fmt: skip


REWARDS = [[0, -5, 0], [3, 2, 12], [-1, 0, -10], [-12, -5, -10]]
TARGETS = [[3, 0, 3], [2, 2, 3], [1, 1, 1], [1, 2, 2]]


@pytest.mark.parametrize("unit", [F(1), F(1, 10**15), F(1, 10**100)])
def test_the_best_policy_of_small_rewards_is_the_best(unit: F) -> None:
    """A search that stops at 1e-13 has proven nothing about rewards of 1e-15."""
    rows = [(s, a, [(1, TARGETS[s][a], REWARDS[s][a] * unit)]) for s in range(4) for a in range(3)]
    mdp = MDP.from_outcomes(rows).within(5)
    most, best = max(every_policy(mdp, ("state",))), best_policy(mdp, ("state",))
    assert best.proven
    assert best.value.value == pytest.approx(most, rel=1e-9, abs=0)
    assert best.upper_bound >= most * (1 - 1e-12)


ALL_OVER = [(s, a, [(1, s, 0)]) for s in range(3) for a in range(2)]


@pytest.mark.parametrize("rows", [ALL_OVER, ALL_OVER[:2], ALL_OVER[:1], [(0, 0, [(1, 0, 1)])]])
@pytest.mark.parametrize("discount", [1, F(1, 2)])
def test_models_with_nothing_to_do_have_answers(rows: list[Any], discount: F) -> None:
    """All states terminal, one state, one action: nothing is lost, and nothing fails."""
    if discount == 1 and rows[0][2][0][2]:
        return  # worth +∞, whatever is done
    mdp = MDP.from_outcomes(rows, discount)
    value = F(rows[0][2][0][2]) / (1 - discount) if discount < 1 else F(0)
    assert certify(mdp).start_value == value
    assert certify(mdp).violations() == []
    for read in ((), ("state",)):
        assert best_policy(mdp, read).value.value == pytest.approx(float(value))
    for kind, form in (("auto", solve(mdp)), ("q", np.zeros((mdp.n_states, mdp.n_actions)))):
        for exactly in (True, False):
            audit = check(mdp, form, kind=kind, exact_values=exactly)
            assert audit.passed
            assert len(audit.frame()) == 0
            assert audit.message()
    assert check(mdp, "random", criterion="average").passed
    assert check(mdp, "random", horizon=2).passed
    assert evaluate(mdp, "random").mean == pytest.approx(float(value))


def test_a_start_policy_is_never_lost() -> None:
    mdp = TEMPTING.compile()
    good = best_policy(mdp).policy
    cut = best_policy(mdp, start=good, node_limit=1)
    assert cut.value.value == pytest.approx(best_policy(mdp).value.value, abs=1e-9)
