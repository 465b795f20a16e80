"""Compiled loops of linear systems, against dense matrices."""

import numpy as np
import pytest
import scipy.sparse as sp

from exact_mdp.solvers.kernels.linear import (
    SparseRows,
    apply_preconditioner,
    compute_inner_product,
    sweep_states,
    write_residual,
)


def drawn(seed: int, size: int = 9) -> tuple[SparseRows, np.ndarray]:
    rng = np.random.default_rng(seed)
    dense = rng.dirichlet(np.ones(size), size) * (rng.random((size, size)) < 0.6)
    dense[0] = 0
    matrix = sp.csr_array(dense)
    matrix.sort_indices()
    return SparseRows(matrix.indptr, matrix.indices, matrix.data), dense


@pytest.mark.parametrize("seed", range(10))
def test_residuals_products_and_the_preconditioner(seed: int) -> None:
    rows, p = drawn(seed)
    x, out = np.random.default_rng(seed + 9).normal(size=9), np.empty(9)
    write_residual(rows, 0.8, x, out)
    assert out == pytest.approx(x - 0.8 * p @ x)
    system = np.eye(9) - 0.8 * p
    diagonal = np.diag(np.diag(system))
    lower, upper = np.tril(system), np.triu(system)  # D - L and D - U
    apply_preconditioner(rows, 0.8, x, out)
    assert out == pytest.approx(np.linalg.solve(lower @ np.linalg.inv(diagonal) @ upper, x))
    for n in range(9):
        assert compute_inner_product(x[:n].copy(), out[:n].copy()) == pytest.approx(x[:n] @ out[:n])


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_sweeps_end_at_the_solution(seed: int, whole: bool) -> None:
    rng = np.random.default_rng(seed)
    rows, p = drawn(seed)
    if whole:  # rows that sum to 1
        p = rng.dirichlet(np.ones(9), 9)
        matrix = sp.csr_array(p)
        rows = SparseRows(matrix.indptr, matrix.indices, matrix.data)
    order, constant = rng.permutation(9), rng.normal(size=9)
    value, room = np.zeros(9), np.empty(9)
    done = sweep_states(rows, order, 0.8, constant, whole, 1e-10, 0.0, 500, 500, value, room)
    assert done
    wanted = np.linalg.solve(np.eye(9) - 0.8 * p[order], constant)
    assert value == pytest.approx(wanted, abs=1e-8)
    again = np.zeros(9)
    assert not sweep_states(rows, order, 0.8, constant, whole, 1e-300, 0.0, 3, 3, again, room)
