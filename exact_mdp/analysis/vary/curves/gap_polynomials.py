"""What every action falls short of a policy, as exact polynomials of one parameter.

    h_l(θ) = V_π(s; θ) - Q_π(l; θ)

On a piece on which rows are polynomials, the values of a policy are polynomials where the model is
acyclic; where it is not they are N_s / D with D = det(I - γ P_π), positive wherever the policy has
values, and D h_l stands in for h_l. By Cramer's rule N and D have at most the degree Σ_s d_s, where
d_s is the greatest degree in the rows of state s: each product takes one entry of each row. So they
come by interpolation at few points where a parameter moves few rows. Where it moves the discount
alone, they come from powers of P_π and its characteristic polynomial, without any point:

    D(γ) = det(I - γ P),      N(γ) = D(γ) Σ_k γ^k P^k r   up to degree n - 1.

A policy is optimal exactly where no h is negative, so that their sign changes are all the
thresholds there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

import flint
import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import rational
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.polynomial_rows import PolynomialRows
from exact_mdp.mdp.parametric.row_change import RowChange
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.bounds import levels

if TYPE_CHECKING:
    from flint import fmpq, fmpq_poly


LARGEST = 300  # states of a model with cycles
CYCLIC_DEGREE = 200

Mix = Sequence[Sequence[tuple[int, "fmpq"]]]
"""Of each state, the pairs that a policy takes there, with their probabilities."""
Ratio = tuple["fmpq_poly", "fmpq_poly"]
Values = tuple[Sequence["fmpq_poly"], "fmpq_poly"]
"""N of each state, and D: the values of a policy are N / D."""


class Rows:
    """The rows of a model as polynomials of y = θ - θ0, already discounted, and its policies."""

    def __init__(self, mdp: MDP, change: RowChange) -> None:
        rows = PolynomialRows.of(mdp, change)
        self.mdp, self.change, self.rate = mdp, change, rows.rate
        self.terminal, self.reward, self.following = rows.terminal, rows.reward, rows.following
        self.state: list[int] = mdp.pair_state.tolist()
        self.order = self._order()
        live = len(self.live)
        if self.order is None and live > LARGEST:
            raise ModelError(
                f"{live} states with cycles among them",
                where=f"parameter {change.name}",
                fix=f"with cycles, use at most {LARGEST} states that are not terminal",
            )
        if self.order is None and self.degree > CYCLIC_DEGREE:
            raise ModelError(
                f"{live} states on cycles give rational functions of degree {self.degree}",
                where=f"parameter {change.name}",
                fix=f"thresholds are exact up to degree {CYCLIC_DEGREE}; use a smaller model",
            )

    def _order(self) -> list[int] | None:
        """Return the states from the end on; None where transitions close a cycle."""
        order = levels(self.mdp)
        # What moves in from nothing may close a cycle that the model at θ0 does not have.
        if order is None or any(
            order[self.state[pair]] <= order[state]
            for pair, row in enumerate(self.following)
            for state, _ in row
        ):
            return None
        return [int(state) for state in np.argsort(order, kind="stable")]

    @cached_property
    def live(self) -> list[int]:
        """The states that are not terminal."""
        return [state for state, end in enumerate(self.terminal) if not end]

    @cached_property
    def degree(self) -> int:
        """Degree of D and of D V, for models with cycles."""
        most = [0] * self.mdp.n_states
        for pair, state in enumerate(self.state):
            if not self.terminal[state]:
                here = (self.reward[pair], *(p for _, p in self.following[pair]))
                most[state] = max(most[state], *(poly.degree() for poly in here))
        return sum(most)

    @property
    def discounted(self) -> bool:
        """Whether the discount is all that moves."""
        still = not len(self.change.transition.key) and not len(self.change.reward.key)
        return still and self.rate.degree() > 0

    def points(self, inside: tuple[Fraction, Fraction]) -> list[fmpq]:
        """Return as many points between two as fix a polynomial of that degree."""
        count, (low, high) = self.degree + 1, inside
        return [rational(low + (high - low) * (k + 1) / (count + 1)) for k in range(count)]

    def start(self, value: Sequence[Any]) -> Any:
        """Return the value at the start, of values that are numbers or polynomials."""
        alive = ((state, weight) for state, weight in self.mdp.start if not self.terminal[state])
        return sum((value[state] * rational(weight) for state, weight in alive), flint.fmpq_poly())

    def worth(self, values: Values) -> Ratio:
        """Return what a policy is worth at the start: N and D, polynomials of y."""
        return self.start(values[0]), values[1]

    def values(self, mix: Mix, inside: tuple[Fraction, Fraction]) -> Values:
        """Return the values of a policy between two points: N and D, polynomials of y."""
        value = [flint.fmpq_poly()] * self.mdp.n_states
        if self.order is None:
            found, scale = self._powers(mix) if self.discounted else self._through(mix, inside)
            for state, numerator in zip(self.live, found, strict=True):
                value[state] = numerator
            return value, scale
        for state in self.order:
            if not self.terminal[state]:
                for pair, share in mix[state]:
                    value[state] = value[state] + share * self.ahead(pair, value)
        return value, flint.fmpq_poly([1])

    def ahead(self, pair: int, value: Sequence[fmpq_poly], scale: fmpq_poly | int = 1) -> fmpq_poly:
        """Return D Q of a pair: D r + Σ p N."""
        total = self.reward[pair] * scale
        for following, p in self.following[pair]:
            total = total + p * value[following]
        return total

    def _through(self, mix: Mix, inside: tuple[Fraction, Fraction]) -> Values:
        """Interpolate N, of the states that are not terminal, and D."""
        points = self.points(inside)
        samples = [self._solved(point, mix) for point in points]
        *numerators, scale = (interpolated(points, column) for column in zip(*samples, strict=True))
        return numerators, scale

    def _solved(self, y: fmpq, mix: Mix) -> list[fmpq]:
        """Return D V, of the states that are not terminal, and D at one point."""
        live, zero = self.live, rational(0)
        place, count = {state: k for k, state in enumerate(live)}, len(live)
        entries, side = [zero] * count**2, [zero] * count
        for k, state in enumerate(live):
            entries[k * count + k] += 1
            for pair, share in mix[state]:
                side[k] += share * self.reward[pair](y)
                for following, p in self.following[pair]:
                    entries[k * count + place[following]] -= share * p(y)
        matrix = flint.fmpq_mat(count, count, entries)
        scale = matrix.det()
        value = matrix.solve(flint.fmpq_mat(count, 1, side)).entries()
        return [*(scale * each for each in value), scale]

    def _powers(self, mix: Mix) -> Values:
        """Return N, of the states that are not terminal, and D from powers of the matrix."""
        live, count = self.live, len(self.live)
        place = {state: k for k, state in enumerate(live)}
        entries, side = [rational(0)] * count**2, [rational(0)] * count
        for k, state in enumerate(live):
            for pair, share in mix[state]:
                side[k] += share * self.reward[pair][0]
                for following, p in self.following[pair]:
                    entries[k * count + place[following]] += share * (p / self.rate)[0]
        matrix, unit = flint.fmpq_mat(count, count, entries).numer_denom()  # P = A / q
        vector, times = flint.fmpq_mat(count, 1, side).numer_denom()
        columns = []
        for _ in range(count):
            columns.append(vector.entries())
            vector = matrix * vector
        below = flint.fmpz_poly(matrix.charpoly().coeffs()[::-1])  # det(I - z A), z = γ / q
        rate = self.rate / unit
        numerators = [
            flint.fmpq_poly((below * flint.fmpz_poly(list(powers))).coeffs()[:count])(rate)
            for powers in zip(*columns, strict=True)
        ]
        return numerators, flint.fmpq_poly(below)(rate) * times


class Gaps:
    """The gap polynomials of a policy, kept up to date as it changes state by state.

    Attributes
    ----------
    gap : list of fmpq_poly, of length L
    renewed : set of int
        Pairs whose polynomial the last change of policy has touched.
    values : (N of each of S states, D)
        The policy's values are N / D.
    """

    values: Values

    def __init__(self, rows: Rows, inside: tuple[Fraction, Fraction]) -> None:
        self.rows, self.inside = rows, inside
        mdp = rows.mdp
        self.offsets: list[int] = mdp.pair_offsets.tolist()
        self.q = [flint.fmpq_poly()] * mdp.n_pairs
        self.gap = [flint.fmpq_poly()] * mdp.n_pairs
        self.renewed: set[int] = set()
        self._fresh = True

    def follow(self, pairs: Integers) -> None:
        """Work out the gaps of the policy that takes these pairs (S,)."""
        self.renewed = set()
        if self.rows.order is None:
            self._evaluate(pairs.tolist())
        else:
            self._substitute(self.rows.order, pairs.tolist())
        self._fresh = False

    def _substitute(self, order: list[int], pairs: list[int]) -> None:
        rows, moved = self.rows, [False] * len(self.offsets)
        one = flint.fmpq_poly([1])
        value = [flint.fmpq_poly()] * rows.mdp.n_states if self._fresh else [*self.values[0]]
        for state in order:
            if rows.terminal[state]:
                continue
            span = range(self.offsets[state], self.offsets[state + 1])
            again = [
                pair
                for pair in span
                if self._fresh or any(moved[following] for following, _ in rows.following[pair])
            ]
            for pair in again:
                self.q[pair] = rows.ahead(pair, value)
            best = self.q[pairs[state]]
            moved[state] = self._fresh or best != value[state]
            value[state] = best
            for pair in span if moved[state] else again:
                self.gap[pair] = best - self.q[pair]
                self.renewed.add(pair)
        self.values = value, one

    def _evaluate(self, pairs: list[int]) -> None:
        rows = self.rows
        value, scale = rows.values([[(pair, rational(1))] for pair in pairs], self.inside)
        self.values = value, scale
        self.renewed = set(range(len(self.gap)))
        self.gap = [
            flint.fmpq_poly() if rows.terminal[s] else value[s] - rows.ahead(pair, value, scale)
            for pair, s in enumerate(rows.state)
        ]


def interpolated(x: Sequence[fmpq], values: Sequence[fmpq]) -> fmpq_poly:
    """Return the polynomial through the points (Newton)."""
    poly: type[fmpq_poly] = flint.fmpq_poly
    if not any(values):
        return poly()
    divided = list(values)
    for level in range(1, len(x)):
        for k in range(len(x) - 1, level - 1, -1):
            divided[k] = (divided[k] - divided[k - 1]) / (x[k] - x[k - level])
    total: fmpq_poly = poly([divided[-1]])
    for k in range(len(x) - 2, -1, -1):
        total = total * poly([-x[k], 1]) + poly([divided[k]])
    return total
