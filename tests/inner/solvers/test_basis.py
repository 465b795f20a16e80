"""Optima under limits from a basis that floats propose, against mixtures of exact policies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from fractions import Fraction as F
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import garnet_rows
from objective_models import LIMITS, sound, totals, with_components

from exact_mdp import MDP, Scenario, solve, tradeoff
from exact_mdp.solvers.objectives import constrained
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.basis import Optimal, by_basis
from exact_mdp.solvers.objectives.checker import Limit, Values, constrained_violations, slack
from exact_mdp.solvers.objectives.constrained import Relaxed, limits_of, relaxed
from exact_mdp.solvers.objectives.file import LimitsProof, ObjectivesProof
from exact_mdp.solvers.objectives.optima import Losses, rank_of
from exact_mdp.solvers.objectives.simplex import maximise

BOUNDS = st.sampled_from([F(-3), F(-1), F(-1, 3), F(1, 7), F(1), F(5, 2)])


@settings(max_examples=40)
@given(mdp=with_components(2), bounds=st.tuples(BOUNDS, BOUNDS))
def test_a_basis_and_mixtures_give_the_same_optimum(mdp: MDP, bounds: tuple[F, F]) -> None:
    of = Objectives.of(mdp, ["reward", "c0", "c1"])
    limits = limits_of({"c0": f">= {bounds[0]}", "c1": f"<= {bounds[1]}"})
    found, wanted = by_basis(of, limits), relaxed(of, limits)
    if found is not None:
        weight = F(found.shift == 0)
        values = (found.flow, (weight, *found.price), found.dual, found.shift)
        assert constrained_violations(of, rank_of(of), limits, *values) == []
        assert found.shift == wanted.shift
        assert found.shift or worth(of, limits, found) == worth(of, limits, wanted)


def worth(of: Objectives, limits: Sequence[Limit], found: Optimal | Relaxed) -> F:
    """The return that prices and values prove to be the greatest."""
    room = sum(x.sign * p * x.bound for x, p in zip(limits, found.price, strict=True))
    return of.at_start(*found.dual) - room


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
def test_states_on_a_cycle_need_no_mixtures(
    limits: Any, draws: int | None, constant: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The basis is found in all cases, also where all policies have the same return."""
    monkeypatch.setattr(constrained, "relaxed", None)
    mdp = ring(constant)
    found = solve(mdp, subject_to=limits)
    assert found.objectives.cyclic
    assert found.violations() == []
    assert found.feasible is (draws is not None)
    assert len(found.randomises) <= (draws or 2)
    if constant and draws:
        assert set(found.prices.values()) == {F(0)}


F = Fraction


@settings(max_examples=30)
@given(mdp=with_components(2), weights=st.tuples(st.integers(0, 9), st.integers(1, 9)))
def test_floats_and_integers_tell_the_same_signs(mdp: MDP, weights: tuple[int, int]) -> None:
    """What pairs lose against a vertex has the sign of the exact slack, with floats or without."""
    front = tradeoff(mdp, ["c0", "c1"])
    of, vertex = front.objectives, front.attained[0]
    losses = Losses(of, vertex)
    worth = [w * F(1, vertex.values[k].below) for k, w in enumerate(weights)]
    parts = [slack(of, a, v) for a, v in zip(of.amounts, vertex.values, strict=True)]
    exact = [sum(w * int(own[pair]) for w, own in zip(worth, parts, strict=True))
             for pair in range(mdp.n_pairs)]  # fmt: skip
    wanted = [(x > 0) - (x < 0) for x in exact]
    assert losses.signs(weights).tolist() == wanted
    losses.near = losses.near * 0
    assert losses.signs(weights).tolist() == wanted


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


def test_a_file_says_what_it_counts(tmp_path: Path) -> None:
    """Names in a file may stand for any sum: the reward is checked, and sums are written out."""
    rows = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, "1/2", components={"help": [0, 4, 0], "calm": [5, 0, 0]})
    held = solve(mdp, subject_to={"calm=2*calm": ">= 5"})
    held.save(path := tmp_path / "held.json")
    proof = ObjectivesProof.load(path)
    assert proof.violations(mdp) == []
    assert [str(limit) for limit in proof.found(mdp)["limits"]] == ["calm=2*calm >= 5"]
    twice = replace(proof, objectives=("return=2*reward", *proof.objectives[1:]))
    assert isinstance(proof, LimitsProof)
    dual = Values([2 * v for v in proof.dual.top], proof.dual.below)
    assert replace(twice, dual=dual, price=(F(1), 2 * proof.price[1])).violations(mdp) == [
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
    proof = ObjectivesProof.load(path)
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
