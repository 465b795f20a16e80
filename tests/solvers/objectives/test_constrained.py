"""Optima under limits against mixtures of all deterministic policies, and their proofs."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from objective_models import totals, with_components

from exact_mdp import MDP, ConstrainedSolution, ModelError, Scenario, certify, evaluate, solve
from exact_mdp.solvers.objectives.checker import Values
from exact_mdp.solvers.objectives.constrained import limits_of
from exact_mdp.solvers.objectives.file import ObjectivesProof
from exact_mdp.solvers.objectives.simplex import maximise

F = Fraction
LIMITS = st.sampled_from([F(-3), F(-1), F(-1, 3), F(0), F(1, 7), F(1), F(5, 2)])
SENSES = {">=": 1, "<=": -1}


def mixed_optimum(points: list[tuple[F, F]], bound: F) -> F | None:
    """The greatest first coordinate of mixtures whose second is at least the bound: by pairs."""
    kept = [p[0] for p in points if p[1] >= bound]
    for a, b in combinations(points, 2):
        if (a[1] - bound) * (b[1] - bound) < 0:
            share = (bound - b[1]) / (a[1] - b[1])
            kept.append(share * a[0] + (1 - share) * b[0])
    return max(kept, default=None)


def sound(found: ConstrainedSolution, binding: int) -> None:
    """What holds of every solution: the proof, the totals of its policy, few randomised states."""
    assert found.violations() == []
    assert sum(len(own) - 1 for own in found.chances.values()) <= binding
    measured = evaluate(found.mdp, found.policy)
    if found.start_value is not None:
        low, high = measured.start.interval
        assert low <= found.start_value <= high
    for name, total in found.totals.items():
        assert measured.components[name] == pytest.approx(float(total), abs=1e-6)


def test_actions_are_drawn_where_the_first_ones_alone_do_not_lead() -> None:
    """The mixture takes both actions in states 0, 1 and 2; the first of each never visit 1."""
    rows = [
        (0, 0, [(1, 2, 1)]),
        (0, 1, [("1/2", 1, 0), ("1/2", 2, 0)]),
        *[(state, action, [(1, 3, action)]) for state, action in ((1, 0), (1, 1), (2, 0))],
        (2, 1, [(1, 1, 1)]),
        (3, 0, [(1, 3, 0)]),
    ]
    mdp = MDP.from_outcomes(rows, components={"cost": [1, 0, 0, 1, 0, 1, 0]})
    for bound in ("3/2", "5/4"):
        found = solve(mdp, subject_to={"cost": f"<= {bound}"})
        sound(found, 1)
        assert found.start_value == F(bound)


@settings(max_examples=60)
@given(mdp=with_components(1), sense=st.sampled_from([">=", "<="]), bound=LIMITS)
def test_one_limit_is_the_best_mixture_of_two_policies(mdp: MDP, sense: str, bound: F) -> None:
    best = 1 if mdp.sense == "max" else -1
    every = totals(mdp, [*mdp.component_names])
    points = [(best * sum(p, F(0)), SENSES[sense] * p[0]) for p in every]
    wanted = mixed_optimum(points, SENSES[sense] * bound)
    found = solve(mdp, subject_to={"c0": f"{sense} {bound}"})
    sound(found, 1)
    assert found.feasible is (wanted is not None)
    if wanted is not None:
        assert found.start_value == best * wanted
        assert found.closest == {"c0": bound}
        if found.totals["c0"] != bound:  # a limit that does not bind is free
            assert found.prices == {"c0": 0}
    else:
        assert (found.start_value, found.start) == (None, None)
        assert found.closest == {"c0": SENSES[sense] * max(p[1] for p in points)}


@settings(max_examples=40)
@given(mdp=with_components(2), bounds=st.tuples(LIMITS, LIMITS))
def test_two_limits_are_the_program_over_all_policies(mdp: MDP, bounds: tuple[F, F]) -> None:
    best = 1 if mdp.sense == "max" else -1
    every = sorted(set(totals(mdp, [*mdp.component_names])))
    columns = [[p[0], -p[1], F(1)] for p in every] + [[F(-1), F(0), F(0)], [F(0), F(-1), F(0)]]
    worth = [best * sum(p, F(0)) for p in every] + [F(0), F(0)]
    wanted = maximise(worth, columns, [bounds[0], -bounds[1], F(1)])
    found = solve(mdp, subject_to={"c0": f">= {bounds[0]}", "c1": f"<= {bounds[1]}"})
    sound(found, 2)
    assert found.feasible is wanted.feasible
    if wanted.feasible:
        assert found.start_value == best * sum(
            (x * r for x, r in zip(wanted.x, worth, strict=True)), F(0)
        )
    else:
        low, high = found.closest["c0"], found.closest["c1"]
        assert bounds[0] - low == high - bounds[1] == found.shift > 0
        assert maximise(worth, columns, [low, -high, F(1)]).feasible
        near = [low + found.shift / 9, -(high - found.shift / 9), F(1)]
        assert not maximise(worth, columns, near).feasible


def test_holding_anger_to_half_a_point() -> None:
    """The optimum costs 1.2 points of anger; the price is that of the front's edge."""
    scenario = Scenario.load("yuan2025").with_(tasks=[1])
    free = solve(scenario, subject_to={"anger": ">= -100"})
    assert free.start_value == certify(scenario).start_value
    assert free.prices == {"anger": 0}
    assert not free.randomises
    held = solve(scenario, subject_to={"anger": ">= -1/3", "skip": "<= 9/10"})
    assert held.totals["anger"] == F(-1, 3)
    assert held.violations() == []
    assert held.prices["anger"] > 0
    assert len(held.randomises) == 1
    none = solve(scenario, subject_to={"anger": ">= 1/2"})
    assert (none.feasible, none.closest) == (False, {"anger": F(0)})


def test_limits_on_steps_and_with_a_horizon() -> None:
    walk = [[["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]]
    mdp = MDP.from_arrays(walk, [[2, 1], [0, 0]])
    found = solve(mdp, subject_to={"steps": "<= 3/2"})
    assert (found.start_value, found.prices) == (F(5, 2), {"steps": F(3)})
    both = solve(mdp, horizon=2, subject_to={"steps": ["<= 4/3", ">= 4/3"]})
    assert both.totals == {"steps": F(4, 3)}
    assert both.violations() == []


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"a": "3"}, "'3' is no limit"),
        ({"a": "> 3"}, "is no limit"),
        ({"a": ">= x"}, "not a finite rational"),
        ({}, "states no limit"),
        ("a >= 3", "states no limit"),
        ({"angst": ">= 3"}, "nothing to count is called 'angst'"),
    ],
)
def test_what_is_no_limit(limits: Any, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        solve(Scenario.load("yuan2025"), subject_to=limits)
    with pytest.raises(ModelError, match="have one solver"):
        solve(MDP.from_arrays([[[1]]], [0]), "value-iteration", subject_to={"steps": "<= 1"})
    assert str(limits_of({"a": "<=  -1/2"})[0]) == "a <= -1/2"


def test_a_file_says_what_it_counts(tmp_path: Path) -> None:
    """Names in a file may stand for any sum: the reward is checked, and sums are written out."""
    rows = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, "1/2", components={"help": [0, 4, 0], "calm": [5, 0, 0]})
    held = solve(mdp, subject_to={"calm=2*calm": ">= 5"})
    held.save(path := tmp_path / "held.json")
    proof = ObjectivesProof.load(path, "limits")
    assert proof.violations(mdp) == []
    assert [str(limit) for limit in proof.found(mdp)["limits"]] == ["calm=2*calm >= 5"]
    twice = replace(proof, objectives=("return=2*reward", *proof.objectives[1:]))
    dual = proof.content["dual"]
    content = {**proof.content, "dual": Values([2 * v for v in dual.top], dual.below)}
    content["price"] = [F(1), 2 * proof.content["price"][1]]
    assert replace(twice, content=content).violations(mdp) == [
        "what is maximised is not the reward"
    ]


@pytest.mark.parametrize("bound", [0, 1])
def test_a_file_may_say_that_nothing_is_visited(bound: int, tmp_path: Path) -> None:
    """All has ended at the start."""
    rows = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, "1/2", components={"a": [1, 4, 0]}, start=1)
    held = solve(mdp, subject_to={"a": f">= {bound}"})
    assert held.violations() == []
    held.save(path := tmp_path / "held.json")
    proof = ObjectivesProof.load(path, "limits")
    assert (proof.violations(mdp), proof.found(mdp)["feasible"]) == ([], not bound)


def test_the_checker_notices() -> None:
    scenario = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    held = solve(scenario, subject_to={"anger": ">= -1/10"})
    none = solve(scenario, subject_to={"anger": ">= 1/3"})
    first = min(held.flow)
    assert held.violations() == none.violations() == []
    for broken in (
        replace(held, price=(held.price[0] + 1,)),
        replace(held, price=(-held.price[0],)),
        replace(held, flow={**held.flow, first: held.flow[first] + 1}),
        replace(held, flow=solve(scenario, subject_to={"anger": ">= -9"}).flow),
        replace(held, dual=Values([v - 1 for v in held.dual.top], held.dual.below)),
        replace(held, feasible=False),
        replace(held, shift=F(1)),
        replace(none, feasible=True, shift=F(0)),
        replace(none, shift=none.shift / 2),
        replace(none, price=(F(0),)),
    ):
        assert broken.violations()
