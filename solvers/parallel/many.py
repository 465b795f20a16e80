"""Many independent pieces of work: here, on all cores, or on a cluster; resumable, in order.

The result depends neither on where a piece is done nor on who finishes first: each piece carries
all that it needs, its seed too. With a folder, every finished piece is written at once, whole or
not at all, and is read instead of done again when the same work is called once more
(`solvers.parallel.pieces`).

A process, here or there, does a piece only where it has the code of the one that sent it, as
`solvers.parallel.sources` checks: one that starts after a file changed is refused.

Cores are processes of joblib (loky; another joblib backend where `joblib.parallel_config` says so),
or its threads for compiled loops that need no interpreter lock. A cluster is a Dask scheduler; see
`solvers.parallel.cluster`.
"""

from __future__ import annotations

import os
import platform
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.solvers.parallel.cluster import ATTEMPTS, Task, died, on_cluster
from exact_mdp.solvers.parallel.pieces import Arrays, kept, open_folder, read_piece, write_piece
from exact_mdp.solvers.parallel.sources import here, require

joblib, tqdm = later("joblib"), later("tqdm")
loky = later("joblib.externals.loky.process_executor")
tracker = later("joblib.externals.loky.backend.resource_tracker")

Work = Callable[[Any], Mapping[str, Any]]


def many(
    work: Work,
    pieces: Sequence[Any],
    *,
    key: Mapping[str, object],
    n_jobs: int | None = 1,
    threads: bool = False,
    scheduler: str | None = None,
    folder: str | Path | None = None,
    files: tuple[str, str] = ("work.json", ""),
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
        JSON values that say what this work is: model, settings, seed. Not how many pieces, where
        earlier pieces stay the same when more are asked for.
    n_jobs : int, optional
        Processes: 1 works in this one, None on all cores. With `scheduler="local"`, the workers.
    threads : bool
        Threads of this process instead, for work that needs no interpreter lock.
    scheduler : str, optional
        A Dask scheduler, "tcp://host:port", or "local" for one that ends with the call.
    folder : path, optional
        Where finished pieces are kept; those of an earlier call with the same key are used again.
    files : (str, str)
        Name of the folder's record, and the beginning of the names of its pieces.
    progress : bool
        Show a bar on standard error where that is a terminal.
    what : str
        What pieces are called, for the bar and for messages.

    Returns
    -------
    list of {name: array}

    Raises
    ------
    ModelError
        Where the folder holds other work or a damaged file, `n_jobs` is not a count, Dask is not
        installed, the scheduler does not answer, or a process has other code. What `work` raises is
        raised as it is.

    Examples
    --------
    >>> [found["x"].item() for found in many(dict, [{"x": 1}, {"x": 2}], key={})]
    [1, 2]
    """
    whole = isinstance(n_jobs, int) and not isinstance(n_jobs, bool)
    if n_jobs is not None and not (whole and n_jobs >= 1):
        raise ModelError(f"n_jobs is {n_jobs!r}", where=what, fix="give a whole number > 0")
    record, stem = files
    place = None if folder is None else open_folder(folder, dict(key), name=record, what=what)
    done: dict[int, Arrays] = {}

    def file_of(index: int) -> Path:
        return Path() if place is None else place / f"{stem}{index:06d}.npz"

    for index in range(len(pieces) if place else 0):
        found = read_piece(file_of(index))
        if found is not None:
            done[index] = found
    tasks = [(index, piece) for index, piece in enumerate(pieces) if index not in done]
    with (
        kept(done, len(pieces), what, place),
        tqdm.tqdm(
            total=len(pieces),
            initial=len(done),
            desc=what,
            disable=None if progress else True,
            delay=1,
        ) as bar,
        closing(_as_done(work, tasks, n_jobs, threads, scheduler)) as results,
    ):
        for index, result in results:
            if place is not None:
                write_piece(file_of(index), result)
            done[index] = result
            bar.update()
    return [done[index] for index in range(len(pieces))]


def _as_done(
    work: Work, tasks: Sequence[Task], n_jobs: int | None, threads: bool, scheduler: str | None
) -> Generator[tuple[int, Arrays]]:
    """Yield (number, `work(piece)`) as they are finished, in any order."""
    if not tasks:
        return
    if scheduler is not None:
        with closing(on_cluster(_one, work, tasks, scheduler, n_jobs)) as results:
            yield from results
    elif n_jobs == 1:
        yield from (_one(work, *task) for task in tasks)
    else:
        with closing(_on_cores(work, tasks, n_jobs, threads)) as results:
            yield from results


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
    work: Work, tasks: Sequence[Task], n_jobs: int | None, threads: bool
) -> Generator[tuple[int, Arrays]]:
    left = dict(tasks)
    # Threads have the code of this process; others may have begun after a file changed.
    do = joblib.delayed(_one if threads else partial(_guarded, here()))
    how = {"backend": "threading"} if threads else {}
    if not threads:
        _track_quietly()
    for attempt in range(ATTEMPTS + 1):
        parallel = joblib.Parallel(
            n_jobs=-1 if n_jobs is None else n_jobs,
            return_as="generator_unordered",
            batch_size=1,
            **how,
        )
        with _quietly(parallel(do(work, *task) for task in list(left.items()))) as results:
            try:
                for index, result in results:
                    del left[index]
                    yield index, result
                return
            except loky.TerminatedWorkerError as error:
                if attempt == ATTEMPTS:
                    raise died(min(left)) from error


def _track_quietly() -> None:
    """Start the process that gives back the semaphores of a program that a signal ended.

    It outlives the program, and would warn of each semaphore after the program's last word.
    """
    before = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [before, "ignore:resource_tracker"]))
    try:
        tracker.ensure_running()
    finally:
        del os.environ["PYTHONWARNINGS"]
        if before is not None:
            os.environ["PYTHONWARNINGS"] = before


@contextmanager
def _quietly(results: Generator[Any]) -> Iterator[Generator[Any]]:
    """Close results in the end, without joblib's warning of pieces that nobody took any more."""
    try:
        yield results
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            results.close()
