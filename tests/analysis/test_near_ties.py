"""What `solve` proposes passes `check` without a limit, however near two actions are."""

import numpy as np
import pytest

from exact_mdp import MDP, check, solve


def nearly_tied(kind: str, rng: np.random.Generator) -> MDP:
    """Return a random model in which some actions differ by little more than rounding."""
    states, actions = int(rng.integers(2, 7)), int(rng.integers(2, 4))
    counts = rng.integers(0, 4, (actions, states, states)).astype(float)
    counts[:, np.arange(states), rng.integers(0, states, states)] += 1
    rows = counts / counts.sum(axis=2, keepdims=True)
    rewards = rng.integers(-3, 4, (actions, states)) / rng.choice([1.0, 2.0, 3.0, 10.0])
    if kind == "rewards some units in the last place apart":
        rows[1] = rows[0]
        rewards[1] = rewards[0] * (1 + rng.integers(-4, 5, states) * 2.0**-52)
    elif kind == "probabilities 1e-12 apart":
        rows[1], rewards[1] = rows[0], rewards[0]
        for state in range(states):
            likely = rng.permutation(np.flatnonzero(rows[0, state]))
            if len(likely) > 1:
                rows[1, state, likely[:2]] += 1e-12, -1e-12
        rewards *= 10.0 ** rng.integers(0, 7)
    elif kind == "rows that miss 1":
        rows *= 1 + rng.choice([0.0, 9e-11, 9e-10, -9e-11], (actions, states, 1))
    discount = rng.choice([0.3, 0.5, 0.9, 0.99, 0.999])
    return MDP.from_arrays(rows, rewards.T, discount=discount, layout="ass")


@pytest.mark.parametrize(
    "kind",
    [
        "rewards some units in the last place apart",
        "probabilities 1e-12 apart",
        "rows that miss 1",
    ],
)
def test_the_solvers_policy_passes(kind: str) -> None:
    rng = np.random.default_rng(0)
    for _ in range(60):
        mdp = nearly_tied(kind, rng)
        audit = check(mdp, solve(mdp).policy)
        assert audit.passed, audit


@pytest.mark.parametrize("method", ["value-iteration", "policy-iteration", "linear-program"])
def test_every_method_takes_the_better_of_two_near_actions(method: str) -> None:
    stay = [[0, 0.3, 0.7], [0, 1, 0], [0, 0, 1]]
    more = [[0, 0.3 + 1e-12, 0.7 - 1e-12], [0, 1, 0], [0, 0, 1]]
    for costs, best in ((False, 1), (True, 0)):
        rewards = [[0, 0], [1e6, 1e6], [0, 0]]
        mdp = MDP.from_arrays([stay, more], rewards, discount=0.9, sense="min" if costs else "max")
        solution = solve(mdp, method)
        assert solution.policy[0] == best
        assert check(mdp, solution.policy).passed
