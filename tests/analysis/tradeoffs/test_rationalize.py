"""Weights that make a policy optimal, against all policies of small models."""

from dataclasses import replace
from fractions import Fraction
from itertools import product
from math import inf
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from objective_models import totals, with_components
from scipy.optimize import linprog

from exact_mdp import MDP, Scenario, rationalize

F = Fraction


@settings(max_examples=60)
@given(mdp=with_components(2), data=st.data())
def test_the_change_is_the_least_over_all_policies(mdp: MDP, data: Any) -> None:
    """HiGHS on the rows of all deterministic policies; the intervals from these rows, exactly."""
    sign = 1 if mdp.sense == "max" else -1
    names = list(mdp.component_names)
    every = [[sign * v for v in point] for point in totals(mdp, names)]
    number = data.draw(st.integers(0, len(every) - 1))
    choice = list(product(*(mdp.pairs_of(s) for s in range(mdp.n_states))))[number]
    least_change = rationalize(mdp, mdp.pair_action[list(choice)])
    assert least_change.violations() == []
    leads = [[a - b for a, b in zip(p, every[number], strict=True)] for p in every]
    weights = [least_change.weights[name] for name in names]
    assert all(dot(weights, lead) <= 0 for lead in leads)
    assert max(abs(w - 1) for w in weights) == least_change.change <= 1
    size = len(names)
    scaled = [[float(x / (max(map(abs, lead)) or 1)) for x in lead] + [0.0] for lead in leads]
    near = [[*(s * np.eye(size)[k]), -1.0] for k in range(size) for s in (1, -1)]
    least = linprog(
        [0.0] * size + [1.0], np.array(scaled + near),
        [0.0] * len(scaled) + [1.0, -1.0] * size, bounds=[(None, None)] * (size + 1),
    )  # fmt: skip
    assert float(least_change.change) == pytest.approx(least.fun, abs=1e-7)
    for k, name in enumerate(names):
        assert least_change.alone[name] == interval(leads, k)


def dot(left: Any, right: Any) -> F:
    return sum((a * b for a, b in zip(left, right, strict=True)), F(0))


def interval(leads: list[list[F]], k: int) -> tuple[F, F | float] | None:
    """All x ≥ 0 with x lead[k] + the rest ≤ 0 on every row."""
    ends = [(lead[k], sum(lead, F(0)) - lead[k]) for lead in leads]
    low = max([F(0), *(rest / -slope for slope, rest in ends if slope < 0)])
    high = min([inf, *(-rest / slope for slope, rest in ends if slope > 0)])
    closed = any(slope == 0 < rest for slope, rest in ends)
    return None if closed or low > high else (low, high)


def test_a_mixed_policy_and_one_that_is_never_right() -> None:
    """Drawing between a good and a worse action is right where both are equally good."""
    rows = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 3)]), (0, 2, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])]
    parts = {"gain": [6, 3, 2, 0], "effort": [-1, 0, 0, 0]}
    mdp = MDP.from_outcomes(rows, components=parts)
    drawn = rationalize(mdp, {"0": {"0": "1/2", "1": "1/2"}, "1": "0"})
    assert (drawn.possible, drawn.change) == (True, F(1, 2))
    never = rationalize(mdp, {"0": "2", "1": "0"})
    assert (never.possible, never.change) == (False, 1)
    assert set(never.weights.values()) == {F(0)} or never.weights["gain"] == 0
    assert "no change below 1" in repr(never)
    assert never.violations() == drawn.violations() == []


def test_the_checker_notices_false_answers() -> None:
    scenario = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    least_change = rationalize(scenario, "always:directive")
    assert least_change.violations() == []
    assert 0 < least_change.change < 1
    best = rationalize(scenario, "optimal")
    place, own = next((k, own) for k, own in enumerate(best.intervals) if own.low)
    assert own.low is not None

    cut = least_change.cuts[0]
    negative = cut, replace(cut, multiplier=-cut.multiplier)  # which add nothing
    low = replace(least_change.dual, top=[v - 1 for v in least_change.dual.top])

    def other(**part: Any) -> Any:
        intervals = [*best.intervals]
        intervals[place] = replace(own, **part)
        return replace(best, intervals=tuple(intervals))

    for broken in (
        replace(least_change, change=least_change.change / 2),
        replace(least_change, multipliers=(F(1),) * len(least_change.multipliers)),
        replace(least_change, cuts=()),
        replace(least_change, cuts=least_change.cuts[:-1]),
        replace(least_change, cuts=(*least_change.cuts, *negative)),
        replace(least_change, dual=low),
        replace(least_change, flow=best.flow),
        other(low=own.low / 2),
        other(low=None),
        other(cuts=()),
    ):
        assert broken.violations()
