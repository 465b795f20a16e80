"""One verb: which solver it takes, and that all of them find what enumeration finds."""

from fractions import Fraction as F

import numpy as np
import pytest
from oracle import policies, policy_values, rows_of

from exact_mdp import MDP, SOLVERS, solve


def acyclic(seed: int, sense: str) -> MDP:
    """Four states; each pair leads to later ones, so that every solver takes it."""
    rng = np.random.default_rng(seed)
    rows = []
    for state in range(3):
        for action in range(1 + int(rng.integers(1, 3))):
            later = rng.permutation(range(state + 1, 4))[:2].tolist()
            each = [(F(1, len(later)), t, F(int(rng.integers(-9, 10)), 3)) for t in later]
            rows.append((state, action, each))
    return MDP.from_outcomes([*rows, (3, 0, [(1, 3, 0)])], "9/10", sense=sense)


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("name", ["auto", *SOLVERS])
def test_every_solver_finds_the_best_of_all_policies(name: str, sense: str) -> None:
    best = max if sense == "max" else min
    for seed in range(5):
        mdp = acyclic(seed, sense)
        values = [policy_values(each, F(9, 10)) for each in policies(rows_of(mdp))]
        optimum = [float(best(x)) for x in zip(*values, strict=True)]
        found = solve(mdp, name)
        assert (np.abs(found.value - optimum) <= found.state_error + 1e-15).all()
        assert found.error_bound < 1e-8
        assert found.method == (name if name != "auto" else "backward-induction")
