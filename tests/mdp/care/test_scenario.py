"""The compiled care model against the one of `care_oracle.py`, outcome by outcome, exactly."""

import pickle
import warnings
from collections.abc import Iterable
from fractions import Fraction
from itertools import product
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from care_oracle import STATUSES, Oracle
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from own_scenarios import check_own, check_pairs, own_text, scenario_of
from policy_cases import state_of
from refusal_tables import refused, table_of_refusals

from exact_mdp import (
    MDP,
    READINGS,
    Scenario,
    ScenarioWarning,
    gradient,
    one_way,
    psa,
    sobol,
    thresholds,
    tornado,
    worst_point,
)

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
    assert table.compute_probabilities().tolist() == probabilities


# ---- settings and errors -------------------------------------------------------------------------

OWN = [  # a scenario, its names, the number of its states, and the pairs to compare
    (scenario_of(own_text(3, 3)), ("s0", "s1", "s2"), 2 * 2 * 8 + 1, range(2 * 2 * 8 * 3)),
    (scenario_of(own_text(6, 5)), tuple(f"s{i}" for i in range(6)), 2 * 2 * 64 + 1,
     Random(0).sample(range(2 * 2 * 64 * 5), 12)),
    (Scenario.load("tea").with_(tasks=[2]), ("forgetfulness", "distraction", "anxiety"),
     2 * 4 * 8 + 1,
     range(0, 2 * 3 * 8 * 3, 5)),
]  # fmt: skip


@pytest.mark.parametrize(("scenario", "statuses", "states", "pairs"), OWN)
def test_scenarios_of_other_statuses_and_actions(
    scenario: Scenario, statuses: tuple[str, ...], states: int, pairs: Iterable[int]
) -> None:
    mdp = scenario.compile()
    assert (scenario.statuses, mdp.n_states, mdp.terminal.sum()) == (statuses, states, 1)
    check_own(scenario, pairs)


@pytest.mark.parametrize(
    ("assignment", "attribute", "value"),
    [
        ("tasks=[3,1]", "tasks", (3, 1)),
        ("tasks = [ 2 ]", "tasks", (2,)),
        ("max_trial=4", "max_trial", 4),
        ("discount=0.9", "discount", Fraction(9, 10)),
        ("discount=2/3", "discount", Fraction(2, 3)),
        ("readings.tasks=[2]", "tasks", (2,)),
        ("readings.evaluation_discount=0.95", "discount", Fraction(19, 20)),
    ],
)
def test_a_setting_changes_one_attribute(assignment: str, attribute: str, value: object) -> None:
    assert getattr(BASE.set(assignment), attribute) == value


def test_numbers_are_taken_as_they_are_written() -> None:
    assert BASE.set("base.anger=0.1")["base.anger"] == Fraction(1, 10)
    assert BASE.set("base.anger=1/10")["base.anger"] == Fraction(1, 10)
    assert BASE.set("base.anger=1e-1")["base.anger"] == Fraction(1, 10)
    assert BASE.set("reward.anger=-7.5")["reward.anger"] == Fraction(-15, 2)
    assert BASE.with_(parameters={"base.anger": 0.1})["base.anger"] == Fraction(0.1)


test_bad_settings_say_what_and_how_to_mend = table_of_refusals(__file__, globals())


def test_a_scenario_is_frozen_and_survives_a_pickle() -> None:
    with pytest.raises(AttributeError):
        BASE.max_trial = 3
    with pytest.raises(TypeError):
        BASE.readings["skip_onset"] = "base"
    again = pickle.loads(pickle.dumps(BASE))
    assert again == BASE
    with pytest.raises(TypeError):
        again.readings["skip_onset"] = "base"
    assert again.compile().table.row(0) == BASE.compile().table.row(0)


# ---- chances that are cut off at 1 ---------------------------------------------------------------

SMALL = {"tasks": [1], "max_trial": 2}
ADDITIVE = {"influence_on_present": "additive"}
HIGH = {"base.anger": (Fraction(1, 100), Fraction(99, 100))}


def small(**readings: str) -> Scenario:
    return Scenario.load("yuan2025").with_(readings=readings, **SMALL)


def messages(work) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        work()
    assert all(each.category is ScenarioWarning for each in caught)
    assert all(each.filename != warnings.__file__ for each in caught)
    return [str(each.message) for each in caught]


def test_the_default_reading_warns_of_nothing() -> None:
    """Some sums are exactly 1 there, and none is more."""
    own = small()
    assert messages(own.compile) == []


def test_compiling_names_the_numbers() -> None:
    (said,) = messages(small(**ADDITIVE).compile)
    assert "a chance of 1.34 is cut off at 1: persistence.anger 1 + influence" in said
    assert "influence.forgetfulness.anger 0.06" in said
    assert "\n" not in said


def test_a_warning_is_an_error_where_python_is_told_so() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ScenarioWarning, match=r"cut off at 1"):
            small(**ADDITIVE).compile()


@pytest.mark.parametrize(
    "analysis",
    [
        lambda own: tornado(own, ranges=HIGH),
        lambda own: one_way(own, "base.anger", HIGH["base.anger"], points=5),
        lambda own: thresholds(own, "base.anger", (Fraction(1, 2), Fraction(4, 5))),
        lambda own: sobol(own, ranges=HIGH, n=16, rng=0),
        lambda own: worst_point(own, "always:none", HIGH),
        lambda own: psa(
            own.with_(parameters={"base.anger": "7/10"}), 50, rng=0, effective_sample_size=5
        ),
        lambda own: gradient(own.with_(parameters={"base.anger": "9/10"}), names=["base.anger"]),
    ],
)
def test_an_analysis_says_it_once(analysis) -> None:
    """However many models it makes, and in how many of them chances pass 1."""
    (said,) = messages(lambda: analysis(small()))
    assert "is cut off at 1" in said


def test_the_command_line_says_it_in_one_line_on_standard_error() -> None:
    words = ["--set", "readings.influence_on_present=additive", "--set", "tasks=[1]", "--json"]
    for command in (["info", "yuan2025"], ["gradient", "yuan2025"]):
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            done = run(*command, *words)
        assert done.status == 0
        assert done.out.startswith("{")
        (line,) = done.err.splitlines()
        assert line.startswith("warning: scenario yuan2025: a chance of 1.34 is cut off at 1")


def test_an_integer_too_long_for_python_to_print(tmp_path: Path) -> None:
    (tmp_path / "long.toml").write_text("max_trial = 0x" + "f" * 4000)
    refused(lambda: Scenario.load(tmp_path / "long.toml"), "an integer of over 4,000 digits")
