"""Problems: finite Markov decision processes, exact and explicit.

>>> from exact_mdp import Scenario
>>> Scenario.load("yuan2025").compile()
MDP(yuan2025: 241 states, 4 actions, 961 pairs, 8065 transitions, discount 1)
"""

from exact_mdp import names_of

__all__, __getattr__ = names_of(__name__)


def __dir__() -> list[str]:
    return list(__all__)
