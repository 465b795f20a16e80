"""SIGTERM ends the work as Ctrl-C does: workers end, finished work is kept and used again."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from cli_runner import PROGRAM

ROOT = Path(__file__).resolve().parents[3]

WORK = """
import sys
import click
import worker
from exact_mdp.analysis.exit_status import end_process, run_command
from exact_mdp.solvers.parallel import run_pieces

@click.command()
@click.argument("folder")
def main(folder):
    run_pieces(worker.piece, range(6), key={}, n_jobs=2, folder=folder)

end_process(run_command(main, "job", sys.argv[1:]))
"""

PIECE = """
import time
import numpy as np

def piece(number):
    time.sleep(0.01 if number < 3 else 600)
    return {"x": np.full(3, number)}
"""


def session(leader: int) -> list[int]:
    """Return the processes of a session that are alive."""
    members = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                fields = (folder / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[3]) == leader and fields[0] != "Z":
                members.append(int(folder.name))
    return members


def gone(leader: int) -> bool:
    """Wait for a session to end; what is left of it is ended."""
    for _ in range(1200):
        if not session(leader):
            return True
        time.sleep(0.1)
    for pid in session(leader):
        os.kill(pid, signal.SIGKILL)
    return False


def listening() -> None:
    """Take signals as in a terminal, also where the tests were started without one."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def started(words: list[object], folder: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [str(word) for word in words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        start_new_session=True,
        preexec_fn=listening,
        env=os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{folder}"},
    )
    for _ in range(1200):
        if len(list(folder.glob("out/*.npz"))) >= 3:
            return process
        if process.poll() is not None:
            break
        time.sleep(0.1)
    raise AssertionError(process.communicate())


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT", "SIGHUP"])
def test_workers_end_with_the_program(tmp_path: Path, name: str) -> None:
    """Processes of a stopped program lived on for six minutes."""
    (tmp_path / "worker.py").write_text(PIECE, "utf-8")
    (tmp_path / "job.py").write_text(WORK, "utf-8")
    process = started([sys.executable, tmp_path / "job.py", tmp_path / "out"], tmp_path)
    assert len(session(process.pid)) > 1
    number = getattr(signal, name)
    process.send_signal(number)
    out, err = process.communicate()
    assert gone(process.pid)
    assert (process.returncode, out) == (128 + number, "")
    assert err == (
        f"stopped by {name}; the finished part (runs: 3 of 6) is kept in {tmp_path / 'out'}, "
        "and the same command goes on from there\n"
    )
    assert not list((tmp_path / "out").glob(".*"))


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc")
def test_a_training_that_was_stopped_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    words = [PROGRAM, "train", "tea", "--learner", "epochs=100", "--n-jobs", "2", "--json", "--out"]
    process = started([*words, tmp_path / "out", "--seeds", "100000"], tmp_path)
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGTERM)  # as `timeout` does: to the process, then to its group
    out, err = process.communicate()
    assert gone(process.pid)
    assert (process.returncode, out) == (143, ""), err
    assert err.startswith("stopped by SIGTERM; the finished part (runs: ")
    assert "Traceback" not in err
    saved = sorted(path.name for path in (tmp_path / "out").glob("runs-*.npz"))
    count = str(len(saved) + 2)
    for folder in ("out", "fresh"):
        subprocess.run(
            [*words, tmp_path / folder, "--seeds", count], check=True, stdout=subprocess.DEVNULL
        )
    for path in (tmp_path / "fresh").glob("runs-*.npz"):
        assert path.read_bytes() == (tmp_path / "out" / path.name).read_bytes()
