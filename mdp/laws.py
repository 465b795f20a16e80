"""Laws of the next status vector, exact: under each action, and when a subtask is skipped.

Given the present vector s and an action a, the next statuses are independent, so that

    K_a(s, s') = Π_i p_i(s, a)^{s'_i} (1 - p_i(s, a))^{1 - s'_i},

worked out as integers over one denominator for each row. Source: Yuan et al. (2025), Section 2.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import prod
from typing import TYPE_CHECKING

import numpy as np

from mdp.chances import chances
from mdp.table import Integers, Numbers, common, integers, multiply

if TYPE_CHECKING:
    from mdp.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class Kernels:
    """Laws of the next status vector: integers over one denominator for each row."""

    bits: Integers  # (2^n, n) the vectors; the first status is the most significant digit
    step: Numbers  # (2^n, A, 2^n) weights under each action
    step_denominator: Numbers  # (2^n, A)
    skip: Numbers  # (2^n, 2^n) weights when a subtask is skipped
    skip_denominator: int


def status_kernels(scenario: Scenario) -> Kernels:
    """Return the laws of the status vector under every action and on a skip."""
    found = chances(scenario)
    vectors, actions, count, _ = found.step.shape
    values = [parameter.value for parameter in scenario.parameters]

    def chance(terms: list[int]) -> Fraction:
        return min(
            Fraction(1), sum((values[k] for k in terms if k < len(found.names)), Fraction(0))
        )

    weight, denominator = _products(
        [[chance(terms) for terms in row] for row in found.step.reshape(-1, count, count).tolist()]
    )
    skip, skip_denominators = _products(
        [[chance(terms) for terms in row] for row in found.skip.tolist()]
    )
    shared, _ = common([Fraction(1, int(d)) for d in skip_denominators])
    bottom = shared[0] * int(skip_denominators[0])
    return Kernels(
        bits=found.bits,
        step=weight.reshape(vectors, actions, vectors),
        step_denominator=denominator.reshape(vectors, actions),
        # As wide as its denominator, below which every sum of a row's weights stays.
        skip=multiply(skip, integers(shared)[:, None]).astype(integers([bottom]).dtype),
        skip_denominator=bottom,
    )


def _products(rows: list[list[Fraction]]) -> tuple[Numbers, Numbers]:
    """Return the law of independent bits: (R, 2^n) integer weights over (R,) denominators."""
    top = integers([p.numerator for row in rows for p in row]).reshape(len(rows), -1)
    bottom = integers([p.denominator for row in rows for p in row]).reshape(len(rows), -1)
    whole = [prod(p.denominator for p in row) for row in rows]
    denominator = integers(whole)
    if denominator.dtype == object:
        top, bottom = top.astype(object), bottom.astype(object)
    weight = np.ones((len(rows), 1), dtype=denominator.dtype)
    for i in range(top.shape[1]):
        one, zero = top[:, i : i + 1], bottom[:, i : i + 1] - top[:, i : i + 1]
        weight = np.stack([weight * zero, weight * one], axis=2).reshape(len(rows), -1)
    return weight, denominator
