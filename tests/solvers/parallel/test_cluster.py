"""A Dask cluster: the same bytes as here, by the same code, whoever dies; and what is refused."""

from __future__ import annotations

import gc
import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import cli_runner
import dask
import numpy as np
import pytest
from cli_runner import run
from pieces_of_work import KEY, WANTED, contents, draws, failing, same

from exact_mdp.analysis.readings import ReadingSpace
from exact_mdp.analysis.sensitivity.psa.distributions import uncertainty
from exact_mdp.analysis.sensitivity.psa.psa import psa
from exact_mdp.mdp import MDP, ModelError
from exact_mdp.mdp.parametric import moving
from exact_mdp.paper_repro.readings import search as reading_search
from exact_mdp.solvers import sources
from exact_mdp.solvers.parallel import cluster as cluster_module
from exact_mdp.solvers.parallel import many as many_module
from exact_mdp.solvers.parallel.many import many

pytestmark = pytest.mark.xdist_group("cluster")  # one cluster serves them all

TESTS = Path(cli_runner.__file__).parent


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


@pytest.mark.slow
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
    found = os.pathsep.join([str(TESTS), *sys.path])
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
        while not (file.exists() and file.stat().st_size) and time.monotonic() < deadline:
            time.sleep(0.02)  # a scheduler makes the file before it writes the address
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


# ---- workers with other code ---------------------------------------------------------------------

ROOT = sources.ROOT

Hire = Callable[..., str]


@pytest.fixture
def scheduler() -> Iterator[Any]:
    """A scheduler on this machine's own address, without workers."""
    with workers(0) as local:
        yield local


@pytest.fixture
def pids() -> dict[str, int]:
    """The processes of the workers, by name."""
    return {}


@pytest.fixture
def hire(scheduler: Any, pids: dict[str, int], tmp_path: Path) -> Iterator[Hire]:
    """Start a worker with the packages of a folder, which may load a script first."""
    with ExitStack() as stack:

        def start(name: str, packages: Path = ROOT, script: str = "") -> str:
            words = [sys.executable, "-m", "distributed.cli.dask_worker", scheduler_address]
            words += ["--host", "127.0.0.1", "--no-dashboard", "--no-nanny", "--nthreads", "1"]
            if script:
                (tmp_path / f"{name}.py").write_text(script)
                words += ["--preload", str(tmp_path / f"{name}.py")]
            known = set(addresses())
            worker = stack.enter_context(
                subprocess.Popen(
                    [*words, "--name", name],
                    env=os.environ | {"PYTHONPATH": os.pathsep.join([str(packages), str(TESTS)])},
                    cwd=tmp_path,
                    stderr=subprocess.DEVNULL,
                )
            )
            stack.callback(worker.kill)
            pids[name] = worker.pid
            deadline = time.monotonic() + 120
            while not (came := set(addresses()) - known):
                assert worker.poll() is None, f"worker {name} has ended"
                assert time.monotonic() < deadline, f"worker {name} does not come"
                time.sleep(0.05)
            return str(came.pop())

        def addresses() -> list[str]:
            return list(scheduler.scheduler.workers)

        scheduler_address = str(scheduler.scheduler_address)
        yield start


@contextmanager
def timeout(seconds: float) -> Iterator[None]:
    with dask.config.set({"exact-mdp.timeout": seconds}):
        yield


def changed(folder: Path) -> Path:
    """Return a copy of the packages, one of which has a line more."""
    for package in sources.PACKAGES:
        shutil.copytree(ROOT / package, folder / package)
    shutil.copytree(ROOT / "exact_mdp", folder / "exact_mdp", symlinks=True)
    with (folder / "mdp" / "model.py").open("a") as file:
        file.write("\n# another line\n")
    return folder


def refused(address: str, **how: Any) -> ModelError:
    with pytest.raises(ModelError) as caught:
        many(partial(draws, 0), range(4), key=KEY, scheduler=address, **how)
    return caught.value


NUMPY = """
import importlib.metadata as metadata
def version(name, true=metadata.version):
    return "1.99.0" if name == "numpy" else true(name)
metadata.version = version
"""
SILENT = """
import time
import solvers.parallel.sources
solvers.parallel.sources.here = lambda: time.sleep(30)
"""


def test_a_worker_with_other_sources_is_refused(scheduler: Any, hire: Hire, tmp_path: Path) -> None:
    """A worker whose code differs changes no result: it is refused, and named; no other is."""
    good = hire("good")
    assert same(
        many(partial(draws, 0), range(12), key=KEY, scheduler=scheduler.scheduler_address), WANTED
    )
    bad = hire("bad", changed(tmp_path / "copy"))
    folder = tmp_path / "kept"
    error = refused(scheduler.scheduler_address, folder=folder)
    mine = sources.source_digest()[: sources.SHORT]
    assert f"{bad}: sources " in error.what
    assert f"{mine} here" in error.what
    assert good not in error.what
    assert "1 of 2 workers" in error.where
    assert not list(folder.glob("*.npz"))
    # The command says the same, with the status of what it cannot use.
    words = ("train", "yuan2025", "--epochs", 1, "--seeds", 2)
    done = run(*words, "--scheduler", scheduler.scheduler_address)
    assert (done.status, done.out) == (2, "")
    assert f"{bad}: sources " in done.err


def test_a_worker_with_another_version_is_refused(scheduler: Any, hire: Hire) -> None:
    """A worker with another NumPy is refused, and the message names it and both versions."""
    from importlib.metadata import version

    bad = hire("bad", script=NUMPY)
    error = refused(scheduler.scheduler_address)
    assert f"{bad}: numpy 1.99.0 there, {version('numpy')} here" in error.what
    assert "sources" not in error.what


def test_a_worker_without_the_packages_is_refused(
    scheduler: Any, hire: Hire, tmp_path: Path
) -> None:
    """A worker on which the packages cannot be imported is refused with the reason."""
    (tmp_path / "empty" / "exact_mdp").mkdir(parents=True)
    (tmp_path / "empty" / "exact_mdp" / "__init__.py").write_text("")
    bad = hire("bad", tmp_path / "empty")
    error = refused(scheduler.scheduler_address)
    assert f"{bad}: ModuleNotFoundError: No module named 'exact_mdp.solvers'" in error.what


def test_a_worker_that_does_not_answer_is_refused(scheduler: Any, hire: Hire) -> None:
    """A worker that never answers, as one with another Dask may not, ends the call by name."""
    bad = hire("bad", script=SILENT)
    with timeout(1.5):
        error = refused(scheduler.scheduler_address)
    assert f"{bad}: no answer within 1.5 seconds" in error.what


def test_no_workers_at_all(scheduler: Any) -> None:
    """Without workers the call ends after the time that Dask's setting gives."""
    with timeout(0.5):
        assert "has no worker" in refused(scheduler.scheduler_address).what


@pytest.mark.parametrize("value", [0, -1, float("nan"), float("inf"), "soon", True, [1]])
def test_a_timeout_that_is_none_is_refused(value: Any) -> None:
    """What is no time to wait for is refused before anything is sent."""
    with dask.config.set({"exact-mdp.timeout": value}):
        error = refused("tcp://127.0.0.1:1")
    assert "the timeout is" in error.what
    assert "exact-mdp.timeout" in error.where


def test_workers_that_never_come_back(
    scheduler: Any,
    hire: Hire,
    pids: dict[str, int],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """Where all workers die and none comes, the call ends; what is finished is kept."""
    hire("only")
    write = many_module.write_piece

    def writing(path: Path, arrays: Any) -> None:
        write(path, arrays)
        os.kill(pids["only"], signal.SIGKILL)

    monkeypatch.setattr(many_module, "write_piece", writing)
    monkeypatch.setattr(cluster_module, "LOOK_AFTER", 0.2)
    address, folder = scheduler.scheduler_address, tmp_path / "kept"
    many(partial(draws, 0), range(1), key=KEY, scheduler=address)  # the worker imports by now
    with timeout(3), pytest.raises(ModelError, match="there has been no worker") as caught:
        many(partial(waiting, str(tmp_path)), range(4), key=KEY, scheduler=address, folder=folder)
    assert "DASK_EXACT_MDP__TIMEOUT" in caught.value.fix
    assert len(list(folder.glob("*.npz"))) == 1


def test_a_worker_that_comes_later_is_asked_too(
    scheduler: Any, hire: Hire, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A worker that joins while the pieces are done is refused as the first ones are."""
    good = hire("good")
    write = many_module.write_piece

    def writing(path: Path, arrays: Any) -> None:
        write(path, arrays)
        hire("bad", script=NUMPY)

    monkeypatch.setattr(many_module, "write_piece", writing)
    monkeypatch.setattr(cluster_module, "LOOK_AFTER", 0.2)
    address = scheduler.scheduler_address
    with pytest.raises(ModelError, match=r"numpy 1\.99\.0 there") as caught:
        many(
            partial(waiting, str(tmp_path)),
            range(4),
            key=KEY,
            scheduler=address,
            folder=tmp_path / "kept",
        )
    (tmp_path / "end").touch()
    assert good not in str(caught.value)


def test_each_piece_says_what_it_must_be_done_with() -> None:
    """A piece that reaches a process with other code is refused there, before it is done."""
    wanted = sources.here() | {"sources": "0" * sources.SHORT, "scipy": "1.0"}
    with pytest.raises(ModelError, match=r"scipy .* there, 1\.0 here; sources") as caught:
        many_module._guarded(wanted, partial(draws, 0), 0, 0)
    assert f"process {os.getpid()}" in caught.value.where


EDITED = """
import sys
from functools import partial
from pathlib import Path
from pieces_of_work import KEY, draws
from solvers.parallel.many import many
from mdp import ModelError, model

if __name__ == "__main__":
    many(partial(draws, 0), range(2), key=KEY, n_jobs=1)
    with open(model.__file__, "a") as file:
        file.write("# one more line")
    try:
        many(partial(draws, 0), range(4), key=KEY, n_jobs=2)
    except ModelError as error:
        print(error)
"""


def test_a_file_that_changes_while_a_process_runs(tmp_path: Path) -> None:
    """New processes would import new code beside the old: that is refused, and the file named."""
    script = tmp_path / "edited.py"
    script.write_text(EDITED)
    found = os.pathsep.join([str(changed(tmp_path / "copy")), str(TESTS)])
    done = subprocess.run(
        [sys.executable, str(script)],
        env=os.environ | {"PYTHONPATH": found},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.stdout.startswith("the source changed since this process began"), done.stderr
    assert str(Path("mdp") / "model.py") in done.stdout
    assert "start it again" in done.stdout


def test_the_digest_covers_every_module() -> None:
    """A change of one byte of any module or scenario is a change of the digest's files."""
    listed = {path.relative_to(ROOT) for path in map(Path, sources._stamps())}
    wanted = {
        path.relative_to(ROOT)
        for package in sources.PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.suffix in {".py", ".toml"}
    }
    assert listed == wanted
    assert Path("solvers/parallel/many.py") in listed
