"""The value along one parameter and where its policies change: closed forms and certificates."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

import pytest
from cases import BY_NAME
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import forest
from oracle import best_average, gain_and_bias
from strategies import Rows, models, of_case

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
    evaluate,
    gradient,
    moving,
    parametric,
    solve,
    thresholds,
)

F = Fraction
WIDTH = F(1, 10**12)
YUAN = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
TEA = Scenario.load("tea").with_(tasks=[1], max_trial=2)
# Puterman (1994), section 3.1; QuantEcon.py, quantecon/markov/tests/test_ddp.py
PUTERMAN = MDP.from_outcomes(
    [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])], "1/2"
)
WAIT = MDP.from_outcomes(
    [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 2, 5)]), (1, 0, [(1, 1, -1)]), (2, 0, [(1, 2, 0)])]
)


def lone(build: Callable[[Any], MDP], value: object = 0, low: int = -1, **more: Any) -> Family:
    """Return a family of one parameter, p, of at most 1."""
    (p,) = parameters = (Parameter(name="p", value=value, low=low, high=1),)
    return Family(parameters=parameters, build=lambda at: build(at[p.name]), **more)


def start_of(mdp: MDP, policy: object) -> Fraction:
    """The exact value of a policy at one point."""
    value = check(mdp, policy, exact_values=True).regret.learned.value
    assert isinstance(value, Fraction)
    return value


def agrees(slopes: Any, family: Parametric, at: Fraction, policy: object) -> dict[str, set[str]]:
    """Compare a curve with a certificate; return the optimal actions by the names of states."""
    mdp = family.at({slopes.parameter.name: at})
    certificate = certify(mdp)
    assert slopes.at(at) == certificate.start_value
    assert slopes.fixed_at(at) == start_of(mdp, policy)
    for piece in slopes.around(at):
        if piece.low[1] < at < piece.high[0]:
            assert (piece.optimal == certificate.optimal_pairs)[~mdp.terminal[mdp.pair_state]].all()
    best = [
        [p for p in mdp.pairs_of(s) if certificate.optimal_pairs[p]] for s in range(mdp.n_states)
    ]
    return {
        mdp.space.label(s): {mdp.actions[mdp.pair_action[p]] for p in own}
        for s, own in enumerate(best)
    }


def test_puterman_leaves_at_ten_elevenths() -> None:
    value_curve = curve(PUTERMAN, "discount", (0, "99/100"), policy=[0, 0])
    low, high = value_curve.pieces
    assert (low.value.numerator, low.value.denominator) == ((10, -11), (1, -1))
    assert high.value.numerator == (5, F(-11, 2))
    assert high.value.denominator == (1, F(-3, 2), F(1, 2))
    assert low.high == high.low
    (best,) = value_curve.within()  # where action 0 is optimal
    assert best.low[0] <= F(10, 11) <= best.low[1]
    assert (best.low, best.high) == (low.high, (F(99, 100),) * 2)
    switches = thresholds(PUTERMAN, "discount", (0, F(999, 1000)))
    (one,) = switches.found
    assert one.low <= F(10, 11) <= one.high <= one.low + WIDTH
    (switch,) = one.switches
    assert (switch.state, switch.before, switch.after) == (0, ("1",), ("0",))
    assert switches.stable() == (0, one.low)
    assert switches.radius == one.low - F(1, 2)


THIRD, HALF, TINY = F(1, 3), F(1, 2), F(1, 10**15)
SWITCHES: dict[str, tuple[Callable[[F], list[F]], dict[str, Any], list[Any], tuple[F, F]]] = {
    "a root that touches": (
        lambda p: [F(0), -((p - THIRD) ** 2)], {"degrees": {"p": 2}}, [], (0, 1),
    ),
    "closer than a bracket": (
        lambda p: [F(0), p - THIRD, 2 * (p - THIRD) - TINY], {},
        [(THIRD, "0", "1"), (THIRD + TINY, "1", "2")], (THIRD, 1),
    ),
    "closer than a bracket to one that is exact": (
        lambda p: [F(0), p - HALF, 2 * (p - HALF) - TINY], {},
        [(HALF, "0", "1"), (HALF + TINY, "1", "2")], (HALF, HALF),
    ),
    "three at one point": (
        lambda p: [F(0), p - THIRD, 2 * (p - THIRD)], {}, [(THIRD, "0", "2")], (THIRD, 1),
    ),
    "a tie today, of actions that are alike": (
        lambda p: [HALF, p, p], {}, [(HALF, "0", "12")], (HALF, HALF),
    ),
    "a breakpoint": (
        lambda p: [F(0), max(F(0), p - HALF)], {"breaks": {"p": [HALF]}}, [(HALF, "01", "1")],
        (HALF, HALF),
    ),
}  # fmt: skip


def test_states_that_change_at_once_share_a_row_of_the_report() -> None:
    """Four of five named states change at 1/4; JSON has a row for each of them."""

    def build(p: F) -> MDP:
        limits = [F(1, 4), F(1, 4), F(3, 4), F(1, 4), F(1, 4)]
        gains = [gain for limit in limits for gain in (p, limit)]
        rows = [(n // 2, n % 2, [(1, 5, gain)]) for n, gain in enumerate(gains)]
        names = [f"s{k}" for k in range(5)] + ["end"]
        return MDP.from_outcomes([*rows, (5, 0, [(1, 5, 0)])], states=names)

    report = thresholds(lone(build, HALF, 0), "p", (0, 1)).report()
    assert [each["state"] for each in report.facts["switches"]] == [
        *("state s0", "state s1", "state s3", "state s4"),
        "state s2",
    ]
    shown = report.tables["switches"].rows
    assert [each["state"] for each in shown] == [
        "4 states: s0, s1, s3, …",
        "state s2",
    ]
    assert [each["threshold"] for each in shown] == [0.25, 0.75]


@pytest.mark.parametrize("name", SWITCHES)
def test_where_one_action_of_several_becomes_best(name: str) -> None:
    gains, more, wanted, stable = SWITCHES[name]

    def build(p: F) -> MDP:
        rows = [(0, action, [(1, 1, gain)]) for action, gain in enumerate(gains(p))]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])

    switches = thresholds(lone(build, HALF, 0, **more), "p", (0, 1))
    for threshold, (at, before, after) in zip(switches.found, wanted, strict=True):
        assert threshold.low <= at <= threshold.high <= threshold.low + WIDTH
        assert ["".join(threshold.switches[0].before), "".join(threshold.switches[0].after)] == [
            before,
            after,
        ]
    assert all(one.high <= other.low for one, other in pairwise(switches.found))
    for end, wanted_end in zip(switches.stable(), stable, strict=True):
        assert abs(end - wanted_end) <= WIDTH
    assert (switches.radius == 0) == (stable[0] == stable[1])


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


@settings(max_examples=25)
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


@pytest.mark.parametrize(
    ("model", "name", "bounds"),
    [
        (TEA, "base.anxiety", None),
        (TEA, "reward.assist.prompt", (-6, 1)),
        (TEA, "discount", ("1/10", "9/10")),
        (YUAN, "assistance.directive.confusion.persistence", ("1/2", 1)),
        (YUAN.with_(readings={"skip_onset": "base"}), "reward.anger", (-2, 0)),
        (YUAN.with_(readings={"skip_timestep": "own"}), "discount", ("1/10", 1)),
    ],
)
def test_scenarios_against_certificates_at_single_points(
    model: Scenario, name: str, bounds: Any
) -> None:
    """Between two points the optimal actions of a state are those before and after its switches."""
    value_curve, switches = (
        curve(model, name, bounds, policy="random"),
        thresholds(model, name, bounds),
    )
    low, high = value_curve.range.low, value_curve.range.high
    assert (low, high) == tuple(map(F, bounds or (0, 1)))  # or all that a probability may be
    cuts = switches.found
    assert {(each.low, each.high) for each in cuts} <= {p.high for p in value_curve.pieces[:-1]}
    assert len(value_curve.frame()) == len(value_curve.pieces) > len(cuts)
    assert all(each.high - each.low <= WIDTH for each in switches.found)
    grid = [low + (high - low) * F(2 * k + 1, 12) for k in range(6)]
    family = parametric(model)
    answers = [agrees(value_curve, family, at, "random") for at in grid]
    for (left, one), (right, two) in pairwise(zip(grid, answers, strict=True)):
        inside = [each for each in cuts if left < each.low and each.high < right]
        turned = [switch for each in inside for switch in each.switches]
        for label in {state for state in one if one[state] != two[state]}:
            own = [switch for switch in turned if switch.label == label]
            assert (set(own[0].before), set(own[-1].after)) == (one[label], two[label])


@settings(max_examples=25)
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
    """Max(0, 1 - |p|) against 0: nothing is lost at both ends alone, and most in the middle."""

    def build(p: F) -> MDP:
        rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 1 - abs(p))]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows)

    within = curve(lone(build, breaks={"p": [0]}), "p", (-1, 1), policy=[0, 0]).within(0)
    assert [(each.low, each.high) for each in within] == [((p, p), (p, p)) for p in (F(-1), F(1))]


@pytest.mark.parametrize("span", [(-1, 1), (0, 1), (-1, 0)])
@pytest.mark.parametrize("gain", [lambda p: F(p < 0), lambda p: F(p <= 0)])
def test_a_jump_is_refused_unless_its_value_belongs_to_all_of_a_range(
    gain: Callable[[F], F], span: tuple[int, int]
) -> None:
    def build(p: F) -> MDP:
        return MDP.from_outcomes([(0, 0, [(1, 1, gain(p))]), (1, 0, [(1, 1, 0)])])

    family = lone(build, breaks={"p": [0]})
    if all(gain(F(end)) == gain(F(0)) for end in span):
        assert curve(family, "p", span).at(0) == gain(F(0))
    else:
        with pytest.raises(ModelError, match=r"rows are not polynomials(.|\n)*state 0"):
            curve(family, "p", span)


def leaving(chance: Callable[[F], F], value: object, high: int = 1, **more: Any) -> Family:
    """Return a model that is left with a chance of p, for 1 a step, or at once for 3."""
    (p,) = parameters = (Parameter(name="p", value=value, low=0, high=high),)

    def build(at: Any) -> MDP:
        q = chance(at[p.name])
        rows = [(0, 0, [(1 - q, 0, 1), (q, 1, 1)]), (0, 1, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, "9/10")

    return Family(parameters=parameters, build=build, **more)


@pytest.mark.parametrize(
    ("chance", "kink", "value", "high", "switches"),
    [
        (lambda p: max(F(1, 5), p / 10), F(2), 3, 4, [2.5926]),
        (lambda p: p if p < HALF else (1 + p) / 3, HALF, "1/2", 1, [0.2593]),
        (lambda p: min(2 * p, HALF), F(1, 4), "1/2", 1, [0.1296]),
    ],
)
def test_a_kink_is_refused_by_a_value_beyond_it_until_it_is_stated(
    chance: Callable[[F], F], kink: Fraction, value: object, high: int, switches: list[float]
) -> None:
    hidden = leaving(chance, value, high)
    for call in (lambda: curve(hidden, "p"), lambda: thresholds(hidden, "p", (0, high))):
        with pytest.raises(ModelError, match="not polynomials of degree 1 in p") as error:
            call()
        at, place = error.value.where.removeprefix("parameter p = ").split(", ", 1)
        assert (0 <= F(at) <= high, place) == (True, "state 0, action 0")
        assert 'state breaks={"p": [value, …]}' in error.value.fix
        assert 'degrees={"p": 2}' in error.value.fix
    stated = leaving(chance, value, high, breaks={"p": [kink]})
    whole = thresholds(stated, "p", (0, high))
    assert [each.value for each in whole.found] == pytest.approx(switches, abs=1e-4)
    assert whole.curve.violations() == []
    for k in range(33):
        at = F(high * k, 32)
        assert whole.curve.at(at) == certify(stated.at({"p": at})).start_value


@pytest.mark.parametrize("today", [F(1, 20), F(1, 2), F(1)])
@pytest.mark.parametrize("span", [(0, 1), ("1/3", "9/10")])
def test_one_kink_of_a_line_is_found_wherever_it_is(
    today: Fraction, span: tuple[object, object]
) -> None:
    for k in range(1, 60):
        kink = F(span[0]) + (F(span[1]) - F(span[0])) * F(k, 60)
        with pytest.raises(ModelError, match="not polynomials"):
            curve(leaving(lambda p, kink=kink: max(p, kink) / 2, today), "p", span)
    beyond = leaving(lambda p: max(p, F(span[0])) / 2, today)
    assert curve(beyond, "p", span).violations() == []


def test_a_derivative_at_a_kink_has_two_sides_once_it_is_stated() -> None:
    with pytest.raises(ModelError, match="not polynomials"):
        gradient(leaving(lambda p: max(p, HALF) / 10, HALF))
    slope = gradient(leaving(lambda p: max(p, HALF) / 10, HALF, breaks={"p": [HALF]}))["p"]
    assert slope.left is not None
    assert slope.right is not None
    assert (slope.left.value, slope.right.value < 0) == (0, True)


def test_where_there_is_no_model_on_a_side_the_points_are_nearer_or_on_the_other() -> None:
    """A chance of 3 p, and one that is 0 from today on to the left."""
    for chance, today, side in ((lambda p: 3 * p, "1/4", 3), (lambda p: p - HALF, HALF, 1)):
        slope = gradient(leaving(chance, today), policy=[0, 0])["p"]
        q = chance(F(today))
        # V = 1 / (1 - 0.9 (1 - q)) and its derivative by q, times that of q
        assert slope.value.value == -F(9, 10) * side / (1 - F(9, 10) * (1 - q)) ** 2


def test_what_leads_to_the_end_without_a_reward_counts_in_the_degree() -> None:
    """Its row has no entry; a chance that is 0 at a single point closes no way to the end."""

    def build(p: F) -> MDP:
        chance = (p - HALF) ** 2
        row = [(share, to, 1) for share, to in ((chance, 1), (1 - chance, 2)) if share]
        stay = [("1/2", 1, 1), ("1/2", 2, 1)]
        return MDP.from_outcomes(
            [(0, 0, row), (1, 0, [(1, 3, 0)]), (2, 0, stay), (3, 0, [(1, 3, 0)])]
        )

    value_curve = curve(lone(build, "1/4", 0, degrees={"p": 2}), "p", (F(1, 8), F(7, 8)))
    assert value_curve.pieces[0].value.numerator == (F(5, 2), 2, -2)
    assert value_curve.violations() == []


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
        ({"start": ((0, F(1, 2)), (1, F(1, 2)))}, {}, "another one"),
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


def test_the_command_says_what_the_function_says() -> None:
    line = "curve tea --set tasks=[1] --set max_trial=2 --parameter"
    limit = ("base.anxiety", "--max-relative-regret", "1/100")
    within = run(line, *limit, "--policy", "always:prompt", "--json").result["within"]
    wanted = curve(TEA, "base.anxiety", policy="always:prompt").within(max_relative_regret="1/100")
    for answer, each in zip(within, wanted, strict=True):
        assert [tuple(map(F, answer[end])) for end in ("from_bracket", "to_bracket")] == [
            each.low,
            each.high,
        ]
    far = run(line, "discount", "--json").result["pieces"][-1]
    last = TEA.compile().with_(discount="999999/1000000")
    assert evaluate(last, far["policy"]).mean == pytest.approx(solve(last).start.value)
    assert "pieces of the optimal value" in run(line, "discount").out
    assert "keeps the limit" in run(line, *limit).out  # of the optimum
    assert "two limits" in run(line, *limit, "--max-regret", "1").refusal()


# ---- policies that are held where nothing is earned ----------------------------------------------


@pytest.mark.parametrize("sense", ["max", "min"])
def test_a_table_is_followed_where_nothing_is_earned_today(sense: str) -> None:
    """Its greedy action counts in states that are over, or whose actions are alike, at 0."""

    def build(p: F) -> MDP:
        rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, p)]), (2, 0, [(1, 2, 0)])]
        rows += [(1, 0, [(1, 1, p)]), (1, 1, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, "1/2", sense=sense)

    sign = 1 if sense == "max" else -1
    table = [[0, 2 * sign], [1 * sign, 3 * sign], [0, 0]]
    value_curve = curve(lone(build), "p", (-1, 1), policy=table)
    for p in (F(-1), F(-1, 2), F(0), F(1)):
        assert value_curve.fixed_at(p) == p  # action 1 in state 0, and nothing after that
    [best] = value_curve.within(0)  # what it earns is good in state 0, and bad in state 1
    assert (float(best.low[0]), float(best.high[1])) == pytest.approx((0, 0))


def test_a_policy_that_is_silent_where_it_matters_elsewhere_is_refused() -> None:
    """A function is not asked about a state in which all is over today."""
    family = lone(lambda p: MDP.from_outcomes([(0, 0, [(1, 0, p)]), (0, 1, [(1, 0, 0)])], "1/2"))
    for policy in ([[1.0, 2.0]], [1], {0: 1}, [[0.0, 1.0]]):
        value_curve = curve(family, "p", (-1, 1), policy=policy)
        assert (value_curve.fixed_at(-1), value_curve.fixed_at(1)) == (0, 0)
        assert value_curve.within(0)[0].low[0] == -1
        assert value_curve.within(0)[-1].high[1] == pytest.approx(0)
    with pytest.raises(ModelError, match="names no action in a state"):
        curve(family, "p", (-1, 1), policy=lambda state: 1)


# ---- discount 1, and close to it -----------------------------------------------------------------


def test_where_some_policy_never_ends_a_policy_that_ends_has_derivatives() -> None:
    slopes = gradient(WAIT, policy=[1, 0, 0], names=["reward.5"])
    assert slopes["reward.5"].value == Certified(value=F(1))
    assert gradient(WAIT.with_(discount="9/10"))["reward.5"].value == Certified(value=F(1))
    assert curve(WAIT.within(3), "reward.5").at(7) == 7
    for line in (thresholds(WAIT, "discount").curve, curve(WAIT, "discount")):
        assert line.range.high < 1


def test_a_policy_that_never_ends_at_one_value_alone_is_found() -> None:
    """An episode goes on with the chance (2p - 1)², or 1 - (2p - 1)², and pays 1 a step."""
    for stays, wrong, right in (
        (lambda p: (2 * p - 1) ** 2, (0, F(3, 4)), (F(1, 8), F(3, 4))),
        (lambda p: 1 - (2 * p - 1) ** 2, (F(1, 8), F(3, 4)), (F(1, 8), F(3, 8))),
    ):

        def build(p: F, stays: Callable[[F], F] = stays) -> MDP:
            row = [(chance, to, 1) for chance, to in ((stays(p), 0), (1 - stays(p), 1)) if chance]
            return MDP.from_outcomes([(0, 0, row), (1, 0, [(1, 1, 0)])])

        family = lone(build, "1/4", 0, degrees={"p": 2})
        with pytest.raises(ModelError, match="some policy never ends"):
            curve(family, "p", wrong)
        value_curve = curve(family, "p", right)
        assert value_curve.at("1/4") == 1 / (1 - stays(F(1, 4)))
        assert value_curve.violations() == []


def test_rows_of_floats_have_a_curve_of_the_discount() -> None:
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


@settings(max_examples=10)
@given(rows=models(discounts=(F(1, 2),)))
def test_the_last_piece_has_the_best_gain_and_of_these_the_best_bias(rows: Rows) -> None:
    """V = g / (1 - γ) + h + …: its first two terms (Puterman 1994, theorem 10.1.5)."""
    mdp = rows.model()
    optimal = curve(mdp, "discount").pieces[-1].optimal
    pairs = [next(p for p in mdp.pairs_of(s) if optimal[p]) for s in range(mdp.n_states)]
    actions = mdp.pair_action[pairs].tolist()
    chosen = [next(r for r in rows.pairs if r[:2] == (s, a)) for s, a in enumerate(actions)]
    gain, bias = gain_and_bias(chosen)
    assert (gain, bias) == best_average(rows.pairs)
    average = certify(mdp, criterion="average")
    assert tuple(average.value) == gain
    assert average.optimal_pairs[pairs].all()


# ---- one curve, and its views -------------------------------------------------------------------


@pytest.mark.parametrize("name", ["base.anxiety", "reward.assist.prompt", "discount"])
def test_slopes_of_the_curve_are_the_derivatives(name: str) -> None:
    value_curve = curve(TEA, name)
    each = gradient(TEA, names=[name])[name]
    sides = [None if side is None else side.value for side in (each.left, each.right)]
    assert [*value_curve.slope(value_curve.parameter.value)] == sides


def test_at_a_tie_each_side_has_the_better_policy() -> None:
    """Twice one of two gains, p and 1 - p."""

    def build(p: F) -> MDP:
        rows = [(s, a, [(1, s + 1, gain)]) for s in (0, 1) for a, gain in enumerate((p, 1 - p))]
        return MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])])

    family = lone(build, HALF, 0)
    value_curve, each = curve(family, "p"), gradient(family)["p"]
    assert value_curve.slope("1/2") == (each.left.value, each.right.value) == (-2, 2)
    assert (value_curve.slope(0), value_curve.slope(1)) == ((None, -2), (2, None))
    assert gradient(family, policy=[0, 1, 0])["p"].value.value == 0


def test_components_change_no_claim() -> None:
    """What is earned in parts is known as well as what is earned at once."""
    parts = PUTERMAN.with_(components={"a": [1, 2, 0], "b": [4, 8, -1]})
    for name in ("p", "gain", "discount"):
        one, two = (moving(mdp, {"p": [(0, 0)]}, {"gain": 10}) for mdp in (PUTERMAN, parts))
        assert curve(one, name).claim == curve(two, name).claim == "certified"
        assert thresholds(one, name).claim == thresholds(two, name).claim == "certified"
        assert gradient(one)[name] == gradient(two)[name]
    assert two.at({"p": "1/3"}).component_names == ("a", "b")
    assert two.at({"gain": 9}).component_names == ("reward",)  # nobody says which part has moved


def test_every_model_of_a_threshold_is_made_once() -> None:
    made: list[Fraction] = []

    def build(p: F) -> MDP:
        made.append(p)
        rows = [(0, 0, [(p, 1, 1), (1 - p, 0, 0)]), (0, 1, [(1, 1, F(3, 4))])]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], "9/10")

    family = lone(build, HALF, 0)
    for _ in range(2):
        made.clear()
        assert len(thresholds(family, "p", (F(1, 10), F(3, 4))).found) == 1
        assert len(made) == len(set(made))


def test_howards_taxicab_at_every_discount() -> None:
    """Howard (1960), chapter 4: the stand in every town, at discount 1 and at those near to it."""
    mdp = of_case(BY_NAME["howard-taxicab"])
    by_discount = curve(mdp, "discount")
    assert by_discount.violations() == []
    assert by_discount.pieces[-1].optimal[[mdp.pair(s, 1) for s in range(3)]].all()
    last = by_discount.pieces[-1].value
    gain = sum(c for c in last.numerator) / -sum(k * c for k, c in enumerate(last.denominator))
    assert gain == certify(mdp, criterion="average").value[0]  # the residue at 1


def test_the_forest_switches_where_two_of_its_policies_are_equal() -> None:
    # pymdptoolbox src/tests/test_PolicyIteration.py: values at 0.9 and 0.96, never cut
    value_curve = curve(forest("1/2"), "discount", (0, "99/100"))
    assert (value_curve.at("9/10"), value_curve.at("24/25")) == (F("26.244"), F("74.6496"))
    assert value_curve.violations() == []
    # Waiting in the middle is worth it from γ on where 9/10 (1 + 9/10 γ …) pays for the cut's 1:
    # 1 + γ V_0 = γ (V_0 / 10 + 9/10 V_2), with V_2 = 4 + γ (V_0 / 10 + 9/10 V_2).
    for at, sign in zip(value_curve.pieces[-2].high, (1, -1), strict=True):
        mdp = forest("1/2").with_(discount=at)
        value = certify(mdp).value
        gain = 1 + at * value[0] - at * (value[0] / 10 + F(9, 10) * value[2])
        assert gain * sign >= 0
    assert value_curve.pieces[-1].optimal[[mdp.pair(s, 0) for s in range(3)]].all()


@pytest.mark.parametrize(
    ("limit", "most", "name", "message"),
    [
        ("LARGEST", 1, "gain", "2 states with cycles among them(.|\n)*at most 1 state"),
        ("CYCLIC_DEGREE", 0, "p", "2 states on cycles(.|\n)*degree 1(.|\n)*up to degree 0;"),
    ],
)
def test_the_limit_that_was_hit_is_named(
    limit: str, most: int, name: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [(s, a, [("1/2", 0, 1), ("1/2", 1, a)]) for s in (0, 1) for a in (0, 1)]
    family = moving(MDP.from_outcomes(rows, "9/10"), {"p": [(0, 1)]}, {"gain": 1})
    assert curve(family, name).pieces
    monkeypatch.setattr(f"exact_mdp.analysis.vary.curves.walk.{limit}", most)
    with pytest.raises(ModelError, match=message):
        curve(family, name)
