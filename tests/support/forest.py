"""The published forest of the MDP toolbox: wait or cut, and fire with a chance of one tenth."""

from __future__ import annotations

from exact_mdp import MDP, Parametric, moving


def forest(discount: str) -> MDP:
    """Return the forest of three ages."""
    wait, cut = [["1/10", "9/10", 0], ["1/10", 0, "9/10"], ["1/10", 0, "9/10"]], [[1, 0, 0]] * 3
    return MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], discount)


def burning(discount: str) -> Parametric:
    """Return the forest with the chance of fire as one number in three rows."""
    mdp = forest(discount)
    return moving(mdp, {"fire": [(mdp.pair(state, 0), 0) for state in range(3)]})
