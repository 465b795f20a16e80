"""Run many independent pieces of work in parallel, with resumable results in a folder.

The result depends neither on where a piece runs nor on which one finishes first: each piece carries
everything that it needs, including its seed. joblib runs them in threads, processes or another of
its backends: `with joblib.parallel_config(backend="dask")` sends them to a Dask cluster.

With a folder, every finished piece is written immediately and atomically. A later call with the
same record reads the finished pieces instead of running them again. The record is JSON and contains
everything that the pieces depend on, so that pieces of different work cannot be mixed.
"""

from __future__ import annotations

import io
import json
import os
import warnings
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from hashlib import sha256
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
import tqdm
from numpy.random import SeedSequence

from exact_mdp.mdp.errors import ModelError, require_type
from exact_mdp.mdp.io.files import LARGEST, read_bytes, read_text, write_atomically
from exact_mdp.mdp.io.structured import json_of, read_arrays
from exact_mdp.mdp.table import Numbers
from exact_mdp.mdp.validate import require_count

Arrays = dict[str, Numbers]
Work = Callable[[Any], Mapping[str, Any]]


def run_pieces(
    work: Work,
    pieces: Sequence[Any],
    *,
    key: Mapping[str, object],
    n_jobs: int | None = 1,
    threads: bool = False,
    folder: str | Path | None = None,
    names: Iterable[str] | None = None,
    progress: bool = False,
    what: str = "runs",
) -> list[Arrays]:
    """Return `work(piece)` for every piece, in their order; exceptions of `work` propagate.

    `work` maps a piece that can be pickled to {name: array}, and can itself be pickled. `key`
    identifies the work by JSON values: model, settings, seed. `n_jobs` is the number of processes,
    at most one for each core and each piece; None takes all cores, or all workers of the backend
    that `joblib.parallel_config` names. With `threads` they are threads of this process, for work
    that releases the interpreter lock. Finished pieces are kept in the `folder`, in files with
    these `names`, numbered by default. `what` is the word for pieces in the progress bar and in
    messages.
    """
    if n_jobs is not None:
        n_jobs = require_count(n_jobs, "n_jobs")
    if folder is None:
        place = None
    else:
        place = _open_folder(folder_of(folder), key, what=what)
    # Read the pieces that an earlier call has finished.
    stems = names or (f"{index:06d}" for index in range(len(pieces)))
    paths = [place and place / f"{stem}.npz" for stem in stems]
    known = ((index, _read_piece(path)) for index, path in enumerate(paths) if path)
    done = {index: arrays for index, arrays in known if arrays is not None}
    tasks = {index: piece for index, piece in enumerate(pieces) if index not in done}
    # None shows the bar only on a terminal.
    disable: bool | None = True
    if progress:
        disable = None
    bar = tqdm.tqdm(total=len(pieces), initial=len(done), desc=what, disable=disable, delay=1)
    # Keep each piece as soon as it is finished; the caller shows the note on an interruption.
    try:
        with bar, closing(_as_done(work, tasks, n_jobs, threads)) as results:
            for index, result in results:
                path = paths[index]
                if path:
                    _write_arrays(path, result)
                done[index] = result
                bar.update()
    except KeyboardInterrupt as stop:
        if place is not None:
            stop.add_note(
                f"the finished part ({what}: {len(done)} of {len(pieces)}) is kept in {place}, "
                "and the same command goes on from there"
            )
        raise
    return [done[index] for index in range(len(pieces))]


def _run_piece(work: Work, index: int, piece: Any) -> tuple[int, Mapping[str, Any]]:
    """Run one piece; this is the function that is sent to workers."""
    return index, work(piece)


def _as_done(
    work: Work, left: dict[int, Any], n_jobs: int | None, threads: bool
) -> Generator[tuple[int, Arrays]]:
    """Yield (number, `work(piece)`) as they are finished, in any order."""
    import joblib
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    # A single worker is this process itself, without joblib.
    results: Any = (_run_piece(work, *task) for task in left.items())
    n_jobs = _count_workers(n_jobs, len(left))
    if n_jobs != 1:
        prefer: str | None = "threads"
        if not threads:
            prefer = None
            _track_quietly()
        # joblib's word for all workers is -1.
        if n_jobs is None:
            n_jobs = -1
        try:
            parallel = joblib.Parallel(
                n_jobs=n_jobs, prefer=prefer, return_as="generator_unordered", batch_size=1
            )
        except ValueError as error:  # the backend cannot return results out of order
            fix = 'choose "loky", "threading" or "dask"'
            raise ModelError(str(error), where="joblib.parallel_config", fix=fix) from error
        results = parallel([joblib.delayed(_run_piece)(work, *task) for task in left.items()])
    try:
        for index, result in results:
            yield index, {name: np.asarray(value) for name, value in result.items()}
    except TerminatedWorkerError as error:
        raise ModelError(
            "a worker process died, possibly out of memory",
            where="n_jobs",
            fix="use fewer processes; finished work is kept in the folder, if there is one",
        ) from error
    finally:
        # joblib would warn about results that were not consumed.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            results.close()


def _count_workers(wanted: int | None, pieces: int) -> int | None:
    """Return the number of workers to start; None for all workers of a user's own backend.

    On this machine there are at most as many as cores and as pieces.
    """
    from joblib import cpu_count
    from joblib.parallel import get_active_backend

    backend, _ = get_active_backend()
    if pieces and type(backend).__module__ != "joblib._parallel_backends":
        return wanted
    cores: int = cpu_count()
    if wanted is None:
        wanted = cores
    return max(1, min(wanted, cores, pieces))


def _track_quietly() -> None:
    """Start the process that frees semaphores, with its warnings at the program's end ignored."""
    from joblib.externals.loky.backend import resource_tracker as tracker

    before = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [before, "ignore:resource_tracker"]))
    try:
        tracker.ensure_running()
    finally:
        del os.environ["PYTHONWARNINGS"]
        if before is not None:
            os.environ["PYTHONWARNINGS"] = before


# ---- a folder of finished pieces -----------------------------------------------------------------


def folder_of(given: object) -> Path:
    """Return the folder in which work is kept; raise ModelError unless a path is given."""
    return Path(require_type(given, str | os.PathLike, "folder", "give a path"))


def _open_folder(folder: Path, record: Mapping[str, object], *, what: str) -> Path:
    """Return the folder, created if missing, after checking that it belongs to this record."""
    text = json.dumps(dict(record), indent=2)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ModelError(
            f"cannot make the folder: {error.strerror}", where=str(folder), fix="choose another"
        ) from error
    path = folder / "work.json"
    # A new folder gets the record; an old one must have the same.
    if not path.exists():
        write_atomically(path, text + "\n")
        return folder
    try:
        content = json_of(read_text(path), str(path))
    except ModelError as error:
        raise ModelError(error.what, where=error.where, fix="choose another folder") from error
    wanted = json.loads(text)
    if content != wanted:
        known = {}
        if isinstance(content, dict):
            known = content
        # Name the keys of the record that differ, if it has any.
        joined = ", ".join(key for key, value in wanted.items() if known.get(key) != value)
        problem = f"the folder holds {what} of other work: its record differs"
        if joined:
            problem += f" in {joined}"
        raise ModelError(
            problem,
            where=str(folder),
            fix="choose another folder, or delete this one",
        )
    return folder


def _write_arrays(path: Path, arrays: Mapping[str, Numbers]) -> None:
    """Write arrays as an .npz file with its digest; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    write_atomically(path, buffer.getvalue() + sha256(buffer.getvalue()).digest())


def _read_piece(path: Path) -> Arrays | None:
    """Return the arrays of a piece, or None if it is missing; ModelError if it is damaged."""
    if not path.exists():
        return None
    content = read_bytes(path, most=LARGEST)
    # The digest follows the archive.
    size = sha256().digest_size
    archive, digest = content[:-size], content[-size:]
    if sha256(archive).digest() != digest:
        fix = "delete it: its runs are then done again"
        raise ModelError("the file is damaged", where=str(path), fix=fix)
    return read_arrays(archive)


# ---- draws in blocks ---------------------------------------------------------------------------


class How(TypedDict, total=False):
    """Options of `run_pieces` for where the work runs; results do not depend on them.

    The workers of a care scenario are threads; for other models they are processes.
    """

    n_jobs: int | None
    folder: str | Path | None
    progress: bool


def seed_blocks(seed: int, n: int, block: int) -> list[tuple[SeedSequence, int]]:
    """Return blocks of n draws: a stream and a number of draws for each."""
    sizes = [min(block, n - first) for first in range(0, n, block)]
    return list(zip(SeedSequence(seed).spawn(len(sizes)), sizes, strict=True))


def join_blocks(blocks: Sequence[Arrays], names: Iterable[str] | None = None) -> Arrays:
    """Return arrays of all draws, by name: of all names by default."""
    if names is None:
        names = blocks[0]
    joined = {}
    for name in names:
        joined[name] = np.concatenate([block[name] for block in blocks])
    return joined
