"""Policy iteration for averages: it ends at the best policy, wherever it begins."""

from itertools import product

import numpy as np

from exact_mdp import MDP
from exact_mdp.solvers.endless.average_iteration import AveragePolicyIteration


def test_improvement_begins_anywhere_and_ends_at_the_best() -> None:
    rng = np.random.default_rng(2)
    rows = rng.dirichlet(np.ones(4), (2, 4))
    rows[:, :2, 2:] = 0  # {0, 1} is never left
    rows /= rows.sum(axis=2, keepdims=True)
    mdp = MDP.from_arrays(rows, rng.normal(size=(4, 2)), 1)
    best = AveragePolicyIteration().run(mdp)[0].tolist()
    for pairs in product(*(mdp.pairs_of(s) for s in range(4))):
        assert AveragePolicyIteration().run(mdp, np.array(pairs))[0].tolist() == best
