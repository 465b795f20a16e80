"""Small linear programs in rational arithmetic, by the simplex method with Bland's rule.

    maximise c x   subject to   A x = b,  x ≥ 0

There are few rows and possibly many columns. Artificial variables, one for each row, cost more than
any number. With Bland's rule the search ends even if steps have length 0 (Mathematics of Operations
Research 2, 1977).
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import flint

from exact_mdp.mdp.exact import from_flint, to_flint


def list_unit_vectors(size: int, one: Any) -> list[list[Any]]:
    """Return the rows of the unit matrix, times a number."""
    rows = [[0 * one] * size for _ in range(size)]
    for k in range(size):
        rows[k][k] = one
    return rows


def solve_linear_program(
    c: Sequence[Fraction], columns: Sequence[Sequence[Fraction]], b: Sequence[Fraction]
) -> tuple[list[Fraction], list[Fraction]]:
    """Return an optimal basic x, and its dual y: y A ≥ c and y b = c x.

    The matrix is given by its columns. The program must have an optimum.
    """
    size, rows = len(columns), len(b)
    # One artificial variable for each row, with the sign of b, so that x = |b| is a first vertex.
    units = list_unit_vectors(rows, Fraction(1))
    for k in range(rows):
        if b[k] < 0:
            units[k][k] = Fraction(-1)
    turned = flint.fmpq_mat([[*map(to_flint, column)] for column in [*columns, *units]])
    matrix, right = turned.transpose(), flint.fmpq_mat([[to_flint(value)] for value in b])
    # Costs are pairs, compared in their order: a part that outweighs any number, and the rest.
    cost = [(flint.fmpq(0), to_flint(value)) for value in c] + [(flint.fmpq(-1),) * 2] * rows
    basis = [*range(size, size + rows)]
    while True:
        inverse = flint.fmpq_mat([[matrix[i, j] for j in basis] for i in range(rows)]).inv()
        price = flint.fmpq_mat([*map(list, zip(*(cost[j] for j in basis), strict=True))]) * inverse
        x, due = inverse * right, [*zip(*(price * matrix).tolist(), strict=True)]
        # Bland's rule: the first column that gains enters, and the first of the tied rows leaves.
        entering = next((j for j in range(size) if cost[j] > due[j]), None)
        if entering is None:
            break
        column = inverse * flint.fmpq_mat([[matrix[i, entering]] for i in range(rows)])
        falling = ((x[i, 0] / column[i, 0], basis[i], i) for i in range(rows) if column[i, 0] > 0)
        basis[min(falling)[-1]] = entering
    basic = dict(zip(basis, x.entries(), strict=True))
    # A number that is large enough to take the place of "more than any number".
    each = ((due[j], cost[j][1]) for j in range(size) if due[j][0] > 0)
    enough = max(((own - later) / first for (first, later), own in each), default=flint.fmpq(0))
    first, later = price.tolist()
    y = []
    for now, then in zip(first, later, strict=True):
        y.append(from_flint(then + enough * now))
    return [from_flint(basic.get(j, flint.fmpq(0))) for j in range(size)], y
