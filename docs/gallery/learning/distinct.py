"""How many different policies come out.

Runs by the policy that they end with; of the same policy, one column.
"""

from exact_mdp import QLearning, Scenario, outcomes, plots, train

small = Scenario.load("tea").compile()
found = outcomes(small, train(small, QLearning(epochs=100), 12, rng=0))
plots.plot_distinct({"Q-learning": found})
