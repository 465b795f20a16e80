"""Intervals at a confidence, and what records leave open."""

from fractions import Fraction as F
from typing import Any

import numpy as np
import pandas as pd
import pytest
from records import NAMES, estimated, recorded

from exact_mdp import MDP, ModelError
from exact_mdp.analysis.gate.data.interval import (
    RegretInterval,
    cut_off,
    find_recorded_ends,
    format_states,
    list_entered_states,
    never_taken,
    observations_of,
    of_process,
    parse_range,
)
from exact_mdp.mdp.space import StateSpace

ROWS: Any = [
    (0, "a", "x", 0, "b", False),
    (0, "b", "x", 0, "c", False),
    (1, "a", "y", 0, "d", True),
    (2, "a", "y", 1, None, False),
]


def model() -> MDP:
    return MDP.from_transitions(pd.DataFrame(ROWS, columns=[*NAMES, "truncated"]), discount="1/2")


def flags(mdp: MDP, states: np.ndarray) -> set[str]:
    return {mdp.space.label(int(s)) for s in np.flatnonzero(states)}


def test_states_that_no_record_leaves() -> None:
    mdp = model()
    (c, d) = (mdp.space.label(mdp.space.number(name)) for name in "cd")
    assert flags(mdp, cut_off(mdp)) == {d}
    assert flags(mdp, find_recorded_ends(mdp)) - {c} == flags(mdp, find_recorded_ends(mdp)) - set(
        list_entered_states(mdp)
    )
    assert list_entered_states(mdp) == (c,)
    plain = estimated(recorded(np.random.default_rng(0), 10))
    assert not cut_off(plain).any()
    assert list_entered_states(plain) == ()


def test_actions_that_nobody_took() -> None:
    mdp = model()
    taken = {
        (int(s), int(a))
        for s, a, n in zip(mdp.pair_state, mdp.pair_action, observations_of(mdp), strict=True)
        if n
    }
    left = {s for s, _ in taken}
    wanted = {(s, a) for s in left for a in range(mdp.n_actions)} - taken
    assert {(s, a) for s, a in never_taken(mdp).tolist()} == wanted
    (s, a) = wanted.pop()
    said = of_process(mdp)
    assert any(f"not available: ({mdp.space.label(s)}: {mdp.actions[a]})" in each for each in said)
    assert any("count as terminal" in each for each in said)
    assert "episodes begin as the model says" in of_process(mdp.with_(start=0))
    assert "episodes begin as the model says" not in said
    single = MDP.from_transitions(pd.DataFrame(ROWS[:2], columns=[*NAMES, "truncated"]), "1/2")
    assert any("only one action" in each for each in of_process(single))
    assert not any("only one action" in each for each in said)


def test_models_without_counts_are_refused() -> None:
    mdp = model()
    for none in (mdp.with_(observations=None), mdp.with_(observations=0 * observations_of(mdp))):
        with pytest.raises(ModelError, match="no counts"):
            observations_of(none)
    assert observations_of(mdp).sum() == 4


def test_a_range_has_its_lower_end_first() -> None:
    assert parse_range(None, "returns") is None
    assert parse_range(("-1/2", 3), "returns") == (-0.5, 3)
    assert parse_range((2, 2), "returns") == (2, 2)
    for wrong in ((3, 2), 5, (1,), ("a", 2)):
        with pytest.raises(ModelError):
            parse_range(wrong, "returns")


def test_names_of_many_states_are_cut_short() -> None:
    mdp = MDP.from_arrays([np.eye(8)], np.ones(8), "1/2").with_(
        space=StateSpace.plain(8, [*"abcdefgh"])
    )
    states = np.zeros(8, dtype=bool)
    states[[1, 2, 4, 5]] = True
    own = [mdp.space.label(s) for s in (1, 2, 4, 5)]
    assert format_states(mdp, states) == f"({', '.join(own)})"
    states[7] = True
    assert format_states(mdp, states) == f"({', '.join(own)} and 1 more)"
    states[0] = True
    assert format_states(mdp, states).endswith(" and 2 more)")


def interval(**parts: Any) -> RegretInterval:
    known: Any = {"low": 0.25, "high": 0.5, "confidence": 0.95, "by": "robust"}
    return RegretInterval(**(known | {"assumptions": ("one", "two"), "found": {"a": 1}} | parts))


def test_an_interval_compares_as_its_two_ends_do() -> None:
    span = interval()
    assert (span <= 0.5, span < 0.5001, span > F(1, 8), span <= 0.125) == (True, True, True, False)
    for limit in (0.25, 0.375):
        with pytest.raises(ModelError, match=r"from 0\.25 to 0\.5") as caught:
            span.__le__(limit)
        assert caught.value.fix.startswith("compare its low or high end")
    assert f"{span:.3f}" == "[0.250, 0.500]"
    assert f"{span}" == str(span)


def test_an_interval_keeps_breaks_or_leaves_open_a_limit() -> None:
    for limit, decision in (
        (F(1, 2), True),
        (1, True),
        (F(1, 4), None),
        (F(3, 8), None),
        (F(1, 8), False),
    ):
        assert interval().keeps_limit(F(limit)) is decision
    assert str(interval()) == "[0.25, 0.5] at 95 % confidence, robust"
    draws = np.array([0.0, 0.25, 0.5, 1.0])
    for limit, share in ((0, 0.25), (F(1, 4), 0.5), (F(1, 5), 0.25), (2, 1.0)):
        assert interval(draws=draws).within(F(limit)).value == share
    facts = interval(draws=draws).list_facts(F(1, 4))
    assert facts["interval"]["probability_within"].value == 0.5
    assert facts["interval"]["a"] == 1
    assert facts["regret_interval"].value == (0.25, 0.5)
    assert facts["confidence"].value == 0.95
    assert facts["by"].value == "robust"
    for draws_or_none, limit in ((None, F(1)), (draws, None)):
        assert (
            "probability_within" not in interval(draws=draws_or_none).list_facts(limit)["interval"]
        )
    assert interval().report().notes == ["assumed: one", "assumed: two"]
    (row,) = interval().frame().to_dict("records")
    assert row == {"low": 0.25, "high": 0.5, "confidence": 0.95, "by": "robust", "a": 1}


def test_a_state_that_was_seen_to_stay_is_no_end_of_the_records() -> None:
    rows: Any = [(0, "b", "x", 1, "a"), (0, "a", "x", 0, "a"), (1, "b", "x", 1, "c")]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=NAMES), discount=1)
    assert mdp.terminal.tolist() == [True, False, True]
    assert find_recorded_ends(mdp).tolist() == [False, False, True]


def test_actions_that_are_not_offered_are_named_by_state() -> None:
    """Action y of state a, although state b has action x."""
    rows: Any = [(0, "a", "x", 1, "b"), (0, "b", "x", 1, None), (1, "b", "y", 1, None)]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=NAMES), discount=1)
    said = [each for each in of_process(mdp) if "not available" in each]
    assert said == ["actions that nobody took are not available: (state a: y)"]
