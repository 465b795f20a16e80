"""What every action falls short of a policy, as exact polynomials of one parameter.

    h_l(θ) = V_π(s; θ) - Q_π(l; θ)

On a section on which rows are polynomials, the values of a policy are polynomials where the model
is acyclic, else N_s / D with D = det(I - γ P_π) > 0, and D h_l stands in for h_l. By Cramer's rule
N and D have at most the degree Σ_s d_s, where d_s is the greatest degree in the rows of state s:
so they come by interpolation. Where the discount alone moves they come from powers of P_π,

    N(γ) = D(γ) Σ_k γ^k P^k r   up to degree n - 1.

A policy is optimal exactly where no h is negative: sign changes are all the thresholds there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

import flint
import numpy as np

from exact_mdp.analysis.vary.curves.checker import Mix, Values
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import rational
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.row_change import PolynomialRows, RowChange, polynomials
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.bounds import levels

if TYPE_CHECKING:
    from flint import fmpq, fmpq_poly


LARGEST = 300  # states of a model with cycles
CYCLIC_DEGREE = 200


class Gaps:
    """The rows of a section as polynomials of y = θ - θ0, and the gaps (L,) of a policy.

    `renewed` are the pairs whose polynomial the last change of policy has touched.
    """

    values: Values

    def __init__(self, mdp: MDP, change: RowChange, low: Fraction, high: Fraction) -> None:
        self.rows, self.inside = PolynomialRows(mdp, change), (low, high)
        self.terminal = self.rows.terminal
        self.state: list[int] = mdp.pair_state.tolist()
        self.pairs = [mdp.pairs_of(state) for state in range(mdp.n_states)]
        self.live = [state for state, ends in enumerate(self.terminal) if not ends]
        self.order = self._order()
        self.degree = 0
        for state in () if self.order else self.live:
            self.degree += max(
                each.degree()
                for pair in self.pairs[state]
                for each in (self.rows.reward[pair], *(p for _, p in self.rows.following[pair]))
            )
        live, where = len(self.live), f"parameter {change.name}"
        if not self.order and live > LARGEST:
            raise ModelError(
                f"{live} states with cycles among them",
                where=where,
                fix=f"with cycles, use at most {LARGEST} states that are not terminal",
            )
        if self.degree > CYCLIC_DEGREE:
            raise ModelError(
                f"{live} states on cycles give rational functions of degree {self.degree}",
                where=where,
                fix=f"thresholds are exact up to degree {CYCLIC_DEGREE}; use a smaller model",
            )
        self.q = [flint.fmpq_poly()] * mdp.n_pairs
        self.gap, self.renewed = [*self.q], set[int]()

    def _order(self) -> list[int]:
        """Return the states from the end on; none where transitions close a cycle."""
        order = levels(self.rows.mdp)
        # What moves in from nothing may close a cycle that the model at θ0 does not have.
        if order is None or any(
            order[self.state[pair]] <= order[state]
            for pair, row in enumerate(self.rows.following)
            for state, _ in row
        ):
            return []
        return [int(state) for state in np.argsort(order, kind="stable")]

    def values_of(self, mix: Mix) -> Values:
        """Return the values of a policy."""
        value = [flint.fmpq_poly()] * len(self.pairs)
        if self.order:
            for state in self.order:
                if not self.terminal[state]:
                    ahead = (self._ahead(pair, value) * share for pair, share in mix[state])
                    value[state] = sum(ahead, flint.fmpq_poly())
            return value, flint.fmpq_poly([1])
        change = self.rows.change
        still = not len(change.transition.key) and not len(change.reward.key)
        by_powers = still and self.rows.rate.degree() > 0
        numerators, scale = self._powers(mix) if by_powers else self._interpolated(mix)
        for state, numerator in zip(self.live, numerators, strict=True):
            value[state] = numerator
        return value, scale

    def _ahead(
        self, pair: int, value: Sequence[fmpq_poly], scale: fmpq_poly | int = 1
    ) -> fmpq_poly:
        """Return D Q of a pair: D r + Σ p N."""
        total = self.rows.reward[pair] * scale
        for following, p in self.rows.following[pair]:
            total = total + p * value[following]
        return total

    def _system(self, mix: Mix) -> tuple[list[tuple[int, fmpq, fmpq_poly]], list[fmpq_poly]]:
        """Return the entries of a policy's transitions among live states, and its rewards."""
        place, count = {state: k for k, state in enumerate(self.live)}, len(self.live)
        entries, side = [], []
        for k, state in enumerate(self.live):
            side.append(
                sum((self.rows.reward[pair] * w for pair, w in mix[state]), flint.fmpq_poly())
            )
            entries += [
                (k * count + place[following], share, p)
                for pair, share in mix[state]
                for following, p in self.rows.following[pair]
            ]
        return entries, side

    def _interpolated(self, mix: Mix) -> tuple[list[fmpq_poly], fmpq_poly]:
        """Return N, of live states, and D from their values at `degree` + 1 points inside."""
        (low, high), size, count = self.inside, self.degree + 1, len(self.live)
        entries, side = self._system(mix)
        step = (high - low) / (size + 1)
        samples: list[list[fmpq]] = []
        for k in range(1, size + 1):
            y, matrix = rational(low + step * k), [rational(0)] * count**2
            matrix[:: count + 1] = [rational(1)] * count
            for at, share, p in entries:
                matrix[at] -= share * p(y)
            system = flint.fmpq_mat(count, count, matrix)
            scale = system.det()
            values = system.solve(flint.fmpq_mat(count, 1, [each(y) for each in side])).entries()
            samples.append([*(scale * each for each in values), scale])
        number = flint.fmpq_poly([rational(-low / step), rational(1 / step)])  # of a point
        *tops, below = (each(number) for each in polynomials(range(1, size + 1), samples))
        return tops, below

    def _powers(self, mix: Mix) -> tuple[list[fmpq_poly], fmpq_poly]:
        """Return N, of live states, and D from powers of the matrix."""
        count, rate = len(self.live), self.rows.rate
        entries, side = self._system(mix)
        numbers = [rational(0)] * count**2
        for at, share, p in entries:
            numbers[at] += share * (p / rate)[0]
        matrix, unit = flint.fmpq_mat(count, count, numbers).numer_denom()  # P = A / q
        vector, times = flint.fmpq_mat(count, 1, [each[0] for each in side]).numer_denom()
        columns = []
        for _ in range(count):
            columns.append(vector.entries())
            vector = matrix * vector
        below = flint.fmpz_poly(matrix.charpoly().coeffs()[::-1])  # det(I - z A), z = γ / q
        numerators = [
            flint.fmpq_poly((below * flint.fmpz_poly(list(powers))).coeffs()[:count])(rate / unit)
            for powers in zip(*columns, strict=True)
        ]
        return numerators, flint.fmpq_poly(below)(rate / unit) * times

    def follow(self, policy: Integers) -> None:
        """Work out the gaps of the policy that takes these pairs (S,)."""
        chosen: list[int] = policy.tolist()
        if not self.order:
            value, scale = self.values = self.values_of([[(p, rational(1))] for p in chosen])
            self.renewed = {pair for state in self.live for pair in self.pairs[state]}
            for pair in self.renewed:
                self.gap[pair] = value[self.state[pair]] - self._ahead(pair, value, scale)
            return
        fresh = not hasattr(self, "values")
        value = [flint.fmpq_poly()] * len(self.pairs) if fresh else [*self.values[0]]
        moved = set[int]()
        self.renewed = set()
        for state in self.order:
            if self.terminal[state]:
                continue
            again = [
                pair
                for pair in self.pairs[state]
                if fresh or any(to in moved for to, _ in self.rows.following[pair])
            ]
            for pair in again:
                self.q[pair] = self._ahead(pair, value)
            best = self.q[chosen[state]]
            if fresh or best != value[state]:
                moved.add(state)
                value[state], again = best, [*self.pairs[state]]
            for pair in again:
                self.gap[pair] = best - self.q[pair]
            self.renewed.update(again)
        self.values = value, flint.fmpq_poly([1])
