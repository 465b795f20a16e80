"""Gain and bias of every deterministic policy of a small model, by elimination in Fractions.

The three equations of `solvers.average.chain` are put into one matrix and reduced; what is not
determined is set to 0. Gain and bias are (Puterman 1994, corollary 8.2.9), the third vector is not.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction as F
from itertools import product

from strategies import Row

Vector = tuple[F, ...]


def reduced(matrix: list[list[F]]) -> list[list[F]]:
    """Return the reduced row echelon form."""
    rows, done = [list(row) for row in matrix], 0
    for column in range(len(rows[0]) - 1):
        pivot = next((i for i in range(done, len(rows)) if rows[i][column]), None)
        if pivot is None:
            continue
        rows[done], rows[pivot] = rows[pivot], rows[done]
        rows[done] = [x / rows[done][column] for x in rows[done]]
        for i, row in enumerate(rows):
            if i != done and row[column]:
                rows[i] = [x - row[column] * y for x, y in zip(row, rows[done], strict=True)]
        done += 1
    return rows[:done]


def gain_and_bias(chosen: Sequence[Row]) -> tuple[Vector, Vector]:
    """Return g and h of a chain: the rows that its states have, in order."""
    n = len(chosen)
    matrix = []
    for block in range(3):
        for s, _, r, following in chosen:
            row = [F(0)] * (3 * n + 1)
            row[block * n + s] += 1  # (I - P) of g, h or w
            for t, p in following.items():
                row[block * n + t] -= p
            if block:
                row[(block - 1) * n + s] += 1
            row[-1] = r if block == 1 else F(0)
            matrix.append(row)
    solution = [F(0)] * (3 * n)
    for row in reduced(matrix):
        column = next(i for i, x in enumerate(row[:-1]) if x)
        assert column >= 2 * n or not any(row[column + 1 : -1])  # determined
        solution[column] = row[-1]
    return tuple(solution[:n]), tuple(solution[n : 2 * n])


def policies(n: int, pairs: Sequence[Row]) -> Iterator[tuple[Row, ...]]:
    """Yield every deterministic policy as the rows that it takes."""
    yield from product(*([row for row in pairs if row[0] == s] for s in range(n)))


def best(n: int, pairs: Sequence[Row]) -> tuple[Vector, Vector]:
    """Return the greatest gains, and the greatest biases of the policies that have them."""
    found = [gain_and_bias(policy) for policy in policies(n, pairs)]
    gain = tuple(max(g[s] for g, _ in found) for s in range(n))
    biases = [h for g, h in found if g == gain]
    return gain, tuple(max(h[s] for h in biases) for s in range(n))
