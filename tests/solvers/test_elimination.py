"""Elimination within a band and in sparse factors, against dense matrices; what is refused."""

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st
from kernel_twins import factor_pattern

from exact_mdp.solvers import SolverError
from exact_mdp.solvers.bounds import elimination
from exact_mdp.solvers.bounds.elimination import TooLarge, band, fill, matrix_of, reach, sparse


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
