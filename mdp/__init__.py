"""What a problem is: finite Markov decision processes, exact and explicit.

>>> from exact_mdp import Scenario
>>> Scenario.load("yuan2025").compile()
MDP(yuan2025: 241 states, 4 actions, 961 pairs, 8065 transitions, discount 1)
"""

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, ScenarioWarning
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.policies.policy import Policy, PolicyLike
from exact_mdp.mdp.space import Column, StateSpace

__all__ = [
    "MDP",
    "Column",
    "ModelError",
    "Parameter",
    "Policy",
    "PolicyLike",
    "Scenario",
    "ScenarioWarning",
    "StateSpace",
]

if __name__ == "mdp":
    from exact_mdp._checkout import alias

    alias(__name__)
