"""The actions of a policy.

The optimal action of every status and subtask, in the first trial.
"""

from exact_mdp import Scenario
from exact_mdp.analysis.plots import plot_policy

tea = Scenario.load("tea").compile()
plot_policy(tea, "optimal", trial=0)
