"""The best average reward: all policies are tried, with limits of powers of their chains."""

from itertools import product

import numpy as np
import pytest
from numpy.linalg import matrix_power

from exact_mdp import MDP, LinearProgram, PolicyIteration, ValueIteration, solve
from exact_mdp.solvers.endless.average import solve_average


def limit(chain: np.ndarray) -> np.ndarray:
    """The limit of averages of a chain's powers: those of a lazy one have the same, and a limit."""
    lazy = (chain + np.eye(len(chain))) / 2
    return matrix_power(lazy, 2**14)


def drawn(seed: int, connected: bool) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    rows = rng.dirichlet(np.ones(4), (2, 4))
    if not connected:  # {0, 1} is never left
        rows[:, :2, 2:] = 0
        rows /= rows.sum(axis=2, keepdims=True)
    return rows, rng.normal(size=(4, 2))


METHODS = [PolicyIteration(), ValueIteration(tol=1e-8), LinearProgram()]


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("method", METHODS, ids=lambda each: each.name)
@pytest.mark.parametrize("seed", range(5))
def test_the_best_gain_is_that_of_the_best_policy(seed: int, method: object, sense: str) -> None:
    connected = isinstance(method, ValueIteration) or seed % 2 == 0
    rows, reward = drawn(seed, connected)
    places = np.arange(4)
    gains = np.array([limit(rows[list(policy), places]) @ reward[places, list(policy)]
                      for policy in product(range(2), repeat=4)])  # fmt: skip
    best = gains.max(axis=0) if sense == "max" else gains.min(axis=0)
    found = solve_average(MDP.from_arrays(rows, reward, 1, sense=sense), method)
    assert (np.abs(found.value - best) <= found.state_error + 1e-10).all()
    assert found.error_bound < 1e-7
    own = limit(rows[found.policy, places]) @ reward[places, found.policy]
    assert own == pytest.approx(best, abs=1e-7)


def test_action_values_are_what_a_step_adds_beyond_the_gain() -> None:
    rows, reward = drawn(1, True)
    found = solve(MDP.from_arrays(rows, reward, 1), criterion="average")
    for pair, (s, a) in enumerate(product(range(4), range(2))):
        assert found.q[pair] == pytest.approx(
            reward[s, a] - found.value[s] + rows[a, s] @ found.bias
        )
