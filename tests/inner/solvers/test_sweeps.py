"""Compiled sweeps: against plain Python, NumPy and rational arithmetic; threads change nothing."""

import tracemalloc
import warnings
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction as F
from functools import cache
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_twins import gains_of, relaxed
from made_models import garnet, gridworld
from strategies import exact_gains, exact_values
from workloads import garnet as garnet_rows
from workloads import queue

from exact_mdp import (
    MDP,
    Certificate,
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
from exact_mdp.solvers.bounds import gains as gains_module
from exact_mdp.solvers.bounds import sweeps as sweeps_module
from exact_mdp.solvers.bounds.bounds import levels, margin_weights
from exact_mdp.solvers.bounds.gains import gains
from exact_mdp.solvers.bounds.linear import LinearSystem
from exact_mdp.solvers.bounds.sweeps import CompiledSweeps, Judged, Sweeps, sweeps_of
from exact_mdp.solvers.dynamic import pace
from exact_mdp.solvers.dynamic import stopping as stopping_module
from exact_mdp.solvers.dynamic.stopping import Iterate

SOLVED = [ModifiedPolicyIteration(tol=1e-8), ModifiedPolicyIteration(), ValueIteration(tol=1e-8)]


def uneven(mdp: MDP, seed: int) -> MDP:
    """The model with rows off by up to what is allowed, some outcomes told twice."""
    rng, table = np.random.default_rng(seed), mdp.table
    off = 1 + rng.uniform(-9e-10, 9e-10, mdp.n_pairs)[table.pair]
    off[np.repeat(mdp.terminal[mdp.pair_state], np.diff(table.offsets))] = 1.0
    weight = np.repeat(table.weight * off / 2, 2)
    parts = {"offsets": 2 * table.offsets, "next": np.repeat(table.next, 2), "weight": weight}
    return mdp.with_(table=replace(table, **parts))


def values(mdp: MDP, seed: int) -> np.ndarray:
    drawn = np.random.default_rng(seed).normal(size=mdp.n_states) * 10
    return np.where(mdp.terminal, 0.0, drawn)


@pytest.fixture(params=[False, True], ids=["for-ever", "ending"])
def mdp(request: pytest.FixtureRequest) -> MDP:
    found = garnet(300, seed=4, ends=request.param)
    assert found.terminal.any() == request.param
    return found


def both(mdp: MDP, *, strict: bool = False) -> list[Sweeps]:
    """Sweeps in NumPy and compiled ones of the same model."""
    return [kind(mdp, margin_weights(mdp), strict=strict) for kind in (Sweeps, CompiledSweeps)]


@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("shift", [0.0, 3.5])
def test_a_judging_pass_is_that_of_numpy_and_of_plain_python(
    mdp: MDP, shift: float, strict: bool
) -> None:
    value = values(mdp, 1)
    one, two = both(mdp, strict=strict)
    slow, fast = one.judge(value, shift), two.judge(value, shift)
    gain = gains_of(mdp, value, shift, one.weights.margin)
    best = np.maximum.reduceat(gain, mdp.pair_offsets[:-1])
    for found in (slow, fast):
        assert np.abs(found.step - np.where(mdp.terminal, 0, best)).max() < 1e-13
    same(slow, fast)
    assert fast.floor == pytest.approx(slow.floor, rel=1e-12)


def same(slow: Judged, fast: Judged) -> None:
    assert slow.pairs.tolist() == fast.pairs.tolist()
    for name in ("low", "high"):
        assert getattr(fast, name) == pytest.approx(getattr(slow, name), rel=1e-12, abs=1e-13)


def moves(mdp: MDP, kind: str) -> list[np.ndarray]:
    """Values that a solver might go through: they settle, jump, or rise and fall as a whole."""
    rng, scale = np.random.default_rng(21), 10.0
    found = [values(mdp, 20)]
    for _ in range(12):
        scale *= {"settle": 0.2, "jump": 1.0, "drift": 0.5}[kind]
        step = rng.normal(size=mdp.n_states) * scale
        if kind == "drift":
            step += rng.normal() * 100
        found.append(np.where(mdp.terminal, 0.0, found[-1] + step))
    return found


@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("kind", ["settle", "jump", "drift"])
def test_what_is_left_out_changes_nothing(mdp: MDP, kind: str, strict: bool) -> None:
    """Passes that remember the last find what passes that look at every pair find."""
    one, two = both(mdp, strict=strict)
    first = mdp.pair_offsets[:-1]
    for number, value in enumerate(moves(mdp, kind)):
        plain = one.judge(value)
        found = two.improve(value)
        assert np.abs(found.step - plain.step).max() < 1e-12
        gain = gains_of(mdp, value, 0.0, one.weights.margin)
        assert two.policy is not None
        assert (mdp.pair_state[two.policy] == np.arange(mdp.n_states)).all()
        best = np.where(mdp.terminal, gain[first], np.maximum.reduceat(gain, first))
        assert np.abs(gain[two.policy] - best).max() < 1e-12
        if number % 3 == 0:
            judged = CompiledSweeps.judge(two, value)
            same(plain, judged)
            assert judged.floor <= plain.floor * (1 + 1e-12)  # that of pairs looked at
            assert judged.low - 1e-12 <= found.low
            assert found.high <= judged.high + 1e-12


def test_most_pairs_are_left_out_once_values_settle(large: MDP) -> None:
    sweeps = sweeps_of(large, margin_weights(large))
    assert isinstance(sweeps, CompiledSweeps)
    value = values(large, 22) / 1000
    for _ in range(30):
        value = value + sweeps.improve(value).step
    memory, own = sweeps._memory, value[large.pair_state]
    ceiling = memory.policy.ceilings + (memory.policy.rise - own)
    looked_at = ceiling >= sweeps.judge(value).step[large.pair_state]
    looked_at[memory.policy.pairs] = False
    assert looked_at.mean() < 0.01


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_ceilings_hold_exactly_whatever_the_values_do(data: st.DataObject) -> None:
    """q(l) ≤ ceiling + rise in rational arithmetic, for every pair that was ever looked at."""
    seed = data.draw(st.integers(0, 10**6))
    discount = data.draw(st.sampled_from(["1/2", "99/100", "999999/1000000"]))
    mdp = garnet(6, seed=seed, discount=discount, ends=data.draw(st.booleans()))
    if data.draw(st.booleans()):  # rows that sum to a little more or less than 1
        mdp = uneven(mdp, seed)
    sweeps = CompiledSweeps(mdp, margin_weights(mdp))
    numbers = st.floats(-1e6, 1e6, allow_subnormal=False)
    for _ in range(data.draw(st.integers(1, 4))):
        drawn = data.draw(st.lists(numbers, min_size=6, max_size=6, unique=True))
        value = np.where(mdp.terminal, 0.0, drawn)
        sweeps.improve(value)
        memory, exact = sweeps._memory, exact_values(value)
        gain = exact_gains(mdp, exact)
        for pair in range(mdp.n_pairs):
            state = int(mdp.pair_state[pair])
            if pair == memory.policy.pairs[state] or mdp.terminal[state]:
                continue
            ceiling, rise = F(float(memory.policy.ceilings[pair])), F(float(memory.policy.rise))
            slack = 4 * F(2) ** -53 * (abs(ceiling) + abs(rise))
            assert gain[pair] + exact[state] <= ceiling + rise + slack


def test_following_a_policy_is_that_of_numpy_and_of_plain_python(mdp: MDP) -> None:
    one, two = both(mdp)
    with pytest.raises(ValueError, match="no policy"):
        two.follow(values(mdp, 2), 0.0)
    for number in range(3):  # rows are exchanged one by one
        for sweeps in (one, two):
            sweeps.improve(values(mdp, 30 + number))
        value, shift, pairs = values(mdp, 2), 1.25, two.policy
        assert pairs.tolist() == one.policy.tolist()
        slow, fast = one.follow(value, shift), two.follow(value, shift)
        step = np.where(mdp.terminal, 0, gains_of(mdp, value, shift, one.weights.margin)[pairs])
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
@pytest.mark.parametrize("twice", [False, True])
def test_compiled_bounds_are_proven_by_exact_inequalities(ends: bool, twice: bool) -> None:
    mdp = garnet(40, seed=6, ends=ends, discount=F(999, 1000))
    if twice:
        mdp = uneven(mdp, 6)
        assert mdp.n_transitions < len(mdp.table.next)
    value = values(mdp, 7)
    _, sweeps = both(mdp)
    sweeps.improve(values(mdp, 17))  # so that pairs are left out
    found = sweeps.judge(value)
    weight = exact_values(sweeps.weights.value)
    above = [v + F(found.high) * w for v, w in zip(exact_values(value), weight, strict=True)]
    below = [v + F(found.low) * w for v, w in zip(exact_values(value), weight, strict=True)]
    live = np.flatnonzero(~mdp.terminal[mdp.pair_state]).tolist()
    most, least = exact_gains(mdp, above), exact_gains(mdp, below)
    room = F(1, 10**12)  # a ratio is rounded last of all, and `bounds` allows for it
    assert all(most[pair] <= room for pair in live)
    assert all(least[pair] >= -room for pair in set(live) & set(found.pairs.tolist()))


@pytest.fixture(scope="module")
def large() -> MDP:
    found = garnet(60_000, seed=9, discount="19/20")
    assert found.n_transitions > 2 * blocks.SMALLEST > COMPILED
    return found


def test_the_number_of_threads_changes_no_bit(large: MDP, monkeypatch: pytest.MonkeyPatch) -> None:
    value = values(large, 10)
    seen = []
    for threads in (1, 2):
        monkeypatch.setattr(blocks, "cores", lambda threads=threads: threads)
        sweeps = sweeps_of(large, margin_weights(large))
        better, followed = sweeps.improve(value, 0.5), sweeps.follow(value, 0.5)
        found = sweeps.judge(value + better.step, 0.5)
        assert (len(sweeps._ends) > 2) == (threads > 1)
        whole = gains(large, value)
        arrays = (better.step, found.step, found.pairs, followed[0], whole.value, whole.error)
        numbers = (better.low, better.high, found.low, found.high, found.floor, *followed[1:])
        seen.append((*[array.tobytes() for array in arrays], *numbers))
        solution = solve(large, ModifiedPolicyIteration(tol=1e-6))
        seen[-1] += (solution.value.tobytes(), solution.pairs.tobytes())
    assert seen[0] == seen[1]


LARGER = [
    lambda: garnet(1_500, seed=41, discount="99/100"),
    lambda: uneven(garnet(1_500, seed=42, ends=True), 42),
    lambda: queue(2_500).model(),
]


@pytest.mark.parametrize("make", LARGER)
def test_rows_of_policies_are_the_same_where_they_stand(
    make: Callable[[], MDP], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for most in (sweeps_module.ASIDE, 0):
        monkeypatch.setattr(sweeps_module, "ASIDE", most)
        one = solve(mdp := make(), tol=1e-7)
        held = sweeps_of(mdp, margin_weights(mdp)).held
        assert (held.data is mdp.transition.data) == (len(held.weights) == 0) == (most == 0)
        told = [part.tobytes() for part in (one.value, one.pairs, one.state_error)]
        found.append((one.iterations, one.stats, told))
    assert found[0] == found[1]


def test_a_large_model_is_solved_in_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """A million states take 1.29 times their own; here parts of a fixed size weigh more."""
    monkeypatch.setattr(sweeps_module, "ASIDE", 0)
    model, work = garnet_rows(20_000, 0.95), garnet_rows(2_000, 0.95)
    solve(work.model(), tol=1e-6)  # loads the loops
    tracemalloc.start()
    try:
        mdp = model.model()
        own, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        solve(mdp, tol=1e-6)
        assert own < tracemalloc.get_traced_memory()[1] < 1.35 * own
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


def test_large_and_small_models_are_solved_alike(large: MDP) -> None:
    found = [solve(large, solver) for solver in SOLVED]
    assert levels(large) is None
    for one in found:
        assert one.error_bound <= 2e-8 * max(1, np.abs(one.value).max())
        difference = np.abs(one.value - found[0].value)
        assert (difference <= one.state_error + found[0].state_error).all()


@pytest.mark.parametrize("discount", [0.99, 0.9999])
def test_slow_chains_are_solved_by_their_equations(discount: float) -> None:
    mdp = queue(3_000, discount).model()
    assert mdp.n_transitions > COMPILED
    one = solve(mdp, ModifiedPolicyIteration(tol=1e-6))
    two = solve(mdp, PolicyIteration())
    assert one.error_bound <= 1e-6
    assert (np.abs(one.value - two.value) <= one.state_error + two.state_error).all()
    assert one.iterations < 60


def two_ways() -> MDP:
    """Exact outcomes, two of each pair to every next state, which its rows of floats have once."""
    rng, rows = np.random.default_rng(34), []
    for state in range(3):
        cuts = [int(each) for each in rng.integers(1, 2**20, 6)]
        chances = [F(cut, sum(cuts)) for cut in cuts]
        rewards = [F(int(each), 7) for each in rng.integers(0, 100, 6)]
        rows.append((state, 0, [*zip(chances, [0, 1, 2] * 2, rewards, strict=True)]))
    return MDP.from_outcomes(rows, "9/10")


SMALL = [
    lambda: queue(60).model(),
    lambda: gridworld(6),
    lambda: garnet(60, seed=31, discount="99/100"),
    lambda: uneven(garnet(30, seed=32, ends=True), 32),
    lambda: garnet(40, seed=33, discount=1, ends=True),
    two_ways,
]


@pytest.mark.parametrize("make", SMALL)
@pytest.mark.parametrize("solver", [*SOLVED, PolicyIteration()], ids=repr)
def test_small_models_are_solved_alike_compiled_and_not(
    make: Callable[[], MDP], solver: Any
) -> None:
    found = []
    for least in (0, COMPILED):
        with pytest.MonkeyPatch.context() as patch:
            for module in (gains_module, sweeps_module):
                patch.setattr(module, "COMPILED", least)
            mdp = make()
            assert isinstance(sweeps_of(mdp, margin_weights(mdp)), CompiledSweeps) == (not least)
            found.append(solve(mdp, solver))
    one, two = found
    assert (np.abs(one.value - two.value) <= one.state_error + two.state_error).all()


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    discount=st.sampled_from([0.5, 0.99, 0.9999, 1 - 1e-7, 1 - 2**-52]),
    ring=st.booleans(),
    ends=st.booleans(),
    off=st.sampled_from([0.0, 1e-10]),
    size=st.sampled_from([1e-3, 1.0, 1e7, 1e307]),
    tol=st.sampled_from([None, 1e-6, 1e-2]),
    sweeps=st.sampled_from([1, 5, 100]),
    most=st.sampled_from([10_000, 3, 1]),
)
def test_rounds_in_one_call_are_rounds_in_python(
    seed: int,
    discount: float,
    ring: bool,
    ends: bool,
    off: float,
    size: float,
    tol: Any,
    sweeps: int,
    most: int,
) -> None:
    """Compiled or in Python: at the tolerance, a limit, or where floats end."""
    rng = np.random.default_rng(seed)
    states, actions = int(rng.integers(2, 40)), int(rng.integers(1, 4))
    chances = rng.dirichlet(np.ones(states), (actions, states))
    if ring:
        up, down = np.roll(np.eye(states), 1, axis=1), np.roll(np.eye(states), -1, axis=1)
        chances = np.array([q * up + (1 - q) * down for q in rng.random(actions)])
    chances[:, ::2] *= 1 - off
    reward = rng.normal(size=(states, actions)) * size
    if ends:
        chances[:, -1], reward[-1] = np.eye(states)[-1], 0.0
    solver = ModifiedPolicyIteration(tol=tol, sweeps=sweeps, max_iterations=most)
    found = []
    for alone in (True, False):
        with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for module in (gains_module, sweeps_module):
                patch.setattr(module, "COMPILED", 0)
            patch.setattr(CompiledSweeps, "alone", alone)
            mdp = MDP.from_arrays(chances, reward, discount=discount, layout="ass")
            status: Any = None
            try:
                one: Any = solve(mdp, solver)
            except SolverError as error:
                status, one = error.status, error.solution
        told: list[Any] = [status]
        if one is not None:
            told += [one.status, one.iterations, one.stats, one.value.tobytes()]
            told += [one.pairs.tobytes(), one.state_error.tobytes()]
        found.append(told)
    assert found[0] == found[1]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("states", "discount", "size", "tol", "part"),
    [(5, 1 - 2**-52, 1.0, 1e-6, 1e-10), (40, 1 - 1e-9, 1e5, None, 1e-6)],
)
def test_a_run_ends_where_floats_do(
    states: int, discount: float, size: float, tol: Any, part: float, seed: int
) -> None:
    """On a ring, each of the two or three states next to one another follows, or does not.

    Margins of 2^-52 are off by a part of themselves, and keep bounds apart that nothing else does;
    of policies that stay here or there, bounds are a billion times as large as values.
    """
    rng = np.random.default_rng(seed)
    chances = np.zeros((3, states, states))
    for action, state in product(range(3), range(states)):
        after = (state + rng.choice([-1, 0, 1], 2, replace=False)) % states
        chances[action, state, after] = rng.dirichlet([1, 1])
    mdp = MDP.from_arrays(chances, rng.normal(size=(states, 3)) * size, discount=discount)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        one, other = solve(mdp, tol=tol), solve(mdp, PolicyIteration())
    assert one.iterations < 120
    assert one.error_bound <= part * np.abs(one.value).max()
    assert (np.abs(one.value - other.value) <= one.state_error + other.state_error).all()


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
    reward = [1, 3, 3, 3, -2, 3, 0]
    return MDP.from_pairs(
        [0, 0, 1, 2, 3, 4, 5], [0, 1, 0, 0, 0, 0, 0], chances, reward, discount=discount
    )


def leaking(seed: int) -> MDP:
    """A random model near discount 1, half of its rows off by up to what is allowed."""
    rng = np.random.default_rng(seed)
    states, actions = int(rng.integers(2, 8)), int(rng.integers(1, 4))
    chances = rng.dirichlet(np.ones(states), (actions, states))
    if seed % 2:  # in parts between which nothing leads
        after = np.eye(states)[rng.integers(states, size=(2, actions, states))]
        chances = after.sum(axis=0) / 2
    chances *= 1 - rng.choice([0.0, 1e-11, 1e-10, 9e-10], size=(actions, states, 1))
    reward = rng.normal(size=(states, actions)) * 10.0 ** rng.integers(-3, 6)
    return MDP.from_arrays(chances, reward, discount=1 - 2.0 ** -rng.integers(30, 53))


OFF, OFTEN = 0.4999999999, [[0.5, 0.5, 0], [0.2, 0.7999999999, 0], [0, 0, 1]]
FALLING = np.eye(6)[[0, 1, 3, 5, 3, 1]] * (1 - np.array([[0], [9e-10], [0], [1e-10], [0], [0]]))
NEAR_ONE = [
    *(MDP.from_arrays([[[0.5, 0.5], [0.5, OFF]]], [1, 2], discount=1 - d) for d in (1e-9, 1e-12)),
    *(MDP.from_arrays([OFTEN], [1, 2, 3], discount=1 - d) for d in (1e-12, 1e-13, 1e-14)),
    *map(in_circles, (1 - 2.0**-n for n in range(47, 53))),
    MDP.from_arrays([FALLING], [-2, -2, 2, 0, 1, 1], discount=1 - 2.0**-52),
    either_way(1 - 2.0**-48),
    *map(leaking, range(12)),
]


@cache
def proof(number: int) -> Certificate:
    return certify(NEAR_ONE[number])


@pytest.mark.parametrize("least", [0, COMPILED])
@pytest.mark.parametrize("kind", [ModifiedPolicyIteration, ValueIteration])
@pytest.mark.parametrize("tol", [None, 1e-3])
@pytest.mark.parametrize("number", range(len(NEAR_ONE)))
def test_a_run_in_which_nothing_is_gained_ends(
    number: int, tol: Any, kind: Any, least: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With bounds around the values that rational arithmetic proves."""
    for module in (gains_module, sweeps_module):
        monkeypatch.setattr(module, "COMPILED", least)
    monkeypatch.setattr(stopping_module, "MANY", 50)
    mdp = NEAR_ONE[number]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        one = solve(mdp, kind(tol=tol))
    assert one.iterations < 300
    for found, exact, error in zip(one.value, proof(number).value, one.state_error, strict=True):
        assert abs(F(float(found)) - exact) <= F(float(error))
    if number < 2:
        assert one.error_bound <= 1e-9 * np.abs(one.value).max()


@pytest.mark.parametrize("least", [0, COMPILED])
def test_patience_is_as_long_as_news_takes(least: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a corridor each round brings one state on, and bounds fall by a thousandth."""
    for module in (gains_module, sweeps_module):
        monkeypatch.setattr(module, "COMPILED", least)
    go = np.eye(60)[[*range(1, 60), 59]]
    mdp = MDP.from_arrays([np.eye(60), go], [0.0] * 59 + [1.0], discount=0.999)
    whole = solve(mdp)
    assert whole.status is Status.CONVERGED
    assert whole.iterations > 50
    monkeypatch.setattr(pace, "LONG", -120)  # no patience but for the last spell
    with pytest.raises(SolverError, match=r"21 iterations.*certify\(\)") as ended:
        solve(mdp)
    assert ended.value.status is Status.NO_BOUND
    found = ended.value.solution
    assert (np.abs(found.value - whole.value) <= found.state_error + whole.state_error).all()


def test_too_few_iterations_name_all_that_goes_on() -> None:
    with pytest.raises(SolverError, match=r"PolicyIteration.*certify\(\)"):
        solve(NEAR_ONE[0], ModifiedPolicyIteration(tol=1e-9, max_iterations=2))


@pytest.mark.parametrize("make", SMALL)
@pytest.mark.parametrize("count", [1, 3])
def test_compiled_rounds_may_be_cut_anywhere(
    make: Callable[[], MDP], count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweeps_module, "COMPILED", 0)
    mdp = make()
    whole = solve(mdp, ModifiedPolicyIteration())
    with pytest.raises(SolverError) as stopped:
        solve(mdp, ModifiedPolicyIteration(max_iterations=whole.iterations - 1))
    monkeypatch.setattr(stopping_module, "ROUNDS", count)
    cut = solve(mdp, ModifiedPolicyIteration())
    assert cut.iterations == whole.iterations
    assert cut.stats == whole.stats
    assert cut.value.tobytes() == whole.value.tobytes()
    assert stopped.value.solution.iterations == whole.iterations - 1


@pytest.mark.parametrize("tol", [None, 1e-6])
@pytest.mark.parametrize("make", LARGER)
def test_rounds_of_larger_models_are_those_of_python(
    make: Callable[[], MDP], tol: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for alone in (True, False):
        mdp = make()
        assert mdp.n_transitions >= COMPILED
        monkeypatch.setattr(CompiledSweeps, "alone", alone)
        one = solve(mdp, ModifiedPolicyIteration(tol=tol))
        told = [part.tobytes() for part in (one.value, one.pairs, one.state_error)]
        found.append((one.iterations, one.stats, told))
    assert found[0] == found[1]


def test_values_beyond_floats_are_noticed(mdp: MDP) -> None:
    for sweeps in both(mdp):
        for wrong in (np.inf, np.nan, 1.7e308):
            value = values(mdp, 11)
            value[[3, 5]] = wrong, -wrong
            with pytest.raises(SolverError, match="beyond the range of floats"):
                sweeps.judge(value)


@pytest.mark.parametrize("states", [1_000, 2_000])
def test_what_values_have_in_common_costs_no_digits(states: int) -> None:
    """Policies on the way are worth a thousand times the optimum; it is reached all the same."""
    mdp = queue(states).model()
    assert (mdp.n_transitions > COMPILED) == (states == 2_000)
    solution = solve(mdp, ModifiedPolicyIteration(tol=1e-6))  # a warning would be an error
    assert solution.error_bound <= 1e-6


@pytest.mark.parametrize("twice", [False, True])
def test_rounding_is_allowed_for_as_in_numpy(twice: bool) -> None:
    """Around the optimum the bounds are made of rounding errors, term by term."""
    mdp = garnet(40, seed=23)
    mdp = uneven(mdp, 23) if twice else mdp
    value = solve(mdp, PolicyIteration()).value.copy()
    slow, fast = (sweeps.judge(value) for sweeps in both(mdp))
    assert 0 < fast.high - fast.low < 1e-11
    assert fast.high - fast.low == pytest.approx(slow.high - slow.low, rel=0.02, abs=0)


def test_rewards_are_rounded_too() -> None:
    """Of equal rewards and values nothing is left but what rounding a reward may cost."""
    rows = [np.full((7, 7), F(1, 7))] * 2
    mdp = MDP.from_arrays(rows, np.full(7, F(1, 3)), "9/10")
    slow, fast = (sweeps.judge(np.full(7, 10 / 3)) for sweeps in both(mdp))
    assert (fast.low, fast.high) == (slow.low, slow.high)
    assert fast.low < fast.high


def test_a_correction_that_goes_astray_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    mdp = garnet(30, seed=25, discount="999/1000")
    iterate = Iterate(Sweeps(mdp, margin_weights(mdp)), values(mdp, 26))
    iterate.improve()
    before, shift = iterate.value.copy(), iterate.shift
    monkeypatch.setattr(LinearSystem, "roughly", lambda self, constant: 1e6 * constant)
    iterate._correct(1e-9)
    assert (iterate.value == before).all()
    assert iterate.shift == shift


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_a_policy_counts_as_evaluated_only_once_its_values_are_near(data: st.DataObject) -> None:
    """Against the equations solved: states that still change alike are not near."""
    living = data.draw(st.integers(1, 4))
    rng = np.random.default_rng(data.draw(st.integers(0, 10**6)))
    last, ending = np.zeros(living + 1), data.draw(st.sampled_from([1e-6, 0.3]))
    last[-1] = 1.0
    rows = rng.dirichlet(np.ones(living), living) * (1 - ending)
    rows = np.vstack([np.column_stack([rows, np.full(living, ending)]), last])
    reward = np.append(rng.normal(3, data.draw(st.sampled_from([0.0, 1.0])), living), 0.0)
    discount = data.draw(st.sampled_from([0.9, 0.999, 1 - 1e-7]))
    mdp = MDP.from_arrays([rows], reward[:, None], discount=discount)
    equations = np.eye(living) - mdp.discount * mdp.transition.toarray()[:living, :living]
    exact = np.append(np.linalg.solve(equations, reward[:living]), 0.0)
    goal = data.draw(st.sampled_from([1e-1, 1e-3])) * np.abs(exact).max()
    for kind in (Sweeps, CompiledSweeps):
        sweeps = kind(mdp, margin_weights(mdp))
        value = np.append(1.0 + np.arange(living), 0.0)
        sweeps.improve(value)
        done, _ = sweeps.settle(value, 0.0, goal / sweeps.weights.value.max(), 100)
        assert not done or np.abs(value - exact).max() <= goal * (1 + 1e-6)
        fresh = Iterate(sweeps, np.append(1.0 + np.arange(living), 0.0), slow=True)
        fresh.improve()
        fresh.evaluate(goal / sweeps.weights.value.max(), 0)
        assert np.abs(fresh.value - exact).max() <= goal * (1 + 1e-6)


@pytest.mark.parametrize("discount", ["999/1000", "99999/100000", "9999999/10000000"])
@pytest.mark.parametrize("tol", [None, 1e-3, 1e-9])
@pytest.mark.parametrize("reward", [1.1, 100002.12593686389])
def test_one_living_state_is_solved_at_once(
    discount: str, tol: float | None, reward: float
) -> None:
    """V = r / (1 - γ); values that all change alike are no sign that they are reached."""
    stay, go = [[1, 0], [0, 1]], [[0.5, 0.5], [0, 1]]
    mdp = MDP.from_arrays([stay, go], [[reward, 1], [0, 0]], discount, layout="ass")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = solve(mdp, tol=tol)
    exact = F(reward) / (1 - F(discount))
    assert abs(F(float(found.value[0])) - exact) <= F(float(found.error_bound))
    assert found.error_bound <= 1e-9 * exact
    assert found.iterations <= 25
