"""Learning curves.

The exact value of the greedy policy of each epoch, over the averages of its episodes.
"""

from exact_mdp import Scenario, solve
from exact_mdp.analysis.learning.curves import learning_curve
from exact_mdp.analysis.plots import plot_learning_curves
from exact_mdp.solvers.learning.q_learning import QLearning

model = Scenario.load("yuan2025").compile()
run = QLearning(epochs=200).train(model, 0)
curve = learning_curve(model, run, rng=1)
plot_learning_curves({"constant ε": curve}, optimum=solve(model).start.value)
