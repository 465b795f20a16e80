"""Models to be timed, as plain arrays that every solver can be given.

A workload is pairs of state and action with sparse rows, expected rewards and a discount. Pairs are
sorted by state; the next states of a row stand in the order in which a user would have made them:
drawn ones in none, those of SciPy's coordinates in rising order. The project is imported for the
care model, and for `model()`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

if TYPE_CHECKING:
    from exact_mdp import MDP


@dataclass(frozen=True, kw_only=True, eq=False)
class Workload:
    """A model as arrays: L pairs, S states."""

    name: str
    size: int
    discount: float
    state: NDArray[np.int64]
    action: NDArray[np.int64]
    transition: csr_array
    reward: NDArray[np.float64]

    @property
    def states(self) -> int:
        return int(self.transition.shape[1])

    @property
    def first(self) -> NDArray[np.int64]:
        """(S,) the first pair of each state."""
        return np.searchsorted(self.state, np.arange(self.states))

    @property
    def bytes(self) -> int:
        """Size of the arrays that a sweep has to read: probabilities, columns, rewards."""
        matrix = self.transition
        return (
            matrix.data.nbytes + matrix.indices.nbytes + matrix.indptr.nbytes + self.reward.nbytes
        )

    def fresh(self) -> csr_array:
        """The same rows in a matrix that nobody has asked yet whether they are sorted."""
        matrix = self.transition
        return csr_array((matrix.data, matrix.indices, matrix.indptr), shape=matrix.shape)

    def model(self, transition: csr_array | None = None) -> MDP:
        from exact_mdp import MDP

        rows = self.fresh() if transition is None else transition
        return MDP.from_pairs(self.state, self.action, rows, self.reward, discount=self.discount)


def _workload(
    name: str, size: int, discount: float, state, action, transition: csr_array, reward
) -> Workload:
    transition.eliminate_zeros()
    if transition.nnz < 2**31 - 1:  # as SciPy does by itself where it can
        transition.indices = transition.indices.astype(np.int32)
        transition.indptr = transition.indptr.astype(np.int32)
    return Workload(
        name=name,
        size=size,
        discount=discount,
        state=np.asarray(state, dtype=np.int64),
        action=np.asarray(action, dtype=np.int64),
        transition=transition,
        reward=np.asarray(reward, dtype=np.float64),
    )


def drawn(pairs: int, states: int, successors: int, rng: np.random.Generator) -> NDArray[np.int32]:
    """(pairs, successors) different states for each pair, in no order."""
    if successors**2 > states:
        return np.argsort(rng.random((pairs, states)), axis=1)[:, :successors].astype(np.int32)
    columns = rng.integers(states, size=(pairs, successors), dtype=np.int32)
    again = np.arange(pairs)
    while len(again):
        ordered = np.sort(columns[again], axis=1)
        again = again[(ordered[:, 1:] == ordered[:, :-1]).any(axis=1)]
        columns[again] = rng.integers(states, size=(len(again), successors), dtype=np.int32)
    return columns


def shares(pairs: int, successors: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(pairs, successors) probabilities: the parts of [0, 1] between random cuts."""
    cuts = np.sort(rng.random((pairs, successors - 1)), axis=1)
    return np.diff(cuts, axis=1, prepend=0.0, append=1.0)


def garnet(
    states: int, discount: float, seed: int = 1, *, actions: int = 4, successors: int = 10
) -> Workload:
    """Random successors with random weights (Archibald, McKinnon and Thomas, 1995)."""
    rng, pairs = np.random.default_rng(seed), states * actions
    weights, columns = shares(pairs, successors, rng), drawn(pairs, states, successors, rng)
    rows = np.arange(0, pairs * successors + 1, successors)
    matrix = csr_array((weights.ravel(), columns.ravel(), rows), shape=(pairs, states))
    state, action = np.divmod(np.arange(pairs), actions)
    return _workload(
        f"garnet γ={discount}", states, discount, state, action, matrix, rng.random(pairs)
    )


def dense(states: int, discount: float = 0.95, seed: int = 2, *, actions: int = 10) -> Workload:
    """Every state can follow every pair."""
    rng, pairs = np.random.default_rng(seed), states * actions
    matrix = csr_array(rng.dirichlet(np.ones(states), pairs))
    state, action = np.divmod(np.arange(pairs), actions)
    return _workload("dense rows", states, discount, state, action, matrix, rng.random(pairs))


def clusters(
    states: int, discount: float = 0.9999, seed: int = 3, *, size: int = 100, leave: float = 1e-4
) -> Workload:
    """Random clusters of states, left for anywhere with a small probability."""
    rng, actions, successors = np.random.default_rng(seed), 3, 8
    pairs = states * actions
    near = drawn(pairs, size, successors, rng)
    state, action = np.divmod(np.arange(pairs), actions)
    columns = np.hstack([near + (state // size * size)[:, None], drawn(pairs, states, 1, rng)])
    weights = np.hstack([(1 - leave) * shares(pairs, successors, rng), np.full((pairs, 1), leave)])
    rows = np.repeat(np.arange(pairs), successors + 1)
    matrix = csr_array((weights.ravel(), (rows, columns.ravel())), shape=(pairs, states))
    return _workload(
        "nearly decomposable", states, discount, state, action, matrix, rng.random(pairs)
    )


def queue(states: int, discount: float = 0.9999) -> Workload:
    """A queue with five service rates: the faster, the dearer; slow to mix."""
    rates = np.array([0.1, 0.3, 0.5, 0.55, 0.6])
    arrival = 0.5
    state = np.repeat(np.arange(states), len(rates))
    action = np.tile(np.arange(len(rates)), states)
    served = np.where(state > 0, rates[action], 0.0)
    up = np.where(state < states - 1, arrival * (1 - served), 0.0)
    down = (1 - arrival) * served
    stay = 1 - up - down
    rows = np.concatenate([np.arange(len(state))] * 3)
    columns = np.concatenate([np.minimum(state + 1, states - 1), np.maximum(state - 1, 0), state])
    matrix = csr_array((np.concatenate([up, down, stay]), (rows, columns)))
    reward = -(state / states) - 0.5 * rates[action] ** 2
    return _workload(f"queue γ={discount}", states, discount, state, action, matrix, reward)


def grid(side: int, discount: float = 0.9999) -> Workload:
    """A square grid, four directions, a slip to either side with 0.1; a corner ends it."""
    place = np.arange(side * side)
    row, column = np.divmod(place, side)
    moves = np.array([(-1, 0), (0, 1), (1, 0), (0, -1)])
    goal = side * side - 1

    def reached(direction: int):
        after = np.clip(row + moves[direction, 0], 0, side - 1) * side + np.clip(
            column + moves[direction, 1], 0, side - 1
        )
        return np.where(place == goal, goal, after)

    parts = []
    for direction in range(4):
        pair = place * 4 + direction
        for turn, chance in ((0, 0.8), (1, 0.1), (3, 0.1)):
            parts.append((pair, reached((direction + turn) % 4), np.full(len(place), chance)))
    rows, columns, chances = (np.concatenate(each) for each in zip(*parts, strict=True))
    matrix = csr_array((chances, (rows, columns)), shape=(side * side * 4, side * side))
    reward = np.repeat(np.where(place == goal, 0.0, -1.0), 4)
    state, action = np.divmod(np.arange(side * side * 4), 4)
    return _workload(f"grid γ={discount}", side, discount, state, action, matrix, reward)


def inventory(capacity: int, discount: float = 0.9999, most: int = 20) -> Workload:
    """Order up to a capacity, uniform demand below `most`; fixed and unit costs, lost sales."""
    level, order = np.meshgrid(np.arange(capacity + 1), np.arange(most), indexing="ij")
    fits = level + order <= capacity
    state, action = level[fits], order[fits]
    demand = np.arange(most)
    stock = (state + action)[:, None]
    after = np.maximum(stock - demand, 0)
    sold = np.minimum(stock, demand).mean(axis=1)
    reward = (4 * sold - 2 * action - 3.0 * (action > 0) - 0.02 * stock[:, 0]) / 100
    rows = np.repeat(np.arange(len(state)), most)
    chances = np.full(len(rows), 1 / most)
    matrix = csr_array((chances, (rows, after.ravel())), shape=(len(state), capacity + 1))
    return _workload("inventory γ=0.9999", capacity, discount, state, action, matrix, reward)


def layered(subtasks: int, discount: float = 0.99) -> Workload:
    """The care model with one task of so many subtasks: 16 statuses, 5 trials."""
    from exact_mdp import Scenario

    scenario = Scenario.load("yuan2025").with_(tasks=[subtasks], discount=str(discount))
    mdp = scenario.compile()
    name = f"layered γ={discount:g}"
    return _workload(
        name,
        subtasks,
        discount,
        mdp.pair_state,
        mdp.pair_action,
        csr_array(mdp.transition).copy(),
        mdp.reward,
    )


FULL: dict[str, list[Callable[[], Workload]]] = {
    "garnet γ=0.95": [lambda n=n: garnet(n, 0.95) for n in (50, 10**3, 10**4, 10**5, 10**6)],
    "garnet γ=0.99": [lambda n=n: garnet(n, 0.99) for n in (10**3, 10**4, 10**5, 10**6)],
    "garnet, other shapes": [
        lambda n=n, k=k: garnet(n, 0.97, seed=100 + n, actions=2 + k, successors=4 * k + 1)
        for n, k in ((80, 4), (700, 1), (3_000, 6), (30_000, 2))
    ],
    "dense rows": [lambda n=n: dense(n) for n in (200, 600)],
    "layered γ=0.99": [lambda n=n: layered(n) for n in (10, 100, 1000, 10_000)],
    "layered γ=1": [lambda n=n: layered(n, 1) for n in (10, 100, 1000, 10_000)],
    "queue γ=0.9999": [lambda n=n: queue(n) for n in (100, 1000, 10_000)],
    "grid γ=0.999": [lambda n=n: grid(n, 0.999) for n in (7, 20, 60)],
    "grid γ=0.9999": [lambda n=n: grid(n) for n in (30, 60, 100, 300)],
    "inventory γ=0.9999": [lambda n=n: inventory(n) for n in (100, 1000, 10_000)],
    "nearly decomposable": [lambda n=n: clusters(n) for n in (300, 3_600)],
}
QUICK = {name: sizes[:2] for name, sizes in FULL.items()}
