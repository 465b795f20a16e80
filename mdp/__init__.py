"""What a problem is: finite Markov decision processes, exact and explicit.

>>> from mdp import Scenario
>>> Scenario.load("yuan2025").compile()
MDP(yuan2025: 241 states, 4 actions, 961 pairs, 8065 transitions, discount 1)
"""

from mdp.care.scenario import Scenario
from mdp.errors import ModelError, ScenarioWarning
from mdp.model import MDP
from mdp.parametric import Parameter
from mdp.policies.policy import Policy
from mdp.space import Column, StateSpace

__all__ = [
    "MDP",
    "Column",
    "ModelError",
    "Parameter",
    "Policy",
    "Scenario",
    "ScenarioWarning",
    "StateSpace",
]
