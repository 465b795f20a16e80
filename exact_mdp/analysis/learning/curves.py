"""Learning curves, drawn twice: by experiment, as the authors do, and exactly.

A point of a curve is the mean return of 40 experiments with the greedy policy of an epoch (Yuan et
al. 2025, "Evaluation Metrics"). The second curve is the exact value of the same policy, which those
experiments estimate; its remaining noise comes from learning alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import Floats
from exact_mdp.mdp.validate import require_count
from exact_mdp.solvers.claims import Claim
from exact_mdp.solvers.learning.q_learning import TrainingRun
from exact_mdp.solvers.learning.row_policies import common_rows, evaluate_row_policies
from exact_mdp.solvers.learning.sampler import (
    Seed,
    build_q_table_rows,
    build_sampling_tables,
    make_random_stream,
    spawn_child_seed,
)

EXPERIMENTS = 40  # behind each point of a curve, as in Yuan et al. (2025)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LearningCurve(Pictured):
    """Mean returns of the greedy policies of E epochs, by experiment and exact."""

    sampled: Floats  # (E,) the mean of `sample_epoch_returns` returns
    standard_error: Floats
    value: Floats  # (E,) of the same policy, up to rounding
    error: Floats
    experiments: int
    cut_short: int  # experiments that did not end; they are counted as far as they went

    claim: ClassVar[Claim] = Claim.ESTIMATED  # of the experiments; the exact values are bounded

    def __repr__(self) -> str:
        return f"LearningCurve({len(self.value)} epochs, {self.experiments} experiments in each)"

    def frame(self) -> DataFrame:
        """Return one row for each epoch."""
        return data_frame(
            {
                "exact value (reward)": self.value,
                "mean of experiments (reward)": self.sampled,
                "standard error (reward)": self.standard_error,
            }
        ).rename_axis("epoch")


def learning_curve(
    model: MDP, run: TrainingRun, *, rng: Seed, n: int = EXPERIMENTS
) -> LearningCurve:
    """Return the curve of one run: each epoch's greedy policy, simulated and evaluated exactly.

    Parameters
    ----------
    model : MDP
    run : TrainingRun
    rng : int, numpy.random.Generator or SeedSequence
    n : int
        Experiments with each policy.

    Returns
    -------
    LearningCurve

    Raises
    ------
    ModelError
        For a run on another model, or fewer than two experiments.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.solvers.learning.q_learning import QLearning
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> curve = learning_curve(mdp, QLearning(epochs=50).train(mdp, rng=0), rng=1)
    >>> curve.value.shape, bool(abs(curve.sampled - curve.value).mean() < 15)
    ((50,), True)
    """
    values = evaluate_row_policies(model, common_rows(model, [run]), run.policies)
    returns, cut_short = sample_epoch_returns(model, run, rng=rng, n=n)
    return LearningCurve(
        sampled=returns.mean(axis=1),
        standard_error=returns.std(axis=1, ddof=1) / np.sqrt(returns.shape[1]),
        value=values.value[run.snapshots],
        error=values.error[run.snapshots],
        experiments=returns.shape[1],
        cut_short=cut_short,
    )


def sample_epoch_returns(
    model: MDP, run: TrainingRun | int, *, rng: Seed, n: int = EXPERIMENTS
) -> tuple[Floats, int]:
    """Return (E, n) returns with the greedy policies of a run's E epochs, and how many are cut.

    If a number of epochs is given instead of a run, actions are drawn uniformly.
    """
    # Scores whose greedy actions are the policies; drawn uniformly, scores do not matter.
    if random := isinstance(run, int):
        rows, which = build_q_table_rows(model), np.zeros(run, dtype=np.int64)
        table = np.zeros((1, rows.offered.size))
    else:
        rows, which = build_q_table_rows(model, run.space.names), run.snapshots.astype(np.int64)
        table = np.eye(model.n_actions)[run.policies].reshape(len(run.policies), -1)
    returns = np.zeros((len(which), require_count(n, "n", 2)))
    from exact_mdp.solvers.kernels import learning as kernels

    laid_out, source, cut_short = (
        build_sampling_tables(model, rows),
        make_random_stream(spawn_child_seed(rng, 0)),
        0,
    )
    for row in range(len(which)):  # one after the other, so that they can be interrupted
        here = slice(row, row + 1)
        more = kernels.sample_returns(
            laid_out,
            source,
            table,
            which[here],
            float(random),
            model.discount,
            10_000,  # timesteps, after which an experiment is cut short
            returns[here],
        )
        cut_short += int(more)
    return returns, cut_short


def average_epochs(values: Floats, window: int) -> tuple[Floats, Floats]:
    """Return the middle of each window of epochs, and the mean of the values in it."""
    size = min(window, len(values))
    means: Floats = np.convolve(values, np.full(size, 1 / size), mode="valid").astype(float)
    middles: Floats = np.arange(len(means), dtype=float) + (size - 1) / 2
    return middles, means
