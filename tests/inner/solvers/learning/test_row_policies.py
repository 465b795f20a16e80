"""Start values of learned policies, each beside its own value in fractions."""

from fractions import Fraction as F

import numpy as np
import oracle
import pytest
from small_models import small_model

from exact_mdp import MDP
from exact_mdp.solvers.learning import row_policies as module
from exact_mdp.solvers.learning.row_policies import evaluate_row_policies
from exact_mdp.solvers.learning.sampler import build_q_table_rows
from exact_mdp.solvers.values.layers import Layers

DISCOUNTS = [F(0), F(2, 3), F(1)]


def ends_of(mdp: MDP) -> set[int]:
    return set(np.flatnonzero(mdp.terminal).tolist())


@pytest.mark.parametrize("discount", DISCOUNTS)
@pytest.mark.parametrize("numbers", [2**22, 1])
def test_start_values_are_bounded(
    discount: F, numbers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one table or in several, and one by one where states lead back to each other."""
    monkeypatch.setattr(module, "BLOCK", numbers)
    for seed in range(5):
        mdp = small_model(seed, discount, falling=seed % 4 > 0)
        rows = build_q_table_rows(mdp)
        names = [mdp.pair_action[mdp.pairs_of(s)] for s in range(mdp.n_states)]
        rng = np.random.default_rng(seed)
        policies = np.array([[rng.choice(each) for each in names] for _ in range(5)])
        point = evaluate_row_policies(mdp, rows, policies)
        for policy, value, error in zip(policies, point.value, point.error, strict=True):
            pairs = [mdp.pair(s, int(a)) for s, a in enumerate(policy)]
            exact = oracle.policy_values(oracle.rows_of(mdp, pairs), discount, ends_of(mdp))
            start = sum((p * exact[s] for s, p in mdp.start), F(0))
            assert abs(F(float(value)) - start) <= F(float(error))
            size = [(s, a, abs(r), row) for s, a, r, row in oracle.rows_of(mdp, pairs)]
            most = oracle.policy_values(size, discount, ends_of(mdp))
            whole = float(sum((p * most[s] for s, p in mdp.start), F(0)))
            if seed % 4:
                # Each step rounds products, sums and a few numbers; then the start adds up all.
                longest = int(np.diff(mdp.transition.indptr).max())
                steps = len(Layers(mdp).blocks) * (longest + 6) + mdp.n_states
                assert steps * 2.0**-53 * whole <= error <= (steps + 8) * 2.0**-53 * whole + 1e-290


def test_errors_cover_roundings_of_long_ways() -> None:
    """Rewards that nearly cancel along a hundred steps with three outcomes each."""
    rng, rows = np.random.default_rng(7), []
    for s in range(100):
        p = rng.integers(1, 99, size=3).tolist()
        following = [s + 1, s + 2, s + 3]
        each = [
            (F(w, sum(p)), min(t, 100), F(float(rng.normal() * 1e6)))
            for w, t in zip(p, following, strict=True)
        ]
        rows.append((s, 0, each))
    rows.append((100, 0, [(F(1), 100, F(0))]))
    mdp = MDP.from_outcomes(rows)
    point = evaluate_row_policies(mdp, build_q_table_rows(mdp), np.zeros((1, 101), dtype=np.int64))
    exact = oracle.policy_values(oracle.rows_of(mdp), F(1), {100})[0]
    assert abs(F(float(point.value[0])) - exact) <= F(float(point.error[0]))


def test_rewards_at_the_end_of_the_range_of_floats() -> None:
    for reward in (F(0), F(1, 3 * 10**320)):
        rows = [(0, 0, [(F(1, 3), 1, reward), (F(2, 3), 2, reward)]), (1, 0, [(1, 2, reward)])]
        mdp = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])])
        point = evaluate_row_policies(
            mdp, build_q_table_rows(mdp), np.zeros((1, 3), dtype=np.int64)
        )
        exact = reward * F(4, 3)
        assert abs(F(float(point.value[0])) - exact) <= F(float(point.error[0])) <= F(1, 2**900)
