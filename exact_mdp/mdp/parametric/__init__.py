"""Models with named parameters: families of models, and how rows move with one parameter."""

from __future__ import annotations

from typing import TYPE_CHECKING

from exact_mdp.mdp.lazy import names_later

if TYPE_CHECKING:
    from exact_mdp.mdp.parametric.family import (
        DISCOUNT,
        Family,
        Parametric,
        Posed,
        moving,
        parameter_of,
        parametric,
        placed,
        room_of,
        unposed,
    )
    from exact_mdp.mdp.parametric.parameter import Parameter

__all__ = [
    "DISCOUNT",
    "Family",
    "Parameter",
    "Parametric",
    "Posed",
    "moving",
    "parameter_of",
    "parametric",
    "placed",
    "room_of",
    "unposed",
]

__getattr__, __dir__ = names_later(
    __name__,
    {
        "exact_mdp.mdp.parametric.family": [name for name in __all__ if name != "Parameter"],
        "exact_mdp.mdp.parametric.parameter": ["Parameter"],
    },
)
