"""Bounded certificates: what they claim holds of the exact values, and faults are found."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
from cases import CASES, Case
from cases.reference import every_policy_ends
from certificates import MODELS, certified
from hypothesis import given, settings
from strategies import Rows, exact_values, model_of, models

from exact_mdp.mdp import MDP, ModelError, Scenario
from exact_mdp.solvers import Claim, SolverError, certify, solve
from exact_mdp.solvers.proof.certificate import BoundedCertificate
from exact_mdp.solvers.proof.checker import gains


def exact_policy_values(mdp: MDP, found: BoundedCertificate) -> list[F]:
    """The values of the policy, from the certificate of the model that offers it alone."""
    pairs = [mdp.pair(s, int(a)) for s, a in enumerate(found.policy)]
    kind = float if mdp.table.weight.dtype == np.float64 else F
    rows = [
        (s, 0, [(kind(p), t, kind(r)) for p, t, r in mdp.table.row(pair)])
        for s, pair in enumerate(pairs)
    ]
    only = MDP.from_outcomes(rows, mdp.discount_exact)
    return list(certify(only).value)


def check(mdp: MDP, found: BoundedCertificate) -> None:
    assert found.violations() == []
    best, taken = list(certify(mdp).value), exact_policy_values(mdp, found)
    lower, upper, middle = map(exact_values, (found.lower, found.upper, found.value))
    error = F(found.error_bound)
    for s in range(mdp.n_states):
        assert lower[s] <= taken[s] <= best[s] <= upper[s]
        assert abs(middle[s] - best[s]) <= error
        assert abs(middle[s] - taken[s]) <= error


@settings(max_examples=100, deadline=None)
@given(models())
def test_exact_values_lie_between(rows: Rows) -> None:
    mdp = rows.model()
    check(mdp, certify(mdp, bounded=True))


@settings(max_examples=60, deadline=None)
@given(models())
def test_exact_values_of_float_models_lie_between(rows: Rows) -> None:
    mdp = rows.model(floats=True)
    check(mdp, certify(mdp, bounded=True))


@pytest.mark.parametrize("name", MODELS)
def test_models_of_every_kind(name: str) -> None:
    found = certify(MODELS[name], bounded=True)
    check(MODELS[name], found)
    assert found.claim is Claim.BOUNDED
    assert found.error_bound < 1e-9 * np.abs(found.value).max()


@pytest.mark.parametrize("case", CASES, ids=str)
def test_published_models(case: Case) -> None:
    mdp = model_of(case.n_states, case.pairs, case.discount, start=case.start)
    if case.discount == 1 and not every_policy_ends(case.n_states, case.pairs):
        with pytest.raises(ModelError, match="needs every policy to end"):
            certify(mdp, bounded=True)
        return
    try:
        found = certify(mdp, bounded=True)
    except SolverError:
        assert case.name.startswith("reset-chain")
        return
    check(mdp, found)


def test_bounds_around_a_poor_solution_are_wide_and_hold() -> None:
    mdp = MODELS["cycle, discounted"]
    poor = replace(solve(mdp), value=np.array([5.0, -3.0, 4.0, 0.0]))
    found = certify(mdp, bounded=True, solution=poor)
    check(mdp, found)
    assert found.error_bound > 1


def test_tolerance() -> None:
    mdp = MODELS["cycle, discounted"]
    assert certify(mdp, bounded=True, tol=1e-6).error_bound <= 1e-6
    with pytest.raises(SolverError, match="the error bound"):
        certify(mdp, bounded=True, tol=1e-30)
    with pytest.raises(ModelError, match="another model"):
        certify(mdp, bounded=True, solution=solve(MODELS["care"]))


def test_many_states() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[400]).compile()
    found = certify(mdp, bounded=True)
    assert found.violations() == []
    assert found.error_bound < 1e-7
    assert 16_000 < found.lower[0] <= found.upper[0] < 18_000


@settings(max_examples=100, deadline=None)
@given(models())
def test_rounding_errors_are_bounded(rows: Rows) -> None:
    """The checker's own arithmetic, against rational arithmetic, for rough values."""
    for floats in (False, True):
        mdp = rows.model(floats=floats)
        value = np.where(
            mdp.terminal, 0, np.sin(np.arange(mdp.n_states)) * 10.0 ** (3 * rows.n_states)
        )
        exact = exact_values(value)
        for earning in (True, False):
            gain, error = gains(mdp, value, earning=earning)
            for pair in range(mdp.n_pairs):
                truth = -exact[mdp.pair_state[pair]]
                for p, t, r in mdp.table.row(pair):
                    truth += p * (r * earning + mdp.discount_exact * exact[t])
                assert abs(truth - F(float(gain[pair]))) <= F(float(error[pair]))


Change = Callable[[BoundedCertificate], dict[str, Any]]


def moved(vector: np.ndarray, amount: float) -> np.ndarray:
    """Changed in one state, to which another one leads."""
    changed = vector.copy()
    changed[1] += amount
    return changed


FAULTS: dict[str, tuple[str, Change]] = {
    "upper too low": ("upper", lambda c: {"upper": moved(c.upper, -1e-6)}),
    "upper far too high in one state": ("upper", lambda c: {"upper": moved(c.upper, 1e6)}),
    "lower too high": ("lower", lambda c: {"lower": moved(c.lower, 1e-6)}),
    "lower far too low in one state": ("lower", lambda c: {"lower": moved(c.lower, -1e6)}),
    "swapped": ("upper", lambda c: {"upper": c.lower, "lower": c.upper}),
    "weight 0": ("weights", lambda c: {"weight": np.zeros_like(c.weight)}),
    "negative weight": ("weights", lambda c: {"weight": -c.weight}),
    "no number": ("upper is not finite", lambda c: {"upper": c.upper * np.nan}),
    "infinite": ("upper is not finite", lambda c: {"upper": c.upper + np.inf}),
    "terminal": ("not 0 in terminal", lambda c: {"upper": c.upper + 1}),
    "policy": ("not available", lambda c: {"policy": c.policy + 99}),
    "model": ("another model", lambda c: {"model": "0" * 64}),
    "size": ("states", lambda c: {"lower": c.lower[1:]}),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("name", ["cycle", "cycle, discounted", "cycle of floats"])
def test_planted_faults_are_found(name: str, fault: str) -> None:
    expected, change = FAULTS[fault]
    found = certify(MODELS[name], bounded=True)
    wrong = replace(found, **change(found)).violations()
    assert any(expected in violation for violation in wrong), wrong


def test_a_worse_policy_is_found() -> None:
    mdp, found = MODELS["cycle, discounted"], certify(MODELS["cycle, discounted"], bounded=True)
    pair = int(np.flatnonzero(~certified("cycle, discounted").optimal_pairs)[0])
    policy = found.policy.copy()
    policy[mdp.pair_state[pair]] = mdp.pair_action[pair]
    assert replace(found, policy=policy).violations() == [
        "the lower values are not proven to be below the policy's"
    ]


def test_representation() -> None:
    found = certify(MODELS["cycle"], bounded=True)
    assert repr(found).startswith("BoundedCertificate(4 states, error ≤ ")
    with pytest.raises(ValueError, match="read-only"):
        found.upper[0] = 1
