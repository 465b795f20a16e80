"""Derivatives of the optimal value.

Elasticities by every named number; exact, by the implicit function of the optimum.
"""

from exact_mdp import Scenario, gradient

gradient(Scenario.load("yuan2025"), exact=False).plot()
