"""The evaluation step, held to the linear equations of a policy."""

import numpy as np
import pytest
import scipy.sparse as sp

from exact_mdp import MDP
from exact_mdp.solvers.dynamic import evaluation
from exact_mdp.solvers.dynamic import values as module
from exact_mdp.solvers.dynamic.evaluation import PolicyEvaluation
from exact_mdp.solvers.dynamic.values import Values


def begin(seed: int, discount: float = 0.95, size: int = 30) -> Values:
    """Return values after a first pass over a random model of two actions."""
    rng = np.random.default_rng(seed)
    rows = sp.csr_array(rng.dirichlet(np.full(size, 0.2), 2 * size))
    state, action = np.repeat(np.arange(size), 2), np.tile([0, 1], size)
    mdp = MDP.from_pairs(state, action, rows, rng.random(2 * size), discount=discount)
    values = Values(mdp, rng.random(size))
    values.pass_over_pairs()
    return values


def policy_values(values: Values, pairs: np.ndarray) -> np.ndarray:
    """Return the values of the policy that takes some pairs, by NumPy."""
    mdp = values.mdp
    matrix = np.eye(mdp.n_states) - mdp.discount * mdp.transition[pairs].toarray()
    return np.linalg.solve(matrix, mdp.reward[pairs])


def differences(value: np.ndarray) -> np.ndarray:
    """Return values up to the constant that all of them share."""
    return value - value.mean()


@pytest.mark.parametrize("large", [False, True])
def test_a_goal_of_zero_gives_the_values_of_the_policy(
    large: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if large:
        monkeypatch.setattr(module, "COMPILED", 0)
    for seed in range(10):
        values = begin(seed)
        pairs = values.search.pairs.copy()
        PolicyEvaluation(values).run(0.0)
        wanted = differences(policy_values(values, pairs))
        np.testing.assert_allclose(differences(values.value), wanted, atol=1e-11)


@pytest.mark.parametrize("cached", [10**9, 0])
def test_sweeps_reach_the_goal(cached: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "COMPILED", 0)
    monkeypatch.setattr(evaluation, "CACHED", cached)
    for goal in (1e-1, 1e-4, 1e-8):
        values = begin(3)
        pairs = values.search.pairs.copy()
        step = PolicyEvaluation(values)
        step.run(goal)
        assert not step.mixes_slowly
        # In units of w = 1 the error is at most the residual over 1 - γ.
        error = differences(values.value) - differences(policy_values(values, pairs))
        assert np.ptp(error) <= 2 * goal


def test_chains_that_mix_slowly_are_relaxed_until_their_equations_are_due(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "COMPILED", 0)
    monkeypatch.setattr(evaluation, "sweep_system", lambda *given: (given[3], False))
    values = begin(5)
    step, called = PolicyEvaluation(values), list[str]()
    for name in ("solve_policy_equations", "apply_backup", "sweep_states"):
        inner = getattr(values, name)
        monkeypatch.setattr(
            values, name, lambda n=name, f=inner, **more: called.append(n) or f(**more)
        )
    transitions = values.mdp.n_transitions
    values.search.policy_stays = False
    step.run(1e-3)
    assert step.mixes_slowly
    assert called == ["apply_backup", "sweep_states"]
    assert step._work() == transitions * (2 + 4)
    step.price = transitions * 8
    values.passes += 1  # 2 more a pass: now the work is as large as the price
    step.run(1e-3)
    assert called[2:] == ["solve_policy_equations"]
    assert step._work() == 0
    values.search.policy_stays, values.idle, values.passes = True, 1, values.passes + 1
    step.run(1e-3)  # a policy that stays without progress is solved for at once
    assert called[3:] == ["solve_policy_equations"]
    values.search.policy_stays, values.idle = False, evaluation.PATIENCE
    step.run(0.0)
    assert called[4:] == ["solve_policy_equations", "sweep_states"]
