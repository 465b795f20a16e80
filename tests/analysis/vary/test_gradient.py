"""Derivatives of the start value: against differences of an independent model, and closed forms."""

from fractions import Fraction

import pytest
from care_oracle import ACTIONS, END, State, oracle_of
from made_models import burning

from exact_mdp import MDP, Family, Scenario, gradient, parametric

F = Fraction
H = F(1, 10**5)
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
    "base.anger", "base.forgetfulness", "persistence.confusion", "influence.confusion.anger",
    "influence.disengagement.confusion", "assistance.directive.confusion.persistence",
    "skip.anger.persistence", "skip.confusion.with-other", "reward.anger", "reward.subtask-skip",
    "reward.assist.directive", "discount",
]  # fmt: skip
EVENLY = {ACTIONS[2]: F(1, 2), ACTIONS[3]: F(1, 2)}


def scenario(readings: dict[str, str], discount: object = "19/20") -> Scenario:
    whole = Scenario.load("yuan2025")
    return whole.with_(readings=readings, discount=discount, tasks=[1], max_trial=2)


def value(
    own: Scenario, name: str, step: Fraction, shares: dict[str, Fraction] | None = None
) -> Fraction:
    """Return the independent model's optimum, or what drawn actions earn, a step from today."""
    oracle = oracle_of(own, {name: {**own.values(), "discount": own.discount}[name] + step})
    if shares is None:
        return oracle.value(oracle.start)

    def drawn(state: State) -> dict[str, Fraction]:
        return {"skip": F(1)} if "skip" in oracle.actions(state) else shares

    return oracle.evaluate(drawn, distribution=False)["mean"]


@pytest.mark.parametrize("shares", [None, EVENLY], ids=["optimum", "policy"])
@pytest.mark.parametrize("number", range(len(READINGS)))
def test_derivatives_are_the_limits_of_differences(
    number: int, shares: dict[str, Fraction] | None
) -> None:
    own, names = scenario(READINGS[number]), NAMES[number::4]
    policy = dict.fromkeys([f"{status:04b}" for status in range(16)], shares)
    slopes = gradient(own, names=names, policy=policy if shares else "optimal")
    for name in names:
        each = slopes[name]
        assert each.value == each.left == each.right is not None
        expected = (value(own, name, H, shares) - value(own, name, -H, shares)) / (2 * H)
        assert float(each.value.value) == pytest.approx(float(expected), abs=1e-7, rel=1e-7)


def test_at_the_end_of_a_range_there_is_one_side() -> None:
    own = scenario({}, F(1))
    slopes = gradient(own, names=["discount", "assistance.directive.confusion.onset"])
    assert slopes["discount"].right is None
    v0, v1, v2 = (value(own, "discount", -k * H) for k in range(3))
    expected = float((3 * v0 - 4 * v1 + v2) / (2 * H))
    assert float(slopes["discount"].left.value) == pytest.approx(expected, abs=1e-4)
    assert slopes["assistance.directive.confusion.onset"].left is None


def test_a_chance_that_is_cut_off_at_1_has_two_sides() -> None:
    own = scenario({"influence_on_present": "additive"}).with_(
        parameters={"persistence.anger": "4/5", "influence.disengagement.anger": "1/5"}
    )
    each = gradient(own, policy="always:none", names=["persistence.anger"])["persistence.anger"]
    assert each.value is each.elasticity is None
    here, low, high = (
        value(own, "persistence.anger", step, {ACTIONS[0]: F(1)}) for step in (F(0), -H, H)
    )
    for side, expected in ((each.left, (here - low) / H), (each.right, (high - here) / H)):
        assert float(side.value) == pytest.approx(float(expected), abs=1e-2)
    assert F(4, 5) in parametric(own).breakpoints("persistence.anger")


def test_published_model_with_cycles() -> None:
    """Fire in the forest: V(0) by hand, and every row that has the fire moves with it."""
    family, p, g = burning("9/10"), F(1, 10), F(9, 10)

    def by_hand(p: Fraction, g: Fraction) -> Fraction:
        # wait for ever: v2 = 4 + g (p v0 + (1 - p) v2), v1 and v0 likewise without reward
        ahead = g * (1 - p)
        return ahead**2 * 4 / ((1 - ahead) * (1 - g * p * (1 + ahead)) - g * p * ahead**2)

    slopes, floats = gradient(family), gradient(family, exact=False)
    assert slopes.start_value == by_hand(p, g)
    for name, ends in (
        ("fire", (by_hand(p + H, g), by_hand(p - H, g))),
        ("discount", (by_hand(p, g + H), by_hand(p, g - H))),
    ):
        slope = pytest.approx(float((ends[0] - ends[1]) / (2 * H)), rel=1e-5)
        assert float(slopes[name].value.value) == slope
        assert floats[name].value.value == slope


def test_frames_say_units_and_whether_the_policy_is_fixed() -> None:
    frame = gradient(scenario({}), policy="random", names=NAMES).frame()
    assert set(frame["unit"]) == {"probability", "reward", "per step"}
    assert set(frame["policy"]) == {"fixed"}
    assert END not in frame["parameter"].tolist()
    assert not frame.drop(columns=["left", "right"]).isna().any(axis=None)


@pytest.mark.parametrize("exact", [True, False])
def test_the_derivative_of_an_end_that_begins_to_earn(*, exact: bool) -> None:
    """V = θ (γ + γ² + …), so that dV/dθ = γ / (1 - γ) = 9."""
    family = Family(
        parameters={"theta": 0},
        build=lambda at: MDP.from_arrays([[[0, 1], [0, 1]]], [[0], [at["theta"]]], discount="9/10"),
    )
    found = gradient(family, exact=exact)["theta"].value
    assert found is not None
    assert float(found.value) == pytest.approx(9, abs=1e-9)
