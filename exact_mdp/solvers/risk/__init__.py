"""Policies that look at the risk of the return, not at its mean alone.

>>> from exact_mdp import MDP
>>> from exact_mdp.solvers.risk import best_cvar
>>> rows = [(0, 0, [("1/2", 1, 10), ("1/2", 1, 0)]), (0, 1, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
>>> best_cvar(MDP.from_outcomes(rows), "1/2").value
Fraction(4, 1)
"""

from exact_mdp.solvers.risk.tail import CVaROptimum, best_cvar

__all__ = ["CVaROptimum", "best_cvar"]
