"""Compiled sweeps: against plain Python, NumPy and rational arithmetic; threads change nothing."""

import subprocess
import sys
from fractions import Fraction as F
from itertools import pairwise

import numpy as np
import pytest
import scipy.sparse as sp
from kernel_twins import gains_of, relaxed
from strategies import exact_gains, exact_values

import solvers.bounds as module
import solvers.kernels.blocks as blocks
from mdp import MDP
from solvers import ModifiedPolicyIteration, PolicyIteration, SolverError, ValueIteration, solve
from solvers.bounds import levels, margin_weights
from solvers.gains import COMPILED, gains
from solvers.kernels import bellman, krylov
from solvers.linear import LinearSystem, policy_chain
from solvers.sweeps import Sweeps

SOLVED = [ModifiedPolicyIteration(tol=1e-8), ModifiedPolicyIteration(), ValueIteration(tol=1e-8)]


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


def queue(states: int, discount: object) -> MDP:
    """Births and deaths at three service rates, slow to mix."""
    state, action = np.repeat(np.arange(states), 3), np.tile(np.arange(3), states)
    up = np.where(state < states - 1, 0.4, 0.0)
    down = np.where(state > 0, np.array([0.3, 0.4, 0.5])[action], 0.0)
    row = np.arange(3 * states)
    ahead, back = np.minimum(state + 1, states - 1), np.maximum(state - 1, 0)
    entries = (np.tile(row, 3), np.concatenate([ahead, back, state]))
    rows = sp.coo_array((np.concatenate([up, down, 1 - up - down]), entries), (len(row), states))
    reward = -state / states - np.array([0.0, 0.3, 1.0])[action]
    return MDP.from_pairs(state, action, rows.tocsr(), reward, discount)


def values(mdp: MDP, seed: int) -> np.ndarray:
    drawn = np.random.default_rng(seed).normal(size=mdp.n_states) * 10
    return np.where(mdp.terminal, 0.0, drawn)


@pytest.fixture(params=[False, True], ids=["for-ever", "ending"])
def mdp(request: pytest.FixtureRequest) -> MDP:
    found = garnet(300, seed=4, ends=request.param)
    assert found.terminal.any() == request.param
    return found


def both(mdp: MDP, monkeypatch: pytest.MonkeyPatch, *, strict: bool = False) -> list[Sweeps]:
    """Sweeps in NumPy and compiled ones of the same model."""
    one, two = (Sweeps(mdp, margin_weights(mdp), strict=strict) for _ in range(2))
    monkeypatch.setattr(Sweeps, "compiled", property(lambda self: self is two))
    assert (one.compiled, two.compiled) == (False, True)
    return [one, two]


@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("shift", [0.0, 3.5])
def test_a_pass_is_that_of_numpy_and_of_plain_python(
    mdp: MDP, monkeypatch: pytest.MonkeyPatch, shift: float, strict: bool
) -> None:
    value = values(mdp, 1)
    one, two = both(mdp, monkeypatch, strict=strict)
    slow, fast = one.improve(value, shift), two.improve(value, shift)
    gain = gains_of(mdp, value, shift, one.margin)
    best = np.maximum.reduceat(gain, mdp.pair_offsets[:-1])
    for found in (slow, fast):
        assert np.abs(found.step - np.where(mdp.terminal, 0, best)).max() < 1e-13
    assert slow.pairs.tolist() == fast.pairs.tolist()
    for name in ("low", "high", "floor"):
        assert getattr(fast, name) == pytest.approx(getattr(slow, name), rel=1e-12)


def test_margins_are_those_of_numpy(mdp: MDP, monkeypatch: pytest.MonkeyPatch) -> None:
    weight = np.where(mdp.terminal, 0.0, 1 + np.abs(values(mdp, 14)) / 100)
    slow = module._margins(mdp, weight)
    monkeypatch.setattr(module, "COMPILED", 0)
    fast = module._margins(mdp, weight)
    assert all(np.abs(one - two).max() < 1e-15 for one, two in zip(slow, fast, strict=True))
    assert (fast[0] < fast[1])[~mdp.terminal[mdp.pair_state]].all()


def test_following_a_policy_is_that_of_numpy_and_of_plain_python(
    mdp: MDP, monkeypatch: pytest.MonkeyPatch
) -> None:
    value, shift = values(mdp, 2), 1.25
    pairs = mdp.pair_offsets[:-1] + np.random.default_rng(3).integers(0, 3, mdp.n_states)
    one, two = both(mdp, monkeypatch)
    slow, fast = one.follow(value, shift, pairs), two.follow(value, shift, pairs)
    step = np.where(mdp.terminal, 0, gains_of(mdp, value, shift, one.margin)[pairs])
    assert np.abs(slow[0] - step).max() < 1e-13
    assert np.abs(fast[0] - step).max() < 1e-13
    assert fast[1:] == pytest.approx(slow[1:], rel=1e-12)


@pytest.mark.parametrize("backward", [False, True])
def test_relaxing_is_that_of_plain_python(mdp: MDP, backward: bool) -> None:
    value = values(mdp, 5)
    sweeps = Sweeps(mdp, margin_weights(mdp))
    found = value.copy()
    largest = sweeps.relax(found, 0.0, backward=backward)
    assert np.abs(found - relaxed(mdp, value, backward=backward)).max() < 1e-12
    assert largest == pytest.approx(np.abs(found - value).max(), rel=1e-12)


@pytest.mark.parametrize("ends", [False, True])
def test_compiled_bounds_are_proven_by_exact_inequalities(
    monkeypatch: pytest.MonkeyPatch, ends: bool
) -> None:
    mdp = garnet(40, seed=6, ends=ends, discount=F(999, 1000))
    value = values(mdp, 7)
    _, sweeps = both(mdp, monkeypatch)
    found = sweeps.improve(value)
    weight = exact_values(sweeps.weights.value)
    above = [v + F(found.high) * w for v, w in zip(exact_values(value), weight, strict=True)]
    below = [v + F(found.low) * w for v, w in zip(exact_values(value), weight, strict=True)]
    live = np.flatnonzero(~mdp.terminal[mdp.pair_state]).tolist()
    most, least = exact_gains(mdp, above), exact_gains(mdp, below)
    room = F(1, 10**12)  # a ratio is rounded last of all, and `bounds` allows for it
    assert all(most[pair] <= room for pair in live)
    assert all(least[pair] >= -room for pair in set(live) & set(found.pairs.tolist()))


def test_the_leak_of_floats_is_known_to_its_error() -> None:
    rng = np.random.default_rng(8)
    weight = rng.dirichlet(np.ones(9), 50).ravel() * (1 + rng.normal(size=450) * 1e-10)
    offsets, found = np.arange(0, 451, 9), np.empty(50)
    error = F(float(bellman.leaks(0, 50, offsets, weight, 0.95, float(1 - F(0.95)), found)))
    assert error < F(1, 10**15)
    for row in range(50):
        total = sum(map(F, weight[9 * row : 9 * row + 9].tolist()))
        assert abs(1 - F(0.95) * total - F(float(found[row]))) <= error


@pytest.fixture(scope="module")
def large() -> MDP:
    found = garnet(60_000, seed=9, discount="19/20")
    assert found.n_transitions > 4 * blocks.SMALLEST > COMPILED
    return found


def test_the_number_of_threads_changes_no_bit(large: MDP, monkeypatch: pytest.MonkeyPatch) -> None:
    value, pairs = values(large, 10), large.pair_offsets[:-1]
    seen = []
    for threads in (1, 2):
        monkeypatch.setattr(blocks, "cores", lambda threads=threads: threads)
        sweeps = Sweeps(large, margin_weights(large))
        found, followed = sweeps.improve(value, 0.5), sweeps.follow(value, 0.5, pairs)
        assert (len(sweeps._ends) > 2) == (threads > 1)
        whole = gains(large, value)
        arrays = (found.step, found.pairs, followed[0], whole.value, whole.error)
        numbers = (found.low, found.high, found.floor, *followed[1:])
        seen.append((*[array.tobytes() for array in arrays], *numbers))
        solution = solve(large, ModifiedPolicyIteration(tol=1e-6))
        seen[-1] += (solution.value.tobytes(), solution.policy.tobytes())
    assert seen[0] == seen[1]


def test_what_fails_on_a_thread_is_raised() -> None:
    def fails(number: int, first: int, last: int) -> None:
        raise ValueError(f"{first} {last}")

    with pytest.raises(ValueError, match=r"^\d+ \d+$"):
        blocks.run_blocks([0, 1, 2, 3], fails)


def test_blocks_cover_all_once() -> None:
    work = np.cumsum(np.concatenate([[0], np.random.default_rng(1).integers(1, 9, 5_000)]))
    for threads in (1, 2, 3):
        ends = blocks.block_ends(work, threads)
        assert (ends[0], ends[-1]) == (0, 5_000)
        assert all(first < last for first, last in pairwise(ends))
        assert len(ends) - 1 == (1 if threads == 1 else 8 * threads)


def test_large_and_small_models_are_solved_alike(large: MDP) -> None:
    found = [solve(large, solver) for solver in SOLVED]
    assert levels(large) is None
    for one in found:
        assert one.error_bound <= 2e-8 * max(1, np.abs(one.value).max())
        difference = np.abs(one.value - found[0].value)
        assert (difference <= one.state_error + found[0].state_error).all()


@pytest.mark.parametrize("discount", ["99/100", "9999/10000"])
def test_slow_chains_are_solved_by_their_equations(discount: str) -> None:
    mdp = queue(3_000, discount)
    assert mdp.n_transitions > COMPILED
    one = solve(mdp, ModifiedPolicyIteration(tol=1e-6))
    two = solve(mdp, PolicyIteration())
    assert one.error_bound <= 1e-6
    assert (np.abs(one.value - two.value) <= one.state_error + two.state_error).all()
    assert one.iterations < 60


def test_values_beyond_floats_are_noticed(monkeypatch: pytest.MonkeyPatch, mdp: MDP) -> None:
    for sweeps in both(mdp, monkeypatch):
        for wrong in (np.inf, np.nan, 1.7e308):
            value = values(mdp, 11)
            value[[3, 5]] = wrong, -wrong
            with pytest.raises(SolverError, match="beyond the range of floats"):
                sweeps.improve(value)


def test_bicgstab_solves_a_chain() -> None:
    mdp = garnet(9_000, seed=12, discount="999/1000")
    chain, reward = policy_chain(mdp, mdp.pair_offsets[:-1])
    assert chain.nnz > COMPILED
    system = LinearSystem(chain, mdp.discount)
    assert not system._banded
    value, room = np.empty(mdp.n_states), np.empty((6, mdp.n_states))
    rows = (chain.indptr, chain.indices, chain.data)
    taken = krylov.bicgstab(*rows, mdp.discount, reward, 1e-10, 100, value, room)
    assert 0 < taken < 100
    assert np.linalg.norm(value - mdp.discount * (chain @ value) - reward) < 1e-8
    assert krylov.bicgstab(*rows, mdp.discount, reward, 1e-10, 1, value, room) == -1
    assert np.abs(system.solve(reward).error).max() < 1e-8


def test_gauss_seidel_both_ways_is_the_product_that_it_stands_for() -> None:
    chain = sp.csr_array(np.random.default_rng(13).dirichlet(np.ones(12), 12))
    matrix = np.eye(12) - 0.9 * chain.toarray()
    lower, upper, diagonal = np.tril(matrix), np.triu(matrix), np.diag(np.diag(matrix))
    given, found = np.arange(12.0), np.empty(12)
    krylov.symmetric(chain.indptr, chain.indices, chain.data, 0.9, given, found)
    assert np.allclose(lower @ np.linalg.solve(diagonal, upper @ found), given, atol=1e-12)


def test_small_models_are_solved_without_numba() -> None:
    code = (
        "import sys; from mdp import MDP; from solvers import solve\n"
        "print(solve(MDP.from_arrays([[[1]]], [1], '9/10')).start_value, 'numba' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["10.0", "False"]
