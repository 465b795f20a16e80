"""The project's own gate: Q-learning ends near the exact optimum, a broken policy is refused.

The limits were set after looking at these seeds, to notice a change; they are no statement about
other seeds. Over 1,000 seeds of training as the paper does, 5 % lose more than 10.7.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from exact_mdp.analysis import assert_policy_optimal, check
from exact_mdp.analysis.cli import main
from exact_mdp.mdp import MDP, Scenario
from exact_mdp.solvers.learning.q_learning import QLearning
from exact_mdp.solvers.learning.schedules import Constant

SEEDS = range(6)
AS_THE_PAPER = QLearning()
BY_VISITS = QLearning(rate=Constant(1.0), rate_power=0.6)


@pytest.fixture(scope="module")
def care() -> MDP:
    return Scenario.load("yuan2025").compile()


@pytest.mark.parametrize("seed", SEEDS)
def test_training_as_the_paper_does_ends_within_six_per_cent(care: MDP, seed: int) -> None:
    assert_policy_optimal(care, AS_THE_PAPER.train(care, seed).q, max_regret=8.0)


def test_rates_that_fall_with_visits_end_within_one_per_cent_but_for_one_seed(care: MDP) -> None:
    passed = {
        seed: check(care, BY_VISITS.train(care, seed).q, max_regret=1.4).passed
        for seed in range(12)
    }
    assert [seed for seed, within in passed.items() if not within] == [0]  # it loses 4.54


def test_a_broken_policy_is_refused(
    care: MDP, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    q = BY_VISITS.train(care, 3).q.copy()
    np.save(tmp_path / "learned.npy", q)
    words = ["check", "yuan2025", str(tmp_path / "learned.npy"), "--max-regret", "1.4"]
    assert main(words) == 0
    q[0b0001, 0] = q.max() + 1  # leaves a disengaged person alone
    np.save(tmp_path / "learned.npy", q)
    assert main(words) == 1
    assert "status 0001" in capsys.readouterr().out
    audit = check(care, q, max_regret=1.4)
    assert not audit.passed
    worst = [care.space.label(found.state) for found in audit.disagreements[:3]]
    assert all("status 0001" in label for label in worst)
