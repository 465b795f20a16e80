"""Models that are made: random ones of any size, grids, rings, and the published forest."""

from fractions import Fraction as F
from typing import Any

import numpy as np
import scipy.sparse as sp

from exact_mdp import MDP, Parametric, certify, moving


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


def in_copies(mdp: MDP, copies: int) -> tuple[MDP, np.ndarray[Any, Any]]:
    """Copies of all states, numbered by chance, and the exact values that they have."""
    floats = (mdp.pair_state, mdp.pair_action, mdp.transition, mdp.reward)
    value = certify(one := MDP.from_pairs(*floats, mdp.discount_exact)).value
    if copies == 1:
        return one, value
    order = np.random.default_rng(copies).permutation(mdp.n_states * copies)
    state = np.argsort(order).reshape(copies, -1)[:, mdp.pair_state].ravel()
    pairs = np.argsort(state, kind="stable")
    rows = sp.csr_array(sp.kron(sp.eye_array(copies), mdp.transition))[pairs][:, order]
    action, reward = np.tile(mdp.pair_action, copies), np.tile(mdp.reward, copies)
    many = MDP.from_pairs(state[pairs], action[pairs], rows, reward[pairs], mdp.discount_exact)
    return many, value[order % mdp.n_states]


def forest(discount: str) -> MDP:
    wait, cut = [["1/10", "9/10", 0], ["1/10", 0, "9/10"], ["1/10", 0, "9/10"]], [[1, 0, 0]] * 3
    return MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], discount)


def burning(discount: str) -> Parametric:
    """Return the forest with the chance of fire as one number in three rows."""
    mdp = forest(discount)
    return moving(mdp, {"fire": [(mdp.pair(state, 0), 0) for state in range(3)]})


def wager(*chances: str, gain: object = 1) -> Parametric:
    """Return one step in which action a pays with the a-th chance; the first two are p and q."""
    rows = [(0, a, [(F(p), 1, gain), (1 - F(p), 2, 0)]) for a, p in enumerate(chances)]
    ends = [(s, 0, [(1, s, 0)]) for s in (1, 2)]
    return moving(MDP.from_outcomes([*rows, *ends]), {"p": [(0, 1)], "q": [(1, 1)]})


MOVES = ["LEFT", "DOWN", "RIGHT", "UP"]


def grid(rows: int, columns: int) -> MDP:
    """A grid world in which each step costs 1, and which ends in its last cell."""
    goal, listed = rows * columns - 1, []
    for state in range(goal):
        r, c = divmod(state, columns)
        for action, (down, right) in enumerate([(0, -1), (1, 0), (0, 1), (-1, 0)]):
            to = min(max(r + down, 0), rows - 1), min(max(c + right, 0), columns - 1)
            listed.append((state, action, [(1, to[0] * columns + to[1], -1)]))
    listed.append((goal, 0, [(1, goal, 0)]))
    return MDP.from_outcomes(listed, discount="9/10", actions=MOVES)


def corridor(names: list[str]) -> MDP:
    """States in a row; `names[0]` earns 1 and moves on, `names[1]` stays put and earns nothing."""
    last = len(names) - 1
    rows = [(s, 0, [(1, s + 1, 1)]) for s in range(last)] + [(last, 0, [(1, last, 0)])]
    rows += [(s, 1, [(1, s, 0)]) for s in range(last)]
    return MDP.from_outcomes(sorted(rows), discount="1/2", states=names, actions=names[:2])


def under(mdp: MDP, policy: Any) -> MDP:
    """Return the model that offers one action (S,) in each state: those of a policy."""
    wanted = np.flatnonzero(mdp.pair_action == np.asarray(policy)[mdp.pair_state])
    return mdp.with_(
        table=mdp.table.of_pairs(wanted),
        pair_state=mdp.pair_state[wanted],
        pair_action=mdp.pair_action[wanted],
    )
