"""Exact solutions of sparse linear systems A x = b in integers.

The strongly connected components of A are solved in order: a single unknown by its row, a few by
FLINT, and more by numeric lifting. The denominator of one solution is tried first for the next one,
also for the transposed system; if it fits, half as many digits are enough. FLINT also solves
components whose matrix is singular in floats, or nearly so.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, reduce
from itertools import chain, pairwise
from operator import mul
from typing import TYPE_CHECKING, Any

import flint
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.mdp.graph import longest_ways
from exact_mdp.mdp.table import (
    Integers,
    Numbers,
    concatenate_ranges,
    row_sums,
    to_common_denominator,
)
from exact_mdp.solvers.exact.levels import Level
from exact_mdp.solvers.exact.lifting import Lifting

if TYPE_CHECKING:
    from flint import fmpz


FEW, MANY = 120, 4_000  # unknowns up to which FLINT is faster than lifting, and is possible at all
LARGEST = 20_000  # unknowns of one component; the numbers of more would fill the memory
BOUNDED = "use certify(mdp, bounded=True), which proves bounds in floating point"


@dataclass(frozen=True, kw_only=True, eq=False)
class Matrix:
    """A square integer matrix of K rows with M entries, and facts that all right sides share."""

    offsets: Integers  # (K+1,) where the rows begin
    column: Integers  # (M,) rising in each row
    entry: Numbers  # (M,)
    denominators: dict[int, fmpz] = field(default_factory=dict)  # by first unknown of a component

    @classmethod
    def of(cls, size: int, row: Integers, column: Integers, entry: Numbers) -> Matrix:
        """Return the matrix of some entries, in any order; entries at one place are added up."""
        order = np.lexsort((column, row))
        row, column, entry = row[order], column[order], entry[order]
        first = np.flatnonzero(np.diff(row * size + column, prepend=-1))
        if len(first) < len(row):
            entry = row_sums(entry, np.append(first, len(row)))
            row, column = row[first], column[first]
        return cls(offsets=np.searchsorted(row, np.arange(size + 1)), column=column, entry=entry)

    @cached_property
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
    def steps(self) -> list[tuple[list[int], Matrix | None]]:
        """The unknowns in the order of solution: a strong component and its matrix in each step.

        Single unknowns that do not lead to each other make one step, without a matrix.
        """
        shape, ones = (self.size, self.size), np.ones(len(self.column), dtype=np.int8)
        label, level = longest_ways(sp.csr_array((ones, self.column, self.offsets), shape))
        single = np.bincount(label)[label] == 1
        order = np.lexsort((label, single, level))
        apart = ~single[order][1:] & (np.diff(label[order]) != 0)
        apart |= (np.diff(level[order]) != 0) | np.diff(single[order])
        parts = list[tuple[list[int], Matrix | None]]()
        for states in np.split(order, np.flatnonzero(apart) + 1):
            block = None
            if len(states) == self.size and not single[states[0]]:
                block = self
            elif not single[states[0]]:
                entries = concatenate_ranges(self.offsets[states], self.offsets[states + 1])
                entries = entries[label[self.column[entries]] == label[states[0]]]
                row, column = np.searchsorted(states, [self.row[entries], self.column[entries]])
                block = Matrix.of(len(states), row, column, self.entry[entries])
            parts.append((states.tolist(), block))
        return parts

    @cached_property
    def lifting(self) -> Lifting:
        """The matrix, prepared for numeric lifting."""
        return Lifting(self.offsets, self.column, self.entry)


def solve_all(matrix: Matrix, sides: Sequence[Sequence[Any]]) -> list[Level]:
    """Return the solutions of A x = b for several integer b, in groups over the same denominators.

    Raises ZeroDivisionError if A is singular, and ModelError if thousands of unknowns depend on
    each other and floats cannot start.
    """
    solution = _Solution(matrix, sides)
    group, below = np.array(solution.group, dtype=np.int64), list(map(int, solution.below))
    levels = []
    for top in solution.tops:
        levels.append(Level.from_groups(list(map(int, top)), below, group))
    return levels


def build_equations(rows: BellmanRows, states: NDArray[np.bool_] | None = None) -> Matrix:
    """Return the matrix of V = r + γ P V for rows of one pair in each state.

    Of some states (S,), those that are not terminal by default; the others have V = r.
    """
    if states is None:
        states = ~rows.terminal
    inside, every = states[rows.pair], np.arange(len(rows.scale))
    return Matrix.of(
        len(every),
        np.concatenate([every, rows.pair[inside]]),
        np.concatenate([every, rows.next[inside]]),
        np.concatenate([rows.scale, -rows.weight[inside]]),
    )


def solve_policy_equations(
    matrix: Matrix, rows: BellmanRows, constant: Sequence[Fraction]
) -> Level:
    """Return V = constant + γ P V, constant (S,), for the `build_equations` of some rows."""
    # Solve for integers, and divide by the common denominator afterwards.
    side, unit = to_common_denominator(constant)
    (level,) = solve_all(matrix, [[*map(mul, side, rows.scale.tolist())]])
    return replace(level, below=[unit * below for below in level.below])


def evaluate_exactly(
    rows: BellmanRows, pairs: Integers | None = None, amounts: Sequence[Numbers] = ()
) -> list[Level]:
    """Return the values of the policy that takes some pairs (S,): of the rewards, or of amounts.

    Amounts (L,) are over the scales of the states, as the constants of the rows are. Without pairs,
    there is one in each state.
    """
    if pairs is None:
        pairs = np.arange(len(rows.scale))
    live, sides = ~rows.terminal, []
    for own in amounts or [rows.constant]:
        sides.append((own[pairs] * live).tolist())
    return solve_all(build_equations(rows.of_pairs(pairs)), sides)


def compute_expected_visits(
    rows: BellmanRows, states: NDArray[np.bool_], start: Sequence[tuple[int, Fraction]]
) -> Level:
    """Return the expected visits of all states from a start, for one pair in each state.

    x(t) = μ(t) + Σ x(s) γ P(s, t) over some states s; the others count arrivals.
    """
    # The start as integers over one denominator.
    shares, unit = to_common_denominator([share for _, share in start])
    side = [0] * len(rows.scale)
    for (state, _), number in zip(start, shares, strict=True):
        side[state] += number
    (level,) = solve_all(build_equations(rows, states).transposed, [side])
    # Each row of integers is its state's scale times the true row: undo this factor.
    top = [*map(mul, level.top, rows.scale.tolist())]
    return replace(level, top=top, below=[unit * below for below in level.below])


class _Solution:
    """Solutions of A x = b: x(s) = tops[k][s] / below[group[s]] for the right side k."""

    def __init__(self, matrix: Matrix, sides: Sequence[Sequence[Any]]) -> None:
        zero, self.sides = flint.fmpz(0), sides
        self.tops = [[zero] * matrix.size for _ in sides]
        self.group, self.below = [0] * matrix.size, [flint.fmpz(1)]
        self._rows, self._number = matrix.listed, {self.below[0]: 0}
        # Components in reverse order: all that a component leads to is solved before it.
        for states, block in matrix.steps:
            if block is None:
                for base, alike in self._by_base(states).items():
                    self._substitute(base, alike)
                continue
            # A component of several unknowns: solve for each right side over one denominator.
            base, tops, belows = _compute_common_multiple(self._by_base(states)), [], []
            for right in self._right_sides(base, states):
                top, below = _solve_component(block, right, matrix.denominators, states[0])
                tops.append(top)
                belows.append(below)
            unit = _compute_common_multiple(belows)
            for k, below in enumerate(belows):
                if below != unit:
                    tops[k] = [n * (unit // below) for n in tops[k]]
            self._store_solution(states, tops, base * unit)

    def _by_base(self, states: Sequence[int]) -> dict[fmpz, list[int]]:
        """Return unknowns by the common denominator of those that they lead to."""
        bases: dict[frozenset[int], fmpz] = {}
        groups: dict[fmpz, list[int]] = {}
        for s in states:
            met = frozenset(map(self.group.__getitem__, self._rows[s][0]))
            if met not in bases:
                bases[met] = _compute_common_multiple(map(self.below.__getitem__, met))
            groups.setdefault(bases[met], []).append(s)
        return groups

    def _right_sides(self, base: fmpz, states: Sequence[int]) -> list[list[fmpz]]:
        """Return the residual b - A x times `base`, for each right side."""
        ahead: set[int] = set()
        for s in states:
            ahead.update(self._rows[s][0])
        # Bring the solved unknowns to the denominator `base`.
        times = {}
        for group in set(map(self.group.__getitem__, ahead)):
            times[group] = base // self.below[group]
        reduced = []
        for side, top in zip(self.sides, self.tops, strict=True):
            known = {}
            for t in ahead:
                known[t] = top[t]
                if top[t]:
                    known[t] = top[t] * times[self.group[t]]
            residual = []
            for s in states:
                columns, entries = self._rows[s]
                flow = sum(map(mul, map(known.__getitem__, columns), entries))
                residual.append(base * side[s] - flow)
            reduced.append(residual)
        return reduced

    def _substitute(self, base: fmpz, states: Sequence[int]) -> None:
        """Solve for unknowns that do not lead to each other."""
        pivots = [flint.fmpz(dict(zip(*self._rows[s], strict=True)).get(s, 0)) for s in states]
        if not all(pivots):
            raise ZeroDivisionError("the matrix is singular")
        sides, places = self._right_sides(base, states), range(len(states))
        # They share a denominator of up to twice the length of the longest of their own and two
        # words: a longer one would cost more than groups do.
        far = 2 * max([pivot.bit_length() for pivot in pivots]) + 128
        apart = _compute_common_multiple(pivots).bit_length() > far
        groups: list[Sequence[int]] = [places]
        if apart:
            groups = [[i] for i in places]
        for some in groups:
            unit = _compute_common_multiple([pivots[i] for i in some])
            tops = []
            for side in sides:
                tops.append([side[i] * (unit // pivots[i]) for i in some])
            self._store_solution([states[i] for i in some], tops, base * unit)

    def _store_solution(
        self, states: Sequence[int], tops: Sequence[Sequence[fmpz]], below: fmpz
    ) -> None:
        """Keep the numbers of some unknowns, all over one denominator in lowest terms."""
        # Reduce to lowest terms.
        listed, shared = [*chain(*tops)], below
        for n in listed:
            if shared == 1:
                break
            shared = shared.gcd(n)
        listed, below = [n // shared for n in listed], below // shared
        # Unknowns with the same denominator share a group; zeros belong to the group of 1.
        number = self._number.setdefault(below, len(self.below))
        if number == len(self.below):
            self.below.append(below)
        for k, values in enumerate(self.tops):
            for s, own in zip(states, listed[k * len(states) :], strict=False):
                values[s] = own
                if own:
                    self.group[s] = number


def _compute_common_multiple(numbers: Iterable[fmpz]) -> fmpz:
    return reduce(flint.fmpz.lcm, numbers, flint.fmpz(1))


def _solve_component(
    matrix: Matrix, side: Sequence[fmpz], known: dict[int, fmpz], first: int
) -> tuple[list[fmpz], fmpz]:
    """Return the solution for one component, whose first unknown is `first` in the whole system."""
    size, solution = matrix.size, None
    if size > LARGEST:
        raise ModelError(f"a cycle of {size} states is too large to be solved exactly", fix=BOUNDED)
    # Large components are lifted from floats; small and hard ones are left to FLINT.
    if size > FEW:
        solution = matrix.lifting.solve(side, matrix.listed, known.get(first))
    if solution is not None:
        known[first] = solution[1]
        return solution
    if size > MANY:
        raise ModelError(
            f"the equations of {size} states that lead to each other are singular, or nearly so",
            fix=BOUNDED,
        )
    # A dense exact solve.
    dense = np.zeros((size, size), dtype=object)
    dense[matrix.row, matrix.column] = matrix.entry
    system = flint.fmpz_mat(size, size, dense.ravel().tolist())
    try:
        exact: Any = system.solve(flint.fmpz_mat(size, 1, list(side)))
    except ZeroDivisionError:
        raise ZeroDivisionError("the matrix is singular") from None
    top, below = exact.numer_denom()
    return top.entries(), below
