"""Where an optimal action changes.

All switching points of one number in its range, each with the state where it happens.
"""

from exact_mdp import Scenario, thresholds

small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
thresholds(small, "assistance.directive.confusion.persistence", (0, 1)).plot()
