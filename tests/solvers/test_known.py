"""Tables by state and action against loops, and the policy of all optimal actions."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import Rows, models

from exact_mdp import MDP, certify, evaluate, solve

HALF = (Fraction(1, 2), Fraction(9, 10))


@given(models(discounts=HALF), st.booleans())
def test_tables_by_state_and_action(drawn: Rows, costs: bool) -> None:
    mdp = drawn.model().with_(sense="min" if costs else "max")
    solution, sign, never = solve(mdp), -1 if costs else 1, np.inf if costs else -np.inf
    certificate, chances = certify(mdp), evaluate(mdp, "random")
    assert solution.q.shape == mdp.R.shape == (mdp.n_states, mdp.n_actions)
    pairs = {
        key: pair for pair, key in enumerate(zip(mdp.pair_state, mdp.pair_action, strict=True))
    }
    for s, a in np.ndindex(mdp.n_states, mdp.n_actions):
        row = mdp.P(a).toarray()[s]
        numbers = [solution.gap_table[s, a], chances.occupancy_table[s, a]]
        if (s, a) not in pairs:
            assert solution.q[s, a] == mdp.R[s, a] == never
            assert np.isnan(numbers).all()
            assert not row.any()
            assert not certificate.optimal[s, a]
            continue
        pair = pairs[s, a]
        assert row.tolist() == mdp.transition.toarray()[pair].tolist()
        assert mdp.R[s, a] == mdp.reward[pair]
        assert numbers[1] == chances.occupancy[pair]
        q = mdp.reward[pair] + mdp.discount * row @ solution.value
        assert solution.q[s, a] == pytest.approx(q, rel=1e-9, abs=1e-9)
        assert numbers[0] == pytest.approx(sign * (solution.value[s] - q), rel=1e-6, abs=1e-6)
        assert certificate.optimal[s, a] == certificate.optimal_pairs[pair]
    assert sign * (sign * solution.q).max(axis=1) == pytest.approx(
        solution.value, rel=1e-6, abs=1e-6
    )


@given(models(discounts=HALF))
def test_the_policy_of_all_optimal_actions(drawn: Rows) -> None:
    """It is worth the optimum, exactly, and takes tied actions equally often."""
    mdp = drawn.model()
    certificate = certify(mdp)
    policy = certificate.optimal_policy()
    weights = policy.weights_exact(mdp)
    weights = policy.weights(mdp).astype(np.int64) if weights is None else weights
    live = ~mdp.terminal[mdp.pair_state]
    assert ((weights > 0) == certificate.optimal_pairs)[live].all()
    for state in np.flatnonzero(~mdp.terminal):
        assert len({int(weights[pair]) for pair in mdp.pairs_of(state)} - {0}) == 1
    evaluation = evaluate(mdp, policy)
    assert abs(evaluation.mean - float(certificate.start_value)) <= evaluation.start.error + 1e-9


def test_ties_are_not_shared_where_a_policy_may_never_end() -> None:
    """Staying costs 1: leaving alone is optimal. (Where both are, who only stays never leaves.)"""
    rows = [(0, 0, [(1, 0, -1)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    optimum = certify(MDP.from_outcomes(rows))
    assert optimum.optimal_policy().weights(optimum.mdp).tolist() == [0, 1, 1]
