"""What memory would save.

Bounds from both sides on the value with memory, beside the best fixed response.
"""

from exact_mdp import Scenario
from exact_mdp.analysis.perception.accuracy import prices
from exact_mdp.analysis.plots import plot_prices

small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
levels = [1.0, 0.9, 0.8]
plot_prices(levels, prices(small, levels, tol=0.5, node_limit=200))
