"""The comparison with other solvers: wrong answers are told as such, and never timed."""

from pathlib import Path

import compare
import numpy as np
import pytest
from contenders import OURS
from results import write
from workloads import Workload, clusters, dense, garnet, grid, inventory, queue

PEER = "quantecon MPI, k=20"
FAMILY = "queue γ=0.9999"


@pytest.mark.parametrize(
    "workload",
    [garnet(30, 0.95), dense(20), clusters(40, size=20), queue(20), grid(5), inventory(30)],
    ids=lambda work: work.name,
)
def test_workloads_are_models(workload: Workload, tmp_path: Path) -> None:
    assert np.abs(np.asarray(workload.transition.sum(axis=1)) - 1).max() < 1e-12
    assert (np.diff(workload.first) > 0).all()
    workload.save(tmp_path / "work.npz")
    again = Workload.load(tmp_path / "work.npz")
    for name in ("name", "states", "discount"):
        assert getattr(again, name) == getattr(workload, name)
    assert (again.transition != workload.transition).nnz == 0
    value, proven = compare.reference(workload)
    assert np.abs(compare.backup(workload, value) - value).max() <= proven < 1e-6


@pytest.mark.parametrize(
    ("off", "bound", "verdict"),
    [(0.0, None, "right"), (1e-3, None, "wrong"), (0.0, 1e-8, "right"), (5e-7, 1e-8, "wrong")],
)
def test_an_answer_is_held_against_the_reference_and_its_own_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, off: float, bound: float | None, verdict: str
) -> None:
    workload = queue(20)
    value, _ = compare.reference(workload)

    def answer(path: Path, family: str, name: str, values: Path) -> dict[str, object] | None:
        if name not in (OURS, PEER):
            return None
        np.save(values, value + (off if name == PEER else 0.0))
        times = {"first": 0.5, "seconds": 0.2 if name == PEER else 0.1, "solving": 0.1}
        times |= {"memory": 1e6, "first memory": 2e6}
        return times | {"note": "", "bound": bound if name == PEER else 1e-9}

    monkeypatch.setattr(compare, "_in_a_process", answer)
    rows = {row["contender"]: row for row in compare.measure(FAMILY, workload, 2, tmp_path)}
    right = verdict == "right"
    assert (rows[OURS]["verdict"], rows[PEER]["verdict"]) == ("right", verdict)
    assert ("seconds" in rows[PEER]) == right
    assert rows["mdpsolver MPI"]["verdict"].startswith("no answer")
    write(list(rows.values()), 1e10, tmp_path)
    page = (tmp_path / "RESULTS.md").read_text()
    (line,) = [line for line in page.splitlines() if f"| 290 | {PEER} |" in line]
    assert ("2 (2 to 2)" in line) == right
    assert ("| wrong |" in line) == (not right)
    assert (f"| {FAMILY} | 20 | 0.5 | {PEER} |" in page) == right
    assert "results_ratio.png" in page
    assert (tmp_path / "results_ratio.png").exists() == right
