"""Exact values of learned policies, many at once.

In an acyclic model all are evaluated in one pass (`values.layers`), whose error bound counts every
rounding: a state's value is a sum of n products, so with d the length of the longest path and W the
same recursion over absolute values, it is at most γ(d (n + 6)) W (Higham, Accuracy and Stability of
Numerical Algorithms, 2002, section 3.1).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from exact_mdp.mdp.errors import ModelError, require_list
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import BLOCK, Numbers
from exact_mdp.solvers.bounds.gains import SLACK, TINY, BoundedVector, gamma
from exact_mdp.solvers.learning.q_learning import TrainingRun
from exact_mdp.solvers.learning.sampler import QTableRows, build_q_table_rows
from exact_mdp.solvers.solution import at_start
from exact_mdp.solvers.values.layers import find_taken_pairs, layers_of
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.policy_values import find_policy_values


def common_rows(model: MDP, runs: Sequence[TrainingRun]) -> QTableRows:
    """Return the rows that the runs read; raises ModelError for runs on another model."""
    if not require_list(runs, "runs") or not all(isinstance(run, TrainingRun) for run in runs):
        fix = "give what train(model, QLearning(), …) returns"
        raise ModelError("no run of training", where="learning", fix=fix)
    rows = build_q_table_rows(model, runs[0].space.names)
    if any(run.space != rows.space or run.q.shape != rows.offered.shape for run in runs):
        raise ModelError(
            "the runs read other states than this model has",
            where="learning",
            fix="use the model that they were trained on, at any discount",
        )
    return rows


def evaluate_row_policies(mdp: MDP, rows: QTableRows, policies: Numbers) -> BoundedVector:
    """Return the start values (U,) for policies (U, K), with one action number for each Q-row."""
    if mdp.ends.most_steps is None:
        starts = []
        for rule in policies:
            policy = Policy(space=rows.space, actions=mdp.actions, rule=rule)
            chain = PolicyChain.of_policy(mdp, policy)
            starts.append(at_start(mdp, find_policy_values(chain)))
        return BoundedVector(
            value=np.array([each.value for each in starts]),
            error=np.array([each.error for each in starts]),
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
