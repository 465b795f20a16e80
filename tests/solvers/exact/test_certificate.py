"""Certificates, exact and bounded, against other exact solvers; and what has no certificate."""

import random
from dataclasses import replace
from fractions import Fraction as F
from itertools import count

import numpy as np
import pytest
from cases import CASES, Case
from certificates import CYCLE, MODELS, certified
from flint import fmpz
from hypothesis import given, settings
from made_models import under
from oracle import every_policy_ends, solve_exact
from strategies import Rows, exact_gains, exact_values, model_of, models

from exact_mdp import (
    MDP,
    BoundedCertificate,
    Certificate,
    Claim,
    ModelError,
    Scenario,
    SolverError,
    certify,
    solve,
)


def check(proof: Certificate, mdp: MDP) -> None:
    """Everything that a certificate claims, computed anew from the model's own rational table."""
    assert proof.violations() == []
    value = list(proof.value)
    gains = exact_gains(mdp, value)
    best = [[a for a in mdp.pairs_of(s) if gains[a] == 0] for s in range(mdp.n_states)]
    for s in range(mdp.n_states):
        if mdp.terminal[s]:
            assert value[s] == 0
            assert proof.optimal_pairs[list(mdp.pairs_of(s))].all()
            continue
        losses = [-gains[a] for a in mdp.pairs_of(s)]
        assert min(losses) == 0
        assert proof.optimal_pairs[list(mdp.pairs_of(s))].tolist() == [x == 0 for x in losses]
        assert proof.gaps[s] == min((x for x in losses if x), default=None)
        assert mdp.pair(s, int(proof.policy[s])) == best[s][0]
    todo = [s for s, weight in mdp.start if weight]
    reached = set(todo)
    while todo:
        s = todo.pop()
        new = {t for a in best[s] for _, t, _ in mdp.table.row(a)} - reached
        reached |= new
        todo += new
    assert proof.unique == all(len(best[s]) == 1 for s in reached if not mdp.terminal[s])
    assert proof.start_value == sum(weight * value[s] for s, weight in mdp.start)
    assert proof.value_float.tolist() == [float(x) for x in value]


def check_reference(rows: Rows, proof: Certificate, mdp: MDP) -> None:
    value, optimal = solve_exact(rows.n_states, rows.pairs, rows.discount)
    assert list(proof.value) == value
    for s in range(rows.n_states):
        chosen = [a for a in mdp.pairs_of(s) if proof.optimal_pairs[a]]
        assert {int(mdp.pair_action[a]) for a in chosen} == set(optimal[s])


def check_bounds(mdp: MDP, proof: BoundedCertificate) -> None:
    assert proof.violations() == []
    best, taken = (list(certify(model).value) for model in (mdp, under(mdp, proof.policy)))
    lower, upper, middle = map(exact_values, (proof.lower, proof.upper, proof.value))
    error = F(proof.error_bound)
    for s in range(mdp.n_states):
        assert lower[s] <= taken[s] <= best[s] <= upper[s]
        assert abs(middle[s] - best[s]) <= error
        assert abs(middle[s] - taken[s]) <= error


# ---- right answers -------------------------------------------------------------------------------


@settings(max_examples=150, deadline=None)
@given(models())
def test_random_models_are_solved_exactly(rows: Rows) -> None:
    mdp = rows.model(floats=False)
    optimum = certify(mdp)
    check(optimum, mdp)
    check_bounds(mdp, certify(mdp, bounded=True))
    check_reference(rows, optimum, mdp)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_published_models(case: Case) -> None:
    mdp = model_of(case.n_states, case.pairs, case.discount, start=case.start)
    optimum = certify(mdp)
    assert optimum.violations() == []
    assert case.values
    for state, value in case.values.items():
        exact = optimum.value[state]
        near = 0 if isinstance(value, F) else case.tolerance
        assert exact == value or abs(exact - value) <= near, state
    assert case.proper == (case.discount < 1 or every_policy_ends(case.n_states, case.pairs))
    if not case.proper:
        with pytest.raises(ModelError, match="need every policy to end"):
            certify(mdp, bounded=True)
        return
    for state, actions in case.optimal.items():
        best = [a for a in mdp.pairs_of(state) if optimum.optimal_pairs[a]]
        assert {int(mdp.pair_action[a]) for a in best} == set(actions)
    for state, action in case.policy.items():
        assert optimum.optimal_pairs[mdp.pair(state, action)]
    check(optimum, mdp)
    check_reference(
        Rows(n_states=case.n_states, pairs=case.pairs, discount=case.discount), optimum, mdp
    )
    try:
        check_bounds(mdp, certify(mdp, bounded=True))
    except SolverError:
        assert case.name.startswith("reset-chain")


@pytest.mark.parametrize("name", MODELS)
def test_models_of_every_kind(name: str) -> None:
    check(certified(name), MODELS[name])
    optimum = certify(MODELS[name], bounded=True)
    check_bounds(MODELS[name], optimum)
    assert optimum.claim is Claim.BOUNDED
    assert optimum.error_bound < 1e-9 * np.abs(optimum.value).max()


@pytest.mark.parametrize("waiting", [False, True])
@pytest.mark.parametrize("width, depth", [(40, 2), (10, 5)])
def test_denominators_without_common_factors(width: int, depth: int, waiting: bool) -> None:
    """Common denominators of all states would be far longer than each state's own."""
    draw, last = random.Random(width), width * depth
    bottoms = (n for n in count(10**5) if fmpz(n).is_prime())
    rows = [(last, 0, F(0), {last: F(1)})]
    for s in range(last):
        below = (s // width + 1) * width
        for a in range(2):
            bottom = next(bottoms)
            share = F(draw.randrange(1, bottom // 2), bottom)
            to = below + draw.randrange(width) if below < last else last
            following = {s if waiting and a else last: 1 - share}
            following[to] = following.get(to, F(0)) + share
            rows.append((s, a, F(draw.randrange(-9, 9), next(bottoms)), following))
    rows.sort(key=lambda row: row[:2])
    mdp = model_of(last + 1, rows, F(1))
    optimum = certify(mdp)
    check(optimum, mdp)
    check_reference(Rows(n_states=last + 1, pairs=tuple(rows), discount=F(1)), optimum, mdp)
    lengths = [below.bit_length() for below in optimum.h.each_below]
    assert max(lengths) < 3 * max(int(x.denominator).bit_length() for x in optimum.value)


def test_denominators_stay_short_where_values_do() -> None:
    chain = [(s, 0, F(1, 10), {s + 1: F(1)}) for s in range(200)]
    optimum = certify(model_of(201, [*chain, (200, 0, F(0), {200: F(1)})], F(1)))
    assert optimum.start_value == 20
    assert max(optimum.h.below) == 10


@pytest.mark.parametrize("scale", [F(10) ** 300, F(1, 10**300)])
def test_numbers_beyond_floats(scale: F) -> None:
    """Floats overflow or underflow while they seek the first policy; the answer is exact still."""
    pairs = [(s, a, r * scale, row) for s, a, r, row in CYCLE]
    mdp = model_of(4, pairs, F(999_999_999_999, 10**12))
    optimum = certify(mdp)
    check(optimum, mdp)
    plain = certify(model_of(4, CYCLE, F(999_999_999_999, 10**12)))
    assert list(optimum.value) == [x * scale for x in plain.value]


def test_where_all_that_remains_is_to_stop() -> None:
    mdp = model_of(2, [(s, a, F(0), {s: F(1)}) for s in range(2) for a in range(2)], F(1))
    optimum = certify(mdp)
    check(optimum, mdp)
    assert optimum.unique
    assert optimum.gaps.tolist() == [None, None]


@pytest.mark.parametrize("tiny", [F(1, 10**20), F(1, 10**400), F(1, 2**1100)])
@pytest.mark.parametrize("around", [False, True])
def test_tiny_probabilities_do_not_vanish(tiny: F, around: bool) -> None:
    """Exact chances that no float holds beside 1, or at all, still lead out, on a cycle too."""
    other = 2 if around else 0
    mdp = MDP.from_outcomes(
        [
            (0, 0, [(1 - tiny, other, 1), (tiny, 1, 0)]),
            (2, 0, [(1 - tiny, 0, 1), (tiny, 1, 0)]),
            (1, 0, [(1, 1, 0)]),
        ],
        1,
    )
    optimum = certify(mdp)
    assert optimum.value[0] == (1 - tiny) / tiny
    assert optimum.violations() == []


# ---- bounds --------------------------------------------------------------------------------------


def test_bounds_around_a_poor_solution_are_wide_and_hold() -> None:
    mdp = MODELS["cycle, discounted"]
    poor = replace(solve(mdp), value=np.array([5.0, -3.0, 4.0, 0.0]))
    optimum = certify(mdp, bounded=True, solution=poor)
    check_bounds(mdp, optimum)
    assert optimum.error_bound > 1


def test_tolerance() -> None:
    mdp = MODELS["cycle, discounted"]
    assert certify(mdp, bounded=True, tol=1e-6).error_bound <= 1e-6
    with pytest.raises(SolverError, match="the error bound"):
        certify(mdp, bounded=True, tol=1e-30)


def test_many_states() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[400]).compile()
    optimum = certify(mdp, bounded=True)
    assert optimum.violations() == []
    assert optimum.error_bound < 1e-7
    assert 16_000 < optimum.lower[0] <= optimum.upper[0] < 18_000


# ---- what has no answer --------------------------------------------------------------------------


@pytest.mark.parametrize("stay", [1.0, 1 + 2.0**-52, 1 + 2.0**-40])
@pytest.mark.parametrize("leave", [1e-20, 1e-300, 5e-324])
def test_a_state_that_is_hardly_ever_left_has_an_exact_value(stay: float, leave: float) -> None:
    """1.0 to stay and 1e-20 to leave: floats cannot bound the value; no division by zero."""
    for rows in ([[stay, leave], [0, 1]], [[stay, leave, 0], [0.5, 0, 0.5], [0, 0, 1]]):
        mdp = MDP.from_arrays([rows], [1.0, *[0.0] * (len(rows) - 1)], 1)
        optimum = certify(mdp)
        assert optimum.violations() == []
        assert optimum.value[0] == (1 / F(leave) if len(rows) == 2 else 2 / F(leave))
        for attempt in (solve, lambda mdp: certify(mdp, bounded=True)):
            with pytest.raises(SolverError):
                attempt(mdp)
        optimum = certify(mdp.with_(discount=0.5))
        assert optimum.violations() == []


# ---- the certificate itself ----------------------------------------------------------------------


def test_a_certificate_states_its_claim() -> None:
    optimum = certified("acyclic")
    assert optimum.claim is Claim.CERTIFIED
    assert optimum.start.value == optimum.start_value == optimum.value[0]
    said = "Certificate(5 states, start value ≈ 5.14285714286, the only optimal policy)"
    assert repr(optimum) == said
    with pytest.raises(ValueError, match="read-only"):
        optimum.policy[0] = 1
    bounded = certify(MODELS["cycle"], bounded=True)
    assert repr(bounded).startswith("BoundedCertificate(4 states, error ≤ ")
    with pytest.raises(ValueError, match="read-only"):
        bounded.upper[0] = 1


def test_another_model_is_another_model() -> None:
    optimum = certified("cycle, discounted")
    assert optimum.violations(MODELS["cycle, discounted"].with_(name="other")) == []
    assert optimum.violations(MODELS["cycle"]) == ["the certificate is of another model"]


@pytest.mark.parametrize("digits", [40, 130, 300, 2000])
@pytest.mark.parametrize("discount", ["0", "9/10"])
def test_tiny_numbers_of_long_denominators_change_no_sign(digits: int, discount: str) -> None:
    """All values are far below 1, and most of their digits are behind the first 256 bits."""
    rows = [
        [["1/2", "1/2", 0], [0, "1/3", "2/3"], [1, 0, 0]],
        [[0, 1, 0], [1, 0, 0], [0, 0, 1]],
        [["1/5", "2/5", "2/5"], [0, 0, 1], ["1/7", "6/7", 0]],
    ]
    rewards, unit = [[3, -5, 2], [7, 6, 5], [-1, 0, 4]], F(10 ** (digits * 5 // 8) + 1, 10**digits)
    plain = certify(MDP.from_arrays(rows, rewards, discount, layout="ass"))
    tiny = [[unit * reward for reward in row] for row in rewards]
    scaled = certify(MDP.from_arrays(rows, tiny, discount, layout="ass"))
    assert scaled.violations() == []
    assert (scaled.optimal_pairs == plain.optimal_pairs).all()
    assert scaled.value.tolist() == [unit * value for value in plain.value]
