"""The command that trains by sampling and says exactly what was learned."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exact_mdp.analysis.cli.options import given, number_of, whole_of
from exact_mdp.analysis.cli.render import Report

if TYPE_CHECKING:
    from exact_mdp.mdp.io.load import Loaded
    from exact_mdp.solvers.learning.q_learning import QLearning


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
    **options: Any,
) -> Report:
    """Train on MODEL as Yuan et al. (2025) do, and compute exactly what the policies are worth.

    Regret is that of the final greedy policies, at the model's discount, over the seeds.
    """
    from exact_mdp.analysis.cli.trained import explained, facts, grids, save, summary
    from exact_mdp.analysis.learning.instability import require_theory
    from exact_mdp.analysis.learning.outcomes import outcomes
    from exact_mdp.solvers import solve
    from exact_mdp.solvers.learning.training import train_many

    asked = given(model, sets, discount)
    loaded = asked.loaded
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
    return asked.report(result, facts(result), grids(result))


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
    exploration = named.get(epsilon) or Constant(number_of(epsilon, "--epsilon"))
    if columns is not None:
        names = loaded.mdp.space.names
        columns = names if columns == "all" else tuple(name.strip() for name in columns.split(","))
    return QLearning(
        method=options["method"],
        epochs=whole_of(options["epochs"], "--epochs", 1, 10**7),
        episodes=whole_of(options["episodes"], "--episodes", 1, 10**9),
        discount=_discount(options["learning_discount"]),
        rate=Constant(number_of(options["rate"], "--rate")),
        rate_power=number_of(options["rate_power"], "--rate-power"),
        exploration=exploration,
        columns=columns,
        initial=number_of(options["initial"], "--initial"),
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
