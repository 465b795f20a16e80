"""Acceptability of the policy of today.

The share of draws in which it loses no more than so much.
"""

from exact_mdp import Scenario, psa

small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
psa(small, 500, rng=0, effective_sample_size=40).plot()
