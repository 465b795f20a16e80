"""Sampled episodes against exact numbers, within four standard errors, and their seeds."""

from fractions import Fraction as F
from math import inf, sqrt

import numpy as np
import pytest

from exact_mdp import MDP, Claim, Scenario, Simulation, evaluate, return_distribution, simulate

EPISODES = 100_000


def check(sample: Simulation, mdp: MDP, policy: object) -> None:
    """Mean, spread, steps and events are within four standard errors of the exact ones."""
    wanted = evaluate(mdp, policy)
    assert abs(sample.mean - wanted.mean) < 4 * sample.standard_error + sample.truncation_error
    assert sample.sd == pytest.approx(wanted.sd, rel=0.03)
    if wanted.ends and not sample.truncated:
        spread = sample.steps.std() / sqrt(sample.episodes)
        assert abs(sample.steps.mean() - wanted.steps) <= 4 * spread
    for name, share in sample.events.items():
        p = wanted.event_probability[name]
        assert abs(share - p) <= 4 * sqrt(p * (1 - p) / sample.episodes)


@pytest.mark.parametrize("discount", [F(1), F(19, 20)])
@pytest.mark.parametrize("policy", ["random", "always:none", "always:directive"])
def test_the_papers_model(policy: str, discount: F) -> None:
    mdp = Scenario.load("yuan2025").compile().with_(discount=discount)
    sample = simulate(mdp, policy, EPISODES, rng=1)
    check(sample, mdp, policy)
    assert sample.claim is Claim.ESTIMATED
    assert sample.value.value == sample.mean
    assert (sample.truncated, sample.truncation_error) == (0, 0.0)
    assert list(sample.events) == ["skip"]


def test_every_return_comes_as_often_as_it_should() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
    exact = return_distribution(mdp, "random")
    sample = simulate(mdp, "random", EPISODES, rng=3)
    values, counts = np.unique(sample.returns, return_counts=True)
    law = {float(value): p for value, p in exact.as_dict().items()}
    assert set(values.tolist()) <= set(law)
    shares = dict(zip(values.tolist(), (counts / EPISODES).tolist(), strict=True))
    for value, p in law.items():
        assert abs(shares.get(value, 0.0) - p) <= 5 * sqrt(p * (1 - p) / EPISODES) + 1e-4


LOOP = [
    (0, 0, [("1/10", 0, 1), ("9/10", 1, -2)]),
    (0, 1, [("1/2", 2, 0), ("1/2", 0, "1/2")]),
    (1, 0, [("3/4", 0, 3), ("1/4", 1, 0)]),
    (2, 0, [(1, 2, 0)]),
]


def test_an_endless_process_is_cut_off_where_nothing_is_lost() -> None:
    mdp = MDP.from_outcomes(LOOP, "9/10")
    sample = simulate(mdp, [0, 0, 0], 20_000, rng=5)
    check(sample, mdp, [0, 0, 0])
    assert sample.truncated == sample.episodes
    assert set(sample.steps.tolist()) == {263}
    assert 0 < sample.truncation_error <= 1e-12 * 3 / 0.1
    low, high = sample.value.interval
    assert low < evaluate(mdp, [0, 0, 0]).mean < high
    assert "cut off" in str(sample.value)


def test_what_is_cut_off_is_part_of_the_error() -> None:
    """Every episode earns 1 a step: the returns show no spread, and the rest is missing."""
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 1)])], "9/10")
    sample = simulate(mdp, [0], 5, rng=0)
    low, high = sample.value.interval
    assert (sample.standard_error, low <= 10 <= high) == (0, True)
    assert 10 - low < 1e-10
    ended = simulate(mdp, [0], 5, rng=0, horizon=3)
    assert ended.value.interval == (ended.mean, ended.mean)
    assert set(ended.steps.tolist()) == {3}
    assert (ended.truncated, ended.truncation_error) == (5, 0)


def test_the_same_seed_gives_the_same_bytes() -> None:
    mdp = Scenario.load("yuan2025").compile()
    first, again = (simulate(mdp, "random", 1000, rng=0) for _ in range(2))
    assert first.returns.tobytes() == again.returns.tobytes()
    assert first.steps.tobytes() == again.steps.tobytes()
    other = simulate(mdp, "random", 1000, rng=1)
    assert first.returns.tobytes() != other.returns.tobytes()
    generator = np.random.default_rng(0)
    assert simulate(mdp, "random", 1000, generator).returns.tobytes() == first.returns.tobytes()
    assert simulate(mdp, "random", 1000, generator).returns.tobytes() != first.returns.tobytes()
    with pytest.raises(ValueError, match="read-only"):
        first.returns[0] = 0


def test_one_episode_says_nothing_of_the_spread() -> None:
    sample = simulate(MDP.from_outcomes(LOOP), "random", 1, rng=0)
    assert (sample.episodes, sample.standard_error) == (1, inf)
