"""Which numbers decide: derivatives, one-way and two-way analyses, exact thresholds.

>>> from exact_mdp import Scenario
>>> from exact_mdp.analysis.sensitivity import gradient
>>> found = gradient(Scenario.load("yuan2025"), names=["reward.task-complete"])
>>> print(found["reward.task-complete"].value)
1 (certified)
"""

from exact_mdp.analysis.sensitivity.draws.global_ import (
    Effects,
    Indices,
    Morris,
    Sobol,
    morris,
    sobol,
)
from exact_mdp.analysis.sensitivity.draws.sampled import Sampled, sampled
from exact_mdp.analysis.sensitivity.gradient import Gradient, gradient
from exact_mdp.analysis.sensitivity.joint_radius import JointRadius, joint_radius
from exact_mdp.analysis.sensitivity.multi_model import MultiModel, multi_model
from exact_mdp.analysis.sensitivity.one_way import Curve, Tornado, one_way, tornado
from exact_mdp.analysis.sensitivity.psa.distributions import (
    Uncertain,
    Uncertainty,
    load_uncertainty,
    uncertainty,
)
from exact_mdp.analysis.sensitivity.psa.expected_loss import LossCurve, expected_loss
from exact_mdp.analysis.sensitivity.psa.psa import PSA, psa
from exact_mdp.analysis.sensitivity.ranges import Range, around, load_ranges, whole
from exact_mdp.analysis.sensitivity.robust.box import (
    BoxExtreme,
    BoxOptimum,
    box_extreme,
    box_optimum,
)
from exact_mdp.analysis.sensitivity.robust.robust import Robust, RobustCurve, robust_curve
from exact_mdp.analysis.sensitivity.structural import (
    Structural,
    combinations,
    one_at_a_time,
    structural,
)
from exact_mdp.analysis.sensitivity.thresholds import Thresholds, thresholds
from exact_mdp.analysis.sensitivity.two_way import TwoWay, two_way

__all__ = [
    "PSA",
    "BoxExtreme",
    "BoxOptimum",
    "Curve",
    "Effects",
    "Gradient",
    "Indices",
    "JointRadius",
    "LossCurve",
    "Morris",
    "MultiModel",
    "Range",
    "Robust",
    "RobustCurve",
    "Sampled",
    "Sobol",
    "Structural",
    "Thresholds",
    "Tornado",
    "TwoWay",
    "Uncertain",
    "Uncertainty",
    "around",
    "box_extreme",
    "box_optimum",
    "combinations",
    "expected_loss",
    "gradient",
    "joint_radius",
    "load_ranges",
    "load_uncertainty",
    "morris",
    "multi_model",
    "one_at_a_time",
    "one_way",
    "psa",
    "robust_curve",
    "sampled",
    "sobol",
    "structural",
    "thresholds",
    "tornado",
    "two_way",
    "uncertainty",
    "whole",
]
