"""Scenarios of one's own, and what is said of settings and files that make none."""

import pickle
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from random import Random

import pytest
from own_scenarios import check_own, own_text, scenario_of
from refusal_tables import refused

from exact_mdp import Scenario

BASE = Scenario.load("yuan2025")


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


# ---- settings and errors --------------------------------------------------------------------


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
def test_settings(assignment: str, attribute: str, value: object) -> None:
    assert getattr(BASE.set(assignment), attribute) == value


def test_numbers_are_taken_as_they_are_written() -> None:
    assert BASE.set("base.anger=0.1")["base.anger"] == Fraction(1, 10)
    assert BASE.set("base.anger=1/10")["base.anger"] == Fraction(1, 10)
    assert BASE.set("base.anger=1e-1")["base.anger"] == Fraction(1, 10)
    assert BASE.set("reward.anger=-7.5")["reward.anger"] == Fraction(-15, 2)
    assert BASE.with_(parameters={"base.anger": 0.1})["base.anger"] == Fraction(0.1)


@pytest.mark.parametrize(
    ("assignment", "what", "fix"),
    [
        ("base.angre=0.1", "unknown parameter 'base.angre'", "base.anger"),
        ("influence.anger.anger=0.1", "unknown parameter", "influence."),
        ("task=[1]", "unknown parameter", "tasks"),
        ("readings.skip_onsets=base", "unknown reading", "skip_onset"),
        ("skip_onset=base", "unknown parameter", "skip_onset"),
        ("base.anger=nan", "not a finite rational", "1/10"),
        ("base.anger=1e999999999", "exponent", "scale"),
        ("=1", "not a setting", "KEY=VALUE"),
        ("base.anger=", "not a setting", "KEY=VALUE"),
        ("tasks=[0]", "tasks", "[3]"),
        ("tasks=[1.5]", "tasks", "[3]"),
        ("tasks=[true]", "tasks", "[3]"),
        ("tasks=3", "tasks", "[3]"),
        ("max_trial=2.5", "max_trial", "1 or more"),
        ("discount=1.1", "discount", "0 to 1"),
        ("tasks=[99999999]", "states", "fewer"),
    ],
)
def test_bad_settings_say_what_and_how_to_mend(assignment: str, what: str, fix: str) -> None:
    assert refused(lambda: BASE.set(assignment), what, "", fix).where


def test_an_integer_too_long_for_python_to_print(tmp_path: Path) -> None:
    (tmp_path / "long.toml").write_text("max_trial = 0x" + "f" * 4000)
    refused(lambda: Scenario.load(tmp_path / "long.toml"), "an integer of over 4,000 digits")


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
