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
    values = scenario.values()
    count = len(scenario.statuses)
    vectors = 2**count
    bits = (np.arange(vectors)[:, None] >> np.arange(count - 1, -1, -1)) & 1

    influence = [[Fraction(0)] * count for _ in range(count)]
    by_row = scenario.readings["influence_orientation"] == "row-to-column"
    for i, target in enumerate(scenario.statuses):
        for j, origin in enumerate(scenario.statuses):
            if i != j:
                first, second = (origin, target) if by_row else (target, origin)
                influence[i][j] = values[f"influence.{first}.{second}"]

    def onset(i: int, present: list[int]) -> Fraction:
        added = sum(influence[i][j] for j in range(count) if present[j])
        return min(Fraction(1), values[f"base.{scenario.statuses[i]}"] + added)

    def stays(i: int, present: list[int]) -> Fraction:
        kept = values[f"persistence.{scenario.statuses[i]}"]
        if scenario.readings["influence_on_present"] == "additive":
            kept += sum(influence[i][j] for j in range(count) if present[j])
        return min(Fraction(1), kept)

    def step(action: str, i: int, present: list[int]) -> Fraction:
        rule = "persistence" if present[i] else "onset"
        assisted = values.get(f"assistance.{action}.{scenario.statuses[i]}.{rule}")
        if assisted is not None:
            return assisted
        return stays(i, present) if present[i] else onset(i, present)

    def skipped(i: int, present: list[int]) -> Fraction:
        rule = scenario.readings["skip_onset"]
        if rule == "reset" or not (present[i] or rule == "base"):
            return Fraction(0)
        if not present[i]:
            return onset(i, present)
        status = scenario.statuses[i]
        if status not in scenario.others:
            return values[f"skip.{status}.persistence"]
        other = scenario.statuses.index(scenario.others[status])
        return values[f"skip.{status}.{'with-other' if present[other] else 'alone'}"]

    listed = bits.tolist()
    weight, denominator = _products(
        [[step(a, i, s) for i in range(count)] for s in listed for a in scenario.actions]
    )
    actions = len(scenario.actions)
    skip, skip_denominators = _products([[skipped(i, s) for i in range(count)] for s in listed])
    shared, _ = common([Fraction(1, int(d)) for d in skip_denominators])
    bottom = shared[0] * int(skip_denominators[0])
    return Kernels(
        bits=bits,
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
