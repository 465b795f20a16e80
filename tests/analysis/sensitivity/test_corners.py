"""The worst point found among corners, against all corners."""

from fractions import Fraction
from itertools import product

import pytest
from made_models import burning

from exact_mdp import (
    MDP,
    Claim,
    ModelError,
    Parametric,
    Scenario,
    evaluate,
    moving,
    parametric,
    solve,
    worst_point,
)

F = Fraction
SMALL = Scenario.load("yuan2025").with_(tasks=[1, 1], max_trial=2)
BOX = {
    "base.anger": (0, F(1, 5)),
    "persistence.confusion": (F(1, 2), 1),
    "skip.confusion.alone": (0, F(2, 5)),
    "reward.anger": (-7, -2),
}
STAY = [["1/2", "1/4", "1/4", 0], ["1/5", "1/2", "1/5", "1/10"], ["1/4", "1/4", "1/4", "1/4"]]
CYCLES = moving(
    MDP.from_arrays([[*STAY, [0, 0, 0, 1]]], [[1], [-2], [3], [0]]), {"p": [(0, 1)], "q": [(1, 3)]}
)
TWO = {"p": (F(1, 10), F(1, 2)), "q": (F(1, 20), F(3, 10))}


def values(
    family: Parametric, policy: object, box: dict[str, tuple[object, object]]
) -> list[float]:
    """Return the policy's value at every corner."""
    mdp = family.at({})
    fixed = solve(mdp).policy if policy == "optimal" else policy
    points = [dict(zip(box, each, strict=True)) for each in product(*box.values())]
    return [evaluate(family.at(point), fixed).mean for point in points]


@pytest.mark.parametrize("policy", ["optimal", "always:directive", "random"])
def test_no_corner_of_a_scenario_is_worse(policy: str) -> None:
    worst = worst_point(SMALL, policy, BOX)
    every = values(parametric(SMALL), policy, BOX)
    assert worst.value.value == pytest.approx(min(every), abs=1e-9)
    assert max(every) > worst.value.value + 1
    there = SMALL.with_(parameters=worst.point).compile()
    assert worst.optimum.value == pytest.approx(solve(there).start_value, abs=1e-9)
    assert worst.optimum.value >= worst.value.value - 1e-9
    assert worst.claim is Claim.ESTIMATED


def test_no_corner_of_a_model_with_cycles_is_worse() -> None:
    worst = worst_point(CYCLES, "optimal", TWO)
    assert worst.value.value == pytest.approx(min(values(CYCLES, "optimal", TWO)), abs=1e-9)
    assert worst.frame()["parameter"].tolist() == ["p", "q"]


def test_a_published_model_with_a_parameter() -> None:
    forest = burning("9/10")
    worst = worst_point(forest, "optimal", {"fire": ("1/20", "3/10")})
    assert worst.point == {"fire": F(3, 10)}
    right = solve(forest.at({"fire": "3/10"})).start_value  # waiting stays optimal there
    assert worst.value.value == pytest.approx(right, abs=1e-9)
    assert worst.optimum.value == pytest.approx(right, abs=1e-9)


def test_of_costs_the_greatest_is_the_worst() -> None:
    """A short way may fail, which costs 7."""
    rows = [
        (0, 0, [("1/2", 1, 1), ("1/2", 2, 1)]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 1, 7)]),
    ]
    costs, rewards = (
        moving(MDP.from_outcomes(rows, sense=sense), {"short": [(0, 1)]})
        for sense in ("min", "max")
    )
    span = {"short": (F(1, 4), F(3, 4))}
    assert worst_point(costs, ranges=span).point == {"short": F(1, 4)}
    assert worst_point(costs, ranges=span).value.value == pytest.approx(1 + 7 * 3 / 4)
    assert worst_point(rewards, ranges=span).point == {"short": F(3, 4)}


@pytest.mark.parametrize(
    "ranges", [{"base.angr": (0, 1)}, {"base.anger": (1, 0)}, {"base.anger": (0, 2)}]
)
def test_what_is_no_range_is_refused(ranges: dict[str, object]) -> None:
    with pytest.raises(ModelError):
        worst_point(SMALL, "optimal", ranges)
