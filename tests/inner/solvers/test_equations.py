"""Fixed points x = c + γ P x: their error bounds, elimination, and Krylov methods."""

import pickle
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_twins import factor_pattern
from oracle import evaluate_exact
from strategies import Rows, exact_values, models

from exact_mdp import (
    MDP,
    BackwardInduction,
    LinearProgram,
    SolverError,
    Status,
    certify,
    evaluate,
    solve,
)
from exact_mdp.mdp.graph import topological_levels
from exact_mdp.solvers.bounds import elimination, linear
from exact_mdp.solvers.bounds.elimination import (
    TooLarge,
    band,
    fill,
    matrix_of,
    reach,
    sparse,
    substitution,
)
from exact_mdp.solvers.bounds.gains import UNIT
from exact_mdp.solvers.bounds.linear import (
    FixedPoint,
    LinearSystem,
    patiently,
    policy_chain,
    quickly,
    relatively,
    sweeping,
)
from exact_mdp.solvers.kernels import linear as krylov
from exact_mdp.solvers.kernels.linear import Rows as Packed


def chains(seed: int, *, lower: int = 9, upper: int = 9, density: float = 0.5) -> sp.csr_array:
    """A random chain of a few states that leaks, its transitions within a band."""
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 14))
    found = rng.random((size, size)) * (rng.random((size, size)) < density)
    found = np.triu(np.tril(found, upper), -lower)
    found *= rng.uniform(0.1, 0.999) / max(1.0, found.sum(axis=1).max())
    return sp.csr_array(found)


@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.integers(0, 4))
def test_a_band_is_eliminated(seed: int, lower: int, upper: int) -> None:
    chain = chains(seed, lower=lower, upper=upper)
    down, up = reach(chain)
    assert (down, up) <= (lower, upper) or (down <= lower and up <= upper)
    constant = np.random.default_rng(seed).normal(size=chain.shape[0])
    for threshold in (0, 10**6):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(elimination, "COMPILED", threshold)
            assert reach(chain) == (down, up)
            order = np.random.default_rng(seed + 1).permutation(chain.shape[0])
            assert reach(chain, order) == reach(sp.csr_array(chain[order][:, order]))
            value = band(chain, 0.9, (down, up))(constant)
        assert np.allclose(value - 0.9 * (chain @ value), constant, rtol=0, atol=1e-12)


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_substitution_along_an_order(seed: int, large: bool) -> None:
    rng = np.random.default_rng(seed)
    chain = sp.csr_array(np.tril(chains(seed).toarray(), -1))
    size = chain.shape[0]
    place, constant = rng.permutation(size), rng.normal(size=size)
    mixed = sp.csr_array(chain[place][:, place])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(elimination, "COMPILED", 0 if large else 10**6)
        value = elimination.substitution(mixed, 0.9, place * 3)(constant)
        assert np.allclose(value - 0.9 * (mixed @ value), constant, rtol=0, atol=1e-13)
        if mixed.nnz:
            with pytest.raises(ValueError, match="order"):
                elimination.substitution(mixed, 0.9, -place)


@given(st.integers(0, 2**32 - 1), st.floats(0, 0.6))
def test_the_fill_is_that_of_the_symmetric_pattern(seed: int, density: float) -> None:
    matrix = matrix_of(chains(seed, density=density), 0.9)
    pattern = factor_pattern(matrix.toarray() != 0)
    assert fill(matrix.tocsc()) == np.tril(pattern).sum()


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_sparse_factors_solve_in_either_order(seed: int, large: bool) -> None:
    chain = chains(seed, density=0.2)
    constant = np.random.default_rng(seed).normal(size=chain.shape[0])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(elimination, "COMPILED", 0)
        patch.setattr(elimination, "MOST_ORDERED", 0 if large else 10**6)
        value = sparse(chain, 0.9)(constant)
    assert np.allclose(value - 0.9 * (chain @ value), constant, rtol=0, atol=1e-12)


@pytest.mark.parametrize("ordered", [0, 10**6])
@pytest.mark.parametrize("kind", ["random", "ring", "hub", "grid"])
def test_factors_are_no_larger_than_foretold(
    monkeypatch: pytest.MonkeyPatch, kind: str, ordered: int
) -> None:
    """Numbered at random, so that the order has to be found."""
    import scipy.sparse.linalg

    size, rng = 900, np.random.default_rng(3)
    state, ahead = np.arange(size), (np.arange(size) + 1) % size
    if kind == "random":
        chain = sp.random_array((size, size), density=3 / size, rng=rng, format="csr")
    elif kind == "grid":
        line = sp.diags_array([np.ones(29)] * 2, offsets=[-1, 1])
        chain = sp.csr_array(sp.kron(line, sp.eye_array(30)) + sp.kron(sp.eye_array(30), line))
    else:
        back = state if kind == "ring" else np.zeros_like(state)
        columns = np.concatenate([ahead, back])
        chain = sp.csr_array((np.ones(2 * size), (np.tile(state, 2), columns)), (size, size))
    places = rng.permutation(size)
    chain = sp.csr_array(chain[places][:, places])
    chain.data *= 0.999 / chain.sum(axis=1).max()
    foretold, made, inner = [], [], scipy.sparse.linalg.splu
    monkeypatch.setattr(elimination, "COMPILED", 0)
    monkeypatch.setattr(elimination, "MOST_ORDERED", ordered)
    monkeypatch.setattr(
        elimination, "fill", lambda matrix: foretold.append(fill(matrix)) or foretold[0]
    )
    monkeypatch.setattr(
        elimination.linalg, "splu", lambda *of, **how: made.append(inner(*of, **how)) or made[0]
    )
    value = sparse(chain, 1.0)(np.ones(size))
    assert np.abs(value - chain @ value - 1).max() < 1e-9
    assert max(made[0].L.nnz, made[0].U.nnz) <= foretold[0]
    if kind in ("ring", "hub"):
        assert foretold[0] <= 5 * size


@pytest.mark.parametrize("limit", ["MOST_ENTRIES", "MOST_OPERATIONS"])
def test_factors_that_would_be_too_large_are_refused(
    monkeypatch: pytest.MonkeyPatch, limit: str
) -> None:
    rng = np.random.default_rng(4)
    after = rng.integers(0, 30_000, (30_000, 10)).ravel()
    chain = sp.csr_array((np.full(300_000, 0.0999), after, np.arange(0, 300_001, 10)))
    with pytest.raises(TooLarge, match=r"30,000 equations .* more than 2\.4 GB or 1e\+11"):
        sparse(chain, 1.0)
    small = sp.csr_array(np.full((6, 6), 0.1))
    monkeypatch.setattr(elimination, "COMPILED", 0)
    exact = {"MOST_ENTRIES": 21, "MOST_OPERATIONS": 91}[limit]  # 6 + 5 + …, and 36 + 25 + …
    monkeypatch.setattr(elimination, limit, exact)
    assert np.allclose(sparse(small, 1.0)(np.ones(6)), 2.5)
    monkeypatch.setattr(elimination, limit, exact - 1)
    with pytest.raises(TooLarge):
        sparse(small, 1.0)


@pytest.mark.parametrize("threshold", [0, 10**6])
@pytest.mark.parametrize("how", ["band", "sparse"])
def test_a_singular_system_is_refused(
    monkeypatch: pytest.MonkeyPatch, how: str, threshold: int
) -> None:
    chain = sp.csr_array([[0.5, 0.5], [0.5, 0.5]])
    monkeypatch.setattr(elimination, "COMPILED", threshold)
    with pytest.raises(SolverError, match="elimination failed"):
        band(chain, 1.0, (1, 1)) if how == "band" else sparse(chain, 1.0)


def fixed_point(
    chain: sp.csr_array, constant: np.ndarray, discount: float = 1.0, **more: object
) -> FixedPoint:
    error = more.pop("constant_error", 0.0)
    return LinearSystem(chain, discount, **more).solve(constant, error)


def choices(rows: Rows, data: st.DataObject) -> dict[int, int]:
    offered = {s: [a for t, a, *_ in rows.pairs if t == s] for s in range(rows.n_states)}
    return {s: data.draw(st.sampled_from(actions)) for s, actions in offered.items()}


@given(models(), st.data())
def test_the_value_of_a_policy_lies_within_the_error(rows: Rows, data: st.DataObject) -> None:
    policy, mdp = choices(rows, data), rows.model()
    exact = evaluate_exact(rows.n_states, rows.pairs, rows.discount, policy)
    chain, reward = policy_chain(mdp, np.array([mdp.pair(s, a) for s, a in policy.items()]))
    error = 2.0**-53 * np.abs(reward)
    order = topological_levels(mdp)
    found = fixed_point(chain, reward, mdp.discount, order=order, constant_error=error)
    for x, value, bound in zip(exact, exact_values(found.value), found.error, strict=True):
        assert abs(x - value) <= F(float(bound))
    size = max(map(abs, exact)) + max(abs(r) for _, _, r, _ in rows.pairs)
    assert found.error.max() <= 1e-9 * float(size)


@given(models(), st.data())
def test_visits_weigh_rewards_to_the_value(rows: Rows, data: st.DataObject) -> None:
    policy, mdp = choices(rows, data), rows.model()
    chain, reward = policy_chain(mdp, np.array([mdp.pair(s, a) for s, a in policy.items()]))
    start = np.full(mdp.n_states, 1 / mdp.n_states)
    order = topological_levels(mdp)
    value = fixed_point(chain, reward, mdp.discount, order=order)
    back = None if order is None else -order
    visits = fixed_point(sp.csr_array(chain.T), start, mdp.discount, order=back)
    difference = abs(start @ value.value - visits.value @ reward)
    allowed = start @ value.error + visits.error @ np.abs(reward)
    assert difference <= allowed + 1e-12 * (np.abs(reward) @ visits.value)


def slow_walk(side: int) -> sp.csr_array:
    """A walk on a square, from whose edge it falls off."""
    line = sp.diags_array([np.full(side - 1, 0.25)] * 2, offsets=[-1, 1])
    eye = sp.eye_array(side)
    return sp.csr_array(sp.kron(line, eye) + sp.kron(eye, line))


def test_all_ways_of_solving_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    size = 600
    rng = np.random.default_rng(7)
    chain = sp.random_array((size, size), density=0.01, rng=rng, format="csr")
    chain = sp.csr_array(sp.triu(chain, k=1))
    chain.data /= np.repeat(chain.sum(axis=1), np.diff(chain.indptr)) * 1.01
    constant = rng.normal(size=size)
    order = np.arange(size)[::-1]
    ways = [fixed_point(chain, constant, order=order), fixed_point(chain, constant)]
    monkeypatch.setattr(linear, "DIRECT_STATES", size)
    ways.append(fixed_point(chain, constant))
    for one in ways:
        assert one.error.max() < 1e-11
        for other in ways:
            assert (np.abs(one.value - other.value) <= one.error + other.error).all()


@pytest.mark.parametrize("side", [40, 90])
def test_a_slowly_mixing_chain_is_solved_by_elimination(
    monkeypatch: pytest.MonkeyPatch, side: int
) -> None:
    chain = slow_walk(side)
    assert (LinearSystem(chain)._direct is not None) == (side == 40)  # small and banded enough
    monkeypatch.setattr(linear, "CHEAP", 0)
    monkeypatch.setattr(linear, "STEPS", 5)
    monkeypatch.setattr(linear, "COMPILED", 0)
    system = LinearSystem(chain)
    found = system.solve(np.ones(side**2))
    assert "_last_resort" in vars(system)
    assert found.error.max() < 1e-8
    monkeypatch.setattr(linear, "STEPS", 4000)
    other = LinearSystem(chain)
    same = other.solve(np.ones(side**2))
    assert "_last_resort" not in vars(other)
    assert (np.abs(found.value - same.value) <= found.error + same.error).all()


@pytest.mark.parametrize(("room", "enough"), [(20, True), (0.5, False)])
def test_small_chains_are_eliminated_in_little_room_or_iterated(
    monkeypatch: pytest.MonkeyPatch, room: float, enough: bool
) -> None:
    """Where SuperLU drops entries for want of room, the residual tells, and iteration answers."""
    chain = slow_walk(40)
    known = LinearSystem(chain).solve(np.ones(1600))
    monkeypatch.setattr(linear, "CHEAP", 0)
    monkeypatch.setattr(elimination, "ROOM", room)
    system, iterated = LinearSystem(chain), list[int]()
    inner = linear.quickly
    monkeypatch.setattr(linear, "quickly", lambda *of: iterated.append(1) or inner(*of))
    found = system.solve(np.ones(1600))
    assert (not iterated) == enough
    assert (np.abs(found.value - known.value) <= found.error + known.error).all()


def test_where_factors_would_be_too_large_iteration_has_patience(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    chain = slow_walk(90)
    known = LinearSystem(chain).solve(np.ones(8100))
    monkeypatch.setattr(elimination, "MOST_ENTRIES", 10_000)
    monkeypatch.setattr(linear, "STEPS", 5)
    system = LinearSystem(chain)
    found = system.solve(np.ones(8100))
    assert isinstance(vars(system)["_last_resort"], TooLarge)
    assert found.error.max() < 1e-8
    assert (np.abs(found.value - known.value) <= found.error + known.error).all()
    monkeypatch.setattr(linear, "GMRES_STEPS", 5)
    monkeypatch.setattr(linear, "PATIENT", 5)
    with pytest.raises(TooLarge, match=r"8,100 equations with 32,040 .* number the states") as told:
        system.roughly(np.ones(8100))
    assert told.value.status is Status.TOO_LARGE
    assert str(pickle.loads(pickle.dumps(told.value))) == str(told.value)


def weak_clusters(states: int, clusters: int, leak: float) -> sp.csr_array:
    """Random clusters that are left for anywhere with a small probability."""
    rng, size = np.random.default_rng(5), states // clusters
    near = np.repeat(np.arange(clusters) * size, size)[:, None] + rng.integers(
        size, size=(states, 6)
    )
    after = np.concatenate([near, rng.integers(states, size=(states, 1))], axis=1)
    chance = rng.dirichlet(np.ones(6), states) * (1 - leak)
    chance = np.concatenate([chance, np.full((states, 1), leak)], axis=1)
    chain = sp.csr_array((chance.ravel(), after.ravel(), np.arange(0, 7 * states + 1, 7)))
    chain.sum_duplicates()
    return chain


def test_a_chain_that_falls_apart_is_solved_without_large_factors() -> None:
    chain, rate = weak_clusters(10_000, 50, 1e-6), 0.999999
    system = LinearSystem(chain, rate)
    constant = np.random.default_rng(6).random(10_000)
    found = system.solve(constant)
    made = vars(system).get("_last_resort")  # of some 25 million entries, and more
    assert made is None or isinstance(made, TooLarge)
    assert found.error.max() < 1e-6 * np.abs(found.value).max()
    assert np.abs(constant + rate * (chain @ found.value) - found.value).max() < 1e-8


@pytest.mark.parametrize("rate", [0.9, 0.999, 1 - 1e-12])
@pytest.mark.parametrize("off", [0.0, 1e-10])
def test_values_relative_to_a_state_often_visited(rate: float, off: float) -> None:
    """V = h + k for some k, as dense equations say."""
    rng = np.random.default_rng(9)
    chain, constant = rng.dirichlet(np.ones(12), 12), rng.normal(size=12)
    chain[::2] *= 1 - off
    leak = 1 - rate + rate * off * (np.arange(12) % 2 == 0)
    found = relatively(LinearSystem(sp.csr_array(chain), rate), leak)(constant)
    assert np.abs(found).min() < 1e-14
    value = np.linalg.solve(np.eye(12) - rate * chain, constant)
    lost = 1e-14 / leak.min()  # by dense equations
    assert np.ptp(found - value) <= lost * np.abs(value).max()


@pytest.mark.parametrize("states", [3, 9_000])
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_a_constant_that_is_no_number_is_refused(states: int, wrong: float) -> None:
    chain = sp.csr_array(sp.diags_array([np.full(states - 1, 0.3)] * 2, offsets=[-1, 1]))
    far = sp.csr_array(([0.1] * 2, ([0, 1], [states - 1] * 2)), chain.shape)
    for each in (chain, sp.csr_array(chain + far)):
        constant = np.ones(states)
        constant[1] = wrong
        with pytest.raises(SolverError, match="range of floats"):
            fixed_point(each, constant)


@given(st.integers(0, 2**32 - 1))
def test_methods_for_large_chains_are_right_to_their_error(seed: int) -> None:
    """Each against rational arithmetic, on chains small enough for it."""
    rng = np.random.default_rng(seed)
    size = int(rng.integers(2, 9))
    parts = rng.integers(0, 4, (size, size)).tolist()
    least = int(rng.integers(1, 4))
    whole = max(map(sum, parts)) + least
    rows = [{to: F(part, whole) for to, part in enumerate(row) if part} for row in parts]
    chain = sp.csr_array(np.array([[part / whole for part in row] for row in parts]))
    constant = rng.integers(-5, 6, size).astype(float)
    pairs = [
        (s, 0, F(int(constant[s])), row | {size: 1 - sum(row.values())})
        for s, row in enumerate(rows)
    ]
    pairs.append((size, 0, F(0), {size: F(1)}))
    known = evaluate_exact(size + 1, pairs, F(1), dict.fromkeys(range(size + 1), 0))[:size]
    with pytest.MonkeyPatch.context() as patch:
        for module in (elimination, linear):
            patch.setattr(module, "COMPILED", 0)
        for most, direct in ((-1, 0), (-1, 500), (100, 0)):
            patch.setattr(linear, "MOST_FILL", most)
            patch.setattr(linear, "DIRECT_STATES", direct)
            found = fixed_point(chain, constant)
            for x, value, bound in zip(known, exact_values(found.value), found.error, strict=True):
                assert abs(x - value) <= F(float(bound))
            assert found.error.max() < 1e-9


@pytest.mark.parametrize(
    "chain",
    [
        sp.csr_array([[1.0]]),
        sp.csr_array([[0.0, 1.0], [1.0, 0.0]]),
        sp.csr_array([[0.5, 0.4], [0.9, 0.6]]),
        sp.csr_array([[1 - 2.0**-53]]),
    ],
)
def test_a_chain_that_does_not_leak_is_refused(chain: sp.csr_array) -> None:
    with pytest.raises(SolverError, match="certify"):
        fixed_point(chain, np.ones(chain.shape[0]))


def test_a_wrong_order_is_refused() -> None:
    chain = sp.csr_array([[0.0, 0.5], [0.0, 0.0]])
    assert fixed_point(chain, np.ones(2), order=np.array([1, 0])).value.tolist() == [1.5, 1.0]
    with pytest.raises(ValueError, match="order"):
        fixed_point(chain, np.ones(2), order=np.array([0, 1]))


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused_at_once(wrong: float) -> None:
    chain = sp.csr_array(np.array([[0.5, wrong], [0.0, 0.0]]))
    with pytest.raises(ValueError, match="not a finite number"):
        fixed_point(chain, np.ones(2))
    with pytest.raises(ValueError, match="not a finite number"):
        fixed_point(sp.csr_array(np.eye(2) / 2), np.ones(2), wrong)


def test_a_chain_is_square_and_has_states() -> None:
    for shape in ((0, 0), (2, 3)):
        with pytest.raises(ValueError, match="not those of a chain"):
            fixed_point(sp.csr_array(shape), np.ones(shape[0]))


def packed(chain: sp.csr_array) -> Packed:
    return Packed(chain.indptr, chain.indices, chain.data)


def solved(
    chain: sp.csr_array, rate: float, constant: np.ndarray, steps: int
) -> tuple[int, np.ndarray]:
    value, room = np.full(len(constant), np.nan), np.full((6, len(constant)), np.nan)
    return krylov.bicgstab(packed(chain), rate, constant, 1e-12, steps, value, room), value


def shuffled(chain: sp.csr_array, seed: int = 1) -> sp.csr_array:
    places = np.random.default_rng(seed).permutation(chain.shape[0])
    return sp.csr_array(chain[places][:, places])


@given(st.integers(0, 2**32 - 1))
def test_small_systems_are_solved(seed: int) -> None:
    rng, chain = np.random.default_rng(seed), chains(seed)
    size = chain.shape[0]
    constant = np.where(rng.random(size) < 0.3, 0.0, rng.normal(size=size))
    taken, value = solved(chain, 0.95, constant, 200)
    assert taken >= 0
    exact = np.linalg.solve(np.eye(size) - 0.95 * chain.toarray(), constant)
    assert np.abs(value - exact).max() < 1e-9


@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_gauss_seidel_both_ways_is_the_product_that_it_stands_for(seed: int, dense: float) -> None:
    rng, chain = np.random.default_rng(seed), chains(seed, density=dense)
    size = chain.shape[0]
    matrix = np.eye(size) - 0.9 * chain.toarray()
    lower, upper, diagonal = np.tril(matrix), np.triu(matrix), np.diag(np.diag(matrix))
    given_, found, through = rng.normal(size=size), np.full(size, np.nan), np.full(size, np.nan)
    krylov.applied(packed(chain), 0.9, given_, found, through)
    assert np.allclose(lower @ np.linalg.solve(diagonal, upper @ found), given_, atol=1e-12)
    assert np.allclose(through, matrix @ found, atol=1e-12)


def test_columns_need_not_be_sorted() -> None:
    rng = np.random.default_rng(8)
    columns = np.stack([rng.permutation(9_000)[:3] for _ in range(9_000)])
    rowed = (np.full(27_000, 0.3), columns.ravel(), np.arange(0, 27_001, 3))
    found = quickly(sp.csr_array(rowed), 0.999, np.ones(9_000), 1e-12)
    assert found is not None
    assert np.abs(found - 1 / (1 - 0.9 * 0.999)).max() < 1e-9


def test_a_random_chain_takes_few_steps_and_too_few_are_noticed() -> None:
    rng = np.random.default_rng(12)
    after, chance = rng.integers(0, 9_000, 54_000), rng.dirichlet(np.ones(6), 9_000).ravel()
    chain = sp.csr_array((chance, after, np.arange(0, 54_001, 6)))
    chain.sum_duplicates()
    constant = rng.normal(size=9_000)
    taken, value = solved(chain, 0.999, constant, 100)
    assert 0 < taken < 30
    assert np.linalg.norm(value - 0.999 * (chain @ value) - constant) < 1e-8
    assert solved(chain, 0.999, constant, 1)[0] == -1


@pytest.mark.parametrize(
    "chain",
    [
        [[0.25, 0.5, 0.0], [0.25, 0.0, 0.25], [0.0, 0.25, 0.125]],
        [[0.0, 0.5, 0.0], [0.25, 0.0, 0.5], [0.125, 0.5, 0.0]],
    ],
)
def test_bicgstab_starts_again_where_it_breaks_down(chain: list[list[float]]) -> None:
    """Here the residual comes to be orthogonal to the first one, after two steps at most."""
    constant, matrix = np.array([-1.0, 0.0, 0.0]), np.array(chain)
    taken, value = solved(sp.csr_array(matrix), 1.0, constant, 60)
    assert 3 <= taken <= 5
    assert np.abs(constant - value + matrix @ value).max() < 1e-11


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    leaks=st.booleans(),
    turned=st.booleans(),
    rate=st.sampled_from([0.5, 0.95, 0.9999]),
)
def test_sweeps_solve_what_mixes_soon(seed: int, leaks: bool, turned: bool, rate: float) -> None:
    """Their residual is what was asked for; a constant in all states is no reason for more."""
    rng = np.random.default_rng(seed)
    chain = rng.dirichlet(np.ones(30), 30) * (rng.uniform(0.2, 0.6) if leaks else 1.0)
    chain = chain.T if turned else chain  # the equations of visits
    constant = rng.normal(size=30) + rng.choice([0.0, 100.0])
    constant /= np.abs(constant).max()
    found = sweeping(sp.csr_array(chain), rate, constant, 1e-11)
    assert found is not None
    left = constant + rate * (chain @ found) - found
    assert np.abs(left).max() <= 1e-11 + 1e-14 / (1 - rate)


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    turned=st.booleans(),
    rate=st.sampled_from([0.0, 0.5, 0.95, 0.9999, 1.0]),
    fine=st.sampled_from([0.0, 2.0**-51]),
    breadth=st.sampled_from([1, 3, 30]),
)
def test_sweeps_are_the_same_compiled_and_not(
    seed: int, turned: bool, rate: float, fine: float, breadth: int
) -> None:
    """Bit for bit; those that are fine leave a residual that is rounding alone."""
    rng = np.random.default_rng(seed)
    chain = rng.dirichlet(np.ones(30), 30) * (rng.random((30, 30)) < breadth / 30)
    chain /= np.where(chain.any(axis=1), chain.sum(axis=1), 1.0)[:, None]
    matrix = sp.csr_array(chain.T if turned else chain)
    constant = np.clip(rng.normal(size=30), -1, 1)
    found = []
    for threshold in (0, 10**6):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(linear, "COMPILED", threshold)
            found.append(sweeping(matrix, rate, constant, 1e-9, fine))
    assert (found[0] is None) == (found[1] is None)
    if found[0] is not None and found[1] is not None:
        assert np.array_equal(*found)
        left = np.abs(constant + rate * (matrix @ found[0]) - found[0]).max()
        assert left <= (64 * UNIT * max(1.0, np.abs(found[0]).max()) if fine and rate < 1 else 2e-9)


@pytest.mark.parametrize("shuffle", [False, True])
def test_a_ring_is_eliminated_within_a_band(shuffle: bool) -> None:
    """Its wrap-around is no reason for dense factors: there is an order with a narrow band."""
    size = 700
    ring = sp.csr_array(0.5 * np.eye(size) + 0.5 * np.roll(np.eye(size), 1, axis=1))
    chain = shuffled(ring) if shuffle else ring
    system, constant = LinearSystem(chain, 0.99999), np.random.default_rng(4).normal(size=size)
    assert system.work > 0
    assert max(reach(chain)) > size / 2
    found = system.solve(constant)
    exact = np.linalg.solve(np.eye(size) - 0.99999 * chain.toarray(), constant)
    assert (np.abs(found.value - exact) <= found.error + 1e-9).all()
    assert found.error.max() < 1e-6


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), rate=st.sampled_from([F(1, 2), F(19, 20), F(9999, 10000)]))
def test_an_error_bound_that_takes_no_equations_holds(seed: int, rate: F) -> None:
    """It is no more than `ALIKE` times what the equations of the error would give."""
    rng = np.random.default_rng(seed)
    chain = sp.csr_array(rng.dirichlet(np.ones(6), 6).round(3))
    chain = sp.csr_array(chain / np.maximum(chain.sum(axis=1), 1.0)[:, None])
    system, excess = LinearSystem(chain, float(rate)), rng.uniform(0.5, 1, 6) ** 3
    error = system._dominating(excess)
    entries = [[F(x) for x in row] for row in chain.toarray()]
    left = [
        F(e) - F(float(rate)) * sum((p * F(x) for p, x in zip(row, error, strict=True)), F(0))
        for e, row in zip(error, entries, strict=True)
    ]
    assert all(have >= F(need) for have, need in zip(left, excess, strict=True))
    least = np.linalg.solve(np.eye(6) - float(rate) * chain.toarray(), excess)
    assert (error <= (linear.ALIKE + 0.1) * least).all()


def test_sweeps_that_would_be_too_many_end_early() -> None:
    ring = sp.csr_array(0.5 * (np.eye(600) + np.roll(np.eye(600), 1, axis=1)))
    constant = np.random.default_rng(3).normal(size=600)
    assert sweeping(ring, 0.9999, constant / np.abs(constant).max(), 1e-11) is None


def test_what_never_ends_is_not_taken_for_solved() -> None:
    for chain in (np.eye(2), np.array([[0.0, 1.0], [1.0, 0.0]]), np.full((3, 3), 0.6)):
        size = len(chain)
        taken, value = solved(sp.csr_array(chain), 1.0, np.arange(1.0, size + 1), 50)
        assert taken == -1 or np.abs(np.arange(1.0, size + 1) - value + chain @ value).max() < 1e-9


def test_small_and_large_chains_are_iterated_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    chain = sp.csr_array(rng.dirichlet(np.ones(40), 40))
    constant = rng.normal(size=40)
    exact = np.linalg.solve(np.eye(40) - 0.99 * chain.toarray(), constant)
    for threshold in (0, 10**6):
        monkeypatch.setattr(linear, "COMPILED", threshold)
        for way in (quickly, patiently):
            found = way(chain, 0.99, constant, 1e-12)
            assert found is not None
            assert np.abs(found - exact).max() < 1e-9
    ring = shuffled(sp.csr_array(np.roll(np.eye(600), 1, axis=1)))
    for threshold in (0, 10**6):
        monkeypatch.setattr(linear, "COMPILED", threshold)
        monkeypatch.setattr(linear, "STEPS", 3)
        assert quickly(ring, 0.9999, rng.normal(size=600), 1e-12) is None


@pytest.fixture
def indices(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The index types of all matrices that SciPy's triangular solve is given."""
    found: list[Any] = []
    true = scipy.sparse.linalg.spsolve_triangular

    def watched(matrix: Any, *given: Any, **how: Any) -> Any:
        found.extend([matrix.indices.dtype, matrix.indptr.dtype])
        return true(matrix, *given, **how)

    monkeypatch.setattr(elimination.linalg, "spsolve_triangular", watched)
    return found


@pytest.mark.parametrize("kind", [np.int32, np.int64])
def test_a_triangular_solve_gets_cs_integers(kind: Any, indices: list[Any]) -> None:
    """SciPy before 1.17.1 raises a TypeError for wider indices: they are cast, whatever comes."""
    chain = sp.csr_array([[0.0, 0.5, 0.25], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
    chain.indices, chain.indptr = chain.indices.astype(kind), chain.indptr.astype(kind)
    found = substitution(chain, 0.5, np.array([2, 1, 0]))(np.array([1.0, 2.0, 4.0]))
    assert found.tolist() == [1 + 0.25 * 3 + 0.125 * 4, 3.0, 4.0]
    assert indices == [np.intc, np.intc]


def test_commands_that_solve_by_substitution_work(indices: list[Any]) -> None:
    """Solving, evaluating and certifying a small model without cycles hand over C's integers."""
    mdp = MDP.from_arrays([[[0, 1, 0], [0, 0, 1], [0, 0, 1]]], [1, 2, 0])
    assert evaluate(mdp, "random").mean == 3
    for solver in (BackwardInduction(), LinearProgram()):
        assert solve(mdp, solver).value.tolist() == [3, 2, 0]
    assert certify(mdp).value[0] == 3
    assert set(indices) <= {np.dtype(np.intc)}
