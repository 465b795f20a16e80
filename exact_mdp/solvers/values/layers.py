"""Many policies, or many sets of actions, of one model without cycles: two passes for all of them.

    V(s) = max_a Q(s, a)  or  Σ_a π(a | s) Q(s, a),    Q(s, a) = r(s, a) + γ Σ_s' P(s' | s, a) V(s')

from the last states to the first, and the visits forward from the start. The error bound of
`policy_values` counts every rounding: a state's value is a sum of n products, so with d the length
of the longest path and W the same recursion over absolute values, it is at most γ(d (n + 6)) W
(Higham, Accuracy and Stability of Numerical Algorithms, 2002, section 3.1).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.graph import reachable, topological_levels
from exact_mdp.mdp.model import MDP, once
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import Floats, Numbers, spans
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.bounds.gains import SLACK, TINY, gamma
from exact_mdp.solvers.bounds.linear import FixedPoint
from exact_mdp.solvers.learning.sampler import Rows
from exact_mdp.solvers.values.evaluate import evaluate

NUMBERS = 2**22  # of a table over pairs and policies


class Layers:
    """Passes over the states that are reached, for N columns at once; 0 where none comes."""

    def __init__(self, mdp: MDP) -> None:
        level = topological_levels(mdp)
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

    def mean(self, weights: Floats, reward: Floats | None = None) -> tuple[Floats, Floats]:
        """Return the same of policies that take pairs with these weights (L, N)."""
        return self._backward(weights, np.add, np.multiply, reward)

    def _backward(
        self, by: Floats, over: np.ufunc, using: np.ufunc, reward: Floats | None = None
    ) -> tuple[Floats, Floats]:
        mdp, reward = self.mdp, self.mdp.reward if reward is None else reward
        value, q = np.zeros((mdp.n_states, by.shape[1])), np.zeros(by.shape)
        for states, pairs, offsets, matrix, _, _ in self.blocks:
            q[pairs] = reward[pairs, None] + mdp.discount * (matrix @ value)
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


@once
def layers_of(mdp: MDP) -> Layers:
    """Return the passes over a model, made once for each."""
    return Layers(mdp)


def policy_values(mdp: MDP, rows: Rows, policies: Numbers) -> FixedPoint:
    """Return the start values (U,) of policies (U, K), an action number for each of K rows."""
    if topological_levels(mdp) is None:
        each = (Policy(space=rows.space, actions=mdp.actions, rule=rule) for rule in policies)
        evaluations = [evaluate(mdp, policy) for policy in each]
        return FixedPoint(
            value=np.array([each.mean for each in evaluations]),
            error=np.array([each.start.error for each in evaluations]),
        )
    pair = np.full((mdp.n_states, mdp.n_actions), -1, dtype=np.int64)
    pair[mdp.pair_state, mdp.pair_action] = np.arange(mdp.n_pairs)
    pair[mdp.forced] = mdp.pair_offsets[:-1][mdp.forced][:, None]
    asked = np.flatnonzero(reachable(mdp) & ~mdp.terminal)
    layers, start = layers_of(mdp), mdp.start_distribution
    value, size = np.empty((2, len(policies)))
    for first in range(0, len(policies), part := max(1, NUMBERS // mdp.n_pairs)):
        here = slice(first, first + part)
        taken = pair[asked[:, None], policies[here, rows.key[asked]].T]
        weights = np.zeros((mdp.n_pairs, taken.shape[1]))
        np.put_along_axis(weights, taken, 1.0, axis=0)
        value[here] = start @ layers.mean(weights)[0]
        size[here] = start @ layers.mean(weights, np.abs(mdp.reward))[0]
    longest = int(np.diff(mdp.transition.indptr).max())
    terms = len(layers.blocks) * (longest + 6) + mdp.n_states + 4
    return FixedPoint(value=value, error=(gamma(terms) * size + TINY * terms) * SLACK)
