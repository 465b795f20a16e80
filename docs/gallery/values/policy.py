"""The actions of a policy.

The optimal action of every status and subtask, in the first trial.
"""

from exact_mdp import Scenario, plots

tea = Scenario.load("tea").compile()
plots.plot_policy(tea, "optimal", trial=0)
