"""Weighted steps are worth the weighted sum of what the steps earn."""

from fractions import Fraction as F

import numpy as np
import pytest
from small_models import small_model

from exact_mdp import MDP, ModelError, certify
from exact_mdp.mdp.questions.step_weights import list_weights, scale_rewards


def test_the_rules() -> None:
    half, simpson = "half-cycle", "simpson"
    assert list_weights(half, 2) == [F(1, 2), F(1, 2)]
    assert list_weights(half, 4) == [F(1, 2), 1, 1, F(1, 2)]
    assert list_weights(simpson, 3) == [F(1, 3), F(4, 3), F(1, 3)]
    assert list_weights(simpson, 5) == [F(1, 3), F(4, 3), F(2, 3), F(4, 3), F(1, 3)]
    assert list_weights(np.array([1, 2]), 2) == [1, 2]
    # Simpson's rule is exact for polynomials of degree 3, and the trapezoidal rule of degree 1.
    for rule, degree in ((simpson, 3), (half, 1)):
        for power in range(degree + 1):
            total = sum(w * t**power for t, w in enumerate(list_weights(rule, 7)))
            assert total == F(6 ** (power + 1), power + 1)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("by_outcome", [True, False])
def test_weighted_sums(seed: int, by_outcome: bool) -> None:
    """One policy, so that the value is the sum over time of the distribution times the reward."""
    chain = small_model(seed, "9/10", by_outcome=by_outcome)
    firsts = [chain.pairs_of(state)[0] for state in range(chain.n_states)]
    rows = [(state, 0, chain.table.row(pair)) for state, pair in enumerate(firsts)]
    parts = {"odd": [F(state % 2) for state in range(len(rows))]} if seed % 2 else None
    mdp = MDP.from_outcomes(
        rows, "9/10", start=chain.start, **({"components": parts} if parts else {})
    )
    weights = [F(1, 2), F(3), F(-1), F(0), F(2, 7)]
    at, worth, odd = dict(mdp.start), F(0), F(0)
    for time, weight in enumerate(weights):
        for state, share in at.items():
            scale = F(9, 10) ** time * weight * share
            worth += scale * sum(p * r for p, _, r in mdp.table.row(state))
            odd += scale * (state % 2)
        after: dict[int, F] = {}
        for state, share in at.items():
            for p, to, _ in mdp.table.row(state):
                after[to] = after.get(to, F(0)) + share * p
        at = after
    steps = mdp.within(5).weigh_steps(weights)
    assert certify(steps).start_value == worth
    assert certify(MDP.from_steps([mdp] * 5).weigh_steps(weights)).start_value == worth
    if seed % 2:
        found = MDP.from_steps([mdp] * 5).weigh_steps(weights).earning("odd")
        assert certify(found).start_value == odd


def test_floats_are_scaled_exactly() -> None:
    mdp = MDP.from_arrays([[[0.5, 0.5], [0, 1]]], [0.1, 0.0])
    table = scale_rewards(mdp.table, np.array([1, 1]), np.array([3, 1]))
    assert table.row(0)[0][2] == F(0.1) / 3


MODEL = small_model(1)


@pytest.mark.parametrize(
    ("model", "weights", "said"),
    [
        (MODEL, "simpson", "have no number"),
        (MODEL.within(4), "simpson", "an odd number of steps"),
        (MODEL.within(1), "half-cycle", "needs 2 steps"),
        (MODEL.within(1), "simpson", "3 or more"),
        (MODEL.within(3), "half", "unknown rule 'half'"),
        (MODEL.within(3), [1, 2], "one weight for each of 3 steps"),
        (MODEL.within(3), 7, "one weight for each of 3 steps"),
        (MODEL.within(2), [1, "x"], "weights"),
        (MODEL.within(2, terminal_value={0: 1}), [1, 1], "does not belong to a step"),
    ],
)
def test_other_weights_are_refused(model: MDP, weights: object, said: str) -> None:
    with pytest.raises(ModelError, match=said):
        model.weigh_steps(weights)
