"""Numeric lifting, held to elimination in FLINT and to integers of Python."""

from collections.abc import Callable
from fractions import Fraction as F
from itertools import islice
from math import lcm, prod
from typing import Any

import flint
import numpy as np
import pytest

from exact_mdp.mdp.table import to_integer_array
from exact_mdp.solvers.exact import lifting
from exact_mdp.solvers.exact.lifting import Lifting

Dense = list[list[int]]


def lifted(dense: Dense) -> Lifting:
    """Return a matrix without its zeros, as lifting takes it."""
    rows = [[(j, a) for j, a in enumerate(row) if a] for row in dense]
    ends = np.cumsum([0, *map(len, rows)])
    column = np.array([j for row in rows for j, _ in row], dtype=np.int64)
    return Lifting(ends, column, to_integer_array(a for row in rows for _, a in row))


def listed(dense: Dense) -> lifting.Rows:
    return [([j for j, a in enumerate(row) if a], [a for a in row if a]) for row in dense]


def eliminated(dense: Dense, side: list[int]) -> list[F]:
    size = len(side)
    exact: Any = flint.fmpz_mat(dense).solve(flint.fmpz_mat(size, 1, side))
    tops, below = exact.numer_denom()
    return [F(int(top), int(below)) for top in tops.entries()]


def chain(rng: np.random.Generator, size: int, bits: int) -> Dense:
    """The equations of a chain that ends, with entries of some bits."""
    dense = [[0] * size for _ in range(size)]
    for s, row in enumerate(dense):
        row[(s + 1) % size] -= 1
        for t in rng.integers(0, size, 3).tolist():
            row[t] -= int(rng.integers(1, 9)) << max(0, bits - 4) | int(rng.integers(0, 2))
        row[s] = 0
        row[s] = (1 << bits) - sum(row)
    return dense


def sides(rng: np.random.Generator, size: int, bits: int) -> list[list[int]]:
    large = [int(x) << bits for x in rng.integers(-9, 10, size)]
    return [rng.integers(-9, 10, size).tolist(), large, [0] * size, [1] + [0] * (size - 1)]


@pytest.mark.parametrize("bits", [1, 20, 40, 61, 62, 70, 130, 300, 1300])
def test_solutions_are_those_of_elimination(bits: int) -> None:
    rng = np.random.default_rng(bits)
    for size in (1, 2, 5, 12) if bits < 999 else (4,):
        dense = chain(rng, size, bits)
        matrix = lifted(dense)
        for side in sides(rng, size, bits):
            found = matrix.solve(side, listed(dense))
            assert found is not None
            top, below = found
            assert [F(int(x), int(below)) for x in top] == eliminated(dense, side)


@pytest.mark.parametrize("widths", [(40,), (24,)])
def test_digits_of_each_width_lead_to_the_solution(
    widths: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lifting, "WIDTHS", widths)
    rng = np.random.default_rng(0)
    dense, side = chain(rng, 9, 30), rng.integers(-9, 10, 9).tolist()
    matrix = lifted(dense)
    assert matrix.width == widths[0]
    wanted = eliminated(dense, side)
    found = matrix.solve(side, listed(dense))
    assert found is not None
    assert [F(int(x), int(found[1])) for x in found[0]] == wanted
    below = lcm(*(x.denominator for x in wanted))
    for known in (below, 6 * below, 1, below // 7 + 1):
        found = matrix.solve(side, listed(dense), flint.fmpz(known))
        assert found is not None
        assert [F(int(x), int(found[1])) for x in found[0]] == wanted


@pytest.fixture
def counts(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return how many digits each solution has taken so far."""
    counts, kept = list[int](), Lifting._yield_digits

    def counted(self: Lifting, *given: Any) -> Any:
        counts.append(0)
        for digit in kept(self, *given):
            counts[-1] += 1
            yield digit

    monkeypatch.setattr(Lifting, "_yield_digits", counted)
    return counts


def test_a_known_denominator_takes_half_as_many_digits(counts: list[int]) -> None:
    rng = np.random.default_rng(1)
    dense, side = chain(rng, 40, 30), rng.integers(-9, 10, 40).tolist()
    matrix = lifted(dense)
    first = matrix.solve(side, listed(dense))
    assert first is not None
    again = matrix.solve(side, listed(dense), first[1])
    assert again == first
    # a number of b bits over q < 2^b: 2 b bits tell q, b bits and a few more those with q known
    bits = int(first[1].bit_length())
    assert counts[0] >= 2 * bits // 40
    before = (4 + 54) // 40 + 1  # of numbers below 2^4 and a solution 2^54 times as large
    assert counts[1] == before + (bits + 2 * lifting.SPARE) // 40 + 1
    assert counts[0] <= 1.2 * (2 * bits // 40 + 10) + 1


def test_narrower_digits_are_taken_where_floats_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    """1 - 2^-k of a ring: the solution is 2^k times as large as the side, and rounding as well."""

    def ring(bits: int) -> Dense:
        return [[2**bits, 1 - 2**bits, 0], [0, 2**bits, 1 - 2**bits], [1 - 2**bits, 0, 2**bits]]

    widths = list[int]()
    for bits in (5, 11, 18, 26, 45, 53):
        dense, side = ring(bits), [1, 2, -5]
        matrix = lifted(dense)
        found = matrix.solve(side, listed(dense))
        widths.append(matrix.width)
        if found is not None:
            top, below = found
            assert [F(int(x), int(below)) for x in top] == eliminated(dense, side)
        assert (found is None) == (matrix.width == 0)
    assert widths == sorted(widths, reverse=True)
    assert len({*widths}) >= 3
    assert widths[-1] == 0


def test_singular_matrices_have_no_digits() -> None:
    matrix = lifted([[1, -1], [-1, 1]])
    assert matrix.width == 0
    assert matrix.solve([1, 2], listed([[1, -1], [-1, 1]])) is None


def test_numbers_are_split_into_digits_and_joined_again() -> None:
    rng = np.random.default_rng(2)
    for width in (24, 32, 40):
        for count in (1, 2, 5):
            most = 1 << (width * count - 1)
            numbers = [0, 1, -1, most - 1, -most]
            numbers += [int(rng.integers(-(1 << 62), 1 << 62)) * most >> 63 for _ in range(9)]
            digits = np.array([*lifting._digits_of(numbers, width, count)])
            assert digits.shape == (count, len(numbers))
            assert digits[1:].min(initial=0) >= 0
            assert np.abs(digits).max() < 1 << width
            place = [1 << width * (count - 1 - k) for k in range(count)]
            together = [sum(p * int(d) for p, d in zip(place, own, strict=True))
                        for own in digits.T]  # fmt: skip
            assert together == numbers
            assert lifting._join_digits(digits, width) == numbers
    # digits as they come are of either sign, and may be as large as the base
    for width in (24, 40):
        digits = rng.integers(-(1 << width), (1 << width) + 1, (4, 600))
        wanted = [sum(int(d) << width * (3 - k) for k, d in enumerate(own)) for own in digits.T]
        assert lifting._join_digits(digits, width) == wanted


def test_digits_come_out_as_the_solution_has_them() -> None:
    """The first ones, joined, are within a unit of 2^(k t) x, whatever A is."""
    rng = np.random.default_rng(3)
    for bits in (3, 30, 90):
        dense = chain(rng, 7, bits)
        side = [int(x) << bits for x in rng.integers(-9, 10, 7)]
        matrix, exact = lifted(dense), eliminated(dense, side)
        lead = (max(map(abs, side)).bit_length() + 54) // 40 + 1
        digits = np.array([*islice(matrix._yield_digits(side, lead), lead + 9)])
        for count in (lead, lead + 4, lead + 9):
            joined = lifting._join_digits(digits[:count], 40)
            shift = 40 * (count - lead)
            assert all(abs(n - x * 2**shift) <= 1 for n, x in zip(joined, exact, strict=True))


def test_a_denominator_is_found_where_bits_tell_it() -> None:
    """A fraction p / q is 2^-(b + 1) from its b bits, and others of so small a q far more."""
    rng = np.random.default_rng(4)
    for bits in (10, 40, 100):
        for _ in range(20):
            below = int(rng.integers(1 << 8, 1 << 9)) * 2 ** (bits - 9) + 1
            top = int(rng.integers(1, 1 << 60)) * below // (1 << 60)
            enough = 2 * bits + lifting.SPARE + 4
            number = flint.fmpz(round(F(top, below) * 2**enough))
            assert lifting._find_denominator(number, enough) == F(top, below).denominator
            few = bits + lifting.SPARE // 2
            short = flint.fmpz(round(F(top, below) * 2**few))
            assert lifting._find_denominator(short, few) is None


def test_a_denominator_is_told_from_chance_by_40_bits() -> None:
    """With q of 12 bits, q x is so many bits from an integer that chance alone would need 2^40."""
    below, bits = 2**11 + 1, 101  # 12 bits
    near = (2**bits * 5) // below  # q x is less than q / 2^101 from 5
    for away, found in ((36, True), (37, False)):
        number = flint.fmpz(near + 2**away)  # q 2^away has 12 + away bits
        assert (12 + (12 + away) < bits - lifting.SPARE) is found
        assert lifting._find_denominator(number, bits) == (below if found else None)


def test_fractions_are_found_over_a_multiple_of_what_is_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tops, belows, bits = [5, -7, 0, 123456, 9], [3, 35, 1, 77, 1001], 400
    numbers = [round(F(a, b) * 2**bits) for a, b in zip(tops, belows, strict=True)]
    for known in (1, 3, 35, 3003, 10**9):
        found = lifting._over_one_denominator(numbers, bits, flint.fmpz(known))
        assert found is not None
        top, below = found
        assert below % known == 0
        assert [F(int(x), int(below)) for x in top] == [
            F(a, b) for a, b in zip(tops, belows, strict=True)
        ]
        assert below == lcm(known, *belows)
    factor, asked = 2**300 + 157, list[int]()  # the known one lacks 7: 80 bits more tell it
    few = 301 + 2 * lifting.SPARE
    for top_of in (1, -123456789):
        number = round(F(top_of, 7 * factor) * 2**few)
        found = lifting._over_one_denominator([number], few, flint.fmpz(factor))
        assert found == ([flint.fmpz(top_of)], flint.fmpz(7 * factor))
    monkeypatch.setattr(lifting, "_find_denominator", lambda *_, **__: asked.append(1))
    found = lifting._over_one_denominator(numbers, bits, flint.fmpz(3003 * 5))
    assert found is not None
    assert asked == []  # nothing is looked for where the known one does
    monkeypatch.undo()
    rare = [*numbers, int(prod(range(1, 60))) << bits >> 200 | 1]
    long = [rare[-1] * 12345678901234567891 % 2**bits | 2 ** (bits - 2)]
    assert lifting._over_one_denominator(long, bits, flint.fmpz(1)) is None


@pytest.mark.parametrize("away, exact", [(59, F(5)), (60, 5 + F(1, 2**40))])
def test_a_number_is_close_to_a_fraction_by_40_bits(away: int, exact: F) -> None:
    """Chance comes as close as 2^-41 once in 2^40 times: 5 + 2^-41 counts as 5."""
    number = (5 << 100) + (1 << away)
    found = lifting._over_one_denominator([number], 100, flint.fmpz(1))
    assert found == ([flint.fmpz(exact.numerator)], flint.fmpz(exact.denominator))


def test_a_solution_is_one_of_every_row() -> None:
    dense = [[2, -1, 0], [0, 3, -1], [-1, 0, 4]]
    exact = eliminated(dense, [1, 2, 3])
    below = lcm(*(x.denominator for x in exact))
    top = [flint.fmpz(int(x * below)) for x in exact]
    rows, side = listed(dense), [1, 2, 3]
    assert lifting._is_solution(rows, side, top, flint.fmpz(below))
    assert not lifting._is_solution(rows, side, top, flint.fmpz(below + 1))
    for k in range(3):
        other = [x + (i == k) for i, x in enumerate(top)]
        assert not lifting._is_solution(rows, side, other, flint.fmpz(below))


def test_a_wrong_denominator_costs_digits_and_no_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Candidates that solve nothing are refused, until there can be no more digits."""
    rng = np.random.default_rng(5)
    dense, side = chain(rng, 6, 10), rng.integers(-9, 10, 6).tolist()
    kept: Callable[..., Any] = lifting._is_solution
    tries = list[int]()

    def refused(*given: Any) -> bool:
        tries.append(1)
        return len(tries) > 3 and kept(*given)

    monkeypatch.setattr(lifting, "_is_solution", refused)
    found = lifted(dense).solve(side, listed(dense))
    assert found is not None
    assert [F(int(x), int(found[1])) for x in found[0]] == eliminated(dense, side)
    monkeypatch.setattr(lifting, "_is_solution", lambda *_: False)
    matrix = lifted(dense)
    assert matrix.solve(side, listed(dense)) is None
    assert matrix.width == 0


def test_without_a_solution_digits_end_where_any_determinant_would_be_told(
    monkeypatch: pytest.MonkeyPatch, counts: list[int]
) -> None:
    """Two determinants of K rows of b bits, by Hadamard, are less than 2^(2 K b)."""
    monkeypatch.setattr(lifting, "_is_solution", lambda *_: False)
    monkeypatch.setattr(lifting, "WIDTHS", (40,))
    rng = np.random.default_rng(6)
    for size, bits in ((12, 61), (12, 90)):
        dense, side = chain(rng, size, bits), [9 << 21, *rng.integers(-9, 10, size - 1).tolist()]
        matrix = lifted(dense)
        assert matrix.solve(side, listed(dense)) is None
        assert side[0].bit_length() + 54 == 79  # one bit more would take a digit more
        before = (max(map(abs, side)).bit_length() + 54) // 40 + 1
        whole = sum(sum(map(abs, row)).bit_length() for row in dense)
        assert counts.pop() == before + 2 * (whole + lifting.SPARE) // 40 + 1


def test_digits_too_long_end_the_search_at_once(
    monkeypatch: pytest.MonkeyPatch, counts: list[int]
) -> None:
    """The solution of a ring of 1 - 2^-45 is 2^45 as large as its side, and floats are lost."""
    monkeypatch.setattr(lifting, "WIDTHS", (40,))
    size, bits = 16, 45
    dense = [[0] * size for _ in range(size)]
    for s, row in enumerate(dense):
        row[s], row[(s + 1) % size] = 2**bits, 1 - 2**bits
    side = [s % 5 - 1 for s in range(size)]
    assert lifted(dense).solve(side, listed(dense)) is None
    assert counts == [(3 + 54) // 40 + 1 + 24]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("more", [0, 1])
def test_a_digit_may_be_as_large_as_the_base(
    sign: int, more: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A larger one, of either sign, ends the search after the first digits."""
    dense, asked = chain(np.random.default_rng(7), 16, 61), list[int]()

    def digits(self: Lifting, *_: Any) -> Any:
        while True:
            asked.append(1)
            yield np.array([0] * 15 + [sign * ((1 << 40) + more)])

    monkeypatch.setattr(Lifting, "_yield_digits", digits)
    monkeypatch.setattr(lifting, "_is_solution", lambda *_: False)
    assert lifted(dense)._solve_by_digits([1] * 16, listed(dense), None) is None
    before, whole = (1 + 54) // 40 + 1, sum(sum(map(abs, row)).bit_length() for row in dense)
    most = before + 2 * (whole + lifting.SPARE) // 40 + 1
    assert len(asked) == (before + 24 if more else most)


def test_a_small_row_beside_a_large_one_loses_no_digit() -> None:
    dense, side = [[2**70, 1], [1, 3]], [5, -7]
    matrix = lifted(dense)
    found = matrix.solve(side, listed(dense))
    assert found is not None
    assert [F(int(x), int(found[1])) for x in found[0]] == eliminated(dense, side)
    assert matrix.width == 40


def test_rows_may_be_of_very_different_size() -> None:
    for dense in ([[2**1300 + 1, 1], [1, 3]], [[3, 1], [1, 2**1300]]):
        side = [5, -7]
        found = lifted(dense).solve(side, listed(dense))
        if found is not None:
            assert [F(int(x), int(found[1])) for x in found[0]] == eliminated(dense, side)
