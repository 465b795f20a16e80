"""Thresholds, where two lines cross: each is known in closed form."""

from fractions import Fraction as F
from typing import Any

import pytest

from exact_mdp import MDP, Family, Parameter, thresholds
from exact_mdp.analysis.vary.curves.thresholds import _group_switches, report_of

WIDTH = F(1, 10**12)


def lines(*values: tuple[object, object]) -> Family:
    """One step, in which action k pays a + b θ for the k-th (a, b); the end is state 1."""

    def build(at: dict[str, F]) -> MDP:
        rows = [(0, k, [(1, 1, F(a) + F(b) * at["x"])]) for k, (a, b) in enumerate(values)]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])

    return Family(parameters={"x": 0}, build=build)


@pytest.mark.parametrize("shift", [F(0), F(1, 3), F(-5, 7)])
def test_the_upper_envelope_of_lines_turns_where_they_cross(shift: F) -> None:
    """-x, 1/2 and 2 x - 1 + shift: at -1/2, and where the last passes 1/2."""
    family = lines((0, -1), ("1/2", 0), (shift - 1, 2))
    found = thresholds(family, "x", (-3, 3))
    places = [F(-1, 2), (F(3, 2) - shift) / 2]
    assert len(found.found) == 2
    for each, place in zip(found.found, places, strict=True):
        assert each.low <= place <= each.high
        assert each.high - each.low <= WIDTH
        assert each.value == pytest.approx(float(place))
        assert each.reached
    before, after = ([(*switch.before, *switch.after) for switch in each.switches]
                     for each in found.found)  # fmt: skip
    assert before == [("0", "1")]
    assert after == [("1", "2")]
    low, high = found.stable()
    assert low == pytest.approx(places[0], abs=1e-11)
    assert high == pytest.approx(places[1], abs=1e-11)
    assert float(found.radius) == pytest.approx(min(0.5, float(places[1])))


def test_where_nothing_crosses_the_whole_range_is_stable() -> None:
    found = thresholds(lines((0, 1), (5, 1)), "x", (-3, 2))
    assert found.found == ()
    assert found.stable() == (-3, 2)
    assert found.radius == 2


def crossing(*places: object, start: object = None, low: object = None) -> Family:
    """In state s, action 0 pays 0 and action 1 pays x less the s-th place; then the end."""
    end = len(places)

    def build(at: dict[str, F]) -> MDP:
        rows = [
            (s, k, [(1, end, k * (at["x"] - F(place)))])
            for s, place in enumerate(places)
            for k in (0, 1)
        ]
        return MDP.from_outcomes([*rows, (end, 0, [(1, end, 0)])], start=start)

    return Family(parameters=(Parameter(name="x", value="1/2", low=low),), build=build)


def test_each_state_turns_at_its_place_and_says_whether_it_is_reached() -> None:
    found = thresholds(crossing("3/4", "1/4", "1/8", start={0: "1/2", 2: "1/2"}), "x", (0, 1))
    assert repr(found) == "Thresholds(x from 0 to 1: 3 thresholds, checked)"
    switches = [*found.switches()]
    assert [(each["state"], each["reached"]) for each in switches] == [
        ("state 2", True), ("state 1", False), ("state 0", True)]  # fmt: skip
    assert [each.switches[0].state for each in found.found] == [2, 1, 0]
    assert [each.reached for each in found.found] == [True, False, True]
    for each, one, place in zip(switches, found.found, (1 / 8, 1 / 4, 3 / 4), strict=True):
        assert each["threshold"] == one.value == pytest.approx(place)
        assert (each["low"], each["high"]) == (one.low, one.high)
        assert (each["before"], each["after"], each["parameter"]) == (("0",), ("1",), "x")
        assert each["columns"] == dict(found.curve.mdp.space.as_dict(one.switches[0].state))
    low, high = found.stable()
    assert (low, high) == (found.found[1].high, found.found[2].low)
    assert found.stable(reached=True) == (found.found[0].high, found.found[2].low)
    assert found.radius == min(F(1, 2) - low, high - F(1, 2))
    frame = found.frame()
    assert frame["state"].tolist() == ["state 2", "state 1", "state 0"]
    assert frame["before"].tolist() == ["0"] * 3
    assert frame["after"].tolist() == ["1"] * 3
    assert frame["claim"].tolist() == ["checked"] * 3
    assert [*frame.columns[:6]] == ["parameter", "threshold", "state", "before", "after", "reached"]
    facts = found.report().facts
    assert str(facts["claim"]) == "checked"
    assert facts["switches"] == switches
    assert facts["stable"]["x"] == {
        "today": 0.5,
        "unit": "number",
        "low": float(low),
        "high": float(high),
        "low_on_reached_states": float(found.found[0].high),
        "high_on_reached_states": float(high),
        "radius": float(found.radius),
        "searched": [0.0, 1.0],
    }


def test_at_a_threshold_nothing_is_stable() -> None:
    found = thresholds(crossing("1/2"), "x", (0, 1))
    assert found.stable() == (F(1, 2), F(1, 2))
    assert found.radius == 0
    assert repr(found) == "Thresholds(x from 0 to 1: 1 threshold, checked)"
    hidden = thresholds(crossing("3/4", "1/2", start=0), "x", (0, 1))
    assert hidden.stable() == (F(1, 2), F(1, 2))
    assert hidden.stable(reached=True) == (0, hidden.found[1].low)


@pytest.mark.parametrize(
    ("low", "ranges", "radius"),
    [
        (None, (0, 2), F(1, 2)),
        (0, (0, 2), F(3, 2)),
        (0, ("1/4", 2), F(1, 4)),
        (0, (0, "5/8"), F(1, 8)),
    ],
)
def test_an_end_of_what_a_parameter_may_be_does_not_count(
    low: object, ranges: tuple[object, object], radius: F
) -> None:
    assert thresholds(crossing(9, low=low), "x", ranges).radius == radius


@pytest.mark.parametrize(
    ("low", "high", "radius"), [(0, 1, F(3, 4)), ("1/8", "5/16", F(1, 8)), ("1/8", 1, F(3, 4))]
)
def test_an_end_on_both_sides_leaves_the_farther_one(low: object, high: object, radius: F) -> None:
    family = Family(
        parameters=(Parameter(name="x", value="1/4", low=low, high=high),),
        build=crossing(9).build,
    )
    assert thresholds(family, "x", (low, high)).radius == radius


def test_a_threshold_at_a_breakpoint_may_be_today() -> None:
    """0 or max(0, x - 1/2): from 1/2 on, the second action alone is best."""

    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, max(F(0), at["x"] - F(1, 2)))])]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])

    family = Family(parameters={"x": "1/2"}, build=build, breaks={"x": ["1/2"]})
    found = thresholds(family, "x", (0, 1))
    assert [(each.low, each.high) for each in found.found] == [(F(1, 2), F(1, 2))]
    assert found.stable() == (F(1, 2), F(1, 2))


def test_a_state_is_reached_by_an_optimal_policy_below_or_above() -> None:
    """State 1 pays max(x - 1/2, 2 x - 1): state 0 takes it above 1/2, and never goes to state 2."""

    def build(at: dict[str, F]) -> MDP:
        over = at["x"] - F(1, 2)
        rows = [(0, 0, [(1, 3, 0)]), (0, 1, [(1, 1, 0)]), (0, 2, [(1, 2, -9)])]
        rows += [(s, k, [(1, 3, (k + 1) * over)]) for s in (1, 2) for k in (0, 1)]
        return MDP.from_outcomes([*rows, (3, 0, [(1, 3, 0)])], start=0)

    for today in ("1/4", "3/4"):
        (one,) = thresholds(Family(parameters={"x": today}, build=build), "x", (0, 1)).found
        assert [(each.state, each.reached) for each in one.switches] == [
            (0, True), (1, True), (2, False)]  # fmt: skip


def test_thresholds_are_those_of_the_criterion() -> None:
    """Earn x and stay, or 3 and return for nothing: x = 3 / 2, or 2 x = 4 at discount 1/2."""

    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(1, 0, at["x"])]), (0, 1, [(1, 1, 3)]), (1, 0, [(1, 0, 0)])]
        return MDP.from_outcomes(rows, "1/2")

    family = Family(parameters={"x": 1}, build=build)
    for criterion, place in (("total", 2), ("average", 1.5)):
        (one,) = thresholds(family, "x", (0, 3), criterion=criterion).found
        assert one.value == pytest.approx(place, rel=1e-12)


def test_states_that_change_alike_are_one_row() -> None:
    def row(places: list[object]) -> dict[str, object]:
        found = thresholds(crossing(*places), "x", (0, 1))
        (one,) = found.report().tables["switches"].rows
        return one

    assert row(["1/4"])["state"] == "state 0"
    assert row(["1/4"])["to"] is None
    two = row(["1/4"] * 2)
    assert two["state"] == "2 states: 0, 1"
    assert two["threshold"] == pytest.approx(0.25)
    assert two["to"] is None
    assert row(["1/4"] * 3)["state"] == "3 states: 0, 1, 2"
    assert row(["1/4"] * 4)["state"] == "4 states: 0, 1, 2, …"
    apart = thresholds(crossing("1/4", "3/4", "1/4"), "x", (0, 1)).report().tables
    rows = [*apart["switches"].rows]
    assert [each["state"] for each in rows] == ["2 states: 0, 2", "state 1"]
    assert [each["threshold"] for each in rows] == pytest.approx([0.25, 0.75])
    stable = [*apart["stable"].rows]
    assert [(each["name"], each["found"]) for each in stable] == [("x", 2)]


def test_states_of_several_columns_are_told_by_the_last() -> None:
    def change(state: str, last: str, threshold: float, after: str = "b") -> dict[str, Any]:
        return {
            "parameter": "x",
            "threshold": threshold,
            "state": state,
            "columns": {"trial": state, "status": last},
            "before": ("a",),
            "after": (after,),
        }

    rows = _group_switches(
        [
            change("s0", "01", 0.25),
            change("s1", "10", 0.375),
            change("s2", "01", 0.5),
            change("s0", "01", 0.625),
            change("s3", "01", 0.5, "c"),
        ]
    )
    assert [each["state"] for each in rows] == ["2 states: status 01", "s1", "s3"]
    assert [each["threshold"] for each in rows] == [0.25, 0.375, 0.5]
    assert [each["to"] for each in rows] == [0.625, None, None]


def test_several_parameters_are_one_report() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])], "1/2")
    sure, checked = (
        thresholds(mdp, "discount", (0, "3/4")),
        thresholds(crossing("1/4"), "x", (0, 1)),
    )
    assert (str(sure.claim), sure.found) == ("certified", ())
    both = report_of({"discount": sure, "x": checked})
    assert str(both.facts["claim"]) == "checked"
    assert str(report_of({"discount": sure}).facts["claim"]) == "certified"
    assert [*both.facts["stable"]] == ["discount", "x"]
    assert both.facts["switches"] == [*checked.switches()]
    assert both.title == "thresholds"
    assert both.tables["stable"].first == 2


def test_a_range_is_a_share_around_today_unless_given() -> None:
    for share, low, high in ((None, F(2, 5), F(3, 5)), ("1/2", F(1, 4), F(3, 4))):
        span = thresholds(crossing(9), "x", relative=share).curve.range
        assert (span.low, span.high) == (low, high)
