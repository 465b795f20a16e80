"""Optima under limits against mixtures of all deterministic policies, and their proofs."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import garnet_rows
from objective_models import LIMITS, best_under, sound, totals, with_components

from exact_mdp import MDP, Scenario, certify, solve

F = Fraction
SENSES = {">=": 1, "<=": -1}


def mixed_optimum(points: list[tuple[F, F]], bound: F) -> F | None:
    """The greatest first coordinate of mixtures whose second is at least the bound: by pairs."""
    allowed = [p[0] for p in points if p[1] >= bound]
    for a, b in combinations(points, 2):
        if (a[1] - bound) * (b[1] - bound) < 0:
            share = (bound - b[1]) / (a[1] - b[1])
            allowed.append(share * a[0] + (1 - share) * b[0])
    return max(allowed, default=None)


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
        solution = solve(mdp, subject_to={"cost": f"<= {bound}"})
        sound(solution, 1)
        assert solution.start_value == F(bound)


@settings(max_examples=60)
@given(mdp=with_components(1), sense=st.sampled_from([">=", "<="]), bound=LIMITS)
def test_one_limit_is_the_best_mixture_of_two_policies(mdp: MDP, sense: str, bound: F) -> None:
    best = 1 if mdp.sense == "max" else -1
    every = totals(mdp, [*mdp.component_names])
    points = [(best * sum(p, F(0)), SENSES[sense] * p[0]) for p in every]
    wanted = mixed_optimum(points, SENSES[sense] * bound)
    solution = solve(mdp, subject_to={"c0": f"{sense} {bound}"})
    sound(solution, 1)
    assert solution.feasible is (wanted is not None)
    if wanted is not None:
        assert solution.start_value == best * wanted
        assert solution.closest == {"c0": bound}
        if solution.totals["c0"] != bound:  # a limit that does not bind is free
            assert solution.prices == {"c0": 0}
    else:
        assert (solution.start_value, solution.start) == (None, None)
        assert solution.closest == {"c0": SENSES[sense] * max(p[1] for p in points)}


@pytest.mark.parametrize("floats", [True, False])
@settings(max_examples=15)
@given(mdp=with_components(2), bounds=st.tuples(LIMITS, LIMITS))
def test_two_limits_are_the_best_mixture_of_policies(
    floats: bool, mdp: MDP, bounds: tuple[F, F]
) -> None:
    """With the basis that floats propose, or by exact steps from the greatest return on."""
    every = sorted(set(totals(mdp, [*mdp.component_names])))
    points = [(sum(p, F(0)), p[0], p[1]) for p in every]
    best = 1 if mdp.sense == "max" else -1

    def optimum(low: F, high: F) -> F | None:
        return best_under(points, [(1, 1, low), (2, -1, high)], best)

    with pytest.MonkeyPatch.context() as patch:
        if not floats:
            patch.setattr("exact_mdp.solvers.objectives.limits._Program._proposed", lambda *_: None)
        solution = solve(mdp, subject_to={"c0": f">= {bounds[0]}", "c1": f"<= {bounds[1]}"})
    sound(solution, 2)
    assert (solution.feasible, solution.start_value) == (
        optimum(*bounds) is not None,
        optimum(*bounds),
    )
    if not solution.feasible:
        low, high = solution.closest["c0"], solution.closest["c1"]
        assert bounds[0] - low == high - bounds[1] == solution.shift > 0
        assert optimum(low, high) is not None
        assert optimum(low + solution.shift / 9, high - solution.shift / 9) is None


def test_holding_anger_to_half_a_point() -> None:
    """The optimum costs 1.2 points of anger; the price is that of the front's edge."""
    scenario = Scenario.load("yuan2025").with_(tasks=[1])
    free = solve(scenario, subject_to={"anger": ">= -100"})
    assert free.start_value == certify(scenario).start_value
    assert free.prices == {"anger": 0}
    assert not free.randomises
    solution = solve(scenario, subject_to={"anger": ">= -1/3", "skip": "<= 9/10"})
    assert solution.totals["anger"] == F(-1, 3)
    assert solution.violations() == []
    assert solution.prices["anger"] > 0
    assert len(solution.randomises) == 1
    none = solve(scenario, subject_to={"anger": ">= 1/2"})
    assert (none.feasible, none.closest) == (False, {"anger": F(0)})


def test_limits_on_steps_and_with_a_horizon() -> None:
    walk = [[["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]]
    mdp = MDP.from_arrays(walk, [[2, 1], [0, 0]])
    solution = solve(mdp, subject_to={"steps": "<= 3/2"})
    assert (solution.start_value, solution.prices) == (F(5, 2), {"steps": F(3)})
    both = solve(mdp, horizon=2, subject_to={"steps": ["<= 4/3", ">= 4/3"]})
    assert both.totals == {"steps": F(4, 3)}
    assert both.violations() == []


def ring(constant: bool = False) -> MDP:
    """A random model of 60 states on one cycle, of three totals."""
    rows, draw = garnet_rows(60, rng=1), np.random.default_rng(2)
    if constant:
        rows = [(s, a, [(p, n, F(7, 1000)) for p, n, _ in own]) for s, a, own in rows]
    parts = {name: draw.integers(0, 64, len(rows)).tolist() for name in "ab"}
    return MDP.from_outcomes(rows, "19/20", components=parts)


@pytest.mark.parametrize(
    "limits, draws",
    [
        ({"a": ">= 900"}, 1),
        ({"a": ">= 900", "b": ">= 900"}, 2),
        ({"a": [">= 600", "<= 700"]}, 1),
        ({"a": ">= 1000", "b": ">= 1000"}, None),
        ({"a": ">= 2000"}, None),
    ],
)
@pytest.mark.parametrize("constant", [False, True])
def test_states_on_a_cycle(limits: Any, draws: int | None, constant: bool) -> None:
    """Also where all policies have the same return."""
    mdp = ring(constant)
    solution = solve(mdp, subject_to=limits)
    assert solution.violations() == []
    assert solution.feasible is (draws is not None)
    assert len(solution.randomises) <= (draws or 2)
    if constant and draws:
        assert set(solution.prices.values()) == {F(0)}


def test_a_file_says_what_it_counts(tmp_path: Path) -> None:
    """Names in a file may stand for any sum: the reward is checked, and sums are written out."""
    rows = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, "1/2", components={"help": [0, 4, 0], "calm": [5, 0, 0]})
    solution = solve(mdp, subject_to={"calm=2*calm": ">= 5"})
    solution.save(path := tmp_path / "held.json")
    mdp.save(tmp_path / "model.npz")
    result = run("verify", path, tmp_path / "model.npz", "--json").result
    assert (result["holds"], result["limits"]) == (True, ["calm=2*calm >= 5"])
    twice = replace(solution, objectives=("return=2*reward", *solution.objectives[1:]))
    dual = replace(solution.dual, top=[2 * v for v in solution.dual.top])
    assert replace(twice, dual=dual, price=(2 * solution.price[0],)).violations() == [
        "what is maximised is not the reward"
    ]


@pytest.mark.parametrize("bound", [0, 1])
def test_a_file_may_say_that_nothing_is_visited(bound: int, tmp_path: Path) -> None:
    """All has ended at the start."""
    rows = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, "1/2", components={"a": [1, 4, 0]}, start=1)
    solution = solve(mdp, subject_to={"a": f">= {bound}"})
    assert solution.violations() == []
    solution.save(path := tmp_path / "held.json")
    mdp.save(tmp_path / "model.npz")
    result = run("verify", path, tmp_path / "model.npz", "--json").result
    assert (result["holds"], result["feasible"]) == (True, not bound)


def test_the_checker_notices() -> None:
    scenario = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    solution = solve(scenario, subject_to={"anger": ">= -1/10"})
    none = solve(scenario, subject_to={"anger": ">= 1/3"})
    visits = solution.flow.visits
    more = replace(visits, top=[visits.top[0] + 1, *visits.top[1:]])
    assert solution.violations() == none.violations() == []
    for broken in (
        replace(solution, price=(solution.price[0] + 1,)),
        replace(solution, price=(-solution.price[0],)),
        replace(solution, flow=replace(solution.flow, visits=more)),
        replace(solution, flow=solve(scenario, subject_to={"anger": ">= -9"}).flow),
        replace(solution, dual=replace(solution.dual, top=[v - 1 for v in solution.dual.top])),
        replace(solution, feasible=False),
        replace(solution, shift=F(1)),
        replace(none, feasible=True, shift=F(0)),
        replace(none, shift=none.shift / 2),
        replace(none, price=(F(0),)),
    ):
        assert broken.violations()
