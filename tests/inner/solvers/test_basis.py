"""Optima under limits with and without what floats propose, against mixtures of all policies."""

from __future__ import annotations

from fractions import Fraction as F

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from objective_models import LIMITS, sound, totals, with_components

from exact_mdp import MDP, solve
from exact_mdp.solvers.objectives.simplex import maximise


@pytest.mark.parametrize("floats", [True, False])
@settings(max_examples=40)
@given(mdp=with_components(2), bounds=st.tuples(LIMITS, LIMITS))
def test_two_limits_are_the_program_over_all_policies(
    floats: bool, mdp: MDP, bounds: tuple[F, F]
) -> None:
    """With the basis that floats propose, or by exact steps from the greatest return on."""
    best = 1 if mdp.sense == "max" else -1
    every = sorted(set(totals(mdp, [*mdp.component_names])))
    columns = [[p[0], -p[1], F(1)] for p in every] + [[F(-1), F(0), F(0)], [F(0), F(-1), F(0)]]
    worth = [best * sum(p, F(0)) for p in every] + [F(0), F(0)]
    wanted = maximise(worth, columns, [bounds[0], -bounds[1], F(1)])
    with pytest.MonkeyPatch.context() as patch:
        if not floats:
            patch.setattr("exact_mdp.solvers.objectives.limits._Program._proposed", lambda *_: None)
        found = solve(mdp, subject_to={"c0": f">= {bounds[0]}", "c1": f"<= {bounds[1]}"})
    sound(found, 2)
    assert found.feasible is wanted.feasible
    if wanted.feasible:
        assert found.start_value == best * sum(
            (x * r for x, r in zip(wanted.x, worth, strict=True)), F(0)
        )
    else:
        low, high = found.closest["c0"], found.closest["c1"]
        assert bounds[0] - low == high - bounds[1] == found.shift > 0
        assert maximise(worth, columns, [low, -high, F(1)]).feasible
        near = [low + found.shift / 9, -(high - found.shift / 9), F(1)]
        assert not maximise(worth, columns, near).feasible
