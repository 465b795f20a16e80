"""Two-way sensitivity analysis.

Which policy is optimal where two numbers vary together, on a grid of both.
"""

from exact_mdp import Scenario, two_way

small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
ranges = {"base.anger": ("1/100", "1/4"), "base.disengagement": ("1/100", "2/5")}
two_way(small, *ranges, ranges=ranges).plot()
