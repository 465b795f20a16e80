"""Optimal values and visits for many sets of allowed pairs of one model.

Models without cycles are solved backward, level by level, for all sets at once; others by policy
iteration, one set after the other, begun with the policy of the one before. Neither claims anything
of its error: `analysis.relaxation` bounds it.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from mdp.chain import reachable, spans
from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers.bounds import levels
from solvers.linear import LinearSystem, policy_chain

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
        for states in np.split(used, cuts[1:]):
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
