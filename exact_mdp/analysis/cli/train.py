"""`exact-mdp train`: learning by sampling, and the exact value of the result."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import exact_mdp
from exact_mdp.analysis.cli.given import Given
from exact_mdp.analysis.cli.words import settings_of
from exact_mdp.mdp.errors import ModelError, locate_errors
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.report import Report
from exact_mdp.mdp.table import float_of
from exact_mdp.solvers.learning import training
from exact_mdp.solvers.learning.q_learning import QLearning
from exact_mdp.solvers.learning.schedules import PAPER_CONSTANT, PAPER_DECAYING, Schedule

SCHEDULES: dict[str, Schedule] = {"constant": PAPER_CONSTANT, "decaying": PAPER_DECAYING}


def train_command(
    given: Given,
    *,
    epsilon: str = "constant",
    seeds: int = 40,
    seed: int = 0,
    learner: Sequence[str] = (),
    out: str | None = None,
    n_jobs: int | None = None,
) -> Report:
    """Train Q-learning, and judge the learned policies by exact values.

    The regret is shown for the final greedy policies of all seeds, at the model's discount.

    Example: exact-mdp train yuan2025 --seeds 10 --learner epochs=1000

    Parameters
    ----------
    epsilon : SCHEDULE
        constant (0.1), decaying (0.03 + 0.97 exp(-λt), 0.8 at epoch 300), or a number from 0 to 1.
    seeds : N, 1 to 10000000
        Number of runs.
    seed : S
        Seed of the random numbers.
    learner : NAME=VALUE, optional
        A setting of `exact_mdp.QLearning`: method=sarsa (expected-sarsa, double-q-learning),
        epochs=6000, episodes=30, discount=0.95, rate=0.05, rate_power=0, columns=all or
        trial,status, initial=0, ties=first (last, random), bootstrap_end=true, max_steps=10000.
    out : DIR, optional
        Folder for finished runs; runs that are there already are not repeated.
    n_jobs : N, 1 to 1024
        Number of threads, all cores unless given. Does not change results.

    Keys
    ----
    Of Outcomes.
    seeds: number of runs; steps: steps of all runs; cut_short: truncated episodes; settings: the
    learner's settings; columns: the columns that the learner reads; optimal_value: the optimal
    value at the start; optimal_value_error: error bound of the optimal value; value_claim: claim of
    the values of the policies; random_value: the value of random actions; best_value_upper_bound:
    an upper bound on the best value; best_value_proven: whether the upper bound is the best value;
    best_fraction_interval: 95 % interval of `best_fraction`; optimal_fraction_interval: 95 %
    interval of `optimal_fraction`; regret: regret of the policies learned, as mean, quantiles,
    intervals; learning_error: loss against the best over the columns; selected: regret and
    optimal_fraction of the best policy that each run met; first_run: the policies that were greedy
    most often in the last episodes of the first run; policies: the distinct policies with their
    counts and exact values; distinct_in_last: number of policies at the end of a run;
    changed_in_last: how often the action of each status changes in the last episodes.
    """
    mdp, stated = given.mdp, settings_of(QLearning, learner, "--learner")
    if stated.get("columns") == ("all",):
        stated["columns"] = mdp.space.names
    stated["exploration"] = SCHEDULES.get(epsilon) or float_of(epsilon, "epsilon")
    stated.setdefault("snapshot_episode", min(10, stated.get("episodes", 10)))
    with locate_errors("--learner"):
        settings = QLearning(**stated)
    if np.isinf(exact_mdp.solve(mdp).start.value):  # refused before the work
        raise ModelError(
            "the optimum is infinite, so the loss of a policy is not a number",
            where="the total at discount 1",
            fix="choose a discount below 1: --discount 0.95",
        )
    runs = training.train(mdp, settings, seeds, rng=seed, n_jobs=n_jobs, out=out, progress=True)
    results = exact_mdp.outcomes(mdp, runs)
    report = given.complete_report(results.report(), settings=repr(settings), seed=seed)
    if out is None:
        return report
    policy, table = files = Path(out, "policy.csv"), Path(out, "q.npy")
    rows, run = results.rows, runs[0]
    Policy(space=rows.space, actions=mdp.actions, rule=results.policies[0]).write(policy)
    free = np.flatnonzero(rows.offered[np.unique(rows.key[~mdp.forced])].any(axis=0))
    content = io.BytesIO()
    np.save(content, run.q if rows.space == mdp.space else run.q[:, free])
    write_atomically(table, content.getvalue())
    return given.save_report(report, out, "summary.json", (repr(settings), seed), *files)
