"""Screening with few draws.

Mean and spread of the elementary effects of Morris.
"""

from exact_mdp import Scenario
from exact_mdp.analysis.sensitivity import morris

small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
names = ["base.anger", "base.confusion", "persistence.anger", "reward.anger"]
morris(small, names=names, n=16, rng=0).plot()
