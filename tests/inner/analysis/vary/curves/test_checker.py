"""The checker of curves: each rule refuses what breaks it alone."""

import pickle
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction as F
from math import inf, prod
from typing import Any

import numpy as np
import pytest
from flint import fmpq_poly

from exact_mdp import MDP, Family, curve
from exact_mdp.analysis.vary.curves.average_equations import AverageEquations
from exact_mdp.analysis.vary.curves.checker import (
    CurvePiece,
    RationalFunction,
    _not_of,
    _not_optimal,
    _turn_at_once,
    piece_violations,
)
from exact_mdp.analysis.vary.curves.equations import SectionEquations
from exact_mdp.mdp.exact import from_flint, to_flint
from exact_mdp.mdp.parametric.row_change import Piece
from exact_mdp.mdp.table import format_rational


def build(at: dict[str, F]) -> MDP:
    """Wait for 1 a step with chance x of an end, or go at once for 3; a second state goes round."""
    x = at["x"]
    rows = [
        (0, 0, [(x, 2, 1), (1 - x, 0, 1)]),
        (0, 1, [(1, 2, 3)]),
        (1, 0, [(F(1, 2), 1, x), (F(1, 2), 0, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
    return MDP.from_outcomes(rows, "9/10", start={0: "1/2", 1: "1/2"})


FAMILY = Family(parameters={"x": "1/2"}, build=build)
FOUND = curve(FAMILY, "x", ("1/10", "1"), policy=[0, 0, 0])
MIX = [[(0, to_flint(F(1)))], [(2, to_flint(F(1)))], [(3, to_flint(F(1)))]]


def said(pieces: Any, held: Any = MIX, sign: int = 1) -> list[str]:
    return list(piece_violations(FAMILY, "x", pieces, held, sign))


def changed(number: int, **parts: Any) -> list[str]:
    pieces = list(FOUND.pieces)
    pieces[number] = replace(pieces[number], **parts)
    return said(pieces)


def test_what_is_found_holds() -> None:
    """The threshold is at 1/(1 - 9/10 (1 - x)) = 3: x = 7/27."""
    assert said(FOUND.pieces) == []
    assert len(FOUND.pieces) == 2
    low, high = FOUND.pieces[0].high
    assert low <= F(7, 27) <= high


def test_each_rule_refuses_what_breaks_it() -> None:
    one, other = FOUND.pieces
    tops, below = one.values
    assert any("are not those that are optimal" in x for x in changed(0, values=other.values))
    assert any("is better" in x for x in said([replace(one, high=(F(1), F(1)))]))
    assert any("are not those that are optimal" in x for x in changed(0, optimal=other.optimal))
    negative = tuple(-top for top in tops), -below
    assert any("not positive" in x for x in changed(0, values=negative))
    more = tuple(top + below for top in tops), below
    assert any("are not those" in x for x in changed(0, values=more))
    assert any("the value at the start" in x for x in changed(1, start=((0, F(1)),)))
    assert any("the value at the start" in x for x in said(FOUND.pieces, sign=-1))
    outside = F(1, 20), F(1, 20)
    assert any("outside its section" in x for x in changed(0, low=outside))
    assert any("nothing proves" in x for x in changed(1, low=(F(1, 2), F(1, 2))))


def test_the_policy_held_fixed_has_its_own_rules() -> None:
    one, _ = FOUND.pieces
    assert one.fixed_values is not None
    tops, below = one.fixed_values
    assert any("has no value" in x for x in changed(0, fixed_values=None))
    assert any(
        "another value" in x
        for x in changed(0, fixed_values=(tuple(t + below for t in tops), below))
    )
    negative = tuple(-top for top in tops), -below
    assert any("fixed from" in x for x in changed(0, fixed_values=negative))
    assert said([replace(each, fixed_values=None) for each in FOUND.pieces], held=None) == []
    other = [[(1, to_flint(F(1)))], *MIX[1:]]
    assert any("another value" in x for x in said(FOUND.pieces, held=other))


@pytest.mark.parametrize("x", [F(0), F(1, 3), F(-5, 2)])
def test_a_ratio_has_its_value_and_derivative(x: F) -> None:
    """(2 + 4 x) (5 + x) / ((6 + 2 x) (5 + x)), and its derivative 20 / (6 + 2 x)²."""
    shared = fmpq_poly([5, 1])
    values = (fmpq_poly([2, 4]) * shared, fmpq_poly([0, 9])), fmpq_poly([6, 2]) * shared
    found = RationalFunction.of(((0, F(1)),), values)
    assert found.denominator[0] == 1
    assert len(found.numerator) == len(found.denominator) == 2
    assert found.at(x) == (2 + 4 * x) / (6 + 2 * x)
    assert found.slope(x) == F(20) / (6 + 2 * x) ** 2
    assert RationalFunction.of(((0, F(0)),), values).numerator == (0,)


# ---- lines that cross --------------------------------------------------------------------------


def lines(*values: Sequence[Any]) -> Family:
    """One step, in which action k pays a + b x + … for the k-th (a, b, …); the end is state 1."""

    def build(at: dict[str, F]) -> MDP:
        rows = []
        for action, line in enumerate(values):
            paid = sum((F(c) * at["x"] ** n for n, c in enumerate(line)), F(0))
            rows.append((0, action, [(1, 1, paid)]))
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])

    degree = max(len(line) for line in values) - 1
    return Family(parameters={"x": "1/2"}, build=build, degrees={"x": degree})


def piece(
    low: tuple[object, object],
    high: tuple[object, object],
    best: list[bool],
    worth: list[Any],
    section: Piece,
) -> CurvePiece:
    return CurvePiece(
        low=(F(low[0]), F(low[1])),
        high=(F(high[0]), F(high[1])),
        section=section,
        optimal=np.array([*best, False]),
        start=((0, F(1)),),
        values=((fmpq_poly([to_flint(F(c)) for c in worth]), fmpq_poly()), fmpq_poly([1])),
    )


WHOLE = Piece(low=F(0), high=F(1), origin=F(1, 2))


def refused(family: Family, *pieces: CurvePiece) -> list[str]:
    return list(piece_violations(family, "x", pieces, None, 1))


def test_one_threshold_may_lie_in_a_bracket_and_two_may_not() -> None:
    """1 - x, 1/2 and x: all turn at 1/2; where 1/2 becomes 9/16, at 7/16 and at 9/16."""
    near = F(3, 8), F(5, 8)
    one = piece((0, 0), near, [True, False, False], [1, -1], WHOLE)
    other = piece(near, (1, 1), [False, False, True], [0, 1], WHOLE)
    assert refused(lines((1, -1), ("1/2", 0), (0, 1)), one, other) == []
    assert refused(lines((1, -1), ("1/4", 0), (0, 1)), one, other) == []
    wrong = refused(lines((1, -1), ("9/16", 0), (0, 1)), one, other)
    assert [each.rpartition(" ")[0] for each in wrong] == ["nothing proves the optimum next to"]
    for narrow in ((F(1, 2), F(5, 8)), (F(3, 8), F(1, 2)), (F(1, 2), F(1, 2))):
        assert (
            refused(
                lines((1, -1), ("1/2", 0), (0, 1)),
                replace(one, high=narrow),
                replace(other, low=narrow),
            )
            == []
        )


def test_an_action_may_not_be_better_between_the_threshold_and_the_bracket() -> None:
    """x is passed at 1/2, 9/16 and 19/32, beyond 1/2 by an action that was not better before."""
    near = F(3, 8), F(5, 8)
    one = piece((0, 0), near, [True, False, False], [1, -1], WHOLE)
    other = piece(near, (1, 1), [False, True, False], [0, 1], WHOLE)
    for roots, sound in (
        ([F(1, 2), F(9, 16), F(19, 32)], False),
        ([F(1, 2), F(1, 4), F(1, 8)], True),
        ([F(1, 2), F(3, 2), F(5, 4)], True),
    ):
        short = prod((fmpq_poly([to_flint(-root), 1]) for root in roots), start=fmpq_poly([1]))
        third = fmpq_poly([0, 1]) - short / 8
        family = lines((1, -1), (0, 1), [from_flint(c) for c in third.coeffs()])
        said = refused(family, one, other)
        assert said == ["nothing proves the optimum next to 0.625"] * (not sound)


def test_no_action_may_be_better_up_to_the_threshold_within_the_bracket() -> None:
    """x - 1/2 passes 0 at 1/2, and (7/16 - x) (x - 1/2) is above 0 between 7/16 and 1/2."""
    near = F(3, 8), F(5, 8)
    one = piece((0, 0), near, [True, False, False], [0], WHOLE)
    other = piece(near, (1, 1), [False, True, False], ["-1/2", 1], WHOLE)
    for turn, sound in ((F(7, 16), False), (F(3, 4), True)):
        third = (-turn / 2, turn + F(1, 2), -1)
        said = refused(lines((0,), ("-1/2", 1), third), one, other)
        assert said == ["nothing proves the optimum next to 0.625"] * (not sound)


def test_pieces_of_a_section_join_and_are_of_its_values() -> None:
    family = lines((1, -1), (0, 1))
    near = F(3, 8), F(5, 8)
    one = piece((0, 0), near, [True, False], [1, -1], WHOLE)
    other = piece(near, (1, 1), [False, True], [0, 1], WHOLE)
    assert refused(family, one, other) == []
    gap = F(5, 8), F(3, 4)
    assert any("nothing proves" in x for x in refused(family, one, replace(other, low=gap)))
    for between in ((F(1, 8), F(1, 4)), (F(1, 4), F(3, 8))):  # not where the lines cross
        said = refused(family, replace(one, high=between), replace(other, low=between))
        assert said == ["a pair of state 0 is better from " + format_rational(between[1]) + " on"]
    late = F(3, 4), F(7, 8)
    said = refused(family, replace(one, high=late), replace(other, low=late))
    assert said == ["a pair of state 0 is better from 0 on"]
    assert any("outside" in x for x in refused(family, one, replace(other, high=(F(1), F(2)))))
    wide = replace(one, low=(F(0), F(1, 8)))
    assert any("nothing proves" in x for x in refused(family, wide, other))
    early = replace(one, low=(F(-1, 8), F(1, 8)))
    assert "the piece from 0.125 on is outside its section" in refused(family, early, other)
    point = replace(one, low=(F(1, 4), F(1, 4)), high=(F(1, 4), F(1, 4)))
    assert refused(family, point) == []
    both = replace(one, optimal=np.array([True, True, False]))
    assert any("are not those that are optimal" in x for x in refused(family, both, other))
    none = replace(one, optimal=np.array([False, False, False]))
    assert any("are not those that are optimal" in x for x in refused(family, none, other))


def test_sections_are_joined_at_points_where_values_may_turn() -> None:
    """The same lines, which cross at the very end of a section."""
    family = lines((1, -1), (0, 1))
    left = Piece(low=F(0), high=F(1, 2), origin=F(1, 4))
    right = Piece(low=F(1, 2), high=F(1), origin=F(3, 4))
    one = piece((0, 0), ("1/2", "1/2"), [True, False], [1, -1], left)
    other = piece(("1/2", "1/2"), (1, 1), [False, True], [0, 1], right)
    assert refused(family, one, other) == []
    ajar = replace(other, low=(F(1, 2), F(5, 8)))
    assert any("nothing proves" in x for x in refused(family, one, ajar))
    apart = replace(one, high=(F(3, 8), F(3, 8)))
    assert any("nothing proves" in x for x in refused(family, apart, other))
    mixed = replace(one, section=right)
    assert any("outside its section" in x for x in refused(family, mixed))


def test_rows_are_one_polynomial_inside_a_section() -> None:
    """A family that says where its formula may change: a section may end there, and not pass it."""
    one = piece((0, 0), (1, 1), [True], ["1/2", -1], WHOLE)
    for place, passed in (("0", False), ("1/2", True), ("1", False), ("3/2", False)):
        family = replace(lines(("1/2", -1)), breaks={"x": [place]})
        said = refused(family, one)
        assert said == ["rows pass to other polynomials inside a section"] * passed


# ---- runs that may never end, or miss the goal --------------------------------------------------


def pay_to_end(at: dict[str, F], **parts: Any) -> MDP:
    """At discount 1 each step costs 1: stay, end with chance x², or end at once for 3."""
    x = at["x"] ** 2
    rows = [
        (0, 0, [(1, 0, -1)]),
        (0, 1, [(p, to, -1) for p, to in ((x, 1), (1 - x, 0)) if p]),
        (0, 2, [(1, 1, -3)]),
        (1, 0, [(1, 1, 0)]),
    ]
    return MDP.from_outcomes(rows, 1, **parts)


COSTLY = Family(parameters={"x": "1/2"}, build=pay_to_end, degrees={"x": 2})
ENDLESS = [
    "nothing proves that an optimal policy from {} on ends",
    "the pairs of state 0 from {} on are not those that are optimal",
]
HELD_ENDLESS = "nothing proves that the policy held fixed ends from {} on"


def held(*pairs: int) -> list[list[tuple[int, Any]]]:
    return [[(pair, to_flint(F(1, len(pairs)))) for pair in pairs], [(3, to_flint(F(1)))]]


def test_a_policy_must_end_where_others_need_not() -> None:
    """1 / x² is 3 at √(1/3); half of it and half of 3 costs (1/2 + 3/2) / (1/2 + x² / 2)."""
    found = curve(COSTLY, "x", ("1/4", "1"), policy={"state 0": {"1": "1/2", "2": "1/2"}})
    one, other = found.pieces
    assert one.optimal.tolist() == [False, False, True, True]
    assert other.optimal.tolist() == [False, True, False, True]
    assert one.fixed is not None
    assert one.fixed.at(F(1, 3)) == -2 / (F(1, 2) + F(1, 18))

    def said(pieces: Sequence[CurvePiece], mix: Any) -> list[str]:
        return [*piece_violations(COSTLY, "x", pieces, mix, 1)]

    assert said(found.pieces, held(1, 2)) == []
    assert said(found.pieces, held(1)) != []
    from_ = format_rational(other.low[1])
    stay = replace(other, optimal=np.array([True, False, False, True]))
    assert said([one, stay], held(1, 2)) == [each.format(from_) for each in ENDLESS]
    wrong = said([replace(one, optimal=stay.optimal), other], held(1, 2))
    assert wrong == [each.format("0.25") for each in ENDLESS]
    assert HELD_ENDLESS.format("0.25") in said(found.pieces, held(0))
    assert HELD_ENDLESS.format(from_) in said(found.pieces, held(0))
    assert HELD_ENDLESS.format("0.25") not in said(found.pieces, held(0, 1))


def test_a_policy_must_end_at_the_very_ends_of_a_piece() -> None:
    """With chance x² it ends but at 0: whether 0 is where a piece begins, or where it ends.

    The brackets of both ends count.
    """
    for low, high, ends in ((0, F(1, 2), False), (F(-1, 2), 0, False), (F(1, 4), F(1, 2), True)):
        whole = Piece(low=F(low), high=F(high), origin=F(low + high) / 2)
        equations = SectionEquations(COSTLY, "x", whole)
        each = CurvePiece(
            low=(F(low), F(low) + F(1, 8)),
            high=(F(high) - F(1, 8), F(high)),
            section=whole,
            optimal=np.array([False, True, False, False]),
            start=((0, F(1)),),
            values=((fmpq_poly([-1]), fmpq_poly()), fmpq_poly([0, 0, 1])),
        )
        each = replace(each, fixed_values=each.values)
        equations.update_gaps(each.values)
        at = format_rational(F(low) + F(1, 8))
        optimal = [*_not_optimal(equations, each, set())]
        assert (ENDLESS[0].format(at) in optimal) == (not ends)
        fixed = [*_not_of(equations, each, held(1))]
        assert (HELD_ENDLESS.format(at) in fixed) == (not ends)
        assert (f"the denominator from {at} on is not positive" in optimal) == (not ends)
        refusal = f"the denominator of the policy held fixed from {at} on is not positive"
        assert (refusal in fixed) == (not ends)
        assert len(optimal) == len(fixed) == 2 * (not ends)
        other = "the policy held fixed has another value in state 0 from {} on"
        assert [*_not_of(equations, each, held(2))][-1] == other.format(at)


def test_averages_are_looked_at_where_a_transition_vanishes() -> None:
    """State 0 goes to a state of 3 for 5, or by the other action for 6 unless, with chance t, to 1.

    At t = 0, where both keep the gain, the second is better.
    """

    def build(at: dict[str, F]) -> MDP:
        t = at["t"]
        moves = [(c, to, 6) for c, to in ((1 - t, 1), (t, 2)) if c]
        rows = [(0, 0, [(1, 1, 5)]), (0, 1, moves), (1, 0, [(1, 1, 3)]), (2, 0, [(1, 2, 1)])]
        return MDP.from_outcomes(rows)

    equations = AverageEquations(Family(parameters={"t": "1/2"}, build=build), "t", WHOLE)
    numbers = [2, 0, 0, 3, 3, 1, 3]  # h, then g, then g at the start
    values = [fmpq_poly([number]) for number in numbers], fmpq_poly([1])
    equations.update_gaps(values)
    first = CurvePiece(
        low=(F(0), F(1, 8)),
        high=(F(1), F(1)),
        section=WHOLE,
        optimal=np.array([True, False, True, True]),
        start=equations.weigh_start(1),
        values=values,
    )
    said = ["nothing proves the optimum at t = 0, where a transition vanishes"]
    assert [*_not_optimal(equations, first, set())] == said
    beyond = replace(first, low=(F(1, 9), F(1, 8)))
    assert [*_not_optimal(equations, beyond, set())] == []


def test_a_terminal_state_is_worth_nothing() -> None:
    found = curve(lines((1, 2)), "x", (0, 1), policy=[0, 0])
    (one,) = found.pieces
    assert one.fixed_values is not None
    words = "a terminal state is worth something from 0 on"
    taken: Any = [[(0, to_flint(F(1)))], [(1, to_flint(F(1)))]]
    for worth in (fmpq_poly([1]), fmpq_poly([0, 1]), fmpq_poly()):
        told = [words] * (worth.degree() >= 0)
        more = (one.values[0][0], worth), one.values[1]
        assert refused(found.family, replace(one, values=more)) == told
        fixed = replace(one, fixed_values=more)
        assert [*piece_violations(found.family, "x", [fixed], taken, 1)] == told


def test_pairs_that_may_miss_the_goal_are_not_optimal_and_not_held() -> None:
    """Go to the goal with chance x and beside it otherwise, or to the goal for 3."""

    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        rows = [
            (0, 0, [(x, 1, -1), (1 - x, 2, -1)]),
            (0, 1, [(1, 1, -3)]),
            *((s, 0, [(1, s, 0)]) for s in (1, 2)),
        ]
        return MDP.from_outcomes(rows, 1, goal=[1], unreached=-inf, start=0)

    family = Family(parameters={"x": "1/2"}, build=build)
    found = curve(family, "x", ("1/4", "3/4"), policy=[1, 0, 0])
    (one,) = found.pieces
    rest: Any = [[(2, to_flint(F(1)))], [(3, to_flint(F(1)))]]
    for pair, wrong in ((1, []), (0, ["the policy held fixed may miss the goal from 0.25 on"])):
        taken = [[(pair, to_flint(F(1)))], *rest]
        assert [*piece_violations(family, "x", [one], taken, 1)] == wrong
    risky = replace(one, optimal=np.array([True, True, False, False]))
    words = "a pair by which a run may miss the goal counts as optimal from 0.25 on"
    assert words in piece_violations(family, "x", [risky], None, 1)
    assert found.at("1/2") == found.fixed_at("1/2") == -3


def test_a_polynomial_survives_being_pickled() -> None:
    for numbers in ([], [F(2, 3), F(0), F(-5, 7)], [F(4)]):
        poly = fmpq_poly([to_flint(c) for c in numbers])
        assert pickle.loads(pickle.dumps(poly)) == poly


def test_gaps_turn_at_once_where_they_share_their_only_root() -> None:
    def through(*numbers: F) -> fmpq_poly:
        return prod((fmpq_poly([to_flint(-n), 1]) for n in numbers), start=fmpq_poly([1]))

    half, third, bracket = F(1, 2), F(1, 3), (F(1, 4), F(3, 4))
    assert _turn_at_once([], bracket)
    assert _turn_at_once([through(half)], bracket)
    assert _turn_at_once([through(half), through(half, F(2)), through(F(5))], bracket)
    assert _turn_at_once([through(third, third), -through(half)], bracket)
    assert _turn_at_once([through(half, half, half)], bracket)
    assert not _turn_at_once([through(half), through(third)], bracket)
    assert not _turn_at_once([through(half, third)], bracket)
    assert not _turn_at_once([through(half, third), through(half)], bracket)
    assert not _turn_at_once([through(half, F(2)), through(third, F(2))], (F(1, 4), F(1)))


def test_a_ratio_is_that_of_the_weighed_states() -> None:
    """1/3 (x) - 2/3 (1 - x²) over 3 x: the first coefficient that is not 0 is made 1."""
    values = (fmpq_poly([0, 1]), fmpq_poly([1, 0, -1])), fmpq_poly([0, 3])
    found = RationalFunction.of(((0, F(1, 3)), (1, F(-2, 3))), values)
    assert found.denominator == (0, 1)
    assert found.numerator == (F(-2, 9), F(1, 9), F(2, 9))
    assert found.at(F(2)) == (F(2, 3) - F(2, 3) * (1 - 4)) / 6


def test_the_value_of_a_piece_is_that_of_its_start() -> None:
    one = FOUND.pieces[0]
    assert one.fixed is not None
    for x in (F(1, 8), F(1, 5)):
        wait = 1 / (1 - F(9, 10) * (1 - x))
        assert one.fixed.at(x) == wait / 2 + (x / 2 + F(9, 20) * wait) / F(11, 20) / 2
        assert one.value.at(x) == wait / 2 + (x / 2 + F(9, 20) * wait) / F(11, 20) / 2
    assert replace(one, fixed_values=None).fixed is None


def test_a_degree_that_was_tested_at_some_points_is_no_proof() -> None:
    line = curve(build({"x": F(1, 2)}), "discount", ("1/10", "4/5"))
    for found, name, known in ((line, "discount", True), (FOUND, "x", False)):
        assert (found.checked is None) == known
        said = [*piece_violations(found.family, name, found.pieces, None, 1, proven=True)]
        assert said == ["the degree of the rows was tested at some points, not proven"] * (
            not known
        )
