"""Exact solutions of linear systems, beside elimination in fractions."""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from integer_systems import Entries, eliminated, matrix_of, solution
from made_models import gridworld

from exact_mdp import ModelError, certify
from exact_mdp.mdp.table import to_integer_array
from exact_mdp.solvers.exact import linear
from exact_mdp.solvers.exact.linear import Matrix


@st.composite
def systems(draw: st.DrawFn) -> tuple[int, Entries]:
    """Integers of any length: in any place, or as the equations of a chain that hardly ends."""
    size, bits = draw(st.integers(1, 9)), draw(st.sampled_from([1, 3, 30, 62, 70, 300, 1300]))
    number = st.one_of(st.integers(-(2**bits), 2**bits), st.integers(-2, 2))
    place = st.integers(0, size - 1)
    entries = draw(st.dictionaries(st.tuples(place, place), number, max_size=4 * size))
    if draw(st.booleans()):
        entries = {(i, j): -abs(a) for (i, j), a in entries.items() if i != j}
        for i in range(size):
            entries[i, i] = draw(st.integers(0, 2)) - sum(
                a for (k, _), a in entries.items() if k == i
            )
    return size, entries


@pytest.mark.parametrize("few", [120, 1])
@settings(max_examples=200)
@given(systems(), st.data())
def test_elimination_in_fractions_agrees(
    few: int, system: tuple[int, Entries], data: st.DataObject
) -> None:
    """By FLINT and by lifting, for several right sides, with rows for columns, and singular."""
    size, entries = system
    matrix = matrix_of(size, entries)
    turned = {(j, i): a for (i, j), a in entries.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(linear, "FEW", few)
        for _ in range(2):
            numbers = st.one_of(st.integers(-9, 9), st.integers(-(2**90), 2**90), st.just(3**900))
            side = data.draw(st.lists(numbers, min_size=size, max_size=size))
            for each, listed in ((matrix, entries), (matrix.transposed, turned)):
                wanted = eliminated(size, listed, side)
                if wanted is None:
                    with pytest.raises(ZeroDivisionError, match="the matrix is singular"):
                        solution(each, side)
                else:
                    assert solution(each, side) == wanted


def ring(size: int, pivot: int, weight: int) -> Matrix:
    """pivot x(s) - weight x(s + 1) = b(s), all round."""
    place = np.arange(size)
    return Matrix.of(
        size,
        np.concatenate([place, place]),
        np.concatenate([place, (place + 1) % size]),
        to_integer_array([pivot] * size + [-weight] * size),
    )


@pytest.mark.parametrize("bits", [1, 25, 45, 60, 200])
def test_long_rings(bits: int) -> None:
    """Floats see no difference between 1 - 2^-60 and 1; entries may be longer than 64 bits."""
    size = 200
    pivot, weight = 2**bits, 2**bits - 1
    matrix = ring(size, pivot, weight)
    assert solution(matrix, [1] * size) == [F(1)] * size
    below = pivot**size - weight**size
    wanted = [pivot ** (size - 1 - (-s % size)) * weight ** (-s % size) for s in range(size)]
    assert solution(matrix, [1] + [0] * (size - 1)) == [F(top, below) for top in wanted]
    with pytest.raises(ZeroDivisionError, match="the matrix is singular"):
        solution(ring(size, pivot, pivot), [1] * size)


@pytest.mark.parametrize("parts", [2, 4, 12])
def test_sets_that_are_hardly_ever_left(parts: int) -> None:
    """Each set of states leads to the next one with a chance of 2^-70."""
    size, rare, rng = 30, 2**70, np.random.default_rng(parts)
    count, entries = parts * size, Entries()
    for s in range(count):
        base = s - s % size
        ahead = {base + (s + 1) % size, *(base + rng.integers(0, size, 2)).tolist()} - {s}
        entries |= {(s, t): -rare for t in ahead}
        entries[s, s] = rare * len(ahead) + (s == 0)
        if s == base:
            entries[s, (s + size) % count] = -1
            entries[s, s] += 1
    side = rng.integers(-9, 9, count).tolist()
    matrix = matrix_of(count, entries)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(linear, "FEW", count)
        wanted = solution(matrix, side)
        patch.setattr(linear, "FEW", 20)
        assert solution(matrix, side) == wanted


def test_cycles_that_are_too_large_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linear, "LARGEST", 8)
    with pytest.raises(ModelError, match="is too large to be solved exactly"):
        certify(gridworld(4))
