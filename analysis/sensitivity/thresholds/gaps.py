"""What every action falls short of a policy, as exact polynomials of one parameter.

    h_l(θ) = V_π(s; θ) - Q_π(l; θ)

On a piece on which rows are polynomials, the values of a policy are polynomials where the model is
acyclic; where it is not they are N_s / D with D = det(I - γ P_π), positive wherever the policy has
values, and D h_l stands in for h_l. N and D come by interpolation: their degrees are at most n d
plus that of the rewards for n states and rows of degree d (Cramer's rule). A policy is optimal
exactly where no h is negative, so that their sign changes are all the thresholds there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.sensitivity.derivatives import refuse_endless
from exact_mdp.analysis.sensitivity.exact_chain import LARGEST, rational
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.row_change import RowChange, reward_entries, transition_entries
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.bounds import levels

if TYPE_CHECKING:
    from flint import fmpq_poly

CYCLIC_DEGREE = 200


class Rows:
    """The rows of a model as polynomials of y = θ - θ0, already discounted."""

    def __init__(self, mdp: MDP, change: RowChange) -> None:
        from flint import fmpq_poly

        self.mdp, self.change = mdp, change
        self.state: list[int] = mdp.pair_state.tolist()
        rate = fmpq_poly([rational(mdp.discount_exact), *map(rational, change.rate)])
        _, top, bottom = reward_entries(mdp)
        if rate == fmpq_poly([1]):
            refuse_endless(mdp, change.reward.key.tolist(), change.name)
        # A state that is left, or earns, next to θ0 is terminal at that very value alone.
        terminal = mdp.terminal.copy()
        terminal[mdp.pair_state[change.reward.key]] = False
        terminal[mdp.pair_state[change.transition.key // mdp.n_states]] = False
        self.terminal: list[bool] = terminal.tolist()
        self.reward = [fmpq_poly([_ratio(a, b)]) for a, b in zip(top, bottom, strict=True)]
        for pair, poly in zip(change.reward.key.tolist(), _polys(change.reward), strict=True):
            self.reward[pair] += poly
        key, top, bottom = transition_entries(mdp)
        entries = {
            number: fmpq_poly([_ratio(a, b)])
            for number, a, b in zip(key.tolist(), top, bottom, strict=True)
        }
        moved = zip(change.transition.key.tolist(), _polys(change.transition), strict=True)
        for number, poly in moved:
            entries[number] = entries.get(number, fmpq_poly()) + poly
        self.following: list[list[tuple[int, fmpq_poly]]] = [[] for _ in self.reward]
        for number, poly in sorted(entries.items()):
            pair, state = divmod(number, mdp.n_states)
            if not self.terminal[self.state[pair]] and not self.terminal[state]:
                self.following[pair].append((state, poly * rate))
        self.order: list[int] | None = None
        order = levels(mdp)
        # What moves in from nothing may close a cycle that the model at θ0 does not have.
        if order is not None and all(
            order[self.state[pair]] > order[state]
            for pair, row in enumerate(self.following)
            for state, _ in row
        ):
            self.order = np.argsort(order, kind="stable").tolist()
        if self.order is None:
            self._check_size()

    @property
    def degree(self) -> int:
        """Degree of D and of D V, for models with cycles."""
        rows = max((p.degree() for row in self.following for _, p in row), default=0)
        rewards = max((p.degree() for p in self.reward), default=0)
        return self.terminal.count(False) * max(rows, 0) + max(rewards, 0)

    def _check_size(self) -> None:
        live = self.terminal.count(False)
        if live > LARGEST or self.degree > CYCLIC_DEGREE:
            raise ModelError(
                f"{live} states on cycles give rational functions of degree {self.degree}",
                where=f"parameter {self.change.name}",
                fix=f"thresholds are exact up to degree {CYCLIC_DEGREE}; use a smaller model",
            )


class Gaps:
    """The gap polynomials of a policy, kept up to date as it changes state by state.

    Attributes
    ----------
    gap : list of fmpq_poly, of length L
    renewed : set of int
        Pairs whose polynomial the last change of policy has touched.
    """

    def __init__(self, rows: Rows, inside: tuple[Fraction, Fraction]) -> None:
        from flint import fmpq_poly

        self.rows, self.inside = rows, inside
        mdp = rows.mdp
        self.offsets: list[int] = mdp.pair_offsets.tolist()
        self.chosen = [-1] * mdp.n_states
        self.value = [fmpq_poly()] * mdp.n_states
        self.q = [fmpq_poly()] * mdp.n_pairs
        self.gap = [fmpq_poly()] * mdp.n_pairs
        self.renewed: set[int] = set()
        self._fresh = True

    def follow(self, pairs: Integers) -> None:
        """Work out the gaps of the policy that takes these pairs (S,)."""
        self.renewed = set()
        if self.rows.order is None:
            self._interpolate(pairs)
        else:
            self._substitute(pairs.tolist())
        self.chosen, self._fresh = pairs.tolist(), False

    def _substitute(self, pairs: list[int]) -> None:
        rows, moved = self.rows, [False] * len(self.value)
        assert rows.order is not None
        for state in rows.order:
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

    def _interpolate(self, pairs: Integers) -> None:
        count, (low, high) = self.rows.degree + 1, self.inside
        points = [low + (high - low) * (k + 1) / (count + 1) for k in range(count)]
        samples = [self._sample(point, pairs.tolist()) for point in points]
        for pair, column in enumerate(zip(*samples, strict=True)):
            self.gap[pair] = _through(points, column)
            self.renewed.add(pair)

    def _sample(self, point: Fraction, pairs: list[int]) -> list[object]:
        """Return (L,) D h at one point."""
        from flint import fmpq_mat

        rows, y = self.rows, rational(point)
        live = [state for state, end in enumerate(rows.terminal) if not end]
        place = {state: k for k, state in enumerate(live)}
        at = [[(s, p(y)) for s, p in row] for row in rows.following]
        earned = [p(y) for p in rows.reward]
        zero = rational(0)
        entries = [zero] * len(live) ** 2
        for k, state in enumerate(live):
            entries[k * len(live) + k] += 1
            for following, p in at[pairs[state]]:
                entries[k * len(live) + place[following]] -= p
        matrix = fmpq_mat(len(live), len(live), entries)
        side = fmpq_mat(len(live), 1, [earned[pairs[state]] for state in live])
        solved = matrix.solve(side).entries()
        scale = matrix.det()
        value = dict(zip(live, solved, strict=True))
        found = []
        for pair, state in enumerate(rows.state):
            if rows.terminal[state]:
                found.append(zero)
                continue
            q = earned[pair] + sum((p * value[to] for to, p in at[pair]), zero)
            found.append(scale * (value[state] - q))
        return found


def _through(points: Sequence[Fraction], values: Sequence[object]) -> fmpq_poly:
    """Return the polynomial through the points (Newton)."""
    from flint import fmpq_poly

    if not any(values):
        return fmpq_poly()
    x, divided = [rational(point) for point in points], list(values)
    for level in range(1, len(x)):
        for k in range(len(x) - 1, level - 1, -1):
            divided[k] = (divided[k] - divided[k - 1]) / (x[k] - x[k - level])
    total = fmpq_poly([divided[-1]])
    for k in range(len(x) - 2, -1, -1):
        total = total * fmpq_poly([-x[k], 1]) + fmpq_poly([divided[k]])
    return total


def _ratio(top: object, bottom: object) -> object:
    return rational(Fraction(int(top), int(bottom)))


def _polys(change: object) -> list[fmpq_poly]:
    """Return the polynomials of a change, without constant terms."""
    from flint import fmpq_poly

    columns = zip(*change.coefficients, strict=True)
    return [fmpq_poly([rational(Fraction(0)), *map(rational, column)]) for column in columns]
