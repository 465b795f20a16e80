"""Models with named parameters: families of models, and how rows move with one parameter."""

from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric.family import (
    DISCOUNT,
    Family,
    Parametric,
    moved_from,
    moving,
    parameter_of,
    parametric,
    room_of,
)

__all__ = [
    "DISCOUNT",
    "Family",
    "Parameter",
    "Parametric",
    "moved_from",
    "moving",
    "parameter_of",
    "parametric",
    "room_of",
]
