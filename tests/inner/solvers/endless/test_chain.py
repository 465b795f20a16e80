"""Gain, bias and shares of time of chains, against their limits and NumPy's solutions."""

from fractions import Fraction as F

import numpy as np
import pytest
from numpy.linalg import matrix_power

from exact_mdp import MDP
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.solvers.endless.chain import ExactChain, FloatChain, compute_laurent_expansion


def two_classes(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Classes {0, 1} and {2, 3, 4}; states 5 and 6 lead to both."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((7, 7))
    rows[:2, :2], rows[2:5, 2:5] = rng.dirichlet([1, 1], 2), rng.dirichlet([1, 1, 1], 3)
    rows[5:] = rng.dirichlet(np.ones(7), 2)
    return rows, rng.normal(size=7)


@pytest.mark.parametrize("seed", range(10))
def test_gain_bias_and_w_solve_their_equations(seed: int) -> None:
    """They are unique, as the bias and w have the long-run average 0 (Puterman 8.2.6)."""
    rows, reward = two_classes(seed)
    limit = matrix_power(rows, 5000)
    deviation = np.linalg.inv(np.eye(7) - rows + limit) - limit
    mdp = MDP.from_arrays(rows[None], reward[:, None], 1)
    chain = FloatChain(mdp, np.arange(7))
    gain, bias, w = compute_laurent_expansion(chain, mdp.reward)
    assert gain == pytest.approx(limit @ reward)
    assert bias == pytest.approx(deviation @ reward, abs=1e-9)
    assert w == pytest.approx(-deviation @ deviation @ reward, abs=1e-9)
    (found, bounded) = chain.evaluate_chain()
    assert (np.abs(found.value - limit @ reward) <= found.error + 1e-10).all()
    assert (np.abs(bounded.value - deviation @ reward) <= bounded.error + 1e-10).all()
    assert max(found.error.max(), bounded.error.max()) < 1e-8


@pytest.mark.parametrize("seed", range(10))
def test_shares_of_time_from_a_start(seed: int) -> None:
    rows, reward = two_classes(seed)
    mdp = MDP.from_arrays(rows[None], reward[:, None], 1, start={5: "1/4", 1: "3/4"})
    share, _ = FloatChain(mdp, np.arange(7)).compute_limit_distribution()
    wanted = mdp.start_distribution @ matrix_power(rows, 5000)
    assert (np.abs(share.value - wanted) <= share.error + 1e-10).all()
    assert share.error.max() < 1e-10


def test_exact_chains_solve_the_same_equations() -> None:
    """0 and 1 take turns, so that only averages have a limit; 2 leads to them, or to 3."""
    rows = [[0, 1, 0, 0], [1, 0, 0, 0], ["1/4", "1/2", 0, "1/4"], [0, 0, 0, 1]]
    mdp = MDP.from_arrays([rows], [[3], [0], [7], ["1/2"]], 1)
    chain = ExactChain(bellman_rows(mdp))
    gain, bias, w = (each.tolist() for each in compute_laurent_expansion(chain, chain.reward))
    assert gain == [F(3, 2), F(3, 2), F(5, 4), F(1, 2)]
    assert bias == [F(3, 4), F(-3, 4), 7 - F(5, 4) + F(3, 16) - F(3, 8), 0]
    ahead = [w[1], w[0], w[0] / 4 + w[1] / 2 + w[3] / 4, w[3]]
    assert [x - y for x, y in zip(w, ahead, strict=True)] == [-x for x in bias]
    assert (w[0] + w[1], w[3]) == (0, 0)
    share, _ = chain.compute_limit_distribution([(2, F(1))])
    assert share.tolist() == [F(3, 8), F(3, 8), 0, F(1, 4)]
