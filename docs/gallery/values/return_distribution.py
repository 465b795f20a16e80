"""The exact distribution of the return.

Every return that an episode may have, with its probability: nothing is sampled.
"""

from exact_mdp import Scenario, return_distribution

model = Scenario.load("yuan2025").compile()
return_distribution(model, "optimal").plot()
