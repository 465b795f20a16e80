"""Storm's multi-objective answers against our fronts: total rewards and the chance of a label.

Storm encloses the achievable totals between two polygons, in rationals here; we have their vertices
(Forejt, Kwiatkowska and Parker, ATVA 2012; Quatmann and Katoen, TACAS 2021). These tests run where
stormpy is installed: `make bench`, or `pytest -m storm`.
"""

import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exact_mdp import MDP, Scenario, save, tradeoff

pytestmark = [pytest.mark.bench, pytest.mark.storm]

F = Fraction
NEAR = F(1, 1000)  # Storm's polygons are this close to each other, on the scale of the totals
NUMBER = r"\s*(-?[0-9]+(?:/[0-9]+)?)\s*"
HALF = re.compile(rf"\({NUMBER},{NUMBER}\) \* x <={NUMBER}")
POINT = re.compile(rf"^\s*\({NUMBER},{NUMBER}\)", re.MULTILINE)


def care() -> MDP:
    return Scenario.load("yuan2025").with_(tasks=[1, 1]).compile()


def walk(states: int = 15, seed: int = 7) -> MDP:
    """States that lead to each other, and in the end home or astray."""
    rng, rows, effort = np.random.default_rng(seed), [], []
    for state in range(states):
        for action in range(3):
            ahead = rng.choice(states, 2, replace=False).tolist()
            home = int(rng.integers(1, 4))
            chances = [F(4, 10), F(6, 10) - F(home, 10) - F(1, 10), F(home, 10), F(1, 10)]
            ends = zip(chances, [*ahead, states, states + 1], strict=True)
            rows.append((state, action, [(p, to, 0) for p, to in ends if p]))
            effort.append(home * int(rng.integers(1, 9)))
    rows += [(end, 0, [(1, end, 0)]) for end in (states, states + 1)]
    labels = {
        name: [state == end for state in range(states + 2)]
        for name, end in (("home", states), ("astray", states + 1))
    }
    parts = {"effort": [*effort, 0, 0], "gain": [*rng.integers(0, 9, 3 * states).tolist(), 0, 0]}
    return MDP.from_outcomes(rows, components=parts, labels=labels)


@pytest.mark.parametrize(
    ("mdp", "names", "query"),
    [
        (
            care(),
            ["anger", "subtask-complete"],
            'multi(R{"anger"}max=? [C], R{"subtask_complete"}max=? [C])',
        ),
        (walk(), ["gain", "home"], 'multi(R{"gain"}max=? [C], Pmax=? [F "home"])'),
        (
            walk(9, 3),
            ["less=-1*effort", "home"],
            'multi(R{"effort"}min=? [C], Pmax=? [F "home"])',
        ),
    ],
    ids=["care", "gain or home", "effort or home"],
)
def test_storm_encloses_our_front(tmp_path: Path, mdp: MDP, names: list[str], query: str) -> None:
    stormpy = pytest.importorskip("stormpy")
    save(mdp, tmp_path / "model.umb")
    model = stormpy.build_model_from_umb(str(tmp_path / "model.umb"))
    (formula,) = stormpy.parse_properties(query)
    text = str(stormpy.model_checking(model, formula))
    signs = [-1 if "min" in part else 1 for part in query.split("?")[:2]]
    vertices = tradeoff(mdp, names).vertices
    under, over, points = (part for part in re.split(r"Over|Pareto optimal", text, maxsplit=2))
    ours = [tuple(s * v for s, v in zip(signs, vertex, strict=True)) for vertex in vertices]
    assert len(ours) > 2
    for inner, half_planes in ((True, HALF.findall(under)), (False, HALF.findall(over))):
        assert half_planes
        for numbers in half_planes:
            a, b, most = map(F, numbers)
            if any(part * sign < 0 for part, sign in zip((a, b), signs, strict=True)):
                continue  # an edge that is no part of the front
            best = max(a * x + b * y for x, y in ours)
            wide = NEAR * scale(ours) * (abs(a) + abs(b))
            assert most <= best <= most + wide if inner else most - wide <= best <= most
    points_of_storm = POINT.findall(points)
    assert points_of_storm
    for point in points_of_storm:
        assert tuple(map(F, point)) in ours


def scale(points: Sequence[tuple[Any, ...]]) -> Fraction:
    return max(abs(F(v)) for point in points for v in point)
