"""The distribution of the return where it is sparse, and other inner values of policies."""

from __future__ import annotations

from fractions import Fraction as F

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import assume, given, settings
from policy_cases import LAWFUL, Case, brute_force, coin, geometric, is_acyclic

from exact_mdp import (
    MDP,
    Claim,
    ModelError,
    ReturnDistribution,
    evaluate,
    return_distribution,
    solvers,
)
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.simulate import _cumulative

CYCLIC_STEPS = 8


@pytest.fixture(params=["dense", "sparse"])
def kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "sparse":
        monkeypatch.setattr(solvers.values.return_mass, "DENSE", 0)
    return str(request.param)


def law_of(case: Case) -> ReturnDistribution:
    """The law, unless the chain takes long to end."""
    if is_acyclic(case):
        return return_distribution(case.model, case.weights)
    assume(brute_force(case, CYCLIC_STEPS)[1] < 0.3)
    return return_distribution(case.model, case.weights)


def check_law(case: Case, found: ReturnDistribution) -> None:
    steps = case.n_states if is_acyclic(case) else CYCLIC_STEPS
    wanted, rest = brute_force(case, steps)
    law = found.as_dict()
    assert list(law) == sorted(law)
    assert rest or set(law) == set(wanted)
    for value, error in zip(found.values, found.error, strict=True):
        low = wanted.get(value, F(0))
        assert low - F(error) <= F(law[value]) <= low + rest + F(error)
    assert all(mass <= F(found.remaining) for x, mass in wanted.items() if x not in law)


@settings(deadline=None, max_examples=40)
@given(LAWFUL)
def test_the_law_is_that_of_brute_force(case: Case) -> None:
    assume(case.ends)
    for widest in (8, 0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(solvers.values.return_mass, "DENSE", widest)
            found = law_of(case)
        check_law(case, found)
        assert found.claim is Claim.BOUNDED
        assert found.remaining <= 1.01e-12
        if is_acyclic(case):
            assert found.remaining == 0
        total = sum(brute_force(case, case.n_states)[0].values()) if is_acyclic(case) else 1
        assert found.probabilities.sum() == pytest.approx(float(total), abs=3e-9)
    wanted = evaluate(case.model, case.weights)
    assert found.mean == pytest.approx(wanted.mean, rel=1e-8, abs=1e-7)
    assert found.sd == pytest.approx(wanted.sd, rel=1e-5, abs=1e-4)


def test_halves_are_on_the_lattice(kind: str) -> None:
    found = return_distribution(coin("1/2", -1, ways=2), "random")
    assert found.as_dict() == {F(-2): 0.25, F(-1, 2): 0.5, F(1): 0.25}
    assert found.unit == F(1, 2)


def test_a_loop_is_followed_until_little_is_left(kind: str) -> None:
    found = return_distribution(geometric("1/2"), "random")
    assert found.values[-1] == 0
    steps = [-int(value) for value in found.values]
    assert found.probabilities.tolist() == [0.5 ** (step + 1) for step in steps]
    assert 0 < found.remaining <= 1e-12
    assert found.probabilities.sum() + found.remaining == pytest.approx(1, abs=1e-15)
    assert max(steps) == 39  # 2^-40 < 10^-12


def test_a_loop_that_takes_too_long_is_an_error(kind: str) -> None:
    with pytest.raises(ModelError, match="after 100 sweeps") as caught:
        return_distribution(geometric("999/1000"), "random", max_sweeps=100)
    assert "max_sweeps" in caught.value.fix


def test_a_loop_without_reward_adds_no_returns(kind: str) -> None:
    found = return_distribution(geometric("9/10", reward=0), "random")
    assert found.values == (0,)
    assert found.probabilities[0] == pytest.approx(1, abs=1e-11)


def test_ways_too_rare_for_floats_are_followed_exactly(kind: str) -> None:
    rare = F(1, 10**400)
    rows = [
        (0, 0, [(rare, 1, 1), (1 - rare, 3, 0)]),
        (1, 0, [(1, 2, 1)]),
        (2, 0, [(1, 3, 1)]),
        (3, 0, [(1, 3, 0)]),
        (4, 0, [(1, 3, 7)]),
    ]
    mdp = MDP.from_outcomes(rows, start={0: 1 - rare, 4: rare})
    exact = return_distribution(mdp, "random", exact=True)
    assert exact.values == (0, 3, 7)
    assert exact.exact == ((1 - rare) ** 2, rare * (1 - rare), rare)
    found = return_distribution(mdp, "random")
    assert found.values == (0,)
    assert found.remaining < 1e-280


def test_too_many_returns_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solvers.values.return_mass, "CELLS", 50)
    monkeypatch.setattr(solvers.values.return_mass, "STEPS", 50)
    for rewards in ((0, 9000), (0, 7, 9001), (0, 10**7, 3)):
        mdp = coin(*rewards, 1, ways=8)
        with pytest.raises(ModelError, match="too many") as caught:
            return_distribution(mdp, "random")
        assert "coarser" in caught.value.fix


def test_probabilities_of_large_models_keep_their_digits() -> None:
    # Summed up over all states at once, rare outcomes of late states would be lost to rounding.
    states, rare = 100_000, 1e-13
    here = np.repeat(np.arange(states - 1), 2)
    there = np.where(np.arange(len(here)) % 2, states - 1, np.minimum(here + 1, states - 2))
    rows = sp.csr_array((np.tile([1 - rare, rare], states - 1), (here, there)))
    last = sp.csr_array(([1.0], ([0], [states - 1])), shape=(1, states))
    mdp = MDP.from_pairs(
        np.arange(states), np.zeros(states, dtype=int), sp.vstack([rows, last]), np.zeros(states)
    )
    first, cumulative = _cumulative(PolicyChain.of(mdp, "random"))
    assert first.tolist() == [*range(0, 2 * states, 2), 2 * states - 1]
    assert (cumulative[0:-1:2] == 1 - rare).all()
    assert (cumulative[1:-1:2] == 1).all()
