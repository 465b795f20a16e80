"""Exact fronts against all deterministic policies of small models, and what no front is."""

from __future__ import annotations

import math
import random
from dataclasses import replace
from fractions import Fraction
from itertools import product
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
    found = [tuple(sign * v for v in point) for point in front.vertices]
    assert front.violations() == []
    assert set(found) <= set(every)
    for weights in product(range(1, 5), repeat=3):
        assert best(weights, found) == best(weights, every)
    for vertex in found:  # none is dominated
        assert not any(
            p != vertex and all(a >= b for a, b in zip(p, vertex, strict=True)) for p in every
        )
    assert {i for _, tight in front.facets for i in tight} <= set(range(len(found)))
    point = data.draw(st.sampled_from(every))
    number = every.index(point)
    policy = list(product(*(mdp.pairs_of(s) for s in range(mdp.n_states))))[number]
    far = front.distance(mdp.pair_action[list(policy)])
    assert far == min((best(c.weights, found) - best(c.weights, [point])) for c in front.corners)


def best(weights: Any, points: list[Point]) -> Fraction:
    return max(sum((w * v for w, v in zip(weights, p, strict=True)), F(0)) for p in points)


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


def test_events_and_labels_are_counted() -> None:
    """The probability of a label that is not left, and the steps until the end, by hand."""
    rows = [
        (0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]),
        (0, 1, [("1/3", 0, 0), ("2/3", 1, 0)]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
    labels = {"home": [False, True, False], "away": [False, False, True]}
    mdp = MDP.from_outcomes(rows, labels=labels)
    front = tradeoff(mdp, ["home", "quick=-1*steps"])
    assert front.vertices == [(F(1, 2), F(-1)), (F(1), F(-3, 2))]
    assert front.edges[0].rate == 1
    both = tradeoff(mdp, ["home", "away"])
    assert both.vertices == [(F(1, 2), F(1, 2)), (F(1), F(0))]


def test_what_is_counted_for_ever_is_refused_by_name() -> None:
    rows = [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, components={"a": [1, 2, 0], "b": [0, 1, 0]})
    with pytest.raises(ModelError, match="'a' has no finite total"):
        tradeoff(mdp, ["b", "a"])
    assert tradeoff(mdp.with_(discount="1/2"), ["a", "b"]).vertices == [(F(2), F(1))]


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


def test_an_end_that_earns_components_for_ever_has_no_finite_total_at_discount_1() -> None:
    rows = [(0, 0, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])]
    parts = {"a": [3, -1], "b": [-3, 1], "c": [1, 0]}
    mdp = MDP.from_outcomes(rows, components=parts)
    for names, endless in ((["c", "steps"], "steps"), (["a", "c"], "a")):
        with pytest.raises(ModelError, match=f"'{endless}' has no finite total"):
            tradeoff(mdp, names)
    evaluation = evaluate(mdp, [0, 0])
    assert evaluation.components == {"a": -math.inf, "b": math.inf, "c": 1.0, "rest": -1.0}
    half = evaluate(mdp.with_(discount="1/2"), [0, 0]).components
    assert half == {"a": 2.0, "b": -2.0, "c": 1.0, "rest": -1.0}
    two = MDP.from_outcomes(
        [(0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])],
        components={"a": [0, 1, -1]},
    )
    assert math.isnan(evaluate(two, [0, 0, 0]).components["a"])
    assert evaluate(two.with_(start=1), [0, 0, 0]).components["a"] == math.inf


def test_steps_go_on_where_an_event_happens_for_ever() -> None:
    """It is then counted for ever, too; an end without it is one."""
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 0)]), (1, 0, [(1, 1, 0)])], "3/4")
    mdp = replace(mdp, table=replace(mdp.table, event=np.array([1, 0])), events=("bell",))
    assert tradeoff(mdp, ["bell", "steps"]).vertices == [(F(4), F(4))]
    assert tradeoff(mdp.with_(start=1), ["bell", "steps"]).vertices == [(F(0), F(0))]


def test_a_run_that_misses_the_goal_has_no_finite_total() -> None:
    rows = [(0, 0, [("1/2", 1, 1), ("1/2", 2, 1)]), (0, 1, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])], labels={"goal": [False, True, False]})
    assert tradeoff(mdp, ["reward", "steps"]).vertices == [(F(3), F(1))]
    assert certify(mdp.until("goal")).start_value == math.inf
    sure = MDP.from_outcomes(rows[1:], labels={"goal": [False, True]}).until("goal")
    assert tradeoff(sure, ["reward", "steps"]).vertices == [(F(3), F(1))]


def test_the_checker_notices() -> None:
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


def test_at_discount_0_only_the_start_counts() -> None:
    """What is gained in the state that comes next is no vertex, and no part of an edge."""
    gains = zip(product(range(2), repeat=2), [2, 1, 5, 1], strict=True)
    rows = [(s, a, [(1, 1, gain)]) for (s, a), gain in gains]
    mdp = MDP.from_outcomes(rows, 0, components={"a": [2, 0, 5, 0], "b": [0, 1, 0, 1]})
    assert tradeoff(mdp, ["a", "b"]).vertices == [(0, 1), (2, 0)]
    limited = solve(mdp, subject_to={"b": ">= 1/2"})
    assert (limited.start_value, limited.violations()) == (F(3, 2), [])
    assert rationalize(mdp, [1, 0]).violations() == []


def test_what_is_proposed_instead_of_a_front_of_long_fractions_is_answered() -> None:
    rows = [(s, a, [(1, (s + 1) % 201, 0)]) for s in range(201) for a in (0, 1)]
    mdp = MDP.from_outcomes(rows, "1/2", components={"a": [0, 1] * 201, "b": [2, 0] * 201})
    with pytest.raises(ModelError, match="201 states lead to each other"):
        tradeoff(mdp, ["a", "b"])
    assert tradeoff(mdp.within(3), ["a", "b"]).vertices == [(0, F(7, 2)), (F(7, 4), 0)]
    assert solve(mdp, subject_to={"a": ">= 1"}).violations() == []
