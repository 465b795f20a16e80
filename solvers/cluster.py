"""Pieces of work on a Dask cluster, none of which is lost with a worker.

Pieces are sent within their tasks, not scattered to workers, and a task whose worker dies is given
to another one: by the scheduler, and by this module where the scheduler gives up. What all pieces
share, the work itself, crosses to each worker once: it is the result of a task too, which is done
again where the workers that hold it die.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import closing, contextmanager
from importlib import import_module
from itertools import islice
from queue import Empty, SimpleQueue
from typing import Any

from mdp.errors import ModelError

ANSWER_WITHIN = 15.0  # seconds for a scheduler to answer, and again for a first worker
LOOK_AFTER = 1.0  # seconds without a result after which the scheduler is looked for
ATTEMPTS = 3  # times that a piece is done again after the workers doing it died
GONE = ("closing", "closed")  # what a client says of itself that has given its scheduler up

ADDRESS = re.compile(r"[a-z]+://(\[[^\]/]+\]|[^\s/:]+):[0-9]{1,5}")

One = Callable[[Any, int, Any], Any]


def on_cluster(
    one: One, work: Any, tasks: Sequence[tuple[int, Any]], scheduler: str, n_jobs: int | None
) -> Generator[Any]:
    """Yield `one(work, number, piece)` for every (number, piece), in any order.

    Parameters
    ----------
    scheduler : str
        "tcp://host:port", or "local" for one that ends with the call.
    n_jobs : int, optional
        Worker processes of a local one; all cores where None.

    Raises
    ------
    ModelError
        Where Dask is not installed, the scheduler does not answer, has no worker or goes away, or
        the workers that do a piece die time after time. What `one` raises is raised as it is.
    """
    with (
        _client(scheduler, n_jobs) as client,
        closing(_results(one, work, tasks, client)) as results,
    ):
        yield from results


def died(index: int) -> ModelError:
    """Return the error for a piece during which worker processes died time after time."""
    return ModelError(
        f"the processes at work died, however often it was tried ({ATTEMPTS + 1})",
        where=f"piece {index}",
        fix="give them more memory, or choose fewer of them; pieces that are finished are kept",
    )


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


def _results(one: One, work: Any, tasks: Sequence[tuple[int, Any]], client: Any) -> Generator[Any]:
    killed = _distributed().KilledWorker
    coming = iter(tasks)
    deaths: dict[int, int] = {}
    pending: dict[Any, tuple[int, Any]] = {}
    ended: SimpleQueue[Any] = SimpleQueue()
    shared = _shared(work, client)
    address = str(client.scheduler.address)  # a client that gives up forgets it

    def submit(task: tuple[int, Any]) -> None:
        future = client.submit(one, shared, *task, pure=False)
        pending[future] = task
        future.add_done_callback(ended.put)

    # A few for each thread wait at the scheduler; all of them at once would fill its memory.
    for task in islice(coming, max(64, 4 * sum(client.nthreads().values()))):
        submit(task)
    try:
        while pending:
            try:
                future = ended.get(timeout=LOOK_AFTER)
            except Empty:
                # What was sent to a scheduler that is gone for good never ends.
                if client.status in GONE:
                    raise _gone(address) from None
                continue
            index, piece = pending.pop(future)
            error = None
            if future.status == "finished":
                try:
                    result = future.result()
                except (OSError, CancelledError) as lost:  # with the scheduler, on its way here
                    error = lost
                else:
                    yield result
                    for following in islice(coming, 1):
                        submit(following)
                    continue
            elif future.status == "error":
                error = future.exception()
                if not isinstance(error, killed):
                    future.result()  # raises what was raised over there
            if client.status in GONE:
                raise _gone(address)
            deaths[index] = deaths.get(index, 0) + 1
            if deaths[index] > ATTEMPTS:
                raise died(index) from error
            if shared.status not in {"pending", "finished"}:
                shared = _shared(work, client)
            submit((index, piece))
    finally:
        if client.status not in GONE:
            client.cancel(list(pending))


def _gone(address: str) -> ModelError:
    return ModelError(
        "the scheduler has gone",
        where=address,
        fix="start it again; pieces that were written to a folder are kept",
    )


def _shared(work: Any, client: Any) -> Any:
    """Return the work as the result of a task, which is sent to a worker once."""
    import dask

    # Large models are meant to be sent: no warning of their size.
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
        return client.submit(_itself, work, pure=False)


def _itself(work: Any) -> Any:
    return work
