"""Runs side by side: each is that of its own child of the seed, whatever is done beside it."""

from pathlib import Path

import numpy as np
import pytest

from exact_mdp import ModelError, QLearning, Scenario, train
from exact_mdp.solvers.learning.sampler import spawn_child_seed

MODEL = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
LEARNER = QLearning(epochs=3)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_run_is_that_of_its_child(jobs: int, tmp_path: Path) -> None:
    runs = train(MODEL, LEARNER, 3, rng=5, n_jobs=jobs, out=tmp_path)
    again = train(MODEL, LEARNER, 4, rng=5, out=tmp_path)  # three of them are read
    for number, run in enumerate(again):
        alone = LEARNER.train(MODEL, spawn_child_seed(5, number))
        for name in ("q", "policies", "returns"):
            assert np.array_equal(getattr(run, name), getattr(alone, name))
            if number < 3:
                assert np.array_equal(getattr(runs[number], name), getattr(alone, name))
    assert not np.array_equal(runs[0].q, runs[1].q)
    with pytest.raises(ModelError):
        train(MODEL, LEARNER, 1, rng=6, out=tmp_path)
