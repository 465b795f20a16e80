"""Points, ranges, bars, maps and the worst corner, against models that are solved one by one."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction as F
from itertools import product
from math import isfinite
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pandas as pd
import pytest
from care_oracle import oracle_of
from made_models import burning, policy_by

from exact_mdp import (
    MDP,
    READINGS,
    Claim,
    Family,
    ModelError,
    Parameter,
    Parametric,
    Scenario,
    certify,
    cost_effectiveness,
    curve,
    evaluate,
    moving,
    one_way,
    parametric,
    psa,
    sobol,
    solve,
    study,
    thresholds,
    tornado,
    two_way,
    worst_point,
)

YUAN = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)


def small(seed: int, discount: object) -> Family:
    """Return a random model of a few states, whose chances move with x; of costs where odd."""
    rng = np.random.default_rng(seed)
    states, sense = int(rng.integers(2, 7)), ("max", "min")[seed % 2]
    shape = (states - 1, 3, 2)
    to, gain = rng.integers(states, size=shape), rng.integers(-3, 4, size=shape)

    def build(at: Any) -> MDP:
        x, end = at["x"], states - 1
        left, rows = (1 - x) / 2, []
        for s, a in np.ndindex(shape[:2]):
            (one, two), (high, low) = to[s, a].tolist(), gain[s, a].tolist()
            rows.append((s, a, [(x, one, high * x), (left, two, 1), (left, end, low)]))
        return MDP.from_outcomes([*rows, (end, 0, [(1, end, 0)])], discount, sense=sense)

    return Family(parameters=(Parameter(name="x", value="1/3", low=0, high=1),), build=build)


def care(seed: int) -> tuple[Parametric, dict[str, Any], list[Any]]:
    """Return any readings, points of all their numbers, and mixed policies that read everything."""
    rng = np.random.default_rng(seed)
    readings = {name: options[rng.integers(len(options))] for name, options in READINGS.items()}
    scenario = YUAN.with_(
        readings=readings, tasks=[2, 1], max_trial=2, discount=["19/20", 1, 0][seed % 3]
    )
    points = {
        name: rng.random(2) if not name.startswith("reward.") else rng.normal(0, 20, 2)
        for name in scenario.names
    }
    points["discount"] = [0.5 + rng.random() / 2, 0.9]
    mdp = scenario.compile()
    shares = rng.dirichlet(np.ones(4), mdp.space.regular)
    shares = np.pad(shares, ((0, 0), (0, mdp.n_actions - 4)))
    policies = [policy_by(mdp, mdp.space.names, shares)] if mdp.n_actions == 4 else []
    return parametric(scenario), points, [*policies, "random", "always:supportive"]


POINTS = {"x": [0.1, "1/3", 0.75]}
MODELS: list[Callable[[], Any]] = [
    *(lambda n=n, rate=rate: (small(n, rate), POINTS, ["random"])
      for n in range(12) for rate in (1, "9/10", "999/1000")),
    lambda: (burning("24/25"), {"fire": [0.05, 0.1, 0.6], "discount": [0.9, 0.96, 0.5]},
             ["always:1"]),
    *(lambda seed=seed: care(seed) for seed in range(14)),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(MODELS)))
def test_points_are_those_solved_one_by_one(number: int) -> None:
    model, points, policies = MODELS[number]()
    table = study(model, points, ["optimal", *policies], n_jobs=2)
    for row, values in enumerate(zip(*points.values(), strict=True)):
        mdp = model.at(dict(zip(points, values, strict=True)))
        best = solve(mdp).start
        assert abs(table.optimal[row] - best.value) <= table.error[row, 0] + best.error
        assert table.regret[row].min() >= 0
        for n, policy in enumerate(policies, 1):
            own = evaluate(mdp, policy).start
            assert abs(table.fixed[row, n] - own.value) <= table.error[row, n + 1] + own.error
            lost = abs(best.value - own.value)
            assert table.regret[row, n] == pytest.approx(lost, abs=1e-8)
        assert table.error[row].max() < 1e-9


def test_points_are_the_numbers_that_were_given() -> None:
    """A float beside a fraction in words stays the float that it is."""
    table = study(small(0, 1), {"x": [0.1, "1/10", 0.5]})
    assert table.points[:, 0].tolist() == [F(0.1), F(1, 10), F(1, 2)]
    assert table.frame()["x"].tolist() == [0.1, 0.1, 0.5]


@pytest.mark.parametrize("last", ["exact", "floats"])
def test_what_is_left_of_a_row_is_shared_in_proportion(last: str) -> None:
    """A row of floats means tenths: the other outcomes share what the named ones leave of 1."""
    given: list[Any] = ["1/10", "1/5", "7/10"] if last == "exact" else [0.1, 0.2, 0.7 - 2.0**-34]
    mdp = MDP.from_arrays([[given, [0, 1, 0], [0, 0, 1]]], [1, 0, 0])
    for named, rest in (({"a": F(1, 4)}, [F(2, 9), F(7, 9)]), ({"a": F(1, 4), "b": F(1, 3)}, [1])):
        family = moving(mdp, {name: [(0, place)] for place, name in enumerate(named)})
        row = [p for p, _, _ in family.at(named).table.row(0)]
        left = 1 - sum(named.values())
        assert row == [*named.values(), *(left * share for share in rest)]


@pytest.mark.parametrize("seed", range(60))
def test_optimal_actions_beside_infinite_states(seed: int) -> None:
    """The actions that lose nothing are those that the exact certificate calls optimal."""
    rng, sign = Random(seed), 1 - 2 * (seed % 2)
    size = rng.randint(3, 5)
    rows = [(0, 0, [(1, size, 2 * sign)]), (size, 0, [(1, size, 0)])]
    for state in range(size):
        for action in range(not state, rng.randint(1, 2) + (not state)):
            to = rng.sample(range(size), rng.randint(1, 2))
            gains = [sign * rng.choice([-2, -1, -1, 0, 1]) for _ in to]
            row = [(F(1, len(to)), t, gain) for t, gain in zip(to, gains, strict=True)]
            rows.append((state, action, row))
    mdp = MDP.from_outcomes(rows, sense="max" if sign > 0 else "min")
    try:
        exact = certify(mdp)
    except ModelError:  # no optimum
        return
    if isfinite(exact.start_value):
        table = study(Family(parameters={"x": 1}, build=lambda _: mdp), {"x": [1]})
        optimal = mdp.by_action(exact.optimal_pairs)[~mdp.forced]
        assert (table.counts == 1).tolist() == optimal.tolist()


# ---- models of draws that differ in more than their numbers --------------------------------------


ILL = MDP.from_outcomes(
    [(0, 0, [("1/2", 0, 1), ("1/2", 1, 1)]), (0, 1, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])],
    states=["ill", "dead"],
    actions=["wait", "leave"],
    labels={"end": [False, True], "all": [True, True]},
)
OTHERS = {
    "numbers of states": MDP.from_arrays([[[1]]], [[1]], "9/10"),
    "names of states": ILL.with_(states=["dead", "ill"]),
    "names of actions": ILL.with_(actions=["leave", "wait"]),
    "states of pairs": ILL.with_(pair_state=np.array([0, 1, 1]), pair_action=np.array([0, 0, 1])),
    "actions of pairs": ILL.with_(pair_action=np.array([0, 1, 1])),
    "senses": ILL.with_(sense="min"),
    "probabilities of the start": ILL.with_(start=1),
    "goals": ILL.until("all"),
}


def either(one: MDP, other: MDP) -> Family:
    """Return a family that is the other model from p = 1/2 on; today it is the first."""
    (p,) = parameters = (Parameter(name="p", value="1/5", low=0, high=1),)
    return Family(parameters=parameters, build=lambda at: other if at[p.name] >= F(1, 2) else one)


@pytest.mark.parametrize("what", OTHERS)
def test_a_model_of_another_form_is_refused_with_its_draw(what: str) -> None:
    family = either(ILL.until("end") if what == "goals" else ILL, OTHERS[what])
    drawn = pd.DataFrame({"p": [0.1, 0.4, 0.625]})
    for call in (
        lambda: study(family, drawn, ["always:wait"]),
        lambda: psa(family, uncertain=drawn, n_jobs=2),
        lambda: tornado(family, ranges={"p": (0, "5/8")}),
        lambda: one_way(family, "p", (0, "5/8"), points=3),
        lambda: sobol(family, ranges={"p": (0, 1)}, n=4, rng=0),
        lambda: cost_effectiveness(
            family, {"wait": [0, 0]}, effect="reward", cost="reward", uncertain=drawn
        ),
    ):
        with pytest.raises(ModelError, match=f"{what} change") as error:
            call()
        assert error.value.where.startswith("draw ")
        assert ", p = " in error.value.where
        assert "return the same states, actions, pairs" in error.value.fix
    with pytest.raises(ModelError, match=f"{what} change\n  where: parameter p = "):
        curve(family, "p", (0, 1))


def test_a_start_over_several_states_may_be_drawn() -> None:
    """How many are ill today, a prevalence, is a number as others are."""

    def build(at: Any) -> MDP:
        return ILL.with_(start={0: at["p"], 1: 1 - at["p"]})

    family = Family(parameters=(Parameter(name="p", value="1/5", low=0, high=1),), build=build)
    table = study(family, {"p": [F(1, 4), F(3, 4), F(1)]}, ["always:wait"])
    assert table.fixed[:, 0].tolist() == pytest.approx([0.5, 1.5, 2])
    assert table.optimal.tolist() == pytest.approx([0.75, 2.25, 3])


@pytest.mark.parametrize("n_jobs", [1, 2])
def test_what_a_users_function_raises_says_at_which_draw(n_jobs: int) -> None:
    def build(at: Any) -> MDP:
        if at["p"] > F(1, 2):
            raise ZeroDivisionError("a division of one's own")
        return ILL

    family = Family(parameters=(Parameter(name="p", value="1/5", low=0, high=1),), build=build)
    with pytest.raises(ZeroDivisionError, match="of one's own") as error:
        study(family, {"p": [0.1, 0.4, 0.625]}, n_jobs=n_jobs)
    assert error.value.__notes__ == ["raised by the model's own function, for draw 2, p = 0.625"]


# ---- ranges --------------------------------------------------------------------------------------


def test_a_range_that_passes_1_by_default_is_warned_of() -> None:
    """A utility may not be 1.02; an open number may, and where a range is stated nobody asks."""
    family = Family(
        parameters={"u": "17/20"}, build=lambda at: MDP.from_arrays([[[1]]], [at["u"]], "1/2")
    )
    analyses = (
        lambda: tornado(family),
        lambda: one_way(family, "u", points=2),
        lambda: sobol(family, n=4),
        lambda: worst_point(family),
    )
    for analyse in analyses:
        match = r'u, 0.85 today, .* to 1.02; .*name="u", .*high=1'
        with pytest.warns(UserWarning, match=match) as caught:
            analyse()
        assert [each.filename for each in caught] == [__file__]
    assert tornado(family, ranges={"u": (0, 1)}).frame()["high"][0] == 1
    assert tornado(family, relative="1/5").frame()["high"][0] == 1.02
    bounded = replace(family, parameters=(Parameter(name="u", value="17/20", low=0, high=1),))
    assert tornado(bounded).frame()["high"][0] == 1


def test_ranges_are_shares_of_today_that_end_where_the_parameter_does() -> None:
    given = (("p", "1/10", 0, 1), ("q", "9/10", 0, 1), ("r", -5, None, None))
    family = Family(
        parameters=[Parameter(name=n, value=v, low=low, high=high) for n, v, low, high in given],
        build=lambda at: MDP.from_arrays([[[1]]], [sum(at.values())], 0),
    )
    for relative, wanted in (
        (2, {"p": (0, F(3, 10)), "q": (0, 1), "r": (-15, 5)}),
        ("1/2", {"p": (F(1, 20), F(3, 20)), "q": (F(9, 20), 1), "r": (F(-15, 2), F(-5, 2))}),
    ):
        spans = tornado(family, relative=relative).spans
        assert {p.name: (span.low, span.high) for p, span in spans.items()} == wanted


def test_ranges_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "ranges.toml"
    file.write_text('"base.anger" = [0.02, "1/10"]\n[reward]\nanger = [-6, -4]\n', "utf-8")
    spans = tornado(YUAN, ranges=file).spans
    assert {parameter.name: (span.low, span.high) for parameter, span in spans.items()} == {
        "base.anger": (F(1, 50), F(1, 10)),
        "reward.anger": (F(-6), F(-4)),
    }


# ---- bars and maps -------------------------------------------------------------------------------


def test_bars_are_values_of_an_independent_model() -> None:
    own = YUAN.with_(readings={"influence_orientation": "column-to-row"})
    names = ["base.confusion", "reward.anger"]
    bars = tornado(own, policy="always:directive", names=names)
    table = bars.frame().set_index("parameter")
    for parameter, span in bars.spans.items():
        bar = table.loc[parameter.name]
        for end in ("low", "high"):
            twin = oracle_of(own, {parameter.name: getattr(span, end)})
            best = float(twin.value(twin.start))
            assert bar[f"value_{end}"] == pytest.approx(best, abs=1e-9)
            fixed = twin.evaluate(lambda _: {"directive": F(1)}, distribution=False)["mean"]
            assert bar[f"fixed_value_{end}"] == pytest.approx(float(fixed), abs=1e-9)
            assert bar[f"regret_{end}"] == pytest.approx(best - float(fixed))
        assert bar["swing"] == abs(bar["value_high"] - bar["value_low"])
    assert table["swing"].is_monotonic_decreasing
    assert bars.frame("fixed_swing")["fixed_swing"].is_monotonic_decreasing
    lost = bars.today
    assert lost["regret"].value == pytest.approx(lost["optimal"].value - lost["fixed"].value)
    assert lost["regret"].error >= lost["optimal"].error + lost["fixed"].error
    assert table["unit"].to_dict() == {"base.confusion": "probability", "reward.anger": "reward"}


def test_two_way_map_agrees_with_thresholds_along_its_rows() -> None:
    x = "assistance.directive.confusion.persistence"
    grid = two_way(YUAN, x, "base.confusion", ranges={x: (0, 1)}, points=5)
    assert grid.policy.shape == (5, 5)
    today = thresholds(YUAN, x, (0, 1))
    across = grid.table.points[:5, 0]
    middle = grid.choices[2]  # base.confusion as it is today
    for column in range(4):
        moved = np.flatnonzero(middle[column] != middle[column + 1]).tolist()
        inside = [t for t in today.found if across[column] < t.value < across[column + 1]]
        assert set(moved) <= {switch.state for t in inside for switch in t.switches}
    frame = grid.frame()
    assert len(frame) == 25
    assert (frame["regret"] >= 0).all()
    assert frame["value"][10] >= frame["fixed_value"][10] - 1e-9


# ---- the worst corner ----------------------------------------------------------------------------

STAY = [["1/2", "1/4", "1/4", 0], ["1/5", "1/2", "1/5", "1/10"], ["1/4", "1/4", "1/4", "1/4"]]
TURNS = moving(
    MDP.from_arrays([[*STAY, [0, 0, 0, 1]]], [[1], [-2], [3], [0]]), {"p": [(0, 1)], "q": [(1, 3)]}
)
TWO = {"p": (F(1, 10), F(1, 2)), "q": (F(1, 20), F(3, 10))}
BOX = {
    "base.anger": (0, F(1, 5)),
    "persistence.confusion": (F(1, 2), 1),
    "skip.confusion.alone": (0, F(2, 5)),
    "reward.anger": (-7, -2),
}
CARE = parametric(YUAN.with_(tasks=[1, 1]))


@pytest.mark.parametrize(
    ("family", "policy", "box"),
    [
        *((CARE, policy, BOX) for policy in ("optimal", "always:directive", "random")),
        (TURNS, "optimal", TWO),
        (burning("9/10"), "optimal", {"fire": (F(1, 20), F(3, 10))}),
    ],
)
def test_no_corner_is_worse(family: Parametric, policy: str, box: dict[str, Any]) -> None:
    worst = worst_point(family, policy, box)
    fixed = solve(family.at({})).policy if policy == "optimal" else policy
    corners = [dict(zip(box, each, strict=True)) for each in product(*box.values())]
    values = [evaluate(family.at(corner), fixed).mean for corner in corners]
    assert worst.value.value == pytest.approx(min(values), abs=1e-9)
    assert values[corners.index(worst.point)] == min(values) < max(values) - 0.1
    best = solve(family.at(worst.point)).start_value
    assert worst.optimum.value == pytest.approx(best, abs=1e-9)
    assert worst.optimum.value >= worst.value.value - 1e-9
    assert worst.claim is Claim.ESTIMATED
    assert worst.frame()["parameter"].tolist() == [*box]


def test_of_costs_the_greatest_is_the_worst() -> None:
    """A short way may fail, which costs 7."""
    rows = [(0, 0, [("1/2", 1, 1), ("1/2", 2, 1)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 1, 7)])]
    for sense, at, value in (("min", F(1, 4), 1 + 7 * 3 / 4), ("max", F(3, 4), 1 + 7 / 4)):
        family = moving(MDP.from_outcomes(rows, sense=sense), {"short": [(0, 1)]})
        worst = worst_point(family, ranges={"short": ("1/4", "3/4")})
        assert (worst.point, worst.value.value) == ({"short": at}, pytest.approx(value))
