"""Learning against a twin in plain Python, and the sampler against exact rows."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learning_twin import Stream, Twin
from strategies import models

from exact_mdp import MDP, Constant, Exponential, Policy, QLearning, Scenario, evaluate
from exact_mdp.solvers.learning.sampler import rows_of, tables
from exact_mdp.solvers.values.layers import policy_values

METHODS = ("q-learning", "sarsa", "expected-sarsa", "double-q-learning")
TIES = ("first", "last", "random")
CARE = Scenario.load("yuan2025")
OTHERS = {"skip_timestep": "own", "task_bonus": "no-subtask-skipped"}


@pytest.fixture(scope="module")
def care() -> MDP:
    return CARE.compile()


@pytest.fixture(scope="module")
def other() -> MDP:
    """Another reading, with states that offer no choice and two tasks."""
    return CARE.with_(readings=OTHERS, tasks=[1, 2]).compile()


# ---- against the twin ----------------------------------------------------------------------------


def compare_with_twin(mdp: MDP, learner: QLearning, seed: int) -> None:
    run = learner.train(mdp, seed)
    rows = rows_of(mdp, learner.columns)
    twin = Twin(
        tables=tables(mdp, rows),
        actions=mdp.n_actions,
        method=learner.method,
        ties=learner.ties,
        discount=float(learner.discount),
        power=learner.rate_power,
        bootstrap_end=learner.bootstrap_end,
        initial=learner.initial,
    )
    words = np.random.SeedSequence(seed).generate_state(4, np.uint64)
    epsilon = learner.exploration.values(learner.epochs)
    rate = learner.rate.values(learner.epochs)
    episodes = learner.epochs * learner.episodes
    at = learner.snapshot_episode
    snapshots = range(at, episodes + 1, learner.episodes) if at else range(0)
    last = range(max(1, episodes + 1 - learner.last), episodes + 1)
    epochs = {*snapshots, *last}
    twin.run(words.tolist(), epsilon, rate, learner.episodes, learner.max_steps, epochs)
    assert np.array_equal(run.q, twin.table(rows.space.size))
    assert (run.steps, run.cut_short) == (twin.steps, twin.cut)
    assert run.returns.tolist() == twin.returns
    assert run.policies[run.last].tolist() == [twin.policies[number] for number in last]
    assert run.policies[run.snapshots].tolist() == [twin.policies[number] for number in snapshots]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("ties", TIES)
@pytest.mark.parametrize("bootstrap_end", [False, True])
def test_every_bit_is_the_twins(other: MDP, method: str, ties: str, bootstrap_end: bool) -> None:
    learner = QLearning(
        method=method, ties=ties, bootstrap_end=bootstrap_end, epochs=25, rate_power=0.3, last=40
    )
    compare_with_twin(other, learner, seed=5)


@pytest.mark.parametrize(
    "learner",
    [
        QLearning(epochs=60, exploration=Exponential.through(0.8, at=300, minimum=0.03)),
        QLearning(epochs=8, columns=("subtask", "trial", "status"), initial=50.0, last=7),
        QLearning(epochs=9, columns=("trial", "status"), discount=1, rate=Exponential(decay=0.3)),
        QLearning(epochs=5, columns=(), rate=Exponential(decay=0.5), snapshot_episode=0),
        QLearning(epochs=30, episodes=3, snapshot_episode=3, max_steps=4, last=500),
        QLearning(epochs=10, exploration=Constant(1.0), ties="random", initial=-3.5),
    ],
    ids=range(6),
)
@pytest.mark.parametrize("seed", [0, 12345678901234567890])
def test_options_are_the_twins(care: MDP, learner: QLearning, seed: int) -> None:
    compare_with_twin(care, learner, seed)


@settings(max_examples=40)
@given(
    model=models(discounts=(Fraction(9, 10), Fraction(1))),
    method=st.sampled_from(METHODS),
    ties=st.sampled_from(TIES),
    seed=st.integers(0, 2**70),
)
def test_any_model_is_learned_as_the_twin_does(model, method: str, ties: str, seed: int) -> None:
    learner = QLearning(
        method=method, ties=ties, epochs=4, episodes=5, max_steps=20, snapshot_episode=2, last=8
    )
    compare_with_twin(model.model(), learner, seed)


def test_the_stream_is_known() -> None:
    """First words of xoshiro256++ from the state 1, 2, 3, 4, as its authors' program gives them."""
    draw = Stream([1, 2, 3, 4])
    known = [41943041, 58720359, 3588806011781223, 3591011842654386, 9228616714210784205]
    assert [draw() for _ in known] == [(word >> 11) / 2**53 for word in known]


# ---- the sampler ---------------------------------------------------------------------------------


@pytest.mark.parametrize("readings", [{}, OTHERS, {"skip_onset": "base"}], ids=str)
def test_alias_columns_are_the_exact_rows(readings: dict[str, str]) -> None:
    mdp = CARE.with_(readings=readings).compile()
    laid = tables(mdp, rows_of(mdp))
    for pair in range(mdp.n_pairs):
        first, last = laid.offsets[pair], laid.offsets[pair + 1]
        chances: dict[tuple[int, float], float] = {}
        for column in range(first, last):
            for side, share in ((0, laid.cut[column]), (1, 1 - laid.cut[column])):
                key = (int(laid.next[2 * column + side]), float(laid.gain[2 * column + side]))
                chances[key] = chances.get(key, 0.0) + share / (last - first)
        expected: dict[tuple[int, float], Fraction] = {}
        for chance, following, gain in mdp.table.row(pair):
            key = (following, float(gain))
            expected[key] = expected.get(key, Fraction(0)) + chance
        assert {key for key, share in chances.items() if share > 1e-14} <= set(expected)
        for key, chance in expected.items():
            assert abs(chances.get(key, 0.0) - float(chance)) < 1e-14


# ---- values of many policies ---------------------------------------------------------------------


@settings(max_examples=60)
@given(model=models(discounts=(Fraction(9, 10), Fraction(1))), seed=st.integers(0, 100))
def test_policy_values_of_any_model(model, seed: int) -> None:
    mdp = model.model()
    rows = rows_of(mdp)
    draw = np.random.default_rng(seed)
    policies = np.array(
        [[draw.choice(np.flatnonzero(row)) for row in rows.offered] for _ in range(3)]
    )
    values = policy_values(mdp, rows, policies)
    for policy, value, error in zip(policies, values.value, values.error, strict=True):
        exact = evaluate(mdp, Policy.from_choices(mdp, policy))
        assert abs(value - exact.mean) <= error + exact.start.error
