"""What learning ends with: exact values, and curves."""

from fractions import Fraction as F
from math import sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from model_contents import by
from strategies import Rows, models

from exact_mdp import (
    MDP,
    Policy,
    QLearning,
    Scenario,
    TrainingRun,
    evaluate,
    learning_curve,
    outcomes,
    solve,
    train,
)

SHORT = QLearning(epochs=150)


@pytest.fixture(scope="module")
def care() -> MDP:
    return Scenario.load("yuan2025").compile()


@pytest.fixture(scope="module")
def runs(care: MDP) -> list[TrainingRun]:
    return train(care, SHORT, 24, rng=3, n_jobs=2)


# ---- outcomes ------------------------------------------------------------------------------------


def test_outcomes_are_exact_values_of_what_was_learned(care: MDP, runs: list[TrainingRun]) -> None:
    learned = outcomes(care, runs)
    best = solve(care).start_value
    for run, regret, final in zip(runs, learned.regret, learned.final, strict=True):
        assert np.array_equal(learned.policies[final], run.final)
        greedy = Policy.of(care, run.q, kind="q")
        assert np.array_equal(greedy.table.argmax(axis=1), run.final)
        assert regret == pytest.approx(best - evaluate(care, greedy).mean, abs=1e-9)
    assert learned.counts.sum() == len(runs)
    assert (np.diff(learned.counts[learned.counts > 0]) <= 0).all()
    for row in range(16):
        taken = [run.final[row] for run in runs]
        assert learned.choices(row).tolist() == [taken.count(action) for action in range(4)]


@settings(max_examples=60)
@given(models(discounts=(F(9, 10), F(1))))
def test_values_of_many_policies_of_any_model(model: Rows) -> None:
    mdp = model.model()
    learner = QLearning(epochs=2, episodes=2, snapshot_episode=0, last=4)
    learned = outcomes(mdp, train(mdp, learner, 3, rng=0))
    for policy, value, error in zip(learned.policies, learned.value, learned.error, strict=True):
        exact = evaluate(mdp, Policy.from_choices(mdp, policy))
        assert abs(value - exact.mean) <= error + exact.start.error


def test_the_last_episodes_are_counted(care: MDP, runs: list[TrainingRun]) -> None:
    learned = outcomes(care, runs)
    for run, distinct, changed in zip(runs, learned.distinct, learned.changed, strict=True):
        recent = {tuple(run.policies[number]) for number in run.last}
        assert len(recent) == distinct
        columns = list(zip(*recent, strict=True))
        assert changed.tolist() == [len(set(column)) > 1 for column in columns]


def test_the_selected_policy_is_the_best_of_the_five_most_frequent(
    care: MDP, runs: list[TrainingRun]
) -> None:
    learned = outcomes(care, runs)
    for run, number in zip(runs, learned.selected, strict=True):
        counts = sorted(run.last_counts().values(), reverse=True)
        assert sum(counts) == SHORT.last
        times = {i: int((run.last == i).sum()) for i in set(run.last.tolist())}
        fifth = (counts + [0] * 5)[4]
        always = [i for i, count in times.items() if count > fifth]
        values = {i: evaluate(care, by(care, ("status",), run.policies[i])).mean for i in times}
        assert learned.value[number] >= max(values[i] for i in always or [run.last[-1]]) - 1e-9
        assert any(abs(learned.value[number] - value) < 1e-9 for value in values.values())


def test_an_optimal_policy_has_no_regret() -> None:
    """Two actions that are equally good: whatever is learned is optimal."""
    rows = [(0, a, [("1/3", 1, 3), ("2/3", 1, 0)]) for a in range(2)]
    mdp = MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])
    learned = outcomes(mdp, train(mdp, QLearning(epochs=10), 10, rng=0))
    assert learned.regret.tolist() == [0.0] * 10
    assert learned.optimal_fraction == learned.best_fraction == 1.0
    assert learned.best is None
    assert learned.regret_interval == (0.0, 0.0)


def test_reading_less_is_told_from_learning_badly() -> None:
    """One action for all states cannot be optimal; the learner is not to blame for that."""
    rows = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 2, 0)]), (1, 1, [(1, 2, 3)])]
    mdp = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])])
    learned = outcomes(mdp, train(mdp, QLearning(epochs=50, columns=()), 10, rng=0))
    assert learned.optimum.value == 4
    assert learned.best_value.value == 3
    assert learned.regret.tolist() == [1.0] * 10
    assert learned.learning_error.tolist() == [0.0] * 10
    assert (learned.optimal_fraction, learned.best_fraction) == (0.0, 1.0)


# ---- curves --------------------------------------------------------------------------------------


def test_curves_show_the_same_with_and_without_noise(care: MDP, runs: list[TrainingRun]) -> None:
    curve = learning_curve(care, runs[0], rng=5)
    assert len(curve.sampled) == SHORT.epochs
    assert curve.experiments == 40
    error = curve.standard_error
    assert abs((curve.sampled - curve.value).sum()) < 4 * sqrt((error**2).sum())
    assert 0.8 < ((curve.sampled - curve.value) ** 2).sum() / (error**2).sum() < 1.25
    last = runs[0].policies[runs[0].snapshots[-1]]
    assert curve.value[-1] == pytest.approx(evaluate(care, by(care, ("status",), last)).mean)
    again = learning_curve(care, runs[0], rng=5)
    assert again.sampled.tobytes() == curve.sampled.tobytes()
    assert learning_curve(care, runs[0], rng=6).sampled.tobytes() != curve.sampled.tobytes()
