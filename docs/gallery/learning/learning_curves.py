"""Learning curves.

The exact value of the greedy policy of each epoch, over the averages of its episodes.
"""

from exact_mdp import QLearning, Scenario, learning_curve, plots, solve

model = Scenario.load("yuan2025").compile()
run = QLearning(epochs=200).train(model, 0)
curve = learning_curve(model, run, rng=1)
plots.plot_learning_curves({"constant ε": curve}, optimum=solve(model).start.value)
