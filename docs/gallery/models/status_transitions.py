"""Moves between statuses under one action.

Every move of 10 % or more; darker and thicker the likelier it is.
"""

from exact_mdp import Scenario
from exact_mdp.analysis.plots import plot_status_transitions
from exact_mdp.paper_repro.report.figures import status_law

scenario = Scenario.load("yuan2025")
model = scenario.compile()
law = status_law(model, model.actions.index("directive"))
plot_status_transitions(law, scenario.statuses)
