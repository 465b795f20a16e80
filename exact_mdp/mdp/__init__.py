"""What a problem is: finite Markov decision processes, exact and explicit.

>>> from exact_mdp import Scenario
>>> Scenario.load("yuan2025").compile()
MDP(yuan2025: 241 states, 4 actions, 961 pairs, 8065 transitions, discount 1)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from exact_mdp.mdp.lazy import names_later

if TYPE_CHECKING:
    from exact_mdp.mdp.care.scenario import Scenario
    from exact_mdp.mdp.errors import (
        DistributionError,
        ModelError,
        NegativeError,
        ScenarioWarning,
        ShapeError,
    )
    from exact_mdp.mdp.model import MDP
    from exact_mdp.mdp.parametric.family import Family, moving
    from exact_mdp.mdp.parametric.parameter import Parameter
    from exact_mdp.mdp.policies.policy import Policy, PolicyLike
    from exact_mdp.mdp.space import Column, StateSpace

__all__ = [
    "MDP",
    "Column",
    "DistributionError",
    "Family",
    "ModelError",
    "NegativeError",
    "Parameter",
    "Policy",
    "PolicyLike",
    "Scenario",
    "ScenarioWarning",
    "ShapeError",
    "StateSpace",
    "moving",
]

__getattr__, __dir__ = names_later(
    __name__,
    {
        "exact_mdp.mdp.care.scenario": ["Scenario"],
        "exact_mdp.mdp.errors": [
            "DistributionError",
            "ModelError",
            "NegativeError",
            "ScenarioWarning",
            "ShapeError",
        ],
        "exact_mdp.mdp.model": ["MDP"],
        "exact_mdp.mdp.parametric.parameter": ["Parameter"],
        "exact_mdp.mdp.parametric.family": ["Family", "moving"],
        "exact_mdp.mdp.policies.policy": ["Policy", "PolicyLike"],
        "exact_mdp.mdp.space": ["Column", "StateSpace"],
    },
)
