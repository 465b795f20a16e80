"""Walks on a grid: Sutton and Barto, Russell and Norvig, and Gymnasium's frozen lake.

The cells are numbered as they are read, row by row from the top left, walls left out; where
episodes end, the end comes last. A step off the grid or into a wall leaves the walker in place.
"""

import tomllib
from collections.abc import Iterable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

from .case import Case, Pair, actions, end, indexed, row, table

F = Fraction
BARTO = "Sutton and Barto, Reinforcement Learning (MIT Press 2018), "
AIMA = "aimacode/aima-python tests/test_mdp.py, test_value_iteration and test_best_policy"
AIMA_ERROR = 0.01 / 0.9  # asked for 0.01, but the sweep before the last one is what is returned
LAKE = "jnsp/rl test_policy_iteration.py and transitions.py, "
MOVES = ((-1, 0), (1, 0), (0, -1), (0, 1))  # up, down, left, right
ARROWS = dict(zip("^v<>", ({0}, {1}, {2}, {3}), strict=True))
ARROWS |= {"L": {0, 3}, "J": {0, 2}, "7": {1, 2}, "r": {1, 3}, "+": {0, 1, 2, 3}}
SIDEWAYS = ((2, 3), (2, 3), (0, 1), (0, 1))
Cell = tuple[int, int]


def _cells(grid: Iterable[str]) -> dict[Cell, int]:
    cells = [(y, x) for y, line in enumerate(grid) for x, mark in enumerate(line) if mark != "#"]
    return {cell: s for s, cell in enumerate(cells)}


def _go(cells: Mapping[Cell, int], cell: Cell, move: int) -> Cell:
    there = (cell[0] + MOVES[move][0], cell[1] + MOVES[move][1])
    return there if there in cells else cell


def _sets(arrows: Iterable[str]) -> dict[int, frozenset[int]]:
    marks = [mark for line in arrows for mark in line if mark != "#"]
    return {s: frozenset(ARROWS[mark]) for s, mark in enumerate(marks) if mark != "."}


def teleports() -> Case:
    """The 5 by 5 grid: any step from A earns 10 and lands on A', from B 5 and B'; walls cost 1."""
    cells = _cells(["....."] * 5)
    jumps = {(0, 1): ((4, 1), 10), (0, 3): ((2, 3), 5)}
    pairs: list[Pair] = []
    for cell, s in cells.items():
        for a in range(4):
            there = _go(cells, cell, a)
            there, reward = jumps.get(cell, (there, -1 if there == cell else 0))
            pairs.append((s, a, F(reward), {cells[there]: F(1)}))
    return Case(
        name="barto-teleports",
        source=BARTO + "examples 3.5 and 3.8, figures 3.2 and 3.5, exercise 3.24",
        pairs=tuple(pairs),
        discount=F(9, 10),
        values={
            **table("""
                22.0 24.4 22.0 19.4 17.5
                19.8 22.0 19.8 17.8 16.0
                17.8 19.8 17.8 16.0 14.4
                16.0 17.8 16.0 14.4 13.0
                14.4 16.0 14.4 13.0 11.7"""),
            1: 10 / (1 - F(9, 10) ** 5),
        },
        tolerance=0.05,
        optimal=_sets([">+<+<", "L^J<<", "L^JJJ", "L^JJJ", "L^JJJ"]),
        uniform_values=table("""
             3.3  8.8  4.4  5.3  1.5
             1.5  3.0  2.3  1.9  0.5
             0.1  0.7  0.7  0.4 -0.4
            -1.0 -0.4 -0.4 -0.6 -1.2
            -1.9 -1.3 -1.2 -1.4 -2.0"""),
    )


def corners() -> Case:
    """The 4 by 4 grid: every step costs 1 until either of two opposite corners."""
    cells = _cells(["...."] * 4)
    pairs: list[Pair] = []
    for cell, s in cells.items():
        if s in (0, 15):
            pairs += end(s, 4)
        else:
            pairs += [(s, a, F(-1), {cells[_go(cells, cell, a)]: F(1)}) for a in range(4)]
    return Case(
        name="barto-corners",
        source=BARTO + "example 4.1 and figure 4.1",
        pairs=tuple(pairs),
        discount=F(1),
        values={s: F(-min(y + x, 6 - y - x)) for (y, x), s in cells.items()},
        optimal=_sets([".<<7", "^J+v", "^+rv", "L>>."]),
        uniform_values=indexed(
            map(F, (0, -14, -20, -22, -14, -18, -20, -20, -20, -20, -18, -14, -22, -20, -14, 0))
        ),
        start=5,
        proper=False,
    )


def slippery(name: str, spec: Mapping[str, Any]) -> Case:
    """A case of gridworlds.toml: a step goes where it should 8 times in 10, else to either side."""
    cells, discount = _cells(spec["grid"]), F(spec.get("discount", "9/10"))
    earned = {
        cells[int(cell[0]), int(cell[2])]: F(reward)
        for cell, reward in (spec["ends"] | spec.get("earned", {})).items()
    }
    ends = [cells[int(cell[0]), int(cell[2])] for cell in spec["ends"]]
    last = len(cells)
    pairs: list[Pair] = []
    for cell, s in cells.items():
        reward = earned.get(s, F(spec["living"]))
        if s in ends:
            pairs.append((s, 0, reward, {last: F(1)}))
            continue
        for a in range(4):
            outcomes = [(a, F(8, 10)), *((b, F(1, 10)) for b in SIDEWAYS[a])]
            there = row(*((cells[_go(cells, cell, b)], p) for b, p in outcomes))
            pairs.append((s, a, reward, there))
    return Case(
        name=name,
        source=spec.get("source", AIMA),
        pairs=(*pairs, *end(last)),
        discount=discount,
        values=table(spec["values"]),
        tolerance=spec.get("tolerance", AIMA_ERROR),
        policy={s: min(best) for s, best in _sets(spec["arrows"]).items()},
        start=cells[len(spec["grid"]) - 1, 0],
        proper=discount < 1,
    )


def frozen_lake() -> Case:
    """Gymnasium's FrozenLake-v1, 4x4: a step goes where it should, or to a side, each 1 in 3."""
    grid = ["SFFF", "FHFH", "FFFH", "HFFG"]
    compass = (2, 1, 3, 0)  # Gymnasium counts left, down, right, up
    cells = _cells(grid)
    pairs: list[Pair] = []
    for (y, x), s in cells.items():
        if grid[y][x] in "HG":
            pairs += end(s, 4)
            continue
        for a in range(4):
            there = [_go(cells, (y, x), compass[(a + turn) % 4]) for turn in (-1, 0, 1)]
            goal = sum(F(1, 3) for v, u in there if grid[v][u] == "G")
            pairs.append((s, a, F(goal), row(*((cells[cell], F(1, 3)) for cell in there))))
    return Case(
        name="frozen-lake",
        source=LAKE + "test_policy_iteration_frozen_lake_gridworld; Farama-Foundation/Gymnasium "
        "gymnasium/envs/toy_text/frozen_lake.py",
        pairs=tuple(pairs),
        discount=F(99, 100),
        values=table("""
            0.54202593 0.49880319 0.47069569 0.45685170
            0.55845096 0          0.35834807 0
            0.59179874 0.64307982 0.61520756 0
            0          0.74172044 0.86283743 0"""),
        tolerance=6e-9,
        policy=actions((0, 3, 3, 3, 0, 0, 0, 0, 3, 1, 0, 0, 0, 2, 1, 0)),
    )


def slippery_walk() -> Case:
    """A line of five cells between a hole and a goal; a step succeeds 1 time in 2, reverses 1 in 6.

    Always right, the goal is reached from cell s with probability (1 - 3^-s) / (1 - 3^-6).
    """
    shares = (F(1, 2), F(1, 3), F(1, 6))
    pairs: list[Pair] = [*end(0, 2), *end(6, 2)]
    for s in range(1, 6):
        for a, ahead in enumerate((-1, 1)):
            outcomes = row(*zip((s + ahead, s, s - ahead), shares, strict=True))
            pairs.append((s, a, outcomes.get(6, F(0)), outcomes))
    return Case(
        name="slippery-walk",
        source=LAKE + "test_policy_iteration and test_policy_evaluation_left_policy",
        pairs=tuple(pairs),
        discount=F(1),
        values={**{s: (1 - F(1, 3**s)) / (1 - F(1, 3**6)) for s in range(6)}, 6: F(0)},
        tolerance=6e-9,
        optimal={s: frozenset({1}) for s in range(1, 6)},
        wrong_policy=actions([0] * 7),
        wrong_values=indexed([0, 0.00274725, 0.01098901, 0.03571429, 0.10989011, 0.33241758, 0]),
        start=3,
    )


SPECS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
CASES = (
    teleports(),
    corners(),
    *(slippery(name, spec) for name, spec in SPECS.items()),
    frozen_lake(),
    slippery_walk(),
)
