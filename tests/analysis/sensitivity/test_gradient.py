"""Derivatives of the start value: against differences of an independent model, and closed forms."""

from fractions import Fraction

import numpy as np
import pytest
from care_oracle import ACTIONS, END, Oracle, State, oracle_of
from made_models import burning

from exact_mdp import MDP, Family, ModelError, Parameter, Scenario, gradient, parametric

F = Fraction
H = F(1, 10**4)
NEAR_1 = F(19, 20)
SMALL = {"tasks": [1], "max_trial": 2}
READINGS = [
    {},
    {"influence_on_present": "additive", "status_cost": "current", "skip_onset": "base"},
    {
        "skip_timestep": "own",
        "influence_orientation": "column-to-row",
        "trial_cost": "failed-trials",
    },
    {"skip_onset": "reset", "task_bonus": "no-subtask-skipped", "max_trial_rule": "after"},
]
NAMES = [
    "base.anger",
    "base.forgetfulness",
    "persistence.confusion",
    "influence.confusion.anger",
    "influence.disengagement.confusion",
    "assistance.directive.confusion.persistence",
    "skip.anger.persistence",
    "skip.confusion.with-other",
    "reward.anger",
    "reward.subtask-skip",
    "reward.assist.directive",
    "discount",
]


def scenario(readings: dict[str, str], discount: Fraction = NEAR_1) -> Scenario:
    return Scenario.load("yuan2025").with_(readings=readings, discount=discount, **SMALL)


def oracle_at(scenario: Scenario, name: str, step: Fraction) -> Oracle:
    now = {**scenario.values(), "discount": scenario.discount}
    return oracle_of(scenario, {name: now[name] + step})


def difference(scenario: Scenario, name: str) -> float:
    """Central, of the independent model's optimum."""
    above, below = (oracle_at(scenario, name, step) for step in (H, -H))
    return float((above.value(above.start) - below.value(below.start)) / (2 * H))


@pytest.mark.parametrize("number", range(len(READINGS)))
def test_derivatives_are_the_limits_of_differences(number: int) -> None:
    own = scenario(READINGS[number])
    names = NAMES[number::4]
    slopes = gradient(own, names=names)
    for name in names:
        each = slopes[name].value
        assert each is not None
        assert slopes[name].left == slopes[name].right == each
        assert float(each.value) == pytest.approx(difference(own, name), abs=1e-4, rel=1e-6)


def test_at_the_end_of_a_range_there_is_one_side() -> None:
    own = scenario({}, F(1))
    slopes = gradient(own, names=["discount", "assistance.directive.confusion.onset"])
    assert slopes["discount"].right is None
    assert slopes["discount"].left is not None
    at = (oracle_at(own, "discount", -k * H) for k in range(3))
    v0, v1, v2 = (oracle.value(oracle.start) for oracle in at)
    expected = float((3 * v0 - 4 * v1 + v2) / (2 * H))
    assert float(slopes["discount"].left.value) == pytest.approx(expected, abs=1e-4)
    assert slopes["assistance.directive.confusion.onset"].left is None


def test_a_chance_that_is_cut_off_at_1_has_two_sides() -> None:
    own = scenario({"influence_on_present": "additive"}).with_(
        parameters={"persistence.anger": "4/5", "influence.disengagement.anger": "1/5"}
    )
    slopes = gradient(own, policy="always:none", names=["persistence.anger"])

    def value(step: Fraction) -> Fraction:
        oracle = oracle_at(own, "persistence.anger", step)
        return oracle.evaluate(unassisted, distribution=False)["mean"]

    each = slopes["persistence.anger"]
    assert each.left is not None
    assert each.right is not None
    assert each.value is None
    assert each.elasticity is None
    for sign, side in ((-1, each.left), (1, each.right)):
        expected = (value(sign * H) - value(F(0))) / (sign * H)
        assert float(side.value) == pytest.approx(float(expected), abs=1e-2)
    assert F(4, 5) in parametric(own).breakpoints("persistence.anger")


def unassisted(state: State) -> dict[str, Fraction]:
    return {ACTIONS[0]: F(1)}


def twin(p: Fraction) -> MDP:
    """Two ways out that are worth the same at p = 1/2: p + 1 and 2 - p; and then a repetition."""
    rows = [
        (0, 0, [(p, 1, 2), (1 - p, 1, 1)] if 0 < p < 1 else [(1, 1, 1 + p)]),
        (0, 1, [(1, 1, 2 - p)]),
        (1, 0, [(1, 2, 1 + p)]),
        (1, 1, [(1, 2, 2 - p)]),
        (2, 0, [(1, 2, 0)]),
    ]
    return MDP.from_outcomes(rows)


def test_at_a_tie_each_side_has_the_better_policy() -> None:
    p = Parameter(name="p", value=F(1, 2), low=F(0), high=F(1))
    family = Family(parameters=(p,), build=lambda at: twin(at["p"]))
    slope = gradient(family)["p"]
    assert slope.left is not None
    assert slope.right is not None
    assert (slope.left.value, slope.right.value) == (-2, 2)
    with pytest.raises(ModelError, match="several actions are optimal"):
        gradient(family, exact=False)
    fixed = gradient(family, policy=np.array([0, 1, 0]))["p"]
    assert fixed.value is not None
    assert fixed.value.value == 0


def test_floats_agree_within_their_bounds() -> None:
    own = scenario({})
    exact, bounded = gradient(own, names=NAMES), gradient(own, names=NAMES, exact=False)
    for name in NAMES:
        truth, near = exact[name].value, bounded[name].value
        assert truth is not None
        assert near is not None
        assert abs(F(near.value) - F(truth.value)) <= F(near.error)
        assert near.error < 1e-8


def test_published_model_with_cycles() -> None:
    """Fire in the forest: V(0) by hand, and every row that has the fire moves with it."""
    family = burning("9/10")
    slopes = gradient(family)

    def value(p: Fraction, g: Fraction) -> Fraction:
        # wait for ever: v2 = 4 + g (p v0 + (1 - p) v2), v1 and v0 likewise without reward
        ahead = g * (1 - p)
        return ahead**2 * 4 / ((1 - ahead) * (1 - g * p * (1 + ahead)) - g * p * ahead**2)

    p, g = F(1, 10), F(9, 10)
    assert slopes.start_value == value(p, g)
    for name, slope in (
        ("fire", (value(p + H, g) - value(p - H, g)) / (2 * H)),
        ("discount", (value(p, g + H) - value(p, g - H)) / (2 * H)),
    ):
        each = slopes[name].value
        assert each is not None
        assert float(each.value) == pytest.approx(float(slope), rel=1e-5)
    floats = gradient(family, exact=False)["fire"].value
    assert floats is not None
    assert floats.value == pytest.approx(
        float((value(p + H, g) - value(p - H, g)) / (2 * H)), rel=1e-5
    )


# ---- a fixed policy --------------------------------------------------------------------------


def fixed(state: State) -> dict[str, Fraction]:
    assert not isinstance(state, str)
    return {"skip": F(1)} if state[1] == 2 else {ACTIONS[2]: F(1, 2), ACTIONS[3]: F(1, 2)}


@pytest.mark.parametrize("readings", READINGS[1:3])
def test_derivatives_of_a_fixed_policy(readings: dict[str, str]) -> None:
    own = scenario(readings)
    names = ["base.anger", "influence.confusion.anger", "reward.subtask-skip", "discount"]
    mdp = own.compile()
    weights = np.where(np.isin(mdp.pair_action, [2, 3]), 0.5, 0.0)
    weights[mdp.forced[mdp.pair_state]] = 1.0
    slopes = gradient(own, policy=weights, names=names)
    step = F(1, 10**5)
    for name in names:
        above, below = (
            oracle_at(own, name, sign * step).evaluate(fixed, distribution=False)["mean"]
            for sign in (1, -1)
        )
        slope = float((above - below) / (2 * step))
        each = slopes[name].value
        assert each is not None
        assert float(each.value) == pytest.approx(slope, rel=1e-7)


def test_frames_say_units_and_whether_the_policy_is_fixed() -> None:
    frame = gradient(scenario({}), policy="random", names=NAMES).frame()
    assert set(frame["unit"]) == {"probability", "reward", "per step"}
    assert set(frame["policy"]) == {"fixed"}
    assert END not in frame["parameter"].tolist()
    assert not frame.drop(columns=["left", "right"]).isna().any(axis=None)


def test_max_trial_moves_in_whole_steps() -> None:
    own = scenario({}, F(1))
    slopes = gradient(own, names=[])
    less, more = slopes.steps["max_trial"]
    values = [
        Oracle({}, [1], trials, F(1), own.values()).value((0, 0, 1, (0, 0, 0, 0)))
        for trials in (1, 2, 3)
    ]
    assert less is not None
    assert (less.value, more.value) == (values[1] - values[0], values[2] - values[1])
