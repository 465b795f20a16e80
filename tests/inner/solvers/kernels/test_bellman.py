"""Compiled passes, against the formulas written with NumPy."""

import numpy as np
import pytest

from exact_mdp import MDP
from exact_mdp.solvers.kernels import bellman


def drawn(seed: int) -> MDP:
    """States with 1, 2 and 3 pairs, and an end."""
    rng = np.random.default_rng(seed)
    state, action = [0, 1, 1, 2, 2, 2, 3], [0, 0, 1, 0, 1, 2, 0]
    rows = rng.dirichlet(np.ones(4), 7)
    rows[-1] = [0, 0, 0, 1]
    return MDP.from_pairs(state, action, rows, [*rng.normal(size=6), 0], "9/10")


@pytest.mark.parametrize("seed", range(10))
def test_gains_and_improvements_are_those_of_the_formula(seed: int) -> None:
    mdp, rng = drawn(seed), np.random.default_rng(seed + 90)
    value, state = rng.normal(size=4), mdp.pair_state
    p = mdp.transition.toarray()
    apart = value[None] - value[state][:, None]
    gain = mdp.reward + 0.9 * (p * apart).sum(axis=1) - 0.1 * value[state]
    steps, flow = np.empty(7), np.empty(7)
    matrix = mdp.transition
    bellman.sum_differences(
        0, 7, state, (matrix.indptr, matrix.indices, matrix.data), value, steps, flow
    )
    assert steps == pytest.approx((p * apart).sum(axis=1))
    assert flow == pytest.approx((p * np.abs(apart)).sum(axis=1))
    for margin in (np.array([2.0]), rng.uniform(1, 2, 7)):
        model = bellman.build_compiled_model(mdp, mdp.reward, margin)
        pairs, rise, extremes = np.full(4, -1), np.empty(4), np.empty(2)
        ceilings = np.full(7, np.inf)
        ceilings[:] = mdp.reward + 100
        bellman.improve_states(0, 4, model, value, pairs, ceilings, 0.0, 0.0, rise, extremes)
        best = [max(gain[l] for l in mdp.pairs_of(s)) for s in range(3)]
        assert rise[:3] == pytest.approx(best)
        assert rise[3] == 0
        assert pairs[:3].tolist() == [max(mdp.pairs_of(s), key=gain.__getitem__) for s in range(3)]
        ratio = gain / (margin if len(margin) > 1 else margin[0])
        assert extremes[0] == pytest.approx(min(ratio[pairs[s]] for s in range(3)))
        assert extremes[1] == pytest.approx(max(ratio[:6]))


@pytest.mark.parametrize("seed", range(10))
def test_relaxing_solves_each_states_own_equation_in_turn(seed: int) -> None:
    mdp, value = drawn(seed), np.random.default_rng(seed).normal(size=4)
    model, level = bellman.build_compiled_model(mdp, mdp.reward, np.array([1.0])), 0.25
    p, wanted = mdp.transition.toarray(), value.copy()
    for s in (2, 0, 1):
        others = np.delete(np.arange(4), s)
        wanted[s] = max(
            (mdp.reward[l] - level + 0.9 * p[l, others] @ wanted[others]) / (1 - 0.9 * p[l, s])
            for l in mdp.pairs_of(s)
        )
    bellman.relax_states(np.array([2, 0, 3, 1]), model, value, level)
    assert value == pytest.approx(wanted)
