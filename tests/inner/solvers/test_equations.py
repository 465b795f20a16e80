"""Fixed points x = c + γ P x: their error bounds, elimination, and Krylov methods."""

from fractions import Fraction as F

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import evaluate_exact
from strategies import Rows, exact_values, models

from exact_mdp import SolverError, Status
from exact_mdp.mdp.graph import topological_levels
from exact_mdp.solvers.bounds import linear
from exact_mdp.solvers.bounds.linear import FixedPoint, LinearSystem, policy_chain
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


WAYS = {
    "elimination": {"FEW": 10**6},
    "band": {"FEW": 0, "SPARSE": 0, "CHEAP": 1e18},
    "sweeps": {"FEW": 0, "SPARSE": 0, "CHEAP": 0, "NARROW": 0},
    "bicgstab": {"FEW": 0, "SPARSE": 0, "CHEAP": 0, "NARROW": 0, "SWEEPS": 1},
    "last resort": {"FEW": 0, "SPARSE": 0, "CHEAP": 0, "NARROW": 0, "SWEEPS": 1, "STEPS": 0},
}


@pytest.fixture(params=WAYS)
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Each way of solving, whatever the chain."""
    for name, limit in WAYS[request.param].items():
        monkeypatch.setattr(linear, name, limit)
    return request.param


@pytest.mark.parametrize("seed", range(40))
def test_each_way_is_right_to_its_error(way: str, seed: int) -> None:
    """Against rational arithmetic, numbered in any order."""
    rng = np.random.default_rng(seed)
    size = int(rng.integers(2, 9))
    parts = np.tril(rng.integers(0, 4, (size, size)), int(rng.integers(-1, size))).tolist()
    whole = max(map(sum, parts)) + int(rng.integers(1, 4))
    rows = [{to: F(part, whole) for to, part in enumerate(row) if part} for row in parts]
    chain = sp.csr_array(np.array([[part / whole for part in row] for row in parts]))
    constant = rng.integers(-5, 6, size).astype(float)
    pairs = [
        (s, 0, F(int(constant[s])), row | {size: 1 - sum(row.values())})
        for s, row in enumerate(rows)
    ]
    pairs.append((size, 0, F(0), {size: F(1)}))
    known = evaluate_exact(size + 1, pairs, F(1), dict.fromkeys(range(size + 1), 0))[:size]
    place = rng.permutation(size)
    falls = not sp.triu(chain).nnz
    turned = sp.csr_array(chain[place][:, place])
    for order in [None, place] if falls else [None]:
        found = fixed_point(turned, constant[place], order=order)
        exact = exact_values(found.value)
        for x, value, bound in zip(np.array(known)[place], exact, found.error, strict=True):
            assert abs(x - value) <= F(float(bound))
        assert found.error.max() < 1e-9


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("rate", [0.5, 0.9999])
def test_each_way_solves_values_and_visits(way: str, rate: float, turned: bool) -> None:
    """Chains that mix soon, and a ring, which has a narrow band in another order."""
    rng = np.random.default_rng(9)
    ring = 0.5 * np.eye(60) + 0.5 * np.roll(np.eye(60), 1, axis=1)
    for dense in (rng.dirichlet(np.ones(60), 60), ring[rng.permutation(60)]):
        chain = sp.csr_array(dense.T if turned else dense)
        constant = rng.normal(size=60)
        found = fixed_point(chain, constant, rate)
        exact = np.linalg.solve(np.eye(60) - rate * chain.toarray(), constant)
        assert (np.abs(found.value - exact) <= found.error + 1e-10 * np.abs(exact).max()).all()
        assert found.error.max() <= 1e-9 * np.abs(exact).max()


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_a_constant_that_is_no_number_is_refused(way: str, wrong: float) -> None:
    chain = sp.csr_array(sp.diags_array([np.full(8, 0.3)] * 2, offsets=[-1, 1]))
    constant = np.ones(9)
    constant[1] = wrong
    with pytest.raises(SolverError, match="range of floats"):
        fixed_point(chain, constant)


def test_factors_that_would_be_too_large_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, limit in (WAYS["last resort"] | {"PATIENT": 5, "MOST_ENTRIES": 10_000}).items():
        monkeypatch.setattr(linear, name, limit)
    with pytest.raises(SolverError, match=r"8,100 equations .* number the states") as told:
        LinearSystem(slow_walk(90)).roughly(np.ones(8100))
    assert told.value.status is Status.TOO_LARGE


@pytest.mark.parametrize("leak", [1e-4, 1e-6])
def test_a_chain_that_falls_apart_is_solved_without_large_factors(leak: float) -> None:
    chain, rate = weak_clusters(10_000, 50, leak), 1 - leak
    system, constant = LinearSystem(chain, rate), np.random.default_rng(6).random(10_000)
    found = system.solve(constant)
    assert "_within_band" not in vars(system)
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
    found, common = LinearSystem(sp.csr_array(chain), rate).relatively(constant, leak)
    assert np.abs(found).min() < 1e-14
    value = np.linalg.solve(np.eye(12) - rate * chain, constant)
    lost = 1e-14 / leak.min() * np.abs(value).max()  # by dense equations
    assert np.abs(found + common - value).max() <= lost


@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_gauss_seidel_both_ways_is_the_product_that_it_stands_for(seed: int, dense: float) -> None:
    rng, chain = np.random.default_rng(seed), chains(seed, density=dense)
    size = chain.shape[0]
    matrix = np.eye(size) - 0.9 * chain.toarray()
    lower, upper, diagonal = np.tril(matrix), np.triu(matrix), np.diag(np.diag(matrix))
    given_, found = rng.normal(size=size), np.full(size, np.nan)
    krylov.preconditioned(packed(chain), 0.9, given_, found)
    assert np.allclose(lower @ np.linalg.solve(diagonal, upper @ found), given_, atol=1e-12)


def test_sweeps_that_would_be_too_many_end_early() -> None:
    ring = sp.csr_array(0.5 * (np.eye(600) + np.roll(np.eye(600), 1, axis=1)))
    constant = np.random.default_rng(3).normal(size=600)
    assert not LinearSystem(ring, 0.9999).swept(constant / np.abs(constant).max(), 1e-11)[1]
