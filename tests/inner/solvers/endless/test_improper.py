"""The reduction of improper policies, against exact values: signs, merged states, the way back."""

from collections.abc import Iterator
from fractions import Fraction as F
from math import inf

import numpy as np
import pytest
from oracle import rows_of
from small_models import small_model

from exact_mdp import MDP, certify, solve
from exact_mdp.solvers.dynamic.methods import PolicyIteration
from exact_mdp.solvers.endless.improper import ImproperPolicies
from exact_mdp.solvers.endless.quotient import of_pairs

# 0 ⇄ 1 for nothing, and 1 may leave for 2 at a cost; 2 waits, or earns 7 on its way to the end 3.
ROWS = [
    (0, 0, [(1, 1, 0)]),
    (1, 0, [(1, 0, 0)]),
    (1, 1, [(1, 2, -5)]),
    (2, 0, [(1, 2, 0)]),
    (2, 1, [(1, 3, 7)]),
    (3, 0, [(1, 3, 0)]),
]
MODEL = MDP.from_outcomes(ROWS, 1, labels={"end": [3]})


def improper_models() -> Iterator[MDP]:
    """Models in which policies can stay forever, with rewards of one sign, of both, and 0."""
    for seed in range(12):
        mdp = small_model(seed, leaving=False, by_outcome=False, ends=1)
        mdp = mdp.with_(labels={"goal": mdp.terminal}, start=int(mdp.terminal.argmax()))
        rng, one = np.random.default_rng(seed), np.ones(mdp.n_pairs, dtype=np.int64)
        for amounts in ([0, 0, -1], [0, 0, 1], [0, 1, -2]):
            earned = rng.choice(amounts, mdp.n_pairs) * ~mdp.terminal[mdp.pair_state]
            own = mdp.with_(table=mdp.table.with_reward(earned, one), labels=mdp.labels)
            yield from (own, own.until("goal"), own.with_(sense="min").until("goal").maximised)


def test_end_components_and_those_without_reward() -> None:
    improper = ImproperPolicies(MODEL)
    component, inside = improper.maximal
    assert component[0] == component[1] != component[2] >= 0 > component[3]
    assert inside.tolist() == [True, True, False, True, False, False]
    assert improper.zero_reward[0].tolist() == component.tolist()
    table = MODEL.table.with_reward(np.array([0, 0, 0, 1, 0, 0]), np.ones(6, dtype=np.int64))
    paid = ImproperPolicies(MODEL.with_(table=table))
    assert (paid.zero_reward[0] >= 0).tolist() == [True, True, False, False]
    assert paid.sign.tolist() == [1, 1, 1, 0]


def test_states_that_reach_each_other_for_nothing_become_one() -> None:
    """Without a goal they may also end there, by a pair of their own."""
    whole = ImproperPolicies(MODEL).apply()
    assert whole.new_state.tolist() == [0, 0, 1, 2]
    assert rows_of(whole.mdp) == [
        (0, 0, -5, {1: 1}),
        (0, 1, 0, {2: 1}),
        (1, 0, 7, {2: 1}),
        (1, 1, 0, {2: 1}),
        (2, 0, 0, {2: 1}),
    ]
    goal = ImproperPolicies(MODEL.with_(sense="min").until("end").maximised).apply()
    assert rows_of(goal.mdp) == [
        (0, 0, 5, {1: 1}),
        (1, 0, -7, {2: 1}),
        (2, 0, 0, {2: 1}),
    ]


def test_components_that_are_left_become_states_and_others_the_end() -> None:
    """0 and 1 are a component that is left, and 2 is one that is not; 3 is in none."""
    rows = [(0, 0, [(1, 1, 0)]), (1, 0, [(1, 0, 0)]), (1, 1, [("1/2", 2, -2), ("1/2", 3, -2)])]
    rows += [(2, 0, [(1, 4, 0)]), (4, 0, [(1, 2, 0)]), (3, 0, [(1, 0, -7)])]
    whole = ImproperPolicies(MDP.from_outcomes(rows, 1)).apply()
    assert whole.new_state.tolist() == [0, 0, 2, 1, 2]
    assert rows_of(whole.mdp) == [
        (0, 0, -2, {1: F(1, 2), 2: F(1, 2)}),
        (0, 1, 0, {2: 1}),
        (1, 0, -7, {0: 1}),
        (2, 0, 0, {2: 1}),
    ]


def test_states_of_a_round_that_loses_stay_apart() -> None:
    rows = [(0, 0, [(1, 1, "1/2")]), (0, 1, [(1, 2, 3)]), (1, 0, [(1, 0, -1)])]
    mdp = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])], 1)
    finite = ImproperPolicies(mdp).apply()
    assert finite.mdp.n_states == len({*finite.new_state.tolist()}) == 3
    assert np.isfinite(solve(mdp).value).all()


def test_a_state_that_cannot_leave_for_good_is_an_end() -> None:
    rows = [(0, 0, [(1, 0, 0)]), (1, 0, [(1, 0, 4)])]
    whole = ImproperPolicies(MDP.from_outcomes([*rows, (0, 1, [(1, 0, 0)])], 1)).apply()
    assert whole.mdp.n_states == whole.new_state[1] + 2 == 2


def test_rewards_that_may_cancel_are_left_to_exact_levels() -> None:
    for more, applies in ((0, False), (1, True), (-1, True)):
        rows = [(0, 0, [(1, 1, 2)]), (1, 0, [(1, 0, more - 2)]), (2, 0, [(1, 0, 0)])]
        assert ImproperPolicies(MDP.from_outcomes(rows, 1)).applies == applies
    # Staying in 0 for nothing is at least as good as losing on the way to 1 and back.
    rows = [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, -1)]), (1, 0, [(1, 0, 0)])]
    assert ImproperPolicies(MDP.from_outcomes(rows, 1)).applies
    # +∞ by chance, at a risk of -∞.
    rows = [(0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]), (1, 0, [(1, 1, 1)]), (2, 0, [(1, 2, -1)])]
    assert not ImproperPolicies(MDP.from_outcomes(rows, 1, start=1)).applies


@pytest.mark.parametrize("kind", ["+∞", "-∞", "finite"])
def test_the_way_back_gives_the_exact_values_and_a_policy_that_attains_them(kind: str) -> None:
    """Signs, values, and the values of the policy as the only one of its model."""
    seen = 0
    for mdp in improper_models():
        proof = certify(mdp)
        improper = ImproperPolicies(mdp)
        if not improper.applies:
            assert not mdp.ends.missing_pays
            continue
        sign = np.array([(value == inf) - int(value == -inf) for value in proof.value])
        assert improper.sign.tolist() == sign.tolist()
        chosen = {"+∞": sign > 0, "-∞": sign < 0, "finite": sign == 0}[kind]
        part = improper.apply().omit_losing_pairs()
        solution = PolicyIteration().solve_rewards(part.mdp)
        values = improper.lift_values(part, solution)
        exact = np.array([float(value) for value in proof.value])
        assert values.value[chosen] == pytest.approx(exact[chosen], abs=1e-9)
        assert (values.error[sign != 0] == 0).all()
        finite = exact[sign == 0]
        off = np.abs(values.value[sign == 0] - finite) - np.abs(np.spacing(finite))
        assert (off <= values.error[sign == 0]).all()
        seen += int(chosen.any())
        used = improper.lift_policy(part, solution.pairs)
        # Before a goal that must not be missed, costs without a minimum are attained by no policy.
        if kind == "+∞" and mdp.ends.has_goal and not mdp.ends.missing_pays:
            continue
        alone = certify(of_pairs(mdp, used).with_(goal=mdp.goal, unreached=mdp.unreached))
        assert alone.value[chosen].tolist() == proof.value[chosen].tolist()
    assert seen >= 5
