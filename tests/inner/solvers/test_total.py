"""Totals at discount 1: the same proof in compiled loops, and pairs left out of floats."""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import Pairs, any_models, model_of

from exact_mdp import certify, solve
from exact_mdp.mdp import graph
from exact_mdp.solvers.bounds.gains import gains
from exact_mdp.solvers.endless.merged import without_losing
from exact_mdp.solvers.endless.structure import finite, structure
from exact_mdp.solvers.exact import linear


@given(model=any_models())
@settings(max_examples=25)
def test_proofs_are_the_same_compiled_and_not(model: Pairs) -> None:
    """Lists and rational elimination, or compiled loops and SciPy's graphs: the same proof."""
    found = []
    for least in (10**9, 0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(graph, "COMPILED", least)
            patch.setattr(linear, "FEW", 1)
            proof = certify(model_of(*model, F(1)))
            wrong = proof.violations()
        claims = [proof.value, proof.policy, proof.optimal_pairs, proof.gaps, proof.unique, wrong]
        found.append([np.asarray(each).tolist() for each in claims])
    assert found[0] == found[1]


def test_only_pairs_that_lose_much_are_left_out_of_the_float_model() -> None:
    """A slippery grid, -1 a step: near ties stay in, whose loss loose bounds could not bear out."""
    rows = []
    for state in range(63):
        for a, ahead in enumerate((-8, 1, 8, -1)):
            moves = (
                (ahead, F(4, 5)),
                *((side, F(1, 10)) for side in ((1, -1) if a % 2 == 0 else (8, -8))),
            )
            onward: dict[int, F] = {}
            for move, p in moves:
                there = state + move
                inside = 0 <= there < 64 and (abs(move) == 8 or there // 8 == state // 8)
                onward[there if inside else state] = (
                    onward.get(there if inside else state, F(0)) + p
                )
            rows.append((state, a, F(-1), onward))
    mdp = model_of(64, [*rows, (63, 0, F(0), {63: F(1)})], F(1))
    found = structure(mdp)
    assert found is not None
    whole = finite(found)
    value = np.zeros(whole.mdp.n_states)
    value[whole.label] = solve(mdp).value
    left = ~np.isin(whole.source, without_losing(whole).source)
    assert left.any()
    assert gains(whole.mdp, value).value[left].max() < -0.1
