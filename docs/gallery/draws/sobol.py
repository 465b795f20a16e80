"""Shares of the variance.

First-order and total indices of Sobol, with their intervals.
"""

from exact_mdp import Scenario, sobol

small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
names = ["base.anger", "base.confusion", "persistence.anger", "reward.anger"]
sobol(small, names=names, n=64, rng=0).plot()
