"""Fronts that others have published: deep sea treasure and resource gathering."""

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import pytest

from exact_mdp import MDP, solve, tradeoff

F = Fraction
MOVES = {"up": (-1, 0), "down": (1, 0), "left": (0, -1), "right": (0, 1)}

# Vamplew et al., Machine Learning 84, 2011; the convex map of Yang, Sun and Narasimhan, NeurIPS
# 2019: treasure by column, at these depths, and its front as listed in MO-Gymnasium.
TREASURE = ["0.7", "8.2", "11.5", "14", "15.1", "16.1", "19.6", "20.3", "22.4", "23.7"]
DEPTH = [1, 2, 3, 4, 4, 4, 7, 7, 9, 10]
STEPS = [1, 3, 5, 7, 8, 9, 13, 14, 17, 19]


def deep_sea(discount: Fraction) -> MDP:
    def outcomes(place: Any, move: str) -> Iterator[tuple[int, Any, Any]]:
        row, column = (a + b for a, b in zip(place, MOVES[move], strict=True))
        if not (0 <= row <= 10 and 0 <= column <= 10 and row <= [*DEPTH, 10][column]):
            row, column = place
        treasure = column < 10 and row == DEPTH[column]
        reward = {"treasure": TREASURE[column] if treasure else 0, "time": -1}
        yield 1, "end" if treasure else (row, column), reward

    def actions(place: Any) -> list[str]:
        return [] if place == "end" else [*MOVES]

    return MDP.from_function((0, 0), actions, outcomes, discount)


@pytest.mark.parametrize("discount", [F(99, 100), F(9, 10)])
def test_deep_sea_treasure(discount: Fraction) -> None:
    """The published front, discounted: t g^(n-1) for time (1 - g^n) / (1 - g)."""
    published = [
        (F(t) * discount ** (n - 1), -(1 - discount**n) / (1 - discount))
        for t, n in zip(TREASURE, STEPS, strict=True)
    ]
    front = tradeoff(deep_sea(discount), ["treasure", "time"])
    assert front.violations() == []
    if discount == F(99, 100):
        assert front.vertices == published
    else:  # so impatient that some lie inside of the hull
        assert set(front.vertices) < set(published)
    supports = {(w, max(a + w * b for a, b in front.vertices)) for w in (0, 1, 2)}
    assert supports == {(w, max(a + w * b for a, b in published)) for w in (0, 1, 2)}
    edge = front.edges[-1]  # half-way along it, the price of the limit is that of its slope
    middle = (front.vertices[-2][0] + front.vertices[-1][0]) / 2
    solution = solve(front.mdp, subject_to={"treasure": f">= {middle}"})
    assert (solution.totals["treasure"], solution.prices["treasure"]) == (middle, edge.rate - 1)


HOME, GOLD, GEM, ENEMIES = (4, 2), (0, 2), (1, 4), {(0, 3), (1, 2)}


def gathering(discount: Fraction) -> MDP:
    """Barrett and Narayanan, ICML 2008: fetch gold and a gem; each enemy kills one time in ten."""

    def outcomes(state: Any, move: str) -> Iterator[tuple[object, Any, Any]]:
        at, gold, gem = state
        there = tuple(min(max(a + b, 0), 4) for a, b in zip(at, MOVES[move], strict=True))
        nothing = {"safety": 0, "gold": 0, "gem": 0}
        if there == HOME:
            yield 1, "end", {**nothing, "gold": int(gold), "gem": int(gem)}
            return
        alive = (there, gold or there == GOLD, gem or there == GEM)
        if there in ENEMIES:
            yield "1/10", "end", {**nothing, "safety": -1}
            yield "9/10", alive, nothing
        else:
            yield 1, alive, nothing

    def actions(state: Any) -> list[str]:
        return [] if state == "end" else [*MOVES]

    return MDP.from_function((HOME, False, False), actions, outcomes, discount)


def test_resource_gathering() -> None:
    """All that MO-Gymnasium lists for it is attained, and what is beyond its hull is refuted.

    It discounts once more than we do: a reward of the first step counts g there.
    """
    g = F(9, 10)
    listed = [
        (F(0), F(0), g**10),
        (-(g**7) / 10 - F(9, 100) * g**9, F(81, 100) * g**12, F(81, 100) * g**12),
        (-(g**3) / 10 - F(9, 100) * g**5, F(81, 100) * g**8, F(0)),
        (-(g**7) / 10, F(9, 10) * g**14, F(9, 10) * g**14),
        (F(0), g**12, F(0)),
        (-(g**7) / 10, F(9, 10) * g**10, F(0)),
    ]
    front = tradeoff(gathering(g), ["safety", "gold", "gem"])
    assert front.violations() == []
    mine = [tuple(g * value for value in vertex) for vertex in front.vertices]
    for point in listed:
        assert all(
            dot(w, point) <= max(dot(w, v) for v in mine)
            for w in (c.weights for c in front.corners)
        )
    assert set(mine) <= set(listed)


def dot(weights: Any, point: Any) -> Fraction:
    return sum((w * v for w, v in zip(weights, point, strict=True)), F(0))
