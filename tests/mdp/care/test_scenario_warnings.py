"""Chances above 1 are cut off, and it is said: once, with the state and the numbers."""

import warnings
from fractions import Fraction

import pytest
from cli_runner import run

from exact_mdp import (
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


def test_compiling_names_the_state_and_the_numbers() -> None:
    (said,) = messages(small(**ADDITIVE).compile)
    assert "a chance of 1.34 is cut off at 1: anger in status 1111 under none" in said
    assert "persistence.anger 1 + influence.forgetfulness.anger 0.06" in said
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
