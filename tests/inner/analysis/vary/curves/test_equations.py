"""Bellman equations in polynomials, against the same equations in fractions at points."""

from fractions import Fraction as F

import pytest
from flint import fmpq_poly
from oracle import mean, rows_of

from exact_mdp import MDP, Family
from exact_mdp.analysis.vary.curves.equations import Equations, weighed
from exact_mdp.mdp.exact import fraction, rational
from exact_mdp.mdp.parametric.row_change import Piece


def family(ends: bool, discount: str = "3/4") -> Family:
    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        back = [(F(1, 2), 0, 0), (F(1, 2), 2, x)] if not ends else [(1, 2, x)]
        rows = [(0, 0, [(x, 1, 4), (1 - x, 2, 0)]), (0, 1, [(1, 1, 1)]), (1, 0, back)]
        return MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])], discount)

    return Family(parameters={"x": "1/2"}, build=build)


def made(ends: bool, discount: str = "3/4", low: F = F(0), high: F = F(1)) -> Equations:
    kind = family(ends, discount)
    return Equations(kind, "x", Piece(low=low, high=high, origin=(low + high) / 2))


@pytest.mark.parametrize("ends", [True, False])
def test_gaps_are_what_pairs_fall_short_of_the_values(ends: bool) -> None:
    equations, kind = made(ends), family(ends)
    values = ((fmpq_poly([1, 2]), fmpq_poly([-1, 0, 3]), fmpq_poly()), fmpq_poly([2, 1]))
    assert equations.follow(values) == {0, 1, 2}
    for x in (F(0), F(1, 3), F(1)):
        mdp, place = kind.at({"x": x}), rational(x)
        below = fraction(values[1](place))
        v = [fraction(top(place)) / below for top in values[0]]
        for pair, (s, _, r, law) in enumerate(rows_of(mdp)[:3]):
            short = v[s] - r - F(3, 4) * mean(law, v)
            assert fraction(equations.gap[pair](place)) == below * short
            assert fraction(equations.ahead(pair, values)(place)) == below * (v[s] - short)
    assert equations.follow(values) == set()
    assert equations.follow(values, taken=[0]) == {0}
    assert equations.gap[0] == fmpq_poly()
    assert equations.live == [0, 1]
    assert (equations.order is None) == (not ends)
    assert equations.differ(0)
    assert not equations.differ(1)


def test_one_solution_is_proved_where_there_is_one() -> None:
    """At discount 1 runs end unless x = 0 keeps them from it."""

    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(at["x"], 1, 1), (1 - at["x"], 0, 1)]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, 1)

    kind = Family(parameters={"x": "1/2"}, build=build)
    for low, one in ((F(1, 10), True), (F(0), False)):
        equations = Equations(kind, "x", Piece(low=low, high=F(1), origin=F(1, 2)))
        assert equations.one_solution() == one
        said = list(equations.unsound())
        assert bool(said) != one
    assert made(False).one_solution()
    assert list(made(False).unsound()) == []
    beyond = made(False, high=F(1))
    beyond.high = F(2)  # where a probability is negative
    assert "negative" in next(beyond.unsound())


def test_a_weighed_sum_is_one() -> None:
    polynomials = [fmpq_poly([1, 2]), fmpq_poly([5]), fmpq_poly([0, 0, 1])]
    assert weighed([(0, F(1, 2)), (2, F(-3))], polynomials) == fmpq_poly([rational(F(1, 2)), 1, -3])
