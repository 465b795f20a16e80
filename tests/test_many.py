"""Many independent pieces: the same in one process, on cores, on a cluster, and after a halt."""

from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.random import SeedSequence, default_rng

from mdp import ModelError
from solvers import many as many_module
from solvers.many import many

KEY = {"model": "normal draws", "seed": 0}


def draws(seed: int, index: int) -> dict[str, Any]:
    """One piece: random numbers of its own child of the seed."""
    rng = default_rng(SeedSequence(seed, spawn_key=(index,)))
    return {"x": rng.normal(size=50), "count": np.int64(index)}


def draws_with_a_halt(folder: str, index: int) -> dict[str, Any]:
    """The same; the first to do piece 5 tells its process, waits, and is killed meanwhile."""
    mark = Path(folder) / "pid"
    if index == 5 and not mark.exists():
        mark.with_suffix(".new").write_text(str(os.getpid()))
        mark.with_suffix(".new").rename(mark)
        time.sleep(120)
    return draws(0, index)


def draws_that_die(folder: str, index: int) -> dict[str, Any]:
    """The same; the first to do piece 3 ends its own process."""
    mark = Path(folder) / "died"
    if index == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return draws(0, index)


def large(piece: np.ndarray[Any, Any]) -> dict[str, Any]:
    return {"sum": piece.sum()}


def failing(index: int) -> dict[str, Any]:
    if index == 2:
        raise ModelError("piece 2 cannot be done", where="here", fix="leave it out")
    return {"x": np.zeros(1)}


def failing_last(folder: str, index: int) -> dict[str, Any]:
    """The same; piece 2 waits until the files of the others are written."""
    deadline = time.monotonic() + 60
    while index == 2 and time.monotonic() < deadline:
        if all((Path(folder) / f"00000{other}.npz").exists() for other in (0, 1)):
            break
        time.sleep(0.02)
    return failing(index)


def same(found: list[dict[str, Any]], wanted: list[dict[str, Any]]) -> bool:
    return len(found) == len(wanted) and all(
        list(a) == list(b) and all(a[name].tobytes() == b[name].tobytes() for name in a)
        for a, b in zip(found, wanted, strict=True)
    )


WANTED = [
    {name: np.asarray(value) for name, value in draws(0, index).items()} for index in range(12)
]


@pytest.mark.parametrize("n_jobs", [1, 2, None])
def test_results_are_in_order_and_do_not_depend_on_the_processes(n_jobs: int | None) -> None:
    assert same(many(partial(draws, 0), range(12), key=KEY, n_jobs=n_jobs), WANTED)


def test_no_pieces_are_no_results() -> None:
    assert many(partial(draws, 0), [], key=KEY, n_jobs=2) == []


def test_a_folder_is_used_again_and_more_pieces_may_be_asked_for(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "run"
    first = many(partial(draws, 0), range(4), key=KEY, folder=folder)
    times = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert sorted(times) == [*(f"{i:06d}.npz" for i in range(4)), "work.json"]
    again = many(failing, range(4), key=KEY, folder=folder)  # nothing is left to do
    assert same(again, first)
    more = many(partial(draws, 0), range(12), key=KEY, folder=folder, n_jobs=2)
    assert same(more, WANTED)
    assert {n: t for n, t in times.items() if (folder / n).stat().st_mtime_ns != t} == {}


def test_the_files_are_the_same_bytes_whoever_did_them(tmp_path: Path) -> None:
    for name, n_jobs in (("one", 1), ("two", 2)):
        many(partial(draws, 0), range(6), key=KEY, folder=tmp_path / name, n_jobs=n_jobs)
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()


@pytest.mark.parametrize("n_jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_what_is_finished_before_an_error_is_kept(tmp_path: Path, n_jobs: int) -> None:
    work = partial(failing_last, str(tmp_path))
    with pytest.raises(ModelError, match="piece 2 cannot be done"):
        many(work, range(3), key=KEY, folder=tmp_path, n_jobs=n_jobs)
    kept = {path.name for path in tmp_path.glob("*.npz")}
    assert kept == {"000000.npz", "000001.npz"}


def interrupted(index: int) -> dict[str, Any]:
    if index == 3:
        raise KeyboardInterrupt
    return draws(0, index)


def test_an_interruption_loses_no_finished_piece(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        many(interrupted, range(12), key=KEY, folder=tmp_path)
    assert len(list(tmp_path.glob("*.npz"))) == 3
    assert same(many(partial(draws, 0), range(12), key=KEY, folder=tmp_path), WANTED)


def test_a_process_that_dies_loses_no_piece(tmp_path: Path) -> None:
    found = many(partial(draws_that_die, str(tmp_path)), range(12), key=KEY, n_jobs=2)
    assert (tmp_path / "died").exists()
    assert same(found, WANTED)


def test_a_folder_of_other_work_is_refused(tmp_path: Path) -> None:
    many(partial(draws, 0), range(2), key=KEY, folder=tmp_path)
    with pytest.raises(ModelError, match="differs in seed"):
        many(partial(draws, 1), range(2), key=KEY | {"seed": 1}, folder=tmp_path)
    (tmp_path / "000001.npz").write_bytes(b"PK\x03\x04 cut short")
    with pytest.raises(ModelError, match="damaged"):
        many(partial(draws, 0), range(2), key=KEY, folder=tmp_path)
    (tmp_path / "work.json").write_text("{")
    with pytest.raises(ModelError, match="broken JSON"):
        many(partial(draws, 0), range(2), key=KEY, folder=tmp_path)
    with pytest.raises(ModelError, match="cannot make the folder"):
        many(partial(draws, 0), range(2), key=KEY, folder=tmp_path / "work.json" / "below")


@pytest.mark.parametrize("n_jobs", [0, -1, True, 1.5, "2"])
def test_a_wrong_number_of_processes_is_refused(n_jobs: Any) -> None:
    with pytest.raises(ModelError, match="n_jobs is"):
        many(partial(draws, 0), range(2), key=KEY, n_jobs=n_jobs)


# ---- Dask ----------------------------------------------------------------------------------------


@contextmanager
def workers(number: int) -> Iterator[Any]:
    """Worker processes on this machine's own address."""
    import distributed

    with distributed.LocalCluster(
        n_workers=number,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
    ) as local:
        yield local


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with workers(1) as local:
        yield local


def test_a_cluster_gives_the_same_bytes(cluster: Any, tmp_path: Path) -> None:
    address = cluster.scheduler_address
    assert address.startswith("tcp://127.0.0.1")
    found = many(partial(draws, 0), range(12), key=KEY, scheduler=address, folder=tmp_path)
    assert same(found, WANTED)
    assert len(list(tmp_path.glob("*.npz"))) == 12
    # Pieces of many bytes travel with their tasks.
    pieces = [np.full(20_000, float(i)) for i in range(6)]
    sums = many(large, pieces, key=KEY, scheduler=address)
    assert [float(each["sum"]) for each in sums] == [20_000.0 * i for i in range(6)]


def test_more_pieces_than_wait_at_the_scheduler(cluster: Any) -> None:
    found = many(partial(draws, 0), range(150), key=KEY, scheduler=cluster.scheduler_address)
    assert [int(each["count"]) for each in found] == list(range(150))


def test_an_error_over_there_is_raised_here(cluster: Any) -> None:
    with pytest.raises(ModelError, match="piece 2 cannot be done") as caught:
        many(failing, range(4), key=KEY, scheduler=cluster.scheduler_address)
    assert caught.value.fix == "leave it out"


def test_joblib_on_a_cluster_gives_the_same_bytes(cluster: Any) -> None:
    import joblib
    from distributed import Client

    with (
        Client(cluster.scheduler_address, set_as_default=False) as client,
        joblib.parallel_config(backend="dask", client=client),
    ):
        assert same(many(partial(draws, 0), range(12), key=KEY, n_jobs=None), WANTED)


@pytest.mark.slow
def test_a_worker_killed_in_the_middle_loses_nothing(tmp_path: Path) -> None:
    from threading import Thread

    killed = []

    def kill() -> None:
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline:
            if (tmp_path / "pid").exists():
                killed.append(int((tmp_path / "pid").read_text()))
                os.kill(killed[0], signal.SIGKILL)
                return
            time.sleep(0.05)

    killer = Thread(target=kill)
    killer.start()
    work = partial(draws_with_a_halt, str(tmp_path))
    with workers(2) as local:
        address = local.scheduler_address
        found = many(work, range(12), key=KEY, scheduler=address, folder=tmp_path / "run")
    killer.join()
    assert len(killed) == 1
    assert killed[0] != os.getpid()
    assert same(found, WANTED)


def test_an_address_without_scheduler_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many_module, "ANSWER_WITHIN", 0.5)
    for address in ("tcp://127.0.0.1:1", "nonsense://x:1", "tls://127.0.0.1:1"):
        with pytest.raises(ModelError, match="no scheduler answers") as caught:
            many(partial(draws, 0), range(2), key=KEY, scheduler=address)
        assert caught.value.where == address
        # What the error still holds is closed: nothing is left to fail at the end of the process.
        assert not [each for each in clients() if each.status != "closed"]


def clients() -> list[Any]:
    import distributed

    return [each for each in gc.get_objects() if isinstance(each, distributed.Client)]


@pytest.mark.parametrize("address", ["nonsense", "", "127.0.0.1:8786", "tcp://x", "tcp://x:y"])
def test_what_is_no_address_is_refused_at_once(address: str) -> None:
    with pytest.raises(ModelError, match="not the address of a scheduler") as caught:
        many(partial(draws, 0), range(2), key=KEY, scheduler=address)
    assert "tcp://HOST:PORT" in caught.value.fix
    assert not [each for each in clients() if each.status != "closed"]


def test_a_scheduler_without_workers_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with workers(0) as empty:
        monkeypatch.setattr(many_module, "ANSWER_WITHIN", 1.0)
        with pytest.raises(ModelError, match="has no worker"):
            many(partial(draws, 0), range(2), key=KEY, scheduler=empty.scheduler_address)


@pytest.mark.parametrize("processes", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_cluster_for_the_call_alone(processes: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    import distributed

    levels: list[Any] = []

    class Watched(distributed.LocalCluster):
        def __init__(self, **how: Any) -> None:
            levels.append(how["silence_logs"])
            super().__init__(**how, processes=processes)

    monkeypatch.setattr(distributed, "LocalCluster", Watched)
    assert same(many(partial(draws, 0), range(3), key=KEY, scheduler="local", n_jobs=1), WANTED[:3])
    assert levels == [logging.ERROR]  # warnings of its workers are no news


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ModelError, match="not installed") as caught:
        many(partial(draws, 0), range(2), key=KEY, scheduler="tcp://127.0.0.1:8786")
    assert "cluster" in caught.value.fix
