"""Discounts next to 1, slowly mixing chains, large models: runs end, and every bound is true."""

import os
import tracemalloc
from collections.abc import Callable
from fractions import Fraction as F
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from answers import agree, holds, quietly
from made_models import classes, garnet, gridworld, in_copies, sparse
from oracle import mixed, policy_values, rows_of
from strategies import model_of
from workloads import garnet as garnet_rows
from workloads import queue

from exact_mdp import (
    MDP,
    SOLVERS,
    BackwardInduction,
    ModifiedPolicyIteration,
    PolicyIteration,
    SolverError,
    Status,
    certify,
    check,
    evaluate,
    solve,
)

KINDS: list[Any] = [kind for kind in SOLVERS.values() if kind is not BackwardInduction]


# ---- models --------------------------------------------------------------------------------------


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


def corridor() -> MDP:
    """Each round of improvements may bring one state on."""
    go = np.eye(60)[[*range(1, 60), 59]]
    return MDP.from_arrays([np.eye(60), go], [0.0] * 59 + [1.0], discount=0.999)


def near_and_far(states: int, discount: str) -> MDP:
    """Stay, or go to one of three others: choices that are best for long and best for now."""
    here = np.arange(states)
    after = np.concatenate([(here + 1) % states, (7 * here + 3) % states, (13 * here + 5) % states])
    entries = (np.repeat([0.25, 0.25, 0.5], states), (np.tile(here, 3), after))
    go = sp.coo_array(entries, (states, states)).tocsr()
    reward = np.random.default_rng(0).normal(size=(states, 2))
    return MDP.from_arrays([sp.eye_array(states, format="csr"), go], reward, discount)


def living(nines: int, reward: float) -> MDP:
    """One state that lives: V = r / (1 - γ); all values change alike before they are reached."""
    stay, go = [[1, 0], [0, 1]], [[0.5, 0.5], [0, 1]]
    rate = 1 - F(1, 10**nines)
    return MDP.from_arrays([stay, go], [[reward, 1], [0, 0]], rate, layout="ass")


def walks(seed: int) -> MDP:
    """To either side, or not: a hundred sweeps tell that ten thousand would be too few."""
    rng = np.random.default_rng(seed)
    states = int(rng.integers(3, 8))
    after = (np.arange(states)[:, None] + rng.integers(-1, 2, (2, states, 2))) % states
    chances = np.eye(states)[after].mean(axis=2)
    return MDP.from_arrays(chances, rng.normal(size=(states, 2)), discount=1 - 1e-9)


OFF, OFTEN = 0.4999999999, [[0.5, 0.5, 0], [0.2, 0.7999999999, 0], [0, 0, 1]]
SMALL: dict[str, Callable[[], MDP]] = {
    **{f"off {d}": lambda d=d: MDP.from_arrays([[[0.5, 0.5], [0.5, OFF]]], [1, 2], discount=1 - d)
       for d in (1e-9, 1e-12)},
    **{f"often {d}": lambda d=d: MDP.from_arrays([OFTEN], [1, 2, 3], discount=1 - d)
       for d in (1e-12, 1e-13, 1e-14)},
    **{f"in circles {k}": lambda k=k: in_circles(1 - 2.0**-k) for k in (47, 50, 52)},
    **{f"beside an end {k}": lambda k=k: beside_an_end(k) for k in (25, 30, 40, 51)},
    **{f"living {k} {r}": lambda k=k, r=r: living(k, r)
       for k, r in product((3, 5, 7), (1.1, 100002.12593686389))},
    **{f"walks {seed}": lambda seed=seed: walks(seed) for seed in range(8)},
    "either way": lambda: either_way(1 - 2.0**-48),
    "ring": lambda: ring(5, 1 - 2.0**-52),
    "corridor": corridor,
    "queue": lambda: queue(60).model(),
    "grid": lambda: gridworld(6),
    "garnet": lambda: garnet(60, seed=31, discount="99/100"),
    "garnet that ends": lambda: garnet(40, seed=33, discount=1, ends=True),
    "garnet that ends late": lambda: garnet(200, seed=34, discount="999/1000", ends=True),
}  # fmt: skip
ORDINARY = ("corridor", "queue", "grid", "garnet")  # where sweeps alone take long


@cache
def small(name: str) -> MDP:
    return SMALL[name]()


@cache
def made(name: str, copies: int) -> tuple[MDP, Any]:
    return in_copies(small(name), copies)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("large", [False, True])
@pytest.mark.parametrize("name", SMALL)
def test_bounds_hold_and_runs_in_which_nothing_is_gained_end(
    name: str, large: bool, kind: Any
) -> None:
    """Around what rational arithmetic proves; copies make the same model large."""
    living, near_an_end = name.startswith("living"), name.startswith(("off", "beside"))
    tight = kind is ModifiedPolicyIteration if living else near_an_end and not large
    most = 26 if living else 200 if name.startswith("walks") else 300
    mdp, exact = made(name, 1 + large * 8000 // small(name).n_transitions)
    for tol in (None, 1e-3, 1e-9) if hasattr(kind, "tol") else (None,):
        try:
            solution = quietly(solve, mdp, kind() if tol is None else kind(tol=tol))
        except SolverError as error:  # an optimiser's own numbers end before those of floats
            if error.status is Status.PROGRAM_FAILED:
                return
            raise
        holds(solution, exact)
        assert solution.iterations < most or name.startswith(ORDINARY)
        if tight:
            assert solution.error_bound <= 1e-9 * max(1, np.abs(solution.value).max())


CLOSE: dict[str, tuple[Callable[[], MDP], float | None]] = {
    "classes, rare": (lambda: classes("rare", 1 - 1e-8), None),
    "classes, integers": (lambda: classes("int", 1 - 1e-9), None),
    "one way": (lambda: one_way(40, 2), None),
    "one way, tol": (lambda: one_way(60, 4), 1e-6),
    "ring": (lambda: ring(40, 1 - 1e-9, 1e5), None),
    "queue": (lambda: queue(3_000, 0.99).model(), 1e-6),
    "slow queue": (lambda: queue(3_000, 0.9999).model(), 1e-6),
}


@pytest.mark.parametrize("name", CLOSE)
def test_pairs_that_differ_by_little_are_told_apart(name: str) -> None:
    make, tol = CLOSE[name]
    model = make()
    solution, other = quietly(solve, model, tol=tol), quietly(solve, model, PolicyIteration())
    assert solution.iterations < (60 if "queue" in name else 500)
    assert solution.error_bound <= 1e-6 * max(1, np.abs(solution.value).max())
    assert agree(solution, other)


@pytest.mark.parametrize("discount", ["99/100", "999/1000", "9999/10000", "999999/1000000"])
@pytest.mark.parametrize("states", [400, 800, 3000, 6000])
def test_the_default_converges_whatever_the_size(states: int, discount: str) -> None:
    solution = solve(near_and_far(states, discount))
    assert solution.status is Status.CONVERGED
    assert solution.iterations < 100  # sweeps alone would take 20 / (1 - γ) of them


# ---- policies ------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("lost", [*(2.0**-k for k in (24, 30, 40, 48, 51)), 1e-8, 1e-9, 1e-12])
def test_policies_are_evaluated_as_closely_as_models_are_solved(lost: float, seed: int) -> None:
    """A policy and a mixed one, against rational arithmetic; rows of floats that miss 1, too."""
    rng = np.random.default_rng(seed)
    chances = rng.multinomial(16, [0.25] * 4, size=(2, 4)) / 16
    if seed % 2:
        chances[0, :, 0] -= 1e-10 * (chances[0, :, 0] > 0.1)
    mdp = MDP.from_arrays(chances, rng.integers(-3, 4, (4, 2)) * 1.0, discount=1 - lost)
    for weights in (np.eye(2)[[0] * 4], np.full((4, 2), 0.5)):
        shares = {key: F(share) for key, share in np.ndenumerate(weights) if share}
        chain = mixed(rows_of(mdp), shares)
        evaluation = evaluate(mdp, weights, kind="policy")
        holds(evaluation, policy_values(chain, mdp.discount_exact))
        alone = quietly(solve, model_of(4, chain, mdp.discount_exact))
        close = max(1e-9 * np.abs(alone.value).max(), alone.error_bound)
        assert evaluation.error_bound <= 2 * close


def test_a_mixed_policy_next_to_discount_1_fails_where_it_loses_more() -> None:
    states = np.arange(600)
    half = 0.5 - 2.0**-34  # rows of floats that sum to 1 - 2^-33 mean halves
    rows = np.repeat(np.arange(1200), 2), np.c_[states, (states + 1) % 600].repeat(2, 0).ravel()
    model = MDP.from_pairs(
        states.repeat(2), np.tile([0, 1], 600), sp.csr_array((np.full(2400, half), rows)),
        np.tile([0.0, -1.0], 600), discount=1 - 1e-8,
    )  # fmt: skip
    lost = F(1, 2) / (1 - F(1 - 1e-8))  # in all states alike, by half a step's -1
    mixed = np.full((600, 2), 0.5)
    assert not check(model, mixed, kind="policy", max_regret=lost - F(3, 1000)).passed
    assert check(model, mixed, kind="policy", max_regret=lost + F(3, 1000)).passed


def test_an_audit_that_bounds_leave_open_says_so() -> None:
    model = classes("int", 1 - 1e-6)
    actions = solve(model).policy.rule.copy()
    actions[5] = (actions[5] + 1) % 3
    lost = check(model, actions).regret.at_start
    audits = [check(model, actions, max_regret=lost.value + k * lost.error) for k in (-2, 0, 2)]
    verdicts = [(each.passed, each.undecided) for each in audits]
    assert verdicts == [(False, False), (False, True), (True, False)]
    assert "; failed: " in repr(audits[0])
    assert "; failed, left open: " in repr(audits[1])
    assert "the bounds do not decide" in audits[1].verdicts[0].text


# ---- chains of a policy, by every way that their equations are solved ---------------------------


def chain(rows: sp.csr_array, discount: object = 1) -> MDP:
    """A chain that earns 1 a step, numbered by chance; what its rows lack leads to the end."""
    size = rows.shape[0]
    order = np.random.default_rng(1).permutation(size)
    ends = 1 - np.asarray(rows.sum(axis=1)).ravel()
    ends[np.abs(ends) < 1e-12] = 0
    whole = sp.block_array([[rows[order][:, order], ends[order, None]], [None, np.eye(1)]])
    state = np.arange(size + 1)
    return MDP.from_pairs(
        state, 0 * state, sp.csr_array(whole), np.append(np.ones(size), 0), discount
    )


def walk(side: int) -> sp.csr_array:
    """A walk on a square, from whose edge it falls off."""
    line = sp.diags_array([np.full(side - 1, 0.25)] * 2, offsets=[-1, 1])
    return sp.csr_array(sp.kron(line, sp.eye_array(side)) + sp.kron(sp.eye_array(side), line))


def clusters(states: int, size: int, leak: float) -> sp.csr_array:
    """Random clusters that are left for anywhere with a small probability."""
    rng = np.random.default_rng(5)
    near = np.arange(states)[:, None] // size * size + rng.integers(size, size=(states, 6))
    after = np.concatenate([near, rng.integers(states, size=(states, 1))], axis=1)
    chance = rng.dirichlet(np.ones(6), states) * (1 - leak)
    chance = np.concatenate([chance, np.full((states, 1), leak)], axis=1)
    return sp.csr_array((chance.ravel(), after.ravel(), np.arange(0, 7 * states + 1, 7)))


def drawn(states: int, width: int, share: float) -> sp.csr_array:
    """Rows that lead anywhere, in no order."""
    rng = np.random.default_rng(8)
    after = np.stack([rng.choice(states, width, replace=False) for _ in range(states)]).ravel()
    chance = share * rng.dirichlet(np.ones(width), states).ravel()
    return sp.csr_array((chance, after, np.arange(0, width * states + 1, width)))


def around(states: int, ahead: float) -> sp.csr_array:
    eye = sp.eye_array(states, format="csr")
    return sp.csr_array((0.999 - ahead) * eye + ahead * eye[:, np.roll(np.arange(states), 1)])


CHAINS: dict[str, Callable[[], MDP]] = {
    "walk": lambda: chain(walk(40)),
    "long walk": lambda: chain(walk(90)),
    "clusters": lambda: chain(clusters(10_000, 200, 1e-6), "999999/1000000"),
    "few clusters": lambda: chain(clusters(600, 60, 1e-9), "999/1000"),
    "anywhere": lambda: chain(drawn(9_000, 3, 0.9), "999/1000"),
    "anywhere, slowly": lambda: chain(drawn(9_000, 6, 1.0), "99999/100000"),
    "ring": lambda: chain(around(700, 0.5)),
    "long ring": lambda: chain(around(60_000, 0.5)),
    "hub": lambda: chain(sp.csr_array(0.999 * (0.5 * around(900, 0.999) + sp.csr_array(
        (np.full(900, 0.5), (np.arange(900), np.zeros(900, int))), (900, 900))))),
}  # fmt: skip


@pytest.mark.parametrize("name", CHAINS)
def test_chains_of_any_shape_are_evaluated(name: str) -> None:
    """c = 1 - P 1 leaks: values are the numbers of steps, and their equations nearly hold."""
    mdp = CHAINS[name]()
    evaluation = evaluate(mdp, [0] * mdp.n_states)
    size = float(np.abs(evaluation.value).max())
    left = mdp.reward + mdp.discount * (mdp.transition @ evaluation.value) - evaluation.value
    assert np.abs(left[:-1]).max() < 1e-11 * max(1, size)
    assert evaluation.error_bound < 1e-6 * size
    if mdp.n_states < 1000:
        holds(evaluation, certify(mdp).value)
    assert agree(evaluation, solve(mdp, PolicyIteration()))


@pytest.mark.parametrize(
    "rows",
    [
        [[0.25, 0.5, 0.0, 0.25], [0.25, 0.0, 0.25, 0.5], [0.0, 0.25, 0.125, 0.625]],
        [[0.0, 0.5, 0.0, 0.5], [0.25, 0.0, 0.5, 0.25], [0.125, 0.5, 0.0, 0.375]],
    ],
)
def test_conjugate_gradients_that_break_down_start_again(rows: list[list[float]]) -> None:
    """Here the residual comes to be orthogonal to the first one, after two steps at most."""
    mdp, exact = in_copies(MDP.from_arrays([[*rows, [0, 0, 0, 1]]], [-1, 0, 0, 0]), 9_000)
    evaluation = evaluate(mdp, [0] * mdp.n_states)
    holds(evaluation, exact)
    assert evaluation.error_bound < 1e-9


# ---- resources -----------------------------------------------------------------------------------


def test_the_number_of_threads_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    mdp, seen = garnet(60_000, seed=9, discount="19/20"), []
    for threads in (1, 2):
        given = set(range(threads))
        monkeypatch.setattr(os, "sched_getaffinity", lambda _, given=given: given, raising=False)
        solutions = [solve(mdp, kind(tol=1e-6)) for kind in KINDS if hasattr(kind, "tol")]
        seen.append([part.tobytes() for one in solutions for part in (one.value, one.pairs)])
        assert all(agree(solutions[0], other) for other in solutions[1:])
    assert seen[0] == seen[1]


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


@pytest.mark.parametrize("states", [500, pytest.param(6000, marks=pytest.mark.slow)])
def test_discounts_next_to_1_leave_the_digits_that_tell_states_apart(states: int) -> None:
    """Values of 3e9 are found to 1, though 1e-7 of them is all that their equations keep."""
    mdp = near_and_far(states, "999999999/1000000000")
    solution, other = solve(mdp), solve(mdp, PolicyIteration())
    assert solution.status is Status.CONVERGED
    assert solution.iterations < 60
    assert solution.error_bound < 1 < 1e-9 * solution.value.max()
    assert agree(solution, other)
