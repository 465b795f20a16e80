"""`exact-mdp train`: learning by sampling, and exactly what was learned."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import click
import numpy as np

from exact_mdp.analysis.cli.options import Given, given, number_of, whole_of
from exact_mdp.analysis.cli.render import Report, Table, number, to_json
from exact_mdp.analysis.learning.outcomes import (
    CANDIDATES,
    QUANTILES,
    Interval,
    Outcomes,
    outcomes,
)
from exact_mdp.analysis.record import run_record
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.mdp.validate import as_discount
from exact_mdp.solvers.learning import training
from exact_mdp.solvers.learning.q_learning import QLearning, TrainingRun
from exact_mdp.solvers.learning.sampler import as_policy
from exact_mdp.solvers.learning.schedules import (
    PAPER_CONSTANT,
    PAPER_DECAYING,
    Constant,
    Schedule,
)
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.evaluate import evaluate
from exact_mdp.solvers.values.policy_values import policy_values

LISTED_ROWS = 1000  # policies over more rows are left to the files of --out
SHOWN = 10  # policies in the table
SCHEDULES: dict[str, Schedule] = {"constant": PAPER_CONSTANT, "decaying": PAPER_DECAYING}


def train(
    model: str,
    seeds: str,
    seed: str,
    out: str | None,
    jobs: str | None,
    sets: tuple[str, ...],
    discount: str | None,
    **options: Any,
) -> Report:
    """Train on a model and judge what was learned by exact values."""
    asked = given(model, sets, discount)
    settings, first = _settings(asked.mdp, options), whole_of(seed, "--seed", most=2**128)
    count = whole_of(seeds, "--seeds", 1, 10**7)
    workers = None if jobs is None else whole_of(jobs, "--jobs", 1, 1024)
    solve(asked.mdp)  # a model that cannot be judged is refused before the work
    runs = training.train(
        asked.mdp,
        settings,
        count,
        rng=first,
        n_jobs=workers,
        out=out,
        progress=True,
    )
    found = outcomes(asked.mdp, runs)
    result = asked.head | {"seed": first, "settings": repr(settings)} | _summary(runs, found)
    if out is not None:
        result["written"] = _save(Path(out), asked, settings, runs[0], found, result)
    return asked.report(result, _facts(result, found), _tables(result))


def _settings(mdp: MDP, options: dict[str, Any]) -> QLearning:
    """Return the learner that the options describe."""
    epsilon, columns = options["epsilon"], options["columns"]
    if columns == "all":
        columns = mdp.space.names
    elif columns is not None:
        columns = tuple(name.strip() for name in columns.split(","))
    try:
        discount: Fraction = as_discount(options["learning_discount"])
    except ModelError as error:
        raise ModelError(error.what, where="--learning-discount", fix=error.fix) from error
    episodes = whole_of(options["episodes"], "--episodes", 1, 10**9)
    return QLearning(
        method=options["method"],
        epochs=whole_of(options["epochs"], "--epochs", 1, 10**7),
        episodes=episodes,
        discount=discount,
        rate=Constant(number_of(options["rate"], "--rate")),
        rate_power=number_of(options["rate_power"], "--rate-power"),
        exploration=SCHEDULES.get(epsilon) or Constant(number_of(epsilon, "--epsilon")),
        columns=columns,
        initial=number_of(options["initial"], "--initial"),
        ties=options["ties"],
        bootstrap_end=options["bootstrap_end"],
        max_steps=whole_of(options["max_steps"], "--max-steps", 1, 10**9),
        snapshot_episode=min(10, episodes),
    )


# ---- the result ----------------------------------------------------------------------------------


def _summary(runs: Sequence[TrainingRun], found: Outcomes) -> dict[str, Any]:
    """Return what the runs ended with."""
    best, counts = found.best, found.last_counts
    return {
        "seeds": found.runs,
        "columns": found.rows.space.names,
        "claim": "estimated",
        "value_claim": "bounded",
        "optimal_value": found.optimum.value,
        "optimal_value_error": found.optimum.error,
        "random_value": evaluate(found.mdp, "random").mean,
        "best_value": found.best_value.value,
        "best_value_upper_bound": found.optimum.value if best is None else best.upper_bound,
        "best_value_proven": True if best is None else best.proven,
        "regret": _spread(found.regret) | {"mean_interval": found.regret_interval},
        "optimal_fraction": found.optimal_fraction,
        "optimal_fraction_interval": found.interval_of(found.optimal_fraction),
        "learning_error": _spread(found.learning_error),
        "best_fraction": found.best_fraction,
        "best_fraction_interval": found.interval_of(found.best_fraction),
        "selected": {
            "regret": _spread(found.selected_regret),
            "optimal_fraction": float((found.selected_regret == 0).mean()),
        },
        "first_run": _first_run(found, runs[0]),
        "policies": [
            row | _share(int(row["count"]), found) | {"policy": _named(found, policy)}
            for row, policy in zip(
                found.frame().to_dict("records"), found.policies[found.counts > 0], strict=True
            )
        ],
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


def _share(count: int, found: Outcomes) -> dict[str, Any]:
    return {"fraction": count / found.runs, "interval": found.interval_of(count / found.runs)}


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


def _save(
    folder: Path,
    asked: Given,
    settings: QLearning,
    run: TrainingRun,
    found: Outcomes,
    result: dict[str, Any],
) -> list[str]:
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
    kept = run_record(
        mdp, model=asked.loaded.name, solver=repr(settings), seed=result["seed"], command=words
    )
    write_atomically(record, json.dumps(kept, indent=2) + "\n")
    written = [str(path) for path in paths]
    write_atomically(summary, to_json(result | {"written": written}) + "\n")
    return written


# ---- for people ----------------------------------------------------------------------------------


def _facts(result: dict[str, Any], found: Outcomes) -> dict[str, Any]:
    regret = result["regret"]
    told = {
        "settings": result["settings"],
        "runs": f"{result['seeds']:,} from seed {result['seed']}, {result['steps']:,} steps",
        "discount": f"{number(result['discount'])} (values); the learner's own is in its settings",
        "optimal value": found.optimum,
        "value of acting at random": result["random_value"],
        "mean regret": number(regret["mean"]),
        "quantiles of regret": ", ".join(
            f"{float(share):.0%}: {number(value)}" for share, value in regret["quantiles"].items()
        ),
        "runs that end optimal": f"{result['optimal_fraction']:.1%} "
        f"({_percent(result['optimal_fraction_interval'])})",
    }
    if regret["mean_interval"]:
        told["mean regret"] += " (95 %: {:.4g} to {:.4g})".format(*regret["mean_interval"])
    if result["best_value"] < result["optimal_value"] - result["optimal_value_error"]:
        proof = "proven" if result["best_value_proven"] else "the best found"
        read = ", ".join(result["columns"]) or "nothing"
        told[f"best that reads {read}"] = (
            f"{number(result['best_value'])}, {proof}; {result['best_fraction']:.1%} end with it"
        )
    return told | {
        "mean regret of the best of five": result["selected"]["regret"]["mean"],
        "episodes cut short": result["cut_short"] or None,
        "written": ", ".join(result["written"]) or None,
    }


def _percent(interval: Interval) -> str:
    return "{:.1%} to {:.1%}".format(*interval)


def _tables(result: dict[str, Any]) -> list[Table]:
    most = result["policies"][0]["policy"]

    def named(entry: dict[str, Any]) -> str:
        policy = entry["policy"]
        if policy is None:
            return "as most runs"
        shown = {row: a for row, a in policy.items() if policy is most or a != most[row]}
        return ", ".join(f"{row} {action}" for row, action in shown.items())

    def interval(entry: dict[str, Any]) -> str:
        return _percent(entry["interval"])

    changed = [{"row": row} | each for row, each in result["changed_in_last"].items()]
    return [
        Table(
            title="final greedy policies, and where they differ from the first",
            rows=result["policies"],
            columns={"runs": "count", "value": "value", "regret": "regret", "policy": named},
            first=SHOWN,
        ),
        Table(
            title="how many policies are greedy in the last episodes of a run",
            rows=[
                {"policies": int(many), "share": each["count"] / result["seeds"]} | each
                for many, each in result["distinct_in_last"].items()
            ],
            columns={
                "policies": "policies",
                "runs": "count",
                "share": "share:.1%",
                "95 %": interval,
            },
        ),
        Table(
            title="where these policies differ",
            rows=sorted(changed, key=lambda each: -each["fraction"]),
            columns={"row": "row", "share of runs": "fraction:.1%", "95 %": interval},
        ),
    ]
