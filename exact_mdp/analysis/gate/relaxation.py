"""Policies bound to read some columns only: many of them, or many relaxations, solved at once.

All states in which the columns read have the same values form a *row*, in which such a policy takes
one action. A relaxation allows a set of actions in each row and lets every state choose among them
knowing the full state: its optimal value bounds every policy that takes allowed actions, mixed ones
too, and with one action in each row it is the value of that policy.

Models without cycles are solved backward, level by level, for all relaxations at once; others by
policy iteration, one after the other. The upper bound is V + c w with the weights w and margins m
of `solvers.bounds.bounds`, where r + γ P V - V ≤ c m for every allowed pair, rounding included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import reachable
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.bounds.bounds import levels, margin_weights
from exact_mdp.solvers.bounds.gains import SLACK, gamma
from exact_mdp.solvers.bounds.linear import LinearSystem, policy_chain
from exact_mdp.solvers.exact.find import first_of
from exact_mdp.solvers.values.layers import Layers

ITERATIONS = 1000
CELLS = 2**21  # pairs times relaxations solved at once
Solved = tuple[Floats, Floats, Floats]
"""Values (S, N), action values (L, N) and the greatest r + γPV - V of a pair allowed (N,)."""


def in_cycles(mdp: MDP, allowed: Flags) -> Solved:
    """Solve relaxations of any model by policy iteration, each begun with the one before."""
    pairs = first = mdp.pair_offsets[:-1]
    values, actions = np.empty((mdp.n_states, allowed.shape[1])), np.empty(allowed.shape)
    excess = np.empty(allowed.shape[1])
    for column, mask in enumerate(allowed.T):
        pairs = np.where(mask[pairs], pairs, first_of(mdp, mask))
        for _ in range(ITERATIONS):
            chain, reward = policy_chain(mdp, pairs)
            value = LinearSystem(chain, mdp.discount).approximate(reward)
            q = mdp.reward + mdp.discount * (mdp.transition @ value)
            open_q = np.where(mask, q, -np.inf)
            best = np.maximum.reduceat(open_q, first)
            better = best > q[pairs] + 2.0**-44 * (np.abs(mdp.reward).max() + np.abs(value).max())
            if not better.any():
                break
            pairs = np.where(better, first_of(mdp, open_q == best[mdp.pair_state]), pairs)
        # Where rounding keeps it from ending, the excess says how far it came.
        gain = q - value[mdp.pair_state]
        values[:, column], actions[:, column] = value, q
        excess[column] = max(np.abs(gain[pairs]).max(), gain[mask].max())
    return values, actions, excess


def visits_in_cycles(mdp: MDP, taken: Flags) -> Floats:
    """Return (S, N) discounted visits from the start where the pairs (L, N) are taken."""
    found = np.empty((mdp.n_states, taken.shape[1]))
    for column, mask in enumerate(taken.T):
        chain, _ = policy_chain(mdp, first_of(mdp, mask))
        system = LinearSystem(chain.T.tocsr(), mdp.discount)
        found[:, column] = system.approximate(mdp.start_distribution)
    return found


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


class Expansion(NamedTuple):
    """What is known of N relaxations, and more of the M whose bound is above the one asked for."""

    upper: Floats  # (N,) nothing allowed has a higher value at the start, rounding included
    kept: Integers  # (M,)
    choice: Integers  # (M, K) the cheapest action of each row, by the relaxation's own visits
    value: Floats  # (M,) about the value of that policy at the start
    loss: Floats  # (M, K) about what each row costs it; the sum is the whole difference


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
        self._layers = None if levels(mdp) is None else Layers(mdp)
        weights = margin_weights(mdp)
        self._reach = float(mdp.start_distribution @ weights.value) * SLACK
        self._margin = weights.smallest
        self._gain = float(np.abs(mdp.table.gains()).max())
        self._terms = int(np.diff(mdp.table.offsets).max())

    def expand(self, allowed: Flags, worth: float = -np.inf) -> Expansion:
        """Return bounds, and for those above `worth` a policy and what each of its rows costs.

        `allowed` (N, K, A) holds N ≤ `batch` relaxations, with an action in each row asked.
        """
        mdp = self.rows.mdp
        open_pairs = self._pairs(allowed)
        value, q, excess = self._solve(open_pairs)
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
            value, _, excess = self._solve(self._pairs(some))
            found.append(self._start(value, excess))
        values, errors = zip(*found, strict=True)
        return np.concatenate(values), np.concatenate(errors)

    def _solve(self, allowed: Flags) -> Solved:
        """Return what allowed pairs (L, N) are worth."""
        if self._layers is None:
            return in_cycles(self.rows.mdp, allowed)
        return (*self._layers.best(allowed), np.zeros(allowed.shape[1]))

    def _start(self, value: Floats, excess: Floats) -> tuple[Floats, Floats]:
        """Return the values (N,) at the start, and how far they may be off."""
        mdp = self.rows.mdp
        off = (excess + self._rounding(value)) / self._margin * self._reach
        summing = gamma(len(mdp.start) + 2) * np.abs(value).max(axis=0)
        return mdp.start_distribution @ value, (off + summing) * SLACK

    def _losses(self, taken: Flags, gap: Floats) -> Floats:
        """Return (N, K·A) the gaps (L, N), weighted by the visits of the pairs taken (L, N)."""
        mdp, layers = self.rows.mdp, self._layers
        visits = visits_in_cycles(mdp, taken) if layers is None else layers.visits(taken)
        return np.asarray((self._sums @ (visits[mdp.pair_state] * gap)).T)

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
