"""Pieces of a range: values as polynomials of a policy, and thresholds that lie close together."""

from collections.abc import Sequence
from fractions import Fraction as F
from itertools import islice, pairwise
from math import inf, prod
from operator import mul
from random import Random
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from curved_models import KINDS, curved_model
from flint import fmpq_poly
from oracle import policy_values, rows_of

from exact_mdp import MDP, Family, curve, parametric
from exact_mdp.analysis.vary.curves import walk
from exact_mdp.analysis.vary.curves.average_equations import AverageEquations
from exact_mdp.analysis.vary.curves.curve import ValueFunction
from exact_mdp.analysis.vary.curves.equations import SectionEquations
from exact_mdp.analysis.vary.curves.roots import Root, isolate_roots
from exact_mdp.analysis.vary.curves.walk import (
    Sweep,
    _bound_degree,
    _build_section_equations,
    _find_earlier_root,
    _interpolate_values,
    _require_finite_values,
    compute_policy_values,
    find_best_average,
    find_optimal_pairs,
    make_improper_error,
)
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import from_flint, to_flint
from exact_mdp.mdp.parametric.row_change import Piece


def ring(at: dict[str, F]) -> MDP:
    """Two states, both with a pair of rows that move with x; the discount may move as well."""
    x = at["x"]
    rows = [
        (0, 0, [(x, 1, 1), (1 - x, 0, 2 * x)]),
        (1, 0, [(F(1, 4) + x / 2, 0, -x), (F(3, 4) - x / 2, 1, 3)]),
        (1, 1, [(1, 0, 5 * x - 1)]),
    ]
    return MDP.from_outcomes(rows, at.get("g", F(3, 5)))


@pytest.mark.parametrize("shares", [(F(1), F(0)), (F(0), F(1)), (F(1, 3), F(2, 3))])
@pytest.mark.parametrize("name", ["x", "discount"])
def test_values_of_a_policy_are_ratios_of_polynomials(name: str, shares: tuple[F, F]) -> None:
    family = Family(parameters={"x": "1/2"}, build=ring, degrees={"x": 2})
    if name == "discount":
        family = parametric(ring({"x": F(1, 2)}))
    section = Piece(low=F(1, 10), high=F(9, 10), origin=F(1, 2))
    equations = SectionEquations(family, name, section)
    held = [[(0, to_flint(F(1)))], [(1 + k, to_flint(p)) for k, p in enumerate(shares) if p]]
    tops, below = compute_policy_values(equations, held)
    for k in range(1, 10):
        place = F(k, 10)
        mdp = family.at({name: place})
        rows = rows_of(mdp)
        mean = (1, 0, shares[0] * rows[1][2] + shares[1] * rows[2][2],
                {t: shares[0] * rows[1][3].get(t, F(0)) + shares[1] * rows[2][3].get(t, F(0))
                 for t in (0, 1)})  # fmt: skip
        wanted = policy_values([rows[0], mean], mdp.discount_exact)
        d = below(to_flint(place))
        assert d > 0
        assert [from_flint(top(to_flint(place)) / d) for top in tops] == wanted


@pytest.mark.parametrize("kind", KINDS)
def test_values_of_every_policy_are_ratios_of_polynomials(kind: str) -> None:
    """Of three or four states, with the discount that moves beside rows and rewards."""
    for seed in range(4):
        model = curved_model(seed, kind)
        section = Piece(low=F(0), high=F(1), origin=F(3, 7))
        equations = SectionEquations(model.family(degree=3), "t", section)
        for policy in islice(model.policies(), 3):
            held = [[(pair, to_flint(F(1)))] for pair in policy]
            tops, below = compute_policy_values(equations, held)
            for t in (F(0), F(2, 9), F(4, 5), F(1)):
                scale = from_flint(below(to_flint(t)))
                assert scale > 0
                values = [from_flint(top(to_flint(t))) / scale for top in tops]
                assert values == model.value(policy, t)


@pytest.mark.parametrize("moves", ["rewards", "rows"])
def test_a_discount_may_move_with_rewards_or_with_rows(moves: str) -> None:
    """Earn x and stay with 1/2, or earn 1 and stay with x, at discount x / 2."""

    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        earned, stay = (x, F(1, 2)) if moves == "rewards" else (F(1), x)
        return MDP.from_outcomes(
            [(0, 0, [(stay, 0, earned), (1 - stay, 1, earned)]), (1, 0, [(1, 0, 3)])], x / 2
        )

    family = Family(parameters={"x": "1/2"}, build=build, degrees={"x": 2})
    equations = _build_section_equations(family, "x", F(1, 9), F(8, 9))
    tops, below = compute_policy_values(equations, [[(k, to_flint(F(1)))] for k in range(2)])
    for x in (F(1, 9), F(1, 3), F(5, 7)):
        values = [from_flint(top(to_flint(x)) / below(to_flint(x))) for top in tops]
        assert values == policy_values(rows_of(family.at({"x": x})), x / 2)


def test_gains_and_relative_values_solve_the_equations_of_a_policy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """g = P g and g + h = r + P h, with h = 0 in the first state of each recurrent class.

    No other g and h solve these (Puterman, Markov Decision Processes, 1994, theorem 8.2.6). From
    two of five states, in any order, a run comes to one state, or to two, and stays there.
    """
    apart = 0
    for seed in range(12):
        rng = Random(seed)
        a, b, c, d, e = rng.sample(range(5), 5)
        ends = [(a, [a]), (b, [b, c]), (c, [b, c]), (d, [a, e]), (d, [b, d, e])]
        ends.append((e, rng.choice([[b, c], [a, c, d]])))
        laws = [[{to: F(rng.randint(1, 3)) for to in each} for _ in "12"] for _, each in ends]
        earned = [rng.randint(-3, 3) for _ in ends]

        def build(
            at: dict[str, F], ends: Any = ends, laws: Any = laws, earned: Any = earned
        ) -> MDP:
            t, rows = at["t"], list[Any]()
            for k, (state, _) in enumerate(ends):
                one, other = (
                    {to: w / sum(law.values()) for to, w in law.items()} for law in laws[k]
                )
                law = [((1 - t) * one[to] + t * other[to], to, earned[k] * t - k) for to in one]
                rows.append((state, k, law))
            return MDP.from_outcomes(rows, start={"state 0": "1/3", "state 1": "2/3"})

        family = Family(parameters={"t": "1/2"}, build=build)
        equations = AverageEquations(family, "t", Piece(low=F(0), high=F(1), origin=F(1, 2)))
        policy = [
            [(pair, F(1, len(pairs))) for pair in pairs] for pairs in equations.pairs.values()
        ]
        held = [[(pair, to_flint(w)) for pair, w in each] for each in policy]
        # States from which both classes can be reached have two equations.
        twice = sum(equations.label_classes(held)[1] < 0)
        monkeypatch.setattr(walk, "LARGEST", 5 + twice)
        numbers, below = compute_policy_values(equations, held)
        apart += twice
        for t in (F(1, 3), F(2, 5)):
            rows, scale = rows_of(family.at({"t": t})), from_flint(below(to_flint(t)))
            assert scale > 0
            values = [from_flint(each(to_flint(t))) / scale for each in numbers]
            h, g, start = values[:5], values[5:10], values[10]
            for state, each in enumerate(policy):
                chances = [sum(w * rows[pair][3].get(to, F(0)) for pair, w in each)
                           for to in range(5)]  # fmt: skip
                reward = sum(w * rows[pair][2] for pair, w in each)
                assert g[state] == sum(map(mul, chances, g))
                assert g[state] + h[state] == reward + sum(map(mul, chances, h))
            assert h[a] == h[min(b, c)] == 0
            assert start == g[0] / 3 + g[1] * 2 / 3
    assert 12 < apart < 24


def test_values_along_the_discount_alone_are_ratios_of_polynomials() -> None:
    for seed in range(4):
        mdp = curved_model(seed, "cyclic").family("1/3").at({})
        section = Piece(low=F(1, 4), high=F(3, 4), origin=F(1, 2))
        equations = SectionEquations(parametric(mdp), "discount", section)
        policy = mdp.pair_offsets[:-1].tolist()
        tops, below = compute_policy_values(equations, [[(l, to_flint(F(1)))] for l in policy])
        for rate in (F(1, 4), F(2, 5), F(3, 4)):
            scale = from_flint(below(to_flint(rate)))
            assert scale > 0
            values = [from_flint(top(to_flint(rate))) / scale for top in tops]
            assert values == policy_values(rows_of(mdp, policy), rate)


@pytest.mark.parametrize("apart", [F(1, 100), F(1, 10**15), F(1, 10**25)])
def test_thresholds_that_lie_close_together_are_both_found(apart: F) -> None:
    """Three lines whose upper envelope turns at 0 and at `apart`, however close that is."""

    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        rows = [(0, 0, [(1, 1, -x)]), (0, 1, [(1, 1, 0)]), (0, 2, [(1, 1, x - apart)])]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])

    found = curve(Family(parameters={"x": 0}, build=build), "x", (-1, 1))
    assert found.violations() == []
    assert [each.optimal[:3].tolist() for each in found.pieces] == [
        [True, False, False], [False, True, False], [False, False, True]]  # fmt: skip
    first, second = found.pieces[0].high, found.pieces[1].high
    assert first[0] <= 0 <= first[1] <= second[0] <= apart <= second[1]


# ---- pieces of random families -----------------------------------------------------------------

Line = Sequence[object]  # coefficients of x, from the constant up


def paying(*states: Sequence[Line], sense: str = "max") -> Family:
    """In each state one choice among polynomials of x, which are earned at once; then the end."""
    end = len(states)

    def build(at: dict[str, F]) -> MDP:
        rows = [
            (s, k, [(1, end, sum((F(c) * at["x"] ** n for n, c in enumerate(line)), F(0)))])
            for s, lines in enumerate(states)
            for k, line in enumerate(lines)
        ]
        start = {s: F(2 * s + 2, end * (end + 1)) for s in range(end)}
        return MDP.from_outcomes([*rows, (end, 0, [(1, end, 0)])], start=start, sense=sense)

    degree = max(len(line) for lines in states for line in lines) - 1
    return Family(parameters={"x": "1/2"}, build=build, degrees={"x": max(degree, 1)})


def check(family: Family, low: object, high: object) -> ValueFunction:
    """The pieces are proved by the checker, cover the range, and are no more than needed."""
    found = curve(family, "x", (low, high), policy=[0] * family.at({}).n_states)
    assert found.violations() == []
    assert found.pieces[0].low == (F(low), F(low))
    assert found.pieces[-1].high == (F(high), F(high))
    for one, other in pairwise(found.pieces):
        assert one.high == other.low
        assert 0 < one.high[1] - one.high[0] <= F(1, 10**12)
        assert (one.optimal != other.optimal).any()
    return found


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("seed", range(6))
def test_the_best_of_random_polynomials_is_followed(seed: int, sense: str) -> None:
    rng = np.random.default_rng(seed)
    states = [rng.integers(-6, 7, (n, 4)).tolist() for n in (4, 2, 5)]
    states[1].append(states[1][0])  # an action that is as good as another one
    found = check(paying(*states, sense=sense), "-3/2", "5/3")
    best = min if sense == "min" else max
    for x in (F(k, 9) for k in range(-13, 15)):
        worth = [best(sum(c * x**n for n, c in enumerate(line)) for line in each)
                 for each in states]  # fmt: skip
        assert found.at(x) == worth[0] / 6 + worth[1] / 3 + worth[2] / 2


@pytest.mark.parametrize(
    ("states", "turns"),
    [
        ([[[0], [-1, 0, 2]], [[0], [1, 0, -2]]], [F(0.7071067811865476)]),  # the same root, twice
        ([[[0], [-1, 3]], [[0], [-2, 6]], [[0, 0], [-1, 2]]], [F(1, 3), F(1, 2)]),
        ([[[0], [-1, 6, -9]]], []),  # is as good at 1/3 alone
        ([[[0], [F(1, 27), F(-1, 3), 1, -1]]], [F(1, 3)]),  # a root three times over
        ([[[0], [-1, 100000]]], [F(1, 100000)]),  # next to where the range begins
        ([[[0], [-99999, 100000]]], [F(99999, 100000)]),
        ([[[0], [0, 1]]], []),  # at the very end of the range
        ([[[0], [0]], [[1], [0]]], []),
        ([[[0], [0, -1, 100000]]], [F(1, 100000)]),  # as good at 0, too
        ([[[0], [-1, 0, 2]], [[0], [F(-707, 1000), 1]]], [F(707, 1000), F(0.7071067811865476)]),
    ],
)
def test_thresholds_are_the_roots_at_which_signs_change(
    states: list[list[Line]], turns: list[F]
) -> None:
    found = check(paying(*states), 0, 1)
    assert len(found.pieces) == len(turns) + 1
    for each, turn in zip(found.pieces, turns, strict=False):
        assert abs(each.high[0] - turn) < F(1, 10**12)


def test_a_point_next_to_the_middle_is_used_where_a_chance_is_0_there() -> None:
    for low, high in ((F(0), F(1)), (F(1, 4), F(3, 4)), (F(2, 5), F(3, 5))):
        shares = [F(1, 2), F(37, 97), F(38, 99), F(39, 101)]
        zeros = [low + (high - low) * share for share in shares]
        for many in (0, 1, 2, 3):

            def chance(x: F, roots: list[F] = zeros[:many]) -> F:
                return F(1, 2) * prod(((x - zero) ** 2 for zero in roots), start=F(1))

            def build(at: dict[str, F], chance: Any = chance) -> MDP:
                p = chance(at["x"]) * (1 + at["x"]) / 2
                rows = [(0, 0, [(p, 0, 1), (1 - p, 1, 1)]), (1, 0, [(1, 1, 0)])]
                return MDP.from_outcomes(rows, "1/2")

            family = Family(parameters={"x": "9/20"}, build=build, degrees={"x": 7})
            equations = _build_section_equations(family, "x", low, high)
            origin = equations.change.piece.origin
            assert low < origin < high
            assert chance(origin) > 0
            assert (equations.low, equations.high) == (low, high)
            assert origin == zeros[many]


# ---- parts of the walk -------------------------------------------------------------------------


def factored(*numbers: F) -> fmpq_poly:
    return prod((fmpq_poly([to_flint(-n), 1]) for n in numbers), start=fmpq_poly([1]))


def test_the_earlier_of_two_roots_is_the_smaller() -> None:
    rng = np.random.default_rng(5)
    for _ in range(60):
        a, b, c, d = (F(int(k), 997) for k in rng.choice(np.arange(1, 997), 4, replace=False))
        one = next(r for r in isolate_roots(factored(a, c), F(0), F(1)))
        other = next(r for r in isolate_roots(factored(b, d), F(0), F(1)))
        wanted = one if min(a, c) < min(b, d) else other
        assert _find_earlier_root(one, other).is_of(wanted.poly)
        assert _find_earlier_root(other, one).is_of(wanted.poly)


def test_of_equal_roots_the_one_known_better_is_the_earlier() -> None:
    square = fmpq_poly([-2, 0, 1])
    wide = Root(poly=square, low=F(1), high=F(2))
    close = Root(poly=square * fmpq_poly([-3, 1]), low=F(7, 5), high=F(3, 2))
    assert _find_earlier_root(wide, close) is close
    assert _find_earlier_root(close, wide) is close
    alike = Root(poly=square * fmpq_poly([-5, 1]), low=F(1), high=F(2))
    assert _find_earlier_root(wide, alike) is wide
    point = Root(poly=factored(F(1, 2)), low=F(1, 2), high=F(1, 2))
    around = Root(poly=factored(F(1, 2), F(-5)), low=F(0), high=F(1))
    assert _find_earlier_root(point, around) is point
    assert _find_earlier_root(around, point) is point
    beyond = Root(poly=factored(F(3, 4)), low=F(1, 2), high=F(1))
    assert _find_earlier_root(point, beyond) is point
    assert _find_earlier_root(beyond, point) is point
    # Ends of an interval do not belong to it, also if they are roots.
    for ends in (F(0), F(1)):
        within = Root(poly=factored(ends, F(1, 2)), low=F(0), high=F(1))
        at_end = Root(poly=factored(ends), low=ends, high=ends)
        smaller = within if ends else at_end
        assert _find_earlier_root(within, at_end) is smaller
        assert _find_earlier_root(at_end, within) is smaller
    for number in (F(1, 4), F(3, 4)):
        other = Root(poly=factored(number), low=F(0), high=F(1))
        smaller = min(number, F(1, 2))
        assert _find_earlier_root(other, point).is_of(factored(smaller))
        assert _find_earlier_root(point, other).is_of(factored(smaller))


def sweep_of(family: Family, low: F, high: F) -> Sweep:
    return Sweep(_build_section_equations(family, "x", low, high), None, 1)


def test_brackets_are_decimals_around_a_root_within_what_is_left() -> None:
    sweep = sweep_of(paying([[0], [-1, 2]]), F(0), F(1))
    square = fmpq_poly([-1, 0, 2])
    for root, true in (
        (Root(poly=square, low=F(0), high=F(1)), None),
        (Root(poly=factored(F(1, 4)), low=F(1, 4), high=F(1, 4)), F(1, 4)),
    ):
        for k, (low, high) in enumerate(islice(sweep._yield_narrowing_brackets(root, F(0)), 4)):
            unit = F(1, 10 ** (13 + 3 * k))
            assert high - low <= 2 * unit
            assert (low / unit).denominator == (high / unit).denominator == 1
            if true is None:
                assert 2 * low**2 < 1 < 2 * high**2
            else:
                assert (low, high) == (true - unit, true + unit)
    quarter = Root(poly=factored(F(1, 4)), low=F(1, 4), high=F(1, 4))
    here = F(1, 4) - F(1, 10**16)
    low, _ = next(sweep._yield_narrowing_brackets(quarter, here))
    assert low == F(1, 4) - F(1, 10**19)
    sweep.high = F(1, 4) + F(1, 10**16)
    _, high = next(sweep._yield_narrowing_brackets(quarter, F(0)))
    assert high == F(1, 4) + F(1, 10**19)


def test_brackets_are_two_decimals_apart_at_most() -> None:
    sweep = sweep_of(paying([[0], [-1, 2]]), F(0), F(1))
    for number in range(2, 40):
        square = Root(poly=fmpq_poly([-number, 0, 50]), low=F(0), high=F(1))
        for k, (low, high) in enumerate(islice(sweep._yield_narrowing_brackets(square, F(0)), 3)):
            assert high - low in (F(1, 10 ** (13 + 3 * k)), F(2, 10 ** (13 + 3 * k)))
            assert 50 * low**2 <= number <= 50 * high**2


def test_brackets_that_never_separate_two_thresholds_are_given_up() -> None:
    """Of brackets that always hold both 1/3 and 1/2, 400 are looked at."""
    sweep = sweep_of(paying([[0], [-1, 3]], [[0], [-1, 2]]), F(0), F(1))
    sweep._follow_policy(np.array([0, 2, 4]))
    third = Root(poly=factored(F(1, 3)), low=F(1, 3), high=F(1, 3))
    brackets = iter([(F(1, 4), F(3, 4))] * 500)
    with pytest.raises(RuntimeError, match="cannot be separated"):
        sweep._cross_root(third, brackets)
    assert len([*brackets]) == 100
    assert sweep.policy.tolist() == [0, 2, 4]


def test_a_bracket_holds_no_other_threshold_and_no_gap_that_turns_twice() -> None:
    """At 1/3 state 0 takes its second action; that of state 1 is better from 2/5 to 3/5."""
    sweep = sweep_of(paying([[0], [-1, 3]], [[0], [F(-6, 25), 1, -1]]), F(0), F(1))
    for wide in (True, False):
        sweep._follow_policy(np.array([0, 2, 4]))
        root = sweep._find_next_root(F(1, 10))
        assert root is not None
        brackets = [(F(1, 4), F(3, 4))] * wide + [(F(1, 4), F(7, 20))]
        assert sweep._cross_root(root, iter(brackets)) == (F(1, 4), F(7, 20))
        assert sweep.policy.tolist() == [1, 2, 4]


def test_the_first_policy_is_looked_for_ever_closer_to_the_lower_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sweep = sweep_of(paying([[0], [-1, 2]]), F(100), F(101))
    cross, seen = sweep._cross_root, []

    def note(root: Root, brackets: Any) -> Any:
        seen.append([*islice(brackets, 9)])
        return cross(root, iter(seen[-1]))

    monkeypatch.setattr(sweep, "_cross_root", note)
    (piece,) = sweep.yield_pieces(np.array([0, 2]))
    assert piece.optimal.tolist() == [False, True, True]
    (first,) = seen
    assert [low for low, _ in first] == [100] * 9
    assert all(100 < later < sooner < 101 for (_, sooner), (_, later) in pairwise(first))


def test_roots_of_the_best_gaps_are_near_where_their_intervals_meet() -> None:
    """A root is near a bracket if its interval meets it, at an end at least; also if unknown."""
    sweep = sweep_of(paying([[0], [1, 1], [2, 1]]), F(0), F(1))
    sweep._follow_policy(np.array([2, 3]))
    third = Root(poly=factored(F(1, 3)), low=F(1, 3), high=F(1, 3))
    wide = Root(poly=factored(F(2, 3)), low=F(5, 8), high=F(3, 4))
    for low, high, near in (
        (F(0), F(1, 4), []),
        (F(0), F(1, 3), [0]),
        (F(1, 3), F(1, 2), [0]),
        (F(2, 5), F(1, 2), []),
        (F(2, 5), F(5, 8), [0]),
        (F(3, 4), F(1), [0]),
        (F(7, 8), F(1), []),
    ):
        sweep.ahead = {0: [third, wide], 1: []}
        assert sweep._find_near_pairs(low, high) == near
        sweep.ahead = {0: [third, wide]}
        assert sweep._find_near_pairs(low, high) == [*near, 1]


def test_roots_ahead_are_those_beyond_a_point() -> None:
    """x (x - 1/4) (x - 1/2)² (x - 3/4): signs change at 1/4 and 3/4 inside."""
    gap = factored(F(0), F(1, 4), F(1, 2), F(1, 2), F(3, 4))
    sweep = sweep_of(paying([[0], [from_flint(-c) for c in gap.coeffs()]]), F(0), F(1))
    sweep._follow_policy(np.array([0, 2]))
    assert sweep._find_roots(0, F(0)) == []
    for here, wanted in ((F(0), [F(1, 4), F(3, 4)]), (F(1, 3), [F(3, 4)]), (F(4, 5), [])):
        sweep.ahead.clear()
        for _ in range(2):
            found = sweep._find_roots(1, here)
            assert len(found) == len(wanted)
            for root, number in zip(found, wanted, strict=True):
                assert root.low <= number <= root.high <= root.low + F(1, 100)
            first = sweep._find_next_root(here)
            if wanted:
                assert first is not None
                assert first.is_of(factored(wanted[0]))
            else:
                assert first is None
    # What is known from farther left is found anew beyond its first root.
    sweep.ahead.clear()
    assert len(sweep._find_roots(1, F(0))) == 2
    assert len(sweep._find_roots(1, F(1, 2))) == 1


def test_the_best_action_of_a_state_is_taken_first(monkeypatch: pytest.MonkeyPatch) -> None:
    sweep = sweep_of(paying([[0], [3], [1]], [[0], [1]], [[5], [2]]), F(0), F(1))
    followed, follow = list[list[int]](), sweep._follow_policy

    def note(policy: Any) -> None:
        followed.append(policy.tolist())
        follow(policy)

    monkeypatch.setattr(sweep, "_follow_policy", note)
    note(np.array([0, 3, 5, 7]))
    sweep._improve_policy(F(1, 4), F(1, 2))
    assert followed == [[0, 3, 5, 7], [1, 4, 5, 7]]
    assert sweep.policy.tolist() == [1, 4, 5, 7]


# ---- degrees, points and refusals --------------------------------------------------------------


def test_the_degree_is_the_sum_of_the_greatest_of_each_state(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """3 of state 0 (a reward of its second pair), 1 of state 1 (a chance), 0 of state 2."""

    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        rows = [
            (0, 0, [(1, 1, 2)]),
            (0, 1, [(1, 0, x**3)]),
            (1, 0, [(x, 0, 0), (1 - x, 2, 0)]),
            (2, 0, [(1, 1, 1)]),
        ]
        return MDP.from_outcomes(rows, "1/2")

    family = Family(parameters={"x": "1/2"}, build=build, degrees={"x": 3})
    equations = _build_section_equations(family, "x", F(0), F(1))
    assert (walk.LARGEST, walk.CYCLIC_DEGREE) == (300, 200)
    assert _bound_degree(equations) == 4
    assert [_bound_degree(equations, [state]) for state in range(3)] == [7, 5, 4]
    for twice, states, degree in (([], 3, 4), ([0], 4, 7), ([0, 2], 5, 7)):
        monkeypatch.setattr(walk, "LARGEST", states)
        monkeypatch.setattr(walk, "CYCLIC_DEGREE", degree)
        assert _bound_degree(equations, twice) == degree
        monkeypatch.setattr(walk, "CYCLIC_DEGREE", degree - 1)
        what = f"{states} states on cycles give rational functions of degree {degree}"
        with pytest.raises(ModelError, match=what) as refused:
            _bound_degree(equations, twice)
        fix = f"thresholds are exact up to degree {degree - 1}; use a smaller model"
        assert (refused.value.where, refused.value.fix) == ("parameter x", fix)
        monkeypatch.setattr(walk, "LARGEST", states - 1)
        with pytest.raises(ModelError, match=f"{states} states with cycles among them") as refused:
            _bound_degree(equations, twice)
        fix = f"with cycles, use at most {states - 1} states that are not terminal"
        assert (refused.value.where, refused.value.fix) == ("parameter x", fix)


def test_values_are_interpolated_from_points_inside_the_section() -> None:
    """v0 = x + q v1, v1 = 1 + q v0 with q = x / 2: D = 1 - q², N = (x + q, 1 + q x)."""
    seen = []

    def chance(at: Any) -> Any:
        seen.append(from_flint(at))
        return at / 2

    section: Any = SimpleNamespace(low=F(1, 3), high=F(5, 3))
    entries: Any = [(1, chance), (2, chance)]
    tops, below = _interpolate_values(section, 2, entries, [fmpq_poly([0, 1]), fmpq_poly([1])])
    assert below == fmpq_poly([1, 0, to_flint(F(-1, 4))])
    assert tops == [fmpq_poly([0, to_flint(F(3, 2))]), fmpq_poly([1, 0, to_flint(F(1, 2))])]
    assert len({*seen}) == 3
    assert all(F(1, 3) < x < F(5, 3) for x in seen)


@pytest.mark.parametrize("zeros", [(1, 2), (2, 3), (1, 3)])
def test_points_at_which_a_policy_stays_forever_are_left_out(zeros: tuple[int, int]) -> None:
    """v = 1 / ((x - a) (x - b)), where a and b are two of the points from 1 to 5 that are tried."""
    section: Any = SimpleNamespace(low=F(0), high=F(4))
    roots = factored(*map(F, zeros))
    tops, below = _interpolate_values(section, 2, [(0, 1 - roots)], [fmpq_poly([1])])
    assert (tops, below) == ([1], roots)
    with pytest.raises(RuntimeError, match="a policy that never ends has no values"):
        _interpolate_values(section, 2, [(0, fmpq_poly([1]))], [fmpq_poly([1])])


def test_without_cycles_values_are_polynomials() -> None:
    """Half of each pair: 1/2 (x + 3/4 (2 x - 1)) + 1/2 2."""

    def build(at: dict[str, F]) -> MDP:
        rows = [
            (0, 0, [(1, 1, at["x"])]),
            (0, 1, [(1, 2, 2)]),
            (1, 0, [(1, 2, 2 * at["x"] - 1)]),
            (2, 0, [(1, 2, 0)]),
        ]
        return MDP.from_outcomes(rows, "3/4")

    equations = _build_section_equations(
        Family(parameters={"x": "1/2"}, build=build), "x", F(0), F(1)
    )
    held = [[(0, to_flint(F(1, 3))), (1, to_flint(F(2, 3)))], [(2, to_flint(F(1)))], []]
    tops, below = compute_policy_values(equations, held)
    assert below == 1
    assert tops[0] == fmpq_poly([to_flint(F(13, 12)), to_flint(F(5, 6))])
    assert tops[1:] == [fmpq_poly([-1, 2]), fmpq_poly()]


def test_where_values_may_be_infinite_is_said_with_the_ways_out() -> None:
    plain, both = make_improper_error("here"), make_improper_error("there", beside=True)
    assert plain.where == "the total at discount 1, here"
    assert "some policy never ends" in plain.what
    assert "within(N)" in plain.fix
    assert "every run ends for sure" in plain.fix
    assert "outside the goal" in both.what
    assert "within(N)" not in both.fix
    assert "every run ends at the goal" in both.fix
    assert "range" not in make_improper_error("here", ranges=False).fix

    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(at["x"], 1, 1), (1 - at["x"], 0, 1)]), (0, 1, [(1, 0, 0)])]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], 1)

    with pytest.raises(ModelError, match="never ends"):
        curve(Family(parameters={"x": "1/2"}, build=build), "x", ("1/4", "3/4"))


def test_a_model_gives_an_optimal_pair_of_every_state() -> None:
    """Two states without an end, of 2 and 3 pairs; the second begins the better loop."""
    rows = [
        (0, 0, [(1, 0, 1)]),
        (0, 1, [(1, 1, 0)]),
        (1, 0, [(1, 0, 0)]),
        (1, 1, [(1, 1, 4)]),
        (1, 2, [(1, 1, 4)]),
    ]
    pairs, start = find_optimal_pairs(MDP.from_outcomes(rows, "1/2", start=0))
    assert pairs.tolist() == [1, 3]
    assert start.value == 4


def test_a_model_gives_a_pair_of_every_state_with_the_best_average() -> None:
    """State 0 earns 1 by staying, or nothing on the way to 3; of two pairs one earns more."""
    rows = [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 2)]), (1, 1, [(1, 1, 3)])]
    pairs, start = find_best_average(MDP.from_outcomes(rows, "1/2", start=0))
    assert pairs.tolist() == [1, 3]
    assert start.value == 3


def leaving(zeros: Sequence[tuple[object, int]], *, at_once: bool) -> Family:
    """With chance ∏ (t - zero)^n / 9, state 0 is left, where each step earns 1, for steps of 2.

    If `at_once`, it may be left for sure, too, for nothing.
    """

    def build(at: dict[str, F]) -> MDP:
        p = abs(prod(((at["t"] - F(zero)) ** n for zero, n in zeros), start=F(1))) / 9
        rows: list[Any] = [(0, 0, [(c, to, 1) for c, to in ((1 - p, 0), (p, 1)) if c])]
        if at_once:
            rows.append((0, 1, [(1, 1, 0)]))
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 2)])])

    return Family(parameters={"t": "1/5"}, build=build, degrees={"t": sum(n for _, n in zeros)})


@pytest.mark.parametrize(
    ("zeros", "place"),
    [
        ([(0, 1)], "t = 0"),
        ([(1, 1)], "t = 1"),
        ([(0, 1), (1, 1)], "t = 0"),
        ([("1/3", 2)], "t ≈ 0.333333"),
        ([("1/4", 2), ("2/3", 2)], "t = 0.25"),
        ([("1/4", 2), (1, 1)], "t = 1"),
        ([(-1, 1), (2, 1)], None),
    ],
)
def test_a_policy_may_not_begin_to_stay_in_the_range_of_an_average(
    zeros: list[tuple[object, int]], place: str | None
) -> None:
    """Where state 0 is left, the average is 2, by the best policy and by the one held fixed."""
    for at_once, policy in ((False, None), (True, [0, 0])):
        family = leaving(zeros, at_once=at_once)
        if place is None:
            found = curve(family, "t", (0, 1), policy=policy, criterion="average")
            assert (found.at("1/2"), found.violations()) == (2, [])
            continue
        with pytest.raises(ModelError, match="may stay forever are others: the average") as refused:
            curve(family, "t", (0, 1), policy=policy, criterion="average")
        assert (refused.value.where, refused.value.fix) == (
            place, "choose a range without this value")  # fmt: skip
    # The best policy leaves at once.
    best = curve(leaving(zeros, at_once=True), "t", (0, 1), criterion="average")
    assert (best.at(0), best.at("1/3"), best.violations()) == (2, 2, [])


def test_a_policy_may_not_begin_to_stay_at_its_threshold_either() -> None:
    """1 by staying, or 2 t after state 0 is left with chance y² (y² + 1/100), y = t - 1/2.

    The second is better from 1/2 on, but at 1/2 it stays for nothing.
    """

    def build(at: dict[str, F]) -> MDP:
        y = at["t"] - F(1, 2)
        p = y**2 * (y**2 + F(1, 100))
        moves = [(c, to, 0) for c, to in ((1 - p, 0), (p, 1)) if c]
        rows = [(0, 0, [(1, 0, 1)]), (0, 1, moves), (1, 0, [(1, 1, 2 * at["t"])])]
        return MDP.from_outcomes(rows, start=0)

    family = Family(parameters={"t": "1/5"}, build=build, degrees={"t": 4})
    with pytest.raises(ModelError, match="the average may jump") as refused:
        curve(family, "t", (0, 1), criterion="average")
    assert refused.value.where == "t ≈ 0.5"
    assert curve(family, "t", (0, "2/5"), criterion="average").at("1/5") == 1
    assert curve(family, "t", ("3/5", 1), criterion="average").at("4/5") == F(8, 5)


def test_rows_may_turn_at_a_breakpoint_and_nowhere_else() -> None:
    """|x - 1/2| or 1/4: thresholds at 1/4 and 3/4, and sections that meet at 1/2."""

    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(1, 1, abs(at["x"] - F(1, 2)))]), (0, 1, [(1, 1, F(1, 4))])]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])

    family = Family(parameters={"x": "1/4"}, build=build, breaks={"x": ["0", "1/2", "1", "2"]})
    found = check_parts(family)
    assert [[*map(float, each)] for each in found] == [
        [0, pytest.approx(0.25)],
        [pytest.approx(0.25), 0.5],
        [0.5, pytest.approx(0.75)],
        [pytest.approx(0.75), 1],
    ]


def check_parts(family: Family) -> list[tuple[F, F]]:
    """Return the ends of the pieces from 0 to 1, which the checker proves."""
    found = curve(family, "x", (0, 1))
    assert found.violations() == []
    return [(each.low[0], each.high[1]) for each in found.pieces]


def test_a_run_that_may_end_beside_the_goal_is_refused_at_discount_1() -> None:
    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        rows = [(0, 0, [(x, 1, -1), (1 - x, 2, -1)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
        goal = [1] if at["g"] == 1 else None  # of a total alone
        return MDP.from_outcomes(rows, at["g"], goal=goal, start=0)

    for discount, refused in ((F(1), True), (F(1, 2), False)):
        family = Family(parameters={"x": "1/2", "g": discount}, build=build)
        if not refused:
            assert curve(family, "x", ("1/4", "3/4")).at("1/2") == -1
            continue
        with pytest.raises(ModelError, match="outside the goal"):
            curve(family, "x", ("1/4", "3/4"))


def test_what_makes_a_total_infinite_is_said_before_anything_is_computed() -> None:
    """Steps cost 1; a policy stays, ends with chance (x - z)², or, if it may, ends for 3."""

    def refusal(zero: F, pair: int | None, *, escape: bool = True) -> str:
        def build(at: dict[str, F]) -> MDP:
            p = (at["x"] - zero) ** 2 / 4
            rows = [
                (0, 0, [(1, 0, -1)]),
                (0, 1, [(c, to, -1) for c, to in ((p, 1), (1 - p, 0)) if c]),
            ]
            if escape:
                rows.append((0, 2, [(1, 1, -3)]))
            return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], 1)

        family = Family(parameters={"x": "1/7"}, build=build, degrees={"x": 2})
        equations = _build_section_equations(family, "x", F(0), F(1))
        held = [[(0, to_flint(F(0))), (pair, to_flint(F(1)))], []] if pair is not None else None
        try:
            _require_finite_values(equations, held)
        except ModelError as error:
            return f"{error.where}: {error.what}"
        return ""

    where = "the total at discount 1, for some x from 0 to 1: "
    endless = where + "from some state no policy ends, and the total is infinite"
    held = where + "the policy held fixed never ends from some state, and its total is infinite"
    for zero in (F(0), F(1, 3), F(1, 2), F(1), F(3, 2)):
        outside = zero > 1
        assert refusal(zero, None, escape=False) == ("" if outside else endless)
        assert refusal(zero, None) == ""
        assert refusal(zero, 0) == held
        assert refusal(zero, 1) == ("" if outside else held)
        assert refusal(zero, 2) == ""


def test_a_policy_held_fixed_may_not_miss_the_goal() -> None:
    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        rows = [(0, 0, [(x, 1, -1), (1 - x, 2, -1)]), (0, 1, [(1, 1, -3)]),
                (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]  # fmt: skip
        return MDP.from_outcomes(rows, 1, goal=[1], unreached=-inf, start=0)

    family = Family(parameters={"x": "1/2"}, build=build)
    assert curve(family, "x", ("1/4", "3/4"), policy=[1, 0, 0]).fixed_at("1/2") == -3
    with pytest.raises(ModelError, match="held fixed may miss the goal"):
        curve(family, "x", ("1/4", "3/4"), policy=[0, 0, 0])


def test_each_section_begins_with_a_policy_that_ends() -> None:
    """Steps cost 1; the chance to end is x before 1/2 and 1 - x after: 1/x, 1/(1 - x), or 3."""

    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        p = min(x, 1 - x)
        rows = [(0, 0, [(1, 0, -1)]), (0, 1, [(p, 1, -1), (1 - p, 0, -1)]), (0, 2, [(1, 1, -3)])]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], 1)

    family = Family(parameters={"x": "1/4"}, build=build, breaks={"x": ["1/2"]})
    found = curve(family, "x", ("1/8", "7/8"))
    assert found.violations() == []
    for x in (F(k, 16) for k in range(2, 15)):
        assert found.at(x) == max(F(-3), -1 / min(x, 1 - x))
    assert len(found.pieces) == 4
