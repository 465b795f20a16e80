"""How many different policies come out.

Runs by the policy that they end with; of the same policy, one column.
"""

from exact_mdp import Scenario
from exact_mdp.analysis.learning.outcomes import outcomes
from exact_mdp.analysis.plots import plot_distinct
from exact_mdp.solvers.learning.q_learning import QLearning
from exact_mdp.solvers.learning.training import train

small = Scenario.load("tea").compile()
found = outcomes(small, train(small, QLearning(epochs=100), 12, rng=0))
plot_distinct({"Q-learning": found})
