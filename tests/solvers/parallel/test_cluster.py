"""A Dask cluster: the same bytes as here, whoever dies meanwhile, and a word where it cannot be."""

from __future__ import annotations

import gc
import json
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import cli_runner
import numpy as np
import pytest
from cli_runner import run
from click.testing import CliRunner
from pieces_of_work import KEY, WANTED, draws, failing, same

from exact_mdp.analysis.readings import ReadingSpace
from exact_mdp.analysis.sensitivity.psa.distributions import uncertainty
from exact_mdp.analysis.sensitivity.psa.psa import psa
from exact_mdp.mdp import MDP, ModelError, Scenario
from exact_mdp.mdp.parametric import moving
from exact_mdp.paper_repro.__main__ import main as reproduce
from exact_mdp.paper_repro.readings import search as reading_search
from exact_mdp.solvers.learning.q_learning import QLearning
from exact_mdp.solvers.learning.training import train_many
from exact_mdp.solvers.parallel import cluster as cluster_module
from exact_mdp.solvers.parallel import many as many_module
from exact_mdp.solvers.parallel.many import many

pytestmark = pytest.mark.xdist_group("cluster")  # one cluster serves them all


@contextmanager
def workers(number: int, **how: Any) -> Iterator[Any]:
    """Workers on this machine's own address, processes unless said otherwise."""
    import distributed

    with distributed.LocalCluster(
        n_workers=number,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
        **how,
    ) as local:
        yield local


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    import dask
    import distributed

    # Dask's own settings are there before one of them is changed, or all would go with the change.
    assert distributed.config
    # Whoever has yet to hear of a worker's death tries for this long to reach it: 30 s by default.
    with dask.config.set({"distributed.comm.timeouts.connect": "2s"}), workers(2) as local:
        yield local


@pytest.fixture
def address(cluster: Any) -> str:
    return str(cluster.scheduler_address)


# ---- the same bytes ------------------------------------------------------------------------------


def large(piece: np.ndarray[Any, Any]) -> dict[str, Any]:
    return {"sum": piece.sum()}


class Counted:
    """Work that counts how often it is packed to be sent from this process."""

    packed = 0

    def __call__(self, index: int) -> dict[str, Any]:
        return draws(0, index) | {"pid": np.int64(os.getpid())}

    def __reduce__(self) -> tuple[Any, ...]:
        type(self).packed += 1
        return (Counted, ())


def test_a_cluster_gives_the_same_bytes(address: str, tmp_path: Path) -> None:
    assert address.startswith("tcp://127.0.0.1")
    found = many(partial(draws, 0), range(12), key=KEY, scheduler=address, folder=tmp_path)
    assert same(found, WANTED)
    assert len(list(tmp_path.glob("*.npz"))) == 12
    # Pieces of many bytes travel with their tasks.
    pieces = [np.full(20_000, float(i)) for i in range(6)]
    sums = many(large, pieces, key=KEY, scheduler=address)
    assert [float(each["sum"]) for each in sums] == [20_000.0 * i for i in range(6)]


def test_what_pieces_share_is_sent_once(address: str) -> None:
    found = many(Counted(), range(40), key=KEY, scheduler=address)
    assert os.getpid() not in {int(each.pop("pid")) for each in found}
    assert same(found[:12], WANTED)
    assert 0 < Counted.packed < 5  # with every piece it would be 40


def test_more_pieces_than_wait_at_the_scheduler(address: str) -> None:
    found = many(partial(draws, 0), range(150), key=KEY, scheduler=address)
    assert [int(each["count"]) for each in found] == list(range(150))


def test_an_error_over_there_is_raised_here(address: str) -> None:
    with pytest.raises(ModelError, match="piece 2 cannot be done") as caught:
        many(failing, range(4), key=KEY, scheduler=address)
    assert caught.value.fix == "leave it out"


def test_joblib_on_a_cluster_gives_the_same_bytes(address: str) -> None:
    import joblib
    from distributed import Client

    with (
        Client(address, set_as_default=False) as client,
        joblib.parallel_config(backend="dask", client=client),
    ):
        assert same(many(partial(draws, 0), range(12), key=KEY, n_jobs=None), WANTED)


# ---- workers that die ----------------------------------------------------------------------------

Kill = Callable[[Any], None]


@pytest.fixture(params=[3, 0], ids=["scheduler tries again", "scheduler gives up"])
def killer(
    request: pytest.FixtureRequest, cluster: Any, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Kill]:
    """Arrange for a busy worker to be killed once two pieces are written by a module."""
    import distributed

    monkeypatch.setattr(cluster.scheduler, "allowed_failures", request.param)
    killed: list[int] = []

    async def busiest() -> str:
        states = cluster.scheduler.workers.values()
        state = max(states, key=lambda each: len(each.processing) + len(each.has_what))
        # It is at work, or has results that are lost with it; it has the shared work in any case.
        assert len(state.processing) + len(state.has_what) > 1
        return str(state.address)

    def arrange(module: Any, name: str = "write_piece") -> None:
        write, written = getattr(module, name), []

        def writing(path: Path, arrays: Any) -> None:
            write(path, arrays)
            written.append(path)
            if len(written) == 2:
                victim = cluster.sync(busiest)
                with distributed.Client(cluster, set_as_default=False) as client:
                    (pid,) = client.run(os.getpid, workers=[victim]).values()
                killed.append(pid)
                os.kill(pid, signal.SIGKILL)

        monkeypatch.setattr(module, name, writing)

    yield arrange
    assert len(killed) == 1
    assert killed[0] != os.getpid()


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_a_worker_killed_in_the_middle_loses_nothing(
    address: str, killer: Kill, tmp_path: Path
) -> None:
    killer(many_module)
    work = partial(draws, 0)
    found = many(work, range(60), key=KEY, scheduler=address, folder=tmp_path / "there")
    assert same(found[:12], WANTED)
    assert same(found, many(work, range(60), key=KEY, folder=tmp_path / "here"))
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


GIVES_UP = pytest.mark.parametrize("killer", [0], ids=["scheduler gives up"], indirect=True)


@GIVES_UP
def test_a_training_loses_nothing_with_a_worker(address: str, killer: Kill, tmp_path: Path) -> None:
    mdp = Scenario.load("yuan2025").compile()
    learner = QLearning(epochs=30)
    wanted = train_many(mdp, learner, 24, rng=0, out=tmp_path / "here")
    killer(many_module)
    found = train_many(mdp, learner, 24, rng=0, scheduler=address, out=tmp_path / "there")
    assert contents(tmp_path / "there") == contents(tmp_path / "here")
    for a, b in zip(found, wanted, strict=True):
        assert a.q.tobytes() == b.q.tobytes()
        assert np.array_equal(a.policies, b.policies)
        assert (a.steps, a.cut_short, a.space) == (b.steps, b.cut_short, b.space)


@GIVES_UP
def test_a_psa_loses_nothing_with_a_worker(address: str, killer: Kill, tmp_path: Path) -> None:
    rows = [(0, 0, [("3/10", 1, 1), ("7/10", 2, 0)]), (0, 1, [("2/5", 1, 1), ("3/5", 2, 0)])]
    wager = MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])], 1)
    model = moving(wager, {"p": [(0, 1)], "q": [(1, 1)]})
    how = {"uncertain": uncertainty(model, {}, default=8), "rng": 2}
    wanted = psa(model, 192, folder=tmp_path / "here", **how)
    killer(many_module)
    found = psa(model, 192, folder=tmp_path / "there", scheduler=address, **how)
    assert contents(tmp_path / "there") == contents(tmp_path / "here")
    assert found.draws.tobytes() == wanted.draws.tobytes()
    assert found.optimal.tobytes() == wanted.optimal.tobytes()
    assert found.evpi() == wanted.evpi()


def deadly(index: int) -> dict[str, Any]:
    if index == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return draws(0, index)


@pytest.mark.parametrize(("scheduler", "attempts"), [(None, 0), ("cluster", 1)])
def test_a_piece_that_kills_whoever_does_it_is_named(
    scheduler: str | None,
    attempts: int,
    cluster: Any,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setattr(cluster.scheduler, "allowed_failures", 0)
    for module in (cluster_module, many_module):
        monkeypatch.setattr(module, "ATTEMPTS", attempts)
    where = cluster.scheduler_address if scheduler else None
    with pytest.raises(ModelError, match="worker processes died") as caught:
        many(deadly, range(2), key=KEY, n_jobs=2, scheduler=where, folder=tmp_path)
    assert "memory" in caught.value.fix


# ---- the command ---------------------------------------------------------------------------------


def test_the_command_trains_on_a_cluster(address: str, tmp_path: Path) -> None:
    words = ("train", "yuan2025", "--epochs", 5, "--seeds", 8, "--seed", 7, "--json")
    alone = run(*words, "--jobs", 1, "--out", tmp_path / "here")
    # What was begun here goes on over there.
    assert run(*words, "--seeds", 3, "--out", tmp_path / "there").status == 0
    there = run(*words, "--scheduler", address, "--out", tmp_path / "there")
    assert there.result | {"written": []} == alone.result | {"written": []}
    runs = [
        {name: data for name, data in contents(tmp_path / each).items() if name.startswith("runs")}
        for each in ("here", "there")
    ]
    assert len(runs[0]) == 8
    assert runs[0] == runs[1]


def test_the_command_names_what_is_no_scheduler() -> None:
    done = run("train", "yuan2025", "--seeds", 2, "--epochs", 5, "--scheduler", "nonsense")
    assert (done.status, done.out) == (2, "")
    assert "tcp://HOST:PORT" in done.err


def test_the_readings_of_the_text_are_searched_on_a_cluster(
    address: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(reading_search, "BLOCK", 1)
    space = ReadingSpace(options={"tasks": ((3,), (2,), (1,)), "evaluation_discount": (1,)})
    here = reading_search.search(space=space, n_jobs=1, out=tmp_path / "here")
    there = reading_search.search(space=space, scheduler=address, out=tmp_path / "there")
    assert contents(tmp_path / "there") == contents(tmp_path / "here")
    assert len(contents(tmp_path / "there")) == 4
    assert there.mean.tobytes() == here.mean.tobytes()


def test_the_reproduction_names_what_is_no_scheduler(tmp_path: Path) -> None:
    words = ["--claim", "return.random", "--scheduler", "nonsense", "--out", str(tmp_path)]
    done = CliRunner().invoke(reproduce, words)
    assert done.exit_code == 2
    assert "tcp://HOST:PORT" in done.output


# ---- no cluster ----------------------------------------------------------------------------------


def waiting(folder: str, index: int) -> dict[str, Any]:
    """All pieces but the one that is done first wait until there is a file."""
    try:
        (Path(folder) / "first").touch(exist_ok=False)
    except FileExistsError:
        deadline = time.monotonic() + 60
        while not (Path(folder) / "end").exists() and time.monotonic() < deadline:
            time.sleep(0.02)
    return draws(0, index)


@contextmanager
def programs(folder: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Give the address and the process of `dask scheduler`, with one `dask worker`."""
    import distributed

    file = folder / "scheduler.json"
    found = os.pathsep.join([str(Path(cli_runner.__file__).parent), *sys.path])
    started = []
    for name, words in (("scheduler", ["--port", "0"]), ("worker", ["--no-nanny"])):
        program = [sys.executable, "-m", f"distributed.cli.dask_{name}", "--host", "127.0.0.1"]
        started.append(
            subprocess.Popen(
                [*program, "--scheduler-file", file, "--no-dashboard", *words],
                env=os.environ | {"PYTHONPATH": found},
                stderr=subprocess.DEVNULL,
            )
        )
    try:
        deadline = time.monotonic() + 60
        while not file.exists() and time.monotonic() < deadline:
            time.sleep(0.02)
        address = json.loads(file.read_text())["address"]
        with distributed.Client(address, set_as_default=False, timeout=60) as client:
            client.wait_for_workers(1, timeout=60)
        yield address, started[0]
    finally:
        for each in started:
            each.kill()
            each.wait()


def test_a_scheduler_that_dies_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    write, folder = many_module.write_piece, tmp_path / "run"
    with programs(tmp_path) as (address, scheduler):

        def writing(path: Path, arrays: Any) -> None:
            write(path, arrays)
            scheduler.kill()
            monkeypatch.setattr(cluster_module, "LOOK_AFTER", 0.1)

        # A worker's first answer takes long: it imports the packages.
        many(partial(draws, 0), range(1), key=KEY, scheduler=address)
        monkeypatch.setattr(many_module, "write_piece", writing)
        monkeypatch.setattr(cluster_module, "ANSWER_WITHIN", 4.0)
        work = partial(waiting, str(tmp_path))
        with pytest.raises(ModelError, match="the scheduler has gone") as caught:
            many(work, range(12), key=KEY, scheduler=address, folder=folder)
    assert caught.value.where == address
    assert len(list(folder.glob("*.npz"))) == 1
    monkeypatch.undo()
    assert same(many(partial(draws, 0), range(12), key=KEY, folder=folder), WANTED)


def test_an_address_without_scheduler_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "ANSWER_WITHIN", 0.5)
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
        monkeypatch.setattr(cluster_module, "ANSWER_WITHIN", 1.0)
        with pytest.raises(ModelError, match="has no worker"):
            many(partial(draws, 0), range(2), key=KEY, scheduler=empty.scheduler_address)


@pytest.mark.parametrize("processes", [False, True])
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
