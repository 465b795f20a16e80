"""Shortest paths with policies that never end: curves and gradients beside exact optima."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction as F
from random import Random
from typing import Any

import numpy as np
import pytest

from exact_mdp import (
    MDP,
    Family,
    ModelError,
    Parameter,
    certify,
    curve,
    evaluate,
    gradient,
    solve,
    thresholds,
)

RANGE = F(1, 10), F(9, 10)


def random_family(rng: Random, *, sense: str = "min") -> Family:
    """Return a random shortest path of four states, in which a policy can wait forever at a cost.

    State 3 is the end. Whatever is drawn, action 0 goes to a higher state with some probability.
    """
    drawn = []
    for state in range(3):
        for action in range(rng.randint(2, 3)):
            ahead = state + 1 if action == 0 else rng.randrange(4)
            behind = rng.randrange(4)
            drawn.append((state, action, ahead, behind, rng.randint(1, 4), rng.randint(0, 3)))

    def build(at: dict[str, F]) -> MDP:
        rows = []
        for state, action, ahead, behind, cost, slope in drawn:
            paid = (cost + slope * at["toll"]) * (1 if sense == "min" else -1)
            chances = {ahead: F(0), behind: F(0)}
            chances[ahead] += 1 - at["slip"] / 2
            chances[behind] += at["slip"] / 2
            rows.append((state, action, [(p, to, paid) for to, p in chances.items()]))
            if action == 0:
                rows.append((state, 9, [(1, state, paid)]))  # wait
        rows.append((3, 0, [(1, 3, 0)]))
        return MDP.from_outcomes(rows, discount=1, sense=sense)

    return Family(parameters={"slip": "1/2", "toll": "1/3"}, build=build)


@pytest.mark.parametrize("sense", ["min", "max"])
def test_curves_agree_with_the_optimum_at_every_point(sense: str) -> None:
    several = 0
    for seed in range(12):
        family = random_family(Random(seed), sense=sense)
        for name in ("slip", "toll"):
            line = curve(family, name, RANGE)
            assert line.violations() == []
            several += len(line.pieces) > 1
            for at in (F(1, 10), F(1, 3), F(5, 8), F(9, 10)):
                assert line.at(at) == certify(family.at({name: at})).start_value
    assert several


def test_a_policy_held_fixed_is_worth_its_own_value() -> None:
    family = random_family(Random(1))
    policy = [0, 0, 0, 0]
    line = curve(family, "slip", RANGE, policy=policy)
    assert line.violations() == []
    for at in (F(1, 4), F(3, 4)):
        piece = next(each for each in line.pieces if each.low[1] <= at <= each.high[0])
        assert piece.fixed is not None
        value = evaluate(family.at({"slip": at}), policy).start_value
        assert float(piece.fixed.at(at)) == pytest.approx(value, rel=1e-12)
    # A proof of another policy does not hold: one that waits forever has no finite value.
    with pytest.raises(ModelError, match="the policy held fixed never ends") as refused:
        curve(family, "slip", RANGE, policy=[9, 9, 9, 0])
    assert "leave the policy out" in refused.value.fix


def test_gradients_are_the_slopes_of_the_curve() -> None:
    for seed in range(12):
        family = random_family(Random(seed))
        slopes, floats = gradient(family), None
        if certify(family.at({})).unique:
            floats = gradient(family, exact=False)
        for name in ("slip", "toll"):
            line = curve(family, name, RANGE)
            today = next(each.value for each in family.parameters if each.name == name)
            step = F(1, 10**9)
            right = (line.at(today + step) - line.at(today)) / step
            left = (line.at(today) - line.at(today - step)) / step
            assert float(slopes[name].right.value) == pytest.approx(float(right), rel=1e-6)
            assert float(slopes[name].left.value) == pytest.approx(float(left), rel=1e-6)
            if floats is not None:
                bounded = floats[name].value
                assert abs(F(bounded.value) - slopes[name].value.value) <= F(bounded.error)


def pitfalls(rng: Random) -> Family:
    """Return a random family with a pit outside the goal, which some pairs may fall into."""
    plain, falls = random_family(rng), [rng.random() < 0.4 for _ in range(12)]

    def build(at: dict[str, F]) -> MDP:
        rows, listed = plain.at(at), []
        for pair in range(rows.n_pairs):
            outcomes = [(p, to, paid) for p, to, paid in rows.table.row(pair)]
            state, action = int(rows.pair_state[pair]), int(rows.pair_action[pair])
            if state < 3 and action in (1, 2) and falls[pair]:
                outcomes = [(p / 2, to, paid) for p, to, paid in outcomes]
                outcomes.append((F(1, 2), 4, outcomes[0][2]))
            listed.append((state, action, outcomes))
        listed.append((4, 0, [(1, 4, 0)]))
        goal = {"goal": [3]}
        return MDP.from_outcomes(listed, discount=1, sense="min", labels=goal).until("goal")

    return Family(parameters={"slip": "1/2", "toll": "1/3"}, build=build)


def test_pairs_that_may_miss_the_goal_are_left_out() -> None:
    for seed in range(12):
        family = pitfalls(Random(seed))
        slopes = gradient(family)
        for name in ("slip", "toll"):
            line = curve(family, name, RANGE)
            assert line.violations() == []
            for at in (F(1, 10), F(1, 3), F(5, 8), F(9, 10)):
                assert line.at(at) == certify(family.at({name: at})).start_value
            today = next(each.value for each in family.parameters if each.name == name)
            step = F(1, 10**9)
            right = (line.at(today + step) - line.at(today)) / step
            assert float(slopes[name].right.value) == pytest.approx(float(right), rel=1e-6)


def test_what_waits_for_nothing_is_refused() -> None:
    """Without a cost of waiting, or with a reward for it, a policy may never end."""
    for paid in (0, -1):

        def build(at: dict[str, F], paid: int = paid) -> MDP:
            rows = [
                (0, 0, [(1 - at["slip"], 1, 1), (at["slip"], 0, 1)]),
                (0, 1, [(1, 0, paid)]),
                (1, 0, [(1, 1, 0)]),
            ]
            return MDP.from_outcomes(rows, discount=1, sense="min")

        with pytest.raises(ModelError, match="some policy never ends"):
            curve(Family(parameters={"slip": "1/2"}, build=build), "slip", RANGE)


def test_where_no_policy_ends_a_curve_is_refused_and_a_smaller_range_is_not() -> None:

    def build(at: dict[str, F]) -> MDP:
        rows = [
            (0, 0, [(p, to, 1) for p, to in ((1 - at["slip"], 1), (at["slip"], 0)) if p]),
            (0, 1, [(1, 0, 1)]),
            (1, 0, [(1, 1, 0)]),
        ]
        return MDP.from_outcomes(rows, discount=1, sense="min")

    family = Family(parameters={"slip": "1/2"}, build=build)
    with pytest.raises(ModelError, match="from some state no policy ends"):
        curve(family, "slip", (0, 1))
    line = curve(family, "slip", (0, "9/10"))
    assert line.violations() == []
    assert line.at("9/10") == 10  # 1 / (1 - slip)
    assert len(line.pieces) == 1
    assert thresholds(family, "slip", (0, "9/10")).frame().empty


def test_a_piece_whose_policy_never_ends_is_no_proof() -> None:
    """Waiting at no loss keeps any value: the equations hold, and the checker must refuse them."""
    family = random_family(Random(2))
    line = curve(family, "toll", RANGE)
    (piece, *_) = line.pieces
    waits = np.zeros_like(piece.optimal)
    forged = replace(line, pieces=(replace(piece, optimal=waits), *line.pieces[1:]))
    assert any("ends" in each for each in forged.violations())
    assert solve(family.at({})).start_value == pytest.approx(float(line.at("1/3")))


def test_where_missing_the_goal_pays_staying_forever_does_too() -> None:
    """The optimum of rewards is +∞: a run that stays at a loss misses the goal as well."""

    def build(at: dict[str, F]) -> MDP:
        rows = [
            (0, 0, [(1 - at["slip"], 1, -1), (at["slip"], 0, -1)]),
            (0, 1, [(1, 0, -1)]),
            (1, 0, [(1, 1, 0)]),
        ]
        return MDP.from_outcomes(rows, discount=1, labels={"goal": [1]}).until("goal")

    family = Family(parameters={"slip": "1/2"}, build=build)
    assert certify(family.at({})).start_value == np.inf
    for ask in (lambda: curve(family, "slip", RANGE), lambda: gradient(family)):
        with pytest.raises(ModelError, match="some policy never ends"):
            ask()


# ---- what a critical reader found ----------------------------------------------------------------

GOAL = {"sense": "min", "start": 0, "labels": {"g": [1]}}


def along(build: Any, today: str | int, degree: int = 1, *, high: str | int = 1) -> Family:
    x = Parameter(name="x", value=today, low=0, high=high)
    return Family(parameters=(x,), build=build, degrees={"x": degree})


def test_a_derivative_next_to_infinite_totals_is_refused() -> None:
    """Today every run reaches the goal; nearby some miss it, with a chance that has no slope."""

    def two_steps(at: dict[str, F]) -> MDP:
        x = at["x"]
        rows = [(0, 0, [(x, 1, 1), (1 - x, 2, 1)]), (1, 0, [(1, 1, 0)])]
        rows += [(2, 0, [(x, 1, 1), (1 - x, 3, 1)]), (3, 0, [(1, 3, 1)])]
        return MDP.from_outcomes(rows, **GOAL).until("g")

    def touching(at: dict[str, F]) -> MDP:
        p = (at["x"] - F(1, 3)) ** 2
        rows = [(0, 0, [(p, 2, 1), (1 - p, 1, 1)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
        return MDP.from_outcomes(rows, **GOAL).until("g")

    for family, near in ((along(two_steps, 1), F(99, 100)), (along(touching, "1/3", 2), F(1, 4))):
        assert certify(family.at({"x": near})).start_value == np.inf
        held: Any = {"policy": [0] * family.at({}).n_states}
        for how in ({}, held, {**held, "exact": False}):
            with pytest.raises(ModelError, match="next to today's value, the total may be inf"):
                gradient(family, **how)


def test_a_point_at_which_a_miss_vanishes_is_seen() -> None:
    """At 1/3 action 0 is sure of the goal and costs 1; elsewhere only action 1 is, at 5."""

    def build(at: dict[str, F]) -> MDP:
        p = (at["x"] - F(1, 3)) ** 2
        rows = [(0, 0, [(p, 2, 1), (1 - p, 1, 1)]), (0, 1, [(1, 1, 5)])]
        rows += [(1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
        return MDP.from_outcomes(rows, **GOAL).until("g")

    with pytest.raises(ModelError, match="outside the goal"):
        curve(along(build, "1/2", 2), "x", (0, 1))
    line = curve(along(build, "1/2", 2), "x", ("2/5", 1))
    assert line.violations() == []
    assert line.at("1/2") == 5


def test_a_discount_that_touches_1_inside_is_seen() -> None:
    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [("1/2", 1, 1), ("1/2", 2, 1)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
        return MDP.from_outcomes(rows, 1 - (at["x"] - F(1, 3)) ** 2, **GOAL).until("g")

    with pytest.raises(ModelError, match="outside the goal"):
        curve(along(build, "1/4", 2), "x", (0, 1))


def test_a_policy_that_never_ends_at_a_point_outside_its_pieces_is_sound() -> None:
    """Action 0 ends with a chance of 0 at 1/2, where the other action is taken."""

    def build(at: dict[str, F]) -> MDP:
        p = (at["x"] - F(1, 2)) ** 2
        rows = [(0, 0, [(p, 1, 1), (1 - p, 0, 1)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, sense="min", start=0)

    line = curve(along(build, "1/4", 2), "x", (0, 1))
    assert len(line.pieces) == 3
    assert line.violations() == []
    for x in (F(0), F(1, 4), F(1, 2), F(9, 10)):
        assert line.at(x) == certify(build({"x": x})).start_value


def test_forged_values_of_ends_origins_and_claims_are_found() -> None:
    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        rows = [(0, 0, [(x, 0, 1), (1 - x, 1, 1)]), (0, 1, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, sense="min", start={0: "1/2", 1: "1/2"})

    family = along(build, "1/2", high="9/10")
    line = curve(family, "x", (0, "9/10"), policy=[0, 0])
    assert line.violations() == []
    first, *others = line.pieces
    assert first.fixed_values is not None
    forged = []
    for name in ("values", "fixed_values"):
        (top, _), below = getattr(first, name)
        forged.append(replace(first, **{name: ([top, 5 * below], below)}))
    forged.append(replace(first, optimal=~first.optimal))
    for piece in forged:
        assert replace(line, pieces=(piece, *others)).violations()
    assert replace(line, checked=None).violations()
    assert replace(line, mdp=family.at({"x": "1/4"})).violations()

    # A section from an origin at which a step outside the goal is not seen.
    def hidden(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(1 - at["x"], 1, 1), (at["x"], 2, 1)])]
        rows += [(1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
        return MDP.from_outcomes(rows, start=0, labels={"g": [1]}).until("g")

    def harmless(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
        return MDP.from_outcomes(rows, start=0, labels={"g": [1]}).until("g")

    plain = curve(along(harmless, 0), "x", (0, "1/2"))
    section = replace(plain.pieces[0].section, origin=F(0))
    stolen = replace(
        plain,
        family=along(hidden, 0),
        mdp=hidden({"x": F(0)}),
        pieces=tuple(replace(each, section=section) for each in plain.pieces),
    )
    assert any("origin" in each for each in stolen.violations())


def test_a_start_too_unlikely_for_a_float_counts() -> None:
    """Once in 10^400 runs begin in an end outside the goal: the total is infinite."""

    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(1 - at["x"], 1, 1), (at["x"], 0, 1)]), (0, 1, [(1, 0, 1)])]
        rows += [(1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
        start = {0: 1 - F(1, 10**400), 2: F(1, 10**400)}
        return MDP.from_outcomes(rows, **GOAL | {"start": start}).until("g")

    for ask in (gradient, lambda family: curve(family, "x", RANGE)):
        with pytest.raises(ModelError, match=r"outside the goal|some policy never ends"):
            ask(along(build, "1/2"))
