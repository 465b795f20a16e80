"""Bellman equations in polynomials, against the same equations in fractions at points."""

from collections import Counter
from collections.abc import Collection
from fractions import Fraction as F
from functools import partial
from itertools import combinations, product
from math import inf
from typing import Any

import numpy as np
import pytest
from flint import fmpq_poly
from oracle import mean, rows_of

from exact_mdp import MDP, Family, parametric
from exact_mdp.analysis.vary.curves.equations import (
    SectionEquations,
    _remove_duplicates,
    list_pairs,
    sum_weighted,
)
from exact_mdp.mdp.exact import from_flint, to_flint
from exact_mdp.mdp.parametric.row_change import Piece


def family(ends: bool, discount: str = "3/4") -> Family:
    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        back = [(F(1, 2), 0, 0), (F(1, 2), 2, x)] if not ends else [(1, 2, x)]
        rows = [(0, 0, [(x, 1, 4), (1 - x, 2, 0)]), (0, 1, [(1, 1, 1)]), (1, 0, back)]
        return MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])], discount)

    return Family(parameters={"x": "1/2"}, build=build)


def made(ends: bool, discount: str = "3/4", low: F = F(0), high: F = F(1)) -> SectionEquations:
    kind = family(ends, discount)
    return SectionEquations(kind, "x", Piece(low=low, high=high, origin=(low + high) / 2))


@pytest.mark.parametrize("ends", [True, False])
def test_gaps_are_what_pairs_fall_short_of_the_values(ends: bool) -> None:
    equations, kind = made(ends), family(ends)
    values = ((fmpq_poly([1, 2]), fmpq_poly([-1, 0, 3]), fmpq_poly()), fmpq_poly([2, 1]))
    assert equations.update_gaps(values) == {0, 1, 2}
    for x in (F(0), F(1, 3), F(1)):
        mdp, place = kind.at({"x": x}), to_flint(x)
        below = from_flint(values[1](place))
        v = [from_flint(top(place)) / below for top in values[0]]
        for pair, (s, _, r, law) in enumerate(rows_of(mdp)[:3]):
            short = v[s] - r - F(3, 4) * mean(law, v)
            assert from_flint(equations.gap[pair](place)) == below * short
            assert from_flint(equations.compute_action_value(pair, values)(place)) == below * (
                v[s] - short
            )
    assert equations.update_gaps(values) == set()
    assert equations.update_gaps(values, taken=[0]) == {0}
    assert equations.gap[0] == fmpq_poly()
    assert equations.live == [0, 1]
    assert (equations.order is None) == (not ends)
    assert equations.has_different_actions(0)
    assert not equations.has_different_actions(1)


def test_one_solution_is_proved_where_there_is_one() -> None:
    """At discount 1 runs end unless x = 0 keeps them from it."""

    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(at["x"], 1, 1), (1 - at["x"], 0, 1)]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, 1)

    kind = Family(parameters={"x": "1/2"}, build=build)
    for low, one in ((F(1, 10), True), (F(0), False)):
        equations = SectionEquations(kind, "x", Piece(low=low, high=F(1), origin=F(1, 2)))
        assert equations.one_solution() == one
        said = list(equations.find_faults())
        assert bool(said) != one
    assert made(False).one_solution()
    assert list(made(False).find_faults()) == []
    beyond = made(False, high=F(1))
    beyond.high = F(2)  # where a probability is negative
    assert "negative" in next(beyond.find_faults())


def test_a_weighed_sum_is_one() -> None:
    polynomials = [fmpq_poly([1, 2]), fmpq_poly([5]), fmpq_poly([0, 0, 1])]
    assert sum_weighted([(0, F(1, 2)), (2, F(-3))], polynomials) == fmpq_poly(
        [to_flint(F(1, 2)), 1, -3]
    )


def test_rows_that_move_hold_at_every_point() -> None:
    """Random chances and rewards of x: gaps are those of the model at a point, pair by pair."""
    states = [0, 0, 1, 2, 2]
    for seed in range(8):
        rng = np.random.default_rng(seed)
        base = rng.multinomial(3, [1 / 3] * 3, size=5) + 1  # of 6
        slope, reward = rng.integers(-1, 2, 5).tolist(), rng.integers(-3, 4, (5, 2)).tolist()

        def build(
            at: dict[str, F], base: Any = base, slope: Any = slope, reward: Any = reward
        ) -> MDP:
            rows = []
            for pair, state in enumerate(states):
                law = [F(int(k), 6) for k in base[pair]]
                law = [
                    law[0] + slope[pair] * at["x"] / 6,
                    law[1],
                    law[2] - slope[pair] * at["x"] / 6,
                ]
                paid = reward[pair][0] + reward[pair][1] * at["x"]
                outcomes = [(p, to, paid) for to, p in enumerate(law) if p]
                rows.append((state, pair - states.index(state), outcomes))
            return MDP.from_outcomes(rows, "2/3")

        kind = Family(parameters={"x": "1/2"}, build=build)
        equations = SectionEquations(kind, "x", Piece(low=F(0), high=F(1), origin=F(1, 4)))
        tops = [fmpq_poly(rng.integers(-3, 4, 3).tolist()) for _ in range(3)]
        values = tops, fmpq_poly([3, 1])
        equations.update_gaps(values)
        for x in (F(0), F(2, 7), F(1)):
            place = to_flint(x)
            below = from_flint(values[1](place))
            v = [from_flint(top(place)) / below for top in tops]
            for pair, (s, _, r, law) in enumerate(rows_of(kind.at({"x": x}))):
                short = v[s] - r - F(2, 3) * mean(law, v)
                assert from_flint(equations.gap[pair](place)) == below * short
        assert equations.state == states
        # Where only the values of state 1 change, gaps come from those before.
        news = [tops[0], tops[1] + 1, tops[2]], values[1]
        for pair, state in enumerate(states):
            total = equations.reward[pair] * values[1]
            total += sum((p * news[0][to] for to, p in equations.following[pair]), fmpq_poly())
            assert equations.compute_action_value(pair, news) == total
            assert equations.compute_action_value(pair, values) == tops[state] - equations.gap[pair]
        doubled = tops, values[1] * 2
        for pair in range(5):
            total = equations.reward[pair] * values[1] * 2
            total += sum((p * tops[to] for to, p in equations.following[pair]), fmpq_poly())
            assert equations.compute_action_value(pair, doubled) == total


def test_the_discount_is_the_rate_of_what_follows() -> None:
    mdp = family(False).at({"x": F(1, 3)})
    section = Piece(low=F(1, 4), high=F(3, 4), origin=F(1, 2))
    equations = SectionEquations(parametric(mdp), "discount", section)
    assert equations.rate == fmpq_poly([0, 1])
    third = to_flint(F(1, 3))
    assert dict(equations.following[0]) == {1: fmpq_poly([0, third])}  # state 2 is terminal
    assert dict(equations.following[2]) == {0: fmpq_poly([0, to_flint(F(1, 2))])}
    assert made(False).rate == to_flint(F(3, 4))


@pytest.mark.parametrize("kind", ["earns", "is left"])
def test_a_state_that_is_terminal_at_one_point_alone_is_live(kind: str) -> None:
    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        if kind == "earns":
            last = [(1, 1, x - F(1, 2))]
        else:
            p = (x - F(1, 2)) ** 2
            last = [(each, to, 0) for each, to in ((1 - p, 1), (p, 0)) if each]
        rows = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 2, 0)]), (1, 0, last), (2, 0, [(1, 2, 0)])]
        return MDP.from_outcomes(rows, "1/2")

    family = Family(parameters={"x": "1/2"}, build=build, degrees={"x": 2})
    equations = SectionEquations(family, "x", Piece(low=F(0), high=F(1), origin=F(1, 2)))
    assert equations.mdp.terminal.tolist() == [False, True, True]
    assert equations.live == [0, 1]
    assert equations.order is None
    assert [to for to, _ in equations.following[0]] == [1]
    assert equations.following[1] == []


def test_actions_differ_in_what_they_earn_or_lead_to() -> None:
    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        rows = [
            (0, 0, [(x, 1, 1), (1 - x, 3, 1)]),
            (0, 1, [(x, 1, 1), (1 - x, 3, 1)]),
            (1, 0, [(1, 3, x)]),
            (1, 1, [(1, 3, F(1, 2))]),
            (2, 0, [(x, 1, 0), (1 - x, 3, 0)]),
            (2, 1, [(1, 1, 0)]),
            (3, 0, [(1, 3, 0)]),
        ]
        return MDP.from_outcomes(rows)

    equations = SectionEquations(
        Family(parameters={"x": "1/2"}, build=build),
        "x",
        Piece(low=F(0), high=F(1), origin=F(1, 3)),
    )
    assert [equations.has_different_actions(state) for state in range(4)] == [
        False,
        True,
        True,
        False,
    ]
    assert equations.order is not None
    assert [*equations.order][-2:] in ([0, 2], [2, 0])


def test_there_is_one_solution_where_every_policy_ends_at_every_point() -> None:
    """Chances c (x - z)², 0 at z alone, and at discount 1: what ends is followed state by state."""
    seen = set()
    for seed in range(40):
        rng, paid = np.random.default_rng(seed), (-1) ** seed
        pairs = []  # of each pair of states 0, 1, 2: where it may go, and where that chance is 0
        for state in range(3):
            for _ in range(1 + int(rng.integers(2))):
                zero = F(int(rng.choice([-1, 0, 1, 2, 3, 5])), 3)
                pairs.append((state, int(rng.integers(4)), int(rng.integers(3)), zero))

        def build(at: dict[str, F], pairs: Any = pairs, paid: int = paid) -> MDP:
            rows, count = [], dict.fromkeys(range(3), 0)
            for state, to, back, zero in pairs:
                p = (at["x"] - zero) ** 2 / 9
                rows.append(
                    (state, count[state], [(c, t, paid) for c, t in ((p, to), (1 - p, back)) if c])
                )
                count[state] += 1
            return MDP.from_outcomes([*rows, (3, 0, [(1, 3, 0)])], 1)

        kind = Family(parameters={"x": "1/2"}, build=build, degrees={"x": 2})
        equations = SectionEquations(kind, "x", Piece(low=F(0), high=F(1), origin=F(1, 2)))

        def ends(x: F, pairs: Any = pairs) -> bool:
            near = {3}
            for _ in range(3):
                for state in range(3):
                    rows = [
                        (to if x != zero else back, back)
                        for s, to, back, zero in pairs
                        if s == state
                    ]
                    if all(near & {*each} for each in rows):
                        near.add(state)
            return len(near) == 4

        points = [F(k, 6) for k in range(7)]
        wanted = all(map(ends, points))
        assert equations.one_solution() == wanted
        # Policies that stay forever and lose at every step do no harm: the optimum is never theirs.
        assert bool([*equations.find_faults()]) == (not wanted and paid > 0)
        seen.add((wanted, paid))
    assert seen == {(ends, paid) for ends in (True, False) for paid in (1, -1)}


def test_below_discount_1_there_is_one_solution_up_to_where_it_is_1() -> None:
    def build(at: dict[str, F]) -> MDP:
        return MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (1, 0, [(1, 1, 0)])], at["g"])

    loop = parametric(build({"g": F(1, 2)}))
    for high, one in ((F(99, 100), True), (F(1), False)):
        equations = SectionEquations(loop, "discount", Piece(low=F(0), high=high, origin=F(1, 2)))
        assert equations.one_solution() == one
        said = [*equations.find_faults()]
        assert said == ["nothing proves that the Bellman equations have one solution"] * (not one)
        assert equations._compute_exit_probability(0) == fmpq_poly([1, -1])


@pytest.mark.parametrize(("discount", "high"), [("1/2", F(3, 4)), ("1/2", F(1)), ("1", F(1))])
def test_a_run_may_miss_the_goal_at_discount_1_alone(discount: str, high: F) -> None:
    """State 0 leads to the goal or beside it; in another model, to the goal alone."""
    for beside in (False, True):
        to = [(F(1, 2), 1, -1), (F(1, 2), 2, -1)] if beside else [(1, 1, -1)]
        rows = [(0, 0, to), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
        mdp = MDP.from_outcomes(rows, discount, target=[1], start=0)
        low = F(1, 4) if discount != "1" else F(1, 2)
        origin = (low + high) / 2
        equations = SectionEquations(
            parametric(mdp), "discount", Piece(low=low, high=high, origin=origin)
        )
        missed = beside and high == 1
        assert equations.may_miss_goal == missed
        words = "a run may end outside the goal, which is worth infinity"
        assert (words in [*equations.find_faults()]) == missed
    assert not made(True).may_miss_goal


def test_chances_that_pass_their_bounds_are_refused() -> None:
    words = "a probability is negative, or probabilities pass 1"
    for low, high, wrong in ((F(0), F(1), False), (F(0), F(2), True), (F(-1), F(1), True)):
        equations = made(True)
        equations.low, equations.high = low, high
        assert (words in [*equations.find_faults()]) == wrong
    more = made(True)
    more.following[1] = [(1, fmpq_poly([to_flint(F(3, 4)), 1]))]  # passes 1 from x = 1/4 on
    assert words in [*more.find_faults()]


def test_polynomials_are_told_apart_once_each() -> None:
    one, other = fmpq_poly([1, 2]), fmpq_poly([2, 1])
    assert _remove_duplicates([one, other, fmpq_poly([1, 2]), other]) == [one, other]


# ---- places at which transitions vanish ----------------------------------------------------------

IRRATIONAL = F(0.7071067811865476)  # stands for √(1/2)
PLACES = [F(0), F(1, 3), F(1, 2), F(2, 3), IRRATIONAL, F(1)]


def vanish(zero: F, x: F) -> F:
    """A probability that is 0 at one place alone, and less than 1 between 0 and 1."""
    if zero == IRRATIONAL:
        return (2 * x * x - 1) ** 2 / 9
    return (x - zero) ** 2 / 9


class Vanishing:
    """Three states, the goal 3 and another end 4; each pair may go to a state, or back to another.

    The probability to go there is 0 at one place alone, for a share of the pairs inside the
    section. Rewards are a + b x.
    """

    def __init__(self, seed: int, ends: int, share: float) -> None:
        rng = np.random.default_rng(seed)
        self.steps: list[tuple[int, int, int, F]] = []  # state, there, back, place
        for state in range(3):
            for _ in range(1 + int(rng.integers(3))):
                there, back = int(rng.integers(3 + ends)), int(rng.integers(3 + (ends > 1)))
                zero = F(5, 3)
                if rng.random() < share:
                    zero = PLACES[int(rng.integers(len(PLACES)))]
                self.steps.append((state, there, back, zero))
        self.reward: list[list[int]] = rng.integers(-4, 2, (len(self.steps), 2)).tolist()
        self.start = {state: F(1, 2) for state in rng.choice(3, 2, replace=False).tolist()}

    def build(self, at: dict[str, F], **parts: Any) -> MDP:
        x, rows, count = at["x"], list[Any](), Counter[int]()
        for (state, there, back, zero), (a, b) in zip(self.steps, self.reward, strict=True):
            p = vanish(zero, x)
            earned = a + b * x
            outcomes = [(c, to, earned) for c, to in ((p, there), (1 - p, back)) if c]
            rows.append((state, count[state], outcomes))
            count[state] += 1
        rows += [(3, 0, [(1, 3, 0)]), (4, 0, [(1, 4, 0)])]
        return MDP.from_outcomes(rows, 1, start=self.start, **parts)

    def equations(self, **parts: Any) -> SectionEquations:
        kind = Family(parameters={"x": "1/7"}, build=partial(self.build, **parts), degrees={"x": 4})
        return SectionEquations(kind, "x", Piece(low=F(0), high=F(1), origin=F(1, 7)))

    def following(self, place: F) -> list[set[int]]:
        """The next states of each pair at a place."""
        every = []
        for _, there, back, zero in self.steps:
            every.append({back} if place == zero else {there, back})
        return every

    def find_connected(self, place: F, pairs: Collection[int]) -> set[int]:
        """The states from which some of the pairs lead to an end at last."""
        near = {3, 4}
        for _ in range(3):
            for pair in pairs:
                if near & self.following(place)[pair]:
                    near.add(self.steps[pair][0])
        return near

    def find_staying(self, place: F) -> set[int]:
        """The pairs of all end components: closed, and each state leads to each other."""
        staying, following = set[int](), self.following(place)
        for size in range(1, len(self.steps) + 1):
            for pairs in combinations(range(len(self.steps)), size):
                states = {self.steps[pair][0] for pair in pairs}
                if not all(following[pair] <= states for pair in pairs):
                    continue
                edges = {(self.steps[pair][0], to) for pair in pairs for to in following[pair]}
                for _ in range(2):
                    edges |= {(s, u) for s, t in edges for v, u in edges if t == v}
                if {*product(states, states)} <= edges:
                    staying.update(pairs)
        return staying

    def find_sure(self, place: F) -> tuple[set[int], set[int]]:
        """The states with a policy that surely reaches the goal, and the pairs that stay there."""
        following, best = self.following(place), {3}
        of_state = [[l for l, each in enumerate(self.steps) if each[0] == s] for s in range(3)]
        for policy in product(*of_state):
            ways = {s: following[policy[s]] for s in range(3)}
            bad = {0, 1, 2, 4} - find_backward(ways, {3})
            best |= {0, 1, 2} - find_backward(ways, bad)
        safe = {
            pair
            for pair, (state, *_) in enumerate(self.steps)
            if state in best and following[pair] <= best
        }
        return best, safe


def find_backward(ways: dict[int, set[int]], target: set[int]) -> set[int]:
    """The states from which the target may be reached."""
    found = {*target}
    for _ in ways:
        found |= {s for s, to in ways.items() if to & found}
    return found


SPANS = [
    (F(0), F(1)), (F(1, 8), F(1, 4)), (F(1, 3), F(2, 5)), (F(2, 5), F(1, 2)), (F(5, 7), F(1)),
    (F(0), F(1, 8)), (F(7, 10), F(5, 7)), (F(2, 5), F(7, 10)), (F(1, 4), F(3, 4)),
]  # fmt: skip


def test_what_stays_and_what_ends_is_found_at_every_place() -> None:
    """Against all sets of pairs at all places; the point 1/7 stands for the others."""
    seen = Counter[object]()
    for seed in range(60):
        model = Vanishing(seed, ends=1 + seed % 2, share=0.75)
        equations, every = model.equations(), range(len(model.steps))
        places = [F(1, 7), *PLACES]
        staying = set.union(*map(model.find_staying, places))
        assert {*equations.staying_pairs} == staying
        assert equations.one_solution() == (not staying)
        assert equations.improper == bool(staying)
        costs = all(a < 0 and a + b < 0 for a, b in (model.reward[pair] for pair in staying))
        assert equations.staying_costs() == costs
        assert not equations.may_miss_goal
        seen[bool(staying), costs] += 1
        rng = np.random.default_rng(seed)
        for low, high in SPANS:
            some = [pair for pair in every if rng.random() < 0.8]
            for pairs in (every, some):
                inside = [F(1, 7), *(place for place in PLACES if low <= place <= high)]
                wanted = all(len(model.find_connected(at, pairs)) == 5 for at in inside)
                assert equations.can_end(pairs, low, high) == wanted
                seen[wanted] += 1
    assert min(seen.values()) > 3
    assert len(seen) == 5


def test_pairs_that_may_miss_the_goal_are_left_out() -> None:
    """Against all policies at all places: which states are sure of the goal, by which pairs."""
    seen = Counter[object]()
    for seed in range(100):
        model = Vanishing(seed, ends=2, share=0.1)
        equations = model.equations(goal=[3], unreached=-inf)
        places = [F(1, 7), *PLACES]
        sure, safe = model.find_sure(places[0])
        if not any(4 in each for each in model.following(F(1, 7))):
            assert not equations.may_miss_goal
            assert equations.live == [0, 1, 2]
            continue
        if any(model.find_sure(place) != (sure, safe) for place in places):
            assert equations.may_miss_goal
            seen["jumps"] += 1
            continue
        assert equations.may_miss_goal == (not sure >= {*model.start})
        assert equations.live == sorted(sure - {3})
        assert [*equations.following] == sorted(safe)
        assert {s: [*pairs] for s, pairs in equations.pairs.items()} == {
            s: [pair for pair in sorted(safe) if model.steps[pair][0] == s] for s in sure - {3}
        }
        barred = [
            pair for pair, (s, *_) in enumerate(model.steps) if s in sure and pair not in safe
        ]
        assert equations.barred == barred
        gaps = [fmpq_poly([int(pair in barred)]) for pair in range(equations.mdp.n_pairs)]
        assert equations.gap == gaps
        seen[equations.may_miss_goal, bool(barred)] += 1
        # If missing the goal pays, no run may do so, nor stay forever.
        pays = model.equations(goal=[3], unreached=inf)
        assert pays.may_miss_goal == (4 in find_forward(model))
        assert pays.barred == []
        assert not pays.staying_costs()
    assert len(seen) == 5


def find_forward(model: Vanishing) -> set[int]:
    """The states that some run may reach."""
    met = {*model.start}
    for _ in range(5):
        for (state, *_), to in zip(model.steps, model.following(F(1, 7)), strict=True):
            if state in met:
                met |= to
    return met


def test_a_discount_that_touches_1_inside_is_looked_at() -> None:
    """γ = 1 - (x - z)², and a run that may end beside the target of a total."""
    for zero in (F(1, 4), F(2, 5), F(1, 2), F(2)):
        for target in ([1], [1, 2]):

            def build(at: dict[str, F], zero: F = zero, target: Any = target) -> MDP:
                rows = [
                    (0, 0, [(F(1, 2), 1, -1), (F(1, 2), 2, -1)]),
                    *((s, 0, [(1, s, 0)]) for s in (1, 2)),
                ]
                rate = 1 - (at["x"] - zero) ** 2 / 9
                return MDP.from_outcomes(rows, rate, target=target, start=0)

            kind = Family(parameters={"x": "1/7"}, build=build, degrees={"x": 2})
            equations = SectionEquations(kind, "x", Piece(low=F(0), high=F(1), origin=F(1, 7)))
            assert equations.may_miss_goal == (target == [1] and zero < 1)


def test_a_state_that_is_terminal_where_the_discount_is_1_may_lie_beside_the_goal() -> None:
    """γ = x: what is earned there at every step, x - 1, is 0 at the end of the section."""

    def build(at: dict[str, F]) -> MDP:
        x = at["x"]
        rows = [(0, 0, [(1, 1, x)]), (0, 1, [(1, 2, 0)]), (1, 0, [(1, 1, 0)]),
                (2, 0, [(1, 2, x - 1)])]  # fmt: skip
        return MDP.from_outcomes(rows, x, labels={"home": [1]}, start=0).until("home")

    kind = Family(parameters={"x": "1/2"}, build=build)
    for high in (F(3, 4), F(1)):
        equations = SectionEquations(kind, "x", Piece(low=F(0), high=high, origin=F(1, 2)))
        assert equations.live == [0, 2]
        assert equations.may_miss_goal == (high == 1)


def test_values_that_move_by_one_state_are_others() -> None:
    equations = made(False)
    values = tuple(fmpq_poly([k, 1]) for k in (1, 2, 5)), fmpq_poly([1])
    equations.update_gaps(values)
    for k in (1, 2):
        turned = (*values[0][k:], *values[0][:k]), values[1]
        for pair in equations.following:
            total = equations.reward[pair]
            total += sum((p * turned[0][to] for to, p in equations.following[pair]), fmpq_poly())
            assert equations.compute_action_value(pair, turned) == total


def test_the_pairs_of_a_policy_have_weights() -> None:
    half = to_flint(F(1, 2))
    assert list_pairs([[(0, half), (1, half)], [(2, to_flint(F(0))), (3, half + half)], []]) == [
        0, 1, 3]  # fmt: skip


@pytest.mark.parametrize("ends", [True, False])
def test_values_of_a_policy_are_told_from_others_state_by_state(ends: bool) -> None:
    """Of 2/3 and 1/3 in state 0: D v = D (r + γ P v), solved by hand; state 2 is worth 0."""
    equations, third = made(ends), to_flint(F(1, 3))
    policy = [[(0, 2 * third), (1, third)], [(2, to_flint(F(1)))], []]
    # v0 = (8 x + 1) / 3 + (2 x + 1) / 4 v1; v1 = x, or x / 2 + 3/8 v0.
    rest, share = fmpq_poly([1, 8]) / 3, fmpq_poly([1, 2]) / 4
    below, first = fmpq_poly([1]), rest + share * fmpq_poly([0, 1])
    second = fmpq_poly([0, 1])
    if not ends:
        below = 1 - share * 3 / 8
        first = rest + share * fmpq_poly([0, 1]) / 2
        second = fmpq_poly([0, 1]) / 2 * below + first * 3 / 8
    numbers = [first, second, fmpq_poly()]
    assert [*equations.find_policy_faults(policy, (numbers, below))] == []
    assert [*equations.find_value_faults((numbers, below))] == []
    for state, faults in ((0, [0] if ends else [0, 1]), (1, [0, 1]), (2, [])):
        for more in (fmpq_poly([1]), fmpq_poly([0, 1])):
            wrong = [number + more * (k == state) for k, number in enumerate(numbers)]
            assert [*equations.find_policy_faults(policy, (wrong, below))] == faults
            said = ["a terminal state is worth something"] * (state == 2)
            assert [*equations.find_value_faults((wrong, below))] == said


def test_the_start_is_weighed() -> None:
    mdp = family(True).at({}).with_(start={0: "1/3", 1: "2/3"})
    section = Piece(low=F(1, 4), high=F(3, 4), origin=F(1, 2))
    equations = SectionEquations(parametric(mdp), "discount", section)
    assert equations.weigh_start(1) == ((0, F(1, 3)), (1, F(2, 3)))
    assert equations.weigh_start(-1) == ((0, F(-1, 3)), (1, F(-2, 3)))
