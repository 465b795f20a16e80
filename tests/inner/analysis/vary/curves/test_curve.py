"""Curves of random families, against policy iteration in fractions at many points."""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction as F
from itertools import pairwise

import numpy as np
import pytest
from oracle import policy_values, rows_of, solve_exact

from exact_mdp import MDP, Family, curve
from exact_mdp.analysis.vary.curves.curve import (
    ValueFunction,
    _choose_simple_fraction,
    _describe_interval,
)
from exact_mdp.mdp.errors import ModelError

NEAR = F(1, 10**20)  # of a step for derivatives: its square is lost in what is compared


def drawn(seed: int, sense: str = "max", discount: str = "4/5") -> Family:
    """Three states of two pairs; θ shifts mass from one outcome to another, and moves rewards."""
    rng = np.random.default_rng(seed)
    base = [
        [F(int(k), 8) for k in rng.multinomial(4, [1 / 3] * 3) + np.array([1, 2, 1])]
        for _ in range(6)
    ]
    ways = [rng.permutation(3)[:2].tolist() for _ in range(6)]
    reward, slope = rng.integers(-4, 5, (2, 6)).tolist()

    def build(at: dict[str, F]) -> MDP:
        rows = []
        for pair, (law, (to, of)) in enumerate(zip(base, ways, strict=True)):
            moved = [*law]
            moved[to], moved[of] = moved[to] + at["x"] / 8, moved[of] - at["x"] / 8
            earned = reward[pair] + slope[pair] * at["x"]
            each = [(p, t, earned) for t, p in enumerate(moved) if p]
            rows.append((*divmod(pair, 2), each))
        return MDP.from_outcomes(rows, discount, sense=sense, start={0: "1/3", 1: "2/3"})

    return Family(parameters={"x": 0}, build=build)


def start_of(mdp: MDP) -> F:
    """The optimum at the start, by policy iteration in fractions."""
    rows = [(s, a, mdp.sense.sign * r, law) for s, a, r, law in rows_of(mdp)]
    value, _ = solve_exact(3, rows, mdp.discount_exact)
    return mdp.sense.sign * sum(p * value[s] for s, p in mdp.start)


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("seed", range(8))
def test_the_curve_is_the_optimum_at_every_point(seed: int, sense: str) -> None:
    family = drawn(seed, sense)
    found = curve(family, "x", ("-1", "1"), policy=[0, 1, 0])
    assert found.violations() == []
    pieces = found.pieces
    assert (pieces[0].low, pieces[-1].high) == ((-1, -1), (1, 1))
    for one, other in pairwise(pieces):
        assert one.high == other.low
        assert 0 <= one.high[1] - one.high[0] <= F(1, 10**12)
        assert (one.optimal != other.optimal).any()
    points = [F(k, 7) for k in range(-7, 8)]
    points += [(each.low[1] + each.high[0]) / 2 for each in pieces]
    for x in points:
        mdp = family.at({"x": x})
        assert found.at(x) == start_of(mdp)
        own = policy_values([rows_of(mdp)[l] for l in (0, 3, 4)], F(4, 5))
        assert found.fixed_at(x) == own[0] / 3 + 2 * own[1] / 3
    for each in pieces:
        x = (each.low[1] + each.high[0]) / 2
        rise = (start_of(family.at({"x": x + NEAR})) - start_of(family.at({"x": x - NEAR}))) / (
            2 * NEAR
        )
        left, right = found.slope(x)
        assert left == right
        assert abs(left - rise) < F(1, 10**30)


@pytest.mark.parametrize("seed", range(8))
def test_a_policy_is_within_a_tolerance_exactly_where_it_loses_no_more(seed: int) -> None:
    family = drawn(seed)
    found = curve(family, "x", ("-1", "1"), policy=[1, 0, 1])
    loss = {x: found.at(x) - found.fixed_at(x) for x in (F(k, 40) for k in range(-40, 41))}
    tolerance = sorted(loss.values())[30] + F(1, 1000)
    inside = found.within(tolerance)
    for x, lost in loss.items():
        sure = any(each.low[1] <= x <= each.high[0] for each in inside)
        maybe = any(each.low[0] <= x <= each.high[1] for each in inside)
        assert sure <= (lost <= tolerance) <= maybe
    share = {x: lost / abs(found.at(x)) for x, lost in loss.items()}
    inside = found.within(max_relative_regret=sorted(share.values())[30])
    for x, lost in share.items():
        sure = any(each.low[1] <= x <= each.high[0] for each in inside)
        maybe = any(each.low[0] <= x <= each.high[1] for each in inside)
        assert sure <= (lost <= sorted(share.values())[30]) <= maybe


@pytest.mark.parametrize("seed", range(4))
def test_the_discount_is_a_parameter_like_any_other(seed: int) -> None:
    mdp = drawn(seed).at({"x": F(1, 2)})
    found = curve(mdp, "discount", ("1/10", "9/10"))
    assert found.violations() == []
    for k in range(1, 10):
        assert found.at(F(k, 10)) == start_of(mdp.with_(discount=F(k, 10)))


# ---- closed forms ------------------------------------------------------------------------------


def paying(*lines: Sequence[object], sense: str = "max") -> Family:
    """One choice among polynomials of x (coefficients from the constant up), earned at once."""

    def build(at: dict[str, F]) -> MDP:
        paid = [sum((F(c) * at["x"] ** n for n, c in enumerate(line)), F(0)) for line in lines]
        rows = [(0, k, [(1, 1, each)]) for k, each in enumerate(paid)]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], sense=sense)

    return Family(parameters={"x": "1/2"}, build=build, degrees={"x": 3})


def held(*lines: Sequence[object], low: object = 0, high: object = 1) -> ValueFunction:
    return curve(paying(*lines), "x", (low, high), policy=[0, 0])


def ends(found: ValueFunction, *limits: object) -> list[tuple[float, float]]:
    """The intervals, each between the middles of its brackets."""
    every = found.within(*limits)
    for each in every:
        for low, high in (each.low, each.high):
            assert 0 <= high - low <= F(1, 10**12)
    return [(float(sum(each.low) / 2), float(sum(each.high) / 2)) for each in every]


@pytest.mark.parametrize(
    ("lines", "limit", "wanted"),
    [
        ([["-1/9", "2/3", -1], [0]], 0, [(1 / 3, 1 / 3)]),  # -(x - 1/3)², as good at one point
        ([["-1/9", "2/3", -1], [0]], "1/100", [(1 / 3 - 0.1, 1 / 3 + 0.1)]),
        ([["-1/9", "2/3", -1], [0]], "1/9", [(0, 2 / 3)]),
        ([["-1/9", "2/3", -1], [0]], 1, [(0, 1)]),
        ([["1/9", "-2/3", 1], [0]], 0, [(0, 1)]),
        ([["1/2"], [0, 1], [1, -1]], 0, [(0.5, 0.5)]),  # three lines through one point
        ([["1/2"], [0, 1], [1, -1]], "1/4", [(0.25, 0.75)]),
        ([[0, 1], ["1/2"]], 0, [(0.5, 1)]),
        ([[1, -1], ["1/2"]], 0, [(0, 0.5)]),
        ([[0, 0, 1], ["1/2"]], 0, [(0.5**0.5, 1)]),
        ([[0], ["-3/16", 1, -1]], 0, [(0, 0.25), (0.75, 1)]),
        ([[0], ["3/16", -1, 1]], 0, [(0.25, 0.75)]),
        ([[0], ["3/16", -1, 1]], "3/16", [(0, 1)]),
        ([[0], ["-3/16", 1, -1]], "1/16", [(0, 1)]),  # the loss touches the limit at 1/2
        ([[0], ["1/16", 1, -1]], "5/16", [(0, 1)]),
        ([[0], [1, -1]], 0, [(1, 1)]),  # at an end of the range alone
        ([[0], [0, 1]], 0, [(0, 0)]),
        ([[0], [1]], 0, []),
        ([[0], [1]], "1/2", []),
        ([[0], [1]], 1, [(0, 1)]),
    ],
)
def test_a_limit_is_kept_from_root_to_root(
    lines: list[list[object]], limit: object, wanted: list[tuple[float, float]]
) -> None:
    found = held(*lines)
    assert found.violations() == []
    got = ends(found, limit)
    assert [x for each in got for x in each] == pytest.approx(
        [x for each in wanted for x in each], abs=1e-11
    )
    if limit == 0:
        assert ends(found) == got


def test_what_is_lost_may_touch_a_limit_where_pieces_meet() -> None:
    """1/2 - |x - 1/2|, at a breakpoint; or 1 - y² + max(0, y³), with y = x - 1/2, at a threshold.

    A threshold is known up to a bracket, inside which nothing is said.
    """

    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, F(1, 2) - abs(at["x"] - F(1, 2)))])]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])

    family = Family(parameters={"x": "1/4"}, build=build, breaks={"x": ["1/2"]})
    broken = curve(family, "x", (0, 1), policy=[0, 0])
    assert len(broken.pieces) == 2
    assert ends(broken, "1/2") == [(0, 1)]
    bent = held([0], ["3/4", 1, -1], ["5/8", "7/4", "-5/2", 1])
    assert ends(bent, 1) == [(0, pytest.approx(0.5)), (pytest.approx(0.5), 1)]


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("seed", range(5))
def test_a_relative_limit_is_a_share_of_the_absolute_optimum(seed: int, sense: str) -> None:
    """The optimum changes its sign in the range."""
    rng = np.random.default_rng(seed)
    lines = rng.integers(-4, 5, (3, 3)).tolist()
    found = curve(paying(*lines, sense=sense), "x", (-1, 1), policy=[0, 0])
    inside = found.within(max_relative_regret="2/5")
    best = max if sense == "max" else min
    for x in (F(k, 60) for k in range(-60, 61)):
        worth = [sum(c * x**n for n, c in enumerate(line)) for line in lines]
        optimum = best(worth)
        assert (found.at(x), found.fixed_at(x)) == (optimum, worth[0])
        kept = abs(optimum - worth[0]) <= F(2, 5) * abs(optimum)
        sure = any(each.low[1] <= x <= each.high[0] for each in inside)
        maybe = any(each.low[0] <= x <= each.high[1] for each in inside)
        assert sure <= kept <= maybe


def test_what_is_asked_for_of_a_limit_is_one_thing() -> None:
    found = held([0], [0, 1])
    with pytest.raises(ModelError, match="two limits"):
        found.within(1, 1)
    assert found.within(1) == found.within(max_relative_regret=1)
    bare = curve(paying([0], [0, 1]), "x", (0, 1))
    with pytest.raises(ModelError, match="no policy"):
        bare.within(1)
    assert bare.fixed_at("1/2") is None


def test_slopes_differ_at_a_threshold_and_end_with_the_range() -> None:
    """The greater of 1/2 and x²."""
    found = held(["1/4"], [0, 0, 1])
    assert found.slope(0) == (None, 0)
    assert found.slope("1/4") == (0, 0)
    assert found.slope("1/2") == (0, 1)
    assert found.slope("3/4") == (F(3, 2), F(3, 2))
    assert found.slope(1) == (2, None)
    low, high = found.pieces[0].high
    assert found.around(low) == found.around(high) == list(found.pieces)
    assert found.around(0) == [found.pieces[0]]
    assert found.around(1) == [found.pieces[1]]
    for beyond in (F(-1, 10**9), 1 + F(1, 10**9)):
        with pytest.raises(ModelError, match="outside the range of the curve"):
            found.at(beyond)


def test_a_cover_with_a_hole_is_refused() -> None:
    found = held(["1/4"], [0, 0, 1])
    one, other = found.pieces
    cases = [(one,), (other,), (other, one), (replace(one, low=(F(1, 9), F(1, 9))), other)]
    cases.append((replace(one, high=one.high[::-1]), replace(other, low=other.low[::-1])))
    for pieces in cases:
        assert any("no piece covers" in each for each in replace(found, pieces=pieces).violations())


def test_a_degree_that_was_tested_is_not_proven() -> None:
    found = held(["1/4"], [0, 0, 1])
    assert replace(found, checked=None).violations() == [
        "the degree of the rows was tested at some points, not proven"
    ]


def test_the_report_has_the_ends_values_and_actions_of_pieces() -> None:
    """From 1/9 to 1: 1/4, then x² from 1/2 on."""
    found = held(["1/4"], [0, 0, 1], low="1/9")
    assert repr(found) == "ValueFunction(x from 0.111111 to 1: 2 pieces, checked)"
    report = found.report(found.within("1/9"))
    one, other = report.facts["pieces"]
    assert (one["from"], one["to"], other["from"], other["to"]) == (F(1, 9), F(1, 2), F(1, 2), 1)
    assert (one["from_bracket"], other["to_bracket"]) == ((F(1, 9), F(1, 9)), (1, 1))
    assert one["to_bracket"] == other["from_bracket"] == found.pieces[0].high
    assert (one["numerator"], one["denominator"]) == ((F(1, 4),), (1,))
    assert other["numerator"] == (0, 0, 1)
    assert one["fixed"] == {"numerator": (F(1, 4),), "denominator": (1,)}
    assert [next(iter(each["policy"].values())) for each in (one, other)] == ["0", "1"]
    assert (report.facts["parameter"], str(report.facts["claim"])) == ("x", "checked")
    within = report.facts["within"]
    (kept,) = within.value
    assert (kept["from"], float(kept["to"])) == (F(1, 9), pytest.approx(13**0.5 / 6, abs=1e-11))
    inner, outer = kept["to_bracket"]  # as wide as it may be, up to a factor of 2
    assert F(1, 2 * 10**12) < outer - inner <= F(1, 10**12)
    assert within.text.startswith("the policy keeps the limit: 0.1111111111 to 0.600925212")
    assert "within" not in found.report().facts
    assert found.report([]).facts["within"].text.endswith("nowhere")
    assert "fixed" not in curve(paying([0]), "x", (0, 1)).report().facts["pieces"][0]
    frame = found.frame()
    assert frame["low"].tolist() == pytest.approx([1 / 9, 1 / 2])
    assert frame["high"].tolist() == pytest.approx([1 / 2, 1])
    assert frame["degree"].tolist() == [0, 2]
    assert frame["value_low"].tolist() == pytest.approx([1 / 4, 1 / 4])
    assert frame["value_high"].tolist() == pytest.approx([1 / 4, 1])
    assert frame["parameter"].tolist() == ["x", "x"]
    assert frame["claim"].tolist() == ["checked", "checked"]
    table = report.tables["pieces"]
    assert list(table.columns) == ["from", "to", "value from", "value to", "degree"]
    assert table.note == "each is a ratio of polynomials with exact coefficients"
    assert (report.title, len(table.rows)) == ("curve", 2)


def test_values_at_the_ends_of_a_piece_are_taken_inside_its_brackets() -> None:
    """A wide bracket shows which of its ends is used."""
    found = held([0, 1])
    wide = replace(found.pieces[0], low=(F(0), F(1, 4)), high=(F(1, 2), F(1)))
    frame = replace(found, pieces=(wide,)).frame()
    assert [frame[key][0] for key in ("low", "high", "value_low", "value_high")] == [
        0,
        1,
        0.25,
        0.5,
    ]


@pytest.mark.parametrize(
    ("low", "high", "point"),
    [
        (F(1, 3) - F(1, 10**13), F(1, 3) + F(1, 10**13), F(1, 3)),
        (F(22, 7), F(22, 7), F(22, 7)),
        (F(5), F(5) + F(1, 10**13), F(5)),
        (F(5) - F(1, 10**13), F(5), F(5)),
        (F(1), F(8, 5), F(1)),  # an integer before 3/2
        (F(1, 4), F(13, 44), F(2, 7)),  # one digit before 3/11
        (F(12345, 67891), F(12345, 67891), F(12345, 67891)),
        (F(-3, 11) - F(1, 10**9), F(-3, 11) + F(1, 10**10), F(-3, 11)),
    ],
)
def test_a_point_of_small_denominator_stands_for_a_bracket(low: F, high: F, point: F) -> None:
    assert _choose_simple_fraction((low, high)) == point
    assert _describe_interval((low, high), (F(7), F(7))) == {
        "from": point, "to": 7, "from_bracket": (low, high), "to_bracket": (F(7), F(7))
    }  # fmt: skip


# ---- ranges, and the policy held fixed ---------------------------------------------------------


def staying(ends: bool) -> MDP:
    """Earn 1 a step; a run ends with chance 1/2 each step, or never."""
    on = [(F(1, 2), 0, 1), (F(1, 2), 1, 1)] if ends else [(1, 0, 1)]
    return MDP.from_outcomes([(0, 0, on), (1, 0, [(1, 1, 0)])], "1/2")


def test_a_discount_ends_next_to_1_where_there_are_no_values_at_1() -> None:
    nearly = 1 - F(1, 2**40)
    for given, low, high in (
        (("1/4", 1), F(1, 4), nearly),
        (("1/4", "3/4"), F(1, 4), F(3, 4)),
        ((nearly - F(1, 2**50), 1), nearly - F(1, 2**50), nearly),
        (None, F(0), nearly),
    ):
        found = curve(staying(False), "discount", given)
        assert (found.range.low, found.range.high) == (low, high)
        assert found.at(low) == 1 / (1 - low)
        assert found.at(high) == 1 / (1 - high)
        assert found.violations() == []
    for low in (nearly, nearly + F(1, 2**50)):
        with pytest.raises(ModelError, match="at discount 1 some policy never ends"):
            curve(staying(False), "discount", (low, 1))
        assert curve(staying(True), "discount", (low, 1)).at(1) == 2
    assert curve(staying(True), "discount", ("1/4", 1)).range.high == 1
    assert curve(staying(True), "discount").range.high == 1
    assert str(curve(staying(True), "discount", ("1/4", "3/4")).claim) == "certified"
    share = curve(staying(False), "discount", relative="1/10").range
    assert (share.low, share.high) == (F(9, 20), F(11, 20))
    other = curve(paying([0, 1]), "x", relative="1/10").range
    assert (other.low, other.high) == (F(9, 20), F(11, 20))
    whole = curve(paying([0, 1]), "x").range
    assert (whole.low, whole.high) == (0, 1)


def test_a_policy_says_what_it_does_where_that_matters() -> None:
    """In state 1 both actions are the same at x = 0 alone."""

    def build(at: dict[str, F]) -> MDP:
        rows = [
            (0, 0, [(1, 1, 1)]),
            (0, 1, [(1, 2, 0)]),
            (1, 0, [(1, 2, at["x"])]),
            (1, 1, [(1, 2, -at["x"])]),
            (2, 0, [(1, 2, 0)]),
        ]
        return MDP.from_outcomes(rows)

    family = Family(parameters={"x": 0}, build=build)
    found = curve(family, "x", (-1, 1), policy={0: 0, 1: 1})
    assert found.fixed_at("1/2") == F(1, 2)
    assert found.at("1/2") == F(3, 2)
    for share in (0, 1):  # state 1 is terminal at x = 0 alone; with 0 both actions stay alike

        def stay(at: dict[str, F], share: int = share) -> MDP:
            earned = [at["x"] * (1 + share * a) for a in range(2)]
            rows = [(1, a, [(1, 1, paid)]) for a, paid in enumerate(earned)]
            return MDP.from_outcomes([(0, 0, [(1, 1, 1)]), *rows], "1/2", start=0)

        family = Family(parameters={"x": 0}, build=stay)
        if share:
            with pytest.raises(ModelError, match="names no action") as refused:
                curve(family, "x", (-1, 1), policy={"state 0": "0"})
            assert refused.value.where == "state 1, for some x"
        else:
            assert curve(family, "x", (-1, 1), policy={"state 0": "0"}).fixed_at("1/2") == F(3, 2)


def test_the_best_policy_of_today_is_that_of_the_criterion() -> None:
    """Stay for 1 a step, or go to where a step earns x, 3/2 today: at discount 1/2 staying is best.

    Values are max(2, x) in total, and max(1, x) on average.
    """

    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, at["x"])])]
        return MDP.from_outcomes(rows, "1/2", start=0)

    family = Family(parameters={"x": "3/2"}, build=build, degrees={"x": 1})
    for criterion, best, fixed in (
        ("total", [2, 2, 3], [2] * 3),
        ("average", [1, 2, 3], [1, 2, 3]),
    ):
        found = curve(family, "x", (0, 3), policy="optimal", criterion=criterion)
        assert found.violations() == []
        assert [found.at(x) for x in (1, 2, 3)] == best
        assert [found.fixed_at(x) for x in (1, 2, 3)] == fixed
        assert found.criterion == criterion
    assert ends(found) == [(1, 3)]
    still = curve(family.at({}), "discount", (0, 1), criterion="average")
    assert (still.range.high, still.at(1)) == (1, F(3, 2))
    random = curve(replace(family, parameters={"x": "1/2"}), "x", (0, 3), policy="random",
                   criterion="average")  # fmt: skip
    assert [random.fixed_at(x) for x in (0, 1, 2)] == [0, 1, 2]
    with pytest.raises(ModelError, match="has no horizon"):
        curve(family.at({}).within(3), "discount", (0, 1), criterion="average")
