"""Derivatives and thresholds of families: certified where the degree is known, else checked."""

from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction as F
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusal_tables import refused, table_of_refusals

from exact_mdp import (
    MDP,
    Certified,
    Claim,
    Family,
    Parameter,
    Range,
    Scenario,
    certify,
    gradient,
    moving,
    one_way,
    parametric,
    thresholds,
    tornado,
    two_way,
)


def unit(name: str, value: F) -> Parameter:
    return Parameter(name=name, value=value, low=F(0), high=F(1))


def earning(gain: F) -> MDP:
    return MDP.from_outcomes([(0, 0, [(1, 1, gain)]), (1, 0, [(1, 1, 0)])])


def staying(at) -> MDP:
    """Earn 1 and stay with probability p: V = 1 / (1 - p)."""
    return MDP.from_arrays([[[at["p"], 1 - at["p"]], [0, 1]]], [1, 0])


def waiting(at) -> MDP:
    """V = 1 / (1 - p² / 2), at discount 1/2."""
    return staying({"p": at["p"] ** 2}).with_(discount=F(1, 2))


def turning(at) -> MDP:
    """The value is -∞ below p = 1/2, 0 there, and +∞ above."""
    return MDP.from_outcomes([(0, 0, [(1, 1, 0)]), (1, 0, [(1, 1, at["p"] - F(1, 2))])])


def start_value(mdp: MDP) -> F | float:
    return certify(mdp).start_value


# ---- the degree ----------------------------------------------------------------------------------


def family(build: Any, value: F = F(1, 2), **more: Any) -> Family:
    return Family(parameters=(unit("p", value),), build=build, **more)


def changing(what: str) -> Callable[[Any], MDP]:
    """Rows and discount follow; a start or pairs that change would be left out silently."""

    def build(at):
        p = at["p"]
        rows = [(0, 0, [(p, 0, 1), (1 - p, 1, 0)]), (1, 0, [(1, 1, 0)])]
        if what == "pairs" and p > F(9, 16):
            rows.append((0, 1, [(1, 1, 0)]))
        start = {0: p, 1: 1 - p} if what == "start" else 0
        return MDP.from_outcomes(rows, p**2 if what == "discount" else F(1, 2), start=start)

    return build


polynomials = st.lists(st.fractions(-3, 3, max_denominator=6), min_size=1, max_size=3)


def evaluated(numbers, x):
    total = F(0) * x
    for number in reversed(numbers):
        total = total * x + number
    return total


@st.composite
def families(draw) -> Family:
    """Two actions in a state that repeats, one in another; polynomials of degree 2 at most."""
    gains = [draw(polynomials) for _ in range(3)]
    power = draw(st.integers(0, 2))
    discount = draw(st.sampled_from([F(1, 2), F(9, 10)]))

    def build(at):
        p = at["p"]
        stay = p**power / 2
        rows = [
            (0, 0, [(stay, 0, evaluated(gains[0], p)), (1 - stay, 1, F(0))]),
            (0, 1, [(F(1, 3), 0, evaluated(gains[1], p)), (F(2, 3), 1, F(1))]),
            (1, 0, [(F(1, 2), 0, evaluated(gains[2], p)), (F(1, 2), 2, F(0))]),
            (2, 0, [(F(1), 2, F(0))]),
        ]
        return MDP.from_outcomes(rows, discount)

    value = draw(st.sampled_from([F(1, 3), F(1, 2), F(4, 7)]))
    return Family(parameters=(unit("p", value),), build=build, degrees={"p": power + 2})


@given(families())
@settings(max_examples=25)
def test_checked_derivatives_are_the_slopes_of_exact_values(family: Family) -> None:
    """Values in fractions on either side, three steps each, close in on the derivative."""
    slope = gradient(family)["p"]
    assert slope.claim == Claim.CHECKED
    today = slope.parameter.value
    here = start_value(family.at({"p": today}))
    for sign, side in ((1, slope.right), (-1, slope.left)):
        assert side is not None
        errors = []
        for step in (F(1, 10**4), F(1, 2 * 10**4)):
            there = start_value(family.at({"p": today + sign * step}))
            errors.append(abs((there - here) / (sign * step) - side.value))
        # The error of a difference is of the order of its step.
        assert errors[1] <= errors[0] * F(51, 100) + F(1, 10**7)


@given(families())
@settings(max_examples=15)
def test_checked_thresholds_are_where_optimal_actions_change(family: Family) -> None:
    switches = thresholds(family, "p", (F(1, 100), F(99, 100)))
    assert switches.claim == Claim.CHECKED
    cuts = switches.found

    def best(value: F) -> np.ndarray:
        return certify(family.at({"p": value})).optimal_pairs

    for each in cuts:
        assert (best(each.low) != best(each.high)).any() or each.low == each.high
    ends = [F(1, 100), *(end for each in cuts for end in (each.low, each.high)), F(99, 100)]
    for low, high in list(pairwise(ends))[::2]:
        inside = [best(low + (high - low) * F(k, 7)) for k in (1, 2, 4, 6)]
        optimal = switches.curve.around((low + high) / 2)[0].optimal
        assert all((one >= optimal).all() for one in inside)
        assert sum(bool((one != optimal).any()) for one in inside) <= 1  # a tie at one point


# ---- what was refused, or not told ---------------------------------------------------------------


@pytest.mark.parametrize("bounds", [(-1, 1), (-1, 2), (F(-1, 2), F(1, 4))])
def test_thresholds_where_an_absorbing_reward_spans_both_signs(bounds) -> None:
    """Staying for ever is worth r / (1 - γ), leaving 1/10: they part where r = 1/10."""

    def build(at):
        rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 2, F(1, 10))])]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, at["r"])]), (2, 0, [(1, 2, 0)])], F(1, 2))

    family = Family(parameters=(Parameter(name="r", value=F(0)),), build=build)
    switches = thresholds(family, "r", bounds)
    (one,) = switches.found
    assert one.low <= F(1, 10) <= one.high
    assert (one.switches[0].before, one.switches[0].after) == (("1",), ("0",))
    assert switches.claim == Claim.CHECKED


def test_what_is_checked_at_points_alone_is_not_certified() -> None:
    """A family that `moving` made is certified, until its builder is replaced."""
    known = moving(staying({"p": F(1, 2)}), {"p": [(0, 0)]})
    assert gradient(known)["p"].value == Certified(value=F(4))
    assert gradient(replace(known, name="again"))["p"].claim == Claim.CERTIFIED
    other = replace(known, build=lambda at: staying(at))
    assert gradient(other, names=["p"])["p"].claim == Claim.CHECKED
    unknown = Family(parameters=(unit("p", F(1, 2)),), build=staying)
    near = gradient(unknown, exact=False)["p"]
    assert near.claim == Claim.CHECKED
    assert 0 < near.value.error < 1e-12  # a float keeps the bound on its error
    assert abs(F(near.value.value) - 4) <= near.value.error
    assert gradient(unknown).frame()["claim"].tolist() == ["checked"]


def test_two_entries_of_one_row_have_a_gradient() -> None:
    """Each has room until both sum to 1; V = (1 + 2 b γ / (1 - γ)) / (1 - γ a) by hand."""
    mdp = MDP.from_arrays([[["1/2", "1/4", "1/4"], [0, 1, 0], [0, 0, 1]]], [1, 2, 0], "1/2")
    family, a, b = moving(mdp, {"a": [(0, 0)], "b": [(0, 1)]}), F(1, 2), F(1, 4)
    assert start_value(family.at({"a": F(1, 8)})) == (1 + 2 * b) / (1 - F(1, 16))
    slopes = {"a": (1 + 2 * b) / 2 / (1 - a / 2) ** 2, "b": 2 / (1 - a / 2)}
    derivatives = gradient(family)
    assert {name: derivatives[name].value for name in slopes} == {
        name: Certified(value=slope) for name, slope in slopes.items()
    }


def test_a_moved_model_keeps_its_limit() -> None:
    mdp = MDP.from_arrays([[["1/2", "1/4", "1/4"], [0, 1, 0], [0, 0, 1]]], [1, 0, 0], time_limit=9)
    family = moving(mdp, {"stay": [(0, 0)], "leave": [(0, 1)]})
    assert family.at({"stay": "1/3"}).time_limit == family.at({}).time_limit == 9


# ---- default ranges ------------------------------------------------------------------------------

CONTINUING = MDP.from_arrays(
    [[["1/2", "1/2"], ["1/5", "4/5"]], [[1, 0], [0, 1]]], [1, 2], F(9, 10), layout="ass"
)


def test_the_default_range_of_a_discount_stays_below_1_where_the_model_goes_on() -> None:
    """Half way to 1 in a model that never ends; 1 itself where every policy ends."""
    (span,) = tornado(CONTINUING, names=["discount"]).spans.values()
    assert (span.low, span.high) == (F(18, 25), F(19, 20))
    assert one_way(CONTINUING, "discount", points=3).table.points[-1, 0] == F(19, 20)
    assert thresholds(CONTINUING, "discount").curve.range.high == F(19, 20)
    ending = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0], F(9, 10))
    (span,) = tornado(ending, names=["discount"]).spans.values()
    assert span.high == 1


def test_default_ranges_stay_where_there_is_a_model() -> None:
    """A probability of staying of 9/10 ± 20 % would be 1, and the model would never end."""
    mdp = MDP.from_arrays([[["9/10", "1/10"], [0, 1]]], [1, 0])
    spans = {p.name: span for p, span in tornado(moving(mdp, {"stay": [(0, 0)]})).spans.items()}
    assert spans["stay"].high == F(19, 20)
    rows = [["1/2", "9/20", "1/20"], [0, 1, 0], [0, 0, 1]]
    family = moving(MDP.from_arrays([rows], [1, 2, 0], "1/2"), {"a": [(0, 0)], "b": [(0, 1)]})
    spans = {p.name: span for p, span in tornado(family).spans.items()}
    assert (spans["a"].high, spans["b"].high) == (F(11, 20), F(1, 2))
    open_ended = Family(parameters=(Parameter(name="p", value=F(9, 10)),), build=staying)
    (span,) = tornado(open_ended).spans.values()
    assert F(9, 10) < span.high < 1
    assert two_way(family, "a", "discount", points=2).policy.shape == (2, 2)


# ---- numbers and names as they are given ---------------------------------------------------------


SIXTEENTHS = "16/9 (checked: the degree holds at 7 points, and is not proven)"
NUMBERS = [0.25, "1/4", F(1, 4), Decimal("0.25"), np.float32(0.25), np.float64(0.25), "0.25"]


@pytest.mark.parametrize("number", NUMBERS, ids=repr)
def test_numbers_of_parameters_become_exact_at_the_door(number: Any) -> None:
    p = Parameter(name="p", value=number, low=0, high=Decimal(1))
    assert (p.value, p.low, p.high) == (F(1, 4), 0, 1)
    assert {type(part) for part in (p.value, p.low, p.high)} == {F}
    for parameters in ((p,), [p], {"p": number}):
        family = Family(parameters=parameters, build=staying, breaks={"p": [number]})
        assert family.breakpoints("p") == (F(1, 4),)
        slope = gradient(family)["p"]
        assert (str(slope.value), slope.claim) == (SIXTEENTHS, Claim.CHECKED)
    assert Range(low=number, high=1) == Range(low=F(1, 4), high=F(1))


def stayer(**parts: Any) -> Family:
    return Family(parameters={"p": 0.5}, build=staying, **parts)


test_what_is_no_parameter_or_not_certified = table_of_refusals(__file__, globals())
WORDS = MDP.from_arrays(
    {"sick": {"wait": {"sick": "1/2", "well": "1/4", "dead": "1/4"}}, "well": {}, "dead": {}},
    {"sick": -1, "well": 0, "dead": 0},
)


def test_entries_are_named_as_states_and_actions_are_everywhere() -> None:
    wanted = moving(WORDS, {"recovery": [(0, 1)]}).at({"recovery": "2/5"}).table.row(0)
    for entry in ((("sick", "wait"), "well"), (("state sick", 0), 1), (np.int64(0), "well")):
        outcomes = moving(WORDS, {"recovery": [entry]}).at({"recovery": "2/5"}).table.row(0)
        assert outcomes == wanted
    for entry, what in (
        ((("sick", "wait"), "wel"), "unknown state 'wel'"),
        ((("sick", "wail"), "well"), "unknown action 'wail'"),
        ((99, "well"), "there is no pair 99"),
        (("sick", "well"), "there is no pair 'sick'"),
        (("sick", "wait", "well"), "an entry is"),
    ):
        refused(lambda each=entry: moving(WORDS, {"recovery": [each]}), what, "parameter recovery")


@pytest.mark.parametrize(
    "readings", [{}, {"skip_onset": "base"}, {"skip_timestep": "own", "skip_onset": "base"}]
)
def test_degrees_of_scenarios_hold_at_further_points(readings: dict[str, str]) -> None:
    """What follows from the rules is checked here: no entry leaves its polynomial."""
    family = parametric(Scenario.load("yuan2025").with_(tasks=[1], max_trial=2, readings=readings))
    names = ["base.confusion", "persistence.anger", "influence.anger.confusion", "discount"]
    free = Family(
        parameters=family.parameters,
        build=lambda at: family.at(at),
        degrees={p.name: family.degree(p.name) for p in family.parameters},
        breaks={p.name: family.breakpoints(p.name) for p in family.parameters},
    )
    own, other = gradient(family, names=names), gradient(free, names=names)
    for name in names:
        assert other[name].claim == Claim.CHECKED
        assert other[name].value.value == own[name].value.value


def test_models_without_a_step_have_gradients() -> None:
    for gain, discount in ((0, 1), (0, "1/2"), (1, "1/2")):
        family = moving(MDP.from_arrays([[[1]]], [gain], discount), {})
        value = gradient(family, policy=[0])["discount"].value
        assert value is not None
        assert value.value == (4 if gain else 0)
        assert gradient(family)["discount"].elasticity == (1.0 if gain else None)


def test_an_elasticity_beyond_floats_is_infinite_not_an_error() -> None:
    """The value is 1e-320, the parameter 1 and the derivative 1: 1e320 per cent."""
    tiny = F(1, 10**320)
    family = Family(
        parameters=(Parameter(name="p", value=F(1)),), build=lambda at: earning(at["p"] - 1 + tiny)
    )
    assert gradient(family)["p"].elasticity == np.inf


def test_outcomes_of_probability_0_are_explored_where_that_is_said() -> None:
    """Else a state is not there, or has another number, where a parameter is 0."""

    def model(at: Any, impossible: bool = True) -> MDP:
        def outcomes(state: str, action: str) -> list[Any]:
            stays = 1 - at["die"] - at["fall"]
            return [(at["die"], "dead", 0), (at["fall"], "ill", 2), (stays, state, 1)]

        def actions(state: str) -> list[str]:
            return ["wait"] if state == "well" else []

        return MDP.from_function("well", actions, outcomes, "1/2", impossible=impossible)

    today = {"die": F(1, 10), "fall": F(1, 5)}
    for name in today:
        changed = model(today | {name: F(0)})
        assert changed.space == model(today).space == model(today, impossible=False).space
        assert changed.table.row(0)[0][0] == 1 - sum(today.values()) + today[name]
        assert model(today | {name: F(0)}, impossible=False).n_states == 2
    family = Family(parameters=today, build=model)
    reached = family.at({"die": 0})
    assert certify(reached).start_value == certify(model(today | {"die": F(0)}, False)).start_value
