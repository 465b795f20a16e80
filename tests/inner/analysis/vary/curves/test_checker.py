"""The checker of curves: each rule refuses what breaks it alone."""

from dataclasses import replace
from fractions import Fraction as F
from typing import Any

import pytest
from flint import fmpq_poly

from exact_mdp import MDP, Family, curve
from exact_mdp.analysis.vary.curves.checker import RationalFunction, piece_violations
from exact_mdp.mdp.exact import rational


def build(at: dict[str, F]) -> MDP:
    """Wait for 1 a step with chance x of an end, or go at once for 3; a second state goes round."""
    x = at["x"]
    rows = [
        (0, 0, [(x, 2, 1), (1 - x, 0, 1)]),
        (0, 1, [(1, 2, 3)]),
        (1, 0, [(F(1, 2), 1, x), (F(1, 2), 0, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
    return MDP.from_outcomes(rows, "9/10", start={0: "1/2", 1: "1/2"})


FAMILY = Family(parameters={"x": "1/2"}, build=build)
FOUND = curve(FAMILY, "x", ("1/10", "1"), policy=[0, 0, 0])
MIX = [[(0, rational(F(1)))], [(2, rational(F(1)))], [(3, rational(F(1)))]]


def said(pieces: Any, mix: Any = MIX, sign: int = 1) -> list[str]:
    return list(piece_violations(FAMILY, "x", pieces, mix, sign))


def changed(number: int, **parts: Any) -> list[str]:
    pieces = list(FOUND.pieces)
    pieces[number] = replace(pieces[number], **parts)
    return said(pieces)


def test_what_is_found_holds() -> None:
    """The threshold is at 1/(1 - 9/10 (1 - x)) = 3: x = 7/27."""
    assert said(FOUND.pieces) == []
    assert len(FOUND.pieces) == 2
    low, high = FOUND.pieces[0].high
    assert low <= F(7, 27) <= high


def test_each_rule_refuses_what_breaks_it() -> None:
    one, other = FOUND.pieces
    tops, below = one.values
    assert any("are not those that are optimal" in x for x in changed(0, values=other.values))
    assert any("is better" in x for x in said([replace(one, high=(F(1), F(1)))]))
    assert any("are not those that are optimal" in x for x in changed(0, optimal=other.optimal))
    negative = tuple(-top for top in tops), -below
    assert any("not positive" in x for x in changed(0, values=negative))
    more = tuple(top + below for top in tops), below
    assert any("are not those" in x for x in changed(0, values=more))
    assert any("the value at the start" in x for x in changed(1, start=((0, F(1)),)))
    assert any("the value at the start" in x for x in said(FOUND.pieces, sign=-1))
    outside = F(1, 20), F(1, 20)
    assert any("outside its section" in x for x in changed(0, low=outside))
    assert any("nothing proves" in x for x in changed(1, low=(F(1, 2), F(1, 2))))


def test_the_policy_held_fixed_has_its_own_rules() -> None:
    one, _ = FOUND.pieces
    assert one.fixed_values is not None
    tops, below = one.fixed_values
    assert any("has no value" in x for x in changed(0, fixed_values=None))
    assert any(
        "another value" in x
        for x in changed(0, fixed_values=(tuple(t + below for t in tops), below))
    )
    negative = tuple(-top for top in tops), -below
    assert any("fixed from" in x for x in changed(0, fixed_values=negative))
    assert said([replace(each, fixed_values=None) for each in FOUND.pieces], mix=None) == []
    other = [[(1, rational(F(1)))], *MIX[1:]]
    assert any("another value" in x for x in said(FOUND.pieces, mix=other))


@pytest.mark.parametrize("x", [F(0), F(1, 3), F(-5, 2)])
def test_a_ratio_has_its_value_and_derivative(x: F) -> None:
    """(2 + 4 x) (1 + x) / ((6 + 2 x) (1 + x)), and its derivative 20 / (6 + 2 x)²."""
    shared = fmpq_poly([1, 1])
    values = (fmpq_poly([2, 4]) * shared, fmpq_poly([0, 9])), fmpq_poly([6, 2]) * shared
    found = RationalFunction.of(((0, F(1)),), values)
    assert found.denominator[0] == 1
    assert len(found.numerator) == len(found.denominator) == 2
    assert found.at(x) == (2 + 4 * x) / (6 + 2 * x)
    assert found.slope(x) == F(20) / (6 + 2 * x) ** 2
    assert RationalFunction.of(((0, F(0)),), values).numerator == (0,)
