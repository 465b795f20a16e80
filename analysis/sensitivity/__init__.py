"""Which numbers decide: derivatives, one-way and two-way analyses, exact thresholds.

>>> from mdp import Scenario
>>> from analysis.sensitivity import gradient
>>> found = gradient(Scenario.load("yuan2025"), names=["reward.task-complete"])
>>> print(found["reward.task-complete"].value)
1 (certified)
"""

from analysis.sensitivity.gradient import Derivative, Gradient, gradient
from analysis.sensitivity.joint import JointRadius, joint_radius
from analysis.sensitivity.moments import Movement, moments_gradient, movement_frame
from analysis.sensitivity.one_way import Bar, Curve, Point, Tornado, one_way, tornado
from analysis.sensitivity.ranges import Range, around, load_ranges, whole
from analysis.sensitivity.thresholds import (
    Switch,
    Threshold,
    Thresholds,
    stability_frame,
    threshold_frame,
    thresholds,
)
from analysis.sensitivity.two_way import TwoWay, two_way

__all__ = [
    "Bar",
    "Curve",
    "Derivative",
    "Gradient",
    "JointRadius",
    "Movement",
    "Point",
    "Range",
    "Switch",
    "Threshold",
    "Thresholds",
    "Tornado",
    "TwoWay",
    "around",
    "gradient",
    "joint_radius",
    "load_ranges",
    "moments_gradient",
    "movement_frame",
    "one_way",
    "stability_frame",
    "threshold_frame",
    "thresholds",
    "tornado",
    "two_way",
    "whole",
]
