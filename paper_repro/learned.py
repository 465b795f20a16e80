"""Training as the paper describes it, many times over: what its learning claims are held against.

Section 3.2.4 of Yuan et al. (2025): Q-learning over the 16 statuses, learning rate 0.05, discount
0.95, 6,000 epochs of 30 episodes, ε constant at 0.1 or decaying (Equation 2). The paper trains once
with each; here each is trained with many seeds, so that what one run shows can be told from chance.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from exact_mdp.analysis.learning.curves import (
    LearningCurve,
    exact_curves,
    learning_curve,
    random_curve,
)
from exact_mdp.analysis.learning.outcomes import Outcomes, outcomes
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.learning.q_learning import QLearning, TrainingRun
from exact_mdp.solvers.learning.sampler import child
from exact_mdp.solvers.learning.schedules import PAPER_CONSTANT, PAPER_DECAYING
from exact_mdp.solvers.learning.training import train_many

SCHEDULES = {"constant": PAPER_CONSTANT, "decaying": PAPER_DECAYING}
CONVERGED = 1000  # last epochs, over which a curve is averaged


@dataclass(frozen=True, kw_only=True, eq=False)
class Learned:
    """Training runs under one exploration schedule, judged by exact values.

    Attributes
    ----------
    schedule : str
    runs : list of TrainingRun
    outcomes : Outcomes
        Final policies with their exact values.
    seed : int
    """

    schedule: str
    runs: list[TrainingRun]
    outcomes: Outcomes
    seed: int

    @cached_property
    def values(self) -> Floats:
        """(R, E) exact value of the greedy policy of every epoch of every run."""
        return exact_curves(self.outcomes.mdp, self.runs)

    @cached_property
    def converged(self) -> Floats:
        """(R,) each run's mean over the last `CONVERGED` epochs."""
        return np.asarray(self.values[:, -CONVERGED:].mean(axis=1))

    @cached_property
    def drawn(self) -> LearningCurve:
        """The first run's curve as the paper draws it: 40 experiments each epoch."""
        number = list(SCHEDULES).index(self.schedule)
        seed = child(child(self.seed, 2**20), number)
        return learning_curve(self.outcomes.mdp, self.runs[0], rng=seed)

    @property
    def final(self) -> Integers:
        """(R, 16) final greedy policies, an action number for each status."""
        return np.asarray(self.outcomes.policies[self.outcomes.final])

    @property
    def chosen(self) -> Integers:
        """(R, 16) the policy that each run would select among its five most frequent."""
        return np.asarray(self.outcomes.policies[self.outcomes.selected])

    def common(self) -> tuple[Integers, Floats]:
        """Return (16,) the most frequent final action of each status, and its share of runs."""
        actions = self.outcomes.mdp.n_actions
        share = np.stack([(self.final == a).mean(axis=0) for a in range(actions)], axis=1)
        return share.argmax(axis=1), share.max(axis=1)


def settings(schedule: str) -> QLearning:
    """Return the paper's settings of Q-learning.

    Examples
    --------
    >>> settings("constant").epochs, settings("constant").episodes
    (6000, 30)
    """
    return QLearning(exploration=SCHEDULES[schedule])


def learn(mdp: MDP, schedule: str, *, runs: int, seed: int, folder: Path | None = None) -> Learned:
    """Train with so many seeds; runs that the folder holds are not done again."""
    number = list(SCHEDULES).index(schedule)
    trained = train_many(
        mdp, settings(schedule), runs, rng=child(seed, number), n_jobs=None, out=folder
    )
    return Learned(
        schedule=schedule, runs=trained, outcomes=outcomes(mdp, trained, bound=False), seed=seed
    )


def random_baseline(mdp: MDP, seed: int) -> LearningCurve:
    """Return the random strategy's curve: 40 experiments each epoch."""
    return random_curve(mdp, QLearning().epochs, rng=child(child(seed, 2**20), len(SCHEDULES)))
