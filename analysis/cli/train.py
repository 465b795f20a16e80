"""The command that trains by sampling and says exactly what was learned."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from exact_mdp.analysis.cli.options import float_of, model_options, tell_limit, whole_of
from exact_mdp.analysis.cli.render import show

if TYPE_CHECKING:
    from exact_mdp.mdp.io.load import Loaded
    from exact_mdp.solvers.learning.q_learning import QLearning


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
    "--scheduler",
    metavar="ADDRESS",
    help="Train on a Dask cluster: tcp://HOST:PORT, or local for one on this machine.",
)
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
    scheduler: str | None,
    explain: bool,
    sets: tuple[str, ...],
    discount: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Train on MODEL as Yuan et al. (2025) do, and compute exactly what the policies are worth.

    Regret is that of the final greedy policies, at the model's discount, over the seeds.
    """
    from exact_mdp.analysis.cli.trained import explained, facts, grids, save, summary
    from exact_mdp.analysis.learning.instability import require_theory
    from exact_mdp.analysis.learning.outcomes import outcomes
    from exact_mdp.mdp.io.load import load
    from exact_mdp.solvers import solve
    from exact_mdp.solvers.learning.training import train_many

    loaded = load(model, sets=sets, discount=discount)
    settings, first = _settings(loaded, options), whole_of(seed, "--seed", most=2**128)
    count = whole_of(seeds, "--seeds", 1, 10**7)
    workers = None if jobs is None else whole_of(jobs, "--jobs", 1, 1024)
    if explain:
        require_theory(settings)
    solve(loaded.mdp)  # a model that cannot be judged is refused before the work
    runs = train_many(
        loaded.mdp,
        settings,
        count,
        rng=first,
        n_jobs=workers,
        scheduler=scheduler,
        out=out,
        progress=True,
    )
    found = outcomes(loaded.mdp, runs)
    result = summary(loaded, settings, first, runs, found)
    if explain:
        result["unstable"] = explained(loaded, settings, found)
    if out is not None:
        result["written"] = save(Path(out), loaded, settings, first, runs, found, result)
    tell_limit(loaded.mdp, option=False)
    show(result, as_json=as_json, facts=facts(result), grids=grids(result))


def _settings(loaded: Loaded, options: dict[str, Any]) -> QLearning:
    from exact_mdp.solvers.learning.q_learning import QLearning
    from exact_mdp.solvers.learning.schedules import (
        PAPER_CONSTANT,
        PAPER_DECAYING,
        Constant,
        Schedule,
    )

    named: dict[str, Schedule] = {"constant": PAPER_CONSTANT, "decaying": PAPER_DECAYING}
    epsilon, columns = options["epsilon"], options["columns"]
    exploration = named.get(epsilon) or Constant(_float(epsilon, "--epsilon"))
    if columns is not None:
        names = loaded.mdp.space.names
        columns = names if columns == "all" else tuple(name.strip() for name in columns.split(","))
    return QLearning(
        method=options["method"],
        epochs=whole_of(options["epochs"], "--epochs", 1, 10**7),
        episodes=whole_of(options["episodes"], "--episodes", 1, 10**9),
        discount=_discount(options["learning_discount"]),
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


def _discount(text: str) -> Fraction:
    from exact_mdp.mdp.errors import ModelError
    from exact_mdp.mdp.validate import as_discount

    try:
        return as_discount(text)
    except ModelError as error:
        raise ModelError(error.what, where="--learning-discount", fix=error.fix) from error


def _float(text: str, option: str) -> float:
    value = float_of(text, option)
    assert value is not None
    return value
