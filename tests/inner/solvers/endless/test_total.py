"""Totals without end: signs of what can be stayed in, and finite values beside them."""

from math import inf

import pytest

from exact_mdp import MDP, solve
from exact_mdp.solvers.endless.total import round_exact_solution


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
