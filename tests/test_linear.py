"""Fixed points x = c + γ P x and their error bounds, held against rational arithmetic."""

from fractions import Fraction as F

import numpy as np
import pytest
import scipy.sparse as sp
from cases.reference import evaluate_exact
from hypothesis import given
from hypothesis import strategies as st
from strategies import Rows, exact_values, models

import solvers.linear as linear
from mdp.chain import topological_levels
from solvers import SolverError
from solvers.linear import LinearSystem, fixed_point, policy_chain


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


def test_a_slowly_mixing_chain_is_solved_by_elimination(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = slow_walk(40)
    monkeypatch.setattr(linear, "KRYLOV_STEPS", 5)
    system = LinearSystem(chain)
    found = system.solve(np.ones(1600))
    assert "_sparse" in vars(system)
    assert found.error.max() < 1e-9
    monkeypatch.setattr(linear, "KRYLOV_STEPS", 4000)
    other = LinearSystem(chain)
    same = other.solve(np.ones(1600))
    assert "_sparse" not in vars(other)
    assert (np.abs(found.value - same.value) <= found.error + same.error).all()


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
