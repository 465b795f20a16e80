"""Curves and thresholds where some policy never ends, against the enumeration of all policies."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction as F
from math import inf
from pathlib import Path
from typing import Any

import pytest
from cli_runner import run
from endless_oracle import best, reaching
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from strategies import Row, any_models, model_of

from exact_mdp.analysis.layout import arrange
from exact_mdp.analysis.pages import explorer
from exact_mdp.analysis.pages.explorer import explore
from exact_mdp.analysis.sensitivity import thresholds, value_function
from exact_mdp.analysis.sensitivity.curves.checker import RationalFunction
from exact_mdp.analysis.sensitivity.curves.curve import ValueFunction
from exact_mdp.mdp import MDP, ModelError, moving
from exact_mdp.mdp.parametric import Family, Parametric
from exact_mdp.mdp.parametric.parameter import Parameter
from exact_mdp.solvers import certify

WAIT = [
    (0, 0, [(1, 0, 0)]),
    (0, 1, [(1, 2, 5)]),
    (1, 0, [(1, 1, -1)]),
    (2, 0, [(1, 2, 0)]),
]
At = Callable[[F], list[Row]]


def moved_reward(draw: st.DrawFn, pairs: tuple[Row, ...], mdp: MDP) -> tuple[Parametric, At]:
    own = draw(st.sampled_from(sorted({r for *_, r, _ in pairs})))
    family = moving(mdp, {}, {"x": own})
    return family, lambda x: [(s, a, x if r == own else r, row) for s, a, r, row in pairs]


def moved_chance(draw: st.DrawFn, pairs: tuple[Row, ...], mdp: MDP) -> tuple[Parametric, At]:
    spread = [(s, a, t, p) for s, a, _, row in pairs for t, p in row.items() if len(row) > 1]
    assume(spread)
    s, a, to, p = draw(st.sampled_from(spread))

    def at(x: F) -> list[Row]:
        rest = (1 - x) / (1 - p)
        row = {t: x if t == to else q * rest for t, q in next(r[3] for r in own).items()}
        kept = {t: q for t, q in row.items() if q}
        return [(*r[:3], kept if r in own else r[3]) for r in pairs]

    own = [r for r in pairs if r[:2] == (s, a)]
    return moving(mdp, {"x": [(mdp.pair(s, a), to)]}), at


@st.composite
def families(draw: st.DrawFn) -> tuple[int, Parametric, At, tuple[F, F]]:
    """A model of any kind, of which one reward or one chance moves."""
    size, pairs = draw(any_models(3))
    mdp = model_of(size, pairs, F(1))
    if draw(st.booleans()):
        family, at = moved_reward(draw, pairs, mdp)
        today = family.parameters[0].value
        return size, family, at, (today - 2, today + 2)
    return size, *moved_chance(draw, pairs, mdp), (F(0), F(1))


def points(found: ValueFunction) -> list[F]:
    """Values next to all cuts, at them, and between them."""
    low, high = found.range.low, found.range.high
    ends = {end for piece in found.pieces for end in (*piece.low, *piece.high)}
    near = {end + step for end in ends for step in (F(1, 1000), -F(1, 1000))}
    inner = {low + (high - low) * F(k, 7) for k in range(1, 7)}
    return sorted(each for each in ends | near | inner if low <= each <= high)


@settings(max_examples=20, deadline=None)
@given(families())
def test_curves_of_random_models(given_: tuple[int, Parametric, At, tuple[F, F]]) -> None:
    size, family, at, span = given_
    try:
        found = value_function(family, "x", span)
    except ModelError as error:
        assert "cancel" in str(error) or "come together" in str(error)  # noqa: PT017
        return
    assert found.violations() == []
    for x in points(found):
        values, swings = best(at(x), size)
        if not swings:
            assert found.at(x) == values[0]


@settings(max_examples=10, deadline=None)
@given(families())
def test_actions_change_at_thresholds_alone(
    given_: tuple[int, Parametric, At, tuple[F, F]],
) -> None:
    _, family, _, span = given_
    try:
        found = thresholds(family, "x", span)
    except ModelError:
        return
    cuts = [span[0], *(end for each in found.found for end in (each.low, each.high)), span[1]]
    for low, high in zip(cuts[::2], cuts[1::2], strict=True):
        several = [certify(family.at({"x": low + (high - low) * F(k, 11)})) for k in (2, 5, 9)]
        assert len({each.optimal_pairs.tobytes() for each in several}) == 1


@settings(max_examples=10, deadline=None)
@given(families(), st.sampled_from(["max", "min"]))
def test_curves_until_a_goal(given_: tuple[int, Parametric, At, tuple[F, F]], sense: str) -> None:
    """Runs that miss the goal are worth +∞, rewards and costs alike."""
    size, family, at, span = given_
    flags = [state == 0 for state in range(size)]

    class Asked:
        name, parameters = family.name, family.parameters
        degree, breakpoints, neighbours = family.degree, family.breakpoints, family.neighbours

        def at(self, values: dict[str, object]) -> MDP:
            return family.at(values).with_(labels={"goal": flags}, sense=sense).until("goal")

    try:
        found = value_function(Asked(), "x", span)
    except ModelError as error:
        assert "without end" in str(error) or "cancel" in str(error)  # noqa: PT017
        return
    assert found.violations() == []
    for x in points(found):
        rows = at(x)
        if sense == "min" and any(r < 0 for *_, r, _ in rows):
            continue  # costs may fall without end: other rules, refused
        assert found.at(x) == reaching(rows, size, inf, 1 if sense == "max" else -1)[0]


def test_waiting_losing_and_gaining() -> None:
    mdp = MDP.from_outcomes(WAIT)
    earned = value_function(mdp, "reward.5", (-7, 7))
    assert [earned.at(x) for x in (-7, -1, 0, F(1, 3), 7)] == [0, 0, 0, F(1, 3), 7]
    assert [each.value for each in thresholds(mdp, "reward.5", (-7, 7)).found] == [0]
    lost = value_function(mdp.with_(start=1), "reward.-1", (-2, 2))
    assert [lost.at(x) for x in (-1, 0, 1)] == [-inf, 0, inf]
    assert [each.low[1] for each in lost.pieces] == [-2, 0]
    assert lost.pieces[0].value == RationalFunction(numerator=(F(-1),), denominator=(F(0),))
    assert lost.violations() == []
    texts = [each.get_text() for each in lost.plot().get_legend().get_texts()]
    assert {"the value is -∞", "the value is +∞"} < {*texts}


def test_a_value_of_its_own_at_one_point() -> None:
    """Waiting is worth 0 where it costs nothing, which is at one value alone."""
    rows = [(0, 0, [(1, 0, -1)]), (0, 1, [(1, 1, -5)]), (1, 0, [(1, 1, 0)])]
    found = value_function(MDP.from_outcomes(rows), "reward.-1", (-2, 1))
    assert [found.at(x) for x in (-2, F(-1, 10**20), 0, F(1, 10**20))] == [-5, -5, 0, inf]
    square = [(0, 0, [(1, 0, 0)]), *rows[1:]]

    def build(at: Mapping[str, F]) -> MDP:
        costs = [(0, 0, [(1, 0, -((at["x"] - 1) ** 2))]), *square[1:]]
        return MDP.from_outcomes(costs)

    from_family = family_of(build)
    touched = value_function(from_family, "x", (0, 2))
    assert [touched.at(x) for x in (0, F(999, 1000), 1, 2)] == [-5, -5, 0, -5]
    assert touched.violations() == []


def family_of(build: Callable[[Mapping[str, F]], MDP]) -> Parametric:
    return Family(parameters=(Parameter(name="x", value=F(1, 2)),), build=build, degrees={"x": 2})


def test_a_state_beside_the_goal_is_terminal_where_it_earns_nothing() -> None:
    mdp = MDP.from_outcomes(
        [(0, 0, [(1, 0, 0)]), (1, 0, [(1, 1, -1)])], labels={"goal": [True, False]}, start=1
    )
    found = value_function(mdp.until("goal"), "reward.-1", (-2, 2))
    assert [found.at(x) for x in (-1, 0, 1)] == [inf, inf, inf]
    assert found.violations() == []


def test_means_of_a_class_decide() -> None:
    """Around two states, +3 and -x: the mean is 0 at 3; costs at the way out are negative."""
    rows = [(0, 0, [(1, 1, 3)]), (1, 0, [("1/2", 0, -2), ("1/2", 1, -2)]), (1, 1, [(1, 2, -4)])]
    mdp = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])])
    found = value_function(mdp, "reward.-2", (-4, 0))
    for x, value in ((F(-2), -1), (F(-8, 5), -1), (F(-1), inf)):
        assert found.at(x) == value
    (cut,) = {piece.low for piece in found.pieces[1:]}
    assert cut == (F(-3, 2), F(-3, 2))  # 3 + 2 x = 0: two steps in state 1 for each in state 0
    assert found.violations() == []


def test_planted_faults_are_found() -> None:
    rows = [(0, 0, [(1, 0, 0)]), (0, 1, [("1/2", 2, 5), ("1/2", 3, 5)]), (1, 0, [(1, 1, -1)])]
    gains = [(2, 0, [("1/3", 2, -1), ("2/3", 3, 2)]), (3, 0, [(1, 2, 1)]), (2, 1, [(1, 4, 0)])]
    mdp = MDP.from_outcomes([*rows, *gains, (4, 0, [(1, 4, 0)])])
    found = value_function(mdp, "reward.2", (-3, 3))
    assert found.violations() == []
    finite, infinite = found.pieces[0], found.pieces[-1]
    assert not finite.value.infinite
    assert infinite.value.infinite
    assert finite.proof is not None
    assert infinite.proof is not None
    (gain,) = infinite.proof.gains
    values, scale = finite.values
    other = replace(finite.proof, certificate=infinite.proof.certificate)
    for bad in (
        replace(finite, values=([each + 1 for each in values], scale)),
        replace(finite, values=(values, -scale)),
        replace(finite, optimal=~finite.optimal),
        replace(finite, value=RationalFunction(numerator=(F(1),), denominator=(F(1),))),
        replace(finite, proof=other),
        replace(finite, proof=replace(finite.proof, point=infinite.proof.point)),
        replace(finite, high=infinite.high),
        replace(infinite, proof=replace(infinite.proof, gains=())),
        replace(infinite, proof=replace(infinite.proof, gains=(replace(gain, mean=-gain.mean),))),
        replace(infinite, low=finite.low, value=-infinite.value),
        replace(infinite, value=finite.value),
    ):
        told = replace(found, pieces=(bad,)).violations()
        assert any("no piece covers" not in each for each in told), bad


def test_a_policy_held_fixed() -> None:
    mdp = MDP.from_outcomes(WAIT)
    found = value_function(mdp, "reward.5", (-7, 7), policy=[1, 0, 0])
    assert [found.fixed_at(x) for x in (-3, 4)] == [-3, 4]
    assert [(e.low[0], e.high[1]) for e in found.within(2)] == [(-2, 7)]
    waits = value_function(mdp, "reward.5", (-7, 7), policy=[0, 0, 0])
    assert waits.fixed_at(4) == 0
    assert waits.violations() == found.violations() == []
    wrong = replace(waits.pieces[1], fixed_values=waits.pieces[1].values)
    assert replace(waits, pieces=(waits.pieces[0], wrong)).violations()
    with pytest.raises(ModelError, match="may go on for ever"):
        value_function(mdp.with_(start=1), "reward.5", (-7, 7), policy=[0, 0, 0])


@settings(max_examples=10, deadline=None)
@given(families(), st.data())
def test_fixed_policies_of_random_models(
    given_: tuple[int, Parametric, At, tuple[F, F]], data: st.DataObject
) -> None:
    """A policy held fixed is worth the optimum of the model that offers nothing else."""
    size, family, at, span = given_
    offered = [[a for s, a, *_ in at(span[0]) if s == state] for state in range(size)]
    policy = [data.draw(st.sampled_from(own)) for own in offered]
    try:
        found = value_function(family, "x", span, policy=policy)
    except ModelError:
        return
    assert found.violations() == []
    for x in points(found):
        values, swings = best([row for row in at(x) if row[1] == policy[row[0]]], size)
        if not swings:
            assert found.fixed_at(x) == values[0]


@pytest.mark.parametrize(
    ("stays", "ends", "at_0", "limit"),
    [(0, 1, 0, 1), ("1/2", "-1/2", inf, inf), ("-1/2", "1/2", -inf, -inf)],
)
def test_a_policy_that_ends_but_at_one_value(
    stays: object, ends: object, at_0: F | float, limit: float
) -> None:
    """Ending has probability p, so that at 0 it stays: what it earns there is no limit."""
    rows = [(0, 0, [("1/4", 1, ends), ("3/4", 0, stays)]), (0, 1, [(1, 1, -9)])]
    mdp = MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])
    found = value_function(moving(mdp, {"p": [(0, 1)]}), "p", (0, 1), policy="always:0")
    assert found.fixed_at(0) == at_0
    assert found.at(0) == max(at_0, -9)
    held, (piece, *_) = found.fixed_at(F(1, 3)), found.pieces
    assert held == F(ends) + 2 * F(stays)  # type: ignore[arg-type]
    assert piece.fixed is not None
    assert piece.fixed.limit(F(0), piece.middle) == limit
    if limit > 0:
        assert found.frame()["value_low"][0] == limit
    lines = [line.get_ydata()[0] for line in found.plot().lines if len(line.get_xdata())]
    assert limit in lines
    (own,) = (e for e in data_of(found)["points"] if e["at"] == "0/1")
    told = {inf: "1/0", -inf: "-1/0", 0: "0/1"}
    assert (own["value"], own["held"]) == (told.get(found.at(0), "-9/1"), told[at_0])


def data_of(curve: ValueFunction) -> dict[str, Any]:
    """What a page of the explorer holds of a curve."""
    layout = arrange(curve.mdp)
    return explorer._curve(curve, explorer._Sets(curve.mdp, layout))


def test_a_chance_may_be_0_wherever_one_looks_first() -> None:
    """It closes a cycle, which goes on for ever at the lower end of the range."""
    second = F(37, 97)

    def build(at: Mapping[str, F]) -> MDP:
        x = at["x"]
        stays = (1 - x) * ((x - F(1, 2)) * (x - second) / (F(1, 2) * second)) ** 2
        row = [(p, to, 1) for p, to in ((stays, 0), (1 - stays, 1)) if p]
        return MDP.from_outcomes([(0, 0, row), (1, 0, [(1, 1, 0)])])

    x = Parameter(name="x", value=F(1, 4))
    found = value_function(Family(parameters=(x,), build=build, degrees={"x": 5}), "x", (0, 1))
    assert found.violations() == []
    assert [found.at(each) for each in (0, second, F(1, 2), 1)] == [inf, 1, 1, 1]


def test_cancelling_rewards_are_refused() -> None:
    around = [(0, 0, [(1, 1, -1)]), (1, 0, [(1, 0, 1)]), (1, 1, [(1, 2, 9)]), (2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(around)
    for engine in (thresholds, value_function):
        with pytest.raises(ModelError, match="rewards cancel for ever"):
            engine(mdp, "reward.9", (8, 10))
    found = value_function(mdp, "reward.1", (0, 2))  # at 1 alone they cancel
    assert [found.at(x) for x in (0, F(1, 2), 2)] == [8, 8, inf]


def test_the_command(tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    MDP.from_outcomes(WAIT, start=1).save(path)
    asked = ("sensitivity", str(path), "curve", "--parameter", "reward.-1", "--relative", "2")
    pieces = run(*asked, "--json").result["pieces"]
    assert [(e["from"], e["to"], e["value"]) for e in pieces] == [
        ("-3", "0", "-inf"),
        ("0", "1", "inf"),
    ]
    assert run("sensitivity", str(path), "threshold").status == 0
    page = explore(MDP.from_outcomes(WAIT), "reward.5", policy=[1, 0, 0]).page()
    assert "points" in page
    page = explore(MDP.from_outcomes(WAIT, start=1), "reward.-1", relative=2).page()
    assert "-1/0" in page
