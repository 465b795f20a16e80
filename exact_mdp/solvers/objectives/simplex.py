"""Small linear programs in rational arithmetic, by the simplex method with Bland's rule.

    maximise c x   subject to   A x = b,  x ≥ 0

The rows are few and the columns may be many. Reduced costs come from the inverse of the basis,
which the columns of the artificial variables hold; Bland's rule ends the search also where steps
have no length (Bland, Mathematics of Operations Research 2, 1977).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import flint

from exact_mdp.mdp.exact import fraction, rational

if TYPE_CHECKING:
    from flint import fmpq


@dataclass(frozen=True, kw_only=True)
class Program:
    """A solved program.

    Attributes
    ----------
    feasible : bool
    x : list of Fraction
        A basic solution; empty where there is none.
    y : list of Fraction
        Dual: y A ≥ c and y b = c x. Where the program is infeasible, y A ≥ 0 and y b < 0.
    """

    feasible: bool
    x: list[Fraction]
    y: list[Fraction]


def maximise(
    c: Sequence[Fraction], columns: Sequence[Sequence[Fraction]], b: Sequence[Fraction]
) -> Program:
    """Solve a program whose matrix is given by its columns; one that is bounded."""
    size, rows = len(columns), len(b)
    sign = [-1 if value < 0 else 1 for value in b]
    table = [
        [sign[i] * rational(column[i]) for column in columns]
        + [flint.fmpq(int(i == k)) for k in range(rows)]
        + [rational(abs(b[i]))]
        for i in range(rows)
    ]
    basis = list(range(size, size + rows))
    artificial = [flint.fmpq(0)] * size + [flint.fmpq(-1)] * rows
    _improve(table, basis, artificial, size)
    if any(table[i][-1] != 0 for i in range(rows) if basis[i] >= size):
        return Program(feasible=False, x=[], y=_dual(table, basis, artificial, sign))
    own = [rational(value) for value in c] + [flint.fmpq(0)] * rows
    _improve(table, basis, own, size)
    x = [Fraction(0)] * size
    for i, number in enumerate(basis):
        if number < size:
            x[number] = fraction(table[i][-1])
    return Program(feasible=True, x=x, y=_dual(table, basis, own, sign))


def _improve(table: list[list[fmpq]], basis: list[int], c: list[fmpq], size: int) -> None:
    """Pivot until no column is worth more than it costs."""
    rows = len(table)
    while True:
        price = [c[number] for number in basis]
        entering = next(
            (
                j
                for j in range(size)
                if c[j] > sum((price[i] * table[i][j] for i in range(rows)), flint.fmpq(0))
            ),
            None,
        )
        if entering is None:
            return
        column = [row[entering] for row in table]
        # An artificial variable that is left at 0 stays there: it leaves as soon as it would move.
        rests = [i for i in range(rows) if basis[i] >= size and not table[i][-1] and column[i]]
        leaving = min(
            rests or [i for i in range(rows) if column[i] > 0],
            key=lambda i: (table[i][-1] / abs(column[i]), basis[i]),
        )
        pivot = column[leaving]
        table[leaving] = [value / pivot for value in table[leaving]]
        for i in range(rows):
            if i != leaving and column[i]:
                table[i] = [
                    value - column[i] * other
                    for value, other in zip(table[i], table[leaving], strict=True)
                ]
        basis[leaving] = entering


def _dual(
    table: list[list[fmpq]], basis: list[int], c: list[fmpq], sign: list[int]
) -> list[Fraction]:
    rows, size = len(table), len(table[0]) - len(table) - 1
    return [
        sign[k]
        * fraction(sum((c[basis[i]] * table[i][size + k] for i in range(rows)), flint.fmpq(0)))
        for k in range(rows)
    ]
