"""A pass held to loops over pairs and to optimal values; values that a user's solver improves."""

from dataclasses import dataclass
from time import perf_counter
from typing import ClassVar

import numpy as np
import pytest
import scipy.sparse as sp
from cases import BY_NAME
from strategies import of_case

from exact_mdp import MDP, PolicyIteration, SolverError, Status, solve
from exact_mdp.solvers.dynamic import values as module
from exact_mdp.solvers.dynamic.methods import Improving
from exact_mdp.solvers.dynamic.values import BellmanPass
from exact_mdp.solvers.kernels import bellman
from exact_mdp.solvers.solution import Solution


@dataclass(frozen=True, kw_only=True)
class OneByOne(Improving):
    """A solver of a user's own, which improves states one by one and tells nobody."""

    name: ClassVar[str] = "one-by-one"

    def maximise(self, model: MDP) -> Solution:
        started = perf_counter()
        values, stopping = self.begin(model)
        pairs = bellman.build_compiled_model(model, model.reward, values.weights.margin)
        for _ in range(self.max_iterations):
            values.pass_over_pairs()
            if stopping.is_reached():
                break
            values.apply_backup()
            bellman.relax_states(np.arange(model.n_states), pairs, values.value, values.level)
        return stopping.conclude(self, started)


@pytest.mark.parametrize("name", ["howard-taxicab", "forest-10-24/25", "puterman-two-state-9/10"])
def test_the_loop_sees_that_states_were_improved_one_by_one(name: str) -> None:
    """Were the values shifted to the middle of the bounds, this would bring back old errors."""
    solution = solve(of_case(BY_NAME[name]), OneByOne(max_iterations=200))
    assert solution.status is Status.CONVERGED
    assert solution.method == "one-by-one"


def random_model(seed: int, discount: float = 0.9, ends: int = 0) -> MDP:
    """Return a model of 12 states with 1 to 3 actions, the last `ends` of which are terminal."""
    rng = np.random.default_rng(seed)
    actions = rng.integers(1, 4, 12)
    state = np.repeat(np.arange(12), actions)
    action = np.concatenate([np.arange(n) for n in actions])
    rows = rng.dirichlet(np.ones(12), len(state)) * (rng.random((len(state), 12)) < 0.5)
    rows[np.arange(len(state)), rng.integers(0, 12, len(state))] += 0.1
    reward = rng.normal(size=len(state))
    for end in range(12 - ends, 12):
        rows[state == end] = np.eye(12)[end]
        reward[state == end] = 0.0
    rows /= rows.sum(axis=1, keepdims=True)
    return MDP.from_pairs(state, action, sp.csr_array(rows), reward, discount=discount)


def advantages(mdp: MDP, value: np.ndarray) -> np.ndarray:
    """Return d(l) = r(l) + γ P_l h - h(s) of all pairs, one after the other."""
    dense = mdp.transition.toarray()
    return np.array([
        mdp.reward[pair] + mdp.discount * dense[pair] @ value - value[mdp.pair_state[pair]]
        for pair in range(mdp.n_pairs)
    ])  # fmt: skip


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("ends", [0, 2])
def test_residual_policy_and_bounds_are_those_of_loops(
    compiled: bool, ends: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    if compiled:
        monkeypatch.setattr(module, "COMPILED", 0)
    for seed in range(15):
        mdp = random_model(seed, ends=ends)
        rng = np.random.default_rng(seed)
        search = BellmanPass(mdp)
        assert search.is_large is compiled
        optimum = PolicyIteration().solve(mdp).value
        for _ in range(3):  # later passes leave out pairs that are beaten
            value = np.where(mdp.terminal, 0.0, optimum + rng.normal(size=12))
            search.run(value, float(value.min()), float(value.max()))
            each = advantages(mdp, value)
            for state in np.flatnonzero(~mdp.terminal):
                own = each[mdp.pairs_of(state)]
                assert search.residual[state] == pytest.approx(own.max(), abs=1e-12)
                assert each[search.pairs[state]] == pytest.approx(own.max(), abs=1e-12)
            live = ~mdp.terminal[mdp.pair_state]
            margin = np.broadcast_to(search.weights.margin, mdp.n_pairs)
            ratio = each / margin
            taken = search.pairs[~mdp.terminal]
            assert search.low <= ratio[taken].min() + 1e-9
            assert search.high == pytest.approx(ratio[live].max(), abs=1e-9)
            weight = search.weights.value
            assert (value + search.low * weight <= optimum + 1e-9).all()
            assert (optimum <= value + search.high * weight + 1e-9).all()
            assert search.half_gap == (search.high - search.low) / 2
            assert 0 <= search.bound_rounding() < 1e-11


def test_a_policy_stays_unless_a_pair_is_better() -> None:
    mdp = MDP.from_arrays([[[1, 0], [0, 1]]] * 2, [[1, 1], [0, 0]], discount="1/2", layout="ass")
    search, zero = BellmanPass(mdp), np.zeros(2)
    search.run(zero, 0.0, 0.0)
    assert (search.pairs.tolist(), search.policy_stays) == ([0, 2], False)
    search.pairs = np.array([1, 3])
    search.run(zero, 0.0, 0.0)
    assert (search.pairs.tolist(), search.policy_stays) == ([1, 3], True)


def test_values_beyond_the_floats_are_refused() -> None:
    mdp = MDP.from_arrays([[[0.5, 0.5], [0.5, 0.5]]], [1e308, -1e308], discount=0.999)
    search = BellmanPass(mdp)
    with (
        np.errstate(over="ignore", invalid="ignore"),
        pytest.raises(SolverError, match="beyond the range"),
    ):
        search.run(np.array([1e308, -1e308]), -1e308, 1e308)
