"""Many runs of a learner, side by side, resumable, the same whatever the number of workers.

Run i draws from the i-th child of the seed (`SeedSequence.spawn`), so that it depends neither on
how many runs there are nor on who does them. A finished run is written to its own file at once, and
read instead of done again when the training is called once more (`solvers.parallel.run_pieces`).
Workers are threads, as the compiled loop needs no interpreter lock, unless joblib is given another
backend.
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

STEM = "runs-"  # of the files of runs, before their numbers
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
        How many. Run i is `settings.train(model, child(rng, i))`.
    rng : int, numpy.random.Generator or SeedSequence
    n_jobs : int, optional
        Threads; all cores where None, or the workers of the backend that `joblib.parallel_config`
        names. The result does not depend on it.
    out : path, optional
        Folder for finished runs. Those of an earlier call with the same model, settings and seed
        are used again; more runs may be asked for than before.
    progress : bool
        Show a bar on standard error where that is a terminal.

    Returns
    -------
    list of TrainingRun

    Raises
    ------
    ModelError
        Where the folder holds the training of another model, other settings or another seed, or a
        file in it is damaged; where `n_jobs` is not a count.

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
        names=[f"{STEM}{number:06d}" for number in range(n)],
        progress=progress,
        what="runs",
    )
    read: list[dict[str, Any]] = [
        {name: array if array.ndim else array.item() for name, array in run.items()} for run in runs
    ]
    return [TrainingRun(space=space, **each) for each in read]


def _train_once(settings: QLearning, model: MDP, root: SeedSequence, number: int) -> dict[str, Any]:
    """Return a run as arrays, which is what crosses between processes."""
    run = settings.train(model, spawn_child_seed(root, number))
    return {name: getattr(run, name) for name in RECORDED}
