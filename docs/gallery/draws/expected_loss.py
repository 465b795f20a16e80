"""What more observations are worth.

The expected loss of policies chosen today, by the number of observations behind the tables.
"""

from exact_mdp import Scenario
from exact_mdp.analysis.sensitivity import expected_loss

small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
policies = {"optimal today": "optimal", "directive": "always:directive"}
expected_loss(small, policies, [10, 30, 100, 300], rng=0, n=200).plot()
