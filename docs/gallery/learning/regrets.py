"""The regret of what was learned.

The exact regret of the final policies of twelve runs.
"""

from exact_mdp import Scenario
from exact_mdp.analysis.learning.outcomes import outcomes
from exact_mdp.solvers.learning.q_learning import QLearning
from exact_mdp.solvers.learning.training import train

model = Scenario.load("yuan2025").compile()
outcomes(model, train(model, QLearning(epochs=100), 12, rng=0)).plot()
