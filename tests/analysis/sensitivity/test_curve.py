"""The value as a function of a parameter, against closed forms and single certificates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import (
    MDP,
    Certified,
    Family,
    ModelError,
    Parameter,
    Parametric,
    Scenario,
    certify,
    check,
    curve,
    explore,
    gradient,
    moving,
    parametric,
    thresholds,
)

F = Fraction
SMALL = Scenario.load("tea").with_(tasks=[1], max_trial=2)
# Puterman (1994), section 3.1; QuantEcon.py, quantecon/markov/tests/test_ddp.py
PUTERMAN = MDP.from_outcomes(
    [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])], "1/2"
)
TODAY = Parameter(name="t", value=F(0), low=F(-1), high=F(1))
HALF = Parameter(name="p", value=F(1, 2), low=F(0), high=F(1))


def start_of(mdp: MDP, policy: object) -> Fraction:
    """The exact value of a policy at one point."""
    value = check(mdp, policy, exact_values=True).regret.learned.value
    assert isinstance(value, Fraction)
    return value


def agrees(slopes: Any, family: Parametric, at: Fraction, policy: object) -> None:
    mdp = family.at({slopes.parameter.name: at})
    certificate = certify(mdp)
    assert slopes.at(at) == certificate.start_value
    assert slopes.fixed_at(at) == start_of(mdp, policy)
    for piece in slopes.around(at):
        if piece.low[1] < at < piece.high[0]:
            assert (piece.optimal == certificate.optimal_pairs)[~mdp.terminal[mdp.pair_state]].all()


def test_puterman_in_closed_form() -> None:
    low, high = curve(PUTERMAN, "discount", (0, "99/100")).pieces
    assert (low.value.numerator, low.value.denominator) == ((10, -11), (1, -1))
    assert high.value.numerator == (5, F(-11, 2))
    assert high.value.denominator == (1, F(-3, 2), F(1, 2))
    assert low.high == high.low
    assert low.high[0] <= F(10, 11) <= low.high[1]


@st.composite
def cyclic(draw: st.DrawFn) -> tuple[MDP, list[int]]:
    """Draw a model of three states and two actions, all of which lead everywhere; its rewards."""
    share = st.integers(1, 6)
    weights = draw(st.lists(st.tuples(share, share, share), min_size=6, max_size=6))
    rewards = draw(st.lists(st.integers(-5, 5), min_size=6, max_size=6))
    rows = [
        (s // 2, s % 2, [(F(w, sum(each)), t, rewards[s]) for t, w in enumerate(each)])
        for s, each in enumerate(weights)
    ]
    sense, start = draw(st.sampled_from(["max", "min"])), {0: F(1, 3), 2: F(2, 3)}
    return MDP.from_outcomes(rows, discount="9/10", start=start, sense=sense), rewards


@settings(max_examples=25, deadline=None)
@given(cyclic(), st.fractions(0, 1, max_denominator=50), st.sampled_from(["p", "discount", "gain"]))
def test_random_models_with_cycles(
    drawn: tuple[MDP, list[int]], place: Fraction, name: str
) -> None:
    mdp, rewards = drawn
    gains = {"gain": rewards[1] or rewards[0]} if rewards[1] or rewards[0] else {}
    family = moving(mdp, {"p": [(0, 1)]}, gains)
    if name not in [parameter.name for parameter in family.parameters]:
        return
    value_curve = curve(family, name, policy="random")
    assert value_curve.violations() == []
    low, high = value_curve.range.low, value_curve.range.high
    agrees(value_curve, family, low + (high - low) * place, "random")
    for left, right in pairwise(value_curve.pieces):
        assert left.high == right.low
        for end in left.high:
            agrees(value_curve, family, end, "random")


@pytest.mark.parametrize("name", ["base.anxiety", "reward.assist.prompt", "discount"])
def test_scenarios(name: str) -> None:
    family = parametric(SMALL)
    span = (F(1, 10), F(9, 10)) if name != "reward.assist.prompt" else (-6, 1)
    value_curve = curve(SMALL, name, span, policy="always:prompt")
    crossed = [t for t in thresholds(SMALL, name, span).found if not t.touch]
    ends = {(t.low, t.high) for t in crossed}
    assert ends <= {piece.high for piece in value_curve.pieces[:-1]}
    assert len(value_curve.frame()) == len(value_curve.pieces) > len(ends)
    for k in range(5):
        agrees(value_curve, family, F(span[0]) + (F(span[1]) - span[0]) * F(k, 4), "always:prompt")


@settings(max_examples=25, deadline=None)
@given(cyclic(), st.fractions(0, 2, max_denominator=10), st.booleans())
def test_where_a_policy_keeps_a_limit(
    drawn: tuple[MDP, list[int]], limit: Fraction, relative: bool
) -> None:
    mdp, policy = drawn[0], [0, 0, 0]
    value_curve = curve(mdp, "discount", (0, "19/20"), policy=policy)
    within = value_curve.within(**{"max_relative_regret" if relative else "max_regret": limit})
    every = [F(19 * k, 20 * 24) for k in range(25)]
    for at in [*every, *(end for each in within for end in (*each.low, *each.high))]:
        best, mine = value_curve.at(at), start_of(mdp.with_(discount=at), policy)
        inside = [each for each in within if each.low[0] <= at <= each.high[1]]
        if all(  # not inside a bracket of an end
            (low == up or not low <= at < up) and (end == top or not end < at <= top)
            for (low, up), (end, top) in ((each.low, each.high) for each in inside)
        ):
            assert (abs(best - mine) <= limit * (abs(best) if relative else 1)) == bool(inside)


def test_a_root_on_one_side_of_a_breakpoint_is_none_on_the_other() -> None:
    """Max(0, 1 - |t|) against 0: nothing is lost at both ends alone, and most in the middle."""
    family = Family(
        parameters=(TODAY,),
        build=lambda at: MDP.from_outcomes(
            [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 1 - abs(at["t"]))]), (1, 0, [(1, 1, 0)])], 1
        ),
        breaks={"t": [0]},
    )
    within = curve(family, "t", (-1, 1), policy=[0, 0]).within(0)
    assert [(each.low, each.high) for each in within] == [((t, t), (t, t)) for t in (F(-1), F(1))]


def test_limits_that_say_nothing_are_refused() -> None:
    value_curve = curve(PUTERMAN, "discount", (0, "99/100"), policy=[0, 0])
    for call, message in (
        (lambda: curve(PUTERMAN, "discount", (0, "99/100")).within(1), "no policy"),
        (lambda: value_curve.within(1, 1), "two limits"),
        (lambda: value_curve.within(-1), "0 or more"),
        (lambda: value_curve.at(1), "outside the range"),
    ):
        with pytest.raises(ModelError, match=message):
            call()
    (only,) = value_curve.within()  # optimal from 10/11 on
    assert only.low[0] <= F(10, 11) <= only.low[1]
    assert only.high == (F(99, 100),) * 2


def test_what_is_false_between_breakpoints_is_found() -> None:
    """Each claim is changed alone; samples at ends and in the middle would see few of these."""
    value_curve = curve(PUTERMAN, "discount", (0, "99/100"), policy=[0, 0])
    (low, high), tiny = value_curve.pieces, F(1, 10**9)
    assert value_curve.violations() == []

    def faults(first: dict[str, Any], second: dict[str, Any] | None) -> str:
        pieces = [replace(low, **first), replace(high, **(second or {}))][: 2 - (second is None)]
        return " | ".join(replace(value_curve, pieces=tuple(pieces)).violations())

    # The left policy is not optimal a billionth further; the right one is not so far on the left.
    for shift in (tiny, -tiny):
        bracket = (low.high[0] + shift, low.high[1] + shift)
        said = faults({"high": bracket}, {"low": bracket})
        assert "is better" in said or (shift < 0 and "next to" in said)
    for first, second, message in (
        ({"optimal": ~low.optimal}, {}, "pair"),
        ({"value": high.value}, {}, "another one"),
        ({}, {"fixed_values": low.values}, "held fixed"),
        ({}, {"values": (high.values[0], -high.values[1])}, "not positive"),
        ({}, None, "no piece covers"),
        ({"section": replace(low.section, high=low.low[0])}, {}, "outside"),
        # One bracket that is wide, between sections, where nothing is checked, proves nothing.
        ({}, {"low": (value_curve.range.low, value_curve.range.high)}, "no piece covers"),
        (
            {"high": (F(1, 2), F(98, 100))},
            {"low": (F(1, 2), F(98, 100)), "section": replace(high.section)},
            "next to",
        ),
    ):
        assert message in faults(first, second)


def test_the_command_says_where_a_policy_keeps_a_limit() -> None:
    line = "curve tea --set tasks=[1] --set max_trial=2 --parameter base.anxiety"
    line += " --max-relative-regret 1/100"
    result = run(line, "--policy", "always:prompt", "--json").result
    value_curve = curve(SMALL, "base.anxiety", policy="always:prompt")
    within = value_curve.within(max_relative_regret="1/100")
    brackets = [(*each["from_bracket"], *each["to_bracket"]) for each in result["within"]]
    assert [tuple(map(F, each)) for each in brackets] == [(*e.low, *e.high) for e in within]
    fixed = result["pieces"][0]["fixed"]
    assert tuple(map(F, fixed["numerator"])) == value_curve.pieces[0].fixed.numerator
    assert "keeps the limit" in run(line).out  # of the optimum, unless a policy is given
    assert "two limits" in run(line, "--max-regret", "1").refusal()


@pytest.mark.parametrize("sense", ["max", "min"])
def test_a_table_is_followed_where_nothing_is_earned_today(sense: str) -> None:
    """Its greedy action counts in states that are over, or whose actions are alike, at 0."""

    def build(at: Mapping[str, F]) -> MDP:
        rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, at["t"])]), (2, 0, [(1, 2, 0)])]
        rows += [(1, 0, [(1, 1, at["t"])]), (1, 1, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, "1/2", sense=sense)

    family = Family(parameters=(TODAY,), build=build)
    table = np.array([[0.0, 2.0], [1.0, 3.0], [0.0, 0.0]]) * (1 if sense == "max" else -1)
    value_curve = curve(family, "t", (-1, 1), policy=table)
    for t in (F(-1), F(-1, 2), F(0), F(1)):
        assert value_curve.fixed_at(t) == t  # action 1 in state 0, and nothing after that
    [kept] = value_curve.within(0)  # what it earns is good in state 0, and bad in state 1
    assert (float(kept.low[0]), float(kept.high[1])) == pytest.approx((0, 0))


def test_a_policy_that_is_silent_where_it_matters_elsewhere_is_refused() -> None:
    """A function is not asked about a state in which all is over today."""
    family = Family(
        parameters=(TODAY,),
        build=lambda at: MDP.from_outcomes([(0, 0, [(1, 0, at["t"])]), (0, 1, [(1, 0, 0)])], "1/2"),
    )
    for policy in ([[1.0, 2.0]], [1], {0: 1}, [[0.0, 1.0]]):
        value_curve = curve(family, "t", (-1, 1), policy=policy)
        assert (value_curve.fixed_at(-1), value_curve.fixed_at(1)) == (0, 0)
        assert value_curve.within(0)[0].low[0] == -1
        assert value_curve.within(0)[-1].high[1] == pytest.approx(0)
    with pytest.raises(ModelError, match="says nothing of a state"):
        curve(family, "t", (-1, 1), policy=lambda state: 1)


# ---- discount 1, where some policy never ends ----------------------------------------------------

WAIT = MDP.from_outcomes(
    [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 2, 5)]), (1, 0, [(1, 1, -1)]), (2, 0, [(1, 2, 0)])]
)


@pytest.mark.parametrize("engine", [thresholds, curve, explore])
def test_where_some_policy_never_ends_curves_are_refused(engine: Callable[..., object]) -> None:
    with pytest.raises(ModelError, match="some policy never ends") as refused:
        engine(WAIT, "reward.5")
    assert "discount below 1" in (refused.value.fix or "")
    assert engine(WAIT.with_(discount="9/10"), "reward.5")
    assert engine(WAIT.within(3), "reward.5")


def test_where_some_policy_never_ends_derivatives_are_refused() -> None:
    with pytest.raises(ModelError, match="some policy never ends"):
        gradient(WAIT)
    slopes = gradient(WAIT, policy=[1, 0, 0], names=["reward.5"])  # this one ends
    assert slopes["reward.5"].value == Certified(value=F(1))
    assert gradient(WAIT.with_(discount="9/10"))["reward.5"].value == Certified(value=F(1))


def test_a_policy_that_never_ends_at_one_value_alone_is_found() -> None:
    """An episode goes on with the chance (2x - 1)², or 1 - (2x - 1)², and pays 1 a step."""

    def family(stays: Callable[[Fraction], Fraction]) -> Parametric:
        def build(at: Mapping[str, Fraction]) -> MDP:
            p = stays(at["x"])
            row = [(chance, to, 1) for chance, to in ((p, 0), (1 - p, 1)) if chance]
            return MDP.from_outcomes([(0, 0, row), (1, 0, [(1, 1, 0)])])

        x = Parameter(name="x", value=F(1, 4), low=F(0), high=F(1))
        return Family(parameters=(x,), build=build, degrees={"x": 2})

    for stays, wrong, right in (
        (lambda x: (2 * x - 1) ** 2, (0, F(3, 4)), (F(1, 8), F(3, 4))),
        (lambda x: 1 - (2 * x - 1) ** 2, (F(1, 8), F(3, 4)), (F(1, 8), F(3, 8))),
    ):
        with pytest.raises(ModelError, match="some policy never ends"):
            curve(family(stays), "x", wrong)
        value_curve = curve(family(stays), "x", right)
        assert value_curve.at("1/4") == 1 / (1 - stays(F(1, 4)))
        assert value_curve.violations() == []


def test_the_curve_of_the_discount_ends_below_1_where_some_policy_never_ends() -> None:
    for line in (thresholds(WAIT, "discount").curve, curve(WAIT, "discount")):
        assert line.range.high < 1
    thirds = [0.1, 0.2, 0.3]
    row = [(p, to, 0.0) for to, p in enumerate([*thirds, 1 - sum(thirds)])]
    rest = [(1 / 3, 1, 0), (1 / 3, 2, 0), (1 / 3 + 1e-16, 0, 0)]  # a little more than 1
    ends = [(1, 0, [(1, 0, 0)]), (3, 0, [(1, 4, 1)]), (4, 0, [(1, 4, 0)])]
    floats = MDP.from_outcomes(
        [(0, 0, row), *ends[:1], (2, 0, rest), (2, 1, [(1, 2, 0)]), *ends[1:]]
    )
    by_discount = curve(floats, "discount")
    assert by_discount.violations() == []
    assert by_discount.at("1/2") == certify(floats.with_(discount="1/2")).start_value


# ---- one curve, and its views -------------------------------------------------------------------


@pytest.mark.parametrize("name", ["base.anxiety", "reward.assist.prompt", "discount"])
def test_slopes_of_the_curve_are_the_derivatives(name: str) -> None:
    value_curve = curve(SMALL, name)
    each = gradient(SMALL, names=[name])[name]
    sides = [None if side is None else side.value for side in (each.left, each.right)]
    assert [*value_curve.slope(value_curve.parameter.value)] == sides


def test_slopes_at_a_tie_are_those_of_the_policies_on_both_sides() -> None:
    def build(at: Mapping[str, Fraction]) -> MDP:
        rows = [(0, 0, [(1, 1, at["p"])]), (0, 1, [(1, 1, 1 - at["p"])]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows)

    family = Family(parameters=(HALF,), build=build)
    value_curve, each = curve(family, "p"), gradient(family)["p"]
    assert value_curve.slope("1/2") == (each.left.value, each.right.value) == (-1, 1)
    assert (value_curve.slope(0), value_curve.slope(1)) == ((None, -1), (1, None))


def test_components_change_no_claim() -> None:
    """What is earned in parts is known as well as what is earned at once."""
    rows = [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])]
    whole = MDP.from_outcomes(rows, "1/2")
    parts = MDP.from_outcomes(rows, "1/2", components={"a": [1, 2, 0], "b": [4, 8, -1]})
    for name in ("p", "gain", "discount"):
        one, two = (moving(mdp, {"p": [(0, 0)]}, {"gain": 10}) for mdp in (whole, parts))
        assert curve(one, name).claim == curve(two, name).claim == "certified"
        assert thresholds(one, name).claim == thresholds(two, name).claim == "certified"
        assert gradient(one)[name] == gradient(two)[name]
    assert two.at({"p": "1/3"}).component_names == ("a", "b")
    assert two.at({"gain": 9}).component_names == ("reward",)  # nobody says which part has moved


def test_every_model_of_a_threshold_is_made_once() -> None:
    made: list[Fraction] = []

    def build(at: Mapping[str, Fraction]) -> MDP:
        made.append(at["p"])
        rows = [(0, 0, [(at["p"], 1, 1), (1 - at["p"], 0, 0)]), (0, 1, [(1, 1, F(3, 4))])]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], "9/10")

    family = Family(parameters=(HALF,), build=build)
    for _ in range(2):
        made.clear()
        assert len(thresholds(family, "p", (F(1, 10), F(3, 4))).found) == 1
        assert len(made) == len(set(made))
