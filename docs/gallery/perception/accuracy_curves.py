"""Value by accuracy.

What is left of the value as the perception of each status worsens, and of all alike.
"""

from exact_mdp import Scenario, accuracy_curves

small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
accuracy_curves(small, levels=[1.0, 0.9, 0.8, 0.7]).plot()
