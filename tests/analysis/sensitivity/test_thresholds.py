"""Thresholds against closed forms and a fine scan by an independent model."""

from fractions import Fraction
from itertools import pairwise, product

import pytest
from care_oracle import END, Oracle, oracle_of
from cases.puterman import two_state

from exact_mdp import MDP, Family, Parameter, Scenario, thresholds

F = Fraction
SMALL = {"tasks": [1], "max_trial": 2}
WIDTH = F(1, 10**12)


def test_puterman_leaves_at_ten_elevenths() -> None:
    case = two_state(F(1, 2))
    rows = [(s, a, [(p, t, r) for t, p in row.items()]) for s, a, r, row in case.pairs]
    switches = thresholds(MDP.from_outcomes(rows, F(1, 2)), "discount", (0, F(999, 1000)))
    (one,) = switches.found
    assert one.low <= F(10, 11) <= one.high
    assert one.high - one.low <= WIDTH
    (switch,) = one.switches
    assert (switch.state, switch.before, switch.after) == (0, ("1",), ("0",))
    assert switches.stable() == (0, one.low)
    assert switches.radius == one.low - F(1, 2)


@pytest.mark.parametrize(
    ("name", "bounds", "readings"),
    [
        ("assistance.directive.confusion.persistence", (F(1, 2), 1), {}),
        ("reward.anger", (-2, 0), {"skip_onset": "base"}),
        ("influence.disengagement.anger", (0, 1), {"influence_on_present": "additive"}),
        (
            "base.confusion",
            (0, 1),
            {"skip_onset": "base", "influence_orientation": "column-to-row"},
        ),
        ("discount", ("1/10", 1), {"skip_timestep": "own"}),
    ],
)
def test_care_model_against_a_scan_of_an_independent_model(name, bounds, readings) -> None:
    own = Scenario.load("yuan2025").with_(readings=readings, **SMALL)
    mdp = own.compile()
    switches = thresholds(own, name, bounds)
    low, high = switches.curve.range.low, switches.curve.range.high
    labels = {state: mdp.space.label(state) for state in range(mdp.n_states)}

    def best(value: Fraction) -> dict[str, frozenset[str]]:
        oracle = oracle_of(own, {name: value})
        return {
            labels[number_of(mdp, state)]: oracle.optimal_actions(state)
            for state in every_state(oracle)
        }

    cuts = [t for t in switches.found if not t.touch]
    grid = [low + (high - low) * F(2 * k + 1, 12) for k in range(6)]
    answers = [best(value) for value in grid]
    for (left, one), (right, two) in pairwise(zip(grid, answers, strict=True)):
        inside = [t for t in cuts if left < t.low and t.high < right]
        moved = {s for s in one if one[s] != two[s]}
        assert moved <= {switch.label for t in inside for switch in t.switches}
        for label in moved:
            own_switches = [s for t in inside for s in t.switches if s.label == label]
            assert set(own_switches[0].before) == one[label]
            assert set(own_switches[-1].after) == two[label]
        if not inside:
            assert one == two
    for threshold in switches.found:
        assert threshold.high - threshold.low <= WIDTH


def number_of(mdp: MDP, state) -> int:
    k, t, _, s = state
    place = {"subtask": k, "trial": t, "status": int("".join(map(str, s)), 2)}
    return mdp.space.index(**place)


def every_state(oracle: Oracle):
    for t, s in product(range(oracle.trials), product((0, 1), repeat=4)):
        state = (0, t, 1, s)
        if state != END and len(oracle.actions(state)) > 1:
            yield state


def choice(p: Fraction, *rewards: Fraction) -> MDP:
    rows = [(0, action, [(1, 1, value)]) for action, value in enumerate(rewards)]
    return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])


def lone(build, degree: int = 1, breaks=()) -> Family:
    parameter = Parameter(name="p", value=F(1, 2), low=F(0), high=F(1))
    return Family(
        parameters=(parameter,),
        build=lambda at: build(at["p"]),
        degrees={"p": degree},
        breaks={"p": breaks},
    )


def test_a_touching_root_changes_nothing_but_is_told() -> None:
    family = lone(lambda p: choice(p, F(0), -((p - F(1, 3)) ** 2)), degree=2)
    switches = thresholds(family, "p", (0, 1))
    (touch,) = switches.found
    assert touch.touch
    assert touch.low <= F(1, 3) <= touch.high
    assert switches.stable() == (0, 1)


def test_two_thresholds_closer_than_the_bracket_are_both_found() -> None:
    tiny = F(1, 10**15)
    family = lone(lambda p: choice(p, F(0), (p - F(1, 3)), 2 * (p - F(1, 3)) - tiny))
    switches = thresholds(family, "p", (0, 1))
    assert [t.switches[0].before + t.switches[0].after for t in switches.found] == [
        ("0", "1"),
        ("1", "2"),
    ]
    assert switches.found[0].high <= F(1, 3) + tiny <= switches.found[1].high


def test_three_actions_that_cross_at_one_point() -> None:
    third = F(1, 3)
    family = lone(lambda p: choice(p, F(0), p - third, 2 * (p - third)))
    (one,) = thresholds(family, "p", (0, 1)).found
    assert (one.switches[0].before, one.switches[0].after) == (("0",), ("2",))


def test_a_tie_today_has_radius_zero_and_identical_actions_stay_tied() -> None:
    family = lone(lambda p: choice(p, F(1, 2), p, p))
    switches = thresholds(family, "p", (F(1, 4), F(3, 4)))
    (one,) = switches.found
    assert one.switches[0].after == ("1", "2")
    assert switches.stable() == (F(1, 2), F(1, 2))
    assert switches.radius == 0


def test_a_switch_at_a_breakpoint() -> None:
    half = F(1, 2)
    family = lone(lambda p: choice(p, F(0), max(F(0), p - half) - F(0)), breaks=(half,))
    (one,) = thresholds(family, "p", (0, 1)).found
    assert one.low == half
    assert one.high - half <= WIDTH
    assert (one.switches[0].before, one.switches[0].after) == (("0", "1"), ("1",))
