"""Fixed points x = c + γ P x and their error bounds, held against rational arithmetic."""

import pickle
from fractions import Fraction as F

import numpy as np
import pytest
import scipy.sparse as sp
from cases.reference import evaluate_exact
from hypothesis import given
from hypothesis import strategies as st
from strategies import Rows, exact_values, models

import exact_mdp.solvers.bounds.linear as linear
from exact_mdp.mdp.chain import topological_levels
from exact_mdp.solvers import SolverError
from exact_mdp.solvers.bounds import elimination
from exact_mdp.solvers.bounds import linear as iteration
from exact_mdp.solvers.bounds.elimination import TooLarge
from exact_mdp.solvers.bounds.linear import FixedPoint, LinearSystem, policy_chain
from exact_mdp.solvers.solution import Status


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
    monkeypatch.setattr(iteration, "STEPS", 5)
    system = LinearSystem(chain)
    found = system.solve(np.ones(side**2))
    assert "_last_resort" in vars(system)
    assert found.error.max() < 1e-8
    monkeypatch.setattr(iteration, "STEPS", 4000)
    other = LinearSystem(chain)
    same = other.solve(np.ones(side**2))
    assert "_last_resort" not in vars(other)
    assert (np.abs(found.value - same.value) <= found.error + same.error).all()


def test_where_factors_would_be_too_large_iteration_has_patience(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    chain = slow_walk(90)
    known = LinearSystem(chain).solve(np.ones(8100))
    monkeypatch.setattr(elimination, "MOST_ENTRIES", 10_000)
    monkeypatch.setattr(iteration, "STEPS", 5)
    system = LinearSystem(chain)
    found = system.solve(np.ones(8100))
    assert isinstance(vars(system)["_last_resort"], TooLarge)
    assert found.error.max() < 1e-8
    assert (np.abs(found.value - known.value) <= found.error + known.error).all()
    monkeypatch.setattr(iteration, "GMRES_STEPS", 5)
    monkeypatch.setattr(iteration, "PATIENT", 5)
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
    assert isinstance(vars(system)["_last_resort"], TooLarge)  # some 25 million entries, and more
    assert found.error.max() < 1e-6 * np.abs(found.value).max()
    assert np.abs(constant + rate * (chain @ found.value) - found.value).max() < 1e-8


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
        for module in (elimination, iteration):
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


def test_values_beyond_floats_are_refused() -> None:
    with pytest.raises(SolverError, match="range of floats"):
        fixed_point(sp.csr_array([[0.9]]), np.array([1e308]))


def test_zero_is_exact() -> None:
    found = fixed_point(sp.csr_array([[0.5]]), np.zeros(1))
    assert (found.value.tolist(), found.error.tolist()) == ([0.0], [0.0])


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
