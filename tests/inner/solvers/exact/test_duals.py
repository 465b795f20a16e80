"""Proofs about totals: what the checker computes held to plain loops, and proofs made by hand."""

from collections.abc import Callable, Sequence
from fractions import Fraction as F
from math import inf, lcm
from types import SimpleNamespace as Record
from typing import Any

import numpy as np
import pytest
from oracle import Row, mixed, policies, policy_values, visits
from scipy.spatial import ConvexHull

from exact_mdp.solvers.exact import duals
from exact_mdp.solvers.exact.checker import Model, Unreadable
from exact_mdp.solvers.exact.duals import (
    Totals,
    list_totals_violations,
    solve_inequalities,
    weigh_values,
)

Amounts = list[list[F]]


def content(rows: Sequence[Row], rate: F, **more: Any) -> dict[str, Any]:
    """Return the file of a model."""
    pairs = []
    for state, action, reward, law in rows:
        below = lcm(*(p.denominator for p in law.values()))
        pairs.append({
            "state": state, "action": action, "reward": str(reward), "denominator": below,
            "next": [*law], "weight": [int(p * below) for p in law.values()],
        })  # fmt: skip
    head = {"format": "exact-mdp model", "version": 2, "states": 1 + max(s for s, *_ in rows)}
    known = {"discount": str(rate), "sense": "max", "start": {"0": 1}, "pairs": pairs}
    return head | known | more


def level(numbers: Sequence[F | int]) -> Record:
    """Return numbers each over its own denominator."""
    listed = [*map(F, numbers)]
    tops, belows = ([x.numerator for x in listed], [x.denominator for x in listed])
    return Record(top=tops, below=belows, group=[*range(len(listed))])


def flow(numbers: dict[int, F | int]) -> Record:
    return Record(pairs=[*numbers], visits=level([*numbers.values()]))


def made(rng: np.random.Generator, rate: F, parts: int) -> tuple[list[Row], Totals]:
    """A random model of four states, of which the last is an end, and what its pairs earn."""
    rows, amounts = list[Row](), [list[F]() for _ in range(parts)]
    for s in range(3):
        for a in sorted(rng.choice(4, rng.integers(1, 4), replace=False).tolist()):
            later = {int(rng.integers(s + 1, 4)): 1}
            for t in rng.integers(0, 4, 2).tolist():
                later[t] = later.get(t, 0) + int(rng.integers(1, 5))
            law = {t: F(n, sum(later.values())) for t, n in later.items()}
            for own in amounts:
                own.append(F(int(rng.integers(-4, 5)), int(rng.integers(1, 4))))
            rows.append((s, a, amounts[0][-1], law))
    rows.append((3, 0, F(0), {3: F(1)}))
    for own in amounts:
        own.append(F(0))
    start = {"0": "1/2", "2": "1/3", "3": "1/6"}
    model = Model(content(rows, rate, start=start))
    return rows, Totals(model, [f"part {k}" for k in range(parts)], amounts)


START = {0: F(1, 2), 2: F(1, 3), 3: F(1, 6)}
RATES = (F(0), F(1, 3), F(9, 10), F(1))


def earning(policy: Sequence[Row], rows: Sequence[Row], own: Sequence[F]) -> list[Row]:
    """Return a policy whose rewards are other amounts."""
    place = {row[:2]: number for number, row in enumerate(rows)}
    return [(s, a, own[place[s, a]], law) for s, a, _, law in policy]


# ---- what is computed ----------------------------------------------------------------------------


def test_a_gain_has_the_sign_of_what_the_pair_adds() -> None:
    rng = np.random.default_rng(0)
    for rate in RATES:
        for _ in range(8):
            rows, totals = made(rng, rate, 2)
            weights = [F(int(n), 3) for n in rng.integers(-3, 4, 2)]
            value = [F(int(n), int(d)) for n, d in rng.integers(1, 6, (4, 2))]
            read = duals._read_level(level(value), 4)
            signs = set[int]()
            for pair, (s, _, _, law) in enumerate(rows):
                earned = sum(w * own[pair] for w, own in zip(weights, totals.amounts, strict=True))
                wanted = earned + rate * sum(p * value[t] for t, p in law.items()) - value[s]
                if s == 3:
                    wanted = -value[s]
                gain = totals.compute_advantage_sign(weights, read, pair)
                assert (gain > 0, gain < 0) == (wanted > 0, wanted < 0)
                signs.add((gain > 0) - (gain < 0))
            assert totals.ends == {3}


def test_values_bound_a_total_where_no_pair_gains_and_the_start_has_no_more() -> None:
    rng = np.random.default_rng(1)
    for rate in RATES:
        for _ in range(8):
            rows, totals = made(rng, rate, 2)
            weights = [F(int(n), 2) for n in rng.integers(0, 4, 2)]
            amounts = [weigh_values(weights, own) for own in zip(*totals.amounts, strict=True)]
            each = [
                policy_values(earning(policy, rows, amounts), rate, {3})
                for policy in policies(rows)
            ]
            best = [max(column) for column in zip(*each, strict=True)]
            most = sum((share * best[s] for s, share in START.items()), F(0))
            assert totals.is_upper_bound(weights, level(best), most)
            assert not totals.is_upper_bound(weights, level(best), most - F(1, 10**9))
            assert totals.is_upper_bound(weights, level(best), most + 1)
            for state in range(4):
                less = [x - F(s == state, 10**9) for s, x in enumerate(best)]
                if state < 3:  # an end may be worth less than it is
                    assert not totals.is_upper_bound(weights, level(less), most)
            above = [*best[:3], F(1, 10**9)]
            if rate and not all(p == 0 for *_, law in rows[:-1] for t, p in law.items() if t == 3):
                assert not totals.is_upper_bound(weights, level(above), most)
    with pytest.raises(Unreadable):
        totals.is_upper_bound(weights, level(best[:3]), most)


def test_a_policy_attains_its_own_totals_alone() -> None:
    rng = np.random.default_rng(2)
    for rate in RATES:
        rows, totals = made(rng, rate, 3)
        for policy in [*policies(rows)][:6]:
            values = [policy_values(earning(policy, rows, own), rate, {3})
                      for own in totals.amounts]  # fmt: skip
            total = [sum((share * v[s] for s, share in START.items()), F(0)) for v in values]
            pairs = [rows.index(row) for row in policy]
            given = [level(v) for v in values]
            assert totals.is_attained(pairs, given, total)
            assert totals.is_attained(np.array(pairs), given, tuple(total))
            for k in range(3):
                off = [x + F(i == k) for i, x in enumerate(total)]
                assert not totals.is_attained(pairs, given, off)
                for state in range(3):
                    other = [x + F(s == state) for s, x in enumerate(values[k])]
                    wrong = [level(other) if i == k else v for i, v in enumerate(given)]
                    both = [x + F(i == k) * START.get(state, 0) for i, x in enumerate(total)]
                    assert not totals.is_attained(pairs, wrong, both)
            assert not totals.is_attained(pairs[:-1], given, total)
            assert not totals.is_attained([pairs[1], pairs[0], *pairs[2:]], given, total)
            with pytest.raises(Unreadable, match="not one total for each objective"):
                totals.is_attained(pairs, given, total[:2])
            with pytest.raises(Unreadable, match="not one total for each objective"):
                totals.is_attained(pairs, given[:2], total[:2])
            for pair in (-1, len(rows)):
                with pytest.raises(Unreadable, match="a pair is none of the model"):
                    totals.is_attained([pair, *pairs[1:]], given, total)


def drawn(rng: np.random.Generator, rows: Sequence[Row], rate: F) -> dict[int, F]:
    """Return the visits of the pairs of a policy that draws, but of the end."""
    weight = [int(n) for n in rng.integers(0, 3, len(rows))]
    by_state = {s: sum(w for w, row in zip(weight, rows, strict=True) if row[0] == s)
                for s in range(4)}  # fmt: skip
    chances = {
        (s, a): F(w, by_state[s]) if by_state[s] else F(a == min(r[1] for r in rows if r[0] == s))
        for w, (s, a, *_) in zip(weight, rows, strict=True)
    }
    chain = mixed(rows, chances)
    moves = [{t: rate * p for t, p in law.items()} if s < 3 else {} for s, _, _, law in chain]
    count = visits(START, moves)
    each = {pair: count[s] * chances[s, a] for pair, (s, a, *_) in enumerate(rows) if s < 3}
    return {pair: x for pair, x in each.items() if x}


def test_visits_earn_what_the_policy_earns() -> None:
    rng = np.random.default_rng(3)
    for rate in RATES:
        for _ in range(6):
            rows, totals = made(rng, rate, 2)
            numbers = drawn(rng, rows, rate)
            wanted = [sum(x * own[pair] for pair, x in numbers.items()) for own in totals.amounts]
            assert totals.compute_earnings(flow(dict(numbers))) == wanted
            backwards = dict(reversed([*numbers.items()]))
            assert totals.compute_earnings(flow(dict(backwards))) == wanted
            for pair, x in numbers.items():
                for other in (x + F(1, 10**9), x / 2):
                    with pytest.raises(Unreadable, match="visits are not those of a policy"):
                        totals.compute_earnings(flow(numbers | {pair: other}))
    one = min(numbers)
    refused: list[tuple[Record, str]] = [
        (flow(numbers | {len(rows): F(1)}), "a pair is none of the model"),
        (flow(numbers | {-1: F(1)}), "a pair is none of the model"),
        (flow(numbers | {len(rows) - 1: F(1)}), "visits of an end"),
        (flow({p: x for p, x in numbers.items() if p != one}), "not those of a policy"),
        (flow(numbers | {one: F(0)}), "visits are not > 0"),
        (flow(numbers | {one: F(-1)}), "visits are not > 0"),
        (flow({}), "visits are not those of a policy"),
    ]
    twice = Record(
        pairs=[one, *numbers],
        visits=level([numbers[one] / 2, numbers[one] / 2, *[*numbers.values()][1:]]),
    )
    for wrong, sentence in [*refused, (twice, "visits are not > 0")]:
        with pytest.raises(Unreadable, match=sentence):
            totals.compute_earnings(wrong)


def test_a_policy_may_take_every_pair() -> None:
    rows: list[Row] = [(0, 0, F(1), {1: F(1)}), (1, 0, F(2), {0: F(1)})]
    totals = Totals(Model(content(rows, F(1, 2))), ["c"], [[F(1), F(2)]])
    assert totals.is_attained([0, 1], [level([F(8, 3), F(10, 3)])], [F(8, 3)])
    assert totals.compute_earnings(flow({0: F(4, 3), 1: F(2, 3)})) == [F(8, 3)]


def test_ends_neither_lead_on_nor_earn() -> None:
    half = F(1, 2)
    rows: list[Row] = [(0, 0, F(0), {0: half, 1: half}), (1, 0, F(0), {1: F(1)}),
                       (1, 1, F(0), {1: F(1)}), (2, 0, F(0), {2: F(1)})]  # fmt: skip
    model = Model(content(rows, half))
    for own, ends in (([1, 0, 0, 0], {1, 2}), ([0, 0, 0, 1], {1}), ([0, 0, -1, 0], {2})):
        assert Totals(model, ["c"], [[F(x) for x in own]]).ends == ends
    assert Totals(model, ["c", "d"], [[F(0)] * 4, [F(0)] * 3 + [F(1)]]).ends == {1}


# ---- where the equations have one solution -------------------------------------------------------

GO: list[Row] = [(0, 0, F(1), {1: F(1)}), (0, 1, F(2), {0: F(1, 2), 2: F(1, 2)}),
                 (1, 0, F(3), {2: F(1, 3), 0: F(2, 3)}), (2, 0, F(0), {2: F(1)}),
                 (3, 0, F(1), {4: F(1)}), (4, 0, F(0), {4: F(1)})]  # fmt: skip
PAY = [[F(1), F(2), F(3), F(0), F(1), F(0)]]


@pytest.mark.parametrize(
    "rank, fault",
    [
        ([2, 1, 0, 1, 0], False),
        ([9, 7, 0, 5, 0], False),
        ([2, 2, 0, 1, 0], True),
        ([2, 1, 1, 1, 0], True),
        ([2, 1, 0, 0, 0], True),
        ([0, 0, 0, 0, 0], True),
    ],
)
def test_a_rank_shows_that_every_policy_ends(rank: list[int], fault: bool) -> None:
    """Each pair may lower it, but at an end."""
    faults = ["the rank does not show that every policy ends"] * fault
    assert [*Totals(Model(content(GO, F(1))), ["c"], PAY).find_faults(rank)] == faults
    assert [*Totals(Model(content(GO, F(1, 2))), ["c"], PAY).find_faults(None)] == []


@pytest.mark.parametrize("rank", [None, [2, 1, 0, 1], [2, 1, 0, 1, 0, 0], [2, 1, 0, 1, -1]])
def test_a_rank_is_a_number_of_each_state(rank: Any) -> None:
    with pytest.raises(Unreadable, match="the rank is missing, or negative"):
        [*Totals(Model(content(GO, F(1))), ["c"], PAY).find_faults(rank)]


@pytest.mark.parametrize(
    "start, goal, fault", [(0, 2, False), (0, 4, True), (3, 4, False), (3, 2, True), (2, 4, True)]
)
def test_runs_end_at_the_goal(start: int, goal: int, fault: bool) -> None:
    model = Model(content(GO, F(1), start={str(start): 1}, goal=[goal]))
    faults = [*Totals(model, ["c"], PAY).find_faults([2, 1, 0, 1, 0])]
    assert faults == ["a run may end outside the goal, and its totals are not finite"] * fault


# ---- geometry ------------------------------------------------------------------------------------


def test_the_size_of_a_cell_is_that_of_its_hull() -> None:
    rng = np.random.default_rng(4)
    for _ in range(30):
        points = [[F(int(x)) for x in row] for row in rng.integers(0, 9, (8, 3))]
        flat = np.array([[float(x) for x in row[:2]] for row in points])
        assert float(duals._measure_hull(points)) == pytest.approx(2 * ConvexHull(flat).volume)
        pairs = [row[:2] for row in points]
        assert duals._measure_hull(pairs) == max(x for x, _ in pairs) - min(x for x, _ in pairs)
    line = [[F(k), F(2 * k), F(0)] for k in range(5)]
    assert (
        duals._measure_hull(line) == duals._measure_hull(line[:1]) == duals._measure_hull([]) == 0
    )
    assert duals._measure_hull([*map(list, np.eye(3, dtype=int).tolist())]) == 1


def test_multipliers_are_allowed_where_all_lines_say_so() -> None:
    rng = np.random.default_rng(5)
    seen = set[tuple[bool, bool]]()
    for _ in range(200):
        lines = [(F(int(a)), F(int(b), 2)) for a, b in rng.integers(-2, 3, (rng.integers(0, 4), 2))]
        low, high = solve_inequalities(lines)
        for x in [F(n, 12) for n in range(61)]:
            assert (low <= x <= high) == all(a * x + b <= 0 for a, b in lines)
        for end in (low, high):
            if low <= high < inf:
                assert all(a * F(end) + b <= 0 for a, b in lines)
        seen.add((low <= high, high == inf))
    assert seen == {(True, True), (True, False), (False, False)}
    assert solve_inequalities([]) == (0, inf)
    assert solve_inequalities([(F(-1), F(2)), (F(0), F(1))]) == (1, 0)


def test_worth_is_a_weighted_sum() -> None:
    assert weigh_values([2, F(1, 2)], [F(3), F(-4)]) == 4
    assert weigh_values([], []) == 0


# ---- proofs by hand ------------------------------------------------------------------------------

Change = Callable[[Any], object]


def choices(*amounts: Sequence[int | F], **more: Any) -> Totals:
    """One step: each action of state 0 earns its amounts, and leads to the end; half start there.

    State 2 earns what the first action does.
    """
    rows: list[Row] = [(0, a, F(own[0]), {1: F(1)}) for a, own in enumerate(amounts)]
    rows += [(1, 0, F(0), {1: F(1)}), (2, 0, F(amounts[0][0]), {1: F(1)})]
    sign = -1 if more.get("sense") == "min" else 1
    rows = [(s, a, sign * r, law) for s, a, r, law in rows]
    parts = [[F(x) for x in own] + [F(0), F(own[0])] for own in zip(*amounts, strict=True)]
    model = Model(content(rows, F(1), start={"0": "1/2", "1": "1/2"}, **more))
    return Totals(model, ["reward", "b", "c", "d"][: len(parts)], parts)


def wrong(totals: Totals, proof: Any) -> list[str]:
    try:
        return list_totals_violations(totals, proof)
    except Unreadable as error:
        return [f"unreadable: {error}"]


def front_of(*points: Sequence[int], weights: Sequence[Sequence[F]]) -> tuple[Totals, Record]:
    """The front of some choices whose corners are at some weights."""
    count = len(points)
    vertices = [
        Record(
            pairs=[a, count, count + 1],
            values=[level([own, 0, first]) for own, first in zip(point, points[0], strict=True)],
            total=[F(x, 2) for x in point],
        )
        for a, point in enumerate(points)
    ]
    corners = []
    for at in weights:
        each = [weigh_values(at, [F(x) for x in point]) for point in points]
        best = [a for a, own in enumerate(each) if own == max(each)]
        dual = level([max(each), 0, each[0]])
        corners.append(Record(weights=[*at], best=best, dual=dual))
    return choices(*points), Record(
        kind="front", rank=[1, 0, 1], attained=vertices, corners=corners
    )


def line() -> tuple[Totals, Record]:
    at = [F(0), F(1, 4), F(3, 4), F(1)]
    return front_of((4, 0), (3, 3), (0, 4), weights=[(x, 1 - x) for x in at])


def triangle() -> tuple[Totals, Record]:
    """Three corners of the weights, three middles of its edges, and its own middle."""
    ends = [*map(list, np.eye(3, dtype=int).tolist())]
    middles = [[F(x != k, 2) for x in range(3)] for k in range(3)]
    at = [[*map(F, end)] for end in ends] + middles + [[F(1, 3)] * 3]
    return front_of((3, 0, 0), (0, 3, 0), (0, 0, 3), weights=at)


@pytest.mark.parametrize("front", [line, triangle])
def test_a_front_by_hand_holds(front: Callable[[], tuple[Totals, Record]]) -> None:
    totals, proof = front()
    assert list_totals_violations(totals, proof) == []
    for corner in proof.corners:
        most = max(weigh_values(corner.weights, vertex.total) for vertex in proof.attained)
        assert totals.is_upper_bound(corner.weights, corner.dual, most)


def put(name: str, place: int, **changes: Any) -> Change:
    """Return a change of one record of a list."""
    return lambda proof: vars(getattr(proof, name)[place]).update(changes)


POINT = "a vertex is not one: others are as good for all weights"
BOUND = "the bound for weights ({}) does not hold"
FRONTS: dict[str, tuple[Change, list[str]]] = {
    "a total": (
        put("attained", 1, total=[F(3, 2), F(2)]),
        ["vertex 1 has other totals", BOUND.format("1/4, 3/4"), BOUND.format("3/4, 1/4"),
         BOUND.format("0, 1"), "the bounds do not cover all weights", POINT],
    ),
    "a policy": (put("attained", 0, pairs=[1, 3, 4]), ["vertex 0 has other totals"]),
    "what is best": (put("corners", 1, best=[1]), [BOUND.format("1/4, 3/4")]),
    "all as good": (put("corners", 3, best=[0, 1]), [BOUND.format("1, 0")]),
    "a bound too low": (put("corners", 0, dual=level([F(7, 2), 0, 0])), [BOUND.format("0, 1")]),
    "a bound too high": (put("corners", 0, dual=level([5, 0, 0])), [BOUND.format("0, 1")]),
    "values of no bound": (put("corners", 3, dual=level([4, 0, 3])), [BOUND.format("1, 0")]),
    "weights that are too large": (
        put("corners", 3, weights=[F(2), F(0)], dual=level([8, 0, 8])),
        [BOUND.format("2, 0"), "the bounds do not cover all weights"],
    ),
    "weights below 0": (
        put("corners", 3, weights=[F(5, 4), F(-1, 4)], dual=level([5, 0, 5])),
        [BOUND.format("5/4, -1/4"), "the bounds do not cover all weights"],
    ),
    "no corner": (lambda p: p.corners.pop(0), ["the bounds do not cover all weights", POINT]),
    "no last corner": (lambda p: p.corners.pop(), ["the bounds do not cover all weights", POINT]),
    "weights twice": (lambda p: p.corners.append(p.corners[1]), ["weights are written twice"]),
    "a vertex twice": (
        lambda p: [p.attained.append(p.attained[1]), p.corners[1].best.append(3),
                   p.corners[2].best.append(3)],
        ["a vertex is written twice", "the bounds do not cover all weights"],
    ),
    "the rank": (lambda p: p.rank.__setitem__(0, 0),
                 ["the rank does not show that every policy ends"]),
    "nothing": (
        lambda p: vars(p).update(attained=[], corners=[]),
        ["the bounds do not cover all weights"],
    ),
    "no vertex": (
        lambda p: p.attained.clear(),
        [*map(BOUND.format, ("0, 1", "1/4, 3/4", "3/4, 1/4", "1, 0")),
         "the bounds do not cover all weights"],
    ),
    "three weights": (
        put("corners", 0, weights=[F(0), F(1), F(0)]),
        ["unreadable: not one weight for each objective"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", FRONTS)
def test_a_front_with_a_mistake_is_refused(what: str) -> None:
    totals, proof = line()
    change, sentences = FRONTS[what]
    change(proof)
    assert sorted(wrong(totals, proof)) == sorted(sentences)


def test_a_point_on_an_edge_is_no_vertex() -> None:
    """(2, 2) is as good as (4, 0) and (0, 4) for equal weights, and only for these."""
    at = [F(0), F(1, 2), F(1)]
    totals, proof = front_of((4, 0), (2, 2), (0, 4), weights=[(x, 1 - x) for x in at])
    assert wrong(totals, proof) == [POINT]


def test_a_front_has_two_or_three_objectives() -> None:
    totals, proof = triangle()
    proof.corners.pop()
    assert wrong(totals, proof) == ["the bounds do not cover all weights"]
    for points in ([(1,), (2,)], [(1, 2, 3, 4), (4, 3, 2, 1)]):
        totals, proof = front_of(*points, weights=[])
        assert wrong(totals, proof) == ["unreadable: a front is of two or three objectives"]


# ---- limits --------------------------------------------------------------------------------------


def limited(sense: str = "max") -> tuple[Totals, Record]:
    """A reward of 4 that costs 6, or one of 2 that costs 2, from half of the starts; 2 is allowed.

    Half of these take each, and a price of 1/2 makes both as good. More is better in all amounts:
    what is limited is b, of which `sense` tells the sign that the limit has.
    """
    sign = 1 if sense == "max" else -1
    limit = Record(name="b", sign=-sign, bound=F(2) * sign)
    totals = choices((4, 6), (2, 2), sense=sense)
    return totals, Record(
        kind="limits", rank=[1, 0, 1], limits=[limit], price=[F(1, 2)], feasible=True, shift=F(0),
        flow=flow({0: F(1, 4), 1: F(1, 4)}), dual=level([1, 0, 1]),
    )  # fmt: skip


def out_of_reach(sense: str = "max") -> tuple[Totals, Record]:
    """At least 1 of b is spent, which is allowed up to 0: all limits have to move by 1."""
    totals, proof = limited(sense)
    vars(proof.limits[0]).update(bound=F(0))
    vars(proof).update(price=[F(1)], feasible=False, shift=F(1), flow=flow({1: F(1, 2)}),
                       dual=level([-2, 0, -6]))  # fmt: skip
    return totals, proof


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("proven", [limited, out_of_reach])
def test_an_optimum_under_limits_by_hand_holds(
    proven: Callable[[str], tuple[Totals, Record]], sense: str
) -> None:
    assert list_totals_violations(*proven(sense)) == []


BETTER = "the values do not prove that no policy is better"
SIGNS = "a price or the step of the limits is negative, or contradicts that they can be kept"
LIMITS: dict[str, tuple[Any, dict[str, Any], list[str]]] = {
    "a flow that keeps too much": (limited, {"flow": flow({1: F(1, 2)})}, [BETTER]),
    "a flow that breaks the limit": (
        limited, {"flow": flow({0: F(1, 2)})}, ["the policy does not keep b"]),
    "a price too low": (limited, {"price": [F(1, 4)]}, [BETTER]),
    "a price below 0": (
        limited, {"price": [F(-1, 2)], "dual": level([7, 0, 7])}, [SIGNS, BETTER]),
    "values too low": (limited, {"dual": level([F(1, 2), 0, 1])}, [BETTER]),
    "a step of limits that are kept": (limited, {"shift": F(1)}, [SIGNS]),
    "a step below 0": (limited, {"shift": F(-1)}, [SIGNS, "the policy does not keep b"]),
    "no reason why not": (limited, {"feasible": False}, [
        SIGNS, BETTER, "nothing proves that no policy keeps the limits"]),
    "a smaller step": (out_of_reach, {"shift": F(1, 2)}, ["the policy does not keep b"]),
    "a greater step": (out_of_reach, {"shift": F(2), "flow": flow({0: F(1, 2)})}, [
        "the policy does not keep b", BETTER]),
    "a step that does": (out_of_reach, {"shift": F(2)}, [BETTER]),
    "prices of less": (
        out_of_reach, {"price": [F(1, 2)], "dual": level([-1, 0, -3])}, [
            BETTER, "nothing proves that no policy keeps the limits"]),
    "prices of more": (
        out_of_reach, {"price": [F(2)], "dual": level([-4, 0, -12])}, [
            "nothing proves that no policy keeps the limits"]),
    "no price": (limited, {"price": []}, ["unreadable: not one price for each limit"]),
    "a limit of the reward": (
        limited, {"limits": [Record(name="reward", sign=-1, bound=F(2))]},
        ["unreadable: what is limited is not counted"]),
    "an equation": (
        limited, {"limits": [Record(name="b", sign=0, bound=F(2))]},
        ["unreadable: a limit is neither >= nor <="]),
    "another rank": (
        limited, {"rank": [0, 0, 1]}, ["the rank does not show that every policy ends"]),
}  # fmt: skip


@pytest.mark.parametrize("what", LIMITS)
def test_limits_with_a_mistake_are_refused(what: str) -> None:
    proven, changes, sentences = LIMITS[what]
    totals, proof = proven()
    vars(proof).update(changes)
    assert wrong(totals, proof) == sentences


def test_what_is_maximised_is_the_reward() -> None:
    totals, proof = limited()
    totals.amounts[0][3] += 1  # of a state in which nothing starts
    vars(proof).update(dual=level([1, 0, 2]))
    assert wrong(totals, proof) == ["what is maximised is not the reward"]


def test_limits_that_do_not_bind_have_no_price() -> None:
    for limits in ([], [Record(name="b", sign=-1, bound=F(100))]):
        totals, proof = choices((4, 1), (2, 0)), limited()[1]
        vars(proof).update(limits=limits, price=[F(0)] * len(limits), flow=flow({0: F(1, 2)}),
                           dual=level([4, 0, 4]))  # fmt: skip
        assert list_totals_violations(totals, proof) == []


def test_rewards_under_limits_may_be_fractions() -> None:
    totals, proof = choices((F(4, 3), 6), (F(2, 3), 2)), limited()[1]
    vars(proof).update(price=[F(1, 6)], dual=level([F(1, 3), 0, F(1, 3)]))
    assert list_totals_violations(totals, proof) == []


def test_two_limits_of_one_total_add_their_prices() -> None:
    totals, proof = limited()
    proof.limits.append(Record(name="b", sign=1, bound=F(2)))
    vars(proof).update(price=[F(1), F(1, 2)])
    assert list_totals_violations(totals, proof) == []


# ---- weights -------------------------------------------------------------------------------------


def between() -> tuple[Totals, Record]:
    """(4, 0) is the policy's, (0, 6) the other: each weight moves by 1/5 until both are alike."""
    totals, other = choices((4, 0), (0, 6)), flow({1: F(1, 2)})
    lead = Record(multiplier=F(1), flow=other)
    first = Record(low=F(3, 2), high=inf, cuts=[other], at_low=level([6, 0, 6]),
                   at_high=level([4, 0, 4]))  # fmt: skip
    second = Record(low=F(0), high=F(2, 3), cuts=[other], at_low=level([4, 0, 4]),
                    at_high=level([4, 0, 4]))  # fmt: skip
    return totals, Record(
        kind="weights", rank=[1, 0, 1], multipliers=[F(6, 5), F(4, 5)], change=F(1, 5),
        dual=level([F(24, 5), 0, F(24, 5)]), flow=flow({0: F(1, 2)}), cuts=[lead],
        intervals=[first, second],
    )  # fmt: skip


def never() -> tuple[Totals, Record]:
    """(4, 4) lies below the line from (10, 0) to (0, 10): only weights of 0 make it optimal."""
    totals, others = choices((4, 4), (10, 0), (0, 10)), [flow({1: F(1, 2)}), flow({2: F(1, 2)})]
    none = [
        Record(low=None, high=None, cuts=[*others], at_low=None, at_high=None) for _ in range(2)
    ]
    return totals, Record(
        kind="weights", rank=[1, 0, 1], multipliers=[F(0), F(0)], change=F(1),
        dual=level([0, 0, 0]), flow=flow({0: F(1, 2)}),
        cuts=[Record(multiplier=F(1), flow=other) for other in others], intervals=none,
    )  # fmt: skip


def already() -> tuple[Totals, Record]:
    """(4, 4) is the best for the weights as they are."""
    totals, other = choices((4, 4), (6, 0)), flow({1: F(1, 2)})
    first = Record(low=F(0), high=F(2), cuts=[other], at_low=level([4, 0, 4]),
                   at_high=level([12, 0, 12]))  # fmt: skip
    second = Record(low=F(1, 2), high=inf, cuts=[other], at_low=level([6, 0, 6]),
                    at_high=level([4, 0, 4]))  # fmt: skip
    return totals, Record(
        kind="weights", rank=[1, 0, 1], multipliers=[F(1), F(1)], change=F(0),
        dual=level([8, 0, 8]), flow=flow({0: F(1, 2)}), cuts=[], intervals=[first, second],
    )  # fmt: skip


@pytest.mark.parametrize("proven", [between, never, already])
def test_the_least_change_of_weights_by_hand_holds(
    proven: Callable[[], tuple[Totals, Record]],
) -> None:
    assert list_totals_violations(*proven()) == []


def test_multipliers_of_policies_add_up() -> None:
    assert list_totals_violations(*single()) == []
    totals, proof = between()
    half, none = (Record(multiplier=x, flow=proof.cuts[0].flow) for x in (F(1, 2), F(0)))
    proof.cuts = [half, none, half]
    assert list_totals_violations(totals, proof) == []


def single() -> tuple[Totals, Record]:
    """(2, 2) lies on the line from (4, 0) to (0, 4): one multiplier alone does."""
    totals, others = choices((2, 2), (4, 0), (0, 4)), [flow({1: F(1, 2)}), flow({2: F(1, 2)})]
    value = level([4, 0, 4])
    point = [Record(low=F(1), high=F(1), cuts=others, at_low=value, at_high=value)
             for _ in range(2)]  # fmt: skip
    return totals, Record(
        kind="weights", rank=[1, 0, 1], multipliers=[F(1), F(1)], change=F(0), dual=value,
        flow=flow({0: F(1, 2)}), cuts=[], intervals=point,
    )  # fmt: skip


OPTIMAL = "the values do not prove the policy optimal for the weights"
SMALLER = "nothing proves that a smaller change does not do"
WEIGHTS: dict[str, tuple[Any, Change, list[str]]] = {
    "a smaller change": (
        between, lambda p: vars(p).update(change=F(1, 6), multipliers=[F(7, 6), F(5, 6)]),
        [OPTIMAL, SMALLER]),
    "a greater change": (
        between,
        lambda p: vars(p).update(change=F(1, 2), multipliers=[F(3, 2), F(1, 2)],
                                 dual=level([6, 0, 6])),
        [SMALLER]),
    "weights of another change": (
        between, lambda p: vars(p).update(multipliers=[F(3, 2), F(4, 5)],
                                          dual=level([6, 0, 6])),
        ["the weights are not changed by that much"]),
    "values that are too low": (between, lambda p: p.dual.top.__setitem__(0, 4), [OPTIMAL]),
    "values that are too high": (between, lambda p: p.dual.top.__setitem__(0, 99), [OPTIMAL]),
    "no values": (between, lambda p: vars(p).update(dual=None), [OPTIMAL]),
    "a cut below 0": (between, put("cuts", 0, multiplier=F(-1)), [SMALLER]),
    "no cut": (between, lambda p: p.cuts.clear(),
               ["nothing proves that the weights have to change"]),
    "a policy beside the cut": (
        between, put("cuts", 0, flow=flow({0: F(1, 2)})),
        ["nothing proves that the weights have to change"]),
    "half of the cuts": (never, lambda p: p.cuts.pop(), [SMALLER]),
    "a lower end": (between, put("intervals", 0, low=F(1)),
                    ["the interval of reward alone is not proven"]),
    "a higher end": (between, put("intervals", 1, high=F(1)),
                     ["the interval of b alone is not proven"]),
    "no values at the lower end": (between, put("intervals", 0, at_low=None),
                                   ["the interval of reward alone is not proven"]),
    "no values at the higher end": (between, put("intervals", 1, at_high=None),
                                    ["the interval of b alone is not proven"]),
    "wrong values at infinity": (between, put("intervals", 0, at_high=level([3, 0, 4])),
                                 ["the interval of reward alone is not proven"]),
    "no interval where there is one": (
        between, put("intervals", 0, low=None, high=None),
        ["nothing proves that reward alone does not do"]),
    "no interval where there is one point": (
        single, put("intervals", 1, low=None, high=None),
        ["nothing proves that b alone does not do"]),
    "half an interval": (never, put("intervals", 1, high=F(1)),
                         ["nothing proves that b alone does not do"]),
    "other cuts of an interval": (never, lambda p: p.intervals[1].cuts.pop(),
                                  ["nothing proves that b alone does not do"]),
    "an interval where there is none": (never, put("intervals", 0, low=F(3, 2), high=F(2, 3)),
                                        ["the interval of reward alone is not proven"]),
    "two weights of three": (between, lambda p: p.multipliers.append(F(1)),
                             ["unreadable: not one of each weight"]),
    "one interval of two": (between, lambda p: p.intervals.pop(),
                            ["unreadable: not one of each weight"]),
    "another rank": (between, lambda p: vars(p).update(rank=[1, 0, 0]),
                     ["the rank does not show that every policy ends"]),
    "a change of nothing": (
        already, lambda p: vars(p).update(change=F(1, 4), multipliers=[F(5, 4), F(1)],
                                          dual=level([9, 0, 9])),
        ["nothing proves that the weights have to change"]),
}  # fmt: skip


@pytest.mark.parametrize("what", WEIGHTS)
def test_weights_with_a_mistake_are_refused(what: str) -> None:
    proven, change, sentences = WEIGHTS[what]
    totals, proof = proven()
    change(proof)
    assert wrong(totals, proof) == sentences
