"""Worst and best case by the size of the error.

The values that are left where each probability may be wrong by so much.
"""

from exact_mdp import Scenario, robust_curve

small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
robust_curve(small, "l1", ["0", "1/20", "1/10", "1/5"]).plot()
