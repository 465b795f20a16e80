"""The best deterministic policy under limits against enumeration, and what its proof rests on."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from objective_models import totals, with_components

from exact_mdp import Scenario, check, solve
from exact_mdp.mdp import MDP, ModelError
from exact_mdp.solvers.objectives.checker import Values
from exact_mdp.solvers.objectives.deterministic import best_deterministic

F = Fraction
LIMITS = st.sampled_from([F(-3), F(-1), F(-1, 3), F(0), F(1, 7), F(1), F(5, 2)])
SMALL = ("yuan2025", "--set", "tasks=[1]", "--set", "max_trial=2")


@settings(max_examples=40)
@given(mdp=with_components(2), bounds=st.tuples(LIMITS, LIMITS), most=st.sampled_from([1, 2, 99]))
def test_it_is_the_best_of_all_policies(mdp: MDP, bounds: tuple[F, F], most: int) -> None:
    """After few parts it keeps the limits all the same, and the bound holds."""
    sign = 1 if mdp.sense == "max" else -1
    kept = [
        p for p in totals(mdp, [*mdp.component_names]) if p[0] >= bounds[0] and p[1] <= bounds[1]
    ]
    best = max((sign * sum(p, F(0)) for p in kept), default=None)
    limits = {"c0": f">= {bounds[0]}", "c1": f"<= {bounds[1]}"}
    found = best_deterministic(mdp, limits, most)
    assert found.violations() == []
    if best is None:
        assert found.found is None
        assert found.feasible is (None if found.bound is not None else False)
    else:
        assert found.bound is not None
        assert sign * found.bound >= best
        if found.found is not None:
            assert sign * found.start_value <= best
            assert found.totals["c0"] >= bounds[0]
            assert found.totals["c1"] <= bounds[1]
    if most == 99:
        assert found.feasible is (best is not None)
        assert best is None or (sign * found.start_value, found.gap) == (best, 0)


def test_the_care_model_without_a_draw() -> None:
    care = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    limit = {"anger": ">= -1/10"}
    found = solve(care, subject_to=limit, deterministic=True)
    assert found.gap == 0 < found.mixed.start_value - found.start_value
    audit = check(care, found.policy, subject_to=limit)
    assert audit.verdicts[0].passed
    assert audit.value.value == found.mixed.start_value - found.start_value
    part = next(part for part in found.parts if part.bound is not None)
    rest = [other for other in found.parts if other is not part]
    lower = Values([v - 1 for v in part.dual.top], part.dual.below)
    for broken in (
        replace(found, parts=tuple(rest)),
        replace(found, parts=(*rest, replace(part, dual=lower))),
        replace(found, parts=(*rest, replace(part, bound=None))),
        replace(found, parts=(*rest, replace(part, price=(F(1), F(-1))))),
        replace(
            found, parts=tuple(replace(p, bound=p.bound and p.bound - 99) for p in found.parts)
        ),
        replace(
            found,
            mixed=replace(found.mixed, limits=solve(care, subject_to={"anger": ">= 0"}).limits),
        ),
    ):
        assert broken.violations()
    with pytest.raises(ModelError, match="every optimum is deterministic"):
        solve(care, deterministic=True)  # type: ignore[call-overload]


def test_the_command() -> None:
    asked = ("--subject-to", "anger >= -1/10", "--deterministic")
    found = run("solve", *SMALL, *asked, "--json")
    assert (found.status, found.result["gap"], found.result["feasible"]) == (0, "0", True)
    assert F(found.result["exact_start_value"]) < F(found.result["mixed_value"])
    assert F(found.result["totals"]["anger"]) >= F(-1, 10)
    assert "this policy (proven)" in run("solve", *SMALL, *asked).out
    none = run("solve", *SMALL, "--subject-to", "anger >= 1", "--deterministic")
    assert (none.status, "no deterministic policy keeps them" in none.out) == (1, True)
    assert run("solve", *SMALL, "--deterministic").status == 2
