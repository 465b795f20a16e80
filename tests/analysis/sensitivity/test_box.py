"""The shared box of parameters: bounds of a policy and of its gradient, and exact extremes."""

from collections.abc import Iterator
from fractions import Fraction

import numpy as np
import pytest
from forest import burning
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp.analysis.sensitivity.ranges import Range
from exact_mdp.analysis.sensitivity.robust.affine import Forms, mixed
from exact_mdp.analysis.sensitivity.robust.box import box_extreme, box_optimum, box_ranges
from exact_mdp.analysis.sensitivity.robust.care import BoxBounds, CareBox
from exact_mdp.mdp import MDP, ModelError, Policy, Scenario
from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.care.tables import READINGS
from exact_mdp.mdp.parametric import Family, moving
from exact_mdp.mdp.parametric.parameter import Parameter
from exact_mdp.solvers import evaluate, solve
from exact_mdp.solvers.values.policy_chain import PolicyChain

SMALL = {"tasks": [1, 1], "max_trial": 2}
F = Fraction
HALF = F(1, 2)
YUAN = Scenario.load("yuan2025")
FOREST = burning("9/10")


def value_at(scenario: Scenario, weights: np.ndarray, point: dict[str, Fraction]) -> float:
    return evaluate(scenario.with_(parameters=point).compile(), weights).mean


def corners(ranges: dict[str, Range], number: int, seed: int) -> Iterator[dict[str, Fraction]]:
    """Yield random corners of a box."""
    rng = np.random.default_rng(seed)
    for _ in range(number):
        ends = rng.integers(0, 2, len(ranges)).tolist()
        yield {
            name: span.high if end else span.low
            for (name, span), end in zip(ranges.items(), ends, strict=True)
        }


@settings(max_examples=6)
@given(
    readings=st.fixed_dictionaries({name: st.sampled_from(o) for name, o in READINGS.items()}),
    discount=st.sampled_from(["1", "19/20", "1/2"]),
    seed=st.integers(0, 99),
    relative=st.sampled_from(["1/1000", "1/5"]),
    rewards=st.booleans(),
)
def test_bounds_hold_at_points_of_the_box(readings, discount, seed, relative, rewards) -> None:
    scenario = YUAN.with_(readings=readings, discount=discount, **SMALL)
    box = box_ranges(scenario, relative=relative)
    if rewards:
        box |= box_ranges(scenario, {"reward.anger": (-7, -2), "reward.assist.directive": (-9, 0)})
    rng = np.random.default_rng(seed)
    mdp = scenario.compile()
    table = rng.dirichlet(np.ones(4), 16)
    weights = PolicyChain.of(mdp, Policy.of(mdp, "random")).chosen.copy()
    free = ~mdp.forced[mdp.pair_state]
    status = np.maximum(mdp.space.values("status"), 0)
    weights[free] = table[status[mdp.pair_state[free]], mdp.pair_action[free]]
    model = CareBox(scenario, weights, list(box))
    low, high = ({n: getattr(span, end) for n, span in box.items()} for end in ("low", "high"))
    found = model.bounds(low, high)
    for point in corners(box, 2, seed):
        inside = {
            n: low[n] + (point[n] - low[n]) * Fraction(int(rng.integers(1, 8)), 8) for n in box
        }
        for at in (point, inside):
            assert found.low <= value_at(scenario, weights, at) <= found.high
        name = str(rng.choice(list(box)))  # one derivative, by a difference of exact values
        step = (high[name] - low[name]) / 10**6
        before, after = dict(inside), dict(inside)
        after[name] = min(high[name], inside[name] + step)
        before[name] = after[name] - step
        rise = value_at(scenario, weights, after) - value_at(scenario, weights, before)
        below, above = found.slopes[name]
        room = 1e-9 / float(step)
        assert below - room <= rise / float(step) <= above + room
    there = model.bounds(low, low)
    assert there.low <= value_at(scenario, weights, low) <= there.high
    assert there.high - there.low < 1e-8


@pytest.mark.parametrize(
    "policy, side",
    [("optimal", "worst"), ("always:directive", "best"), ("random", "worst"), ("random", "best")],
)
def test_the_extreme_of_a_small_box_against_a_grid(policy: str, side: str) -> None:
    ranges = {
        "base.anger": (0, "1/5"),
        "persistence.confusion": ("1/2", 1),
        "skip.confusion.alone": (0, "2/5"),
    }
    scenario = YUAN.with_(**SMALL)
    found = box_extreme(scenario, policy, ranges, side=side, gap=1e-4)
    assert found.gap <= 1e-4
    mdp = scenario.compile()
    weights = PolicyChain.of(mdp, solve(mdp) if policy == "optimal" else policy).chosen
    spans = box_ranges(scenario, ranges)
    grid = [[s.low + (s.high - s.low) * k / 2 for k in range(3)] for s in spans.values()]
    values = [
        value_at(scenario, weights, dict(zip(spans, (a, b, c), strict=True)))
        for a in grid[0]
        for b in grid[1]
        for c in grid[2]
    ]
    extreme = min(values) if side == "worst" else max(values)
    if side == "worst":
        assert found.low - 1e-9 <= extreme
    else:
        assert extreme <= found.high + 1e-9
    reached = value_at(scenario, weights, dict(found.point))
    assert reached == pytest.approx(float(found.reached), abs=1e-9)
    assert found.low - 1e-9 <= reached <= found.high + 1e-9


def test_the_worst_case_of_the_care_models_optimum_is_exact() -> None:
    found = box_extreme(YUAN, "optimal")
    assert found.proven
    assert found.gap == 0
    assert len(found.point) == 32
    assert "open" not in found.signs.values()
    weights = PolicyChain.of(YUAN.compile(), solve(YUAN.compile())).chosen
    sampled = [value_at(YUAN, weights, c) for c in corners(box_ranges(YUAN), 20, seed=3)]
    assert float(found.value.value) < min(sampled)


def test_the_best_policy_against_the_box() -> None:
    scenario = YUAN.with_(**SMALL)
    found = box_optimum(scenario, candidates={"never help": "always:none"})
    assert found.gap <= 1e-3
    assert found.low <= found.high
    for each in found.candidates.values():
        assert each.low <= found.high
    for point in corners(box_ranges(scenario), 10, seed=1):  # no optimum is below the floor
        assert solve(scenario.with_(parameters=point).compile()).start_value >= found.low - 1e-9


@pytest.mark.parametrize("readings", [{}, {"skip_timestep": "own", "status_cost": "current"}])
def test_the_whole_box_stays_within_what_steps_can_earn(readings: dict[str, str]) -> None:
    scenario = YUAN.with_(readings=readings)
    family, mdp = ScenarioFamily(scenario=scenario), scenario.compile()
    box = {p.name: (0, 1) for p in family.parameters if (p.low, p.high) == (0, 1)}
    box.pop("discount")
    held = solve(mdp)
    steps = sum(scenario.tasks) * (scenario.trials + 1)  # at most, a skip in its own step included
    gains = mdp.table.gains()
    found = {side: box_extreme(scenario, held, box, side=side) for side in ("worst", "best")}
    assert steps * gains.min() <= found["worst"].low <= found["worst"].high
    assert found["best"].low <= found["best"].high <= steps * gains.max()
    for side in found.values():  # and more than that: both ends are reached
        assert side.gap < 1e-6
        value = value_at(scenario, PolicyChain.of(mdp, held).chosen, dict(side.point))
        assert value == pytest.approx(float(side.reached), abs=1e-9)


def test_a_box_of_width_0_is_the_tables_as_they_are() -> None:
    scenario = YUAN.with_(**SMALL)
    box = box_ranges(scenario, relative=0)
    found, optimum = box_extreme(scenario, "optimal", box), box_optimum(scenario, box)
    today = solve(scenario.compile()).start_value
    assert (found.proven, optimum.saddle) == (True, True)
    assert float(found.reached) == pytest.approx(today, abs=1e-9)
    assert set(found.signs.values()) == {"none"}
    assert len(box) == 32


def test_a_search_that_gets_no_further_ends_early(monkeypatch: pytest.MonkeyPatch) -> None:
    def loose(self: CareBox, low: dict[str, Fraction], high: dict[str, Fraction]) -> BoxBounds:
        return BoxBounds(low=-1e6, high=1e6, slopes=dict.fromkeys(low, (-1.0, 1.0)))

    monkeypatch.setattr(CareBox, "bounds", loose)
    box = {"base.anger": (0, 1), "persistence.confusion": (0, 1)}
    found = box_extreme(YUAN.with_(tasks=[1], max_trial=1), "optimal", box, parts=80)
    assert 20 < found.parts < 25
    assert found.low == -1e6
    assert not found.proven


def test_a_published_model_with_a_parameter() -> None:
    ranges = {"fire": ("1/20", "3/10")}
    worst = box_extreme(FOREST, "optimal", ranges)
    right = solve(FOREST.at({"fire": "3/10"})).start_value  # waiting stays optimal there
    assert worst.low - 1e-9 <= right <= worst.high + 1e-9
    assert worst.gap < 1e-6
    assert str(worst.point["fire"]) == "3/10"
    assert str(box_extreme(FOREST, "optimal", ranges, side="best").point["fire"]) == "1/20"
    found = box_optimum(FOREST, ranges)
    assert found.gap < 1e-6
    assert found.low == pytest.approx(right, abs=1e-6)
    near = box_extreme(FOREST, "optimal", {"fire": ("9/100", "11/100")})
    assert near.proven
    assert near.signs == {"fire": "falling"}


def test_two_parameters_of_a_model_with_cycles_against_a_grid() -> None:
    stay = [["1/2", "1/4", "1/4", 0], ["1/5", "1/2", "1/5", "1/10"], ["1/4", "1/4", "1/4", "1/4"]]
    mdp = MDP.from_arrays([[*stay, [0, 0, 0, 1]]], [[1], [-2], [3], [0]])
    family = moving(mdp, {"p": [(0, 1)], "q": [(1, 3)]})
    ranges = {"p": ("1/10", "1/2"), "q": ("1/20", "3/10")}
    for side, pick in (("worst", min), ("best", max)):
        found = box_extreme(family, "optimal", ranges, side=side, gap=1e-3, parts=200)
        values = [
            evaluate(family.at({"p": F(2 + k, 20), "q": F(1 + m, 20)}), [0, 0, 0, 0]).mean
            for k in range(9)
            for m in range(6)
        ]
        assert found.gap <= 1e-3
        assert found.low - 1e-9 <= pick(values) <= found.high + 1e-3


def test_rows_that_are_not_affine_are_refused() -> None:
    def build(at):
        p, q = at["p"], at["q"]
        return MDP.from_arrays([[[p * q, 1 - p * q], [0, 1]]], [1, 0])

    half = Fraction(1, 2)
    names = [Parameter(name=n, value=half, low=F(0), high=F(1)) for n in "pq"]
    with pytest.raises(ModelError, match="affine"):
        box_extreme(Family(parameters=tuple(names), build=build), "optimal")


@pytest.mark.parametrize(
    "p, q, r",
    [
        (1, F(1, 2), F(3, 5)),  # seen at the low corner alone
        (0, 0, F(3, 5)),  # at the high one
        (0, 1, F(3, 5)),  # at the one that crosses
        (1, 0, F(1, 2)),  # inside
    ],
)
def test_rows_that_are_affine_at_all_points_but_one_are_refused(p, q, r) -> None:
    """(x - p) (y - q) (z - r) is 0, as from today, at three of the points that are looked at."""

    def build(at):
        x = HALF + (at["x"] - p) * (at["y"] - q) * (at["z"] - r) / 4
        return MDP.from_arrays([[[x, 1 - x], [0, 1]]], [1, 0], discount="9/10")

    today = {"x": F(p), "y": F(q), "z": F(1, 4)}
    names = [Parameter(name=n, value=v, low=F(0), high=F(1)) for n, v in today.items()]
    family = Family(parameters=tuple(names), build=build)
    with pytest.raises(ModelError, match="affine in the parameters together"):
        box_extreme(family, "optimal", dict.fromkeys("xyz", (0, 1)))


@given(st.integers(0, 9999))
def test_affine_forms_hold_their_numbers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.integers(-6, 6)
    forms = [Forms.of(rng.normal() * size, rng.normal(size=3), abs(rng.normal())) for _ in "ab"]
    chance = Forms.of(np.array(0.5), rng.uniform(-0.1, 0.1, 3), np.array(0.1))
    for _ in range(5):
        unknown = rng.uniform(-1, 1, 3)
        a, b, p = (
            f.centre + f.slope @ unknown + f.rest * rng.uniform(-1, 1) for f in (*forms, chance)
        )
        for form, number in (
            (forms[0] + forms[1], a + b),
            (forms[0] - forms[1], a - b),
            (forms[0].scaled(2.5), 2.5 * a),
            (mixed(*forms, chance), (1 - p) * a + p * b),
        ):
            assert form.low <= number <= form.high
            assert abs(number - form.centre) <= form.radius * (1 + 1e-12)


@given(st.integers(0, 9999))
def test_a_form_wider_than_its_interval_is_replaced_by_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = rng.normal(size=4) * 10.0 ** rng.integers(-3, 3)
    high = low + rng.uniform(0.1, 1, 4)
    size = 10.0 ** rng.integers(-3, 9, 4)
    slope = rng.normal(size=(4, 2))
    number = rng.uniform(low, high)
    unknown = rng.uniform(-1, 1, 2)
    centre = number - slope @ unknown  # the number lies within the form, and in the interval
    form = Forms.of(centre, slope, size, (low, high))
    assert (form.rest <= np.minimum(size, 0.51 * (high - low))).all()
    assert (np.abs(number - form.centre - form.slope @ unknown) <= form.rest * (1 + 1e-9)).all()
    for each in (form.scaled(3.0) - form.scaled(2.0), mixed(form, form, form.scaled(0.0))):
        assert (each.low <= number).all()
        assert (number <= each.high).all()
        assert (np.abs(number - each.centre) <= each.radius * (1 + 1e-9)).all()
        assert (each.rest <= 3 * (high - low) + 1e-9).all()


@pytest.mark.parametrize(
    "ranges",
    [
        {},
        {"base.angr": (0, 1)},
        {"discount": ("1/2", 1)},
        {"base.anger": (1, 0)},
        {"base.anger": (0, 2)},
    ],
)
def test_what_is_no_box_is_refused(ranges: dict[str, object]) -> None:
    with pytest.raises(ModelError):
        box_extreme(YUAN, "optimal", ranges)
    with pytest.raises(ModelError):
        box_extreme(YUAN, "optimal", side="middle")
