"""A trainer judged by many seeds.

The interval of the share of seeds that keep the limit, run after run, until it decides.
"""

from exact_mdp import QLearning, Scenario, check_trainer

model = Scenario.load("yuan2025").compile()
learner = QLearning(epochs=60)
check_trainer(model, lambda seed: learner.train(model, seed).q, runs=20, max_regret=2, rng=0).plot()
