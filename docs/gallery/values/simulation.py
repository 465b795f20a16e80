"""A simulation.

An independent estimate, with its standard error.
"""

from exact_mdp import Scenario, simulate

model = Scenario.load("yuan2025").compile()
simulate(model, "random", n=2000, rng=0).plot()
