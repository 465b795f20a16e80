"""Pieces of a range: values as polynomials of a policy, and thresholds that lie close together."""

from fractions import Fraction as F

import pytest
from oracle import policy_values, rows_of

from exact_mdp import MDP, Family, curve, parametric
from exact_mdp.analysis.vary.curves.equations import Equations
from exact_mdp.analysis.vary.curves.walk import values_of
from exact_mdp.mdp.exact import fraction, rational
from exact_mdp.mdp.parametric.row_change import Piece


def ring(at: dict[str, F]) -> MDP:
    """Two states, both with a pair of rows that move with x; the discount may move as well."""
    x = at["x"]
    rows = [
        (0, 0, [(x, 1, 1), (1 - x, 0, 2 * x)]),
        (1, 0, [(F(1, 4) + x / 2, 0, -x), (F(3, 4) - x / 2, 1, 3)]),
        (1, 1, [(1, 0, 5 * x - 1)]),
    ]
    return MDP.from_outcomes(rows, at.get("g", F(3, 5)))


@pytest.mark.parametrize("shares", [(F(1), F(0)), (F(0), F(1)), (F(1, 3), F(2, 3))])
@pytest.mark.parametrize("name", ["x", "discount"])
def test_values_of_a_policy_are_ratios_of_polynomials(name: str, shares: tuple[F, F]) -> None:
    family = Family(parameters={"x": "1/2"}, build=ring, degrees={"x": 2})
    if name == "discount":
        family = parametric(ring({"x": F(1, 2)}))
    section = Piece(low=F(1, 10), high=F(9, 10), origin=F(1, 2))
    equations = Equations(family, name, section)
    mix = [[(0, rational(F(1)))], [(1 + k, rational(p)) for k, p in enumerate(shares) if p]]
    tops, below = values_of(equations, mix)
    for k in range(1, 10):
        place = F(k, 10)
        mdp = family.at({name: place})
        rows = rows_of(mdp)
        mean = (1, 0, shares[0] * rows[1][2] + shares[1] * rows[2][2],
                {t: shares[0] * rows[1][3].get(t, F(0)) + shares[1] * rows[2][3].get(t, F(0))
                 for t in (0, 1)})  # fmt: skip
        wanted = policy_values([rows[0], mean], mdp.discount_exact)
        d = below(rational(place))
        assert d > 0
        assert [fraction(top(rational(place)) / d) for top in tops] == wanted


@pytest.mark.parametrize("apart", [F(1, 100), F(1, 10**15), F(1, 10**25)])
def test_thresholds_that_lie_close_together_are_both_found(apart: F) -> None:
    """Three lines whose upper envelope turns at 0 and at `apart`, however close that is."""

    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        rows = [(0, 0, [(1, 1, -x)]), (0, 1, [(1, 1, 0)]), (0, 2, [(1, 1, x - apart)])]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])

    found = curve(Family(parameters={"x": 0}, build=build), "x", (-1, 1))
    assert found.violations() == []
    assert [each.optimal[:3].tolist() for each in found.pieces] == [
        [True, False, False], [False, True, False], [False, False, True]]  # fmt: skip
    first, second = found.pieces[0].high, found.pieces[1].high
    assert first[0] <= 0 <= first[1] <= second[0] <= apart <= second[1]
