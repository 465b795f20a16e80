"""Learning from samples: exact laws, known convergence, and many runs."""

import os
from itertools import pairwise
from math import exp, log, sqrt
from pathlib import Path

import numpy as np
import pytest
from model_contents import by

from exact_mdp import (
    MDP,
    Constant,
    Exponential,
    ModelError,
    QLearning,
    Scenario,
    evaluate,
    train,
)

CARE = Scenario.load("yuan2025")


@pytest.fixture(scope="module")
def care() -> MDP:
    return CARE.compile()


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
    exact = evaluate(care, by(care, ("status",), table))
    error = exact.sd / sqrt(4000 * 30)
    assert abs(run.returns.mean() - exact.mean) < 4 * error
    assert abs(run.steps / (4000 * 30) - exact.steps) < 0.05


def test_a_start_distribution_is_drawn_from() -> None:
    rows = [(state, 0, [(1, 2, state)]) for state in range(2)] + [(2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(rows, start={0: "1/4", 1: "3/4"})
    run = QLearning(epochs=200).train(mdp, 0)
    assert abs(run.returns.mean() - 0.75) < 4 * sqrt(0.75 * 0.25 / 6000)


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


def test_actions_may_be_more_than_16_bits_count(tmp_path: Path) -> None:
    names = tuple(f"a{number}" for number in range(40_000))
    rows = [(0, 39_998, [(1, 1, -1)]), (0, 39_999, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, "1/2", actions=names)
    for _ in range(2):  # the second time from the file
        (run,) = train(mdp, QLearning(epochs=5), 1, rng=0, out=tmp_path)
        assert run.final.tolist() == [39_999, 0]
        assert evaluate(mdp, run.policy(mdp)).mean == 1


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
