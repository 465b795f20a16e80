"""Evaluate many policies of an acyclic model at once, or many sets of actions.

    V(s) = max_a Q(s, a)  or  Σ_a π(a | s) Q(s, a),    Q(s, a) = r(s, a) + γ Σ_s' P(s' | s, a) V(s')

from the last states to the first, and visits in a pass forward from the start. The error bound of
`evaluate_row_policies` counts every rounding: a state's value is a sum of n products, so with d the
length of the longest path and W the same recursion over absolute values, it is at most γ(d (n + 6))
W (Higham, Accuracy and Stability of Numerical Algorithms, 2002, section 3.1).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.graph import find_reachable_states
from exact_mdp.mdp.model import MDP, cache_on_model
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import BLOCK, Floats, Integers, Numbers, concatenate_ranges
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.bounds.gains import SLACK, TINY, BoundedVector, gamma
from exact_mdp.solvers.learning.sampler import QTableRows
from exact_mdp.solvers.values.evaluate import evaluate


class Layers:
    """Passes over all reachable states, for N columns at once; entries of other states are 0."""

    def __init__(self, mdp: MDP) -> None:
        level = mdp.ends.most_steps
        assert level is not None
        self.mdp = mdp
        used = np.flatnonzero(find_reachable_states(mdp) & ~mdp.terminal)
        used = used[np.argsort(level[used], kind="stable")]
        # States of one topological level do not depend on each other: one block for each level.
        layers: list[Integers] = []
        if len(used):
            layers = np.split(used, np.flatnonzero(np.diff(level[used])) + 1)
        self.blocks = []
        for states in layers:
            first, last = mdp.pair_offsets[states], mdp.pair_offsets[states + 1]
            pairs = concatenate_ranges(first, last)
            offsets = np.cumsum(last - first) - (last - first)
            matrix = mdp.transition[pairs]
            # The transposed rows, with columns for the states that follow, carry visits forward.
            targets, columns = np.unique(matrix.indices, return_inverse=True)
            shape = (len(pairs), len(targets))
            back = sp.csr_array((matrix.data, columns, matrix.indptr), shape).T.tocsr()
            self.blocks.append((states, pairs, offsets, matrix, targets, back))

    def solve_allowed(self, allowed: Flags) -> tuple[Floats, Floats, Floats]:
        """Return V (S, N) and Q (L, N) over the pairs allowed (L, N), and the error of V (N,)."""
        # A pair that is not allowed loses every comparison.
        mdp, worst = self.mdp, np.where(allowed, 0.0, -np.inf)
        value, q = np.zeros((mdp.n_states, allowed.shape[1])), np.zeros(allowed.shape)
        for states, pairs, offsets, matrix, _, _ in self.blocks:
            q[pairs] = mdp.reward[pairs, None] + mdp.discount * (matrix @ value)
            value[states] = np.maximum.reduceat(q[pairs] + worst[pairs], offsets)
        return value, q, np.zeros(allowed.shape[1])

    def evaluate_pairs(
        self, taken: Integers, reward: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Return V (S, N) for policies that take these pairs (S, N), and its error (N,)."""
        mdp = self.mdp
        if reward is None:
            reward = mdp.reward
        value, used = np.zeros(taken.shape), np.zeros(mdp.n_pairs, dtype=bool)
        used[taken] = True
        for states, pairs, _, _, _, _ in self.blocks:
            # If policies differ in few states, few pairs are used by any of them.
            here = pairs[used[pairs]]
            q = reward[here, None] + mdp.discount * (mdp.transition[here] @ value)
            value[states] = np.take_along_axis(q, np.searchsorted(here, taken[states]), axis=0)
        return value, np.zeros(taken.shape[1])

    def compute_visits(self, weights: Floats | Flags) -> Floats:
        """Return (S, N) discounted visits from the start, for weights (L, N) of the pairs."""
        mdp = self.mdp
        # All visits of a block are known when its turn comes, as every transition leads onward.
        visits = np.repeat(mdp.start_distribution[:, None], weights.shape[1], axis=1)
        for _, pairs, _, _, targets, back in reversed(self.blocks):
            flow = visits[mdp.pair_state[pairs]] * weights[pairs]
            visits[targets] += mdp.discount * (back @ flow)
        return visits


layers_of = cache_on_model(Layers)


def find_taken_pairs(mdp: MDP, key: Integers, policies: Numbers) -> Integers:
    """Return the pairs (S, N) that policies (N, K) take; state s reads entry key[s] of each."""
    pair = mdp.by_action(np.arange(mdp.n_pairs), -1).astype(np.int64)
    chosen = pair[np.arange(mdp.n_states)[:, None], policies[:, key].T]
    # In a state with a single action the policy has no effect.
    alone = mdp.forced[:, None] | (chosen < 0)
    return np.where(alone, mdp.pair_offsets[:-1][:, None], chosen)


def evaluate_row_policies(mdp: MDP, rows: QTableRows, policies: Numbers) -> BoundedVector:
    """Return the start values (U,) for policies (U, K), with one action number for each Q-row."""
    if mdp.ends.most_steps is None:
        evaluations = []
        for rule in policies:
            policy = Policy(space=rows.space, actions=mdp.actions, rule=rule)
            evaluations.append(evaluate(mdp, policy))
        return BoundedVector(
            value=np.array([each.mean for each in evaluations]),
            error=np.array([each.start.error for each in evaluations]),
        )
    layers, start = layers_of(mdp), mdp.start_distribution
    # In parts of limited memory: values V, and W for the error bound.
    value, size = np.empty((2, len(policies)))
    part = max(1, BLOCK // mdp.n_states)
    for first in range(0, len(policies), part):
        here = slice(first, first + part)
        pairs = find_taken_pairs(mdp, rows.key, policies[here])
        value[here] = start @ layers.evaluate_pairs(pairs)[0]
        size[here] = start @ layers.evaluate_pairs(pairs, np.abs(mdp.reward))[0]
    # The bound γ(d (n + 6)) W, and the sum over the start on top.
    longest = int(np.diff(mdp.transition.indptr).max())
    terms = len(layers.blocks) * (longest + 6) + mdp.n_states + 4
    return BoundedVector(value=value, error=(gamma(terms) * size + TINY * terms) * SLACK)
