"""Learning curves, drawn twice: by experiment, as the authors do, and exactly.

A point of a curve is the mean return of 40 experiments with the greedy policy of an epoch (Yuan et
al. 2025, "Evaluation Metrics"). Beside it stands what those experiments estimate, the exact value
of the same policy; what is left of the noise in that curve comes from learning alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exact_mdp.analysis.learning.outcomes import common_rows
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.mdp.validate import counted
from exact_mdp.solvers.learning.q_learning import TrainingRun
from exact_mdp.solvers.learning.sampler import Seed, child, rows_of, stream, tables
from exact_mdp.solvers.values.evaluate import evaluate
from exact_mdp.solvers.values.layers import policy_values

EXPERIMENTS = 40
MAX_STEPS = 10_000  # an experiment is cut short after this many timesteps


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LearningCurve(Pictured):
    """Mean returns of the greedy policies of E epochs, by experiment and exact."""

    sampled: Floats  # (E,) the mean of `experiments` returns
    standard_error: Floats
    value: Floats  # (E,) of the same policy, up to rounding
    error: Floats
    experiments: int
    cut_short: int  # experiments that did not end; they are counted as far as they went

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
    """Return the curve of one run: each epoch's greedy policy, tried and evaluated exactly.

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
    values = policy_values(model, common_rows(model, [run]), run.policies)
    table = np.eye(model.n_actions)[run.policies].reshape(len(run.policies), -1)
    value, error = values.value[run.snapshots], values.error[run.snapshots]
    return _curve(model, run.space.names, table, run.snapshots, value, error, n, rng)


def random_curve(model: MDP, epochs: int, *, rng: Seed, n: int = EXPERIMENTS) -> LearningCurve:
    """Return the same curve for actions drawn uniformly, the authors' baseline."""
    mean, nothing = evaluate(model, "random"), np.zeros((1, rows_of(model).offered.size))
    value, error = np.full((2, epochs), [[mean.mean], [mean.start.error]])
    return _curve(model, None, nothing, np.zeros(epochs), value, error, n, rng)


def exact_curves(model: MDP, runs: Sequence[TrainingRun]) -> Floats:
    """Return (R, E) exact values of the greedy policy of every epoch of every run."""
    rows = common_rows(model, runs)
    curves = [policy_values(model, rows, run.policies).value[run.snapshots] for run in runs]
    return np.array(curves)


def _curve(
    model: MDP,
    columns: Sequence[str] | None,
    table: Floats,
    which: Numbers,
    value: Floats,
    error: Floats,
    n: int,
    rng: Seed,
) -> LearningCurve:
    """Return the curve of the policies `which` of a table, which act at random without columns."""
    n = counted(n, "n", 2)
    returns = np.zeros((len(which), n))
    from exact_mdp.solvers.kernels import learning as kernels

    cut_short = kernels.rollouts(
        tables(model, rows_of(model, columns)),
        stream(child(rng, 0)),
        table,
        np.ascontiguousarray(which, dtype=np.int64),
        float(columns is None),
        model.discount,
        MAX_STEPS,
        returns,
    )
    return LearningCurve(
        sampled=returns.mean(axis=1),
        standard_error=returns.std(axis=1, ddof=1) / np.sqrt(n),
        value=value,
        error=error,
        experiments=n,
        cut_short=int(cut_short),
    )
