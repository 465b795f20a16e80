"""Exact solutions of linear systems, held to elimination in fractions and to chains by hand."""

from collections.abc import Iterator
from fractions import Fraction as F
from math import lcm, prod
from typing import Any

import numpy as np
import pytest
from integer_systems import Entries, eliminated, matrix_of, solution
from oracle import Row, fixed_point, policies, policy_values, rows_of, visits

from exact_mdp import MDP, ModelError
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.mdp.table import to_integer_array
from exact_mdp.solvers.exact import linear
from exact_mdp.solvers.exact.linear import Matrix, solve_all


def ring(size: int, pivot: int, weight: int) -> Matrix:
    """pivot x(s) - weight x(s + 1) = b(s), all round."""
    place = np.arange(size)
    return Matrix.of(
        size,
        np.concatenate([place, place]),
        np.concatenate([place, (place + 1) % size]),
        to_integer_array([pivot] * size + [-weight] * size),
    )


# ---- matrices ------------------------------------------------------------------------------------


def scattered(rng: np.random.Generator, size: int, density: float = 0.4) -> Entries:
    """Entries of a few places, which are not zero; those of the diagonal are large."""
    places = zip(*np.nonzero(rng.random((size, size)) < density), strict=True)
    entries = {(int(i), int(j)): int(rng.integers(1, 9)) for i, j in places}
    return entries | {(i, i): int(rng.integers(50, 99)) for i in range(size)}


def dense_of(matrix: Matrix) -> np.ndarray[Any, Any]:
    dense = np.zeros((matrix.size, matrix.size), dtype=object)
    for i, (columns, entries) in enumerate(matrix.listed):
        assert columns == sorted({*columns})
        dense[i, columns] = entries
    return dense


def test_entries_of_one_place_are_added_up() -> None:
    rng = np.random.default_rng(0)
    for size in (1, 3, 8):
        row, column = rng.integers(0, size, (2, 40))
        entry = rng.integers(-9, 10, 40)
        wanted = np.zeros((size, size), dtype=object)
        for i, j, a in zip(row, column, entry, strict=True):
            wanted[i, j] += int(a)
        matrix = Matrix.of(size, row, column, entry)
        assert matrix.size == size
        assert len(matrix.column) == len({*zip(row.tolist(), column.tolist(), strict=True)})
        assert (dense_of(matrix) == wanted).all()
        assert (dense_of(matrix.transposed) == wanted.T).all()
        assert matrix.row.tolist() == [i for i, (each, _) in enumerate(matrix.listed) for _ in each]
        assert matrix.transposed.denominators is matrix.denominators
    some = Matrix.of(4, np.array([2, 0]), np.array([1, 3]), np.array([5, 7]))
    assert some.listed == [([3], [7]), ([], []), ([1], [5]), ([], [])]
    assert Matrix.of(2, np.array([0]), np.array([1]), np.array([5])).listed == [
        ([1], [5]),
        ([], []),
    ]


def test_steps_are_components_in_the_order_of_solution() -> None:
    """All that a step leads to was solved for before; what leads round is together."""
    rng = np.random.default_rng(1)
    for _ in range(30):
        size = int(rng.integers(1, 12))
        matrix = matrix_of(size, scattered(rng, size, 0.12))
        dense = dense_of(matrix)
        ways = (dense != 0).astype(int) + np.eye(size, dtype=int)
        reach = np.linalg.matrix_power(ways, size) > 0
        done = set[int]()
        for states, block in matrix.steps:
            listed = {*states}
            assert done.isdisjoint(listed)
            if block is None:
                for s in states:
                    assert {t for t in range(size) if reach[s, t]} - {s} <= done
            else:
                for s in states:
                    assert listed == {t for t in range(size) if reach[s, t] and reach[t, s]}
                    assert {t for t in range(size) if reach[s, t]} <= done | listed
                assert 1 < len(states) == len(listed)
                assert states == sorted(states)
                assert (dense_of(block) == dense[states][:, states]).all()
            done |= listed
        assert done == {*range(size)}


def test_rings_that_do_not_lead_to_each_other_are_apart() -> None:
    """Two rings, with a single unknown between their numbers, and one unknown alone."""
    places = [(0, 0), (0, 1), (1, 0), (1, 1), (2, 2), (3, 3), (3, 4), (4, 3), (4, 4)]
    matrix = matrix_of(5, {(i, j): 3 if i == j else -1 for i, j in places})
    parts = {(*states,): block is not None for states, block in matrix.steps}
    assert parts == {(0, 1): True, (3, 4): True, (2,): False}
    assert solution(matrix, [4, 4, 3, 4, 4]) == [2, 2, 1, 2, 2]
    assert matrix_of(1, {(0, 0): 2}).steps == [([0], None)]


def test_several_right_sides_share_their_denominators() -> None:
    rng = np.random.default_rng(2)
    for density in (0.1, 0.4):
        for _ in range(10):
            entries = scattered(rng, 7, density)
            matrix = matrix_of(7, entries)
            sides = rng.integers(-9, 10, (3, 7)).tolist()
            levels = solve_all(matrix, sides)
            for level, side in zip(levels, sides, strict=True):
                assert list(level.to_fractions()) == eliminated(7, entries, side)
                assert level.below == levels[0].below
                assert (level.group == levels[0].group).all()
            (zero,) = solve_all(matrix, [[0] * 7])
            assert zero.top == [0] * 7
            assert zero.below == [1]


def test_denominators_are_in_lowest_terms_and_apart_where_they_are_long() -> None:
    """A common denominator of some states is no longer than twice the longest, and 128 bits."""
    primes = [2**61 - 1, 2**89 - 1, 2**107 - 1, 2**127 - 1, 2**521 - 1]

    def groups(pivots: list[int]) -> list[int]:
        size = len(pivots)
        matrix = matrix_of(size, {(i, i): pivot for i, pivot in enumerate(pivots)})
        (level,) = solve_all(matrix, [[1] * size])
        assert list(level.to_fractions()) == [F(1, pivot) for pivot in pivots]
        assert level.top == [b // p for b, p in zip(level.each_below, pivots, strict=True)]
        return level.below

    assert groups([3, 5, 7]) == [105]
    assert groups([4, -6, 9]) == [36]
    assert groups(primes[:3]) == [primes[0] * primes[1] * primes[2]]  # 257 bits, of 342 allowed
    assert sorted(groups([2**521 - 1, 2**607 - 1, 2**127 - 1])) == [
        (2**521 - 1) * (2**607 - 1) * (2**127 - 1)
    ]  # 1255 bits, of 1342
    assert sorted(groups([2**521 - 1, 2**607 - 1, 2**279 - 1, 2**127 - 1])) == sorted(
        [2**521 - 1, 2**607 - 1, 2**279 - 1, 2**127 - 1]
    )  # 1534 bits
    for last, bits in ((2**129 - 1, 388), (7**46, 389)):  # of 2 · 130 + 128 = 388
        pivots = [2**129, 3**82, last]
        assert (max(x.bit_length() for x in pivots), prod(pivots).bit_length()) == (130, bits)
        assert sorted(groups(pivots)) == ([prod(pivots)] if bits == 388 else sorted(pivots))
    (level,) = solve_all(matrix_of(2, {(0, 0): 6, (1, 1): 10}), [[3, 5]])
    assert (level.top, level.below) == ([1, 1], [2])


def test_a_singular_pivot_is_named() -> None:
    for entries in ({(0, 1): 1, (1, 1): 2}, {(0, 0): 1}, {(0, 0): 1, (0, 1): 2, (1, 1): 0}):
        with pytest.raises(ZeroDivisionError, match="the matrix is singular"):
            solve_all(matrix_of(2, entries), [[1, 1]])


def test_known_denominators_are_kept_by_component(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linear, "FEW", 1)
    entries = {(0, 0): 7, (1, 1): 5, (1, 2): -2, (2, 1): -1, (2, 2): 3, (0, 1): 1,
               (3, 3): 11, (3, 4): -1, (4, 3): -1, (4, 4): 3}  # fmt: skip
    matrix, asked = matrix_of(5, entries), list[Any]()
    kept = linear.Lifting.solve

    def solve(self: Any, side: Any, rows: Any, known: Any = None) -> Any:
        asked.append(known)
        return kept(self, side, rows, known)

    monkeypatch.setattr(linear.Lifting, "solve", solve)
    for each in (matrix, matrix, matrix.transposed):
        solution(each, [1, 2, 3, 4, 5])
    assert asked == [None, None, 13, 32, 32, 13]  # the other way, in the other order
    assert {first: int(below) for first, below in matrix.denominators.items()} == {1: 13, 3: 32}


@pytest.mark.parametrize("size, many, refused", [(6, 5, True), (6, 6, False)])
def test_many_equations_that_floats_cannot_start_are_refused(
    size: int, many: int, refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(linear, "FEW", 1)
    monkeypatch.setattr(linear, "MANY", many)
    hardly = ring(size, 2**60, 2**60 - 1)
    if refused:
        with pytest.raises(ModelError, match="the equations of 6 states that lead to each other"):
            solution(hardly, [1] * size)
    else:
        assert solution(hardly, [1] * size) == [F(1)] * size


@pytest.mark.parametrize("largest", [5, 6])
def test_the_size_of_a_component_is_limited(largest: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linear, "LARGEST", largest)
    if largest == 5:
        with pytest.raises(ModelError, match="a cycle of 6 states is too large"):
            solution(ring(6, 3, 1), [1] * 6)
    else:
        assert solution(ring(6, 3, 1), [2] * 6) == [F(1)] * 6


def test_few_equations_are_not_lifted(monkeypatch: pytest.MonkeyPatch) -> None:
    used = list[int]()
    monkeypatch.setattr(linear.Lifting, "solve", lambda self, *_: used.append(self.size))
    for few, lifted in ((6, []), (5, [6])):
        monkeypatch.setattr(linear, "FEW", few)
        assert solution(ring(6, 3, 1), [2] * 6) == [F(1)] * 6
        assert used == lifted


# ---- equations of policies -----------------------------------------------------------------------


def some_models() -> Iterator[MDP]:
    """Models whose policies end, with states that are over and of different scales."""
    rng = np.random.default_rng(3)
    for rate in ("1", "1/2", "9/10", "0"):
        for size in (1, 2, 5):
            rows: list[Any] = [(size, 0, [(1, size, 0)])]
            for s in range(size):
                for a in range(int(rng.integers(1, 3))):
                    out = F(1, int(rng.integers(2, 6)))
                    share = F(int(rng.integers(1, 5)), 6)
                    t, u = rng.integers(0, size + 1, 2).tolist()
                    reward = F(int(rng.integers(-9, 10)), int(rng.integers(1, 5)))
                    law = [(out, size, reward), ((1 - out) * share, t, reward),
                           ((1 - out) * (1 - share), u, 2 * reward)]  # fmt: skip
                    rows.append((s, a, law))
            yield MDP.from_outcomes(sorted(rows, key=lambda row: row[:2]), rate)


def each_policy(mdp: MDP) -> Iterator[tuple[list[Row], np.ndarray[Any, Any]]]:
    rows = rows_of(mdp)
    for policy in [*policies(rows)][:5]:
        yield [*policy], np.array([rows.index(row) for row in policy])


def test_values_of_a_policy_are_those_of_its_equations() -> None:
    rng = np.random.default_rng(4)
    for mdp in some_models():
        rows, last = bellman_rows(mdp), mdp.n_states - 1
        for policy, pairs in each_policy(mdp):
            (value,) = linear.evaluate_exactly(rows, pairs)
            wanted = policy_values(policy, mdp.discount_exact, {last})
            assert list(value.to_fractions()) == wanted
            amounts = [rng.integers(-9, 10, mdp.n_pairs).astype(object) for _ in range(2)]
            for level, own in zip(
                linear.evaluate_exactly(rows, pairs, amounts), amounts, strict=True
            ):
                scale = rows.scale.tolist()
                other = [(s, a, F(int(own[pair]), int(scale[s])), law)
                         for pair, (s, a, _, law) in zip(pairs, policy, strict=True)]  # fmt: skip
                assert list(level.to_fractions()) == policy_values(
                    other, mdp.discount_exact, {last}
                )


def test_constants_of_any_denominator_are_solved_for() -> None:
    rng = np.random.default_rng(5)
    for mdp in some_models():
        for policy, pairs in each_policy(mdp):
            rows = bellman_rows(mdp).of_pairs(pairs)
            constant = [F(int(n), int(d)) for n, d in rng.integers(1, 9, (mdp.n_states, 2))]
            constant[-1] = F(0)
            level = linear.solve_policy_equations(linear.build_equations(rows), rows, constant)
            moves = [
                {t: mdp.discount_exact * p for t, p in law.items()} if s < mdp.n_states - 1 else {}
                for s, _, _, law in policy
            ]
            assert list(level.to_fractions()) == fixed_point(constant, moves)


def test_visits_are_counted_from_each_start() -> None:
    """Those of some states lead on; the others count how often runs arrive."""
    rng = np.random.default_rng(6)
    for mdp in some_models():
        size = mdp.n_states
        for policy, pairs in each_policy(mdp):
            rows = bellman_rows(mdp).of_pairs(pairs)
            states = np.append(rng.random(size - 1) < 0.7, False)
            starts = [{0: F(1)}, {0: F(1, 3), size - 1: F(2, 3)}]
            moves = [
                {t: mdp.discount_exact * p for t, p in law.items()} if states[s] else {}
                for s, _, _, law in policy
            ]
            for start in starts:
                level = linear.compute_expected_visits(rows, states, [*start.items()])
                assert list(level.to_fractions()) == visits(start, moves)
    once = linear.compute_expected_visits(rows, states, [(0, F(1))])
    twice = linear.compute_expected_visits(rows, states, [(0, F(1, 2)), (0, F(1, 2))])
    assert list(twice.to_fractions()) == list(once.to_fractions())


def test_a_least_common_multiple_is_positive() -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        numbers = [int(n) or 1 for n in rng.integers(-9, 10, rng.integers(0, 5))]
        assert linear._compute_common_multiple(map(linear.flint.fmpz, numbers)) == lcm(*numbers)
