"""Training as the paper describes it, many times over (Section 3.2.4).

Q-learning over the 16 statuses, learning rate 0.05, discount 0.95, 6,000 epochs of 30 episodes, ε
constant at 0.1 or decaying (Equation 2). The paper trains once with each schedule; here each is
trained with many seeds, so that the outcome of one run can be told from chance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp import MDP, ModelError
from exact_mdp.analysis.learning.curves import LearningCurve, learning_curve
from exact_mdp.analysis.learning.outcomes import Outcomes, outcomes
from exact_mdp.solvers.learning.q_learning import QLearning, TrainingRun
from exact_mdp.solvers.learning.row_policies import common_rows, evaluate_row_policies
from exact_mdp.solvers.learning.schedules import PAPER_CONSTANT, PAPER_DECAYING, Constant
from exact_mdp.solvers.learning.training import train

SEED = 20250101  # of all training runs; any other would do
CURVES = 2**20  # the child of the seed that curves are drawn from
CONVERGED = 1000  # last epochs, over which a curve is averaged
SETTINGS = {
    "constant": QLearning(exploration=PAPER_CONSTANT),
    "decaying": QLearning(exploration=PAPER_DECAYING),
}
SHOWN = {"constant": "constant ε", "decaying": "decaying ε"}


def change_settings(schedule: str, changes: Mapping[str, Any]) -> QLearning:
    """Return the learner under an exploration schedule, with settings of `QLearning` changed.

    >>> change_settings("constant", {"ties": "random"}).ties
    'random'
    """
    changes = dict(changes)
    if "rate" in changes:
        changes["rate"] = Constant(float(changes["rate"]))
    try:
        return replace(SETTINGS[schedule], **changes)
    except TypeError as error:
        names = ", ".join(vars(SETTINGS[schedule]))
        raise ModelError(
            f"the learner has no such setting: {error}",
            where="training",
            fix=f"change one of {names}",
        ) from None


@dataclass(frozen=True, kw_only=True)
class Learned:
    """Training runs under one exploration schedule, with the exact values of final policies."""

    schedule: str
    runs: list[TrainingRun]
    outcomes: Outcomes

    @cached_property
    def values(self) -> np.ndarray:
        """(R, E) exact value of the greedy policy of every epoch of every run."""
        mdp, runs = self.outcomes.mdp, self.runs
        rows = common_rows(mdp, runs)
        return np.array(
            [evaluate_row_policies(mdp, rows, r.policies).value[r.snapshots] for r in runs]
        )

    @cached_property
    def converged(self) -> np.ndarray:
        """(R,) each run's mean over the last `CONVERGED` epochs."""
        return np.asarray(self.values[:, -CONVERGED:].mean(axis=1))

    @cached_property
    def final(self) -> np.ndarray:
        """(R, 16) final greedy policies, an action number for each status."""
        return np.asarray(self.outcomes.policies[self.outcomes.final])

    @cached_property
    def last(self) -> list[np.ndarray]:
        """For each run the different greedy policies of its last 100 episodes, (U, 16)."""
        return [run.policies[np.unique(run.last)] for run in self.runs]

    @property
    def drawn(self) -> LearningCurve:
        """The first run's curve as the paper draws it: 40 experiments each epoch."""
        source = spawn_seed(CURVES, list(SETTINGS).index(self.schedule))
        return learning_curve(self.outcomes.mdp, self.runs[0], rng=source)

    def find_common_actions(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (16,) the most frequent final action of each status, and its share of runs."""
        actions = self.outcomes.mdp.n_actions
        shares = np.stack([(self.final == a).mean(axis=0) for a in range(actions)], axis=1)
        return shares.argmax(axis=1), shares.max(axis=1)


def spawn_seed(*numbers: int) -> np.random.SeedSequence:
    """Return a descendant of the seed, the same however many there are."""
    return np.random.SeedSequence(SEED, spawn_key=numbers)


def train_learner(
    mdp: MDP, schedule: str, runs: int, *, folder: Path | None, changes: Mapping[str, Any]
) -> Learned:
    """Train with this many seeds; runs that the folder holds are not done again."""
    chosen = change_settings(schedule, changes)
    if folder is not None:
        # The folder is named after the model and the settings, so that other runs are not taken for
        # these.
        rows = np.concatenate([mdp.transition.data, mdp.reward]).tobytes()
        mark = sha256(rows + repr(chosen).encode()).hexdigest()[:12]
        folder = folder / f"{schedule}-{mark}"
    source = spawn_seed(list(SETTINGS).index(schedule))
    trained = train(mdp, chosen, runs, rng=source, n_jobs=None, out=folder)
    results = outcomes(mdp, trained, bound=False)
    return Learned(schedule=schedule, runs=trained, outcomes=results)
