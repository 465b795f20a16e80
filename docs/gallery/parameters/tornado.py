"""Tornado diagram.

The optimal value at both ends of each range, one number at a time.
"""

from exact_mdp import Scenario, tornado

names = ["base.anger", "base.confusion", "persistence.anger", "persistence.disengagement"]
tornado(Scenario.load("yuan2025"), names=names).plot()
