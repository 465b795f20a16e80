"""The fixed point of Q-learning under aggregation, its noise, and what they predict."""

from collections import defaultdict
from fractions import Fraction

import numpy as np
import oracle
import pytest

from exact_mdp.analysis.learning.instability import compare, predict
from exact_mdp.analysis.learning.outcomes import outcomes
from exact_mdp.mdp import MDP, ModelError, Scenario
from exact_mdp.solvers import solve
from exact_mdp.solvers.learning.mean_field import MeanField, mean_field, settle
from exact_mdp.solvers.learning.q_learning import QLearning
from exact_mdp.solvers.learning.sampler import rows_of
from exact_mdp.solvers.learning.schedules import Constant
from exact_mdp.solvers.learning.training import train_many

CARE = Scenario.load("yuan2025")
SETTLED = [2, 1, 1, 1, 3, 1, 1, 1, 3, 1, 1, 1, 3, 1, 1, 1]


@pytest.fixture(scope="module")
def care() -> MDP:
    return CARE.compile()


@pytest.fixture(scope="module")
def field(care: MDP) -> MeanField:
    return settle(care, [3] * 16, epsilon=0.1)


# ---- the fixed point -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "readings",
    [{}, {"skip_timestep": "own"}, {"task_bonus": "no-subtask-skipped", "status_cost": "current"}],
    ids=str,
)
def test_nothing_moves_on_average(readings: dict[str, str]) -> None:
    """Exact visits and temporal differences in fractions, from the independent implementation."""
    mdp = CARE.with_(readings=readings, tasks=[2], max_trial=2).compile()
    found = settle(mdp, [3] * 16, epsilon=0.1)
    assert found.consistent
    care = oracle.Oracle(readings, tasks=[2], max_trial=2)
    epsilon, discount = Fraction(1, 10), Fraction(19, 20)

    def row(state: oracle.State) -> int:
        return int("".join(map(str, state[3])), 2)

    def actions(state: oracle.State) -> list[tuple[int, str, Fraction]]:
        if care.actions(state) == ("skip",):
            return [(4, "skip", Fraction(1))]
        return [
            (a, name, epsilon / 4 + (1 - epsilon) * (a == found.policy[row(state)]))
            for a, name in enumerate(oracle.ACTIONS)
        ]

    mass: dict[oracle.State, Fraction] = {care.start: Fraction(1)}
    moved: dict[tuple[int, int], Fraction] = defaultdict(Fraction)
    often: dict[tuple[int, int], Fraction] = defaultdict(Fraction)
    q = [[Fraction(float(x)) if x == x else Fraction(0) for x in line] for line in found.q]
    while mass:
        ahead: dict[oracle.State, Fraction] = defaultdict(Fraction)
        for state, weight in mass.items():
            for action, name, share in actions(state):
                for chance, following, rewards, _ in care.outcomes(state, name):
                    flow = weight * share * chance
                    target = sum(rewards.values(), Fraction(0))
                    if following != oracle.END:
                        target += discount * max(
                            q[row(following)][a] for a, *_ in actions(following)
                        )
                        ahead[following] += flow
                    moved[row(state), action] += flow * (target - q[row(state)][action])
                    often[row(state), action] += flow
        mass = ahead
    for (state, action), total in often.items():
        assert found.updates[state, action] == pytest.approx(float(total), rel=1e-12)
        # What is left over is due to the errors that the solution states, of this entry and others.
        limit = (found.error[state, action] + np.max(found.error[np.isfinite(found.error)])) * total
        assert abs(moved[state, action]) <= limit
    never = {(s, a) for s, a in np.argwhere(np.isnan(found.q)).tolist()}
    assert never.isdisjoint(often)


def test_the_care_models_fixed_point(field: MeanField) -> None:
    assert field.policy.tolist() == SETTLED
    assert field.consistent
    assert np.nanmax(field.error) < 1e-7
    assert field.gaps[0].round(2).tolist() == [9.31, 4.34, 0.0, 1.52]


def test_reading_everything_it_is_the_optimum() -> None:
    """Without aggregation the fixed point is Q*, whatever is explored."""
    mdp = CARE.with_(tasks=[1], max_trial=3, discount="19/20").compile()
    first = rows_of(mdp, mdp.space.names).offered.argmax(axis=1)
    found = settle(mdp, first, epsilon=0.3, columns=mdp.space.names)
    assert found.consistent
    optimum = solve(mdp)
    exact = np.full(found.q.shape, np.nan)
    exact[mdp.pair_state, mdp.pair_action] = mdp.backup(optimum.value)
    known = ~np.isnan(found.q)
    assert known.sum() > 100
    assert np.abs(found.q - exact)[known].max() < 1e-9


def test_beyond_the_end_it_goes_on_where_that_is_asked_for(care: MDP, field: MeanField) -> None:
    beyond = settle(care, SETTLED, epsilon=0.1, bootstrap_end=True)
    assert beyond.q[0, 2] > 5 * field.q[0, 2]
    run = QLearning(epochs=1500, bootstrap_end=True).train(care, 0)
    assert abs(run.q[0].max() - beyond.q[0].max()) < 5 * beyond.spread(0.05)[0].max()


def test_a_held_row_keeps_its_action(care: MDP) -> None:
    found = settle(care, [1] * 16, epsilon=0.1, held=[0])
    assert found.policy[0] == 1
    assert not found.consistent
    assert found.greedy[0] == 2


# ---- the noise -----------------------------------------------------------------------------------


def test_the_noise_by_second_moments(care: MDP, field: MeanField) -> None:
    """E[XXᵀ] of X, the sum of temporal differences by entry, state by state from the end."""
    q, n_actions = np.nan_to_num(field.q), care.n_actions
    size, key = q.size, field.rows.key
    mean, second = np.zeros((care.n_states, size)), np.zeros((care.n_states, size, size))
    for state in range(care.n_states - 2, -1, -1):
        for pair in care.pairs_of(state):
            action = care.pair_action[pair]
            share = 0.025 + 0.9 * (action == field.policy[key[state]])
            entry = key[state] * n_actions + action
            for chance, following, gain in care.table.row(pair):
                p = float(chance) * share
                ahead = 0.0 if care.terminal[following] else 0.95 * q[key[following]].max()
                delta = float(gain) + ahead - q[key[state], action]
                mean[state, entry] += p * delta
                mean[state] += p * mean[following]
                second[state] += p * second[following]
                second[state, entry] += p * delta * mean[following]
                second[state, :, entry] += p * delta * mean[following]
                second[state, entry, entry] += p * delta * delta
    expected = second[0] - np.outer(mean[0], mean[0])
    assert np.abs(mean[0]).max() < 1e-9
    used = field.used
    assert np.abs(field.noise - expected[np.ix_(used, used)]).max() < 1e-8


def test_the_covariance_solves_its_equation(field: MeanField) -> None:
    covariance = field.covariance(0.05)
    step = np.eye(len(covariance)) + 0.05 * field.jacobian
    rest = step @ covariance @ step.T + 0.05**2 * field.noise - covariance
    assert np.abs(rest).max() < 1e-9
    assert np.linalg.eigvalsh(covariance).min() > -1e-9


def test_a_coins_noise_is_known_and_simulated() -> None:
    """Q ← Q + α (x - Q), x = ±1: the variance is α / (2 - α), to all orders."""
    rate = 0.2
    mdp = MDP.from_outcomes([(0, 0, [("1/2", 1, 1), ("1/2", 1, -1)]), (1, 0, [(1, 1, 0)])])
    found = mean_field(mdp, [0, 0], epsilon=0.5)
    assert found.q[0, 0] == 0
    assert np.isnan(found.q[1, 0])
    assert found.spread(rate)[0, 0] ** 2 == pytest.approx(rate / (2 - rate))
    learner = QLearning(epochs=4, rate=Constant(rate), last=1, snapshot_episode=0)
    values = np.array([run.q[0, 0] for run in train_many(mdp, learner, 1500, rng=0)])
    assert values.var() == pytest.approx(rate / (2 - rate), rel=0.15)
    assert abs(values.mean()) < 4 * values.std() / np.sqrt(1500)


def test_a_rate_that_does_not_settle_is_refused(field: MeanField) -> None:
    with pytest.raises(ModelError, match="not stable"):
        field.covariance(2.5)


# ---- what they predict ---------------------------------------------------------------------------


def test_the_predicted_shares_are_those_of_training(care: MDP) -> None:
    """The greedy action in 0000 over held-out seeds, against a theory that samples no episode."""
    learner = QLearning(epochs=1500)
    theory = predict(care, learner, row=0, policy=SETTLED, n=64, episodes=4000)
    assert theory.label == "status 0000"
    runs = train_many(care, learner, 160, rng=4242, n_jobs=2)
    counts = outcomes(care, runs, bound=False).choices(0)
    switching, linear = compare(theory.switching, counts), compare(theory.linear, counts)
    assert switching.distance < 2.5 * switching.noise
    assert linear.distance < 0.2
    assert theory.switching.sum() == pytest.approx(1)
    assert theory.linear.sum() == pytest.approx(1)
    assert (theory.spread > theory.gaps)[1:].all()


def test_a_comparison_by_hand() -> None:
    found = compare(np.array([0.25, 0.75]), np.array([10, 10]))
    assert found.distance == 0.25
    assert 0.05 < found.noise < 0.1
    assert found.intervals[0] == pytest.approx((0.299, 0.701), abs=1e-3)


@pytest.mark.parametrize(
    "settings",
    [{"method": "sarsa"}, {"rate_power": 0.5}],
    ids=str,
)
def test_learners_without_theory_are_refused(care: MDP, settings: dict[str, object]) -> None:
    with pytest.raises(ModelError, match="no theory"):
        predict(care, QLearning(epochs=1, **settings))


def test_rows_that_are_never_visited_are_refused(care: MDP) -> None:
    with pytest.raises(ModelError, match="never taken"):
        predict(care, QLearning(epochs=1, exploration=Constant(0.0)), policy=SETTLED)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"policy": [0] * 15}, "shape"),
        ({"policy": [4] * 16}, "not offered"),
        ({"policy": SETTLED, "epsilon": 1.5}, "epsilon"),
        ({"policy": SETTLED, "discount": 2}, "discount"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_bad_arguments_are_refused(care: MDP, arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        mean_field(care, **{"epsilon": 0.1} | arguments)


def test_an_episode_that_need_not_end_is_refused() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 0, 0)])], discount="9/10")
    with pytest.raises(ModelError, match="may not"):
        mean_field(mdp, [0], epsilon=0.1)
