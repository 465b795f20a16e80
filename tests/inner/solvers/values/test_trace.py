"""Traces are powers of the chain's matrix, in fractions, within the bound that is stated."""

from fractions import Fraction as F

import numpy as np
import pytest
from small_models import small_model

from exact_mdp import MDP, ModelError, cohort_trace, evaluate
from exact_mdp.solvers.values.policy_chain import PolicyChain


def powers(mdp: MDP, steps: int, weights: np.ndarray) -> list[list[F]]:
    """The exact shares at each time, with the probabilities (L,) of pairs."""
    at = [F(0)] * mdp.n_states
    for state, share in mdp.start:
        at[state] = F(share)
    rows = [at]
    for _ in range(steps):
        after = [F(0)] * mdp.n_states
        for pair in np.flatnonzero(weights).tolist():
            state = int(mdp.pair_state[pair])
            for chance, to, _ in mdp.table.row(pair):
                after[to] += at[state] * F(float(weights[pair])) * chance
        at = after
        rows.append(at)
    return rows


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("policy", ["random", "optimal"])
def test_shares_are_powers(seed: int, policy: str) -> None:
    mdp = small_model(seed)
    trace, chain = cohort_trace(mdp, policy, steps=6), PolicyChain.of(mdp, policy)
    for own, exact in zip(trace.share, powers(mdp, 6, chain.chosen), strict=True):
        # Weights of random policies are rounded once: 6 steps of 2^-53 each.
        off = max(abs(F(float(x)) - y) for x, y in zip(own, exact, strict=True))
        assert off <= trace.error
    assert trace.error < 1e-13
    assert trace.share.sum(axis=1) == pytest.approx(np.ones(7))


@pytest.mark.parametrize("seed", range(8))
def test_a_model_with_a_time_has_the_trace_of_its_steps(seed: int) -> None:
    mdp = small_model(seed)
    alone = cohort_trace(mdp, "random", steps=4)
    for timed in (mdp.within(4), MDP.from_steps([mdp] * 4)):
        trace = cohort_trace(timed, "random")
        assert trace.share.shape == (5, mdp.n_states)
        assert trace.share == pytest.approx(alone.share, abs=1e-14)


def test_ends_are_cumulative_and_visits_are_not() -> None:
    ill = MDP.from_arrays([[["9/10", "1/10"], [0, 1]]], [1, 0], states=["ill", "dead"])
    trace = cohort_trace(ill, steps=3)
    assert trace.share[:, 1] == pytest.approx([0, 0.1, 0.19, 0.271])
    assert trace.share[:3, 0].sum() == pytest.approx(evaluate(ill.within(3), "optimal").mean)
    frame = trace.frame()
    assert frame.columns.tolist() == ["time", "ill", "dead"]
    assert frame["time"].tolist() == [0, 1, 2, 3]
    assert trace.report().facts["error_bound"].value == trace.error


def test_the_number_of_steps_is_said_once() -> None:
    mdp = small_model(1)
    with pytest.raises(ModelError, match="number of steps is missing"):
        cohort_trace(mdp, "random")
    with pytest.raises(ModelError, match="of its own"):
        cohort_trace(mdp.within(2), "random", 2)
    with pytest.raises(ModelError, match="steps"):
        cohort_trace(mdp, "random", 0)
