"""Tables by state and action against loops; solvers that begin with what is known."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_models import garnet
from strategies import Rows, models

from exact_mdp import MDP, SOLVERS, ModelError, certify, evaluate, solve

HALF = (Fraction(1, 2), Fraction(9, 10))


@given(models(discounts=HALF), st.booleans())
def test_tables_by_state_and_action(drawn: Rows, costs: bool) -> None:
    mdp = drawn.model().with_(sense="min" if costs else "max")
    found, never = solve(mdp), np.inf if costs else -np.inf
    certificate, visits = certify(mdp), evaluate(mdp, "random").occupancy
    assert found.q.shape == mdp.R.shape == (mdp.n_states, mdp.n_actions)
    offered = {
        (s, a): pair
        for pair, (s, a) in enumerate(
            zip(mdp.pair_state.tolist(), mdp.pair_action.tolist(), strict=True)
        )
    }
    table = evaluate(mdp, "random").occupancy_table
    for s in range(mdp.n_states):
        for a in range(mdp.n_actions):
            pair, row = offered.get((s, a)), mdp.P(a).toarray()[s]
            if pair is None:
                assert found.q[s, a] == mdp.R[s, a] == never
                assert np.isnan([found.gap_table[s, a], table[s, a]]).all()
                assert not row.any()
                assert not certificate.optimal[s, a]
                continue
            assert row.tolist() == mdp.transition.toarray()[pair].tolist()
            assert mdp.R[s, a] == mdp.reward[pair]
            assert table[s, a] == visits[pair]
            q = mdp.reward[pair] + mdp.discount * row @ found.value
            assert found.q[s, a] == pytest.approx(q, rel=1e-9, abs=1e-9)
            lost = found.value[s] - q
            assert found.gap_table[s, a] == pytest.approx(
                -lost if costs else lost, rel=1e-6, abs=1e-6
            )
            assert certificate.optimal[s, a] == certificate.optimal_pairs[pair]
    best = (found.q.min if costs else found.q.max)(axis=1)
    assert best == pytest.approx(found.value, rel=1e-6, abs=1e-6)


@given(models(discounts=HALF))
def test_the_policy_of_all_optimal_actions(drawn: Rows) -> None:
    """It is worth the optimum, exactly, and takes tied actions equally often."""
    mdp = drawn.model()
    certificate = certify(mdp)
    policy = certificate.optimal_policy()
    weights = policy.weights_exact(mdp)
    weights = policy.weights(mdp).astype(np.int64) if weights is None else weights
    ended = mdp.terminal[mdp.pair_state]
    assert ((weights > 0) == certificate.optimal_pairs)[~ended].all()
    for state in np.flatnonzero(~mdp.terminal):
        pairs = mdp.pairs_of(state)
        shares = {int(w) for w in weights[pairs.start : pairs.stop] if w}
        assert len(shares) == 1
    found = evaluate(mdp, policy)
    assert abs(found.mean - float(certificate.start_value)) <= found.start.error + 1e-9


def test_ties_are_not_shared_where_a_policy_may_never_end() -> None:
    """Staying and leaving are both worth 1; who only stays never gets it."""
    rows = [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    found = certify(MDP.from_outcomes(rows))
    assert found.start_value == 1
    with pytest.raises(ModelError, match="drawn among"):
        found.optimal_policy()
    alone = certify(MDP.from_outcomes([*rows[1:], (0, 0, [(1, 0, -1)])]))
    assert alone.optimal_policy().weights(alone.mdp).tolist() == [0, 1, 1]


MODEL = garnet(120, seed=1, discount="0.99")
STARTED = [name for name, kind in SOLVERS.items() if hasattr(kind, "start")]


@pytest.mark.parametrize("name", STARTED)
@pytest.mark.parametrize("costs", [False, True])
def test_what_is_known_saves_work_and_changes_no_answer(name: str, costs: bool) -> None:
    mdp = MODEL.with_(sense="min") if costs else MODEL
    cold = solve(mdp, name)
    noise = np.random.default_rng(0).normal(size=mdp.n_states)
    starts: dict[str, Any] = {
        "solution": cold,
        "values": np.array(cold.value),
        "policy": cold.policy,
        "far": 1e3 * noise,
        "random": np.zeros(mdp.n_states, dtype=np.int64),
    }
    for what, start in starts.items():
        found = solve(mdp, name, start=start)
        assert np.abs(found.value - cold.value).max() <= found.error_bound + cold.error_bound
        assert found.error_bound < 1e-6
        if what in ("solution", "values", "policy"):
            assert found.iterations <= max(3, cold.iterations // 2), what


def test_a_start_that_does_not_fit() -> None:
    acyclic = MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0])
    assert solve(acyclic, start=[0, 0]).value.tolist() == [1, 0]
    for model, solver, start, message in (
        (acyclic, "backward-induction", [0, 0], "takes no start"),
        (MODEL, "value-iteration", np.zeros(3), "values of shape"),
        (MODEL, "value-iteration", np.full(120, np.inf), "not finite"),
        (MODEL, "value-iteration", [np.nan] * 120, "not finite"),
        (MODEL, "policy-iteration", [np.inf] * 120, "not finite"),
        (MODEL, "linear-program", np.zeros(120), "takes no start"),
        (MODEL, "policy-iteration", np.zeros(3), "values of shape"),
        (MODEL, "policy-iteration", np.full(120, 9), "there is no action 9"),
        (MODEL, "policy-iteration", [[1, 2], [3]], "does not hold real numbers"),
        (MODEL, "policy-iteration", "random", "mixed"),
        (MODEL, "policy-iteration", [9] * 120, "there is no action 9"),
    ):
        with pytest.raises(ModelError, match=message):
            solve(model, solver, start=start)
