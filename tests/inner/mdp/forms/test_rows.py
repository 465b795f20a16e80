"""What rows of floats mean: one row at a time in fractions, many at once, and the rule itself."""

from fractions import Fraction as F
from math import isfinite, nextafter

import numpy as np
import pytest

from exact_mdp.mdp.forms.rows import (
    WHOLE,
    normalize_rows_in_numpy,
    put_right,
    rationalize_row,
    rows_to_integers,
    to_dyadic_integers,
)

ROWS = [
    [0.1, 0.2, 0.7],
    [1 / 3, 1 / 3, 1 / 3],
    [1 / 7, 2 / 7, 4 / 7],
    [0.123456789, 0.5, 0.376543211],
    [0.25, 0.25, 0.5 + 2e-10],
    [0.3, 0.3, 0.4 - 3e-10],
    [0.45 + 1e-10, 0.45 + 1e-10, 0.1],
    [1 / 11] * 11,
    [nextafter(0.1, 1), 0.2, 0.7],
    [1.0],
    [2.0**-60, 1 - 2.0**-53],
]


def read(row: list[float]) -> list[F]:
    """The rule, as the module states it: fractions n / WHOLE, or what others leave the largest."""
    tops = [round(F(x) * WHOLE) for x in row]
    neighbours = all(float(F(n, WHOLE)) in (x, nextafter(x, 0), nextafter(x, 2))
                     for n, x in zip(tops, row, strict=True))  # fmt: skip
    if neighbours and sum(tops) == WHOLE:
        return [F(n, WHOLE) for n in tops]
    largest = max(row)
    share = (1 - sum((F(x) for x in row if x != largest), F(0))) / row.count(largest)
    if float(share) != largest:
        return read([float(share) if x == largest else x for x in row])
    return [share if x == largest else F(x) for x in row]


def drawn(seed: int) -> list[list[float]]:
    """Rows of many kinds: dirichlet, decimals, thirds, ties, and off by what is tolerated."""
    rng = np.random.default_rng(seed)
    rows = [rng.dirichlet(np.ones(k)).tolist() for k in rng.integers(1, 9, 30)]
    rows += [(rng.multinomial(1000, [0.25] * 4) / 1000).tolist() for _ in range(30)]
    rows += [(rng.multinomial(63, [0.2] * 5) / 63).tolist() for _ in range(30)]
    off = 1 + rng.choice([-9e-10, 0, 9e-10], 60)
    rows += [[x * f for x in row] for row, f in zip(rows[:60], off, strict=True)]
    return [[x for x in row if x > 0] for row in rows]


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_a_row_means_numbers_that_sum_to_1(row: list[float]) -> None:
    found = rationalize_row(row)
    assert found == read(row)
    assert sum(found) == 1


@pytest.mark.parametrize("seed", range(5))
def test_many_rows_at_once_mean_what_each_one_means(seed: int) -> None:
    rows = [*ROWS, *drawn(seed)]
    offsets = np.cumsum([0, *map(len, rows)])
    weight = np.concatenate(rows)
    assert normalize_rows_in_numpy(weight, offsets)
    top, bottom = rows_to_integers(weight, offsets)
    for k, row in enumerate(rows):
        own = slice(offsets[k], offsets[k + 1])
        found = [F(int(n), int(bottom[k])) for n in top[own]]
        assert found == rationalize_row(row) == read(row)
        assert weight[own].tolist() == [float(x) for x in found]
    again = weight.copy()
    normalize_rows_in_numpy(again, offsets)
    assert (again == weight).all()


def test_exact_numbers_beside_floats_stay() -> None:
    assert rationalize_row([F(1, 3), 1 / 6, 0.5]) == [F(1, 3), F(1, 6), F(1, 2)]
    assert rationalize_row([F(1, 7), 0.2, 1 - 1 / 7 - 0.2]) == [F(1, 7), F(1, 5), F(23, 35)]


@pytest.mark.parametrize("row", [[0.5, 0.6], [0.5, 0.5 + 2e-9], [-0.5, 1.5], [float("nan"), 1.0],
                                 [float("inf")], [F(1, 2), 0.6]])  # fmt: skip
def test_what_is_no_distribution_stays(row: list[float]) -> None:
    assert str(rationalize_row(row)) == str(row)
    if all(isinstance(x, float) and isfinite(x) for x in row):
        weight = np.array(row)
        assert not normalize_rows_in_numpy(weight, np.array([0, len(row)]))
        assert str(weight.tolist()) == str(row)


def test_noise_below_0_and_rows_of_single_precision_are_put_right() -> None:
    offsets = np.array([0, 2, 4])
    given = np.array([1.0, -4e-16, 0.5, -2e-9])
    assert put_right(given, offsets).tolist() == [1.0, 0.0, 0.5, -2e-9]
    single = np.float32([0.1, 0.2, 0.7])
    wanted = single.astype(float) / single.astype(float).sum()
    assert put_right(single, np.array([0, 3])).tolist() == wanted.tolist()
    off = np.float32([0.1, 0.2, 0.6999])
    assert put_right(off, np.array([0, 3])).tolist() == off.astype(float).tolist()
    double = np.array([0.1, 0.2, 0.7 + 3e-8])  # not all of them are numbers of single precision
    assert put_right(double, np.array([0, 3])).tolist() == double.tolist()
    mixed = np.array([F(1, 2), -1e-12, 0.5], dtype=object)
    assert put_right(mixed, np.array([0, 3])).tolist() == [F(1, 2), 0.0, 0.5]
    whole = np.array([0, 1])
    assert put_right(whole, np.array([0, 2])) is whole


@pytest.mark.parametrize("seed", range(4))
def test_floats_are_integers_over_powers_of_two(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=12) * 2.0 ** rng.integers(-90 * (seed > 1) - 4, 4, 12)
    values[[0, 5]] = 0
    offsets = np.array([0, 3, 3, 12])
    top, bottom = to_dyadic_integers(values, offsets)
    below = np.repeat(bottom, np.diff(offsets))
    found = [F(int(a), int(b)) for a, b in zip(top, below, strict=True)]
    assert found == [F(x) for x in values.tolist()]
