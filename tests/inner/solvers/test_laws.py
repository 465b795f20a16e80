"""Laws over all solvers: answers lie within their bounds, whatever the numbers and the loops."""

import tracemalloc
import warnings
from collections.abc import Callable
from fractions import Fraction as F
from functools import cache
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import classes, garnet, gridworld, sparse
from workloads import garnet as garnet_rows
from workloads import queue

from exact_mdp import (
    MDP,
    Certificate,
    GaussSeidel,
    ModifiedPolicyIteration,
    PolicyIteration,
    SolverError,
    Status,
    ValueIteration,
    certify,
    solve,
)
from exact_mdp.mdp.forms import threads as blocks
from exact_mdp.mdp.table import COMPILED
from exact_mdp.solvers.dynamic import iterate

KINDS: list[Any] = [ModifiedPolicyIteration, ValueIteration, GaussSeidel, PolicyIteration]


@pytest.fixture(params=[0, 10**9], ids=["compiled", "numpy"])
def loops(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """Solve models of any size in compiled loops, or in NumPy."""
    monkeypatch.setattr(iterate, "LOOPS", request.param)
    return int(request.param)


def quietly(mdp: MDP, solver: Any = "auto", **settings: Any) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return solve(mdp, solver, **settings)


def holds(found: Any, proof: Certificate) -> bool:
    exact = zip(found.value, proof.value, found.state_error, strict=True)
    return all(abs(F(float(x)) - value) <= F(float(error)) for x, value, error in exact)


def agree(one: Any, other: Any) -> bool:
    apart = np.abs(one.value - other.value)
    return bool((apart <= one.state_error + other.state_error).all())


# ---- any numbers -----------------------------------------------------------------------------


def attacked(seed: int) -> MDP:
    """Rows off by up to 1e-10, discounts up to 1 - 1e-12, rewards over 300 orders of magnitude."""
    rng = np.random.default_rng(seed)
    states, actions = int(rng.integers(1, 7)), int(rng.integers(1, 4))
    chances = rng.dirichlet(np.full(states, 0.5), (actions, states))
    if seed % 3 == 0:  # in parts between which nothing leads
        chances = np.eye(states)[rng.integers(states, size=(2, actions, states))].mean(axis=0)
    chances *= 1 + rng.choice([0.0, -1e-10, 1e-10], size=(actions, states, 1))
    reward = rng.normal(size=(states, actions))
    if seed % 2:
        reward *= 10.0 ** rng.integers(-150, 150, reward.shape)
    if seed % 5 == 0:
        chances[:, -1], reward[-1] = np.eye(states)[-1], 0.0
    rate = rng.choice([0.5, 0.99, 1 - 1e-6, 1 - 1e-9, 1 - 1e-12])
    return MDP.from_arrays(chances, reward, discount=rate, layout="ass")


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), tol=st.sampled_from([None, 1e-3]), large=st.booleans())
def test_no_number_breaks_a_bound(seed: int, tol: Any, large: bool) -> None:
    mdp = attacked(seed)
    proof = certify(mdp)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(iterate, "LOOPS", 0 if large else 10**9)
        for kind in KINDS:
            kwargs = {} if kind is PolicyIteration else {"tol": tol}
            try:
                found = quietly(mdp, kind(max_iterations=3000, **kwargs))
            except SolverError as error:  # an honest refusal has an honest bound
                found = error.solution
            assert found is None or holds(found, proof)


@given(seed=st.integers(0, 10**6), power=st.integers(-30, 30))
def test_costs_scales_and_names_change_the_numbers_alike(seed: int, power: int) -> None:
    rng = np.random.default_rng(seed)
    chances = rng.dirichlet(np.ones(5), (3, 5))
    reward, order = rng.normal(size=(5, 3)), rng.permutation(5)
    found = solve(MDP.from_arrays(chances, reward, 0.9, layout="ass"), tol=1e-9)
    least = solve(MDP.from_arrays(chances, -reward, 0.9, layout="ass", sense="min"), tol=1e-9)
    assert (least.value == -found.value).all()
    scaled = MDP.from_arrays(chances, reward * 2.0**power, 0.9, layout="ass")
    scaled = solve(scaled, tol=1e-9 * 2.0**power)
    assert (scaled.value == found.value * 2.0**power).all()
    mixed = MDP.from_arrays(chances[:, order][:, :, order], reward[order], 0.9, layout="ass")
    other = solve(mixed, tol=1e-9)
    assert (np.abs(other.value - found.value[order]) <= 2e-9).all()
    assert (other.policy.rule == found.policy.rule[order]).all()


# ---- next to discount 1 ----------------------------------------------------------------------


def in_circles(discount: float) -> MDP:
    """State 3 may stay for nothing, or go for what staying loses no more of than rounding does."""
    rows = [
        [(1, 3), (3, -2), (2, 1)],
        [(2, 1), (3, -2)],
        [(1, -1), (2, -1), (2, -3)],
        [(3, 0), (0, -3), (1, 1), (1, -1)],
    ]
    pairs = [(s, a, *pair) for s, row in enumerate(rows) for a, pair in enumerate(row)]
    state, action, after, reward = zip(*pairs, strict=True)
    return MDP.from_pairs(state, action, np.eye(4)[list(after)], reward, discount=discount)


def either_way(discount: float) -> MDP:
    """State 0 may stay for 1 a step, or go where more is earned, though a part of it is lost."""
    rows = [{0: 1.0}, {2: 0.49999999999, 3: 0.5}, {5: 1}, {1: 0.5, 4: 0.5}]
    rows += [{1: 0.5, 3: 0.5}, {1: 0.5, 3: 0.5}, {1: 0.5, 2: 0.5}]
    chances = np.zeros((7, 6))
    for pair, row in enumerate(rows):
        chances[pair, list(row)] = list(row.values())
    state, action = [0, 0, 1, 2, 3, 4, 5], [0, 1, 0, 0, 0, 0, 0]
    return MDP.from_pairs(state, action, chances, [1, 3, 3, 3, -2, 3, 0], discount=discount)


def beside_an_end(exponent: int) -> MDP:
    """Four states that no way leads out of, beside one in which all is over."""
    state, action = [0, 1, 1, 2, 2, 3, 3, 3, 4, 4, 4, 4], [0, 0, 1, 0, 1, 0, 1, 2, 0, 1, 2, 3]
    after = np.eye(5)[[0, 1, 3, 1, 4, 4, 1, 3, 4, 4, 3, 4]]
    reward = [0, -0.33, -0.42, -0.46, 0.44, 0.14, -0.48, -0.38, 0.21, 0.38, -0.21, -0.47]
    return MDP.from_pairs(state, action, after, reward, discount=1 - 2.0**-exponent)


def one_way(states: int, seed: int) -> MDP:
    """Ways round a ring that all earn 1, some of their rows off."""
    rng, pairs = np.random.default_rng(seed), 4 * states
    rows = (np.repeat(np.arange(states), 4)[:, None] + rng.integers(0, 3, (pairs, 3))) % states
    weight = rng.dirichlet(np.ones(3), pairs)
    weight *= 1 - 1e-10 * rng.random((pairs, 1)) * (rng.random((pairs, 1)) < 0.4)
    return sparse(rows, weight, np.ones(pairs), 1 - 1e-9)


def ring(states: int, discount: float, size: float = 1.0) -> MDP:
    """On a ring, each of the two or three states next to one another follows, or does not."""
    rng = np.random.default_rng(states)
    chances = np.zeros((3, states, states))
    for action, state in product(range(3), range(states)):
        after = (state + rng.choice([-1, 0, 1], 2, replace=False)) % states
        chances[action, state, after] = rng.dirichlet([1, 1])
    return MDP.from_arrays(chances, rng.normal(size=(states, 3)) * size, discount=discount)


OFF, OFTEN = 0.4999999999, [[0.5, 0.5, 0], [0.2, 0.7999999999, 0], [0, 0, 1]]
NEAR_ONE = [
    *(MDP.from_arrays([[[0.5, 0.5], [0.5, OFF]]], [1, 2], discount=1 - d) for d in (1e-9, 1e-12)),
    *(MDP.from_arrays([OFTEN], [1, 2, 3], discount=1 - d) for d in (1e-12, 1e-13, 1e-14)),
    *map(in_circles, (1 - 2.0**-47, 1 - 2.0**-50, 1 - 2.0**-52)),
    either_way(1 - 2.0**-48),
    *map(beside_an_end, (25, 30, 40, 51)),
    ring(5, 1 - 2.0**-52),
]


@cache
def proof(number: int) -> Certificate:
    return certify(NEAR_ONE[number])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("tol", [None, 1e-3])
@pytest.mark.parametrize("number", range(len(NEAR_ONE)))
def test_a_run_in_which_nothing_is_gained_ends(
    number: int, tol: Any, kind: Any, loops: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With bounds around the values that rational arithmetic proves."""
    monkeypatch.setattr(iterate, "MANY", 50)
    mdp = NEAR_ONE[number]
    found = quietly(mdp, kind() if kind is PolicyIteration else kind(tol=tol))
    assert found.iterations < 300
    assert holds(found, proof(number))
    if number < 2 or (mdp.n_states == 5 and mdp.terminal.any()):
        assert found.error_bound <= 1e-9 * max(1, np.abs(found.value).max())


CLOSE = {
    "classes, rare": (classes("rare", 1 - 1e-8), None),
    "classes, integers": (classes("int", 1 - 1e-9), None),
    "one way": (one_way(40, 2), None),
    "one way, tol": (one_way(60, 4), 1e-6),
    "ring": (ring(40, 1 - 1e-9, 1e5), None),
}


@pytest.mark.parametrize("name", CLOSE)
def test_pairs_that_differ_by_little_are_told_apart(name: str) -> None:
    model, tol = CLOSE[name]
    found, other = quietly(model, tol=tol), quietly(model, PolicyIteration())
    assert found.iterations < 500
    assert found.error_bound <= 1e-6 * np.abs(found.value).max()
    assert agree(found, other)


def test_in_a_corridor_each_round_may_bring_one_state_on(loops: int) -> None:
    go = np.eye(60)[[*range(1, 60), 59]]
    mdp = MDP.from_arrays([np.eye(60), go], [0.0] * 59 + [1.0], discount=0.999)
    found = solve(mdp)
    assert found.status is Status.CONVERGED
    assert holds(found, certify(mdp))


def test_too_few_iterations_name_all_that_goes_on() -> None:
    with pytest.raises(SolverError, match=r"PolicyIteration.*certify\(\)"):
        solve(NEAR_ONE[0], ModifiedPolicyIteration(tol=1e-9, max_iterations=2))


@pytest.mark.parametrize("discount", ["999/1000", "99999/100000", "9999999/10000000"])
@pytest.mark.parametrize("tol", [None, 1e-3, 1e-9])
@pytest.mark.parametrize("reward", [1.1, 100002.12593686389])
def test_one_living_state_is_solved_at_once(
    discount: str, tol: float | None, reward: float, loops: int
) -> None:
    """V = r / (1 - γ); values that all change alike are no sign that they are reached."""
    stay, go = [[1, 0], [0, 1]], [[0.5, 0.5], [0, 1]]
    mdp = MDP.from_arrays([stay, go], [[reward, 1], [0, 0]], discount, layout="ass")
    found = quietly(mdp, tol=tol)
    exact = F(reward) / (1 - F(discount))
    assert abs(F(float(found.value[0])) - exact) <= F(float(found.error_bound))
    assert found.error_bound <= 1e-9 * exact
    assert found.iterations <= 25


# ---- large models ----------------------------------------------------------------------------

MODELS = [
    lambda: queue(60).model(),
    lambda: gridworld(6),
    lambda: garnet(60, seed=31, discount="99/100"),
    lambda: garnet(40, seed=33, discount=1, ends=True),
    lambda: garnet(200, seed=34, discount="999/1000", ends=True),
]


@pytest.mark.parametrize("make", MODELS)
@pytest.mark.parametrize("kind", KINDS)
def test_models_are_solved_alike_compiled_and_not(
    make: Callable[[], MDP], kind: Any, loops: int
) -> None:
    mdp = make()
    assert holds(quietly(mdp, kind()), certify(mdp))


@pytest.fixture(scope="module")
def large() -> MDP:
    found = garnet(60_000, seed=9, discount="19/20")
    assert found.n_transitions > 2 * blocks.SMALLEST > COMPILED
    return found


def test_the_number_of_threads_changes_no_bit(large: MDP, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    for threads in (1, 2):
        monkeypatch.setattr(blocks, "cores", lambda threads=threads: threads)
        found = [solve(large, kind(tol=1e-6)) for kind in KINDS[:2]]
        seen.append([part.tobytes() for one in found for part in (one.value, one.pairs)])
        assert agree(*found)
    assert seen[0] == seen[1]


@pytest.mark.parametrize("discount", [0.99, 0.9999])
def test_slow_chains_are_solved_by_their_equations(discount: float) -> None:
    mdp = queue(3_000, discount).model()
    one, two = solve(mdp, tol=1e-6), solve(mdp, PolicyIteration())
    assert one.error_bound <= 1e-6
    assert agree(one, two)
    assert one.iterations < 60


def test_a_large_model_is_solved_in_little_memory() -> None:
    """Here parts of a fixed size weigh more than in larger ones."""
    model, work = garnet_rows(20_000, 0.95), garnet_rows(2_000, 0.95)
    solve(work.model(), tol=1e-6)  # loads the loops
    tracemalloc.start()
    try:
        mdp = model.model()
        own, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        solve(mdp, tol=1e-6)
        assert own < tracemalloc.get_traced_memory()[1] < 1.4 * own
    finally:
        tracemalloc.stop()


def test_what_fails_on_a_thread_is_raised() -> None:
    def fails(number: int, first: int, last: int) -> None:
        raise ValueError(f"{first} {last}")

    with pytest.raises(ValueError, match=r"^\d+ \d+$"):
        blocks.run_blocks([0, 1, 2, 3], fails)


def test_threads_ignore_what_their_caller_ignores() -> None:
    seen = np.zeros(50)

    def overflows(number: int, first: int, last: int) -> None:
        seen[number] = np.multiply(1e308, np.full(1, 10.0))[0]

    with np.errstate(over="ignore"):  # a warning would be an error
        blocks.run_blocks(range(51), overflows)
    assert np.isinf(seen).all()


def test_blocks_cover_all_once() -> None:
    work = np.cumsum(np.concatenate([[0], np.random.default_rng(1).integers(1, 9, 5_000)]))
    for threads in (1, 2, 3):
        ends = blocks.block_ends(work, threads)
        assert (ends[0], ends[-1]) == (0, 5_000)
        assert all(first < last for first, last in pairwise(ends))
        assert len(ends) - 1 == (1 if threads == 1 else blocks.PER_THREAD * threads)
        most = int(work[-1]) // 40
        ends = blocks.block_ends(work, threads, most=most)
        assert np.diff(work[ends]).max() <= most + 9
