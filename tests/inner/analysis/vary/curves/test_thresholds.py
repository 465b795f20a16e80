"""Thresholds, where two lines cross: each is known in closed form."""

from fractions import Fraction as F

import pytest

from exact_mdp import MDP, Family, thresholds

WIDTH = F(1, 10**12)


def lines(*values: tuple[object, object]) -> Family:
    """One step, in which action k pays a + b θ for the k-th (a, b); the end is state 1."""

    def build(at: dict[str, F]) -> MDP:
        rows = [(0, k, [(1, 1, F(a) + F(b) * at["x"])]) for k, (a, b) in enumerate(values)]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])

    return Family(parameters={"x": 0}, build=build)


@pytest.mark.parametrize("shift", [F(0), F(1, 3), F(-5, 7)])
def test_the_upper_envelope_of_lines_turns_where_they_cross(shift: F) -> None:
    """-x, 1/2 and 2 x - 1 + shift: at -1/2, and where the last passes 1/2."""
    family = lines((0, -1), ("1/2", 0), (shift - 1, 2))
    found = thresholds(family, "x", (-3, 3))
    places = [F(-1, 2), (F(3, 2) - shift) / 2]
    assert len(found.found) == 2
    for each, place in zip(found.found, places, strict=True):
        assert each.low <= place <= each.high
        assert each.high - each.low <= WIDTH
        assert each.value == pytest.approx(float(place))
        assert each.reached
    before, after = ([(*switch.before, *switch.after) for switch in each.switches]
                     for each in found.found)  # fmt: skip
    assert before == [("0", "1")]
    assert after == [("1", "2")]
    low, high = found.stable()
    assert low == pytest.approx(places[0], abs=1e-11)
    assert high == pytest.approx(places[1], abs=1e-11)
    assert float(found.radius) == pytest.approx(min(0.5, float(places[1])))


def test_where_nothing_crosses_the_whole_range_is_stable() -> None:
    found = thresholds(lines((0, 1), (5, 1)), "x", (-3, 2))
    assert found.found == ()
    assert found.stable() == (-3, 2)
    assert found.radius == 2
