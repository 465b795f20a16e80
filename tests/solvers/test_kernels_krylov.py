"""Krylov methods: against dense matrices, where they break down, and where they start again."""

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

from exact_mdp.solvers.bounds.linear import patiently, quickly
from exact_mdp.solvers.kernels import linear as krylov
from exact_mdp.solvers.kernels.compiling import Rows


def rows(chain: sp.csr_array) -> Rows:
    return Rows(chain.indptr, chain.indices, chain.data)


def solved(
    chain: sp.csr_array, rate: float, constant: np.ndarray, steps: int
) -> tuple[int, np.ndarray]:
    value, room = np.full(len(constant), np.nan), np.full((6, len(constant)), np.nan)
    return krylov.bicgstab(rows(chain), rate, constant, 1e-12, steps, value, room), value


def shuffled(chain: sp.csr_array, seed: int = 1) -> sp.csr_array:
    places = np.random.default_rng(seed).permutation(chain.shape[0])
    return sp.csr_array(chain[places][:, places])


@given(st.integers(0, 2**32 - 1))
def test_small_systems_are_solved(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 12))
    dense = rng.random((size, size)) * (rng.random((size, size)) < 0.5)
    dense *= 0.99 / max(1.0, dense.sum(axis=1).max())
    constant = np.where(rng.random(size) < 0.3, 0.0, rng.normal(size=size))
    taken, value = solved(sp.csr_array(dense), 0.95, constant, 200)
    assert taken >= 0
    exact = np.linalg.solve(np.eye(size) - 0.95 * dense, constant)
    assert np.abs(value - exact).max() < 1e-9


def test_nothing_is_solved_at_once() -> None:
    taken, value = solved(sp.csr_array(np.full((3, 3), 0.2)), 1.0, np.zeros(3), 5)
    assert (taken, value.tolist()) == (0, [0.0] * 3)


@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_gauss_seidel_both_ways_is_the_product_that_it_stands_for(seed: int, dense: float) -> None:
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 13))
    chain = sp.csr_array(rng.random((size, size)) / size * (rng.random((size, size)) < dense))
    matrix = np.eye(size) - 0.9 * chain.toarray()
    lower, upper, diagonal = np.tril(matrix), np.triu(matrix), np.diag(np.diag(matrix))
    given_, found, through = rng.normal(size=size), np.full(size, np.nan), np.full(size, np.nan)
    krylov.applied(rows(chain), 0.9, given_, found, through)
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


def test_what_never_ends_is_not_taken_for_solved() -> None:
    for chain in (np.eye(2), np.array([[0.0, 1.0], [1.0, 0.0]]), np.full((3, 3), 0.6)):
        size = len(chain)
        taken, value = solved(sp.csr_array(chain), 1.0, np.arange(1.0, size + 1), 50)
        assert taken == -1 or np.abs(np.arange(1.0, size + 1) - value + chain @ value).max() < 1e-9


def test_small_and_large_chains_are_iterated_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    import exact_mdp.solvers.bounds.linear as module

    rng = np.random.default_rng(5)
    chain = sp.csr_array(rng.dirichlet(np.ones(40), 40))
    constant = rng.normal(size=40)
    exact = np.linalg.solve(np.eye(40) - 0.99 * chain.toarray(), constant)
    for threshold in (0, 10**6):
        monkeypatch.setattr(module, "COMPILED", threshold)
        for way in (quickly, patiently):
            found = way(chain, 0.99, constant, 1e-12)
            assert found is not None
            assert np.abs(found - exact).max() < 1e-9
    ring = shuffled(sp.csr_array(np.roll(np.eye(600), 1, axis=1)))
    for threshold in (0, 10**6):
        monkeypatch.setattr(module, "COMPILED", threshold)
        monkeypatch.setattr(module, "STEPS", 3)
        assert quickly(ring, 0.9999, rng.normal(size=600), 1e-12) is None
