"""Many runs in one band.

Mean and quantiles over runs, here of the exact values of four runs' policies, epoch by epoch.
"""

import numpy as np

from exact_mdp import Scenario
from exact_mdp.analysis.learning.curves import learning_curve
from exact_mdp.analysis.plots import plot_value_bands
from exact_mdp.solvers.learning.q_learning import QLearning
from exact_mdp.solvers.learning.training import train

model = Scenario.load("yuan2025").compile()
runs = train(model, QLearning(epochs=60), 4, rng=0)
plot_value_bands({"Q-learning": np.array([learning_curve(model, r, rng=1).value for r in runs])})
