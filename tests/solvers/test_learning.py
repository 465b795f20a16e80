"""Learning from samples: exact laws, many runs, and exact values of what was learned."""

import logging
import os
from fractions import Fraction as F
from itertools import pairwise
from math import exp, log, sqrt
from pathlib import Path

import joblib
import numpy as np
import pytest
from hypothesis import given, settings
from made_models import policy_by
from strategies import Rows, models

from exact_mdp import (
    MDP,
    Constant,
    Exponential,
    ModelError,
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

CARE = Scenario.load("yuan2025")
SHORT = QLearning(epochs=150)


@pytest.fixture(scope="module")
def care() -> MDP:
    return CARE.compile()


@pytest.fixture(scope="module")
def runs(care: MDP) -> list[TrainingRun]:
    return train(care, SHORT, 24, rng=3, n_jobs=2)


# ---- schedules -----------------------------------------------------------------------------------


def test_the_papers_schedules() -> None:
    decay = log(0.97 / 0.77) / 300
    decaying = Exponential.through(0.8, at=300, minimum=0.03)
    assert decaying.values(6000)[[0, 300]].tolist() == pytest.approx([1, 0.8], abs=1e-15)
    assert decaying.values(6000)[5999] == pytest.approx(0.03 + 0.97 * exp(-decay * 5999))
    assert set(QLearning().exploration.values(10)) == {0.1}


# ---- what learning must do -----------------------------------------------------------------------


def test_training_returns_are_those_of_the_exploring_policy(care: MDP) -> None:
    """With a rate of 0 the greedy policy stays, and the returns have its exact ε-greedy mean."""
    epsilon = 0.25
    run = QLearning(epochs=4000, rate=Constant(0.0), exploration=Constant(epsilon)).train(care, 2)
    table = np.full((16, 4), epsilon / 4)
    table[:, 0] += 1 - epsilon
    exact = evaluate(care, policy_by(care, ("status",), table))
    error = exact.sd / sqrt(4000 * 30)
    assert abs(run.returns.mean() - exact.mean) < 4 * error
    assert abs(run.steps / (4000 * 30) - exact.steps) < 0.05


# ---- many runs -----------------------------------------------------------------------------------

SMALL = QLearning(epochs=4)


def test_workers_and_number_of_runs_change_nothing(care: MDP, tmp_path: Path) -> None:
    alone = train(care, SMALL, 7, rng=0, n_jobs=1, out=tmp_path / "one")
    many = train(care, SMALL, 7, rng=0, n_jobs=3, out=tmp_path / "three")
    one, three = (sorted((tmp_path / name).iterdir()) for name in ("one", "three"))
    assert [(p.name, p.read_bytes()) for p in one] == [(p.name, p.read_bytes()) for p in three]
    few = train(care, SMALL, 2, rng=0)
    for a, b in [*zip(alone, many, strict=True), *zip(alone, few, strict=False)]:
        assert a.q.tobytes() == b.q.tobytes()
        assert np.array_equal(a.policies[a.snapshots], b.policies[b.snapshots])
    by_hand = SMALL.train(care, np.random.SeedSequence(0).spawn(6)[5])
    assert by_hand.q.tobytes() == alone[5].q.tobytes()
    assert all(a.q.tobytes() != b.q.tobytes() for a, b in pairwise(alone))


def test_a_dask_cluster_gives_the_same_bytes(care: MDP, tmp_path: Path) -> None:
    """By joblib's own backend; what is done in threads here goes there as well."""
    distributed = pytest.importorskip("distributed")
    alone = train(care, SMALL, 3, rng=0, out=tmp_path / "alone")
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
    )  # fmt: skip
    with cluster, distributed.Client(cluster), joblib.parallel_config(backend="dask"):
        runs = train(care, SMALL, 3, rng=0, n_jobs=None, out=tmp_path / "cluster")
    assert [run.q.tobytes() for run in runs] == [run.q.tobytes() for run in alone]
    one, other = (sorted((tmp_path / name).iterdir()) for name in ("alone", "cluster"))
    assert [(p.name, p.read_bytes()) for p in one] == [(p.name, p.read_bytes()) for p in other]


def test_finished_runs_are_kept_and_used_again(care: MDP, tmp_path: Path) -> None:
    fresh = train(care, SMALL, 8, rng=1)
    train(care, SMALL, 5, rng=1, out=tmp_path)
    files = sorted(tmp_path.glob("*.npz"))
    assert [path.name for path in files] == [f"runs-{number:06d}.npz" for number in range(5)]
    for path in files:
        os.utime(path, (0, 0))
    runs = train(care, SMALL, 8, rng=1, out=tmp_path)
    assert len(list(tmp_path.glob("*.npz"))) == 8
    assert all(path.stat().st_mtime == 0 for path in files)  # not worked out and written again
    for a, b in zip(runs, fresh, strict=True):
        assert (a.steps, a.cut_short, a.space) == (b.steps, b.cut_short, b.space)
        for name in ("q", "policies", "last", "returns"):
            assert np.array_equal(getattr(a, name), getattr(b, name)), name


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"rng": 2}, "seed"),
        ({"settings": QLearning(epochs=5)}, "settings"),
        ({"model": CARE.with_(tasks=[1]).compile()}, "model_hash"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_folder_of_another_training_is_refused(
    care: MDP, tmp_path: Path, changes: dict[str, object], named: str
) -> None:
    given = {"model": care, "settings": SMALL, "n": 1, "rng": 1, "out": tmp_path}
    train(**given)
    with pytest.raises(ModelError, match=named):
        train(**given | changes)


def test_a_damaged_file_is_named(care: MDP, tmp_path: Path) -> None:
    train(care, SMALL, 1, rng=1, out=tmp_path)
    path = tmp_path / "runs-000000.npz"
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ModelError, match="damaged") as refused:
        train(care, SMALL, 1, rng=1, out=tmp_path)
    assert refused.value.where == str(path)
    (listed,) = tmp_path.glob("*.json")
    for text, what in (("{", "broken JSON"), ("[]", "differs")):
        listed.write_text(text)
        with pytest.raises(ModelError, match=what):
            train(care, SMALL, 1, rng=1, out=tmp_path)
    with pytest.raises(ModelError, match="cannot make the folder"):
        train(care, SMALL, 1, rng=1, out=listed / "below")


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
        exact = evaluate(mdp, Policy.of(mdp, policy))
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
        values = {
            i: evaluate(care, policy_by(care, ("status",), run.policies[i])).mean for i in times
        }
        assert learned.value[number] >= max(values[i] for i in always or [run.last[-1]]) - 1e-9
        assert any(abs(learned.value[number] - value) < 1e-9 for value in values.values())


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
    assert curve.value[-1] == pytest.approx(evaluate(care, policy_by(care, ("status",), last)).mean)
    again = learning_curve(care, runs[0], rng=5)
    assert again.sampled.tobytes() == curve.sampled.tobytes()
    assert learning_curve(care, runs[0], rng=6).sampled.tobytes() != curve.sampled.tobytes()


def test_actions_may_be_more_than_16_bits_count(tmp_path: Path) -> None:
    names = tuple(f"a{number}" for number in range(40_000))
    rows = [(0, 39_998, [(1, 1, -1)]), (0, 39_999, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, "1/2", actions=names)
    for _ in range(2):  # the second time from the file
        (run,) = train(mdp, QLearning(epochs=5), 1, rng=0, out=tmp_path)
        assert run.final.tolist() == [39_999, 0]
        assert evaluate(mdp, run.policy(mdp)).mean == 1
