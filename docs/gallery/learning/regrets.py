"""The regret of what was learned.

The exact regret of the final policies of twelve runs.
"""

from exact_mdp import QLearning, Scenario, outcomes, train

model = Scenario.load("yuan2025").compile()
outcomes(model, train(model, QLearning(epochs=100), 12, rng=0)).plot()
