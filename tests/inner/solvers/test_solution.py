"""Solutions: action values, gaps and the start value, by their definitions."""

import numpy as np
import pytest

from exact_mdp import MDP, solve


def test_action_values_and_gaps_are_those_of_the_definition() -> None:
    rows = [[[0.25, 0.75], [0, 1]], [[1, 0], [0.5, 0.5]]]
    for sense, sign in (("max", 1), ("min", -1)):
        mdp = MDP.from_arrays(rows, [[1, 3], [2, 0]], "1/2", sense=sense, layout="ass")
        found = solve(mdp)
        q = np.array([[sum(p * x for p, x in zip(rows[a][s], found.value, strict=True)) / 2
                       + [[1, 3], [2, 0]][s][a] for a in range(2)] for s in range(2)])  # fmt: skip
        assert found.q == pytest.approx(q)
        assert found.gap_table == pytest.approx(sign * (found.value[:, None] - q), abs=1e-9)
        assert found.start_value == found.value[0]
    spread = solve(mdp.with_(start={0: "1/4", 1: "3/4"}))
    assert spread.start_value == pytest.approx(spread.value @ [0.25, 0.75])
