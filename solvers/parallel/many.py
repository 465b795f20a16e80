"""Many independent pieces of work: here, on all cores, or on a cluster; resumable, in order.

The result depends neither on where a piece is done nor on who finishes first: each piece carries
all that it needs, its seed too. With a folder, every finished piece is written at once, whole or
not at all, and is read instead of done again when the same work is called once more.

A process, here or there, does a piece only where it has the code of the one that sent it, as
`solvers.parallel.sources` tells: one that starts after a file changed is refused.

Cores are processes of joblib (loky; another joblib backend where `joblib.parallel_config` says so).
A cluster is a Dask scheduler; see `solvers.parallel.cluster`.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.solvers.parallel.cluster import ATTEMPTS, died, on_cluster
from exact_mdp.solvers.parallel.pieces import Arrays, kept, open_folder, read_piece, write_piece
from exact_mdp.solvers.parallel.sources import here, require

RECORD = "work.json"

Work = Callable[[Any], Mapping[str, Any]]
Task = tuple[int, Any]  # a piece and its number


def many(
    work: Work,
    pieces: Sequence[Any],
    *,
    key: Mapping[str, object],
    n_jobs: int | None = 1,
    scheduler: str | None = None,
    folder: str | Path | None = None,
    progress: bool = False,
    what: str = "runs",
) -> list[Arrays]:
    """Return `work(piece)` for every piece, in their order.

    Parameters
    ----------
    work : callable
        From a piece to {name: array}; a function at the top of a module, or a `functools.partial`
        of one, so that it can be sent to other processes. Threads of a worker share it.
    pieces : sequence
        Anything that can be pickled.
    key : mapping
        JSON values that tell what this work is: model, settings, seed. Not how many pieces, where
        earlier pieces stay the same when more are asked for.
    n_jobs : int, optional
        Processes: 1 works in this one, None on all cores. With `scheduler="local"`, the workers.
    scheduler : str, optional
        A Dask scheduler, "tcp://host:port", or "local" for one that ends with the call.
    folder : path, optional
        Where finished pieces are kept; those of an earlier call with the same key are used again.
    progress : bool
        Show a bar on standard error where that is a terminal.
    what : str
        What pieces are called, for the bar and for messages.

    Raises
    ------
    ModelError
        Where the folder holds other work or a damaged file, `n_jobs` is no count, Dask is not
        installed, the scheduler does not answer, or a process has other code. What `work` raises is
        raised as it is.

    Examples
    --------
    >>> [found["x"].item() for found in many(dict, [{"x": 1}, {"x": 2}], key={})]
    [1, 2]
    """
    from tqdm import tqdm

    check_jobs(n_jobs, what)
    place = None if folder is None else open_folder(folder, dict(key), name=RECORD, what=what)
    files = [None if place is None else place / f"{i:06d}.npz" for i in range(len(pieces))]
    done: dict[int, Arrays] = {}
    for index, file in enumerate(files):
        found = None if file is None else read_piece(file)
        if found is not None:
            done[index] = found
    waiting = [index for index in range(len(pieces)) if index not in done]
    tasks = [(index, pieces[index]) for index in waiting]
    with (
        kept(done, len(pieces), what, place),
        tqdm(
            total=len(pieces),
            initial=len(done),
            desc=what,
            disable=None if progress else True,
            delay=1,
        ) as bar,
        closing(as_done(work, tasks, n_jobs=n_jobs, scheduler=scheduler)) as results,
    ):
        for index, result in results:
            file = files[index]
            if file is not None:
                write_piece(file, result)
            done[index] = result
            bar.update()
    return [done[index] for index in range(len(pieces))]


def as_done(
    work: Work, tasks: Sequence[Task], *, n_jobs: int | None = 1, scheduler: str | None = None
) -> Generator[tuple[int, Arrays]]:
    """Yield (number, `work(piece)`) as they are finished, in any order; see `many`.

    For those who keep files of their own; close it, so that an interruption ends the workers too.

    Examples
    --------
    >>> next(as_done(dict, [(7, {"x": 1})]))
    (7, {'x': array(1)})
    """
    if not tasks:
        return
    if scheduler is not None:
        with closing(on_cluster(_one, work, tasks, scheduler, n_jobs)) as results:
            yield from results
    elif n_jobs == 1:
        yield from (_one(work, *task) for task in tasks)
    else:
        with closing(_on_cores(work, tasks, n_jobs)) as results:
            yield from results


def check_jobs(n_jobs: object, what: str) -> None:
    """Raise ModelError unless `n_jobs` is None or a whole number of workers."""
    if n_jobs is None:
        return
    if isinstance(n_jobs, bool) or not isinstance(n_jobs, int) or n_jobs < 1:
        raise ModelError(f"n_jobs is {n_jobs!r}", where=what, fix="give a whole number > 0")


def _one(work: Work, index: int, piece: Any) -> tuple[int, Arrays]:
    """Do one piece, wherever this is called."""
    found = work(piece)
    if not isinstance(found, Mapping):
        raise TypeError(
            f"a piece of work must return {{name: array}}, not a {type(found).__name__}"
        )
    return index, {name: np.asarray(value) for name, value in found.items()}


def _guarded(wanted: Mapping[str, str], work: Work, index: int, piece: Any) -> tuple[int, Arrays]:
    """Do one piece where this process has the code that it was sent with."""
    require(wanted, f"process {os.getpid()} of {platform.node()}")
    return _one(work, index, piece)


def _on_cores(
    work: Work, tasks: Sequence[Task], n_jobs: int | None
) -> Generator[tuple[int, Arrays]]:
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    left, wanted = dict(tasks), here()
    for attempt in range(ATTEMPTS + 1):
        parallel = Parallel(
            n_jobs=-1 if n_jobs is None else n_jobs,
            return_as="generator_unordered",
            batch_size=1,
        )
        with closing(
            parallel(delayed(_guarded)(wanted, work, *task) for task in list(left.items()))
        ) as results:
            try:
                for index, result in results:
                    del left[index]
                    yield index, result
                return
            except TerminatedWorkerError as error:
                if attempt == ATTEMPTS:
                    raise died(min(left)) from error
