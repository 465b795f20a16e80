"""What every action falls short of a policy, as exact polynomials of one parameter.

    h_l(θ) = V_π(s; θ) - Q_π(l; θ)

On a piece on which rows are polynomials, the values of a policy are polynomials where the model is
acyclic; where it is not they are N_s / D with D = det(I - γ P_π), positive wherever the policy has
values, and D h_l stands in for h_l. N and D come by interpolation: their degrees are at most n d
plus that of the rewards for n states and rows of degree d (Cramer's rule). A policy is optimal
exactly where no h is negative, so that their sign changes are all the thresholds there are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.analysis.sensitivity.derivatives import refuse_endless
from exact_mdp.analysis.sensitivity.exact_chain import LARGEST, rational, ratios
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.row_change import (
    Change,
    RowChange,
    reward_entries,
    transition_entries,
)
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.bounds import levels

if TYPE_CHECKING:
    from flint import fmpq, fmpq_poly

flint = later("flint")

CYCLIC_DEGREE = 200

Mix = Sequence[Sequence[tuple[int, "fmpq"]]]
"""Of each state, the pairs that a policy takes there, with their probabilities."""
Ratio = tuple["fmpq_poly", "fmpq_poly"]


class Rows:
    """The rows of a model as polynomials of y = θ - θ0, already discounted."""

    def __init__(self, mdp: MDP, change: RowChange) -> None:
        poly = flint.fmpq_poly
        self.mdp, self.change = mdp, change
        self.state: list[int] = mdp.pair_state.tolist()
        rate = poly([rational(mdp.discount_exact), *map(rational, change.rate)])
        if rate == poly([1]):
            refuse_endless(mdp, change.reward.key.tolist(), change.name)
        # A state that is left, or earns, next to θ0 is terminal at that very value alone.
        terminal = mdp.terminal.copy()
        terminal[mdp.pair_state[change.reward.key]] = False
        terminal[mdp.pair_state[change.transition.key // mdp.n_states]] = False
        self.terminal: list[bool] = terminal.tolist()
        self.reward: list[fmpq_poly] = [poly([r]) for r in ratios(reward_entries(mdp))]
        for pair, moved in _polynomials(change.reward):
            self.reward[pair] += moved
        entries = transition_entries(mdp)
        weight: dict[int, fmpq_poly] = {
            key: poly([p]) for key, p in zip(entries[0].tolist(), ratios(entries), strict=True)
        }
        for key, moved in _polynomials(change.transition):
            weight[key] = weight.get(key, poly()) + moved
        self.following: list[list[tuple[int, fmpq_poly]]] = [[] for _ in self.reward]
        for key, p in sorted(weight.items()):
            pair, state = divmod(key, mdp.n_states)
            if not self.terminal[self.state[pair]] and not self.terminal[state]:
                self.following[pair].append((state, p * rate))
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

    @property
    def degree(self) -> int:
        """Degree of D and of D V, for models with cycles."""
        rows = max((p.degree() for row in self.following for _, p in row), default=0)
        rewards = max((p.degree() for p in self.reward), default=0)
        return len(self.live) * max(rows, 0) + max(rewards, 0)

    def points(self, inside: tuple[Fraction, Fraction]) -> list[fmpq]:
        """Return as many points between two as fix a polynomial of that degree."""
        count, (low, high) = self.degree + 1, inside
        return [rational(low + (high - low) * (k + 1) / (count + 1)) for k in range(count)]

    def solved(self, y: fmpq, mix: Mix) -> tuple[dict[int, fmpq], fmpq]:
        """Return the values of a policy at one point, by state, and D there."""
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
        value = matrix.solve(flint.fmpq_mat(count, 1, side)).entries()
        return dict(zip(live, value, strict=True)), matrix.det()

    def start(self, value: Sequence[Any] | Mapping[int, Any]) -> Any:
        """Return the value at the start, of values that are numbers or polynomials."""
        alive = ((state, weight) for state, weight in self.mdp.start if not self.terminal[state])
        return sum((value[state] * rational(weight) for state, weight in alive), rational(0))

    def worth(self, mix: Mix, inside: tuple[Fraction, Fraction]) -> Ratio:
        """Return what a policy held fixed is worth at the start: N and D, polynomials of y."""
        poly = flint.fmpq_poly
        if self.order is None:
            points = self.points(inside)
            found = [self.solved(point, mix) for point in points]
            scaled = [self.start(value) * scale for value, scale in found]
            return _through(points, scaled), _through(points, [scale for _, scale in found])
        value = [poly()] * self.mdp.n_states
        for state in self.order:
            if not self.terminal[state]:
                for pair, share in mix[state]:
                    ahead = sum((p * value[to] for to, p in self.following[pair]), poly())
                    value[state] = value[state] + share * (self.reward[pair] + ahead)
        return poly([0]) + self.start(value), poly([1])


class Gaps:
    """The gap polynomials of a policy, kept up to date as it changes state by state.

    Attributes
    ----------
    gap : list of fmpq_poly, of length L
    renewed : set of int
        Pairs whose polynomial the last change of policy has touched.
    worth : (fmpq_poly, fmpq_poly)
        N and D of the policy's value N / D at the start.
    """

    def __init__(self, rows: Rows, inside: tuple[Fraction, Fraction]) -> None:
        self.rows, self.inside = rows, inside
        mdp = rows.mdp
        self.offsets: list[int] = mdp.pair_offsets.tolist()
        self.value = [flint.fmpq_poly()] * mdp.n_states
        self.q = [flint.fmpq_poly()] * mdp.n_pairs
        self.gap = [flint.fmpq_poly()] * mdp.n_pairs
        self.renewed: set[int] = set()
        self._fresh = True

    def follow(self, pairs: Integers) -> None:
        """Work out the gaps of the policy that takes these pairs (S,)."""
        self.renewed = set()
        if self.rows.order is None:
            self._interpolate(pairs.tolist())
        else:
            self._substitute(self.rows.order, pairs.tolist())
            self.worth = (flint.fmpq_poly() + self.rows.start(self.value), flint.fmpq_poly([1]))
        self._fresh = False

    def _substitute(self, order: list[int], pairs: list[int]) -> None:
        rows, moved = self.rows, [False] * len(self.value)
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
                total = rows.reward[pair]
                for following, factor in rows.following[pair]:
                    total = total + factor * self.value[following]
                self.q[pair] = total
            value = self.q[pairs[state]]
            moved[state] = self._fresh or value != self.value[state]
            self.value[state] = value
            for pair in span if moved[state] else again:
                self.gap[pair] = value - self.q[pair]
                self.renewed.add(pair)

    def _interpolate(self, pairs: list[int]) -> None:
        points = self.rows.points(self.inside)
        samples = [self._sample(point, pairs) for point in points]
        *gaps, top, below = (_through(points, column) for column in zip(*samples, strict=True))
        self.gap, self.worth = gaps, (top, below)
        self.renewed = set(range(len(gaps)))

    def _sample(self, y: fmpq, pairs: list[int]) -> list[fmpq]:
        """Return (L,) D h, and after them D V at the start, and D, at one point."""
        rows, zero = self.rows, rational(0)
        value, scale = rows.solved(y, [[(pair, rational(1))] for pair in pairs])
        found = []
        for pair, state in enumerate(rows.state):
            if rows.terminal[state]:
                found.append(zero)
                continue
            q = rows.reward[pair](y) + sum(
                (p(y) * value[to] for to, p in rows.following[pair]), zero
            )
            found.append(scale * (value[state] - q))
        return [*found, scale * rows.start(value), scale]


def _through(x: Sequence[fmpq], values: Sequence[fmpq]) -> fmpq_poly:
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


def _polynomials(change: Change) -> list[tuple[int, fmpq_poly]]:
    """Return what is added to each entry that moves, by its key."""
    columns = zip(*change.coefficients, strict=True)
    moved = [flint.fmpq_poly([rational(0), *map(rational, column)]) for column in columns]
    return list(zip(change.key.tolist(), moved, strict=True))
