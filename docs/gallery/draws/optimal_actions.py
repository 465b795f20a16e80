"""How sure the optimal action is.

The share of draws in which each action is optimal, status by status.
"""

from exact_mdp import Scenario, plots, psa

small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
plots.plot_optimal_actions(psa(small, 500, rng=0, effective_sample_size=40))
