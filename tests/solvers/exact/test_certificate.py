"""Certificates of numbers of any length, ties, bounds, and what has no bounds.

That certificates are right is a law of every solver, in `test_laws`.
"""

import random
from dataclasses import replace
from fractions import Fraction as F
from itertools import count
from typing import Any

import numpy as np
import pytest
from answers import holds
from certified_models import CYCLE, MODELS, certified
from flint import fmpz
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import gridworld, under
from oracle import rows_of, solve_exact
from strategies import model_of

from exact_mdp import MDP, Certificate, Claim, Scenario, SolverError, certify, solve


def check(mdp: MDP) -> Certificate:
    """The certificate, of the values and optimal actions that the oracle finds."""
    optimum, rows = certify(mdp), rows_of(mdp)
    value, optimal = solve_exact(mdp.n_states, rows, mdp.discount_exact)
    assert optimum.violations() == []
    assert list(optimum.value) == value
    for s, actions in enumerate(optimal):
        chosen = [a for a in mdp.pairs_of(s) if optimum.optimal_pairs[a]]
        assert {int(mdp.pair_action[a]) for a in chosen} == actions
    return optimum


# ---- numbers of any length -----------------------------------------------------------------------


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
    optimum = check(model_of(last + 1, rows, F(1)))
    lengths = [below.bit_length() for below in optimum.h.each_below]
    assert max(lengths) < 3 * max(int(x.denominator).bit_length() for x in optimum.value)


def test_denominators_stay_short_where_values_do() -> None:
    chain = [(s, 0, F(1, 10), {s + 1: F(1)}) for s in range(200)]
    optimum = certify(model_of(201, [*chain, (200, 0, F(0), {200: F(1)})], F(1)))
    assert optimum.start_value == 20
    assert max(optimum.h.below) == 10


THREE = MDP.from_arrays(
    [
        [["1/2", "1/2", 0], [0, "1/3", "2/3"], [1, 0, 0]],
        [[0, 1, 0], [1, 0, 0], [0, 0, 1]],
        [["1/5", "2/5", "2/5"], [0, 0, 1], ["1/7", "6/7", 0]],
    ],
    [[3, -5, 2], [7, 6, 5], [-1, 0, 4]],
    layout="ass",
)
FAR = model_of(4, CYCLE, F(999_999_999_999, 10**12))
LENGTHS = [F(10 ** (digits * 5 // 8) + 1, 10**digits) for digits in (40, 130, 300, 2000)]


@pytest.mark.parametrize(
    "mdp", [THREE.with_(discount=0), THREE.with_(discount="9/10"), FAR], ids=str
)
@pytest.mark.parametrize("unit", [F(10) ** 300, F(1, 10**300), *LENGTHS])
def test_a_unit_of_rewards_changes_no_sign(unit: F, mdp: MDP) -> None:
    """Floats overflow or underflow, or miss most digits, while they seek the first policy."""
    rows = [(s, a, unit * reward, law) for s, a, reward, law in rows_of(mdp)]
    plain, optimum = certify(mdp), check(model_of(mdp.n_states, rows, mdp.discount_exact))
    assert (optimum.optimal_pairs == plain.optimal_pairs).all()
    assert optimum.value.tolist() == [unit * value for value in plain.value]


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


# ---- ties ----------------------------------------------------------------------------------------


@settings(max_examples=60)
@given(st.integers(1, 5), st.integers(-4, 4), st.integers(1, 3), st.data())
def test_one_value_everywhere(size: int, top: int, bottom: int, data: st.DataObject) -> None:
    """Rewards of the value times the chance to end; less in some pairs, more in one at times."""
    value, rows, end = F(top, bottom), [], (size, 0, [(1, size, 0)])
    for s in range(size):
        for a in range(data.draw(st.integers(1, 3))):
            out, to = (
                data.draw(st.sampled_from([F(1, 3), F(1)])),
                data.draw(st.integers(0, size - 1)),
            )
            less = data.draw(st.sampled_from([F(0), F(0), F(1, 7), F(2)])) if a else F(0)
            ahead = [(out, size), (1 - out, to)][: 1 + (out < 1)]
            rows.append((s, a, [(p, t, value * out - less) for p, t in ahead]))
    mdp = MDP.from_outcomes([*rows, end])
    assert check(mdp).value[:size].tolist() == [value] * size
    more = mdp.pairs_of(data.draw(st.integers(0, size - 1)))[0]
    rows[more] = (*rows[more][:2], [(p, t, r + 1) for p, t, r in rows[more][2]])
    assert max(check(MDP.from_outcomes([*rows, end])).value) > value


def test_gridworld() -> None:
    """One cycle of 399 states: symmetric values, and both ways along the diagonal."""
    mdp = gridworld(20)
    optimum = certify(mdp)
    assert optimum.violations() == []
    assert max(optimum.h.below).bit_length() > 1000
    assert not optimum.unique
    square = optimum.value.reshape(20, 20)
    assert (square == square.T).all()
    diagonal = [optimum.optimal_pairs[list(mdp.pairs_of(21 * i))] for i in range(19)]
    assert all(marks.tolist() == [False, True, True, False] for marks in diagonal)


@pytest.mark.parametrize("bits", [90, 1100])
def test_what_floats_cannot_tell_apart_is_chosen_exactly(bits: int) -> None:
    """Forty states in a row, each with two actions that differ by less than any rounding."""
    size, more = 40, F(1, 2**bits)
    rows: list[Any] = [
        (s, a, [(1, s + 1, 1 + more * (a if s % 2 else 1 - a))])
        for s in range(size)
        for a in (0, 1)
    ]
    optimum = certify(MDP.from_outcomes([*rows, (size, 0, [(1, size, 0)])]))
    assert optimum.start_value == size * (1 + more)
    assert optimum.policy[:-1].tolist() == [s % 2 for s in range(size)]
    assert set(optimum.gaps[:-1]) == {more}
    assert optimum.violations() == []


# ---- bounds --------------------------------------------------------------------------------------


def test_bounds_around_a_poor_solution_are_wide_and_hold() -> None:
    mdp = MODELS["cycle, discounted"]
    poor = replace(solve(mdp), value=np.array([5.0, -3.0, 4.0, 0.0]))
    bounds = certify(mdp, bounded=True, solution=poor)
    assert bounds.violations() == []
    best, taken = (certify(model).value for model in (mdp, under(mdp, bounds.policy)))
    between = zip(bounds.lower.tolist(), taken, best, bounds.upper.tolist(), strict=True)
    assert all(low <= own <= right <= high for low, own, right, high in between)
    holds(bounds, best)
    ends = zip(bounds.lower, bounds.value, bounds.upper, bounds.error, strict=True)
    assert all(middle - off <= low <= high <= middle + off for low, middle, high, off in ends)
    assert bounds.error_bound > 1


@pytest.mark.parametrize("part", [0.001, 0.1, 100])
def test_bounds_count_the_roundings_of_the_values_that_they_move(part: float) -> None:
    """Near discount 1 bounds of values far off are 10¹⁰ times as wide: so are their roundings."""
    rows = [[[0.5, 0.5], [0.25, 0.75]], [[0.9, 0.1], [0.5, 0.5]]]
    mdp = MDP.from_arrays(rows, [[1, 0], [0, 2]], 1 - F(1, 10**10), layout="ass")
    solution = solve(mdp)
    poor = replace(solution, value=solution.value * [1 + part, 1 - part])
    bounds = certify(mdp, bounded=True, solution=poor)
    assert bounds.violations() == []
    holds(bounds, certify(mdp).value)


def test_many_states() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[120]).compile()
    optimum = certify(mdp, bounded=True)
    assert optimum.violations() == []
    assert optimum.error_bound < 1e-7
    assert 4_800 < optimum.lower[0] <= optimum.upper[0] < 5_400


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
