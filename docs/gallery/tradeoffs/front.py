"""An exact Pareto front.

Two expected totals, every vertex a policy; between two vertices, mixtures of their policies.
"""

from exact_mdp import Scenario, tradeoff

model = Scenario.load("yuan2025").compile()
front = tradeoff(model, ["anger", "subtask-complete"])
front.plot(policies={"optimal": "optimal", "random": "random"})
