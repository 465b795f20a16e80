"""How sure the optimal action is.

The share of draws in which each action is optimal, status by status.
"""

from exact_mdp import Scenario
from exact_mdp.analysis.plots.psa import plot_optimal_actions
from exact_mdp.analysis.sensitivity import psa

small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
plot_optimal_actions(psa(small, 500, rng=0, effective_sample_size=40))
