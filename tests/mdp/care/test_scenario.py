"""The compiled care model against the one of `care_oracle.py`, outcome by outcome, exactly."""

from fractions import Fraction
from itertools import product
from random import Random
from typing import Any

import numpy as np
import pytest
from care_oracle import STATUSES, Oracle
from hypothesis import given, settings
from hypothesis import strategies as st
from own_scenarios import check_pairs
from policy_cases import state_of

from exact_mdp import MDP, READINGS, Scenario

BASE = Scenario.load("yuan2025")
ALL_READINGS = [
    dict(zip(READINGS, options, strict=True)) for options in product(*READINGS.values())
]


def check_shape(mdp: MDP, oracle: Oracle) -> None:
    """States, available actions, the start and the end are the reference's."""
    last = mdp.n_states - 1
    assert mdp.start == ((0, Fraction(1)),)
    assert state_of(mdp, 0) == oracle.start
    assert np.flatnonzero(mdp.terminal).tolist() == [last]
    assert mdp.table.row(mdp.n_pairs - 1) == [(1, last, 0)]
    for number in range(last):
        offered = [mdp.actions[mdp.pair_action[pair]] for pair in mdp.pairs_of(number)]
        assert offered == list(oracle.actions(state_of(mdp, number)))
    # every transition leads on, so that the order of the states is a topological one
    assert (mdp.table.next > mdp.pair_state[mdp.table.pair])[:-1].all()


def sample(mdp: MDP, count: int, seed: int) -> list[int]:
    pairs = range(mdp.n_pairs - 1)
    return Random(seed).sample(pairs, min(count, len(pairs)))


@pytest.mark.parametrize(
    "part", [0, *(pytest.param(part, marks=pytest.mark.slow) for part in range(1, 6))]
)
def test_every_combination_of_readings_is_the_references(part: int) -> None:
    assert len(ALL_READINGS) == 576
    for readings in Random(0).sample(ALL_READINGS, 576)[part::6]:
        mdp = BASE.with_(readings=readings, tasks=[2], max_trial=1).compile()
        oracle = Oracle(readings, tasks=(2,), max_trial=1)
        trials = oracle.trials + (readings["skip_timestep"] == "own")
        flags = 1 + (readings["task_bonus"] == "no-subtask-skipped")
        assert mdp.n_states == 2 * trials * flags * 16 + 1
        check_pairs(mdp, oracle, sample(mdp, 8, 0))


def test_the_shipped_scenario_is_the_papers() -> None:
    oracle = Oracle()
    assert BASE.values() == oracle.parameters
    mdp = BASE.compile()
    check_shape(mdp, oracle)
    check_pairs(mdp, oracle, sample(mdp, 150, 0))
    assert (mdp.n_states, mdp.n_pairs) == (3 * 5 * 16 + 1, 3 * 5 * 16 * 4 + 1)


chances = st.one_of(
    st.sampled_from([Fraction(0), Fraction(1)]), st.fractions(0, 1, max_denominator=60)
)


@settings(max_examples=60)
@given(data=st.data())
def test_any_parameters_under_any_readings(data: st.DataObject) -> None:
    values = {
        name: data.draw(
            st.fractions(-40, 40, max_denominator=9) if name.startswith("reward.") else chances
        )
        for name in data.draw(st.lists(st.sampled_from(BASE.names), max_size=12, unique=True))
    }
    readings = data.draw(st.sampled_from(ALL_READINGS))
    tasks, most = data.draw(st.sampled_from([([1, 1], 1), ([1, 2], 2), ([2], 2)]))
    mdp = BASE.with_(readings=readings, parameters=values, tasks=tasks, max_trial=most).compile()
    oracle = Oracle(readings, tasks=tasks, max_trial=most, parameters=values)
    check_shape(mdp, oracle)
    check_pairs(mdp, oracle, sample(mdp, 20, data.draw(st.integers(0, 10**6))))


@pytest.mark.parametrize(
    "values",
    [
        {"base.anger": "0.1234567891234567"},
        {f"base.{status}": f"0.1234567891234{digit}67" for digit, status in enumerate(STATUSES)},
        {f"skip.{s}.persistence": "0.123456789012345678" for s in STATUSES[2:]},
        {"reward.anger": "-5.000000000000000000001", "reward.trial": "-1/3"},
        {"reward.anger": 2**62 - 1, "reward.trial": 2**62 - 1, "reward.assist.none": 2**62 - 1},
        {"reward.subtask-skip": -(2**63) - 1},
        {
            "reward.timestep": "1/9223372036854775809",
            "skip.anger.persistence": "1/9223372036854775809",
        },
    ],
    ids=["one", "all", "skip", "reward", "sums", "whole", "unsigned"],
)
@pytest.mark.parametrize("skip", ["same", "own"])
def test_numbers_that_outgrow_64_bits_stay_exact(values: dict[str, Any], skip: str) -> None:
    readings = {"skip_timestep": skip, "status_cost": "current" if skip == "own" else "next"}
    mdp = BASE.with_(parameters=values, tasks=[2], max_trial=1, readings=readings).compile()
    exact = {name: Fraction(value) for name, value in values.items()}
    oracle = Oracle(readings, tasks=(2,), max_trial=1, parameters=exact)
    table = mdp.table
    wide = [a.dtype == object for a in (table.weight, table.denominator, table.gain)]
    assert any(wide)
    check_pairs(mdp, oracle, sample(mdp, 40, 3))
    probabilities = [float(p) for pair in range(mdp.n_pairs) for p, _, _ in table.row(pair)]
    assert table.probabilities().tolist() == probabilities


# ---- large scenarios ----------------------------------------------------------------------------
