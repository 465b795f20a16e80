"""Moves between statuses under one action.

Every move of 10 % or more; darker and thicker the likelier it is.
"""

import numpy as np

from exact_mdp import Scenario, plots

scenario = Scenario.load("yuan2025")
model = scenario.compile()
law = np.zeros((16, 16))
for now in range(16):
    row = model.pair(model.space.index(status=now), model.action("directive"))
    for chance, state, _ in model.table.row(row):  # the end counts as status 0000
        law[now, max(model.space.values("status")[state], 0)] += chance
plots.plot_status_transitions(law, scenario.statuses)
