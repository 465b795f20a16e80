"""Terminal values: added to the last step in exact numbers, as a component of their own."""

from fractions import Fraction as F

import numpy as np
import pytest

from exact_mdp import MDP, ModelError
from exact_mdp.mdp.questions.terminal_values import (
    add_terminal_values,
    read_terminal_values,
    require_unpaid,
)
from exact_mdp.mdp.space import StateSpace

ROWS = [(0, 0, [("1/3", 0, "1/2"), ("2/3", 1, "1/2")]), (1, 0, [(1, 1, 2**61)])]
MORE = [F(1, 2), F(2, 3), F(2**61)]


@pytest.mark.parametrize("given", [{1: "1/2"}, [0, F(1, 2)], np.array([0, 0.5]), (0, "1/2")])
def test_values_are_read_by_state(given: object) -> None:
    assert read_terminal_values(given, StateSpace.plain(2)) == [0, F(1, 2)]
    assert read_terminal_values(None, StateSpace.plain(3)) == [0, 0, 0]
    with pytest.raises(ModelError, match="a int does not give a value for each state"):
        read_terminal_values(7, StateSpace.plain(2))


def test_a_state_of_the_goal_has_none() -> None:
    goal, space = np.array([False, True, True]), StateSpace.plain(3)
    require_unpaid([F(5), F(0), F(0)], goal, space)
    with pytest.raises(ModelError, match="state 2"):
        require_unpaid([F(5), F(0), F(1)], goal, space)


def test_sums_are_exact_and_in_lowest_terms_beyond_64_bits() -> None:
    names, table = add_terminal_values(MDP.from_outcomes(ROWS, 1).table, 0, MORE, ("reward",))
    assert names == ("reward",)
    assert table.row(0) == [(F(1, 3), 0, F(1)), (F(2, 3), 1, F(7, 6))]
    assert table.row(1) == [(F(1), 1, F(2**62))]
    assert table.gain_denominator.tolist() == [6, 1]
    assert table.components is None
    _, later = add_terminal_values(MDP.from_outcomes(ROWS, 1).table, 1, [F(1, 3)], ("reward",))
    assert later.row(0) == MDP.from_outcomes(ROWS, 1).table.row(0)
    assert later.row(1) == [(F(1), 1, 2**61 + F(1, 3))]


@pytest.mark.parametrize("by_outcome", [False, True])
def test_they_are_a_component_under_a_free_name(by_outcome: bool) -> None:
    rows = [(0, 0, [("1/3", 0, 3), ("2/3", 1, 3)]), (1, 0, [(1, 1, 2)])]
    amounts = {"terminal value": [1, 2], "b": [2, 0]}
    if by_outcome:
        rows = [(0, 0, [("1/3", 0, 5), ("2/3", 1, 2)]), (1, 0, [(1, 1, 2)])]
    mdp = MDP.from_outcomes(rows, 1, components=amounts)
    names, table = add_terminal_values(mdp.table, 0, MORE, mdp.component_names)
    assert names == ("terminal value", "b", "terminal value'")
    expected, below = table.expected_components_exact()
    each = [[F(int(x), int(b)) for x in row] for row, b in zip(expected, below, strict=True)]
    assert each == [[1, 2, F(11, 18)], [2, 0, 2**61]]
    assert table.expected_gain_exact[0][0] / F(int(table.expected_gain_exact[1][0])) == F(65, 18)
    assert table.averaged == mdp.table.averaged
