"""Which numbers decide: derivatives, one-way and two-way analyses, exact thresholds.

>>> from mdp import Scenario
>>> from analysis.sensitivity import gradient
>>> found = gradient(Scenario.load("yuan2025"), names=["reward.task-complete"])
>>> print(found["reward.task-complete"].value)
1 (certified)
"""

from analysis.sensitivity.gradient import Derivative, Gradient, gradient
from analysis.sensitivity.moments import Movement, moments_gradient, movement_frame

__all__ = [
    "Derivative",
    "Gradient",
    "Movement",
    "gradient",
    "moments_gradient",
    "movement_frame",
]
