"""Many independent pieces: the same in one process, on cores, and after a halt."""

import os
import signal
import time
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest
from numpy.random import SeedSequence, default_rng

from exact_mdp import ModelError
from exact_mdp.solvers.parallel import run_pieces

KEY = {"model": "normal draws", "seed": 0}


def draws(index: int) -> dict[str, Any]:
    """One piece: random numbers of its own child of the seed, and the process that drew them."""
    rng = default_rng(SeedSequence(0, spawn_key=(index,)))
    return {"x": rng.normal(size=50), "process": np.int64(os.getpid())}


WANTED = [draws(index)["x"].tobytes() for index in range(12)]


def same(given: list[dict[str, Any]]) -> bool:
    return [piece["x"].tobytes() for piece in given] == WANTED


def draws_that_die(folder: str, index: int) -> dict[str, Any]:
    """The same; the first to do piece 3 ends its own process, after some are written."""
    mark = Path(folder) / "died"
    if index == 3 and not mark.exists():
        while not [*Path(folder).glob("*.npz")]:
            time.sleep(0.02)
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return draws(index)


def failing_last(folder: str, index: int) -> dict[str, Any]:
    """Piece 2 fails, and waits until the files of the others are written."""
    others = [Path(folder) / f"00000{other}.npz" for other in (0, 1)]
    while index == 2 and not all(other.exists() for other in others):
        time.sleep(0.02)
    if index == 2:
        raise ModelError("piece 2 cannot be done", where="here", fix="leave it out")
    return {"x": np.zeros(1)}


@pytest.mark.parametrize("n_jobs", [1, 2])
def test_what_is_finished_before_an_error_is_kept(tmp_path: Path, n_jobs: int) -> None:
    work = partial(failing_last, str(tmp_path))
    with pytest.raises(ModelError, match="piece 2 cannot be done"):
        run_pieces(work, range(3), key=KEY, folder=tmp_path, n_jobs=n_jobs)
    files = {path.name for path in tmp_path.glob("*.npz")}
    assert files == {"000000.npz", "000001.npz"}


def test_a_process_that_dies_loses_no_finished_piece(tmp_path: Path) -> None:
    work = partial(draws_that_die, str(tmp_path))
    with pytest.raises(ModelError, match="a worker process died"):
        run_pieces(work, range(12), key=KEY, n_jobs=2, folder=tmp_path)
    kept = {path: path.read_bytes() for path in tmp_path.glob("*.npz")}
    assert kept
    assert same(run_pieces(work, range(12), key=KEY, n_jobs=2, folder=tmp_path))
    assert {path: path.read_bytes() for path in kept} == kept


@pytest.mark.parametrize(("pieces", "started"), [(40, 4), (3, 3), (1, None)])
@pytest.mark.parametrize("wanted", [120, None])
def test_no_more_workers_start_than_there_are_cores_and_pieces(
    wanted: int | None, pieces: int, started: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A single piece is done here."""
    seen: list[int] = []

    class Noted(joblib.Parallel):
        def __init__(self, n_jobs: int, **settings: Any) -> None:
            seen.append(n_jobs)
            super().__init__(n_jobs=1, **settings)

    monkeypatch.setattr(joblib, "cpu_count", lambda: 4)
    monkeypatch.setattr(joblib, "Parallel", Noted)
    assert len(run_pieces(draws, range(pieces), key=KEY, n_jobs=wanted)) == pieces
    assert seen == ([] if started is None else [started])
