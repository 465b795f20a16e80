"""Train many runs of a learner in parallel, with the same results for any number of workers.

Run i draws from the i-th child of the seed (`SeedSequence.spawn`), so it depends neither on
the number of runs nor on the worker. A finished run is written immediately to its own file, which a
later call reads instead of training again (`solvers.parallel.run_pieces`). Workers are threads, as
the compiled loop releases the interpreter lock, unless joblib is given another backend.
"""

from __future__ import annotations

from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

from numpy.random import SeedSequence

from exact_mdp.mdp.errors import ModelError, named_options
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.validate import require_count
from exact_mdp.solvers.learning.q_learning import QLearning, TrainingRun
from exact_mdp.solvers.learning.sampler import (
    Seed,
    as_sequence,
    build_q_table_rows,
    spawn_child_seed,
)
from exact_mdp.solvers.parallel import run_pieces

RECORDED = [field.name for field in fields(TrainingRun) if field.name != "space"]


@named_options
def train(
    model: MDP,
    settings: QLearning,
    n: int,
    *,
    rng: Seed | None = None,
    n_jobs: int | None = 1,
    out: str | Path | None = None,
    progress: bool = False,
) -> list[TrainingRun]:
    """Return independent runs of a learner.

    Parameters
    ----------
    model : MDP
    settings : QLearning
    n : int
        Number of runs. Run i is `settings.train(model, child(rng, i))`.
    rng : int, numpy.random.Generator or SeedSequence
    n_jobs : int, optional
        Number of threads; None takes all cores, or the workers of the backend that
        `joblib.parallel_config` names. The result does not depend on it.
    out : path, optional
        Folder for finished runs. Runs of an earlier call with the same model, settings and seed
        are read from it; `n` may be larger than before.
    progress : bool
        Show a progress bar on standard error if that is a terminal.

    Returns
    -------
    list of TrainingRun

    Raises
    ------
    ModelError
        If the folder holds the training of another model, other settings or another seed, if a
        file in it is damaged, or if `n_jobs` is not a positive integer.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> runs = train(mdp, QLearning(epochs=5), 3, rng=0)
    >>> len(runs), runs[0].q.shape
    (3, (16, 4))
    """
    n = require_count(n, "n")
    learner: object = settings
    if not isinstance(learner, QLearning):
        fix = "give QLearning(), with settings of its own where need be"
        raise ModelError(f"{learner!r} is not a learner", where="train", fix=fix)
    if rng is None:
        raise ModelError("training needs a seed", where="rng", fix="give rng=0, or another number")
    space, root = build_q_table_rows(model, settings.columns).space, as_sequence(rng)
    runs = run_pieces(
        partial(_train_once, settings, model, root),
        range(n),
        key={
            "model_hash": fingerprint(model),
            "settings": repr(settings),
            "seed": str(root.entropy),
            "spawn_key": list(root.spawn_key),
        },
        n_jobs=n_jobs,
        threads=True,
        folder=out,
        names=[f"runs-{number:06d}" for number in range(n)],
        progress=progress,
        what="runs",
    )
    trained = []
    for run in runs:
        # Numbers were stored as arrays without dimensions.
        fields_of_run: dict[str, Any] = dict(run)
        for name, array in run.items():
            if not array.ndim:
                fields_of_run[name] = array.item()
        trained.append(TrainingRun(space=space, **fields_of_run))
    return trained


def _train_once(settings: QLearning, model: MDP, root: SeedSequence, number: int) -> dict[str, Any]:
    """Return a run as arrays, the form in which it is sent between processes and stored."""
    run = settings.train(model, spawn_child_seed(root, number))
    return {name: getattr(run, name) for name in RECORDED}
