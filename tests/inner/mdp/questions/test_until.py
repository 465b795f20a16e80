"""Rewards until a label is reached, and single components, against the recursion over all runs."""

from fractions import Fraction as F

import pytest
from oracle import rows_of
from small_models import three_states

from exact_mdp import MDP, ModelError, certify
from exact_mdp.mdp.questions.origin import origin_of


@pytest.mark.parametrize("seed", range(8))
def test_what_is_earned_until_then_leaves_out_what_comes_after(seed: int) -> None:
    mdp = three_states(seed)
    value = [F(0)] * 3
    question = mdp.until("there").within(5)
    for _ in range(5):
        value = [F(0) if s == 2 else max(r + F(3, 4) * sum(p * value[t] for t, p in law.items())
                 for u, _, r, law in rows_of(mdp) if u == s) for s in range(3)]  # fmt: skip
    assert certify(question).start_value == value[0] / 3 + 2 * value[2] / 3


ROWS = [(0, 0, [("1/2", 0, {"a": 1, "b": 4}), ("1/2", 1, {"a": 3, "b": -2})]),
        (1, 0, [(1, 0, {"a": 5, "b": 5})])]  # fmt: skip
MODEL = MDP.from_outcomes(ROWS, "1/2", labels={"there": [1]})


def test_runs_end_in_the_label_which_is_a_goal_at_discount_1_only() -> None:
    found = MODEL.until("there")
    assert rows_of(found) == [(0, 0, F(3), {0: F(1, 2), 1: F(1, 2)}), (1, 0, F(0), {1: F(1)})]
    assert found.goal is None
    assert found.target is not None
    assert found.target.tolist() == [False, True]
    goal = MODEL.with_(discount=1).until("there").goal
    assert goal is not None
    assert goal.tolist() == [False, True]


def test_one_component_counts_also_of_the_model_that_was_asked_first() -> None:
    """With terminal values for the rewards alone, which no component has."""
    for mdp in (MODEL, MODEL.within(40), MODEL.within(40, terminal_value={0: 100})):
        values = [certify(mdp.until("there", name)).start_value for name in ("a", "b")]
        assert [float(value) for value in values] == pytest.approx([2 / 0.75, 1 / 0.75])
    assert MODEL.within(2).until("there", "b").component_names == ("b",)
    paid = MODEL.within(1, terminal_value={0: 8})
    assert certify(paid.until("there", "terminal value")).start_value == 2
    single = three_states(0)
    origin = origin_of(single.until("there", "reward"))
    assert origin is not None
    assert origin.model is single
    with pytest.raises(ModelError, match="no reward component 'c'"):
        MODEL.until("there", "c")


def test_a_labelled_state_has_no_terminal_value() -> None:
    paid = MODEL.within(2, terminal_value={1: 8})
    with pytest.raises(ModelError, match="earns no terminal value"):
        paid.until("there")
    assert MODEL.within(2, terminal_value={0: 8}).until("there").target is not None
