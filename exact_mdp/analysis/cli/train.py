"""`exact-mdp train`: learning by sampling, and exactly what was learned."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from exact_mdp.analysis.cli.given import Given
from exact_mdp.analysis.cli.words import number_of, settings_of
from exact_mdp.analysis.learning.outcomes import (
    CANDIDATES,
    QUANTILES,
    Interval,
    Outcomes,
    outcomes,
)
from exact_mdp.analysis.record import run_record
from exact_mdp.mdp.errors import located
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.report import Report, Shown, Table, number
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.learning import training
from exact_mdp.solvers.learning.q_learning import QLearning, TrainingRun
from exact_mdp.solvers.learning.sampler import as_policy
from exact_mdp.solvers.learning.schedules import PAPER_CONSTANT, PAPER_DECAYING, Schedule
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.evaluate import evaluate
from exact_mdp.solvers.values.layers import policy_values

LISTED_ROWS = 1000  # policies over more rows are left to the files of --out
SHOWN = 10  # policies in the table
SCHEDULES: dict[str, Schedule] = {"constant": PAPER_CONSTANT, "decaying": PAPER_DECAYING}


def train(
    given: Given,
    *,
    epsilon: str = "constant",
    seeds: int = 40,
    seed: int = 0,
    learner: Sequence[str] = (),
    out: str | None = None,
    n_jobs: int | None = None,
) -> Report:
    """Train Q-learning, and judge what was learned by exact values.

    Regret is that of the final greedy policies, at the model's discount, over the seeds.

    Example:

    exact-mdp train yuan2025 --seeds 10 --learner epochs=1000

    Parameters
    ----------
    epsilon : SCHEDULE
        constant (0.1), decaying (0.03 + 0.97 exp(-λt), 0.8 at epoch 300), or a number from 0 to 1.
    seeds : N, 1 to 10000000
        Number of runs.
    seed : S, 0 to 340282366920938463463374607431768211456
        Seed of the random numbers.
    learner : NAME=VALUE, optional
        A setting of `exact_mdp.QLearning`: method=sarsa (expected-sarsa, double-q-learning),
        epochs=6000, episodes=30, discount=0.95, rate=0.05, rate_power=0, columns=all or
        trial,status, initial=0, ties=first (last, random), bootstrap_end=true, max_steps=10000.
    out : DIR, optional
        Folder for finished runs; runs that are there already are not repeated.
    n_jobs : N, 1 to 1024
        Number of threads, all cores unless given. Does not change results.
    """
    mdp, settings = given.mdp, _settings(given.mdp, epsilon, learner)
    solve(mdp)  # a model that cannot be judged is refused before the work
    runs = training.train(mdp, settings, seeds, rng=seed, n_jobs=n_jobs, out=out, progress=True)
    found = outcomes(mdp, runs)
    report = given.report(_report(runs, found, settings), seed=seed)
    return report if out is None else _saved(report, Path(out), given, settings, runs[0], found)


def _settings(mdp: MDP, epsilon: str, learner: Sequence[str]) -> QLearning:
    """Return the learner that the options describe."""
    stated = settings_of(QLearning, learner, "--learner")
    if stated.get("columns") == ("all",):
        stated["columns"] = mdp.space.names
    stated["exploration"] = SCHEDULES.get(epsilon) or number_of(epsilon, "--epsilon")
    stated.setdefault("snapshot_episode", min(10, stated.get("episodes", 10)))
    with located("--learner"):
        return QLearning(**stated)


# ---- the result ----------------------------------------------------------------------------------


def _report(runs: Sequence[TrainingRun], found: Outcomes, settings: QLearning) -> Report:
    """Return what the runs ended with."""
    best, counts, regret = found.best, found.last_counts, _spread(found.regret)
    interval = found.regret_interval
    quantiles = ", ".join(f"{float(q):.0%}: {number(v)}" for q, v in regret["quantiles"].items())
    apart = "" if interval is None else f" (95 %: {_percent(interval, '.4g')})"
    learning, optimal = _spread(found.learning_error), found.interval_of(found.optimal_fraction)
    policies = [
        row | _share(int(row["count"]), found) | {"policy": _named(found, policy)}
        for row, policy in zip(
            found.frame().to_dict("records"), found.policies[found.counts > 0], strict=True
        )
    ]
    facts = {
        "settings": repr(settings),
        "seeds": found.runs,
        "columns": found.rows.space.names,
        "claim": Shown("estimated"),
        "value_claim": Shown("bounded"),
        "optimal_value": Shown(found.optimum.value, found.optimum),
        "optimal_value_error": Shown(found.optimum.error),
        "random_value": evaluate(found.mdp, "random").mean,
        "best_value": Shown(found.best_value.value, found.best_value),
        "best_value_upper_bound": Shown(found.optimum.value if best is None else best.upper_bound),
        "best_value_proven": True if best is None else best.proven,
        "regret": Shown(
            regret | {"mean_interval": interval},
            f"mean regret {number(regret['mean'])}{apart}; quantiles {quantiles}",
        ),
        "optimal_fraction": Shown(
            found.optimal_fraction,
            f"{found.optimal_fraction:.1%} of the runs end optimal (95 %: {_percent(optimal)})",
        ),
        "optimal_fraction_interval": Shown(optimal),
        "learning_error": Shown(learning, f"mean {number(learning['mean'])}"),
        "best_fraction": Shown(found.best_fraction, f"{found.best_fraction:.1%}"),
        "best_fraction_interval": Shown(found.interval_of(found.best_fraction)),
        "selected": Shown(
            {
                "regret": _spread(found.selected_regret),
                "optimal_fraction": float((found.selected_regret == 0).mean()),
            },
            f"mean regret of the best of five {number(float(found.selected_regret.mean()))}",
        ),
        "first_run": Shown(_first_run(found, runs[0])),
        "policies": policies,
        "distinct_in_last": {
            str(many): {"count": count, "interval": found.interval_of(count / found.runs)}
            for many, count in counts.items()
        },
        "changed_in_last": {
            found.rows.space.label(row): _share(count, found)
            for row, count in enumerate(found.changed.sum(axis=0).tolist())
            if count
        },
        "steps": sum(run.steps for run in runs),
        "cut_short": sum(run.cut_short for run in runs),
        "written": [],
    }
    return Report(title="training", facts=facts, tables=_tables(facts, found.runs))


def _share(count: int, found: Outcomes) -> dict[str, Any]:
    return {"fraction": count / found.runs, "interval": found.interval_of(count / found.runs)}


def _percent(interval: Interval, form: str = ".1%") -> str:
    return f"{interval[0]:{form}} to {interval[1]:{form}}"


def _spread(values: Floats) -> dict[str, Any]:
    quantiles = zip(QUANTILES, np.quantile(values, QUANTILES).tolist(), strict=True)
    return {
        "mean": float(values.mean()),
        "mean_interval": None,
        "quantiles": {str(share): value for share, value in quantiles},
        "greatest": float(values.max()),
    }


def _first_run(found: Outcomes, run: TrainingRun) -> dict[str, Any]:
    """Return the policies that were greedy most often in the last episodes of one run."""
    counts = run.last_counts()
    top = list(counts)[:CANDIDATES]
    values = policy_values(found.mdp, found.rows, run.policies[top])
    return {
        "episodes": len(run.last),
        "distinct": len(counts),
        "top": [
            {
                "episodes": counts[number],
                "value": float(value),
                "error_bound": float(error),
                "policy": _named(found, run.policies[number]),
            }
            for number, value, error in zip(top, values.value, values.error, strict=True)
        ],
    }


def _named(found: Outcomes, choices: Numbers) -> dict[str, str] | None:
    """Return {row: action}, or None where there are too many rows to list."""
    space, names = found.rows.space, found.mdp.actions
    if space.size > LISTED_ROWS:
        return None
    alone = len(space.columns) == 1 and not space.extra
    label = space.columns[0].label if alone else space.label
    return {label(row): names[action] for row, action in enumerate(choices.tolist())}


def _saved(
    report: Report,
    folder: Path,
    given: Given,
    settings: QLearning,
    run: TrainingRun,
    found: Outcomes,
) -> Report:
    """Write summary, most frequent policy, first Q-table and record beside the runs."""
    mdp, space = found.mdp, found.rows.space
    summary, policy, table, record = paths = [
        folder / name for name in ("summary.json", "policy.csv", "q.npy", "run.json")
    ]
    as_policy(mdp, space, found.policies[0]).write(policy)
    free = np.flatnonzero(found.rows.offered[np.unique(found.rows.key[~mdp.forced])].any(axis=0))
    content = io.BytesIO()
    np.save(content, run.q if space == mdp.space else run.q[:, free])
    write_atomically(table, content.getvalue())
    words = click.get_current_context().find_root().obj or ()
    seed = report.facts["seed"]
    made = run_record(mdp, model=given.loaded.name, solver=repr(settings), seed=seed, command=words)
    write_atomically(record, json.dumps(made, indent=2) + "\n")
    report = replace(report, facts={**report.facts, "written": [str(path) for path in paths]})
    write_atomically(summary, report.json() + "\n")
    return report


def _tables(facts: dict[str, Any], runs: int) -> dict[str, Table]:
    most = facts["policies"][0]["policy"]

    def named(policy: dict[str, str] | None) -> str:
        if policy is None:
            return "as most runs"
        shown = {row: a for row, a in policy.items() if policy is most or a != most[row]}
        return ", ".join(f"{row} {action}" for row, action in shown.items())

    changed = [{"row": row} | each for row, each in facts["changed_in_last"].items()]
    return {
        "policies": Table(
            title="final greedy policies, and where they differ from the first",
            rows=[each | {"policy": named(each["policy"])} for each in facts["policies"]],
            columns={"runs": "count", "value": "value", "regret": "regret", "policy": "policy"},
            first=SHOWN,
        ),
        "distinct_in_last": Table(
            title="how many policies are greedy in the last episodes of a run",
            rows=[
                {"many": int(many), "count": each["count"], "share": each["count"] / runs}
                | {"interval": _percent(each["interval"])}
                for many, each in facts["distinct_in_last"].items()
            ],
            columns={"policies": "many", "runs": "count", "share": "share:.1%", "95 %": "interval"},
        ),
        "changed_in_last": Table(
            title="where these policies differ",
            rows=[
                each | {"interval": _percent(each["interval"])}
                for each in sorted(changed, key=lambda each: -each["fraction"])
            ],
            columns={"row": "row", "share of runs": "fraction:.1%", "95 %": "interval"},
        ),
    }
