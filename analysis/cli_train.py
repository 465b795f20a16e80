"""The command that trains by sampling and says exactly what was learned."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from analysis.cli_common import float_of, model_options, whole_of
from analysis.cli_output import Grid, number, show, to_json

if TYPE_CHECKING:
    from collections.abc import Sequence

    from analysis.learning import Interval, Outcomes
    from mdp.load import Loaded
    from solvers.q_learning import QLearning, TrainingRun

SHOWN = 10  # policies in the table for people
LISTED_ROWS = 1000  # policies over more rows are left to the files of --out
SHIFTS = 5e-4  # shares of runs below this are no news


@click.command(short_help="Q-learning by sampling, judged by exact values.")
@click.argument("model")
@click.option(
    "--epsilon",
    default="constant",
    metavar="SCHEDULE",
    help="constant (0.1, the default), decaying (0.03 + 0.97 exp(-λt), 0.8 at epoch 300), or a "
    "number from 0 to 1.",
)
@click.option("--seeds", default="40", metavar="N", help="Number of runs (40).")
@click.option("--seed", default="0", metavar="S", help="Seed of all runs together (0).")
@click.option(
    "--out", metavar="DIR", help="Keep runs there as they finish, and go on from those it holds."
)
@click.option(
    "--method",
    default="q-learning",
    metavar="NAME",
    help="q-learning (the default), sarsa, expected-sarsa or double-q-learning.",
)
@click.option("--epochs", default="6000", metavar="N", help="Epochs of a run (6000).")
@click.option("--episodes", default="30", metavar="N", help="Episodes of an epoch (30).")
@click.option("--rate", default="0.05", metavar="X", help="Learning rate (0.05).")
@click.option(
    "--rate-power", default="0", metavar="X", help="Rate of the n-th update: rate · n^-X (0)."
)
@click.option(
    "--learning-discount", default="0.95", metavar="G", help="The learner's discount (0.95)."
)
@click.option(
    "--columns",
    metavar="NAMES",
    help="What the learner reads: all, or columns with commas, such as trial,status. Unless given, "
    "the status alone where there is one.",
)
@click.option("--initial", default="0", metavar="X", help="First value of every entry (0).")
@click.option("--ties", default="first", metavar="RULE", help="first (the default), last, random.")
@click.option("--bootstrap-end", is_flag=True, help="Look beyond the end as if it went on.")
@click.option("--max-steps", default="10000", metavar="N", help="Cut longer episodes (10000).")
@click.option("--jobs", metavar="N", help="Threads; all cores unless given. Changes no result.")
@click.option(
    "--explain", is_flag=True, help="Predict how unstable the least stable status is, and why."
)
@model_options
def train(
    model: str,
    seeds: str,
    seed: str,
    out: str | None,
    jobs: str | None,
    explain: bool,
    sets: tuple[str, ...],
    discount: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Train on MODEL as Yuan et al. (2025) do, and compute exactly what the policies are worth.

    Regret is that of the final greedy policies, at the model's discount, over the seeds.
    """
    from analysis.learning import outcomes
    from mdp.load import load
    from solvers import solve
    from solvers.training import train_many

    loaded = load(model, sets=sets, discount=discount)
    settings, first = _settings(loaded, options), whole_of(seed, "--seed", most=2**128)
    count = whole_of(seeds, "--seeds", 1, 10**7)
    workers = None if jobs is None else whole_of(jobs, "--jobs", 1, 1024)
    solve(loaded.mdp)  # a model that cannot be judged is refused before the work
    runs = train_many(
        loaded.mdp, settings, count, seed=first, n_jobs=workers, out=out, progress=True
    )
    found = outcomes(loaded.mdp, runs)
    result = _result(loaded, settings, first, runs, found)
    if explain:
        result["unstable"] = _explained(loaded, settings, found)
    if out is not None:
        result["written"] = _save(Path(out), loaded, settings, first, runs, found, result)
    show(result, as_json=as_json, facts=_facts(result), grids=_grids(result))


def _settings(loaded: Loaded, options: dict[str, Any]) -> QLearning:
    from solvers.q_learning import QLearning
    from solvers.schedules import PAPER_CONSTANT, PAPER_DECAYING, Constant, Schedule

    named: dict[str, Schedule] = {"constant": PAPER_CONSTANT, "decaying": PAPER_DECAYING}
    epsilon, columns = options["epsilon"], options["columns"]
    exploration = named.get(epsilon) or Constant(_float(epsilon, "--epsilon"))
    if columns is not None:
        names = loaded.mdp.space.names
        columns = names if columns == "all" else tuple(name.strip() for name in columns.split(","))
    return QLearning(
        method=options["method"],
        epochs=whole_of(options["epochs"], "--epochs", 1, 10**9),
        episodes=whole_of(options["episodes"], "--episodes", 1, 10**9),
        discount=options["learning_discount"],
        rate=Constant(_float(options["rate"], "--rate")),
        rate_power=_float(options["rate_power"], "--rate-power"),
        exploration=exploration,
        columns=columns,
        initial=_float(options["initial"], "--initial"),
        ties=options["ties"],
        bootstrap_end=options["bootstrap_end"],
        max_steps=whole_of(options["max_steps"], "--max-steps", 1, 10**9),
        snapshot_episode=min(10, whole_of(options["episodes"], "--episodes", 1)),
    )


def _float(text: str, option: str) -> float:
    value = float_of(text, option)
    assert value is not None
    return value


def _result(
    loaded: Loaded,
    settings: QLearning,
    seed: int,
    runs: Sequence[TrainingRun],
    found: Outcomes,
) -> dict[str, Any]:
    from analysis.learning import share_interval

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
        "best_value": found.best_value.value,
        "best_value_upper_bound": found.optimum.value if best is None else best.upper_bound,
        "best_value_proven": True if best is None else best.proven,
        "regret": _regret(found.regret, found.regret_interval),
        "optimal_fraction": found.optimal_fraction,
        "optimal_fraction_interval": _share(found, found.optimal_fraction),
        "best_fraction": found.best_fraction,
        "best_fraction_interval": _share(found, found.best_fraction),
        "selected": {
            "regret": _regret(found.selected_regret, None),
            "optimal_fraction": float((found.selected_regret == 0).mean()),
        },
        "policies": [_policy(found, number) for number in range(len(found.policies))],
        "distinct_in_last": {
            str(many): {
                "count": int((found.distinct == many).sum()),
                "interval": share_interval(int((found.distinct == many).sum()), found.runs),
            }
            for many in sorted(set(found.distinct.tolist()))
        },
        "changed_in_last": {
            found.rows.space.label(row): float(share)
            for row, share in enumerate(found.changed.mean(axis=0))
            if share > 0
        },
        "steps": sum(run.steps for run in runs),
        "cut_short": sum(run.cut_short for run in runs),
        "unstable": None,
        "written": [],
    }


def _share(found: Outcomes, share: float) -> Interval:
    from analysis.learning import share_interval

    return share_interval(round(share * found.runs), found.runs)


def _regret(values: Any, interval: Interval | None) -> dict[str, Any]:
    import numpy as np

    from analysis.learning import QUANTILES

    return {
        "mean": float(values.mean()),
        "mean_interval": interval,
        "quantiles": {
            str(share): float(value)
            for share, value in zip(QUANTILES, np.quantile(values, QUANTILES), strict=True)
        },
        "greatest": float(values.max()),
    }


def _policy(found: Outcomes, number: int) -> dict[str, Any]:
    from analysis.learning import share_interval

    space, count = found.rows.space, int(found.counts[number])
    chosen = None
    if space.size <= LISTED_ROWS:
        alone = len(space.columns) == 1 and not space.extra
        chosen = {
            space.columns[0].label(row) if alone else space.label(row): found.mdp.actions[action]
            for row, action in enumerate(found.policies[number].tolist())
        }
    value, error = float(found.value[number]), float(found.error[number])
    regret = found.optimum.value - value
    return {
        "count": count,
        "fraction": count / found.runs,
        "interval": share_interval(count, found.runs),
        "value": value,
        "error_bound": error,
        "regret": 0.0 if abs(regret) <= error + found.optimum.error else regret,
        "policy": chosen,
    }


def _explained(loaded: Loaded, settings: QLearning, found: Outcomes) -> dict[str, Any]:
    """Return fixed point, gaps, noise and predicted shares of the row that changes most."""
    from analysis.instability import compare, predict

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


def _save(
    folder: Path,
    loaded: Loaded,
    settings: QLearning,
    seed: int,
    runs: Sequence[TrainingRun],
    found: Outcomes,
    result: dict[str, Any],
) -> list[str]:
    """Write summary, most frequent policy, first Q-table and record beside the runs."""
    import json

    import numpy as np

    from analysis.record import run_record
    from mdp.files import write_atomically
    from solvers.sampler import as_policy

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


# ---- for people ----------------------------------------------------------------------------------


def _facts(result: dict[str, Any]) -> dict[str, str]:
    regret, selected = result["regret"], result["selected"]
    low, high = result["optimal_fraction_interval"]
    facts = {
        "model": result["model"],
        "settings": result["settings"],
        "runs": f"{result['seeds']:,} from seed {result['seed']}, {result['steps']:,} steps",
        "discount": f"{number(result['discount'])} (values); the learner's own is in its settings",
        "optimal value": number(result["optimal_value"], result["optimal_value_error"]),
        "mean regret": _with_interval(regret["mean"], regret["mean_interval"]),
        "quantiles of regret": ", ".join(
            f"{float(share):.0%}: {number(value)}" for share, value in regret["quantiles"].items()
        ),
        "runs that end optimal": f"{result['optimal_fraction']:.1%} ({low:.1%} to {high:.1%})",
    }
    if result["best_value"] < result["optimal_value"] - result["optimal_value_error"]:
        proof = "proven" if result["best_value_proven"] else "the best found"
        read = ", ".join(result["columns"]) or "nothing"
        facts[f"best that reads {read}"] = (
            f"{number(result['best_value'])}, {proof}; {result['best_fraction']:.1%} end with it"
        )
    facts["mean regret of the best of five"] = number(selected["regret"]["mean"])
    if result["cut_short"]:
        facts["episodes cut short"] = f"{result['cut_short']:,}"
    if result["written"]:
        facts["written"] = ", ".join(result["written"])
    return facts


def _with_interval(value: float, interval: Interval | None) -> str:
    if interval is None:
        return number(value)
    return f"{number(value)} (95 %: {interval[0]:.4g} to {interval[1]:.4g})"


def _grids(result: dict[str, Any]) -> list[Grid]:
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
    grids = [
        Grid(
            title=f"{title} ({more} more)" if more else title,
            headings=("runs", "value", "regret", "policy"),
            rows=rows,
            numeric=frozenset({0, 1, 2}),
        ),
        Grid(
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
    changed = sorted(result["changed_in_last"].items(), key=lambda item: -item[1])
    if changed:
        grids.append(
            Grid(
                title="where these policies differ",
                headings=("row", "share of runs"),
                rows=[(row, f"{share:.1%}") for row, share in changed if share > SHIFTS],
                numeric=frozenset({1}),
            )
        )
    if result["unstable"]:
        grids.append(_theory(result["unstable"]))
    return grids


def _theory(found: dict[str, Any]) -> Grid:
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
    return Grid(
        title=f"{found['row']}: fixed point of the learner, noise at rate {found['rate']:g}, and "
        "predicted and observed shares of final policies",
        headings=("action", "Q", "gap", "noise", "linear", "switching", "observed", "95 %"),
        rows=rows,
        numeric=frozenset(range(1, 8)),
    )
