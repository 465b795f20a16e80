"""What learning ends with: exact values, curves, intervals, and an implementation of its own."""

from math import sqrt
from random import Random

import care_oracle
import numpy as np
import pytest

from exact_mdp import (
    MDP,
    Exponential,
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
        values = {
            i: evaluate(care, Policy.by(care, ("status",), run.policies[i])).mean for i in times
        }
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
    assert curve.value[-1] == pytest.approx(evaluate(care, Policy.by(care, ("status",), last)).mean)
    again = learning_curve(care, runs[0], rng=5)
    assert again.sampled.tobytes() == curve.sampled.tobytes()
    assert learning_curve(care, runs[0], rng=6).sampled.tobytes() != curve.sampled.tobytes()


# ---- an implementation of its own ----------------------------------------------------------------


def learn_alone(
    care: care_oracle.Oracle, settings: QLearning, seed: int
) -> tuple[list, list[float]]:
    """Q-learning on the independent implementation of the care model, by its own random numbers."""
    draw = Random(seed)
    laws: dict = {}
    q = {(s, a): 0.0 for s in range(16) for a in (*range(4), "skip")}
    returns = []

    def number(state: care_oracle.State) -> int:
        return 0 if state == care_oracle.END else int("".join(map(str, state[3])), 2)

    def law(state: care_oracle.State, action: str) -> tuple[list, list[float]]:
        if (state, action) not in laws:
            followed = care.outcomes(state, action)
            results = [(nxt, float(sum(earned.values()))) for _, nxt, earned, _ in followed]
            laws[state, action] = (results, [float(chance) for chance, *_ in followed])
        return laws[state, action]

    def options(state: care_oracle.State) -> list:
        names = care.actions(state)
        return ["skip"] if names == ("skip",) else list(range(4))

    for epsilon in settings.exploration.values(settings.epochs):
        total = 0.0
        for _ in range(settings.episodes):
            state = care.start
            while state != care_oracle.END:
                row, offered = number(state), options(state)
                if draw.random() < epsilon:
                    action = draw.choice(offered)
                else:
                    action = max(offered, key=lambda a: q[row, a])
                name = "skip" if action == "skip" else care_oracle.ACTIONS[action]
                results, chances = law(state, name)
                state, reward = draw.choices(results, chances)[0]
                total += reward
                ahead = 0.0
                if state != care_oracle.END:
                    ahead = max(q[number(state), a] for a in options(state))
                q[row, action] += 0.05 * (reward + 0.95 * ahead - q[row, action])
        returns.append(total / settings.episodes)
    greedy = [max(range(4), key=lambda a: q[s, a]) for s in range(16)]
    return [greedy, [q[0, a] for a in range(4)]], returns


@pytest.mark.parametrize(
    "readings",
    [
        {"influence_orientation": "column-to-row", "trial_cost": "failed-trials"},
        {"skip_timestep": "own", "task_bonus": "no-subtask-skipped", "skip_onset": "base"},
    ],
    ids=str,
)
def test_training_agrees_with_an_implementation_of_its_own(readings: dict[str, str]) -> None:
    """On seeds and readings used nowhere else: returns, values and policies, in distribution."""
    learner = QLearning(epochs=40, exploration=Exponential(minimum=0.05, decay=0.1))
    count = 24
    scenario = Scenario.load("yuan2025").with_(readings=readings, tasks=[1, 1])
    ours = train(scenario.compile(), learner, 8 * count, rng=90210)
    care = care_oracle.Oracle(readings, tasks=[1, 1])
    theirs = [learn_alone(care, learner, 77_000 + number) for number in range(count)]

    def z(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
        spread = ours.var(axis=0, ddof=1) / len(ours) + theirs.var(axis=0, ddof=1) / len(theirs)
        return (ours.mean(axis=0) - theirs.mean(axis=0)) / np.sqrt(spread + 1e-12)

    halves = (slice(0, 20), slice(20, 40))
    mine = np.array([[run.returns[half].mean() for half in halves] for run in ours])
    others = np.array([[np.mean(returns[half]) for half in halves] for _, returns in theirs])
    assert (np.abs(z(mine, others)) < 4).all()
    values = np.array([run.q[0, :4] for run in ours])
    assert (np.abs(z(values, np.array([learned[1] for learned, _ in theirs]))) < 4).all()
    for action in range(4):
        share = np.array([run.final[0] == action for run in ours]).mean()
        other = np.mean([learned[0][0] == action for learned, _ in theirs])
        pooled = (share * 8 + other) / 9
        assert abs(share - other) < 4 * sqrt(pooled * (1 - pooled) * (9 / 8) / count) + 1e-9


def test_outcomes_of_costs_are_those_of_rewards_times_minus_one() -> None:
    rows, costs = [[[0, 1], [0, 1]], [[0, 1], [0, 1]]], np.array([[1, 3], [0, 0]])
    paid = MDP.from_arrays(rows, costs, layout="ass", sense="min")
    earned = MDP.from_arrays(rows, -costs, layout="ass")
    learned = [
        outcomes(each, train(each, QLearning(epochs=2), 12, rng=1)) for each in (paid, earned)
    ]
    for name in ("regret", "selected_regret", "learning_error"):
        assert getattr(learned[0], name).tolist() == getattr(learned[1], name).tolist()
        assert getattr(learned[0], name).min() >= 0
    assert learned[0].optimal_fraction == learned[1].optimal_fraction
