"""Linear systems of integers, and their solutions by elimination in fractions."""

from fractions import Fraction as F

import numpy as np
from oracle import solved

from exact_mdp.mdp.table import to_integer_array
from exact_mdp.solvers.exact.linear import Matrix, solve_all

Entries = dict[tuple[int, int], int]


def matrix_of(size: int, entries: Entries) -> Matrix:
    row, column = np.array(list(entries), dtype=np.int64).reshape(-1, 2).T
    return Matrix.of(size, row, column, to_integer_array(entries.values()))


def eliminated(size: int, entries: Entries, side: list[int]) -> list[F] | None:
    """The solution in fractions, None where there is not just one."""
    rows = [{j: F(a) for (k, j), a in entries.items() if k == i and a} for i in range(size)]
    solutions = solved(rows, [*map(F, side)])
    return solutions[0] if solutions else None


def solution(matrix: Matrix, side: list[int]) -> list[F]:
    (level,) = solve_all(matrix, [side])
    return list(level.to_fractions())
