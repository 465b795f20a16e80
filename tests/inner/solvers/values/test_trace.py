"""Traces are powers of the chain's matrix, in fractions, within the bound that is stated."""

from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
from small_models import small_model

from exact_mdp import MDP, ModelError, cohort_trace, evaluate
from exact_mdp.solvers.bounds.gains import UNIT
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
    report = trace.report()
    assert report.facts["error_bound"].value == trace.error
    assert report.facts["steps"] == 3
    assert (report.tables["trace"].rows.to_numpy() == frame.to_numpy()).all()


def test_the_number_of_steps_is_said_once() -> None:
    mdp = small_model(1)
    with pytest.raises(ModelError, match="number of steps is missing"):
        cohort_trace(mdp, "random")
    with pytest.raises(ModelError, match="of its own"):
        cohort_trace(mdp.within(2), "random", 2)
    with pytest.raises(ModelError, match="steps"):
        cohort_trace(mdp, "random", -1)
    with pytest.raises(ModelError, match="choose fewer steps"):
        cohort_trace(mdp, "random", 10**12)


@pytest.mark.parametrize("seed", range(4))
def test_states_without_a_time_keep_their_place_behind_all_others(seed: int) -> None:
    """To have reached a label is one more state; its share is the probability to reach it."""
    model = small_model(seed)
    mdp = model.with_(labels={"there": np.flatnonzero(model.terminal)}).reaching("there")
    alone, timed = cohort_trace(mdp, "random", steps=4), cohort_trace(mdp.within(4), "random")
    assert timed.states == alone.states
    assert timed.share == pytest.approx(alone.share, abs=1e-14)
    wanted = evaluate(mdp.within(4), "random").mean
    assert timed.share[-1, -1] == pytest.approx(wanted) != 0


def test_the_error_counts_every_rounding() -> None:
    """Each of two actions in 4 states leads to another state: its share adds up 4 products."""
    rows: Any = [(s, a, [(F(1, 3), 4, 0), (F(2, 3), s, 1)]) for s in range(4) for a in range(2)]
    mdp = MDP.from_outcomes([*rows, (4, 0, [(1, 4, 0)])], start=dict.fromkeys(range(4), F(1, 4)))
    rounded = PolicyChain.of(mdp, "random").roundings  # of a probability
    assert rounded >= 2 * 2
    for steps in range(1, 5):
        # Four products and their sum with those who have come there before; once the start; and
        # with a time, the sum of a state's shares over the times from 0 on.
        least = (steps * (rounded + 5) + 1 + steps) * UNIT
        assert least <= cohort_trace(mdp, "random", steps).error <= least * (1 + 1e-5)
