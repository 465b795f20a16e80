"""Policies under limits: against enumeration, and as the command reports them."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from objective_models import totals, with_components
from oracle import each_choice

from exact_mdp import MDP, Scenario, assert_policy_optimal, check, solve

F = Fraction
BOUNDS = st.sampled_from([F(-3), F(-1), F(-1, 3), F(0), F(1, 7), F(1), F(5, 2)])


@settings(max_examples=40)
@given(mdp=with_components(1), bound=BOUNDS, data=st.data())
def test_each_policy_against_the_best_mixture(mdp: MDP, bound: F, data: Any) -> None:
    """Passed is within the limit at no regret; states and the room left explain the regret."""
    every = totals(mdp, [*mdp.component_names])
    choices = list(each_choice(mdp))
    number = data.draw(st.integers(0, len(choices) - 1))
    total, earned = every[number][0], sum(every[number], F(0))
    policy = [int(mdp.pair_action[pair]) for pair in choices[number]]
    limit = {"c0": f">= {bound}"}
    audit, best = check(mdp, policy, subject_to=limit), solve(mdp, subject_to=limit)
    assert audit.criterion.best.feasible is best.feasible
    assert (audit.criterion.totals, audit.criterion.earned) == ({"c0": total}, earned)
    if not best.feasible:
        assert not audit.passed
        assert total < bound
        return
    sign = 1 if mdp.sense == "max" else -1
    assert audit.value.value == sign * (best.start_value - earned)
    assert audit.passed is (total >= bound and audit.value.value <= 0)
    explained = sum(each.cost for each in audit.disagreements) + float(audit.criterion.room)
    assert explained == pytest.approx(float(audit.value.value), abs=1e-6)
    assert check(mdp, best.policy, subject_to=limit).passed


def test_the_care_model_under_half_a_point_of_anger() -> None:
    """The free optimum earns 61 more and fails; the best that keeps the limit passes."""
    care, limit = Scenario.load("yuan2025"), {"anger": ">= -1/2"}
    best = solve(care, subject_to=limit)
    audit = assert_policy_optimal(care, best.policy, subject_to=limit)
    assert (audit.value.value, len(audit.disagreements)) == (0, 0)
    free = check(care, "optimal", subject_to=limit)
    assert [each.passed for each in free.verdicts] == [False, True]
    assert float(free.value.value) == pytest.approx(-61.10, abs=0.01)
    with pytest.raises(AssertionError, match="not within the limit anger >= -1/2: its total is -1"):
        assert_policy_optimal(care, "optimal", subject_to=limit)


def test_the_command_says_what_is_kept(tmp_path: Path) -> None:
    small = ("yuan2025", "--set", "tasks=[1]", "--set", "max_trial=2")
    asked = ("--subject-to", "anger >= -1/10", "--subject-to", "steps <= 40")
    written, page, junit = (tmp_path / name for name in ("p.csv", "p.html", "j.xml"))
    run("solve", *small, *asked, "--policy-out", written)
    good = run("check", *small[:1], written, *small[1:], *asked, "--json")
    assert (good.status, good.result["passed"], good.result["kept"]) == (0, True, [True, True])
    assert good.result["limits"] == ["anger >= -1/10", "steps <= 40"]
    assert good.result["totals"]["anger"] == "-1/10"
    assert F(good.result["prices"]["anger"]) > 0
    assert good.result["exact_regret"] == good.result["room"] == "0"
    words = ("check", "yuan2025", "always:directive", *small[1:], *asked, "--html", page)
    bad = run(*words, "--junit", junit, "--markdown")
    assert bad.status == 1
    assert "| anger \\>= -1/10 |" in bad.out
    assert "against the best policy that keeps the limits" in bad.out
    assert "the policy is not within the limit anger" in page.read_text()
    assert len(ElementTree.parse(junit).findall(".//testcase")[0]) == 1
    none = run("check", "yuan2025", "optimal", "--subject-to", "anger >= 1/2", "--json")
    closest = (none.status, none.result["feasible"], none.result["closest"])
    assert closest == (1, False, {"anger": "0"})
    assert none.result["checks"][1]["text"].endswith("can be kept: anger >= 0")
    assert run("check", "yuan2025", "optimal", "--json").result["limits"] is None
