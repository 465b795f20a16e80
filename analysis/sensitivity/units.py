"""The unit of a parameter, for tables and axes."""

from __future__ import annotations

from mdp.parameters import Parameter
from mdp.parametric import DISCOUNT


def unit_of(parameter: Parameter) -> str:
    """Return what a parameter is measured in.

    Examples
    --------
    >>> from fractions import Fraction
    >>> unit_of(Parameter(name="reward.anger", value=Fraction(-5)))
    'reward'
    """
    if parameter.name == DISCOUNT:
        return "per step"
    return "probability" if (parameter.low, parameter.high) == (0, 1) else "reward"
