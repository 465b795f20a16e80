"""Many runs in one band.

Mean and quantiles over runs, here of the exact values of four runs' policies, epoch by epoch.
"""

import numpy as np

from exact_mdp import QLearning, Scenario, learning_curve, plots, train

model = Scenario.load("yuan2025").compile()
runs = train(model, QLearning(epochs=60), 4, rng=0)
plots.plot_value_bands(
    {"Q-learning": np.array([learning_curve(model, r, rng=1).value for r in runs])}
)
