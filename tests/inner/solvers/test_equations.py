"""Fixed points x = c + γ P x: each way of solving them, whatever the chain."""

from fractions import Fraction as F

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import evaluate_exact
from strategies import exact_values

from exact_mdp import SolverError, Status
from exact_mdp.solvers.bounds import linear
from exact_mdp.solvers.bounds.linear import FixedPoint, LinearSystem


def fixed_point(
    chain: sp.csr_array, constant: np.ndarray, discount: float = 1.0, **more: object
) -> FixedPoint:
    error = more.pop("constant_error", 0.0)
    return LinearSystem(chain, discount, **more).solve(constant, error)


def slow_walk(side: int) -> sp.csr_array:
    """A walk on a square, from whose edge it falls off."""
    line = sp.diags_array([np.full(side - 1, 0.25)] * 2, offsets=[-1, 1])
    eye = sp.eye_array(side)
    return sp.csr_array(sp.kron(line, eye) + sp.kron(eye, line))


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


def test_sweeps_that_would_be_too_many_end_early() -> None:
    ring = sp.csr_array(0.5 * (np.eye(600) + np.roll(np.eye(600), 1, axis=1)))
    constant = np.random.default_rng(3).normal(size=600)
    assert not LinearSystem(ring, 0.9999).swept(constant / np.abs(constant).max(), 1e-11)[1]
