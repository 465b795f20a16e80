"""The program of an optimum, against scipy's HiGHS on a matrix that is made here."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import linprog

from exact_mdp import MDP, LinearProgram
from exact_mdp.solvers.dynamic.linear_program import least_above, own_states


@pytest.mark.parametrize("solver", ["CLARABEL", "HIGHS"])
@pytest.mark.parametrize("seed", range(4))
def test_the_values_are_the_least_above_their_own_backup(seed: int, solver: str) -> None:
    rng = np.random.default_rng(seed)
    rows, reward = rng.dirichlet(np.ones(4), (3, 4)), rng.normal(size=(4, 3))
    above = np.concatenate([np.eye(4) - 0.8 * rows[a] for a in range(3)])
    wanted = linprog(np.ones(4), -above, -reward.T.ravel(), bounds=(None, None))
    found = LinearProgram(solver=solver).solve(MDP.from_arrays(rows, reward, "4/5"))
    assert found.value == pytest.approx(wanted.x, abs=1e-8)
    assert found.method == "linear-program"
    x, steps = least_above(np.ones(4), sp.csr_array(above), reward.T.ravel(), solver)
    assert x == pytest.approx(wanted.x, abs=1e-5)
    assert steps > 0


def test_each_pair_belongs_to_its_state() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 0)]), (0, 1, [(1, 0, 0)]), (1, 0, [(1, 1, 0)])], "1/2")
    assert own_states(mdp).toarray().tolist() == [[1, 0], [1, 0], [0, 1]]
