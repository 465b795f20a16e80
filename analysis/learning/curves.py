"""Learning curves, drawn twice: by experiment, as the authors do, and exactly.

A point of a curve is the mean return of 40 experiments with the greedy policy of an epoch (Yuan et
al. 2025, "Evaluation Metrics"). Beside it stands what those experiments estimate, the exact value
of the same policy; what is left of the noise in that curve comes from learning alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import SeedSequence

from exact_mdp.analysis.learning.outcomes import common_rows
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers import evaluate
from exact_mdp.solvers.learning.q_learning import TrainingRun
from exact_mdp.solvers.learning.sampler import Rows, child, rows_of, scores, stream, tables
from exact_mdp.solvers.values.policy_values import policy_values

EXPERIMENTS = 40


@dataclass(frozen=True, kw_only=True, eq=False)
class LearningCurve:
    """Mean returns of the greedy policies of E epochs, by experiment and exact.

    Attributes
    ----------
    sampled, standard_error : (E,)
        Mean of `experiments` sampled returns, and its standard error.
    exact, error : (E,)
        Value of the same policy, up to rounding.
    cut_short : int
        Experiments that did not end; they are counted as far as they went.
    """

    sampled: Floats
    standard_error: Floats
    exact: Floats
    error: Floats
    experiments: int
    cut_short: int


def learning_curve(
    mdp: MDP,
    run: TrainingRun,
    *,
    seed: int | SeedSequence,
    experiments: int = EXPERIMENTS,
    max_steps: int = 10_000,
) -> LearningCurve:
    """Return the curve of one run: each epoch's greedy policy, tried and evaluated exactly.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.solvers.learning.q_learning import QLearning
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> curve = learning_curve(mdp, QLearning(epochs=50).train(mdp, seed=0), seed=1)
    >>> curve.exact.shape, bool(abs(curve.sampled - curve.exact).mean() < 15)
    ((50,), True)
    """
    rows = common_rows(mdp, [run])
    values = policy_values(mdp, rows, run.policies)
    table = scores(run.policies, mdp.n_actions)
    return _curve(
        mdp,
        rows,
        table,
        run.snapshots,
        values.value[run.snapshots],
        values.error[run.snapshots],
        0.0,
        (experiments, max_steps),
        seed,
    )


def random_curve(
    mdp: MDP,
    epochs: int,
    *,
    seed: int | SeedSequence,
    experiments: int = EXPERIMENTS,
    max_steps: int = 10_000,
) -> LearningCurve:
    """Return the same curve for actions drawn uniformly, the authors' baseline."""
    rows = rows_of(mdp)
    exact = evaluate(mdp, "random")
    which = np.zeros(epochs, dtype=np.int64)
    return _curve(
        mdp,
        rows,
        np.zeros((1, rows.offered.size)),
        which,
        np.full(epochs, exact.mean),
        np.full(epochs, exact.error_bound),
        1.0,
        (experiments, max_steps),
        seed,
    )


def exact_curves(mdp: MDP, runs: Sequence[TrainingRun]) -> Floats:
    """Return (R, E) exact values of the greedy policy of every epoch of every run."""
    rows = common_rows(mdp, runs)
    found = [policy_values(mdp, rows, run.policies).value[run.snapshots] for run in runs]
    return np.array(found)


def _curve(
    mdp: MDP,
    rows: Rows,
    table: Floats,
    which: Numbers,
    exact: Floats,
    error: Floats,
    chance: float,
    sizes: tuple[int, int],
    seed: int | SeedSequence,
) -> LearningCurve:
    from exact_mdp.solvers import kernels

    experiments, max_steps = sizes
    if experiments < 2:
        raise ModelError(
            f"{experiments} experiments", where="learning curve", fix="make two or more"
        )
    returns = np.zeros((len(which), experiments))
    cut_short = kernels.rollouts(
        tables(mdp, rows),
        stream(child(seed, 0)),
        table,
        np.ascontiguousarray(which, dtype=np.int64),
        chance,
        mdp.discount,
        max_steps,
        returns,
    )
    return LearningCurve(
        sampled=returns.mean(axis=1),
        standard_error=returns.std(axis=1, ddof=1) / np.sqrt(experiments),
        exact=exact,
        error=error,
        experiments=experiments,
        cut_short=int(cut_short),
    )
