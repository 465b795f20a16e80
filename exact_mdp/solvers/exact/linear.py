"""Exact solutions of sparse linear systems A x = b in integers.

The strongly connected components of A are solved in order: a single unknown by its row, a few by
FLINT, and more by numeric lifting. The denominator of one solution is tried first for the next one,
also of the transposed system: then half as many digits are enough.

Where A is too near a singular matrix for floats, an entry (i, j) is changed by some s, so that the
smallest pivot is not small any more. With B = A + s e_i e_jᵀ, y = B⁻¹ b and z = B⁻¹ e_i,

    x = y + z s y_j / (1 - s z_j),    A is singular if the divisor is 0

(Sherman and Morrison, Annals of Mathematical Statistics 21, 1950). One change is enough for a chain
that hardly ever leaves a set of states. If some changes do not help, FLINT solves the component.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import flint
import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import row_sums
from exact_mdp.mdp.graph import components_in_order
from exact_mdp.mdp.table import Integers, Numbers, integers, spans
from exact_mdp.solvers.exact.lifting import Lifting

if TYPE_CHECKING:
    from flint import fmpz


FEW, MANY = 120, 4_000  # unknowns that FLINT solves faster, and those that are too many for it
MOST_CHANGES = 8  # of entries, before FLINT is asked


@dataclass(frozen=True, kw_only=True, eq=False)
class Matrix:
    """A square integer matrix of K rows with M entries.

    What is worked out for one right side is kept for the next one.
    """

    offsets: Integers  # (K+1,) where the rows begin
    column: Integers  # (M,) rising in each row
    entry: Numbers  # (M,)
    denominators: dict[int, fmpz] = field(default_factory=dict)  # by first unknown of a component
    changes: int = 0  # of entries, see `changed`

    @classmethod
    def of(cls, size: int, row: Integers, column: Integers, entry: Numbers) -> Matrix:
        """Return the matrix of some entries, in any order; those of the same place are added up."""
        order = np.lexsort((column, row))
        row, column, entry = row[order], column[order], entry[order]
        first = np.flatnonzero(np.diff(row * size + column, prepend=-1))
        if len(first) < len(row):
            entry = row_sums(entry, np.append(first, len(row)))
            row, column = row[first], column[first]
        return cls(offsets=np.searchsorted(row, np.arange(size + 1)), column=column, entry=entry)

    @property
    def size(self) -> int:
        """The number of rows, and of unknowns."""
        return len(self.offsets) - 1

    @cached_property
    def row(self) -> Integers:
        """(M,) the row of each entry."""
        return np.repeat(np.arange(self.size), np.diff(self.offsets))

    @cached_property
    def transposed(self) -> Matrix:
        """The matrix with rows for columns."""
        turned = Matrix.of(self.size, self.column, self.row, self.entry)
        return replace(turned, denominators=self.denominators)

    @cached_property
    def listed(self) -> list[tuple[list[int], list[int]]]:
        """The columns and entries of each row."""
        column, entry = self.column.tolist(), self.entry.tolist()
        return [(column[a:b], entry[a:b]) for a, b in pairwise(self.offsets.tolist())]

    @cached_property
    def components(self) -> list[tuple[list[int], Matrix]]:
        """The unknowns and the matrix of each strong component, in the order of solution."""
        shape, ones = (self.size, self.size), np.ones(len(self.column), dtype=np.int8)
        label = components_in_order(sp.csr_array((ones, self.column, self.offsets), shape))
        if not label.any():
            return [(list(range(self.size)), self)]
        found, order = list[tuple[list[int], Matrix]](), np.argsort(label, kind="stable")
        for states in np.split(order, np.flatnonzero(np.diff(label[order])) + 1):
            entries = spans(self.offsets[states], self.offsets[states + 1])
            entries = entries[label[self.column[entries]] == label[states[0]]]
            row, column = np.searchsorted(states, [self.row[entries], self.column[entries]])
            block = Matrix.of(len(states), row, column, self.entry[entries])
            found.append((states.tolist(), block))
        return found

    @cached_property
    def lifting(self) -> Lifting:
        """The matrix as lifting needs it."""
        return Lifting(self.offsets, self.column, self.entry)

    @cached_property
    def changed(self) -> Change | None:
        """What another entry in one place changes; None where that does not help."""
        entry = self.lifting.weakest() if self.changes < MOST_CHANGES else None
        if entry is None:
            return None
        i, j, amount = entry
        matrix = Matrix.of(
            self.size,
            np.append(self.row, i),
            np.append(self.column, j),
            integers([*self.entry.tolist(), amount]),
        )
        matrix = replace(matrix, changes=self.changes + 1)
        unit = [flint.fmpz(k == i) for k in range(self.size)]
        effect = _solve_component(matrix, unit, matrix.denominators, 0)
        return Change(matrix, j, amount, *effect)


class Change(NamedTuple):
    """A matrix with `amount` more in one entry, in `column`; its solution for a 1 in that row."""

    matrix: Matrix
    column: int
    amount: int
    top: list[fmpz]
    below: fmpz


def exact_solve(matrix: Matrix, side: Sequence[Any]) -> tuple[list[fmpz], fmpz]:
    """Return the solution of A x = b for integers b, as integers over one positive denominator.

    Raises ZeroDivisionError where A is singular, and ModelError where thousands of unknowns depend
    on each other and floats cannot start.

    Examples
    --------
    >>> ring = Matrix.of(2, *np.array([[0, 0, 1, 1], [0, 1, 0, 1]]), np.array([2, -1, -1, 3]))
    >>> exact_solve(ring, [1, 0]), exact_solve(ring.transposed, [0, 1])
    (([3, 1], 5), ([1, 2], 5))
    """
    one, rows = flint.fmpz(1), matrix.listed
    value, group, below = [0 * one] * matrix.size, [0] * matrix.size, [one]
    for states, block in matrix.components:
        met = {group[t] for s in states for t in rows[s][0]}  # of other components, and 0
        base = one
        for own in met:
            base = base.lcm(below[own])
        times = {own: base // below[own] for own in met}
        right = [base * side[s] for s in states]
        if any(met):
            for i, s in enumerate(states):
                each = zip(*rows[s], strict=True)
                right[i] -= sum(a * value[t] * times[group[t]] for t, a in each)
        top, bottom = _solve_component(block, right, matrix.denominators, states[0])
        top, bottom = _reduced(top, bottom * base)
        for s, number in zip(states, top, strict=True):
            value[s], group[s] = number, len(below)
        below.append(bottom)
    common = one
    for number in below:
        common = common.lcm(number)
    factor = [common // number for number in below]
    return [number * factor[g] for number, g in zip(value, group, strict=True)], common


def _solve_component(
    matrix: Matrix, side: Sequence[fmpz], known: dict[int, fmpz], first: int
) -> tuple[list[fmpz], fmpz]:
    """Return the solution for one component, whose first unknown is `first` in the whole system."""
    if matrix.size == 1:
        pivot = sum(matrix.entry.tolist())
        if not pivot:
            raise ZeroDivisionError("the matrix is singular")
        return [side[0] if pivot > 0 else -side[0]], flint.fmpz(abs(pivot))
    if matrix.size <= FEW:
        return _dense(matrix, side)
    found = matrix.lifting.solve(side, matrix.listed, known.get(first))
    if found is None:
        return _by_change(matrix, side)
    known[first] = found[1]
    return found


def _by_change(matrix: Matrix, side: Sequence[fmpz]) -> tuple[list[fmpz], fmpz]:
    """Return the solution by that for one other entry (Sherman and Morrison, see above)."""
    try:
        change = matrix.changed
        if change is None:
            return _dense(matrix, side)
        other, below = _solve_component(change.matrix, side, change.matrix.denominators, 0)
    except ZeroDivisionError:  # of the other one
        return _dense(matrix, side)
    factor = change.below - change.amount * change.top[change.column]
    if not factor:
        raise ZeroDivisionError("the matrix is singular")
    more, sign = change.amount * other[change.column], 1 if factor > 0 else -1
    top = [sign * (a * factor + b * more) for a, b in zip(other, change.top, strict=True)]
    return _reduced(top, below * abs(factor))


def _reduced(top: list[fmpz], below: fmpz) -> tuple[list[fmpz], fmpz]:
    """Return integers and their denominator without the divisor that all share."""
    shared = below
    for number in top:
        if shared == 1:
            return top, below
        shared = shared.gcd(number)
    return [number // shared for number in top], below // shared


def _dense(matrix: Matrix, side: Sequence[fmpz]) -> tuple[list[fmpz], fmpz]:
    """Return what FLINT's dense solver finds."""
    size = matrix.size
    if size > MANY:
        raise ModelError(
            f"the equations of {size} states that lead to each other are singular, or nearly so",
            fix="use certify(mdp, bounded=True), which proves bounds in floating point",
        )
    dense = np.zeros((size, size), dtype=object)
    dense[matrix.row, matrix.column] = matrix.entry
    system = flint.fmpz_mat(size, size, dense.ravel().tolist())
    try:
        found: Any = system.solve(flint.fmpz_mat(size, 1, list(side)))
    except ZeroDivisionError:
        raise ZeroDivisionError("the matrix is singular") from None
    top, below = found.numer_denom()
    return top.entries(), below
