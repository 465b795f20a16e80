"""Steps of the textbook: sweeps, evaluations, one pass without cycles, and averages."""

from itertools import product

import numpy as np
import pytest

from exact_mdp import (
    MDP,
    BackwardInduction,
    GaussSeidel,
    ModelError,
    ModifiedPolicyIteration,
    PolicyIteration,
    SolverError,
    ValueIteration,
)
from exact_mdp.solvers.dynamic.methods import AveragePolicyIteration

RNG = np.random.default_rng(4)
ROWS, REWARD = RNG.dirichlet(np.ones(5), (3, 5)), RNG.normal(size=(5, 3))
RING = MDP.from_arrays(ROWS, REWARD, "9/10")


def test_policy_iteration_is_howards() -> None:
    """Every iteration solves the equations of its policy; the next one is greedy for them."""
    policy, seen = RING.with_(discount="0"), []
    values = np.zeros(5)
    while True:
        q = REWARD + 0.9 * np.einsum("ast,t->sa", ROWS, values)
        policy = q.argmax(axis=1)
        if seen and (policy == seen[-1]).all():
            break
        seen.append(policy)
        chain = ROWS[policy, np.arange(5)]
        values = np.linalg.solve(np.eye(5) - 0.9 * chain, REWARD[np.arange(5), policy])
    found = PolicyIteration().solve(RING)
    assert found.value == pytest.approx(values, rel=1e-13)
    assert (found.policy.rule == seen[-1]).all()
    assert found.iterations <= len(seen) + 1


@pytest.mark.parametrize("kind", [ValueIteration, GaussSeidel, ModifiedPolicyIteration])
def test_a_tolerance_is_met_and_a_limit_is_kept(kind: type) -> None:
    exact = PolicyIteration().solve(RING).value
    for tol in (1.0, 1e-4, 1e-10):
        found = kind(tol=tol).solve(RING)
        assert np.abs(found.value - exact).max() <= found.error_bound + 1e-14 <= tol + 1e-14
    with pytest.raises(SolverError) as caught:
        kind(max_iterations=1, tol=1e-9).solve(RING)
    assert caught.value.solution is not None
    assert np.abs(caught.value.solution.value - exact).max() <= caught.value.solution.error_bound


def test_backward_induction_counts_back_from_the_end() -> None:
    rows = [
        (k, a, [("1/2", k + 1, a), ("1/2", k + 2, 3 - 2 * a)]) for k in range(8) for a in (0, 1)
    ]
    rows += [(k, 0, [(1, k, 0)]) for k in (8, 9)]
    mdp = MDP.from_outcomes(rows, "3/4")
    value = [0.0] * 10
    for k in range(7, -1, -1):
        value[k] = max(a / 2 + (3 - 2 * a) / 2 for a in (0, 1)) + 0.375 * (
            value[k + 1] + value[k + 2]
        )
    found = BackwardInduction().solve(mdp)
    assert found.value.tolist() == value
    assert found.policy.rule.tolist()[:8] == [0] * 8
    with pytest.raises(ModelError, match="without cycles"):
        BackwardInduction().solve(RING)


def test_improvement_begins_anywhere_and_ends_at_the_best() -> None:
    rng = np.random.default_rng(2)
    rows = rng.dirichlet(np.ones(4), (2, 4))
    rows[:, :2, 2:] = 0  # {0, 1} is never left
    rows /= rows.sum(axis=2, keepdims=True)
    mdp = MDP.from_arrays(rows, rng.normal(size=(4, 2)), 1)
    best = AveragePolicyIteration().run(mdp)[0].tolist()
    for pairs in product(*(mdp.pairs_of(s) for s in range(4))):
        assert AveragePolicyIteration().run(mdp, np.array(pairs))[0].tolist() == best
