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

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import BellmanRows, row_sums
from exact_mdp.mdp.table import Integers, Numbers, magnitude, spans
from exact_mdp.solvers.proof.linear import Equations

if TYPE_CHECKING:
    from flint import fmpz, fmpz_mat


STEPS = 100  # of policy iteration, before the exact ones
PRECISE = 256  # bits of fixed-point values
BEYOND = 2**900  # pivots that floats would not hold, with their remainders
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
            return self._sharpened(policy, chain)

    def _sharpened(self, policy: Integers, chain: sp.csr_array) -> Integers:
        """Improve a policy by fixed-point values, until no pair gains one part in 2^128."""
        if magnitude(np.array(self.pivot, dtype=object)) > BEYOND:
            return policy
        longest = max(int(number).bit_length() for number in self.fixed)
        spare, units = max(0, longest - PRECISE), PRECISE + max(0, PRECISE - longest)
        fixed = np.array([int(number) >> spare << units for number in self.fixed], dtype=object)
        pivot, weight = np.array(self.pivot, dtype=object), self.weight.astype(object)
        filled = np.flatnonzero(np.diff(self.row, prepend=-1))
        scale, identity = pivot.astype(np.float64), sp.eye_array(len(policy), format="csc")

        def gains(value: Numbers) -> Numbers:
            gain = fixed - pivot * np.repeat(value, np.diff(self.offsets))
            if len(filled):
                gain[self.row[filled]] += np.add.reduceat(weight * value[self.column], filled)
            return np.asarray(gain)

        for _ in range(STEPS):
            try:
                factors: Any = linalg.splu((identity - chain[policy]).tocsc())
            except RuntimeError:  # singular, up to rounding
                return policy
            value, before = np.zeros(len(policy), dtype=object), 2 * units + longest
            while True:
                gain = gains(value)
                left = magnitude(gain[policy]).bit_length()
                if left <= PRECISE:
                    break
                low = left - 60
                step = factors.solve((gain[policy] >> low).astype(np.float64) / scale[policy])
                step = np.ldexp(step, 60)
                if left >= before or not np.isfinite(step).all():
                    return policy
                value += np.array([int(x) for x in step], dtype=object) << low >> 60
                before = left
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
        try:
            return self._equations(policy).solve([self.fixed[pair] for pair in policy.tolist()])
        except ZeroDivisionError:
            raise endless() from None

    def _equations(self, policy: Integers) -> Equations:
        chosen = np.isin(self.row, policy)
        return Equations(
            pivot=[self.pivot[pair] for pair in policy.tolist()],
            row=np.searchsorted(policy, self.row[chosen]),
            column=self.column[chosen],
            weight=self.weight[chosen],
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


def endless(where: str = "rows of floats on a cycle") -> ModelError:
    """Return the error to raise where a policy is found not to end."""
    return ModelError(
        "a policy need not end, because the probabilities of some rows sum to more than 1",
        where=where,
        fix='give the probabilities as exact numbers such as "1/10", or a discount below 1',
    )
