"""One-way sensitivity analysis.

The optimal value, and the value of a policy held fixed, as one number varies.
"""

from exact_mdp import Scenario, one_way

name = "assistance.directive.confusion.persistence"
one_way(Scenario.load("yuan2025"), name, (0, 1), points=9).plot()
