"""Totals without end: signs of what can be stayed in, and finite values beside them."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from exact_mdp import MDP, solve
from exact_mdp.solvers.total import break_near_ties, round_exact_solution


def ring(earned: object, leave: object) -> MDP:
    """0 and 1 go round and earn `earned` and its negation less 1, 0, or plus 1; 0 may leave."""
    rows = [(0, 0, [(1, 1, earned)]), (0, 1, [(1, 2, leave)]), (1, 0, [(1, 0, -1)])]
    return MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])], 1)


@pytest.mark.parametrize(
    ("earned", "values"),
    [("2", [inf, inf]), ("1", [3, 2]), ("1/2", [3, 2])],
)
def test_the_sign_of_a_round_decides(earned: str, values: list[float]) -> None:
    """More than 0 a round is worth +∞; 0 a round is worth what leaving is; less is never stayed in.

    Of a round that earns 0 the total is what is earned until it is left, here at once.
    """
    mdp = ring(earned, 3)
    found, exact = solve(mdp), round_exact_solution(mdp)
    assert exact.value.tolist() == [*values, 0]
    for one in (found.value, exact.value):
        assert [*one[:2]] == pytest.approx(values)


def test_rounded_is_the_exact_number_rounded_once() -> None:
    rows = [(0, 0, [("1/3", 0, 1), ("2/3", 1, "1/7")]), (1, 0, [(1, 1, 0)])]
    found = round_exact_solution(MDP.from_outcomes(rows, 1))
    assert found.value[0] == (1 / 3 + 2 / 21) / (2 / 3) or abs(found.value[0] - 9 / 14) <= 2**-53
    average = round_exact_solution(
        MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (1, 0, [(1, 0, 2)])], 1), "average"
    )
    assert average.value.tolist() == [1.5, 1.5]
    assert average.bias.tolist() == [-0.25, 0.25]


# In state 0 all three actions lead to 1 and 2 by half; what they earn differs by 1e-12.
ROWS = [(0, a, [("1/2", 1, r), ("1/2", 2, r)]) for a, r in enumerate(["0", "1e-12", "0"])]
ROWS += [(s, 0, [(1, s, 1000 * s)]) for s in (1, 2)]
MDP_OF_TIES = MDP.from_outcomes(ROWS, "9/10")


def test_the_better_action_is_found_though_values_are_known_less_well() -> None:
    solution = solve(MDP_OF_TIES)
    for pair in (0, 1, 2):
        chosen = np.array([pair, 3, 4])
        loose = replace(solution, pairs=chosen, state_error=np.full(3, 1e-3))
        assert break_near_ties(loose).pairs.tolist() == [1, 3, 4]


def test_actions_of_one_worth_stay() -> None:
    mdp = MDP_OF_TIES.with_(discount="0")
    solution = replace(solve(mdp), pairs=np.array([2, 3, 4]), state_error=np.full(3, 1.0))
    assert break_near_ties(solution).pairs.tolist() == [1, 3, 4]
    twins = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 0, 1)])], "1/2")
    for pair in (0, 1):
        solution = replace(solve(twins), pairs=np.array([pair]))
        assert break_near_ties(solution).pairs.tolist() == [pair]


def test_infinite_values_are_left_alone() -> None:
    solution = replace(solve(MDP_OF_TIES), value=np.array([np.inf, 1.0, 2.0]))
    assert break_near_ties(solution) is solution
