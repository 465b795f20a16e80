"""The right sides of the Bellman equations for many pairs at once, in integers.

Waiting in place is taken out of the equations: with pivot(l) = scale(s) - weight of staying in s,

    pivot(l) · V(s) ≥ constant(l) + Σ weight(i) V(next(i)),   next(i) ≠ s,

with equality for the optimal pairs; so a state that may wait is in no cycle for that. The sums are
products of integer matrices where these are not mostly zeros. Where a part of a model repeats a
part before, with states shifted, its matrix is made once.

The exact optimal values of states on one cycle, given those of the states that it leads to.

    pivot(l) · v(s) = fixed(l) + Σ weight(i) v(next(i)),   the sum over states on the cycle

for the best pair l of every state. Policy iteration in floats finds a policy, and policy iteration
in rational arithmetic improves it until no pair is better (Howard, Dynamic Programming and Markov
Processes, 1960). It ends because every step gains exactly.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import flint
import numpy as np
import scipy.sparse as sp
from scipy.sparse import linalg

from exact_mdp.mdp.exact import BellmanRows, row_sums
from exact_mdp.mdp.table import Integers, Numbers, integers, magnitude, spans
from exact_mdp.solvers.exact.linear import Matrix, exact_solve

if TYPE_CHECKING:
    from flint import fmpz, fmpz_mat


STEPS = 100  # of policy iteration, before the exact ones
PRECISE = 256  # bits of values in fixed point
LARGEST = 20_000  # states; the numbers of a larger cycle would fill the memory
CHUNK = 64  # states whose pairs are multiplied together
FILLED = 4  # one in this many entries of a matrix is not zero, at least


@dataclass(frozen=True)
class Product:
    """constant + Σ weight · V for a few states' pairs, as one matrix or row by row."""

    columns: Sequence[int]
    matrix: fmpz_mat | None
    rows: Sequence[tuple[int, Sequence[int], Sequence[int]]]

    def __call__(self, value: Mapping[int, fmpz], unit: fmpz) -> list[fmpz]:
        """Return the sums, times `unit`, for values of the `columns` that are times `unit`."""
        if self.matrix is None:
            return [
                sum(
                    (w * value[state] for w, state in zip(weight, following, strict=True)), c * unit
                )
                for c, weight, following in self.rows
            ]
        vector = [value[state] for state in self.columns]
        product: Any = self.matrix * flint.fmpz_mat(len(vector) + 1, 1, [*vector, unit])
        entries: list[fmpz] = product.entries()
        return entries


class RightSides:
    """The right sides of a model's equations.

    Attributes
    ----------
    rows : BellmanRows
        Without the transitions of a state to itself.
    pivot : list of int, of length L
        What V(s) is multiplied by on the left.
    factor : list of int, of length L
        Greatest common divisor of the pair's pivot, weights and constant.
    waits : list of bool, of length S
        Whether some pair may stay put.
    """

    def __init__(self, rows: BellmanRows) -> None:
        self.rows, pivot = _without_waiting(rows)
        self.pivots = pivot
        self.pivot: list[int] = pivot.tolist()
        self.factor: list[int] = _factor(self.rows, pivot).tolist()
        waits = np.asarray(pivot != rows.scale[rows.pair_state])
        self.waits: list[bool] = np.logical_or.reduceat(waits, rows.pair_offsets[:-1]).tolist()
        self._lengths = np.diff(self.rows.offsets)
        self._matrices: dict[Any, tuple[fmpz_mat, Integers]] = {}

    def products(self, states: Integers) -> Iterator[Product]:
        """Yield the products whose sums are those of all pairs of `states`, in order."""
        for first in range(0, len(states), CHUNK):
            yield self._product(_part(self.rows.pair_offsets, states[first : first + CHUNK]))

    def products_of(self, pairs: Integers) -> Iterator[Product]:
        """Yield the products whose sums are those of `pairs`, in order."""
        for first in range(0, len(pairs), CHUNK):
            yield self._product(pairs[first : first + CHUNK])

    def _product(self, pairs: Integers | slice) -> Product:
        rows = self.rows
        entries = _part(rows.offsets, pairs)
        lengths, constant = self._lengths[pairs], rows.constant[pairs]
        following, weight = rows.next[entries], rows.weight[entries]
        shift = int(following.min()) if len(following) else 0
        numbers = (following - shift, lengths, weight, constant)
        small = weight.dtype != object and constant.dtype != object
        key = tuple(array.tobytes() for array in numbers) if small else None
        if key in self._matrices:
            matrix, columns = self._matrices[key]
            return Product((columns + shift).tolist(), matrix, ())
        columns, place = np.unique(following, return_inverse=True)
        if len(lengths) * (len(columns) + 1) > FILLED * (len(weight) + len(lengths)):
            ends = [0, *np.cumsum(lengths).tolist()]
            weights, targets = weight.tolist(), following.tolist()
            listed = [
                (number, weights[first:last], targets[first:last])
                for number, (first, last) in zip(constant.tolist(), pairwise(ends), strict=True)
            ]
            return Product(columns.tolist(), None, listed)
        shape = (len(lengths), len(columns) + 1)
        dense = np.zeros(shape, dtype=np.int64 if small else object)
        dense[np.repeat(np.arange(len(lengths)), lengths), place] = weight
        dense[:, -1] = constant
        matrix = flint.fmpz_mat(*shape, dense.ravel().tolist())
        if small:
            self._matrices[key] = matrix, columns - shift
        return Product(columns.tolist(), matrix, ())


def _part(offsets: Integers, groups: Integers | slice) -> Integers | slice:
    """Return where the members of some groups are: a slice where the groups are consecutive."""
    if isinstance(groups, slice):
        return slice(int(offsets[groups.start]), int(offsets[groups.stop]))
    first, last = int(groups[0]), int(groups[-1])
    if last - first == len(groups) - 1 and (len(groups) < 3 or bool((np.diff(groups) == 1).all())):
        return slice(int(offsets[first]), int(offsets[last + 1]))
    return spans(offsets[groups], offsets[groups + 1])


def _without_waiting(rows: BellmanRows) -> tuple[BellmanRows, Numbers]:
    """Return the equations without transitions of a state to itself, and the (L,) pivots."""
    stays = rows.next == rows.pair_state[rows.pair]
    offsets = np.concatenate([[0], np.cumsum(~stays)])[rows.offsets]
    staying = row_sums(np.where(stays, rows.weight, 0), rows.offsets)
    moving = replace(rows, offsets=offsets, next=rows.next[~stays], weight=rows.weight[~stays])
    return moving, np.asarray(rows.scale[rows.pair_state] - staying)


def _factor(rows: BellmanRows, pivot: Numbers) -> Numbers:
    """Return (L,) the greatest common divisors of each pair's numbers."""
    factor = np.gcd(pivot, rows.constant)
    filled = np.flatnonzero(np.diff(rows.offsets))
    if len(filled):
        inside = np.gcd.reduceat(rows.weight, rows.offsets[filled])
        factor = factor.astype(np.result_type(factor, inside))
        factor[filled] = np.gcd(factor[filled], inside)
    return np.asarray(factor)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cycle:
    """The equations of K states on a cycle, N pairs and M transitions inside, pair by pair."""

    offsets: Integers  # (K+1,) pairs of each state
    pivot: Sequence[int]  # of length N
    fixed: Sequence[fmpz]  # of length N
    row: Integers  # (M,) pairs
    column: Integers  # (M,) next states
    weight: Numbers  # (M,)

    @classmethod
    def of(cls, sides: RightSides, states: Integers, fixed: Sequence[fmpz]) -> Cycle:
        """Return the equations of sorted states, given what the states around contribute."""
        rows = sides.rows
        pairs = spans(rows.pair_offsets[states], rows.pair_offsets[states + 1])
        entries = spans(rows.offsets[pairs], rows.offsets[pairs + 1])
        row = np.repeat(np.arange(len(pairs)), rows.offsets[pairs + 1] - rows.offsets[pairs])
        column = np.searchsorted(states, rows.next[entries])
        inside = states[np.minimum(column, len(states) - 1)] == rows.next[entries]
        counts = rows.pair_offsets[states + 1] - rows.pair_offsets[states]
        return cls(
            offsets=np.concatenate([[0], np.cumsum(counts)]),
            pivot=[sides.pivot[pair] for pair in pairs.tolist()],
            fixed=fixed,
            row=row[inside],
            column=column[inside],
            weight=rows.weight[entries][inside],
        )

    def policy(self) -> Integers:
        """Return (K,) pairs that are optimal as far as 53 bits, then as PRECISE bits can show."""
        size, policy = len(self.offsets) - 1, self.offsets[:-1].copy()
        if size == len(self.pivot):
            return policy
        largest = max(1, *(abs(int(number)) for number in self.fixed))
        pivot = self.pivot
        earned = np.array([int(a) / (largest * b) for a, b in zip(self.fixed, pivot, strict=True)])
        try:
            share = [int(w) / pivot[l] for w, l in zip(self.weight, self.row.tolist(), strict=True)]
        except OverflowError:  # beyond the floats, which only suggest a policy to begin with
            return policy
        chain = sp.csr_array((share, (self.row, self.column)), shape=(len(pivot), size))
        identity = sp.eye_array(size, format="csc")
        with np.errstate(all="ignore"):
            for _ in range(STEPS):
                try:
                    value = linalg.splu((identity - chain[policy]).tocsc()).solve(earned[policy])
                except RuntimeError:  # singular, up to rounding
                    return policy
                gain = earned + chain @ value - np.repeat(value, np.diff(self.offsets))
                better = self._better(policy, gain, 1e-12 * np.abs(value).max())
                if better is None:
                    break
                policy = better
        return self._sharpened(policy)

    def _sharpened(self, policy: Integers) -> Integers:
        """Improve a policy by values of PRECISE bits, until no pair gains one part in 2^128."""
        pivot, weight = np.array(self.pivot, dtype=object), self.weight.astype(object)
        filled = np.flatnonzero(np.diff(self.row, prepend=-1))
        for _ in range(STEPS):
            side = [int(self.fixed[pair]) for pair in policy.tolist()]
            found = self._matrix(policy).lifting.approximate(side, PRECISE)
            if found is None:
                break
            value, point = np.array(found[0], dtype=object), found[1]
            fixed = [int(n) << point if point > 0 else int(n) >> -point for n in self.fixed]
            gain = fixed - pivot * np.repeat(value, np.diff(self.offsets))
            if len(filled):
                gain[self.row[filled]] += np.add.reduceat(weight * value[self.column], filled)
            better = self._better(policy, gain // pivot, magnitude(value) >> PRECISE // 2)
            if better is None:
                break
            policy = better
        return policy

    def _better(self, policy: Integers, gain: Numbers, least: float) -> Integers | None:
        """Return the policy with the best pairs where they gain more than `least`, if any do."""
        best = np.maximum.reduceat(gain, self.offsets[:-1])
        better = np.asarray(best > least, dtype=bool)
        if not better.any():
            return None
        equal = np.asarray(gain == np.repeat(best, np.diff(self.offsets)), dtype=bool)
        first = np.where(equal, np.arange(len(gain)), len(gain))
        return np.where(better, np.minimum.reduceat(first, self.offsets[:-1]), policy)

    def values(self, policy: Integers) -> tuple[list[fmpz], fmpz]:
        """Return the values of a policy as integers over one positive denominator."""
        return exact_solve(self._matrix(policy), [self.fixed[pair] for pair in policy.tolist()])

    def _matrix(self, policy: Integers) -> Matrix:
        """Return the equations of a policy."""
        chosen, states = np.isin(self.row, policy), np.arange(len(policy))
        return Matrix.of(
            len(policy),
            np.concatenate([np.searchsorted(policy, self.row[chosen]), states]),
            np.concatenate([self.column[chosen], states]),
            integers([*(-self.weight[chosen]).tolist(), *(self.pivot[l] for l in policy.tolist())]),
        )

    def losses(self, value: Sequence[fmpz], rest: Mapping[int, fmpz]) -> list[list[fmpz]]:
        """Return pivot · v - right side for the pairs of each state: negative where better.

        Pairs without a right side in `rest` are those of the policy, which lose nothing.
        """
        nothing = value[0] * 0
        return [
            [
                self.pivot[pair] * value[i] - rest[pair] if pair in rest else nothing
                for pair in range(first, last)
            ]
            for i, (first, last) in enumerate(pairwise(self.offsets.tolist()))
        ]
