"""Optimal for all discounts near 1, and the curve as a command."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import pytest
from cli_runner import run
from hypothesis import given, settings
from strategies import Rows, models

from exact_mdp.analysis.sensitivity import value_function
from exact_mdp.analysis.sensitivity.blackwell import blackwell
from exact_mdp.mdp import MDP, Scenario
from exact_mdp.solvers import certify

F = Fraction
# Puterman (1994), section 3.1; QuantEcon.py, quantecon/markov/tests/test_ddp.py
ROWS = [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])]


@settings(max_examples=60)
@given(rows=models(discounts=(F(1, 2),)))
def test_it_is_optimal_from_there_on_and_not_before(rows: Rows) -> None:
    """Certificates above the threshold, far above and just below it."""
    mdp = rows.model()
    found = blackwell(mdp)
    pairs = [mdp.pair(s, int(a)) for s, a in enumerate(found.policy)]
    room = 1 - found.high
    for above in (found.high + room / 10**6, found.high + room / 3, 1 - room / 10**9):
        optimal = certify(mdp.with_(discount=above)).optimal_pairs
        assert optimal[pairs].all()
        assert optimal[found.optimal].all()
    if found.low > 0:
        below = certify(mdp.with_(discount=found.low - F(1, 10**9))).optimal_pairs
        assert not below[pairs].all()
    costs = mdp.negated()
    assert blackwell(costs).policy.tolist() == found.policy.tolist()


def test_the_threshold_of_puterman_is_found_exactly() -> None:
    found = blackwell(MDP.from_outcomes(ROWS, "1/2"))
    assert found.low == found.high == F(10, 11)
    assert found.frame()["action"].tolist() == ["0", "0"]


def test_the_curve_of_a_discount_goes_up_to_1() -> None:
    found = value_function(MDP.from_outcomes(ROWS, "1/2"), "discount")
    assert found.at("999/1000") == (5 - F(11, 2) * F(999, 1000)) / ((1 - F(999, 2000)) * F(1, 1000))
    assert found.violations() == []


def test_the_curve_covers_all_that_a_parameter_may_be() -> None:
    found = value_function(Scenario.load("tea").with_(tasks=[1], max_trial=2), "base.anxiety")
    assert (found.range.low, found.range.high) == (0, 1)
    assert found.violations() == []
    assert found.at(0) != found.at(1)
    broken = type(found)(**{**vars(found), "pieces": found.pieces[1:]})
    assert broken.violations()


def test_the_command(tmp_path: object) -> None:
    words = ("sensitivity", "tea", "curve", "--set", "tasks=[1]", "--set", "max_trial=2")
    found = run(*words, "--parameter", "base.anxiety", "--json").result
    assert found["claim"] == "certified"
    pieces = found["pieces"]
    assert (pieces[0]["from"], pieces[-1]["to"]) == ("0", "1")
    assert all(a["to"] == b["from"] for a, b in pairwise(pieces))
    first, at = pieces[0], F(pieces[0]["to"]) / 2
    top = sum(F(c) * at**k for k, c in enumerate(first["numerator"]))
    below = sum(F(c) * at**k for k, c in enumerate(first["denominator"]))
    scenario = Scenario.load("tea").with_(tasks=[1], max_trial=2)
    assert top / below == value_function(scenario, "base.anxiety").at(at)
    assert first["policy"].keys() == {f"{n:03b}" for n in range(8)}
    far = run(*words, "--parameter", "discount", "--json").result
    assert F(far["blackwell"]["from"]) < 1
    assert far["blackwell"]["policy"].keys() == first["policy"].keys()
    assert "pieces of the optimal value" in run(*words, "--parameter", "discount").out


@pytest.mark.parametrize("more", [(), ("--parameter", "discount", "--parameter", "base.anxiety")])
def test_one_parameter_is_named(more: tuple[str, ...]) -> None:
    done = run("sensitivity", "tea", "curve", *more)
    assert (done.status, done.out) == (2, "")
    assert "--parameter NAME" in done.err
