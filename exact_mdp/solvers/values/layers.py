"""Evaluate many policies of an acyclic model at once, or many sets of actions.

    V(s) = max_a Q(s, a)  or  Σ_a π(a | s) Q(s, a),    Q(s, a) = r(s, a) + γ Σ_s' P(s' | s, a) V(s')

from the last states to the first, and visits in a pass forward from the start.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.graph import find_reachable_states
from exact_mdp.mdp.model import MDP, cache_on_model
from exact_mdp.mdp.table import Floats, Integers, Numbers, concatenate_ranges
from exact_mdp.mdp.validate import Flags


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
    alone = mdp.forced[:, None] | (chosen == -1)
    return np.where(alone, mdp.pair_offsets[:-1][:, None], chosen)
