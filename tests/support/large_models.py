"""Models of any size: random ones, and a grid with cycles."""

from __future__ import annotations

from fractions import Fraction as F

import numpy as np
import scipy.sparse as sp

from exact_mdp import MDP


def garnet(
    states: int, *, seed: int, discount: object = "9/10", ends: bool = False, actions: int = 3
) -> MDP:
    """A random model; with an end in its last state where `ends`."""
    rng = np.random.default_rng(seed)
    pairs, width = states * actions, 6
    after = np.sort(rng.integers(0, states, (pairs, width)))
    chance = rng.dirichlet(np.ones(width), pairs)
    reward = rng.normal(size=pairs)
    if ends:
        after[:, -1] = states - 1
        last = slice(pairs - actions, pairs)
        after[last], reward[last] = states - 1, 0.0
    rows = sp.csr_array(
        (chance.ravel(), after.ravel(), np.arange(0, pairs * width + 1, width)), (pairs, states)
    )
    rows.sum_duplicates()
    if ends:
        rows.data[rows.indptr[pairs - actions] :] = 1.0
    owner, action = np.repeat(np.arange(states), actions), np.tile(np.arange(actions), states)
    return MDP.from_pairs(owner, action, rows, reward, discount)


def gridworld(width: int) -> MDP:
    """Steps that go astray to either side with probability 1/10, and many ties."""

    def at(row: int, column: int) -> int:
        return min(max(row, 0), width - 1) * width + min(max(column, 0), width - 1)

    rows = []
    for i in range(width):
        for j in range(width):
            for action, (down, right) in enumerate([(0, 1), (1, 0), (0, -1), (-1, 0)]):
                sides = [at(i + right, j + down), at(i - right, j - down)]
                outcomes = [(F(8, 10), at(i + down, j + right), -1)]
                outcomes += [(F(1, 10), side, -1) for side in sides]
                if at(i, j) == width**2 - 1:
                    outcomes = [(F(1), at(i, j), 0)]
                rows.append((at(i, j), action, outcomes))
    return MDP.from_outcomes(rows, F(99, 100))


def sparse(rows: np.ndarray, weight: np.ndarray, reward: np.ndarray, discount: float) -> MDP:
    """The model of `rows` (L, k) of next states and their weights, as many pairs in each state."""
    pairs, states = len(rows), int(rows.max()) + 1
    given = weight.ravel(), rows.ravel(), np.arange(0, rows.size + 1, rows.shape[1])
    transition = sp.csr_array(given, shape=(pairs, states))
    transition.sum_duplicates()
    state, action = np.divmod(np.arange(pairs), pairs // states)
    return MDP.from_pairs(state, action, transition, reward, discount=discount)


def classes(reward: str, discount: float) -> MDP:
    """Ways round a ring, in which some states may be stayed in for ever."""
    rng, states, actions = np.random.default_rng(0), 3000, 3
    pairs = states * actions
    state = np.repeat(np.arange(states), actions)[:, None]
    rows = (state + rng.integers(0, 4, (pairs, 3)) * (rng.random((pairs, 1)) > 0.03)) % states
    weight = rng.dirichlet(np.ones(3), pairs)
    rare = (rng.random(pairs) < 5 / pairs) * 1.0
    return sparse(
        rows, weight, rare if reward == "rare" else rng.integers(-3, 4, pairs) * 1.0, discount
    )
