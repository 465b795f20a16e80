"""Optima under limits against mixtures of all deterministic policies, and their proofs."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import garnet_rows
from objective_models import LIMITS, best_under, sound, totals, with_components

from exact_mdp import MDP, solve

F = Fraction


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


def test_of_many_states_that_are_alike_no_more_draw_than_limits_bind() -> None:
    """Any thirty of sixty states may pay, and half of another one; b tells them apart."""
    rows = [(s, a, [(1, s + 1, -a)]) for s in range(60) for a in (0, 1)]
    parts = {"a": [0, 1] * 60, "b": [s % 7 * a for s in range(60) for a in (0, 1)]}
    ended = {name: [*own, 0] for name, own in parts.items()}
    mdp = MDP.from_outcomes([*rows, (60, 0, [(1, 60, 0)])], components=ended)
    for limits in ({"a": ">= 61/2"}, {"a": ">= 61/2", "b": [">= 200/3", "<= 202/3"]}):
        solution = solve(mdp, subject_to=limits)
        sound(solution, len(limits))
        assert solution.start_value == F(-61, 2)


SIGNS = {">=": 1, "<=": -1}


@settings(max_examples=60)
@given(
    mdp=with_components(2),
    senses=st.lists(st.sampled_from([*SIGNS]), min_size=1, max_size=2),
    bounds=st.tuples(LIMITS, LIMITS),
)
def test_the_optimum_is_the_best_mixture_of_policies(
    mdp: MDP, senses: list[str], bounds: tuple[F, F]
) -> None:
    every = sorted(set(totals(mdp, [*mdp.component_names])))
    points = [(sum(p, F(0)), p[0], p[1]) for p in every]
    signs = {f"c{k}": SIGNS[sense] for k, sense in enumerate(senses)}
    asked = dict(zip(signs, bounds, strict=False))

    def optimum(at: dict[str, F]) -> F | None:
        limits = [(k, signs[name], bound) for k, (name, bound) in enumerate(at.items(), 1)]
        return best_under(points, limits, 1 if mdp.sense == "max" else -1)

    limits = zip(asked.items(), senses, strict=True)
    solution = solve(mdp, subject_to={name: f"{how} {x}" for (name, x), how in limits})
    sound(solution, len(senses))
    best = optimum(asked)
    assert (solution.feasible, solution.start_value) == (best is not None, best)
    if solution.feasible:
        assert solution.closest == asked
        for name, bound in asked.items():  # a limit that does not bind is free
            assert solution.totals[name] == bound or solution.prices[name] == 0
        return
    closest, shift = solution.closest, solution.shift
    assert solution.start is None
    assert closest == {name: x - signs[name] * shift for name, x in asked.items()}
    assert shift > 0
    assert optimum(closest) is not None
    assert optimum({name: x + signs[name] * shift / 9 for name, x in closest.items()}) is None


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
    solution.save(path := tmp_path / "proof.json")
    mdp.save(tmp_path / "model.npz")
    result = run("verify", path, tmp_path / "model.npz", "--json").result
    assert (result["holds"], result["limits"]) == (True, ["calm=2*calm >= 5"])
    twice = replace(solution, objectives=("return=2*reward", *solution.objectives[1:]))
    dual = replace(solution.dual, top=[2 * v for v in solution.dual.top])
    assert replace(twice, dual=dual, price=(2 * solution.price[0],)).violations() == [
        "what is maximised is not the reward"
    ]
