"""Robust values: every deterministic policy against every corner of intervals."""

from itertools import product

import numpy as np
import pytest

from exact_mdp import MDP, Intervals, solve_robust
from exact_mdp.solvers.robust.game import Game, verify_margins


def drawn(seed: int, sense: str) -> MDP:
    rng = np.random.default_rng(seed)
    return MDP.from_arrays(rng.dirichlet(np.ones(2), (2, 2)), rng.normal(size=(2, 2)), "4/5",
                           sense=sense, layout="ass")  # fmt: skip


@pytest.mark.parametrize("nature", ["worst", "best"])
@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("seed", range(6))
def test_the_value_is_that_of_the_best_policy_at_natures_corners(
    seed: int, sense: str, nature: str
) -> None:
    """Two outcomes a row: a corner puts the first at either end. All are tried for each policy."""
    mdp = drawn(seed, sense)
    p, reward = mdp.transition.toarray(), mdp.reward
    low = np.maximum(0.7 * p, 1 - 1.3 * p[:, ::-1])[:, 0]  # the least chance of the first outcome
    high = np.minimum(1.3 * p, 1 - 0.7 * p[:, ::-1])[:, 0]

    def value(pairs: tuple[int, ...], ends: tuple[int, ...]) -> np.ndarray:
        first = [(low, high)[end][pair] for pair, end in zip(pairs, ends, strict=True)]
        chain = np.array([[x, 1 - x] for x in first])
        return np.linalg.solve(np.eye(2) - 0.8 * chain, reward[list(pairs)])

    gains = sense == "max"
    agent, other = (max, min) if gains else (min, max)
    against = other if nature == "worst" else agent
    values = [[against(value(pairs, ends)[s] for ends in product((0, 1), repeat=2)) for s in (0, 1)]
              for pairs in product((0, 1), (2, 3))]  # fmt: skip
    best = [agent(own[s] for own in values) for s in (0, 1)]
    found = solve_robust(mdp, Intervals.relative(mdp, "3/10"), nature=nature)
    assert (np.abs(found.value - best) <= found.state_error + 1e-12).all()
    assert found.error_bound < 1e-7


def test_margins_bound_what_any_law_keeps() -> None:
    """w - γ q w ≥ m of every law q: at the nominal laws and at the ends of the intervals."""
    mdp = drawn(1, "max")
    game = Game(mdp, Intervals.relative(mdp, "3/10"), against=True, weights=None)
    weight, margin = verify_margins(game)
    p = mdp.transition.toarray()
    assert (margin > 0).all()
    for share in (0.7, 1.0, 1.3):
        first = np.clip(share * p[:, 0], 1 - 1.3 * p[:, 1], 1 - 0.7 * p[:, 1])
        kept = 0.8 * (first * weight[0] + (1 - first) * weight[1])
        assert (weight[mdp.pair_state] - kept >= margin[mdp.pair_state] - 1e-12).all()
