"""Optima under limits from a basis that floats propose, against mixtures of exact policies."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from objective_models import with_components
from random_models import garnet_rows

from exact_mdp import MDP, solve
from exact_mdp.solvers.objectives import constrained
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.basis import Optimal, by_basis
from exact_mdp.solvers.objectives.checker import Limit, constrained_violations
from exact_mdp.solvers.objectives.constrained import Relaxed, limits_of, relaxed
from exact_mdp.solvers.objectives.optima import proof

BOUNDS = st.sampled_from([F(-3), F(-1), F(-1, 3), F(1, 7), F(1), F(5, 2)])


@settings(max_examples=40)
@given(mdp=with_components(2), bounds=st.tuples(BOUNDS, BOUNDS))
def test_a_basis_and_mixtures_give_the_same_optimum(mdp: MDP, bounds: tuple[F, F]) -> None:
    of = Objectives.of(mdp, ["reward", "c0", "c1"])
    limits = limits_of({"c0": f">= {bounds[0]}", "c1": f"<= {bounds[1]}"})
    found, wanted = by_basis(of, limits), relaxed(of, limits)
    if found is not None:
        weight = F(found.shift == 0)
        values = (found.flow, (weight, *found.price), found.dual, found.shift)
        assert constrained_violations(of, proof(of), limits, *values) == []
        assert found.shift == wanted.shift
        assert found.shift or worth(of, limits, found) == worth(of, limits, wanted)


def worth(of: Objectives, limits: Sequence[Limit], found: Optimal | Relaxed) -> F:
    """The return that prices and values prove to be the greatest."""
    room = sum(x.sign * p * x.bound for x, p in zip(limits, found.price, strict=True))
    return of.at_start(*found.dual) - room


def ring(constant: bool = False) -> MDP:
    """A random model of 60 states on one cycle, of three totals."""
    rows, draw = garnet_rows(60, rng=1), np.random.default_rng(2)
    if constant:
        rows = [(s, a, [(p, n, F(7, 1000)) for p, n, _ in own]) for s, a, own in rows]
    parts = {name: draw.integers(0, 64, len(rows)).tolist() for name in "ab"}
    return MDP.from_outcomes(rows, "19/20", components=parts)


@pytest.mark.parametrize(
    "limits, draws",
    [
        ({"a": ">= 900"}, 1),
        ({"a": ">= 900", "b": ">= 900"}, 2),
        ({"a": [">= 600", "<= 700"]}, 1),
        ({"a": ">= 1000", "b": ">= 1000"}, None),
        ({"a": ">= 2000"}, None),
    ],
)
@pytest.mark.parametrize("constant", [False, True])
def test_states_on_a_cycle_need_no_mixtures(
    limits: Any, draws: int | None, constant: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The basis is found in all cases, also where all policies have the same return."""
    monkeypatch.setattr(constrained, "relaxed", None)
    mdp = ring(constant)
    found = solve(mdp, subject_to=limits)
    assert found.objectives.cyclic
    assert found.violations() == []
    assert found.feasible is (draws is not None)
    assert len(found.randomises) <= (draws or 2)
    if constant and draws:
        assert set(found.prices.values()) == {F(0)}
