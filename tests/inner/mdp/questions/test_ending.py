"""Pairs that are redirected, states that become terminal, and labels at which runs end."""

from fractions import Fraction as F

import numpy as np
import pytest
from oracle import rows_of

from exact_mdp import MDP, ModelError
from exact_mdp.mdp.questions.ending import (
    describe_sense,
    ends_at_label,
    find_labelled_states,
    make_terminal,
    redirect_pairs,
)

ROWS = [(0, 0, [("1/3", 0, 4), ("2/3", 1, 7)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 0, "1/2")])]
MODEL = MDP.from_outcomes(ROWS, "1/2", labels={"there": [1]})


def test_redirected_pairs_lead_to_their_states_and_earn_nothing() -> None:
    """Pair 0 leads to 1, and a new pair to 0; the others stay as they are."""
    table = redirect_pairs(MODEL.table, np.array([1, 0, 0, 1], bool), np.array([1, 0, 0, 0]))
    assert [table.row(pair) for pair in range(4)] == [
        [(F(1), 1, F(0))],
        [(F(1), 1, F(2))],
        [(F(1), 0, F(1, 2))],
        [(F(1), 0, F(0))],
    ]


def test_a_terminal_state_stays_in_all_its_pairs() -> None:
    ended = make_terminal(MODEL, np.array([True, False]), name="ended")
    assert rows_of(ended)[:2] == [(0, 0, F(0), {0: F(1)}), (0, 1, F(0), {0: F(1)})]
    assert rows_of(ended)[2] == rows_of(MODEL)[2]
    assert (ended.name, ended.terminal.tolist()) == ("ended", [True, False])


def test_runs_end_at_one_label_only() -> None:
    assert find_labelled_states(MODEL, "there").tolist() == [False, True]
    assert not ends_at_label(MODEL)
    for asked in (MODEL.until("there"), MODEL.reaching("there")):
        assert ends_at_label(asked)
        with pytest.raises(ModelError, match="already answers a question"):
            find_labelled_states(asked, "there")
    with pytest.raises(ModelError, match="the model has none"):
        find_labelled_states(MODEL.with_(labels={}), "there")
    with pytest.raises(ModelError, match="label"):
        find_labelled_states(MODEL, "here")


def test_the_sense_is_said_in_words() -> None:
    costs = MODEL.with_(sense="min")
    assert [describe_sense(mdp) for mdp in (MODEL, costs, costs.reaching("there"))] == [
        *("", "costs to minimise", "least probability of reaching")
    ]
