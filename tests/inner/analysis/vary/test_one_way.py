"""Tornadoes, value curves and maps of two parameters, against enumeration of all policies."""

from dataclasses import replace
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from exact_mdp import MDP, Family, ModelError, Parameter, moving, one_way, tornado, two_way
from exact_mdp.analysis.vary.one_way import make_grid
from exact_mdp.analysis.vary.ranges import Range

F = Fraction


def model_of(sense: str) -> Family:
    """Two choices in state 0 and three in state 1, of which state 0 may or may not lead to it."""
    sign = 1 if sense == "max" else -1

    def build(at: Any) -> MDP:
        x, y, z = at["x"], at["y"], at["z"]
        rows = [
            (0, 0, [(1, 1, sign * x)]), (0, 1, [(1, 2, sign * y)]),
            (1, 0, [(1, 2, sign * z)]), (1, 1, [(1, 2, sign * (1 - z))]),
            (1, 2, [(1, 2, sign / F(2))]),
            (2, 0, [(1, 2, 0)]),
        ]  # fmt: skip
        return MDP.from_outcomes(rows, discount="1/2", sense=sense)

    names = {"x": 1, "y": 2, "z": "1/4"}
    return Family(
        parameters=tuple(Parameter(name=n, value=v) for n, v in names.items()), build=build
    )


TODAY = {"x": F(1), "y": F(2), "z": F(1, 4)}
EVERY = [*product(range(2), range(3))]


def worth(policy: tuple[int, int], at: dict[str, Fraction]) -> Fraction:
    """What a policy earns from state 0 on: x and then half of a wager, or y and no more."""
    if policy[0] == 1:
        return at["y"]
    return at["x"] + (at["z"], 1 - at["z"], F(1, 2))[policy[1]] / 2


def best(at: dict[str, Fraction]) -> Fraction:
    return max(worth(policy, at) for policy in EVERY)


SPANS = {"x": (F(1, 2), F(5, 2)), "z": (F(-1), F(1, 2)), "y": (F(0), F(2))}
SENSES = pytest.mark.parametrize("sense", ["max", "min"])


@SENSES
@pytest.mark.parametrize("held", [(0, 1), (1, 0), (0, 0)])
def test_bars_have_the_values_at_both_ends(sense: str, held: tuple[int, int]) -> None:
    found = tornado(model_of(sense), policy=[*held, 0], ranges=SPANS)
    sign = 1 if sense == "max" else -1
    rows = []
    for name, ends in SPANS.items():
        own = [TODAY | {name: end} for end in ends]
        optimal, fixed = [best(at) for at in own], [worth(held, at) for at in own]
        regret = [o - f for o, f in zip(optimal, fixed, strict=True)]
        rows.append({
            "parameter": name, "low": ends[0], "today": TODAY[name], "high": ends[1],
            "value_low": sign * optimal[0], "value_high": sign * optimal[1],
            "fixed_value_low": sign * fixed[0], "fixed_value_high": sign * fixed[1],
            "regret_low": regret[0], "regret_high": regret[1],
            "swing": abs(optimal[1] - optimal[0]), "fixed_swing": abs(fixed[1] - fixed[0]),
            "regret": max(regret),
        })  # fmt: skip
    for by in ("swing", "fixed_swing", "regret"):
        frame = found.frame(by)
        wanted = sorted(rows, key=lambda row: -row[by])
        assert frame["parameter"].tolist() == [row["parameter"] for row in wanted]
        for column in rows[0].keys() - {"parameter"}:
            floats = [float(row[column]) for row in wanted]
            assert frame[column].tolist() == pytest.approx(floats), column
        assert found.report(by).facts["bars"] == frame.drop(columns="claim").to_dict("records")
    today = found.today
    assert today["optimal"].value == pytest.approx(float(sign * best(TODAY)))
    assert today["fixed"].value == pytest.approx(float(sign * worth(held, TODAY)))
    lost = float(best(TODAY) - worth(held, TODAY))
    assert today["regret"].value == pytest.approx(lost)
    facts, tables = found.report().facts, found.report().tables
    assert facts["start_value"].value == today["optimal"].value
    assert facts["policy_value"].value == today["fixed"].value
    assert facts["regret"].value == today["regret"].value
    assert len(tables["held"].rows) == (3 if lost else 0)
    ends = {"parameter": "parameter", "from": "low:.6g", "to": "high:.6g"}
    for key, policy, what in (
        ("bars", "re-optimised; regret of the policy held fixed", "value"),
        ("held", "held fixed", "fixed_value"),
    ):
        assert tables[key].title == f"start value at both ends, policy {policy}"
        assert tables[key].columns == ends | {
            "at low": f"{what}_low:.6g", "at high": f"{what}_high:.6g", "regret": "regret:.3g"
        }  # fmt: skip
    if lost:
        swings = found.frame("fixed_swing")["parameter"].tolist()
        assert tables["held"].rows["parameter"].tolist() == swings
    assert found.frame()["parameter"][0] in repr(found)
    assert found.model == "model"


@SENSES
def test_a_tornado_of_two_policies_has_the_differences_of_their_values(sense: str) -> None:
    sign, one, other = (1 if sense == "max" else -1), (0, 2), (1, 2)

    def apart(at: dict[str, F]) -> F:
        return sign * (worth(one, at) - worth(other, at))

    found = tornado(model_of(sense), ranges=SPANS, policy=[*one, 0], against=[*other, 0])
    ends = {name: [apart(TODAY | {name: end}) for end in SPANS[name]] for name in SPANS}
    order = sorted(ends, key=lambda name: -abs(ends[name][1] - ends[name][0]))
    frame = found.frame()
    assert frame["parameter"].tolist() == order
    assert frame["difference_swing"][0] > 0
    for place, end in enumerate(("low", "high")):
        wanted = [float(ends[name][place]) for name in order]
        assert frame[f"difference_{end}"].tolist() == pytest.approx(wanted)
    today = found.today["difference"]
    assert abs(F(today.value) - apart(TODAY)) <= F(today.error) < F(1, 10**9)
    # The optimum, the policy and its regret are those of the tornado of one policy.
    alone = tornado(model_of(sense), ranges=SPANS, policy=[*one, 0])
    assert frame[alone.frame().columns].equals(alone.frame().set_index("parameter").loc[order]
                                               .reset_index()[alone.frame().columns])  # fmt: skip
    assert found.report().facts["difference"].value == today.value
    table = found.report().tables["apart"]
    assert table.rows["parameter"].tolist() == order
    title = "start value at both ends, policy held fixed, less the value of the other"
    assert (table.title, table.columns["at low"]) == (title, "difference_low:.6g")
    assert "difference" not in alone.report().facts
    ax = found.plot(Figure().subplots())
    assert ax.lines[0].get_xdata()[0] == today.value
    assert "less the other" in ax.get_xlabel()
    with pytest.raises(ModelError, match="output"):
        alone.plot(output="difference")


def test_a_difference_is_as_uncertain_as_both_values_and_its_own_rounding() -> None:
    found = tornado(model_of("max"), ranges=SPANS, policy=[0, 2, 0], against=[1, 2, 0])
    errors = 2.0 ** -np.arange(40, 40 + found.table.error.size).reshape(found.table.error.shape)
    for apart in (-3.0, 2.0**10):
        fixed = np.full(found.table.fixed.shape, 1.0)
        fixed[0] += [apart, 0]
        table = replace(found.table, fixed=fixed, error=errors)
        today = replace(found, table=table).today["difference"]
        unit = F(1, 2**53) * abs(F(apart))
        least = F(errors[0, 1]) + F(errors[0, 2]) + unit
        assert today.value == apart
        assert least <= F(today.error) <= least * (1 + F(1, 2**19))
        # No more than the rounding, without an error of the values.
        exact = replace(found, table=replace(table, error=np.zeros_like(errors)))
        assert unit < F(exact.today["difference"].error) <= unit * (1 + F(1, 2**19))


def test_bars_of_one_length_keep_the_order_of_the_parameters() -> None:
    names = [f"x{k:02}" for k in range(40)]

    def build(at: Any) -> MDP:
        prize = sum(at.values()) + at["x20"]
        return MDP.from_outcomes([(0, 0, [(1, 1, prize)]), (1, 0, [(1, 1, 0)])])

    found = tornado(Family(parameters=dict.fromkeys(names, 1), build=build), relative="1/2")
    order = ["x20", *names[:20], *names[21:]]
    assert found.frame()["parameter"].tolist() == order


def machine(sense: str) -> Any:
    """Earns 4 a step and goes on with chance f, or 3 and goes on with chance 9/10; else a rest."""
    sign = 1 if sense == "max" else -1
    rows: list[Any] = [(0, 0, [("1/2", 0, 4 * sign), ("1/2", 1, 4 * sign)]),
                       (0, 1, [("9/10", 0, 3 * sign), ("1/10", 1, 3 * sign)]),
                       (1, 0, [(1, 0, 0)])]  # fmt: skip
    # At a discount of 1/2 the first action is the better one, also today.
    mdp = MDP.from_outcomes(rows, discount="1/2", sense=sense)
    return moving(mdp, {"f": [(0, 0)], "g": [(1, 0)]})


@SENSES
def test_rewards_per_step_are_those_of_a_machine_and_its_rests(sense: str) -> None:
    """What is earned in a step of work, over the steps that it takes with its rest."""
    sign, model = (1 if sense == "max" else -1), machine(sense)
    first, second = (lambda f: 4 / (2 - f)), (lambda g: 3 / (2 - g))
    bars = tornado(model, criterion="average")
    assert {p.name for p in bars.spans} == {"f", "g"}  # no average depends on the discount
    assert [p.name for p in tornado(model, names=["discount"], criterion="average").spans] == [
        "discount"
    ]
    ranges = {"discount": ("1/4", "3/4")}
    assert [p.name for p in tornado(model, ranges=ranges, criterion="average").spans] == [
        "discount"
    ]
    assert {p.name for p in tornado(model).spans} == {"f", "g", "discount"}
    today = bars.today
    wanted = [sign * second(0.9), sign * second(0.9), 0]
    assert [each.value for each in today.values()] == pytest.approx(wanted, abs=1e-9)
    row = bars.frame().set_index("parameter").loc["f"]
    columns = ["value_low", "value_high", "fixed_value_low", "fixed_value_high", "regret"]
    best = first(0.6)
    numbers = sign * second(0.9), sign * best, sign * second(0.9), sign * second(0.9)
    assert row[columns].tolist() == pytest.approx([*numbers, best - second(0.9)])
    assert bars.report().tables["bars"].title.startswith("average reward at both ends, policy")

    curve = one_way(model, "f", (0, 1), criterion="average", points=3)
    grid = two_way(model, "f", "g", ranges={"f": (0, 1), "g": (0, 1)}, points=3,
                   criterion="average")  # fmt: skip
    at = [0, 0.5, 1]
    assert curve.frame()["value"].tolist() == pytest.approx(
        [sign * max(first(f), second(0.9)) for f in at]
    )
    assert grid.frame()["value"].tolist() == pytest.approx(
        [sign * max(first(f), second(g)) for g in at for f in at]
    )
    assert grid.frame()["fixed_value"].tolist() == pytest.approx(
        [sign * second(g) for g in at for f in at]
    )
    values = {"re-optimised": "value:.6g", "policy held fixed": "fixed_value:.6g",
              "its regret": "regret:.3g"}  # fmt: skip
    for each, names in ((curve, {"f": "at:.6g"}),
                        (grid, {"f": "x:.6g", "g": "y:.6g", "policy": "policy"})):  # fmt: skip
        (table,) = each.report().shown_tables()
        assert table.title == "average reward at the start"
        assert table.columns == names | values
        assert each.report().facts["criterion"].value == "average"


def test_a_tornado_is_of_the_parameters_asked_for() -> None:
    model = model_of("max")
    named = tornado(model, names=["z", "x"], relative="1/2")
    assert [(p.name, span.low, span.high) for p, span in named.spans.items()] == [
        ("z", F(1, 8), F(3, 8)), ("x", F(1, 2), F(3, 2)),
    ]  # fmt: skip
    mixed = tornado(model, names=["z", "x"], ranges={"x": (0, 5)})
    assert [(span.low, span.high) for span in mixed.spans.values()] == [(F(1, 5), F(3, 10)), (0, 5)]
    assert "Tornado(0 bars; value today" in repr(tornado(model, names=[]))


@SENSES
def test_a_curve_has_the_values_along_the_range(sense: str) -> None:
    sign, held = (1 if sense == "max" else -1), (0, 2)
    for points in (2, 3, 21):
        found = one_way(model_of(sense), "x", ("1/2", 3), policy=[*held, 0], points=points)
        at = [F(1, 2) + F(5, 2) * k / (points - 1) for k in range(points)]
        frame = found.frame()
        assert frame["at"].tolist() == pytest.approx([float(x) for x in at])
        for column, of in (
            ("value", lambda x: sign * best(TODAY | {"x": x})),
            ("fixed_value", lambda x: sign * worth(held, TODAY | {"x": x})),
            ("regret", lambda x: best(TODAY | {"x": x}) - worth(held, TODAY | {"x": x})),
        ):
            assert frame[column].tolist() == pytest.approx([float(of(x)) for x in at])
        assert found.parameter.name == "x"
        assert len(found.report().facts["points"]) == points
        ends = [f"{sign * float(best(TODAY | {'x': at[k]})):.6g}" for k in (0, -1)]
        assert repr(found) == f"Curve({points} points of x; value {ends[0]} to {ends[1]})"
    usual = one_way(model_of(sense), "x")
    assert len(usual.table.points) == 21
    assert (usual.table.points[0, 0], usual.table.points[-1, 0]) == (F(4, 5), F(6, 5))
    wide = one_way(model_of(sense), "x", relative="1/2", points=2)
    assert wide.table.points[:, 0].tolist() == [F(1, 2), F(3, 2)]


def test_a_grid_is_even_and_has_both_ends() -> None:
    span = Range(low=F(1, 3), high=F(2))
    assert make_grid(span, 2) == [F(1, 3), 2]
    assert make_grid(span, 6) == [F(1, 3) + F(k, 3) for k in range(6)]
    wrong: list[Any] = [1, 0, 2.5]
    for few in wrong:
        with pytest.raises(ModelError, match="points"):
            make_grid(span, few)


@SENSES
def test_a_map_has_the_best_policy_of_each_point(sense: str) -> None:
    sign, held, n = (1 if sense == "max" else -1), (0, 2), 7
    ranges = {"z": ("1/10", "2/5"), "x": ("3/5", "11/5")}  # no ties
    found = two_way(model_of(sense), "z", "x", ranges=ranges, policy=[*held, 0], points=n)
    z = [F(1, 10) + F(3, 10) * k / (n - 1) for k in range(n)]
    x = [F(3, 5) + F(8, 5) * k / (n - 1) for k in range(n)]
    frame, seen = found.frame(), dict[Any, int]()
    for row, (j, i) in enumerate(product(range(n), repeat=2)):
        at = TODAY | {"z": z[i], "x": x[j]}
        choice = max(EVERY, key=lambda each, at=at: worth(each, at))
        second = max(range(3), key=lambda a, at=at: worth((0, a), at))
        assert found.choices[j, i].tolist() == [choice[0], second, 0]
        # What is done in state 1 counts only where state 0 leads to it.
        number = found.policy[j, i]
        reached = (0, second) if choice[0] == 0 else (1, None)
        assert seen.setdefault(reached, number) == number
        assert found.list_actions(number) == (
            {"state 0": "0", "state 1": str(second)} if choice[0] == 0 else {"state 0": "1"}
        )
        own = frame.iloc[row]
        values = [z[i], x[j], sign * best(at), sign * worth(held, at), best(at) - worth(held, at)]
        assert own[["x", "y", "value", "fixed_value", "regret"]].tolist() == pytest.approx(
            [float(each) for each in values]
        )
        assert own["policy"] == number
    assert len(seen) == len({*seen.values()}) == 2
    assert (found.x.name, found.y.name) == ("z", "x")
    assert found.report().facts["policies"] == 2
    assert repr(found) == "TwoWay(z, x; points 49, best policies 2)"
    assert len(found.report().facts["points"]) == 49


def test_policies_that_differ_where_a_state_is_reached_are_two() -> None:
    ranges = {"z": ("1/10", "9/10"), "x": (2, 3)}
    found = two_way(model_of("max"), "z", "x", ranges=ranges, points=2)
    assert found.choices[0, :, 1].tolist() == [1, 0]
    assert len({*found.policy.ravel().tolist()}) == 2
    assert found.list_actions(int(found.policy[0, 1])) == {"state 0": "0", "state 1": "0"}
    assert found.list_actions(int(found.policy[0, 0])) == {"state 0": "0", "state 1": "1"}
    # Two actions of state 1 where it is reached and two where it is not are three policies.
    every = two_way(model_of("max"), "z", "x", ranges=ranges | {"x": (0, 3)}, points=2)
    assert every.choices[:, :, :2].tolist() == [[[1, 1], [1, 0]], [[0, 1], [0, 0]]]
    assert every.policy.tolist() == [[0, 0], [1, 2]]
    assert every.list_actions(1) == {"state 0": "0", "state 1": "1"}
    unreached = two_way(model_of("max"), "z", "x", ranges=ranges | {"x": (0, 1)}, points=2)
    assert unreached.choices[0, :, 1].tolist() == [1, 0]
    assert unreached.policy.tolist() == [[0, 0], [0, 0]]
    usual = two_way(model_of("max"), "x", "y")
    assert usual.policy.shape == (11, 11)
    assert usual.table.points[0].tolist() == [F(4, 5), F(8, 5)]
    wide = two_way(model_of("max"), "x", "y", relative="1/2", points=2)
    assert wide.table.points.tolist() == [[F(1, 2), 1], [F(3, 2), 1], [F(1, 2), 3], [F(3, 2), 3]]


def test_a_map_is_of_two_parameters_and_their_ranges() -> None:
    model = model_of("max")
    with pytest.raises(ModelError, match="both parameters are x"):
        two_way(model, "x", "x")
    with pytest.raises(ModelError, match="z has a range, and is neither"):
        two_way(model, "x", "y", ranges={"z": (0, 1), "x": (0, 1)})
    with pytest.raises(ModelError, match="unknown"):
        two_way(model, "x", "unknown")
    with pytest.raises(ModelError, match="unknown"):
        two_way(model, "unknown", "x")
