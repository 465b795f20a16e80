"""How the best response hedges.

The action of the best fixed response to each perceived status, as perception worsens.
"""

from exact_mdp import Scenario
from exact_mdp.analysis.perception.accuracy import hedging

small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
hedging(small, levels=[1.0, 0.9, 0.8]).plot()
