"""Models that are made: random ones of any size, grids, rings, and the published forest."""

from fractions import Fraction as F
from itertools import product
from typing import Any

import numpy as np
import scipy.sparse as sp

from exact_mdp import MDP, Parametric, Policy, StateSpace, certify, moving


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
        after[last], chance[last], reward[last] = states - 1, np.eye(width)[0], 0.0
    return sparse(after, chance, reward, discount)


def gridworld(width: int) -> MDP:
    """Steps that go astray to either side with probability 1/10, and many ties."""
    return grid(width, width, F(1, 10)).with_(discount="99/100")


def sparse(rows: np.ndarray, weight: np.ndarray, reward: np.ndarray, discount: object) -> MDP:
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


MOVES, STEPS = ["LEFT", "DOWN", "RIGHT", "UP"], [(0, -1), (1, 0), (0, 1), (-1, 0)]


def grid(rows: int, columns: int, astray: F = F(0)) -> MDP:
    """A grid world in which each step costs 1, and which ends in its last cell.

    A step goes to either side with a probability.
    """

    def at(row: int, column: int) -> int:
        return min(max(row, 0), rows - 1) * columns + min(max(column, 0), columns - 1)

    goal, listed = rows * columns - 1, list[Any]()
    for state, action in product(range(goal), range(4)):
        (r, c), (down, right) = divmod(state, columns), STEPS[action]
        ways: list[Any] = [(1 - 2 * astray, at(r + down, c + right), -1)]
        ways += [(astray, at(r + side * right, c + side * down), -1) for side in (1, -1)]
        listed.append((state, action, [way for way in ways if way[0]]))
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


def policy_by(mdp: MDP, columns: Any, rule: Any) -> Policy:
    """The policy that reads some columns alone, by action numbers or probabilities."""
    space = StateSpace(columns=tuple(map(mdp.space.column, columns)))
    return Policy(space=space, actions=mdp.actions, rule=np.asarray(rule))
