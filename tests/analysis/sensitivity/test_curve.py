"""The value as a function of a parameter, against closed forms and single certificates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction

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
    thresholds,
)

F = Fraction
SMALL = Scenario.load("tea").with_(tasks=[1], max_trial=2)


def start_of(mdp: MDP, policy: object) -> Fraction:
    """The exact value of a policy at one point."""
    value = check(mdp, policy, exact_values=True).regret.learned.value
    assert isinstance(value, Fraction)
    return value


def test_puterman_in_closed_form() -> None:
    # Puterman (1994), section 3.1; QuantEcon.py, quantecon/markov/tests/test_ddp.py
    rows = [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])]
    found = curve(MDP.from_outcomes(rows, "1/2"), "discount", (0, "99/100"))
    low, high = found.pieces
    assert (low.value.numerator, low.value.denominator) == ((10, -11), (1, -1))
    assert (high.value.numerator, high.value.denominator) == (
        (5, F(-11, 2)),
        (1, F(-3, 2), F(1, 2)),
    )
    assert low.high == high.low
    assert low.high[0] <= F(10, 11) <= low.high[1]
    with pytest.raises(ModelError, match="outside the range"):
        found.at(1)


shares = st.integers(1, 6)
PUTERMAN = MDP.from_outcomes(
    [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])], "1/2"
)


@settings(max_examples=25, deadline=None)
@given(
    weights=st.lists(st.tuples(shares, shares, shares), min_size=6, max_size=6),
    rewards=st.lists(st.integers(-5, 5), min_size=6, max_size=6),
    limit=st.fractions(0, 2, max_denominator=10),
    relative=st.booleans(),
    sense=st.sampled_from(["max", "min"]),
)
def test_where_a_policy_keeps_a_limit(
    weights: list[tuple[int, int, int]],
    rewards: list[int],
    limit: Fraction,
    relative: bool,
    sense: str,
) -> None:
    rows = [
        (s // 2, s % 2, [(F(w, sum(each)), t, rewards[s]) for t, w in enumerate(each)])
        for s, each in enumerate(weights)
    ]
    mdp = MDP.from_outcomes(rows, discount="1/2", sense=sense)
    found = curve(mdp, "discount", (0, "19/20"), policy=[0, 0, 0])
    kept = found.within(**{"max_relative_regret" if relative else "max_regret": limit})
    tests = [F(19 * k, 20 * 24) for k in range(25)]
    tests += [e for each in kept for e in (*each.low, *each.high)]
    for at in tests:
        best, mine = found.at(at), start_of(mdp.with_(discount=at), [0, 0, 0])
        inside = [each for each in kept if each.low[0] <= at <= each.high[1]]
        if all(
            not (each.low[0] < at < each.low[1] or each.high[0] < at < each.high[1])
            and not (each.low[0] != each.low[1] and at == each.low[0])
            and not (each.high[0] != each.high[1] and at == each.high[1])
            for each in inside
        ):
            assert (abs(best - mine) <= limit * (abs(best) if relative else 1)) == bool(inside)


def test_limits_that_say_nothing_are_refused() -> None:
    found = curve(PUTERMAN, "discount", (0, "99/100"))
    with pytest.raises(ModelError, match="no policy"):
        found.within(1)
    held = curve(PUTERMAN, "discount", (0, "99/100"), policy=[0, 0])
    with pytest.raises(ModelError, match="two limits"):
        held.within(1, 1)
    with pytest.raises(ModelError, match="0 or more"):
        held.within(-1)
    (only,) = held.within()  # optimal from 10/11 on: Puterman (1994), section 3.1
    assert only.low[0] <= F(10, 11) <= only.low[1]
    assert only.high == (F(99, 100),) * 2


def test_the_command_says_where_a_policy_keeps_a_limit() -> None:
    words = ("curve", "tea", "--set", "tasks=[1]", "--set", "max_trial=2")
    asked = (*words, "--parameter", "base.anxiety", "--max-relative-regret", "1/100", "--json")
    result = run(*asked, "--policy", "always:prompt").result
    found = curve(SMALL, "base.anxiety", policy="always:prompt")
    kept = found.within(max_relative_regret="1/100")
    brackets = [(*each["from_bracket"], *each["to_bracket"]) for each in result["within"]]
    assert [tuple(map(F, each)) for each in brackets] == [(*e.low, *e.high) for e in kept]
    fixed = result["pieces"][0]["fixed"]
    assert tuple(map(F, fixed["numerator"])) == found.pieces[0].fixed.numerator
    assert "keeps the limit" in run(*asked[:-1]).out  # of the optimum, unless a policy is given
    refused = run(*asked, "--max-regret", "1")
    assert (refused.status, refused.out) == (2, "")
    assert "two limits" in refused.err


@pytest.mark.parametrize("sense", ["max", "min"])
def test_a_table_is_followed_where_nothing_is_earned_today(sense: str) -> None:
    """Its greedy action counts in states that are over, or whose actions are alike, at 0."""
    parameter = Parameter(name="t", value=F(0), low=F(-1), high=F(1))

    def build(at: Mapping[str, F]) -> MDP:
        rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, at["t"])]), (2, 0, [(1, 2, 0)])]
        rows += [(1, 0, [(1, 1, at["t"])]), (1, 1, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, "1/2", sense=sense)

    family = Family(parameters=(parameter,), build=build)
    table = np.array([[0.0, 2.0], [1.0, 3.0], [0.0, 0.0]]) * (1 if sense == "max" else -1)
    found = curve(family, "t", (-1, 1), policy=table)
    for t in (F(-1), F(-1, 2), F(0), F(1)):
        assert found.fixed_at(t) == t  # action 1 in state 0, and nothing after that
    [kept] = found.within(0)  # what it earns in state 0 has to be good, and in state 1 to be bad
    assert (float(kept.low[0]), float(kept.high[1])) == pytest.approx((0, 0))


def test_a_policy_that_is_silent_where_it_matters_elsewhere_is_refused() -> None:
    """A function is not asked about a state in which all is over today."""
    parameter = Parameter(name="t", value=F(0), low=F(-1), high=F(1))
    family = Family(
        parameters=(parameter,),
        build=lambda at: MDP.from_outcomes([(0, 0, [(1, 0, at["t"])]), (0, 1, [(1, 0, 0)])], "1/2"),
    )
    for policy in ([[1.0, 2.0]], [1], {0: 1}, [[0.0, 1.0]]):
        found = curve(family, "t", (-1, 1), policy=policy)
        assert (found.fixed_at(-1), found.fixed_at(1)) == (0, 0)
        assert found.within(0)[0].low[0] == -1
        assert found.within(0)[-1].high[1] == pytest.approx(0)
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
    held = gradient(WAIT, policy=[1, 0, 0], names=["reward.5"])  # this one ends
    assert held["reward.5"].value == Certified(value=F(1))
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
        found = curve(family(stays), "x", right)
        assert found.at("1/4") == 1 / (1 - stays(F(1, 4)))
        assert found.violations() == []


def test_the_curve_of_the_discount_ends_below_1_where_some_policy_never_ends() -> None:
    for engine in (thresholds, curve):
        assert engine(WAIT, "discount").range.high < 1
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
    found = curve(SMALL, name)
    each = gradient(SMALL, names=[name])[name]
    sides = [None if side is None else side.value for side in (each.left, each.right)]
    assert [*found.slope(found.parameter.value)] == sides


def test_slopes_at_a_tie_are_those_of_the_policies_on_both_sides() -> None:
    p = Parameter(name="p", value=F(1, 2), low=F(0), high=F(1))

    def build(at: Mapping[str, Fraction]) -> MDP:
        rows = [(0, 0, [(1, 1, at["p"])]), (0, 1, [(1, 1, 1 - at["p"])]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows)

    family = Family(parameters=(p,), build=build)
    found, each = curve(family, "p"), gradient(family)["p"]
    assert found.slope("1/2") == (each.left.value, each.right.value) == (-1, 1)
    assert (found.slope(0), found.slope(1)) == ((None, -1), (1, None))


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

    p = Parameter(name="p", value=F(1, 2), low=F(0), high=F(1))
    family = Family(parameters=(p,), build=build)
    for _ in range(2):
        made.clear()
        assert len(thresholds(family, "p", (F(1, 10), F(3, 4))).found) == 1
        assert len(made) == len(set(made))
