"""Pieces of work on a Dask cluster, none of which is lost with a worker.

Pieces are sent within their tasks, not scattered to workers, and a task whose worker dies is given
to another one: by the scheduler, and by this module where the scheduler gives up. What all pieces
share, the work itself, crosses to each worker once: it is the result of a task too, which is done
again where the workers that hold it die.

A worker has code of its own. Each is asked for it (`solvers.parallel.sources`) before it is given
anything, and each piece carries what it must be, for those that come later. Whoever has other
sources or other versions is refused by name. So is a worker that does not answer, as one with
another version of Dask may not. Where no worker is left, the call ends too.

How long a scheduler, a first worker, an answer and a worker's return are waited for is Dask's
setting `exact-mdp.timeout`, in seconds, 30 unless given: DASK_EXACT_MDP__TIMEOUT in the
environment, or `dask.config.set({"exact-mdp.timeout": 120})`. It limits no piece of work.
"""

from __future__ import annotations

import asyncio
import logging
import math
import re
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import closing, contextmanager
from functools import partial
from itertools import islice
from queue import Empty, SimpleQueue
from typing import Any

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import load
from exact_mdp.solvers.parallel.sources import TRAVEL, difference, here, require, unlike

ANSWER_WITHIN = 30.0  # seconds for a scheduler, a first worker, an answer; see above
LOOK_AFTER = 1.0  # seconds without a result after which scheduler and workers are looked for
ATTEMPTS = 3  # times that a piece is done again after the workers doing it died
GONE = ("closing", "closed")  # what a client says of itself that has given its scheduler up

ADDRESS = re.compile(r"[a-z]+://(\[[^\]/]+\]|[^\s/:]+):[0-9]{1,5}")

# Asked as text, which every version of Python and of Dask can carry.
CODE = "__import__('exact_mdp.solvers.parallel.sources', fromlist=['here']).here()"
VERSIONS = (
    "{'Python': '.'.join(__import__('platform').python_version_tuple()[:2])}"
    f" | {{name: __import__('importlib.metadata', fromlist=['version']).version(name)"
    f" for name in {TRAVEL!r}}}"
)
SHOWN = 5  # workers in a message

One = Callable[[Any, int, Any], Any]
Task = tuple[int, Any]  # the number of a piece, and the piece


def on_cluster(
    one: One, work: Any, tasks: Sequence[Task], scheduler: str, n_jobs: int | None
) -> Generator[Any]:
    """Yield `one(work, number, piece)` for every (number, piece), in any order.

    The scheduler is "tcp://host:port", or "local" for one of `n_jobs` processes that ends with the
    call. ModelError says where Dask is missing, the scheduler does not answer, has no worker or
    goes away, a worker has other code or does not answer, none is left, or the workers that do a
    piece die time after time. What `one` raises is raised as it is.
    """
    wanted, within = here(), _timeout()
    with _client(scheduler, n_jobs, within) as client:
        crew = _Crew(client, wanted, within)
        crew.meet()
        with closing(_results(one, work, tasks, crew)) as results:
            yield from results


def died(index: int) -> ModelError:
    """Return the error for a piece during which worker processes died time after time."""
    return ModelError(
        f"the worker processes died in each of {ATTEMPTS + 1} attempts",
        where=f"piece {index}",
        fix="give them more memory, or use fewer of them; finished pieces are kept",
    )


def _gone(address: str) -> ModelError:
    return ModelError(
        "the scheduler has gone",
        where=address,
        fix="start it again; pieces that were written to a folder are kept",
    )


def _timeout() -> float:
    """Return the seconds that an answer is waited for."""
    load("distributed")
    given = load("dask.config").get("exact-mdp.timeout", None)
    if given is None:
        return ANSWER_WITHIN
    number = isinstance(given, int | float) and not isinstance(given, bool)
    if not number or not 0 < given < math.inf:
        raise ModelError(
            f"the timeout is {given!r}",
            where="exact-mdp.timeout, a setting of Dask",
            fix="give seconds, a number > 0",
        )
    return float(given)


# ---- who is there --------------------------------------------------------------------------------


@contextmanager
def _client(scheduler: str, n_jobs: int | None, within: float) -> Iterator[Any]:
    """Give a client of a scheduler that answers and has a worker."""
    distributed = load("distributed")
    if scheduler == "local":
        # A free port for its status page: the usual one may be in use. Workers that are slow to
        # end do not matter: the results are all here by then.
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
    advice = (
        "start `dask scheduler` and `dask worker`, or check the address and that they have the "
        "version of Dask that is installed here"
    )

    def start(self: Any, **how: Any) -> None:
        """Close a client that cannot start: it is not left to the end of the process."""
        try:
            distributed.Client.start(self, **how)
        except BaseException:
            self.close(timeout=within)
            raise

    connect: Any = type("Client", (distributed.Client,), {"start": start})
    try:
        with warnings.catch_warnings():  # of other versions: they are refused by name
            warnings.simplefilter("ignore", distributed.versions.VersionMismatchWarning)
            client = connect(scheduler, timeout=within, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ModelError(
            f"no scheduler answers: {str(error)[:200]}", where=scheduler, fix=advice
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=within)
        except TimeoutError as error:
            raise ModelError("the scheduler has no worker", where=scheduler, fix=advice) from error
        yield client


class _Crew:
    """The workers of a scheduler, each asked for its code before it counts."""

    def __init__(self, client: Any, wanted: Mapping[str, str], within: float) -> None:
        self.client, self.wanted, self.within = client, wanted, within
        self.address = str(client.scheduler.address)  # a client that gives up forgets it
        self.met: set[str] = set()  # addresses of workers that have this process's code
        self.seen = time.monotonic()

    def meet(self) -> None:
        """Ask the workers that came since; refuse those with other code, and where none is left."""
        present = self._answer(self.client.nthreads)
        if not isinstance(present, dict):  # who cannot be asked may be gone: the client finds out
            return
        if present:
            self.seen = time.monotonic()
        elif time.monotonic() - self.seen > self.within:
            raise ModelError(
                f"there has been no worker for {self.within:g} seconds",
                where=self.address,
                fix="start workers again; finished pieces are kept. For slow ones set "
                "DASK_EXACT_MDP__TIMEOUT to more seconds",
            )
        came = set(present) - self.met
        if not came:
            return
        if not self.met:
            self._meet_scheduler()
        found = self._codes(came)
        now = self._answer(self.client.nthreads)
        left = set(now) if isinstance(now, dict) else set()
        told = {
            worker: words
            for worker in sorted(came & left)
            if (words := self._unlike(found[worker], self.wanted))
        }
        if told:
            names = "; ".join(f"{worker}: {told[worker]}" for worker in list(told)[:SHOWN])
            more = f"; and {len(told) - SHOWN} more" if len(told) > SHOWN else ""
            raise unlike(names + more, f"{len(told)} of {len(left)} workers of {self.address}")
        self.met |= came & left

    def _meet_scheduler(self) -> None:
        """Compare what work travels on with what the scheduler has: it computes nothing."""
        answer = self._answer(partial(self.client.run_on_scheduler, eval, VERSIONS))
        told = self._unlike(answer, {name: self.wanted[name] for name in ("Python", *TRAVEL)})
        if told:
            raise unlike(f"the scheduler: {told}", self.address)

    def _unlike(self, answer: object, wanted: Mapping[str, str]) -> str:
        """Return in words what is wrong with an answer; "" where nothing is."""
        if isinstance(answer, dict):
            return difference(wanted, answer)
        if isinstance(answer, TimeoutError):
            return f"no answer within {self.within:g} seconds; other versions of Python or Dask?"
        return f"{type(answer).__name__}: {' '.join(str(answer).split())[:200]}"

    def _codes(self, workers: Iterable[str]) -> dict[str, object]:
        """Return the code of each worker, or the error that asking it ends in."""

        async def one(worker: str) -> object:
            asked = self.client.run(eval, CODE, workers=[worker], on_error="return")
            try:
                return (await asyncio.wait_for(asked, self.within))[worker]
            except Exception as error:  # whatever the error is, it speaks of this worker
                return error

        async def each() -> dict[str, object]:
            return dict(zip(names, await asyncio.gather(*map(one, names)), strict=True))

        names = list(workers)
        found = self._answer(each, 2 * self.within)
        return found if isinstance(found, dict) else dict.fromkeys(names, found)

    def _answer(self, ask: Callable[[], Any], within: float | None = None) -> Any:
        """Return what is awaited, or the error that it ends in."""

        async def waited() -> Any:
            return await asyncio.wait_for(ask(), within or self.within)

        try:
            return self.client.sync(waited)
        except Exception as error:
            return error


# ---- what they do --------------------------------------------------------------------------------


def _results(one: One, work: Any, tasks: Sequence[Task], crew: _Crew) -> Generator[Any]:
    client, killed = crew.client, load("distributed").KilledWorker
    coming = iter(tasks)
    deaths: dict[int, int] = {}
    pending: dict[Any, Task] = {}
    ended: SimpleQueue[Any] = SimpleQueue()
    shared = _shared(work, client)

    def submit(task: Task) -> None:
        future = client.submit(_guarded, one, crew.wanted, shared, *task, pure=False)
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
                    raise _gone(crew.address) from None
                crew.meet()
                continue
            index, piece = pending.pop(future)
            error = None
            if future.status == "finished":
                try:
                    result = future.result()
                except (OSError, CancelledError, killed) as lost:
                    # With the scheduler, on its way here, or with the worker that had it.
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
                raise _gone(crew.address)
            deaths[index] = deaths.get(index, 0) + 1
            if deaths[index] > ATTEMPTS:
                raise died(index) from error
            if shared.status not in {"pending", "finished"}:
                shared = _shared(work, client)
            submit((index, piece))
    finally:
        if client.status not in GONE:
            client.cancel(list(pending))


def _shared(work: Any, client: Any) -> Any:
    """Return the work as the result of a task, which is sent to a worker once."""
    # Large models are meant to be sent: no warning of their size.
    with load("dask.config").set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
        return client.submit(_itself, work, pure=False)


def _guarded(one: One, wanted: Mapping[str, str], work: Any, index: int, piece: Any) -> Any:
    """Do a piece where this worker has the code that it was sent with."""
    require(wanted, f"worker {load('distributed').get_worker().address}")
    return one(work, index, piece)


def _itself(work: Any) -> Any:
    return work
