"""Many independent pieces of work: here, on all cores, or on a cluster; resumable, in order.

The result depends neither on where a piece is done nor on who finishes first: each piece carries
all that it needs, its seed too. With a folder, every finished piece is written at once, whole or
not at all, and is read instead of done again when the same work is called once more.

Cores are processes of joblib (loky; another joblib backend where `joblib.parallel_config` says so).
A cluster is a Dask scheduler. Pieces are sent within their tasks, not scattered to workers, and a
task whose worker dies is given to another one, so that a lost worker loses no piece.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from mdp.errors import ModelError
from solvers.pieces import Arrays, open_folder, read_piece, write_piece

RECORD = "work.json"
ANSWER_WITHIN = 15.0  # seconds for a scheduler to answer, and again for a first worker
ATTEMPTS = 3  # times that a piece is done again after the workers doing it died

ADDRESS = re.compile(r"[a-z]+://(\[[^\]/]+\]|[^\s/:]+):[0-9]{1,5}")

Work = Callable[[Any], Mapping[str, Any]]


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
        of one, so that it can be sent to other processes.
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
        installed, or the scheduler does not answer. What `work` raises is raised as it is.

    Examples
    --------
    >>> [found["x"].item() for found in many(dict, [{"x": 1}, {"x": 2}], key={})]
    [1, 2]
    """
    from tqdm import tqdm

    if n_jobs is not None and (isinstance(n_jobs, bool) or not isinstance(n_jobs, int)):
        raise ModelError(f"n_jobs is {n_jobs!r}", where=what, fix="give a whole number > 0")
    if n_jobs is not None and n_jobs < 1:
        raise ModelError(f"n_jobs is {n_jobs}", where=what, fix="give a whole number > 0")
    place = None if folder is None else open_folder(folder, dict(key), name=RECORD, what=what)
    files = [None if place is None else place / f"{i:06d}.npz" for i in range(len(pieces))]
    done: dict[int, Arrays] = {}
    for index, file in enumerate(files):
        found = None if file is None else read_piece(file)
        if found is not None:
            done[index] = found
    waiting = [index for index in range(len(pieces)) if index not in done]
    tasks = [(work, index, pieces[index]) for index in waiting]
    with (
        tqdm(
            total=len(pieces),
            initial=len(done),
            desc=what,
            disable=None if progress else True,
            delay=1,
        ) as bar,
        closing(_results(tasks, n_jobs, scheduler)) as results,
    ):
        for index, result in results:
            file = files[index]
            if file is not None:
                write_piece(file, result)
            done[index] = result
            bar.update()
    return [done[index] for index in range(len(pieces))]


Task = tuple[Work, int, Any]


def _one(task: Task) -> tuple[int, Arrays]:
    """Do one piece, wherever this is called."""
    work, index, piece = task
    found = work(piece)
    if not isinstance(found, Mapping):
        raise TypeError(
            f"a piece of work must return {{name: array}}, not a {type(found).__name__}"
        )
    return index, {name: np.asarray(value) for name, value in found.items()}


def _results(
    tasks: list[Task], n_jobs: int | None, scheduler: str | None
) -> Generator[tuple[int, Arrays]]:
    """Yield results as they come, in any order."""
    if not tasks:
        return
    if scheduler is not None:
        with _client(scheduler, n_jobs) as client, closing(_on_cluster(tasks, client)) as results:
            yield from results
    elif n_jobs == 1:
        yield from map(_one, tasks)
    else:
        with closing(_on_cores(tasks, n_jobs)) as results:
            yield from results


def _on_cores(tasks: list[Task], n_jobs: int | None) -> Generator[tuple[int, Arrays]]:
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    left = {task[1]: task for task in tasks}
    for attempt in range(ATTEMPTS + 1):
        parallel = Parallel(
            n_jobs=-1 if n_jobs is None else n_jobs,
            return_as="generator_unordered",
            batch_size=1,
        )
        with closing(parallel(delayed(_one)(task) for task in list(left.values()))) as results:
            try:
                for index, result in results:
                    del left[index]
                    yield index, result
                return
            except TerminatedWorkerError:
                if attempt == ATTEMPTS:
                    raise


# ---- Dask ----------------------------------------------------------------------------------------


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError as error:
        raise ModelError(
            "a scheduler needs Dask, which is not installed",
            where="scheduler",
            fix='install it: pip install "exact-mdp[cluster]"',
        ) from error


@contextmanager
def _client(scheduler: str, n_jobs: int | None) -> Iterator[Any]:
    """Give a client of a scheduler that answers and has a worker."""
    distributed = _distributed()
    if scheduler == "local":
        # A free port for its status page: the usual one may be in use. Workers that are slow to
        # end are no news: the results are all here by then.
        with (
            distributed.LocalCluster(
                n_workers=n_jobs,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.ERROR,
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            yield client
        return
    if not ADDRESS.fullmatch(scheduler):
        raise ModelError(
            "not the address of a scheduler", where=scheduler, fix="write tcp://HOST:PORT, or local"
        )
    advice = "start `dask scheduler` and `dask worker`, or check the address"

    class Client(distributed.Client):  # type: ignore[misc, name-defined]
        """One that is closed where it cannot start, and not left to the end of the process."""

        def start(self, **how: Any) -> None:
            try:
                super().start(**how)
            except BaseException:
                self.close(timeout=ANSWER_WITHIN)
                raise

    try:
        client = Client(scheduler, timeout=ANSWER_WITHIN, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ModelError(
            f"no scheduler answers: {str(error)[:200]}", where=scheduler, fix=advice
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=ANSWER_WITHIN)
        except TimeoutError as error:
            raise ModelError("the scheduler has no worker", where=scheduler, fix=advice) from error
        yield client


def _on_cluster(tasks: list[Task], client: Any) -> Generator[tuple[int, Arrays]]:
    distributed = _distributed()
    coming = iter(tasks)
    deaths: dict[int, int] = {}
    pending: dict[Any, Task] = {}
    finished = distributed.as_completed(loop=client.loop)

    def submit(task: Task) -> None:
        future = client.submit(_one, task, pure=False)
        pending[future] = task
        finished.add(future)

    # A few for each thread wait at the scheduler; all of them at once would fill its memory.
    for task in islice(coming, max(64, 4 * sum(client.nthreads().values()))):
        submit(task)
    try:
        for future in finished:
            task = pending.pop(future)
            if future.status == "finished":
                yield future.result()
                for following in islice(coming, 1):
                    submit(following)
                continue
            error = future.exception() if future.status == "error" else None
            deaths[task[1]] = deaths.get(task[1], 0) + 1
            lost = future.status in {"lost", "cancelled"} or isinstance(
                error, distributed.KilledWorker
            )
            if not lost or deaths[task[1]] > ATTEMPTS:
                future.result()  # raises what was raised over there
            submit(task)
    finally:
        client.cancel(list(pending))
