"""Heuristic search over beliefs: the bounds of each place, and one trial after the other.

See `solvers.pomdp.pomdp` for what is computed. A belief is a vector of any sum: the value of acting
is homogeneous, so that sums are probabilities and nothing needs to be divided by them.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from exact_mdp.mdp.care.process import Move, Process
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.pomdp.values import acting, fast_informed, rounding, values

CHECKED = 1e-12  # an improvement below this share of the values is not worth keeping
LEFT = 0.5  # a trial goes on where more than this share of the tolerance is open
LEAST = 1e-150  # smaller chances are left out of the points that bound from above


@dataclass(frozen=True, kw_only=True, eq=False)
class Vectors:
    """A place's controller: in belief b, take the action of the vector with the greatest α · b.

    Attributes
    ----------
    value : (N, Z) float
    action : (N,) int64
    """

    value: Floats
    action: Integers


class _Growing:
    """Rows of one shape, kept in an array that doubles when it is full."""

    def __init__(self, *shape: int) -> None:
        self._all, self.count = np.zeros((8, *shape)), 0

    def add(self, row: Floats | float) -> None:
        """Add one row."""
        if self.count == len(self._all):
            self._all = np.concatenate([self._all, np.zeros_like(self._all)])
        self._all[self.count] = row
        self.count += 1

    @property
    def rows(self) -> Floats:
        """(n, …) what was added."""
        return self._all[: self.count]


class _Upper:
    """Upper bounds of one place: fast informed vectors, corners and points."""

    def __init__(self, fast: Floats) -> None:
        size = fast.shape[1]
        self.fast = fast  # (A, Z), available actions alone
        self.corner = fast.max(axis=0)
        self._points, self._values = _Growing(size), _Growing()
        self._inverse, self._barred = _Growing(size), _Growing(size)

    def at(self, beliefs: Floats) -> Floats:
        """Return (B,) upper bounds at beliefs (B, Z) of any sum."""
        found = (beliefs @ self.fast.T).max(axis=1)
        base = beliefs @ self.corner
        np.minimum(found, base, out=found)
        if self._points.count:
            drop = self._values.rows - self._points.rows @ self.corner
            share = beliefs[:, None, :] * self._inverse.rows + self._barred.rows
            saw = base + (share.min(axis=2) * np.minimum(drop, 0.0)).min(axis=1)
            np.minimum(found, saw, out=found)
        return np.asarray(found)

    def add(self, belief: Floats, value: float) -> None:
        """Record that `value` is an upper bound at a belief that sums to 1."""
        # Chances so small have no inverse that is safe. Without them the value is at most
        # LEAST Z max |V| higher, far below the slack that `Search.upper` adds.
        belief = np.where(belief < LEAST, 0.0, belief)
        support = np.flatnonzero(belief)
        if len(support) == 1:
            self.corner[support] = np.minimum(self.corner[support], value / belief[support])
            return
        if not value < self.at(belief[None])[0] - CHECKED * abs(value):
            return
        self._points.add(belief)
        self._values.add(value)
        self._inverse.add(np.divide(1.0, belief, out=np.zeros_like(belief), where=belief > 0))
        self._barred.add(np.where(belief > 0, 0.0, np.inf))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Branch:
    """One move from a belief: what is believed there after each action and perception.

    beliefs (A, O, R) before their division by what they sum to, with the bounds (A, O) on their
    values; O is 1 where only one status is possible, so that perceiving it tells nothing.
    """

    move: Move
    beliefs: Floats
    seen: Floats  # (O, R) C(s', z), or ones
    lower: Floats
    upper: Floats
    vector: Integers  # (A, O) the best vector at the move's place


class Search:
    """The bounds of every place, and the trials that improve them."""

    def __init__(self, process: Process, begin: object) -> None:
        self.process = process
        size, places = process.statuses, len(process.moves)
        self.slack = 2 * rounding(process)
        fast = fast_informed(process)
        self.available = [np.flatnonzero(row) for row in process.offered]
        self.up = [_Upper(fast[x][self.available[x]]) for x in range(places)]
        self.low = [_Growing(size) for _ in range(places)]
        self.actions: list[list[int]] = [[] for _ in range(places)]  # of these vectors
        for table in _tables(process, begin):
            _, q = values(process, acting(process, table))
            for place in process.order:
                for action in self.available[place]:
                    self._learn(place, q[place, :, action, 0], int(action))
        first = process.start * process.confusion.T  # (Z, Z) by what is seen
        self.first = first[first.sum(axis=1) > 0]

    def vectors(self) -> tuple[Vectors, ...]:
        """Return a copy of every place's vectors."""
        both = zip(self.low, self.actions, strict=True)
        return tuple(
            Vectors(value=low.rows.copy(), action=np.array(actions, dtype=np.int64))
            for low, actions in both
        )

    def _learn(self, place: int, vector: Floats, action: int) -> None:
        self.low[place].add(vector)
        self.actions[place].append(action)

    @property
    def lower(self) -> float:
        """Sound lower bound at the start."""
        vectors = self.low[self.process.start_place].rows
        return float((self.first @ vectors.T).max(axis=1).sum()) - self.slack

    @property
    def upper(self) -> float:
        """Sound upper bound at the start."""
        return float(self.up[self.process.start_place].at(self.first).sum()) + self.slack

    def trial(self, tolerance: float, end: float) -> None:
        """Go down once from the start, to where the bounds are furthest apart."""
        place = self.process.start_place
        gaps = self.up[place].at(self.first) - (self.first @ self.low[place].rows.T).max(axis=1)
        belief = self.first[int(gaps.argmax())]
        belief, tolerance = belief / belief.sum(), tolerance * LEFT
        path = []
        while True:
            path.append((place, belief))
            branches, _, upper = self._look(place, belief)
            if not branches or perf_counter() > end:
                break
            action = int(upper.argmax())
            best, chosen = 0.0, None
            for branch in branches:
                mass = branch.beliefs[action].sum(axis=1)
                open_gap = branch.upper[action] - branch.lower[action] - tolerance * mass
                number = int(open_gap.argmax())
                if open_gap[number] > best:
                    best, chosen = float(open_gap[number]), (branch, number)
            if chosen is None:
                break
            branch, number = chosen
            place = branch.move.place
            belief = np.zeros(self.process.statuses)
            belief[branch.move.reach] = branch.beliefs[action, number]
            belief /= belief.sum()
        for each in reversed(path):
            self._back_up(*each)

    def _look(self, place: int, belief: Floats) -> tuple[list[_Branch], Floats, Floats]:
        """Return the branches of a belief, and bounds (A,) on its actions, not available -inf."""
        process = self.process
        lower = np.where(process.offered[place], belief @ process.reward[place], -np.inf)
        upper, branches = lower.copy(), []
        support = np.flatnonzero(belief)
        for move in process.moves[place]:
            after = np.einsum("s,asr->ar", belief[support], move.chance[:, support])
            one = len(move.reach) == 1
            seen = np.ones((1, 1)) if one else process.confusion[move.reach].T
            beliefs = after[:, None, :] * seen
            flat = beliefs.reshape(-1, len(move.reach))
            found = flat @ self.low[move.place].rows[:, move.reach].T
            vector = found.argmax(axis=1)
            low = found[np.arange(len(flat)), vector].reshape(beliefs.shape[:2])
            whole = np.zeros((len(flat), process.statuses))
            whole[:, move.reach] = flat
            up = self.up[move.place].at(whole).reshape(beliefs.shape[:2])
            lower += process.discount * low.sum(axis=1)
            upper += process.discount * up.sum(axis=1)
            branches.append(
                _Branch(
                    move=move,
                    beliefs=beliefs,
                    seen=seen,
                    lower=low,
                    upper=up,
                    vector=vector.reshape(beliefs.shape[:2]),
                )
            )
        return branches, lower, upper

    def _back_up(self, place: int, belief: Floats) -> None:
        """Improve both bounds of a place at one belief."""
        process = self.process
        branches, lower, upper = self._look(place, belief)
        self.up[place].add(belief, float(upper.max()))
        action = int(lower.argmax())
        known = float((self.low[place].rows @ belief).max())
        if not lower[action] > known + CHECKED * max(1.0, abs(known)):
            return
        vector = process.reward[place][:, action].copy()
        for branch in branches:
            move = branch.move
            rows = self.low[move.place].rows[branch.vector[action]][:, move.reach]
            ahead = (branch.seen * rows).sum(axis=0)
            vector += process.discount * (move.chance[action] @ ahead)
        self._learn(place, vector, action)


def _tables(process: Process, begin: Any) -> list[Floats]:
    """Return the policies (P, Z, A) that the lower bound begins with."""
    if begin is not None:
        forms = list(begin) if isinstance(begin, list | tuple) else [begin]
        return [process.table(form) for form in forms]
    one_hot = np.eye(process.offered.shape[1])
    first = one_hot[process.offered.argmax(axis=1)]
    tables = [
        np.where(offered[:, None], row, first)
        for offered, row in zip(process.offered.T, one_hot, strict=True)
    ]
    return [np.repeat(table[:, None], process.statuses, axis=1) for table in tables]
