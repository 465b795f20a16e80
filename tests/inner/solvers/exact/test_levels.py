"""Levels of certificates, held to fractions added one by one."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction as F
from math import gcd

import numpy as np
import pytest
from oracle import Row, mean, rows_of

from exact_mdp import MDP, ModelError
from exact_mdp.mdp.exact import BellmanRows, bellman_rows
from exact_mdp.solvers.exact import levels
from exact_mdp.solvers.exact.levels import (
    Level,
    combine_levels,
    compute_surplus_signs,
    compute_surpluses,
    list_level_steps,
    make_fraction,
    yield_level_advantages,
)


def random_level(rng: np.random.Generator, states: int) -> Level:
    """Numbers over several denominators, in groups."""
    groups = int(rng.integers(1, min(states, 3) + 1))
    below = rng.integers(1, 9, groups).tolist()
    group = np.append(np.arange(groups), rng.integers(0, groups, states - groups))
    return Level(top=rng.integers(-9, 10, states).tolist(), below=below, group=group)


def listed(level: Level) -> list[F]:
    return [F(t, level.below[g]) for t, g in zip(level.top, level.group.tolist(), strict=True)]


def models() -> Iterator[tuple[MDP, BellmanRows, list[Row]]]:
    """Models with states of several numbers of actions, and other scales in each."""
    rng = np.random.default_rng(0)
    for rate in ("0", "1/2", "9/10", "1") * 5:
        size, rows = int(rng.integers(1, 5)), []
        for s in range(size):
            for a in sorted(rng.choice(4, rng.integers(1, 4), replace=False).tolist()):
                weights = rng.integers(1, 6, rng.integers(1, 4)).tolist()
                reward = F(int(rng.integers(-5, 6)), int(rng.integers(1, 5)))
                rows.append((s, a, [(F(w, sum(weights)), int(rng.integers(0, size)), reward)
                                    for w in weights]))  # fmt: skip
        mdp = MDP.from_outcomes(rows, rate)
        yield mdp, bellman_rows(mdp), rows_of(mdp)


def test_a_fraction_is_in_lowest_terms() -> None:
    rng = np.random.default_rng(1)
    for top, below in [(0, 7), (-6, 4), (10**400, 3 * 10**399), *rng.integers(1, 99, (50, 2))]:
        made, wanted = make_fraction(int(top), int(below)), F(int(top), int(below))
        assert type(made) is F
        assert (made.numerator, made.denominator) == (wanted.numerator, wanted.denominator)
        assert type(made.numerator) is type(made.denominator) is int
        assert gcd(made.numerator, made.denominator) == 1
        assert hash(made) == hash(wanted)


def test_numbers_of_a_level_are_tops_over_the_belows_of_their_groups() -> None:
    rng = np.random.default_rng(2)
    for states in (1, 2, 6):
        for _ in range(10):
            level = random_level(rng, states)
            numbers = listed(level)
            assert level.each_below == [level.below[g] for g in level.group]
            for sign in (1, -1):
                assert level.to_fractions(sign).tolist() == [sign * x for x in numbers]
                assert level.to_floats(sign).tolist() == [float(sign * x) for x in numbers]
            assert level.to_fractions().tolist() == numbers
            assert level.to_floats().tolist() == [float(x) for x in numbers]
            for array in (level.to_fractions(), level.to_floats()):
                with pytest.raises(ValueError, match="read-only"):
                    array[0] = 1
            one = Level.of(numbers)
            assert one.to_fractions().tolist() == numbers
            assert (one.below, one.group.tolist()) == ([one.below[0]], [0] * states)
            assert gcd(one.below[0], *one.top) == 1
    with pytest.raises(ModelError):
        Level.of([F(10**400)]).to_floats()
    assert Level.of([F(10**400), F(10**400, 3)]).to_fractions()[1] == F(10**400, 3)


def test_denominators_that_no_number_has_are_left_out() -> None:
    level = Level.from_groups([1, 2, 3], [5, 7, 11, 13], np.array([3, 1, 3]))
    assert (level.top, level.below, level.group.tolist()) == ([1, 2, 3], [7, 13], [1, 0, 1])
    assert listed(level) == [F(1, 13), F(2, 7), F(3, 13)]


def test_some_numbers_are_put_over_one_denominator() -> None:
    rng = np.random.default_rng(3)
    for _ in range(30):
        level = random_level(rng, 6)
        for _ in range(2):  # what is kept of the first time is right the second time
            states = rng.integers(0, 6, rng.integers(1, 5)).tolist()
            numbers, unit = level.over_one(states, level.group.tolist())
            assert [F(n, unit) for n in numbers] == [listed(level)[s] for s in states]
            assert all(type(n) is int for n in numbers)
            used = {level.below[level.group[s]] for s in states}
            if len(level.below) > 1:
                assert unit == np.lcm.reduce([*used])


def test_what_is_kept_belongs_to_one_level_alone() -> None:
    level = Level(top=[1, 1], below=[2, 3], group=np.array([0, 1]))
    assert level.over_one([0, 1], [0, 1]) == ([3, 2], 6)
    other = replace(level, below=[5, 7])
    assert other.over_one([0, 1], [0, 1]) == ([7, 5], 35)
    assert repr(level) == "Level(top=[1, 1], below=[2, 3], group=array([0, 1]))"


def test_a_mean_is_a_weighted_sum() -> None:
    rng = np.random.default_rng(4)
    for _ in range(30):
        level = random_level(rng, 5)
        weights = [(int(s), F(int(n), 6)) for s, n in rng.integers(0, 5, (4, 2))]
        wanted = sum((w * listed(level)[s] for s, w in weights), F(0))
        assert level.compute_mean(weights) == level.compute_mean(iter(weights)) == wanted
        assert level.compute_mean([]) == 0


def test_levels_are_combined_number_by_number() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        first = random_level(rng, 5)
        each = [first, *(Level(top=rng.integers(-9, 10, 5).tolist(), below=first.below,
                               group=first.group) for _ in range(2))]  # fmt: skip
        weights = [F(int(n), int(d)) for n, d in rng.integers(1, 7, (3, 2))]
        weights[1] *= -1
        made = combine_levels(each, weights)
        columns = zip(*map(listed, each), strict=True)
        assert listed(made) == [
            sum((w * x for w, x in zip(weights, column, strict=True)), F(0)) for column in columns
        ]
        assert listed(combine_levels(each[:1], [2])) == [2 * x for x in listed(first)]


def shares(found: list[tuple[int, int]]) -> list[F]:
    assert all(below > 0 for _, below in found)
    return [F(top, below) for top, below in found]


def test_what_pairs_gain_on_values_is_what_the_equation_leaves() -> None:
    rng = np.random.default_rng(6)
    for mdp, equations, rows in models():
        value = random_level(rng, mdp.n_states)
        numbers, rate = listed(value), mdp.discount_exact
        wanted = [r + rate * mean(law, numbers) - numbers[s] for s, _, r, law in rows]
        (found,) = compute_surpluses(equations, value)
        assert shares(found) == wanted
        some = rng.integers(0, mdp.n_pairs, 3)
        (found,) = compute_surpluses(equations, value, pairs=some)
        assert shares(found) == [wanted[pair] for pair in some]
        (step,) = list_level_steps(equations, value)
        for top, first, second in yield_level_advantages(equations, step):
            assert min(first, second) > 0
            assert type(top) is type(first) is type(second) is int
        assert compute_surplus_signs(equations, step).tolist() == [
            (x > 0) - (x < 0) for x in wanted
        ]
        own = np.unique(some)
        others = [0 if pair in own else (x > 0) - (x < 0) for pair, x in enumerate(wanted)]
        assert compute_surplus_signs(equations, step, own).tolist() == others


def test_gains_of_three_levels_are_those_of_gain_bias_and_the_next() -> None:
    """d(g), r - g + d(h) and d(w) - h."""
    rng = np.random.default_rng(7)
    for mdp, _, rows in models():
        equations = bellman_rows(mdp.with_(discount=1))
        made = [random_level(rng, mdp.n_states) for _ in range(3)]
        g, h, w = map(listed, made)
        wanted = [
            [mean(law, g) - g[s] for s, _, _, law in rows],
            [r - g[s] + mean(law, h) - h[s] for s, _, r, law in rows],
            [mean(law, w) - w[s] - h[s] for s, _, _, law in rows],
        ]
        assert [shares(found) for found in compute_surpluses(equations, *made)] == wanted
        for step, each in zip(list_level_steps(equations, *made), wanted, strict=True):
            assert compute_surplus_signs(equations, step).tolist() == [
                (x > 0) - (x < 0) for x in each
            ]


def test_numbers_of_one_denominator_are_not_looked_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(levels, "lcm", None)
    one = Level.of([F(1, 2), F(1, 3)])
    assert one.over_one([1], [0, 0]) == ([2], 6)


def test_signs_are_integers_of_what_is_gained() -> None:
    rows = [(0, a, [(1, 0, reward)]) for a, reward in enumerate((1, 0, -1))]
    equations = bellman_rows(MDP.from_outcomes(rows))
    (step,) = list_level_steps(equations, Level.of([F(0)]))
    found = compute_surplus_signs(equations, step)
    assert (found.tolist(), found.dtype) == ([1, 0, -1], np.int64)


def test_advantages_count_the_denominators_of_rewards() -> None:
    equations = bellman_rows(MDP.from_outcomes([(0, a, [(1, 0, 1)]) for a in range(4)]))
    step = Level.of([F(0)]), [1, 1, 1, 1], [1, 1, 2, 3]
    found = [F(top, a * b) for top, a, b in yield_level_advantages(equations, step)]
    assert found == [1, 1, F(1, 2), F(1, 3)]
