"""Exact fronts against all deterministic policies of small models, and what no front is."""

import math
import random
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from objective_models import totals, vertices, with_components

from exact_mdp import MDP, ModelError, Scenario, certify, evaluate, rationalize, solve, tradeoff

F = Fraction
Point = tuple[Fraction, ...]


@settings(max_examples=60)
@given(mdp=with_components(2))
def test_two_totals_are_the_hull_of_all_policies(mdp: MDP) -> None:
    sign = 1 if mdp.sense == "max" else -1
    front = tradeoff(mdp, ["c0", "c1"])
    assert front.vertices == sorted(vertices(totals(mdp, ["c0", "c1"]), sign))
    assert front.violations() == []
    assert len(front.edges) == len(front.vertices) - 1
    for edge in front.edges:
        a, b = front.vertices[edge.start], front.vertices[edge.end]
        assert edge.rate == (a[1] - b[1]) / (b[0] - a[0]) > 0
    for vertex, policy in zip(front.vertices, front.policies, strict=True):
        assert front.totals(policy) == vertex
        assert front.distance(policy) == 0
        components = evaluate(mdp, policy).components
        assert (components["c0"], components["c1"]) == pytest.approx(
            tuple(map(float, vertex)), abs=1e-6
        )


@settings(max_examples=40)
@given(mdp=with_components(3), data=st.data())
def test_three_totals_bound_all_policies_and_are_attained(mdp: MDP, data: Any) -> None:
    sign = 1 if mdp.sense == "max" else -1
    names = ["c0", "c1", "c2"]
    every = [tuple(sign * v for v in point) for point in totals(mdp, names)]
    front = tradeoff(mdp, names)
    attained = [tuple(sign * v for v in point) for point in front.vertices]
    assert front.violations() == []
    assert set(attained) <= set(every)
    for weights in product(range(1, 5), repeat=3):
        assert best(weights, attained) == best(weights, every)
    for vertex in attained:  # none is dominated
        assert not any(
            p != vertex and all(a >= b for a, b in zip(p, vertex, strict=True)) for p in every
        )
    assert {i for _, tight in front.facets for i in tight} <= set(range(len(attained)))
    point = data.draw(st.sampled_from(every))
    number = every.index(point)
    policy = list(product(*(mdp.pairs_of(s) for s in range(mdp.n_states))))[number]
    far = front.distance(mdp.pair_action[list(policy)])
    assert far == min((best(c.weights, attained) - best(c.weights, [point])) for c in front.corners)


def best(weights: Any, points: list[Point]) -> Fraction:
    return max(sum((w * v for w, v in zip(weights, p, strict=True)), F(0)) for p in points)


@settings(max_examples=40)
@given(mdp=with_components(1, for_ever=True))
def test_steps_go_on_where_a_component_is_earned_for_ever(mdp: MDP) -> None:
    """Against all policies; the components of one are those that `evaluate` finds."""
    sign = 1 if mdp.sense == "max" else -1
    front = tradeoff(mdp, ["c0", "steps"])
    assert front.vertices == sorted(vertices(totals(mdp, ["c0", "steps"]), sign))
    assert front.violations() == []
    components = evaluate(mdp, front.policies[0]).components
    assert components["c0"] == pytest.approx(float(front.vertices[0][0]), abs=1e-9)


HOME = MDP.from_outcomes(
    [
        (0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]),
        (0, 1, [("1/3", 0, 0), ("2/3", 1, 0)]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 2, 0)]),
    ],
    labels={"home": [False, True, False], "away": [False, False, True]},
)
STAYS = MDP.from_outcomes(
    [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])],
    components={"a": [1, 2, 0], "b": [0, 1, 0]},
)
EARNS = MDP.from_outcomes(  # in its end, for ever
    [(0, 0, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])], components={"a": [3, -1], "b": [-3, 1], "c": [1, 0]}
)
RINGS = MDP.from_outcomes([(0, 0, [(1, 0, 0)]), (1, 0, [(1, 1, 0)])], "3/4")  # for ever, in state 0
RINGS = replace(RINGS, table=replace(RINGS.table, event=np.array([1, 0])), events=("bell",))
GOAL = [(0, 0, [("1/2", 1, 1), ("1/2", 2, 1)]), (0, 1, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])]
MISSES = MDP.from_outcomes([*GOAL, (2, 0, [(1, 2, 0)])])
SURE = MDP.from_outcomes(GOAL[1:], labels={"goal": [False, True]}).until("goal")
NOW = MDP.from_outcomes(  # what is gained in the state that comes next does not count
    [
        (s, a, [(1, 1, gain)])
        for s, both in enumerate([(2, 1), (5, 1)])
        for a, gain in enumerate(both)
    ],
    0,
    components={"a": [2, 0, 5, 0], "b": [0, 1, 0, 1]},
)


@pytest.mark.parametrize(
    ("mdp", "names", "wanted"),
    [
        (HOME, ["home", "quick=-1*steps"], [(F(1, 2), -1), (1, F(-3, 2))]),
        (HOME, ["home", "away"], [(F(1, 2), F(1, 2)), (1, 0)]),
        (STAYS, ["b", "a"], "grow forever"),
        (STAYS.with_(discount="1/2"), ["a", "b"], [(2, 1)]),
        (EARNS, ["c", "steps"], "grow forever"),
        (EARNS, ["a", "c"], "no policy from the start has finite totals"),
        (RINGS, ["bell", "steps"], [(4, 4)]),
        (RINGS.with_(start=1), ["bell", "steps"], [(0, 0)]),
        (MISSES, ["reward", "steps"], [(3, 1)]),
        (SURE, ["reward", "steps"], [(3, 1)]),
        (NOW, ["a", "b"], [(0, 1), (2, 0)]),
    ],
)
def test_fronts_by_hand(mdp: MDP, names: list[str], wanted: Any) -> None:
    """What is counted for ever at discount 1 is refused."""
    if isinstance(wanted, str):
        with pytest.raises(ModelError, match=wanted):
            tradeoff(mdp, names)
        return
    front = tradeoff(mdp, names)
    assert (front.vertices, front.violations()) == (wanted, [])
    for edge, (left, right) in zip(front.edges, pairwise(wanted), strict=True):
        assert edge.rate == F(left[1] - right[1]) / (right[0] - left[0])


def test_a_total_may_be_called_as_a_column_is() -> None:
    rows = [(0, a, [(1, 1, 0)]) for a in range(3)]
    parts = {"rate": [0, 2, 3, 0], "calm": [5, 4, 0, 0]}
    mdp = MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], components=parts)
    front = tradeoff(mdp, ["rate", "calm"])
    assert [tuple(row[:2]) for row in front.frame().to_numpy()] == front.vertices
    assert [row[0] for row in front.report().shown_tables()[0].cells()] == ["0", "2", "3"]


def test_components_that_an_end_earns_for_ever_are_infinite() -> None:
    ends = {"a": -math.inf, "b": math.inf, "c": 1.0, "rest": -1.0}
    assert evaluate(EARNS, [0, 0]).components == ends
    half = evaluate(EARNS.with_(discount="1/2"), [0, 0]).components
    assert half == {"a": 2.0, "b": -2.0, "c": 1.0, "rest": -1.0}
    rows = [(0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
    two = MDP.from_outcomes(rows, components={"a": [0, 1, -1]})
    assert math.isnan(evaluate(two, [0, 0, 0]).components["a"])
    assert evaluate(two.with_(start=1), [0, 0, 0]).components["a"] == math.inf


def test_the_checker_notices_false_fronts() -> None:
    """A lost vertex, a lost bound, another total and values too low are all found."""
    front = tradeoff(Scenario.load("yuan2025").with_(tasks=[1]), ["anger", "subtask-complete"])
    assert len(front.vertices) > 3
    one = front.attained[1]
    low = [replace(c, dual=replace(c.dual, top=[v - 1 for v in c.dual.top])) for c in front.corners]
    for broken in (
        replace(front, attained=front.attained[1:]),
        replace(front, attained=(*front.attained[:1], *front.attained[2:])),
        replace(front, corners=front.corners[1:]),
        replace(front, corners=tuple(low)),
        replace(front, attained=(replace(one, total=(F(0), F(0))), *front.attained)),
        replace(front, attained=(replace(one, pairs=one.pairs[:-1]), *front.attained[1:])),
        replace(front, attained=(*front.attained, one)),
    ):
        assert broken.violations()


@pytest.mark.parametrize("third", [{}, {"far": [0, 1, 3, 0]}], ids=["two", "three"])
def test_a_vertex_written_twice_does_not_count_twice(third: dict[str, list[int]]) -> None:
    """Copies of a vertex, with bounds for its weights alone, would fill the weights of others."""
    rows = [(0, a, [(1, 1, 0)]) for a in range(3)] + [(1, 0, [(1, 1, 0)])]
    parts = {"help": [0, 2, 3, 0], "calm": [5, 4, 0, 0], **third}
    front = tradeoff(MDP.from_outcomes(rows, "1/2", components=parts), list(parts))
    assert front.violations() == []
    assert len(front.attained) > 1
    for number, vertex in enumerate(front.attained):
        own = tuple(replace(c, best=(0, 1)) for c in front.corners if number in c.best)
        forged = [replace(front, attained=(vertex,) * n, corners=own) for n in range(2, 7)]
        forged.append(replace(front, attained=(*front.attained, vertex)))
        assert all("written twice" in " ".join(each.violations()) for each in forged)


@pytest.mark.parametrize("size", [10**12, 10**18, 10**30, 10**100])
def test_amounts_of_very_different_size(size: int) -> None:
    """Floats then propose policies that others beat: none of them may become a vertex."""
    for seed in range(15):
        rng, rows, parts = random.Random(seed), [], {"a": [], "b": []}
        for state, action in product(range(3), range(3)):
            ahead = rng.sample(range(3), 2)
            rows.append((state, action, [("1/2", s, 0) for s in ahead]))
            for amounts in parts.values():
                amounts.append(rng.randint(-3, 3) * rng.choice([1, size]))
        mdp = MDP.from_outcomes(rows, "9/10", components=parts)
        front = tradeoff(mdp, ["a", "b"])
        assert front.vertices == sorted(vertices(totals(mdp, ["a", "b"]), 1))
        assert front.violations() == []


def test_the_front_of_the_care_model() -> None:
    """Its best sum is the optimum; both ends are the optima of one total alone."""
    mdp = Scenario.load("yuan2025").with_(tasks=[1, 1]).compile()
    front = tradeoff(mdp, ["anger", "rest=forget+confuse+disengaged+trial+subtask-complete+"
        "subtask-skip+timestep+task-complete+assist.none+assist.supportive+assist.non-directive"
        "+assist.directive"])  # fmt: skip
    assert max(a + b for a, b in front.vertices) == certify(mdp).start_value
    assert front.violations() == []
    assert front.distance("optimal") == 0
    assert front.distance("random") > 0
    steps = tradeoff(mdp, ["steps", "skip"])
    evaluation = evaluate(mdp, "random")
    assert float(steps.totals("random")[0]) == pytest.approx(evaluation.steps)
    assert all(0 <= v[1] <= 2 for v in steps.vertices)


def test_at_discount_0_limits_and_weights_have_proofs() -> None:
    limited = solve(NOW, subject_to={"b": ">= 1/2"})
    assert (limited.start_value, limited.violations()) == (F(3, 2), [])
    assert rationalize(NOW, [1, 0]).violations() == []
