"""Many policies, or many sets of actions, of one model without cycles: two passes for all of them.

    V(s) = max_a Q(s, a)  or  Σ_a π(a | s) Q(s, a),    Q(s, a) = r(s, a) + γ Σ_s' P(s' | s, a) V(s')

from the last states to the first, and the visits forward from the start.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.graph import reachable
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, spans
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.bounds.bounds import levels


class Layers:
    """Passes over the states of a model without cycles that are reached, for N columns at once.

    A transition leads from a layer to earlier ones, or the end. Numbers are 0 where none comes.
    """

    def __init__(self, mdp: MDP) -> None:
        level = levels(mdp)
        assert level is not None
        self.mdp = mdp
        used = np.flatnonzero(reachable(mdp) & ~mdp.terminal)
        used = used[np.argsort(level[used], kind="stable")]
        self.blocks = []
        for states in np.split(used, np.flatnonzero(np.diff(level[used])) + 1) if len(used) else ():
            first, last = mdp.pair_offsets[states], mdp.pair_offsets[states + 1]
            pairs, offsets = spans(first, last), np.cumsum(last - first) - (last - first)
            matrix = mdp.transition[pairs]
            targets, columns = np.unique(matrix.indices, return_inverse=True)
            shape = (len(pairs), len(targets))
            back = sp.csr_array((matrix.data, columns, matrix.indptr), shape).T.tocsr()
            self.blocks.append((states, pairs, offsets, matrix, targets, back))

    def best(self, allowed: Flags) -> tuple[Floats, Floats]:
        """Return the optimal values (S, N) and action values (L, N) of the pairs allowed (L, N)."""
        return self._backward(np.where(allowed, 0.0, -np.inf), np.maximum, np.add)

    def mean(self, weights: Floats) -> tuple[Floats, Floats]:
        """Return the same of policies that take pairs with these weights (L, N)."""
        return self._backward(weights, np.add, np.multiply)

    def _backward(self, by: Floats, over: np.ufunc, using: np.ufunc) -> tuple[Floats, Floats]:
        mdp = self.mdp
        value, q = np.zeros((mdp.n_states, by.shape[1])), np.zeros(by.shape)
        for states, pairs, offsets, matrix, _, _ in self.blocks:
            q[pairs] = mdp.reward[pairs, None] + mdp.discount * (matrix @ value)
            value[states] = over.reduceat(using(q[pairs], by[pairs]), offsets)
        return value, q

    def visits(self, weights: Floats | Flags) -> Floats:
        """Return (S, N) discounted visits from the start where pairs have these weights (L, N)."""
        mdp = self.mdp
        visits = np.repeat(mdp.start_distribution[:, None], weights.shape[1], axis=1)
        for _, pairs, _, _, targets, back in reversed(self.blocks):
            flow = visits[mdp.pair_state[pairs]] * weights[pairs]
            visits[targets] += mdp.discount * (back @ flow)
        return visits
