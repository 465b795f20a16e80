"""Probabilities of reaching a label, against the recursion over all runs."""

from fractions import Fraction as F

import pytest
from oracle import rows_of
from small_models import three_states

from exact_mdp import MDP, certify


@pytest.mark.parametrize("steps", [0, 1, 4])
@pytest.mark.parametrize("seed", range(8))
def test_what_is_reached_is_the_sum_over_runs(seed: int, steps: int) -> None:
    """The probability of coming there within N steps, by the best of all choices at each step."""
    mdp = three_states(seed, discount="1")
    reached = [F(0), F(0), F(1)]
    for _ in range(steps):
        reached = [F(1) if s == 2 else max(sum(p * reached[t] for t, p in law.items())
                   for u, _, _, law in rows_of(mdp) if u == s) for s in range(3)]  # fmt: skip
    for question in (mdp.reaching("there").within(steps), mdp.within(steps).reaching("there")):
        assert certify(question).start_value == reached[0] / 3 + 2 * reached[2] / 3
        assert list(certify(question).value[:3]) == reached


def test_arrivals_earn_1_once_and_forbidden_states_stay_put() -> None:
    """0 goes to 1, the label, to 2 or to 3, which is not allowed; `reached` is state 4."""
    rows = [
        (0, 0, [("1/4", 1, 7), ("1/4", 2, 7), ("1/2", 3, 7)]),
        (1, 0, [(1, 0, 5)]),
        (2, 0, [(1, 1, -1)]),
        (3, 0, [(1, 1, 9)]),
    ]
    mdp = MDP.from_outcomes(rows, "1/2", labels={"there": [1], "fine": [0, 1, 2]})
    found = mdp.reaching("there", "fine")
    assert rows_of(found) == [
        (0, 0, F(1, 4), {2: F(1, 4), 3: F(1, 2), 4: F(1, 4)}),
        (1, 0, F(1), {4: F(1)}),
        (2, 0, F(1), {4: F(1)}),
        (3, 0, F(0), {3: F(1)}),
        (4, 0, F(0), {4: F(1)}),
    ]
    assert found.labels["fine"].tolist() == [True, True, True, False, False]
    assert certify(found).value.tolist() == [F(1, 2), 1, 1, 0, 0]
    assert certify(mdp.with_(start=3).reaching("there", "fine")).start_value == 0
    assert certify(mdp.with_(start={1: 1, 3: 0}).reaching("there", "fine")).start_value == 1
