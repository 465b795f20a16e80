"""Which numbers matter: derivatives, one-way and two-way analyses, exact thresholds.

>>> from exact_mdp import Scenario
>>> from exact_mdp.analysis.vary import gradient
>>> found = gradient(Scenario.load("yuan2025"), names=["reward.task-complete"])
>>> print(found["reward.task-complete"].value)
1 (certified)
"""

from exact_mdp.analysis.vary.corners import worst_point
from exact_mdp.analysis.vary.curves.curve import curve
from exact_mdp.analysis.vary.curves.gradient import gradient
from exact_mdp.analysis.vary.curves.thresholds import thresholds
from exact_mdp.analysis.vary.distributions import (
    Uncertain,
    Uncertainty,
    load_uncertainty,
    uncertainty,
)
from exact_mdp.analysis.vary.one_way import one_way, tornado, two_way
from exact_mdp.analysis.vary.psa import psa
from exact_mdp.analysis.vary.ranges import Range, load_ranges
from exact_mdp.analysis.vary.robust import robust_curve
from exact_mdp.analysis.vary.sobol import sobol
from exact_mdp.analysis.vary.study import Study, study

__all__ = [
    "Range",
    "Study",
    "Uncertain",
    "Uncertainty",
    "curve",
    "gradient",
    "load_ranges",
    "load_uncertainty",
    "one_way",
    "psa",
    "robust_curve",
    "sobol",
    "study",
    "thresholds",
    "tornado",
    "two_way",
    "uncertainty",
    "worst_point",
]
