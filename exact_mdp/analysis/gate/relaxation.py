"""Policies bound to read some columns only: many of them, or many relaxations, solved at once.

All states in which the columns read have the same values form a *row*, and a policy that reads
these columns takes one action in the whole row. A relaxation allows a set of actions in each row
and lets every state of it choose among them freely, knowing the full state: its optimal value is
an upper bound for every policy that takes, in each row, one of the allowed actions, mixed ones
included, and with one action allowed in each row it is the value of that policy.

Models without cycles are solved backward, level by level, for all sets of allowed pairs at once;
others by policy iteration, one set after the other, begun with the policy of the one before.
Neither claims anything of its error.

The upper bound is V + c w with the weights w and margins m of `solvers.bounds.bounds`, where V are
the values found and r + γ P V - V ≤ c m for every allowed pair,
rounding errors included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import reachable
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Floats, Integers, spans
from exact_mdp.solvers.bounds.bounds import levels, margin_weights
from exact_mdp.solvers.bounds.gains import SLACK, gamma
from exact_mdp.solvers.bounds.linear import LinearSystem, policy_chain

Flags = NDArray[np.bool_]
ITERATIONS = 1000


class Levels:
    """Models without cycles: one backward pass for all relaxations at once."""

    def __init__(self, mdp: MDP) -> None:
        self.mdp = mdp
        level = levels(mdp)
        assert level is not None
        used = np.flatnonzero(reachable(mdp) & (level > 0))
        used = used[np.argsort(level[used], kind="stable")]
        cuts = np.flatnonzero(np.diff(level[used], prepend=0))
        self.blocks = []
        for states in np.split(used, cuts)[1:]:
            first, last = mdp.pair_offsets[states], mdp.pair_offsets[states + 1]
            pairs = spans(first, last)
            matrix = mdp.transition[pairs]
            offsets = np.concatenate([[0], np.cumsum(last - first)[:-1]])
            targets, columns = np.unique(matrix.indices, return_inverse=True)
            shape = (len(pairs), len(targets))
            back = sp.csr_array((matrix.data, columns, matrix.indptr), shape).T.tocsr()
            self.blocks.append((states, pairs, offsets, matrix, targets, back))

    def solve(self, allowed: Flags) -> tuple[Floats, Floats, Floats]:
        """Return values (S, N), action values (L, N) and the greatest r + γPV - V allowed (N,)."""
        mdp, count = self.mdp, allowed.shape[1]
        value, q = np.zeros((mdp.n_states, count)), np.zeros((mdp.n_pairs, count))
        for states, pairs, offsets, matrix, _, _ in self.blocks:
            found = mdp.reward[pairs, None] + mdp.discount * (matrix @ value)
            q[pairs] = found
            found[~allowed[pairs]] = -np.inf
            value[states] = np.maximum.reduceat(found, offsets)
        return value, q, np.zeros(count)

    def visits(self, taken: Flags) -> Floats:
        """Return (S, N) discounted visits from the start where the pairs (L, N) are taken."""
        mdp = self.mdp
        visits = np.repeat(mdp.start_distribution[:, None], taken.shape[1], axis=1)
        for _, pairs, _, _, targets, back in reversed(self.blocks):
            flow = visits[mdp.pair_state[pairs]] * taken[pairs]
            visits[targets] += mdp.discount * (back @ flow)
        return visits


class Cycles:
    """Models with cycles: policy iteration for each relaxation, begun with the one before."""

    def __init__(self, mdp: MDP) -> None:
        self.mdp = mdp

    def solve(self, allowed: Flags) -> tuple[Floats, Floats, Floats]:
        """See `Levels.solve`."""
        mdp, count = self.mdp, allowed.shape[1]
        values, q = np.empty((mdp.n_states, count)), np.empty((mdp.n_pairs, count))
        excess = np.empty(count)
        pairs = mdp.pair_offsets[:-1]
        for column in range(count):
            values[:, column], q[:, column], pairs = self._iterate(allowed[:, column], pairs)
            gain = q[:, column] - values[mdp.pair_state, column]
            excess[column] = np.abs(gain[pairs]).max()
            excess[column] = max(excess[column], gain[allowed[:, column]].max())
        return values, q, excess

    def visits(self, taken: Flags) -> Floats:
        """See `Levels.visits`."""
        mdp = self.mdp
        visits = np.empty((mdp.n_states, taken.shape[1]))
        for column in range(taken.shape[1]):
            chain, _ = policy_chain(mdp, self._first(taken[:, column]))
            system = LinearSystem(chain.T.tocsr(), mdp.discount)
            visits[:, column] = system.approximate(mdp.start_distribution)
        return visits

    def _iterate(self, allowed: Flags, pairs: Integers) -> tuple[Floats, Floats, Integers]:
        mdp = self.mdp
        pairs = np.where(allowed[pairs], pairs, self._first(allowed))
        for _ in range(ITERATIONS):
            chain, reward = policy_chain(mdp, pairs)
            value = LinearSystem(chain, mdp.discount).approximate(reward)
            q = mdp.reward + mdp.discount * (mdp.transition @ value)
            open_q = np.where(allowed, q, -np.inf)
            best = np.maximum.reduceat(open_q, mdp.pair_offsets[:-1])
            noise = 2.0**-44 * (np.abs(mdp.reward).max() + np.abs(value).max())
            better = best > q[pairs] + noise
            if not better.any():
                break
            pairs = np.where(better, self._first(open_q == best[mdp.pair_state]), pairs)
        # Where rounding keeps it from ending, the excess says how far it came.
        return value, q, pairs

    def _first(self, marked: Flags) -> Integers:
        """Return (S,) each state's first marked pair (L,); states never reached may mark more."""
        numbers = np.where(marked, np.arange(self.mdp.n_pairs), self.mdp.n_pairs)
        return np.asarray(np.minimum.reduceat(numbers, self.mdp.pair_offsets[:-1]))


CELLS = 2**21  # pairs times relaxations solved at once


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """The rows of the table of a policy that reads some columns; K of them.

    Attributes
    ----------
    mdp : MDP
    space : StateSpace
        The columns; where these are all, the model's states, each with a row of its own.
    row : (S,) int64
        The row that each state reads.
    asked : (K,) bool
        Whether a state of the row has a choice and can be reached from the start.
    available : (K, A) bool
        Actions that all states of the row with a choice offer.
    """

    mdp: MDP
    space: StateSpace
    row: Integers
    asked: Flags
    available: Flags

    @classmethod
    def of(cls, mdp: MDP, columns: Sequence[str]) -> Rows:
        """Return the rows; raises ModelError where a row has no action in common."""
        space = StateSpace(columns=tuple(mdp.space.column(name) for name in columns))
        row = mdp.space.rows(space.columns)
        if set(space.columns) == set(mdp.space.columns):
            space, row = mdp.space, np.arange(mdp.n_states)
        size, free = space.size, ~mdp.forced
        entry = (row[mdp.pair_state] * mdp.n_actions + mdp.pair_action)[free[mdp.pair_state]]
        offers = np.bincount(entry, minlength=size * mdp.n_actions).reshape(size, -1)
        states = np.bincount(row[free], minlength=size)
        available = (offers == states[:, None]) & (states[:, None] > 0)
        without = (states > 0) & ~available.any(axis=1)
        if without.any():
            raise ModelError(
                "no action is available in all states that the policy cannot tell apart",
                where=space.label(int(np.flatnonzero(without)[0])) or "all states",
                fix="let the policy read more columns",
            )
        asked = np.bincount(row[free & reachable(mdp)], minlength=size) > 0
        return cls(mdp=mdp, space=space, row=row, asked=asked, available=available)

    def policy(self, choice: Integers) -> Policy:
        """Return the policy of one action number (K,) a row, silent where there is no choice."""
        table = np.eye(self.mdp.n_actions)[choice]
        table[~self.available.any(axis=1)] = np.nan
        return Policy(space=self.space, actions=self.mdp.actions, rule=table)

    def choices(self, policy: Policy) -> Integers:
        """Return the likeliest action numbers (K,) of a policy that reads nothing else."""
        taken: Integers = self.available.argmax(axis=1)
        free = np.flatnonzero(~self.mdp.forced)
        taken[self.row[free]] = policy.choices(self.mdp)[free]
        return taken


@dataclass(frozen=True, kw_only=True, eq=False)
class Expansion:
    """What is known of N relaxations, and more of the M that are kept.

    Attributes
    ----------
    upper : (N,)
        Nothing that the relaxation allows has a higher value at the start, rounding included.
    kept : (M,) int64
        Those with an upper bound above the one asked for.
    choice : (M, K) int64
        A policy that it allows: the cheapest action of each row, by the relaxation's own visits.
    value : (M,)
        About the value of that policy at the start.
    loss : (M, K)
        About what each row costs it against the relaxation: visits of the policy times what its
        actions fall short of the best allowed. The sum is the whole difference.
    """

    upper: Floats
    kept: Integers
    choice: Integers
    value: Floats
    loss: Floats


class Relaxations:
    """Solves relaxations of one model, given as allowed actions (N, K, A)."""

    def __init__(self, rows: Rows) -> None:
        mdp = rows.mdp
        self.rows = rows
        self.batch: int = max(1, min(256, CELLS // mdp.n_pairs))
        self._live = ~mdp.terminal[mdp.pair_state]
        self._entries = rows.available.size
        # Pairs of states that have no choice, or are never reached, are always allowed.
        asked = (~mdp.forced & reachable(mdp))[mdp.pair_state] & self._live
        entry = rows.row[mdp.pair_state] * mdp.n_actions + mdp.pair_action
        self._entry = np.where(asked, entry, self._entries)
        chosen = np.flatnonzero(asked)
        self._sums = sp.csr_array(
            (np.ones(len(chosen)), (entry[chosen], chosen)), shape=(self._entries, mdp.n_pairs)
        )
        self._engine = Cycles(mdp) if levels(mdp) is None else Levels(mdp)
        weights = margin_weights(mdp)
        self._reach = float(mdp.start_distribution @ weights.value) * SLACK
        self._margin = float(weights.least[self._live].min(initial=np.inf))
        self._gain = float(np.abs(mdp.table.gains()).max())
        self._terms = int(np.diff(mdp.table.offsets).max())

    def expand(self, allowed: Flags, worth: float = -np.inf) -> Expansion:
        """Return bounds, and for those above `worth` a policy and what each of its rows costs.

        `allowed` (N, K, A) holds N ≤ `batch` relaxations, with an action in each row asked.
        """
        mdp = self.rows.mdp
        open_pairs = self._pairs(allowed)
        value, q, excess = self._engine.solve(open_pairs)
        top, error = self._start(value, excess)
        upper = top + error
        kept = np.flatnonzero(upper > worth)
        if len(kept) < len(upper):
            open_pairs, value, q = open_pairs[:, kept], value[:, kept], q[:, kept]
            allowed, excess, top = allowed[kept], excess[kept], top[kept]
        gap = value[mdp.pair_state] - q
        best = open_pairs & (gap <= excess)
        number = np.where(best, np.arange(mdp.n_pairs)[:, None], mdp.n_pairs)
        first = np.minimum.reduceat(number, mdp.pair_offsets[:-1])
        loss = self._losses(number == first[mdp.pair_state], gap).reshape(allowed.shape)
        # What rounding leaves is not a loss: of equal actions, the lowest number is taken.
        loss[loss <= self._rounding(value)[:, None, None]] = 0.0
        choice = np.where(allowed, loss, np.inf).argmin(axis=2)
        taken = self._pairs(one_hot(choice, mdp.n_actions))
        loss = self._losses(taken, gap * taken).reshape(allowed.shape).sum(axis=2)
        rest = top - loss.sum(axis=1)
        return Expansion(upper=upper, kept=kept, choice=choice, value=rest, loss=loss)

    def evaluate(self, choices: Integers) -> tuple[Floats, Floats]:
        """Return values (N,) of any number of policies (N, K) at the start, and error bounds."""
        found = []
        for first in range(0, len(choices), self.batch):
            some = one_hot(choices[first : first + self.batch], self.rows.mdp.n_actions)
            value, _, excess = self._engine.solve(self._pairs(some))
            found.append(self._start(value, excess))
        values, errors = zip(*found, strict=True)
        return np.concatenate(values), np.concatenate(errors)

    def _start(self, value: Floats, excess: Floats) -> tuple[Floats, Floats]:
        """Return the values (N,) at the start, and how far they may be off."""
        mdp = self.rows.mdp
        off = (excess + self._rounding(value)) / self._margin * self._reach
        summing = gamma(len(mdp.start) + 2) * np.abs(value).max(axis=0)
        return mdp.start_distribution @ value, (off + summing) * SLACK

    def _losses(self, taken: Flags, gap: Floats) -> Floats:
        """Return (N, K·A) the gaps (L, N), weighted by the visits of the pairs taken (L, N)."""
        visits = self._engine.visits(taken)
        return np.asarray((self._sums @ (visits[self.rows.mdp.pair_state] * gap)).T)

    def _pairs(self, allowed: Flags) -> Flags:
        """Return (L, N) the pairs that are allowed."""
        flat = allowed.reshape(len(allowed), self._entries)
        padded = np.concatenate([flat, np.ones((len(flat), 1), dtype=bool)], axis=1)
        return np.asarray(padded.T[self._entry])

    def _rounding(self, value: Floats) -> Floats:
        """Return (N,) how far a computed r + γPV - V may be from the exact one."""
        size = np.abs(value).max(axis=0)
        return np.asarray(gamma(self._terms + 8) * (self._gain + 2 * size))


def one_hot(choices: Integers, actions: int) -> Flags:
    """Return (..., A) True at the action chosen: the relaxation that allows one policy alone."""
    return np.asarray(choices[..., None] == np.arange(actions))
