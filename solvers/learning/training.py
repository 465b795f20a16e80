"""Many runs of a learner, side by side, resumable, the same whatever the number of workers.

Run i draws from the i-th child of the seed (`SeedSequence.spawn`), so that it depends neither on
how many runs there are nor on who does them. Runs are done in blocks of `BLOCK`, which is a single
run, so that an interruption loses no finished one; a finished block is written to its own file at
once, whole or not at all, and read instead of done again when the training is called once more.
Workers are threads, as the compiled loop needs no interpreter lock, or those of a Dask cluster.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing
from functools import partial
from pathlib import Path
from threading import Event

import numpy as np
from numpy.random import SeedSequence

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.fingerprint import fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Numbers
from exact_mdp.solvers.learning.q_learning import QLearning, Trainer, TrainingRun
from exact_mdp.solvers.learning.sampler import as_sequence, child
from exact_mdp.solvers.parallel.many import as_done, check_jobs
from exact_mdp.solvers.parallel.pieces import damaged, kept, open_folder, read_piece, write_piece

BLOCK = 1
RECORD = "training.json"


def train_many(
    mdp: MDP,
    settings: QLearning,
    runs: int,
    *,
    seed: int | SeedSequence,
    n_jobs: int | None = 1,
    scheduler: str | None = None,
    out: str | Path | None = None,
    progress: bool = False,
) -> list[TrainingRun]:
    """Return independent runs of a learner.

    Parameters
    ----------
    runs : int
        How many. Run i is `settings.train(mdp, child(seed, i))`.
    seed : int or SeedSequence
    n_jobs : int, optional
        Threads; all cores where None. With `scheduler="local"`, processes. The result does not
        depend on it.
    scheduler : str, optional
        A Dask scheduler, "tcp://host:port", or "local" for one that ends with the call; see
        `solvers.parallel.many.many`. The result does not depend on it, nor on workers that die.
    out : path, optional
        Folder for finished blocks. Those of an earlier call with the same model, settings and seed
        are used again; more runs may be asked for than before.
    progress : bool
        Show a bar on standard error where that is a terminal.

    Raises
    ------
    ModelError
        Where the folder holds the training of another model, other settings or another seed, or a
        file in it is damaged; where `n_jobs` is no count, or the scheduler does not answer.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> runs = train_many(mdp, QLearning(epochs=5), 3, seed=0)
    >>> len(runs), runs[0].q.shape
    (3, (16, 4))
    """
    from tqdm import tqdm

    if isinstance(runs, bool) or not isinstance(runs, int) or runs < 1:
        raise ModelError(f"runs is {runs!r}", where="train_many", fix="give a whole number > 0")
    check_jobs(n_jobs, "train_many")
    trainer = Trainer(settings, mdp)
    root = as_sequence(seed)
    folder = None if out is None else _folder(Path(out), mdp, settings, root)
    blocks = [range(first, min(first + BLOCK, runs)) for first in range(0, runs, BLOCK)]
    done: dict[int, list[TrainingRun]] = {}
    with (
        kept(done, runs, "runs", folder),
        tqdm(
            total=runs, desc="training", unit="run", disable=None if progress else True, delay=1
        ) as bar,
    ):
        waiting = []
        for block in blocks:
            found = None if folder is None else _read(folder, block, trainer)
            if found is None:
                waiting.append(block)
            else:
                done[block.start] = found
                bar.update(len(found))
        with closing(_train(trainer, root, waiting, n_jobs, scheduler)) as results:
            for block, found in results:
                if folder is not None:
                    write_piece(folder / _name(block), _packed(found))
                done[block.start] = found
                bar.update(len(found))
    return [run for block in blocks for run in done[block.start]]


def _train(
    trainer: Trainer,
    root: SeedSequence,
    blocks: Sequence[range],
    n_jobs: int | None,
    scheduler: str | None,
) -> Generator[tuple[range, list[TrainingRun]]]:
    """Yield blocks of runs as they are finished; an interruption ends after the runs at hand."""
    if scheduler is not None:
        work = partial(_block, trainer, root)
        tasks = list(enumerate(blocks))
        with closing(as_done(work, tasks, n_jobs=n_jobs, scheduler=scheduler)) as results:
            for place, arrays in results:
                yield blocks[place], list(_unpacked(arrays, trainer.rows.space))
        return
    stop = Event()

    def block_of(block: range) -> list[TrainingRun]:
        return [trainer.run(child(root, number)) for number in block if not stop.is_set()]

    workers = (os.cpu_count() or 1) if n_jobs is None else n_jobs
    if workers == 1 or len(blocks) <= 1:
        for block in blocks:
            yield block, block_of(block)
        return
    with ThreadPoolExecutor(workers) as pool:
        pending: dict[Future[list[TrainingRun]], range] = {}
        try:
            pending = {pool.submit(block_of, block): block for block in blocks}
            while pending:
                for future in wait(pending, return_when=FIRST_COMPLETED).done:
                    yield pending.pop(future), future.result()
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)


def _block(trainer: Trainer, root: SeedSequence, block: range) -> dict[str, Numbers]:
    """Return the runs of a block as arrays, which is what crosses between processes."""
    return _packed([trainer.run(child(root, number)) for number in block])


# ---- files ---------------------------------------------------------------------------------------


def _folder(folder: Path, mdp: MDP, settings: QLearning, root: SeedSequence) -> Path:
    """Return the folder, made where it is missing, after checking what it is the training of."""
    record = {
        "model_hash": fingerprint(mdp),
        "settings": repr(settings),
        "seed": str(root.entropy),
        "spawn_key": list(root.spawn_key),
        "runs_per_file": BLOCK,
    }
    return open_folder(folder, record, name=RECORD, what="training")


def _name(block: range) -> str:
    return f"runs-{block.start:06d}.npz"


_PER_RUN = ("q", "snapshots", "last", "returns")
_NUMBERS = ("steps", "cut_short")


def _packed(runs: Sequence[TrainingRun]) -> dict[str, Numbers]:
    """Return a block as arrays: `policies` one run behind the other, the rest stacked."""
    arrays = {name: np.stack([getattr(run, name) for run in runs]) for name in _PER_RUN}
    arrays |= {name: np.array([getattr(run, name) for run in runs]) for name in _NUMBERS}
    arrays["policies"] = np.concatenate([run.policies for run in runs])
    arrays["distinct"] = np.array([len(run.policies) for run in runs])
    return arrays


def _read(folder: Path, block: range, trainer: Trainer) -> list[TrainingRun] | None:
    """Return the runs of a block from its file; None where there is none, or one with fewer."""
    path = folder / _name(block)
    arrays = read_piece(path)
    if arrays is None:
        return None
    try:
        runs = list(_unpacked(arrays, trainer.rows.space))
    except Exception as error:  # arrays that are missing, or do not fit together
        raise damaged(path) from error
    if not all(trainer.possible(run) for run in runs):
        raise damaged(path)
    return runs[: len(block)] if len(runs) >= len(block) else None


def _unpacked(arrays: dict[str, Numbers], space: StateSpace) -> Iterator[TrainingRun]:
    ends = np.cumsum(arrays["distinct"])
    for number, end in enumerate(ends.tolist()):
        values = {name: arrays[name][number] for name in _PER_RUN}
        scalars = {name: arrays[name][number].item() for name in _NUMBERS}
        policies = arrays["policies"][end - int(arrays["distinct"][number]) : end]
        yield TrainingRun(space=space, policies=policies, **values, **scalars)
