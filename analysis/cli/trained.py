"""What `exact-mdp train` reports and saves of its runs.

What `exact-mdp train` prints for people.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import click
import numpy as np

from exact_mdp.analysis.cli.render import Table, number, to_json
from exact_mdp.analysis.learning.instability import compare, predict
from exact_mdp.analysis.learning.outcomes import (
    CANDIDATES,
    QUANTILES,
    Interval,
    Outcomes,
    share_interval,
)
from exact_mdp.analysis.record import run_record
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.io.load import Loaded
from exact_mdp.mdp.table import Numbers
from exact_mdp.solvers import evaluate
from exact_mdp.solvers.learning.q_learning import QLearning, TrainingRun
from exact_mdp.solvers.learning.sampler import as_policy
from exact_mdp.solvers.values.policy_values import policy_values

LISTED_ROWS = 1000  # policies over more rows are left to the files of --out


def summary(
    loaded: Loaded,
    settings: QLearning,
    seed: int,
    runs: Sequence[TrainingRun],
    found: Outcomes,
) -> dict[str, Any]:
    """Return the command's result."""
    best = found.best
    return {
        "model": loaded.name,
        "seeds": found.runs,
        "seed": seed,
        "settings": repr(settings),
        "columns": found.rows.space.names,
        "discount": loaded.mdp.discount,
        "claim": "estimated",
        "value_claim": "bounded",
        "optimal_value": found.optimum.value,
        "optimal_value_error": found.optimum.error,
        "random_value": evaluate(loaded.mdp, "random").mean,
        "best_value": found.best_value.value,
        "best_value_upper_bound": found.optimum.value if best is None else best.upper_bound,
        "best_value_proven": True if best is None else best.proven,
        "regret": _regret(found.regret, found.regret_interval),
        "optimal_fraction": found.optimal_fraction,
        "optimal_fraction_interval": _share(found, found.optimal_fraction),
        "learning_error": _regret(found.learning_error, None),
        "best_fraction": found.best_fraction,
        "best_fraction_interval": _share(found, found.best_fraction),
        "selected": {
            "regret": _regret(found.selected_regret, None),
            "optimal_fraction": float((found.selected_regret == 0).mean()),
        },
        "first_run": _first_run(found, runs[0]),
        "policies": [_policy(found, place) for place in np.flatnonzero(found.counts)],
        "distinct_in_last": {
            str(many): {
                "count": int((found.distinct == many).sum()),
                "interval": share_interval(int((found.distinct == many).sum()), found.runs),
            }
            for many in sorted(set(found.distinct.tolist()))
        },
        "changed_in_last": {
            found.rows.space.label(row): {
                "fraction": count / found.runs,
                "interval": share_interval(count, found.runs),
            }
            for row, count in enumerate(found.changed.sum(axis=0).tolist())
            if count
        },
        "steps": sum(run.steps for run in runs),
        "cut_short": sum(run.cut_short for run in runs),
        "unstable": None,
        "written": [],
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
    return {
        space.columns[0].label(row) if alone else space.label(row): names[action]
        for row, action in enumerate(choices.tolist())
    }


def _share(found: Outcomes, share: float) -> Interval:
    return share_interval(round(share * found.runs), found.runs)


def _regret(values: Any, interval: Interval | None) -> dict[str, Any]:
    return {
        "mean": float(values.mean()),
        "mean_interval": interval,
        "quantiles": {
            str(share): float(value)
            for share, value in zip(QUANTILES, np.quantile(values, QUANTILES), strict=True)
        },
        "greatest": float(values.max()),
    }


def _policy(found: Outcomes, place: int) -> dict[str, Any]:
    count = int(found.counts[place])
    value, error = float(found.value[place]), float(found.error[place])
    regret = found.optimum.value - value
    return {
        "count": count,
        "fraction": count / found.runs,
        "interval": share_interval(count, found.runs),
        "value": value,
        "error_bound": error,
        "regret": 0.0 if abs(regret) <= error + found.optimum.error else regret,
        "policy": _named(found, found.policies[place]),
    }


def explained(loaded: Loaded, settings: QLearning, found: Outcomes) -> dict[str, Any]:
    """Return fixed point, gaps, noise and predicted shares of the row that changes most."""
    row = int(found.changed.mean(axis=0).argmax())
    theory = predict(loaded.mdp, settings, row=row, policy=found.policies[0])
    counts = found.choices(row)
    names = loaded.mdp.actions
    comparisons = {kind: compare(getattr(theory, kind), counts) for kind in ("linear", "switching")}
    seen = comparisons["linear"].intervals
    return {
        "row": theory.label,
        "epsilon": theory.field.epsilon,
        "rate": theory.rate,
        "actions": {
            names[action]: {
                "fixed_point": float(theory.field.q[row, action]),
                "gap": float(theory.gaps[action]),
                "noise": float(theory.spread[action]),
                "linear": float(theory.linear[action]),
                "switching": float(theory.switching[action]),
                "switching_error": float(theory.switching_error[action]),
                "observed": float(counts[action] / found.runs),
                "interval": seen[action],
            }
            for action in range(len(names))
            if found.rows.offered[row, action]
        },
        "distance": {kind: each.distance for kind, each in comparisons.items()},
        "distance_by_chance": {kind: each.noise for kind, each in comparisons.items()},
    }


def save(
    folder: Path,
    loaded: Loaded,
    settings: QLearning,
    seed: int,
    runs: Sequence[TrainingRun],
    found: Outcomes,
    result: dict[str, Any],
) -> list[str]:
    """Write summary, most frequent policy, first Q-table and record beside the runs."""
    mdp, space = loaded.mdp, found.rows.space
    paths = [folder / name for name in ("summary.json", "policy.csv", "q.npy", "run.json")]
    as_policy(mdp, space, found.policies[0]).write(paths[1])
    free = np.flatnonzero(found.rows.offered[np.unique(found.rows.key[~mdp.forced])].any(axis=0))
    content = io.BytesIO()
    np.save(content, runs[0].q if space == mdp.space else runs[0].q[:, free])
    write_atomically(paths[2], content.getvalue())
    words = click.get_current_context().find_root().obj or ()
    record = run_record(mdp, model=loaded.name, solver=repr(settings), seed=seed, command=words)
    write_atomically(paths[3], json.dumps(record, indent=2) + "\n")
    written = [str(path) for path in paths]
    write_atomically(paths[0], to_json(result | {"written": written}) + "\n")
    return written


def _grid(
    *,
    title: str,
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    numeric: frozenset[int] = frozenset(),
) -> Table:
    columns = {heading: itemgetter(place) for place, heading in enumerate(headings)}
    return Table(title=title, rows=rows, columns=columns)


SHOWN = 10  # policies in the table


def facts(result: dict[str, Any]) -> dict[str, str]:
    regret, selected = result["regret"], result["selected"]
    low, high = result["optimal_fraction_interval"]
    told = {
        "model": result["model"],
        "settings": result["settings"],
        "runs": f"{result['seeds']:,} from seed {result['seed']}, {result['steps']:,} steps",
        "discount": f"{number(result['discount'])} (values); the learner's own is in its settings",
        "optimal value": number(result["optimal_value"], result["optimal_value_error"]),
        "value of acting at random": number(result["random_value"]),
        "mean regret": _with_interval(regret["mean"], regret["mean_interval"]),
        "quantiles of regret": ", ".join(
            f"{float(share):.0%}: {number(value)}" for share, value in regret["quantiles"].items()
        ),
        "runs that end optimal": f"{result['optimal_fraction']:.1%} ({low:.1%} to {high:.1%})",
    }
    if result["best_value"] < result["optimal_value"] - result["optimal_value_error"]:
        proof = "proven" if result["best_value_proven"] else "the best found"
        read = ", ".join(result["columns"]) or "nothing"
        told[f"best that reads {read}"] = (
            f"{number(result['best_value'])}, {proof}; {result['best_fraction']:.1%} end with it"
        )
    told["mean regret of the best of five"] = number(selected["regret"]["mean"])
    if result["cut_short"]:
        told["episodes cut short"] = f"{result['cut_short']:,}"
    if result["written"]:
        told["written"] = ", ".join(result["written"])
    return told


def _with_interval(value: float, interval: Interval | None) -> str:
    if interval is None:
        return number(value)
    return f"{number(value)} (95 %: {interval[0]:.4g} to {interval[1]:.4g})"


def grids(result: dict[str, Any]) -> list[Table]:
    most = result["policies"][0]["policy"]
    rows = []
    for entry in result["policies"][:SHOWN]:
        if entry is result["policies"][0] or most is None:
            shown = (
                "as most runs" if most is None else ", ".join(f"{k} {a}" for k, a in most.items())
            )
        else:
            unlike = {k: a for k, a in entry["policy"].items() if a != most[k]}
            shown = ", ".join(f"{k} {a}" for k, a in unlike.items())
        rows.append((str(entry["count"]), number(entry["value"]), number(entry["regret"]), shown))
    more = len(result["policies"]) - len(rows)
    title = "final greedy policies, and where they differ from the first"
    found = [
        _grid(
            title=f"{title} ({more} more)" if more else title,
            headings=("runs", "value", "regret", "policy"),
            rows=rows,
            numeric=frozenset({0, 1, 2}),
        ),
        _grid(
            title="how many policies are greedy in the last episodes of a run",
            headings=("policies", "runs", "share", "95 %"),
            rows=[
                (
                    many,
                    str(entry["count"]),
                    f"{entry['count'] / result['seeds']:.1%}",
                    "{:.1%} to {:.1%}".format(*entry["interval"]),
                )
                for many, entry in result["distinct_in_last"].items()
            ],
            numeric=frozenset({0, 1, 2}),
        ),
    ]
    changed = sorted(result["changed_in_last"].items(), key=lambda item: -item[1]["fraction"])
    if changed:
        found.append(
            _grid(
                title="where these policies differ",
                headings=("row", "share of runs", "95 %"),
                rows=[
                    (row, f"{each['fraction']:.1%}", "{:.1%} to {:.1%}".format(*each["interval"]))
                    for row, each in changed
                ],
                numeric=frozenset({1}),
            )
        )
    if result["unstable"]:
        found.append(_theory(result["unstable"]))
    return found


def _theory(found: dict[str, Any]) -> Table:
    rows = [
        (
            name,
            f"{entry['fixed_point']:.3f}",
            f"{entry['gap']:.3f}",
            f"{entry['noise']:.3f}",
            f"{entry['linear']:.1%}",
            f"{entry['switching']:.1%}",
            f"{entry['observed']:.1%}",
            "{:.1%} to {:.1%}".format(*entry["interval"]),
        )
        for name, entry in found["actions"].items()
    ]
    return _grid(
        title=f"{found['row']}: fixed point of the learner, noise at rate {found['rate']:g}, and "
        "predicted and observed shares of final policies",
        headings=("action", "Q", "gap", "noise", "linear", "switching", "observed", "95 %"),
        rows=rows,
        numeric=frozenset(range(1, 8)),
    )
