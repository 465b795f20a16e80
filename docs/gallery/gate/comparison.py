"""Policies side by side.

Exact values of several policies in one model.
"""

from exact_mdp import Scenario, compare

model = Scenario.load("yuan2025").compile()
policies = {"optimal": "optimal", "directive": "always:directive", "random": "random"}
compare(model, policies).plot()
