"""Optima under limits against mixtures of all deterministic policies, and their proofs."""

from dataclasses import replace
from fractions import Fraction as F
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from objective_models import LIMITS, best_under, sound, totals, with_components

from exact_mdp import MDP, ModelError, certify, check, rationalize, solve, tradeoff


def test_actions_are_drawn_where_the_first_ones_alone_do_not_lead() -> None:
    """It takes both in states 0, 1 and 2; the first of each never visit 1; no run comes to 4."""
    rows = [
        (0, 0, [(1, 2, 1)]),
        (0, 1, [("1/2", 1, 0), ("1/2", 2, 0)]),
        *[(state, action, [(1, 3, action)]) for state, action in ((1, 0), (1, 1), (2, 0))],
        (2, 1, [(1, 1, 1)]),
        (3, 0, [(1, 3, 0)]),
        *[(4, action, [(1, 3, action)]) for action in (0, 1)],
    ]
    mdp = MDP.from_outcomes(rows, components={"cost": [1, 0, 0, 1, 0, 1, 0, 0, 0]})
    for bound in ("3/2", "5/4"):
        solution = solve(mdp, subject_to={"cost": f"<= {bound}"})
        sound(solution, 1)
        assert solution.start_value == F(bound)
        assert solution.rule[4].tolist() == [0, 1]


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
    draw, rows = np.random.default_rng(2), []
    for pair in range(240):
        after, weights = (
            draw.choice(60, 5, replace=False).tolist(),
            draw.integers(1, 99, 5).tolist(),
        )
        earned = F(7 if constant else int(draw.integers(1000)), 1000)
        each = zip(weights, after, strict=True)
        rows.append((pair // 4, pair % 4, [(F(w, sum(weights)), t, earned) for w, t in each]))
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


@pytest.mark.parametrize("more", ["", "--horizon 1", "--until home", "--discount 1/2"])
def test_limits_may_be_on_components_that_do_not_count(more: str, tmp_path: Path) -> None:
    """Help is 4 for 3 of toil, or 1 for 1: half of each for 2. The rest is 9 and 0."""
    rows = [(0, 0, [(1, 1, 16)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])]
    parts = {"help": [4, 1, 0], "toil": [3, 1, 0]}
    model, proof = tmp_path / "model.npz", tmp_path / "proof.json"
    MDP.from_outcomes(rows, components=parts, labels={"home": [False, True]}).save(model)
    asked = f"--reward help {more}"
    found = run(f"solve {asked} --subject-to 'toil <= 2' --certificate", proof, model, "--json")
    assert found.result["exact_start_value"] == "5/2"
    assert run(f"verify {asked} --proven --json", proof, model).result["holds"]
    told = run(f"check {asked} --subject-to 'rest <= 2' --json", model, "always:1").result
    assert [told[name] for name in ("passed", "learned_value", "regret")] == [False, 1, 2 / 3]


# ---- what must not be claimed --------------------------------------------------------------------

STAY_OR_GO = [(0, 0, [(1, 1, -5)]), (0, 1, [(1, 2, -1)]), (1, 0, [(1, 1, 0)])]
HOME = {"home": [False, True, False]}
TWO = MDP.from_outcomes(
    [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])],
    components={"gain": [6, 3, 0], "effort": [-1, 0, 0]},
)


@pytest.mark.parametrize("trap", [[(1, 2, 0)], [("1/2", 2, 1), ("1/2", 2, -1)]])
def test_totals_are_refused_where_a_run_may_end_beside_the_goal(trap: list[object]) -> None:
    mdp = MDP.from_outcomes([*STAY_OR_GO, (2, 0, trap)], labels=HOME).until("home")
    for call in (
        lambda: solve(mdp, subject_to={"reward": ">= -3"}),
        lambda: tradeoff(mdp, ["reward", "steps"]),
        lambda: rationalize(mdp, [0, 0, 0]),
    ):
        with pytest.raises(ModelError, match=r"misses the goal|grow forever"):
            call()
    assert solve(mdp.with_(start=[0, 1, 0]), subject_to={"reward": ">= -3"}).start_value == 0


def test_a_proof_of_totals_does_not_hold_where_a_run_may_end_beside_the_goal() -> None:
    plain = MDP.from_outcomes([*STAY_OR_GO, (2, 0, [(1, 2, 0)])], labels=HOME)
    mdp = plain.until("home")
    proof = solve(mdp.with_(goal=None), subject_to={"reward": ">= -3"})
    assert proof.violations() == []
    totals = proof.of.to_totals()
    totals.model.goal = {1}
    assert any("outside the goal" in fault for fault in totals.find_faults(proof.rank))


def test_weights_are_those_of_all_components() -> None:
    alone = MDP.from_outcomes([(0, 0, [(1, 1, -1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])])
    true, other = (rationalize(mdp, {"0": "1", "1": "0"}) for mdp in (TWO, alone))
    false = replace(other, objectives=("effort",), model=true.model, mdp=TWO)
    assert (true.change, false.change) == (F(1, 2), 0)
    assert false.violations() == ["the weighted totals are not the components of the reward"]
    cut = replace(true.cuts[0], multiplier=inf)
    assert replace(true, cuts=(cut,), change=F(2)).violations()
    assert replace(true, kind="front").violations()


def test_limits_on_one_name_keep_their_own_closest_bounds() -> None:
    solution = solve(TWO, subject_to={"gain": [">= 9", "<= 4"]})
    assert solution.closest == {"gain >= 9": F(6), "gain <= 4": F(7)}
    assert solution.frame()["closest"].tolist() == [F(6), F(7)]


def test_a_proof_is_loaded_with_its_own_model_only(tmp_path: Path) -> None:
    front = tradeoff(TWO, ["gain", "effort"])
    front.save(path := tmp_path / "front.json")
    assert type(front).load(path, TWO).vertices == front.vertices
    with pytest.raises(ModelError, match="another model"):
        type(front).load(path, TWO.with_(discount="1/2"))


# ---- amounts in floats ---------------------------------------------------------------------------

PARTS = {"a": [0.1, 0.7, 0.0], "b": [0.2, 0.0, 0.0], "c": [0.3, 0.0, 0.0]}
REWARD = [0.1 + 0.2 + 0.3, 0.7, 0.0]


def with_floats(first: str = "a") -> MDP:
    """Amounts in floats, whose rounded sum is the reward: the objective is the reward itself."""
    parts = {first if name == "a" else name: amount for name, amount in PARTS.items()}
    rows = [[0, 1], [0, 1], [0, 1]]
    return MDP.from_pairs([0, 0, 1], [0, 1, 0], rows, REWARD, components=parts)


@pytest.mark.parametrize("first", ["a", "reward", "return"])
def test_the_optimum_under_limits_is_one_of_the_reward(first: str) -> None:
    """Also where a component is called as the reward is, or as the objective."""
    mdp = with_floats(first)
    assert mdp.component_names == (first, "b", "c")
    assert sum(map(F, (0.1, 0.2, 0.3))) != F(REWARD[0])
    free = solve(mdp, subject_to={first: "<= 9"})
    assert (free.start_value, free.violations()) == (certify(mdp).start_value, [])
    solution = solve(mdp, subject_to={first: "<= 1/2"})
    share = (F(1, 2) - F(0.1)) / (F(0.7) - F(0.1))
    assert solution.start_value == (1 - share) * F(REWARD[0]) + share * F(0.7)
    assert solution.violations() == []
    audit = check(mdp, [0, 0], subject_to={first: "<= 1/2"})
    assert audit.regret.at_start.value == solution.start_value - F(REWARD[0])


def test_fronts_and_weights_are_of_the_amounts_as_given() -> None:
    mdp = with_floats()
    front = tradeoff(mdp, ["a", "reward"])
    assert front.violations() == []
    assert front.vertices == [(F(0.7), F(0.7))]
    least_change = rationalize(mdp, [0, 0])
    assert least_change.violations() == []
    assert least_change.possible
    assert rationalize(mdp, [1, 0]).change == 0
