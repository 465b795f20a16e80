"""Influence between statuses.

How much a status that is present raises the chance of the others, without assistance.
"""

from exact_mdp import Scenario, plots

plots.plot_influence(Scenario.load("yuan2025"))
