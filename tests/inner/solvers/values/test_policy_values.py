"""Values of policies, each beside the solution of its equations in fractions."""

from fractions import Fraction as F
from math import inf
from typing import Any

import numpy as np
import oracle
import pytest
from small_models import small_model

from exact_mdp import MDP
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
    assert ends.value[1] == inf


def test_classes_without_rewards_become_terminal() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 5)]), (1, 0, [(1, 2, 0)]), (2, 0, [(1, 1, 0)])])
    given = PolicyChain.of(mdp, [0, 0, 0])
    found = find_policy_values(given)
    assert found.value.tolist() == [5, 0, 0]
    assert found.chain is not given
    assert found.chain.mdp.terminal.tolist() == [False, True, True]
