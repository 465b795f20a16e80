"""Fixed points x = c + γ P x: each way of solving them, whatever the chain."""

from fractions import Fraction as F
from math import inf, nan
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from oracle import evaluate_exact
from strategies import exact_values

from exact_mdp import SolverError, Status
from exact_mdp.solvers.bounds import linear
from exact_mdp.solvers.bounds.linear import LinearSystem

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


@pytest.mark.parametrize("seed", range(20))
def test_each_way_is_right_to_its_error(way: str, seed: int) -> None:
    """Against rational arithmetic: chains that fall in any order, discounts, and full rows."""
    rng = np.random.default_rng(seed)
    size, rate = int(rng.integers(2, 9)), [F(1), F(1, 2), F(9999, 10000)][seed % 3]
    parts = rng.integers(0, 4, (size, size))
    if rate == 1:
        parts = np.tril(parts, int(rng.integers(-1, size)))
    whole = int(parts.sum(axis=1).max()) + int(rng.integers(1, 4)) * (rate == 1)
    rows = [{to: F(int(part), whole) for to, part in enumerate(row) if part} for row in parts]
    constant = rng.integers(-5, 6, size).astype(float)
    pairs = [
        (s, 0, F(int(constant[s])), {t: p for t, p in [*row.items(), (size, 1 - sum(row.values()))]
                                     if p}) for s, row in enumerate(rows)
    ]  # fmt: skip
    pairs.append((size, 0, F(0), {size: F(1)}))
    known = evaluate_exact(size + 1, pairs, rate, dict.fromkeys(range(size + 1), 0))[:size]
    chain, place = sp.csr_array(parts / whole), rng.permutation(size)
    turned = sp.csr_array(chain[place][:, place])
    for order in [None] if sp.triu(chain).nnz else [None, place]:
        solution = LinearSystem(turned, float(rate), order=order).solve(constant[place], 0.0)
        exact = exact_values(solution.value)
        for x, value, bound in zip(np.array(known)[place], exact, solution.error, strict=True):
            assert abs(x - value) <= F(float(bound))
        assert solution.error.max() < 1e-9 * max(1, float(max(map(abs, known))))


@pytest.mark.parametrize("wrong", [nan, inf, -inf])
def test_a_constant_that_is_no_number_is_refused(way: str, wrong: float) -> None:
    chain = sp.csr_array(sp.diags_array([np.full(8, 0.3)] * 2, offsets=[-1, 1]))
    with pytest.raises(SolverError, match="range of floats"):
        LinearSystem(chain, 1.0).solve(np.array([1, wrong, *[1.0] * 7]), 0.0)


def test_factors_that_would_be_too_large_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a walk on a square, from whose edge it falls off."""
    limits: dict[str, Any] = WAYS["last resort"] | {"PATIENT": 5, "MOST_ENTRIES": 10_000}
    for name, limit in limits.items():
        monkeypatch.setattr(linear, name, limit)
    line = sp.diags_array([np.full(89, 0.25)] * 2, offsets=[-1, 1])
    walk = sp.csr_array(sp.kron(line, sp.eye_array(90)) + sp.kron(sp.eye_array(90), line))
    with pytest.raises(SolverError, match=r"8,100 equations .* number the states") as caught:
        LinearSystem(walk, 1.0).roughly(np.ones(8100))
    assert caught.value.status is Status.TOO_LARGE
