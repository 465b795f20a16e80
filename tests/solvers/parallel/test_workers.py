"""Work done elsewhere is done by the same code, or refused by the name of who has another."""

from __future__ import annotations

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
import pytest
from cli_runner import run
from pieces_of_work import KEY, WANTED, draws, same

from exact_mdp.mdp import ModelError
from exact_mdp.solvers import sources
from exact_mdp.solvers.parallel import cluster as cluster_module
from exact_mdp.solvers.parallel import many as many_module
from exact_mdp.solvers.parallel.many import many

pytestmark = pytest.mark.xdist_group("cluster")

TESTS = Path(cli_runner.__file__).parent
ROOT = sources.ROOT

Hire = Callable[..., str]


@pytest.fixture
def scheduler() -> Iterator[Any]:
    """A scheduler on this machine's own address, without workers."""
    import distributed

    with distributed.LocalCluster(
        n_workers=0, host="127.0.0.1", dashboard_address="127.0.0.1:0"
    ) as local:
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
    begun = time.monotonic()
    with timeout(1.5):
        error = refused(scheduler.scheduler_address)
    assert f"{bad}: no answer within 1.5 seconds" in error.what
    assert time.monotonic() - begun < 20


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


def stuck(folder: str, index: int) -> dict[str, Any]:
    """Whichever piece is first is done at once; the others wait for a file."""
    try:
        (Path(folder) / "first").touch(exist_ok=False)
    except FileExistsError:
        deadline = time.monotonic() + 60
        while not (Path(folder) / "end").exists() and time.monotonic() < deadline:
            time.sleep(0.02)
    return draws(0, index)


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
        many(partial(stuck, str(tmp_path)), range(4), key=KEY, scheduler=address, folder=folder)
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
            partial(stuck, str(tmp_path)),
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
