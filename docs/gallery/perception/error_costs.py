"""Which errors of perception cost most.

What a robot loses by each kind of error when it takes what it sees for true.
"""

from exact_mdp import Scenario, error_costs, independent

small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
seen = independent([0.9, 0.8, 0.7, 0.95], [0.85, 0.9, 0.75, 0.6])
error_costs(small, "optimal", seen).plot()
