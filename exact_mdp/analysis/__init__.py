"""What a solved model means: comparisons, returns, sensitivity, and the command line.

>>> from exact_mdp import check
>>> from exact_mdp import MDP
>>> check(MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]]), [1, 0]).passed
True
"""

from exact_mdp import names_of

__all__, __getattr__ = names_of(__name__)


def __dir__() -> list[str]:
    return list(__all__)
