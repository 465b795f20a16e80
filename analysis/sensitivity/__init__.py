"""Which numbers decide: derivatives, one-way and two-way analyses, exact thresholds.

>>> from mdp import Scenario
>>> from analysis.sensitivity import gradient
>>> found = gradient(Scenario.load("yuan2025"), names=["reward.task-complete"])
>>> print(found["reward.task-complete"].value)
1 (certified)
"""

from analysis.sensitivity.distributions import Uncertain, Uncertainty
from analysis.sensitivity.expected_loss import LossCurve, expected_loss
from analysis.sensitivity.gradient import gradient
from analysis.sensitivity.gradient_result import Derivative, Gradient
from analysis.sensitivity.joint import JointRadius, joint_radius
from analysis.sensitivity.moments import Movement, moments_gradient, movement_frame
from analysis.sensitivity.morris import Effects, Morris, morris
from analysis.sensitivity.multi_model import MultiModel, multi_model
from analysis.sensitivity.one_way import Bar, Curve, Point, Tornado, one_way, tornado
from analysis.sensitivity.parameter_uncertainty import uncertainty
from analysis.sensitivity.psa import psa
from analysis.sensitivity.psa_result import PSA
from analysis.sensitivity.ranges import Range, around, load_ranges, whole
from analysis.sensitivity.robust import robust_curve
from analysis.sensitivity.robust_box import BoxExtreme, BoxOptimum, box_extreme, box_optimum
from analysis.sensitivity.robust_result import Robust, RobustCurve
from analysis.sensitivity.sampled import Sampled, sampled
from analysis.sensitivity.sobol import Indices, Sobol, sobol
from analysis.sensitivity.structural import structural
from analysis.sensitivity.structural_readings import combinations, one_at_a_time
from analysis.sensitivity.structural_result import Reading, Structural
from analysis.sensitivity.threshold_result import (
    Switch,
    Threshold,
    Thresholds,
    stability_frame,
    threshold_frame,
)
from analysis.sensitivity.thresholds import thresholds
from analysis.sensitivity.two_way import TwoWay, two_way
from analysis.sensitivity.uncertainty_file import load_uncertainty

__all__ = [
    "PSA",
    "Bar",
    "BoxExtreme",
    "BoxOptimum",
    "Curve",
    "Derivative",
    "Effects",
    "Gradient",
    "Indices",
    "JointRadius",
    "LossCurve",
    "Morris",
    "Movement",
    "MultiModel",
    "Point",
    "Range",
    "Reading",
    "Robust",
    "RobustCurve",
    "Sampled",
    "Sobol",
    "Structural",
    "Switch",
    "Threshold",
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
    "moments_gradient",
    "morris",
    "movement_frame",
    "multi_model",
    "one_at_a_time",
    "one_way",
    "psa",
    "robust_curve",
    "sampled",
    "sobol",
    "stability_frame",
    "structural",
    "threshold_frame",
    "thresholds",
    "tornado",
    "two_way",
    "uncertainty",
    "whole",
]
