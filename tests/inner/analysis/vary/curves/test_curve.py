"""Curves of random families, against policy iteration in fractions at many points."""

from fractions import Fraction as F
from itertools import pairwise

import numpy as np
import pytest
from oracle import policy_values, rows_of, solve_exact

from exact_mdp import MDP, Family, curve

NEAR = F(1, 10**20)  # of a step for derivatives: its square is lost in what is compared


def drawn(seed: int, sense: str = "max", discount: str = "4/5") -> Family:
    """Three states of two pairs; θ shifts mass from one outcome to another, and moves rewards."""
    rng = np.random.default_rng(seed)
    base = [
        [F(int(k), 8) for k in rng.multinomial(4, [1 / 3] * 3) + np.array([1, 2, 1])]
        for _ in range(6)
    ]
    ways = [rng.permutation(3)[:2].tolist() for _ in range(6)]
    reward, slope = rng.integers(-4, 5, (2, 6)).tolist()

    def build(at: dict[str, F]) -> MDP:
        rows = []
        for pair, (law, (to, of)) in enumerate(zip(base, ways, strict=True)):
            moved = [*law]
            moved[to], moved[of] = moved[to] + at["x"] / 8, moved[of] - at["x"] / 8
            earned = reward[pair] + slope[pair] * at["x"]
            each = [(p, t, earned) for t, p in enumerate(moved) if p]
            rows.append((*divmod(pair, 2), each))
        return MDP.from_outcomes(rows, discount, sense=sense, start={0: "1/3", 1: "2/3"})

    return Family(parameters={"x": 0}, build=build)


def start_of(mdp: MDP) -> F:
    """The optimum at the start, by policy iteration in fractions."""
    rows = [(s, a, mdp.sign * r, law) for s, a, r, law in rows_of(mdp)]
    value, _ = solve_exact(3, rows, mdp.discount_exact)
    return mdp.sign * sum(p * value[s] for s, p in mdp.start)


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("seed", range(8))
def test_the_curve_is_the_optimum_at_every_point(seed: int, sense: str) -> None:
    family = drawn(seed, sense)
    found = curve(family, "x", ("-1", "1"), policy=[0, 1, 0])
    assert found.violations() == []
    pieces = found.pieces
    assert (pieces[0].low, pieces[-1].high) == ((-1, -1), (1, 1))
    for one, other in pairwise(pieces):
        assert one.high == other.low
        assert 0 <= one.high[1] - one.high[0] <= F(1, 10**12)
        assert (one.optimal != other.optimal).any()
    points = [F(k, 7) for k in range(-7, 8)]
    points += [(each.low[1] + each.high[0]) / 2 for each in pieces]
    for x in points:
        mdp = family.at({"x": x})
        assert found.at(x) == start_of(mdp)
        own = policy_values([rows_of(mdp)[l] for l in (0, 3, 4)], F(4, 5))
        assert found.fixed_at(x) == own[0] / 3 + 2 * own[1] / 3
    for each in pieces:
        x = (each.low[1] + each.high[0]) / 2
        rise = (start_of(family.at({"x": x + NEAR})) - start_of(family.at({"x": x - NEAR}))) / (
            2 * NEAR
        )
        left, right = found.slope(x)
        assert left == right
        assert abs(left - rise) < F(1, 10**30)


@pytest.mark.parametrize("seed", range(8))
def test_a_policy_is_within_a_tolerance_exactly_where_it_loses_no_more(seed: int) -> None:
    family = drawn(seed)
    found = curve(family, "x", ("-1", "1"), policy=[1, 0, 1])
    loss = {x: found.at(x) - found.fixed_at(x) for x in (F(k, 40) for k in range(-40, 41))}
    tolerance = sorted(loss.values())[30] + F(1, 1000)
    inside = found.within(tolerance)
    for x, lost in loss.items():
        sure = any(each.low[1] <= x <= each.high[0] for each in inside)
        maybe = any(each.low[0] <= x <= each.high[1] for each in inside)
        assert sure <= (lost <= tolerance) <= maybe


@pytest.mark.parametrize("seed", range(4))
def test_the_discount_is_a_parameter_like_any_other(seed: int) -> None:
    mdp = drawn(seed).at({"x": F(1, 2)})
    found = curve(mdp, "discount", ("1/10", "9/10"))
    assert found.violations() == []
    for k in range(1, 10):
        assert found.at(F(k, 10)) == start_of(mdp.with_(discount=F(k, 10)))
