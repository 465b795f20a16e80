"""Values of policies, each beside the solution of its equations in fractions."""

from fractions import Fraction as F
from math import inf
from typing import Any

import numpy as np
import oracle
import pytest
from small_models import given, random_policy, small_model

from exact_mdp import MDP
from exact_mdp.solvers.dynamic.methods import ModifiedPolicyIteration
from exact_mdp.solvers.dynamic.values import NEARLY_ONE
from exact_mdp.solvers.values import policy_values as module
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.policy_values import find_policy_values


@pytest.mark.parametrize("rate", ["0", "2/3", "1", "999999999/1000000000"])
def test_values_differ_from_the_truth_by_their_errors_at_most(rate: str) -> None:
    for seed in range(20):
        mdp = small_model(seed, rate, falling=True)
        rng = np.random.default_rng(seed)
        pairs = [int(rng.choice(mdp.pairs_of(s))) for s in range(mdp.n_states)]
        found = find_policy_values(PolicyChain.of(mdp, mdp.pair_action[pairs]))
        ends = {*np.flatnonzero(mdp.terminal).tolist()}
        truth = oracle.policy_values(oracle.rows_of(mdp, pairs), F(rate), ends)
        for value, error, exact in zip(found.value, found.error, truth, strict=True):
            assert abs(F(float(value)) - exact) <= F(float(error)) < F(1, 10**6)
        assert found.settled


def test_what_is_earned_forever_is_infinite_and_what_is_not_met_may_be_unknown() -> None:
    rows: Any = [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 2, 3)]), (1, 0, [(1, 1, 1)]), (2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(rows)
    stays = find_policy_values(PolicyChain.of(mdp, [0, 0, 0]))
    assert (stays.value.tolist(), stays.settled) == ([inf, inf, 0], False)
    ends = find_policy_values(PolicyChain.of(mdp, [1, 0, 0]))
    assert (ends.value[[0, 2]].tolist(), ends.settled) == ([3, 0], True)
    assert (ends.value[1], ends.error[1]) == (inf, 0)
    assert ends.error[[0, 2]].max() < 1e-12
    # What is not met is in no bound: errors shrink with the rewards.
    rows[1] = (0, 1, [(1, 2, F(3, 2**100))])
    small = find_policy_values(PolicyChain.of(MDP.from_outcomes(rows), [1, 0, 0]))
    assert small.value.tolist() == [3 / 2**100, inf, 0]
    assert small.error.max() < 1e-12 / 2**100


def test_rewards_that_cancel_forever_have_the_mean_of_discounts_next_to_1() -> None:
    """1, -1, 1, -1, … is worth 1 / (1 + γ)."""
    chain = PolicyChain.of(MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (1, 0, [(1, 0, -1)])]), [0, 0])
    found = find_policy_values(chain)
    assert found.value == pytest.approx([0.5, -0.5])
    assert (found.chain, found.settled) == (chain, False)


def test_classes_without_rewards_become_terminal() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 5)]), (1, 0, [(1, 2, 0)]), (2, 0, [(1, 1, 0)])])
    given = PolicyChain.of(mdp, [0, 0, 0])
    found = find_policy_values(given)
    assert found.value.tolist() == [5, 0, 0]
    assert found.chain is not given
    assert found.chain.mdp.terminal.tolist() == [False, True, True]


@pytest.mark.parametrize("rate", ["1", "1/2"])
def test_errors_of_rewards_that_cancel_are_in_the_bound(rate: str) -> None:
    """10^16 + 1 is no float: half of it less 5 10^15 is 1 / 2, of which floats see nothing."""
    big = 10**16
    rows: Any = [(0, 0, [(1, 1, big + 1)]), (0, 1, [(1, 1, -big)]), (1, 0, [(1, 1, 0)])]
    chain = PolicyChain.of(MDP.from_outcomes(rows, rate), "random")
    found = find_policy_values(chain)
    assert abs(F(float(found.value[0])) - F(1, 2)) <= F(float(found.error[0])) < 16
    # All is over after one step: the reward is the value, and its error may be all of that.
    assert found.error[0] >= chain.reward[1][0]


def test_next_to_discount_1_values_are_improved_in_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    used = list[MDP]()

    class Counting(ModifiedPolicyIteration):
        def solve(self, model: MDP) -> Any:
            used.append(model)
            return super().solve(model)

    monkeypatch.setattr(module, "ModifiedPolicyIteration", Counting)
    close = 1 - F(1, 10**9)
    for rate, rounds in ((F(1), 0), (F(99, 100), 0), (F(NEARLY_ONE), 0), (close, 1)):
        for seed in range(3):
            mdp = small_model(seed, rate)
            chances = random_policy(mdp, seed)
            found = find_policy_values(PolicyChain.of(mdp, given(chances)))
            law = oracle.mixed(oracle.rows_of(mdp), chances)
            truth = oracle.policy_values(law, rate, {*np.flatnonzero(mdp.terminal).tolist()})
            for value, error, exact in zip(found.value, found.error, truth, strict=True):
                assert abs(F(float(value)) - exact) <= F(float(error))
                assert error <= 1e-5 * (1 + abs(float(exact)))
            assert len(used) == rounds
            used.clear()
    # Of many transitions, those of a pure policy alone.
    for pure, more, rounds in ((False, 1, 1), (False, 0, 0), (True, 0, 1)):
        mdp = small_model(1, close)
        monkeypatch.setattr(module, "COMPILED", mdp.n_transitions + more)
        find_policy_values(PolicyChain.of(mdp, given(random_policy(mdp, 1, pure=pure))))
        assert len(used) == rounds
        used.clear()
