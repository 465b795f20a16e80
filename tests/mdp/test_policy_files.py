"""Policy files that are refused, those that are read all the same, and how files are written."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from policies import (
    MDP_1,
    STATUSES,
    check_follows,
)

from exact_mdp.mdp import ModelError, Policy, Scenario

GOOD_CSV = "status,action\n" + "".join(f"{status},none\n" for status in STATUSES)
GOOD_JSON = json.dumps(dict.fromkeys(STATUSES, "none"))

BAD_FILES: dict[str, tuple[str, str, str]] = {
    "empty csv": ("p.csv", "", "the header is missing"),
    "empty json": ("p.json", "", "broken JSON"),
    "json list": ("p.json", "[1]", "not a JSON object"),
    "json number": ("p.json", "3", "not a JSON object"),
    "json cut": ("p.json", GOOD_JSON[:-5], "broken JSON"),
    "json deep": ("p.json", '{"a":' * 100_000, "nested more than 100 deep"),
    "json twice": ("p.json", GOOD_JSON[:-1] + ', "0000": "none"}', "0000 appears twice"),
    "json status": ("p.json", GOOD_JSON.replace("0110", "0120"), "unknown status '0120'"),
    "json short status": ("p.json", GOOD_JSON.replace("0110", "110"), "unknown status '110'"),
    "json action": ("p.json", GOOD_JSON.replace("none", "nome", 1), "unknown action 'nome'"),
    "json missing": ("p.json", '{"0000": "none"}', "15 of 16 rows are missing: status 0001"),
    "json number action": ("p.json", GOOD_JSON.replace('"none"', "2", 1), "unknown action '2'"),
    "json null action": ("p.json", GOOD_JSON.replace('"none"', "null", 1), "unknown action"),
    "json list action": ("p.json", GOOD_JSON.replace('"none"', "[1]", 1), "unknown action"),
    "json chance": (
        "p.json", GOOD_JSON.replace('"none"', '{"none": 0.5}', 1), "not a distribution",
    ),
    "json negative": (
        "p.json",
        GOOD_JSON.replace('"none"', '{"none": 1.5, "directive": -0.5}', 1),
        "not a distribution",
    ),
    "json huge": ("p.json", GOOD_JSON.replace('"none"', '{"none": 1e9999}', 1), ""),
    "json nan": ("p.json", GOOD_JSON.replace('"none"', '{"none": NaN}', 1), ""),
    "json null chance": (
        "p.json", GOOD_JSON.replace('"none"', '{"none": null}', 1), "not a number",
    ),
    "json no chance": ("p.json", GOOD_JSON.replace('"none"', "{}", 1), "not a distribution"),
    "csv header": ("p.csv", GOOD_CSV.replace("status", "stats", 1), "unknown column 'stats'"),
    "csv no action": ("p.csv", GOOD_CSV.replace(",action", "", 1), "the header is status"),
    "csv action only": ("p.csv", "action\nnone\n", "the header is action"),
    "csv header twice": ("p.csv", GOOD_CSV.replace("action", "status,action", 1), "the header is"),
    "csv no header": ("p.csv", GOOD_CSV.partition("\n")[2], "unknown column '0000'"),
    "csv long line": ("p.csv", GOOD_CSV.replace("none", "none,1", 1), "3 values under 2 headings"),
    "csv twice": ("p.csv", GOOD_CSV + "0000,none\n", "status 0000 appears twice"),
    "csv other twice": ("p.csv", GOOD_CSV + "0000,directive\n", "status 0000 appears twice"),
    "csv missing": ("p.csv", GOOD_CSV.replace("1001,none\n", ""), "1 of 16 rows are missing"),
    "csv action": ("p.csv", GOOD_CSV.replace("none", "nothing", 1), "unknown action 'nothing'"),
    "csv status": ("p.csv", GOOD_CSV.replace("0101", "0201"), "unknown status '0201'"),
    "csv number status": ("p.csv", GOOD_CSV.replace("0101", "5"), "unknown status '5'"),
    "csv quote": ("p.csv", GOOD_CSV.replace("none", '"none', 1), "broken CSV"),
    "csv null": ("p.csv", GOOD_CSV.replace("none", "no\0ne", 1), ""),
    "csv trial": (
        "p.csv", "trial,status,action\n" + "".join(f"2,{s},none\n" for s in STATUSES),
        "unknown trial '2'",
    ),
    "csv probability": (
        "p.csv",
        "status,action,probability\n" + "".join(f"{s},none,0.9\n" for s in STATUSES),
        "not a distribution",
    ),
    "csv probability word": (
        "p.csv",
        "status,action,probability\n" + "".join(f"{s},none,often\n" for s in STATUSES),
        "not a finite rational",
    ),
    "other kind": ("p.txt", GOOD_CSV, "unknown kind of policy"),
    "no ending": ("optimall", GOOD_CSV, "unknown kind of policy"),
    "text as npy": ("p.npy", GOOD_CSV, "NumPy"),
    "text as npz": ("p.npz", GOOD_CSV, "NumPy"),
    "empty npy": ("p.npy", "", "NumPy"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_FILES)
def test_files_that_are_no_policy(tmp_path: Path, name: str) -> None:
    file, content, message = BAD_FILES[name]
    path = tmp_path / file
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ModelError) as caught:
        Policy.read(path, MDP_1)
    assert message in str(caught.value)
    assert caught.value.fix


@pytest.mark.parametrize("name", ["p\0.json", "p\0.csv", "p\0.npy", f"{'p' * 5000}.json"])
def test_names_that_no_file_can_have(name: str) -> None:
    with pytest.raises(ModelError):
        Policy.read(name, MDP_1)


@pytest.mark.parametrize("name", ["p.json", "p.csv", "p.npy", "p.npz"])
def test_files_that_cannot_be_read(tmp_path: Path, name: str) -> None:
    with pytest.raises(ModelError, match="cannot read the file"):
        Policy.read(tmp_path / name, MDP_1)
    (tmp_path / name).mkdir()
    with pytest.raises(ModelError, match="cannot read the file"):
        Policy.read(tmp_path / name, MDP_1)


@pytest.mark.parametrize(
    "array", [np.array([["a"]]), np.array([1j]), np.array([{}], dtype=object), np.array("x")]
)
def test_arrays_that_are_no_numbers(tmp_path: Path, array: Any) -> None:
    path = tmp_path / "q.npy"
    np.save(path, array, allow_pickle=True)
    with pytest.raises(ModelError):
        Policy.read(path, MDP_1)


def test_archives_of_several_arrays(tmp_path: Path) -> None:
    path = tmp_path / "q.npz"
    np.savez(path, first=np.zeros((16, 4)), second=np.zeros((16, 4)))
    with pytest.raises(ModelError, match="holds first, second"):
        Policy.read(path, MDP_1)


def test_files_as_editors_leave_them(tmp_path: Path) -> None:
    """A byte order mark, CRLF, blank lines and spaces change nothing."""
    text = GOOD_CSV.replace("\n", "\r\n").replace("0001,none", " 0001 , directive ") + "\r\n\r\n"
    path = tmp_path / "p.csv"
    path.write_bytes(text.encode("utf-8-sig"))
    check_follows(MDP_1, Policy.read(path, MDP_1), [0, 3, *[0] * 14])
    path = tmp_path / "p.json"
    path.write_bytes(GOOD_JSON.encode("utf-8-sig"))
    check_follows(MDP_1, Policy.read(path, MDP_1), [0] * 16)


def test_columns_in_any_order(tmp_path: Path) -> None:
    lines = [
        f"directive,{s},{t}" if t == 1 else f"none,{s},{t}" for t in range(2) for s in STATUSES
    ]
    path = tmp_path / "p.csv"
    path.write_text("action,status,trial\n" + "\n".join(reversed(lines)), encoding="utf-8")
    policy = Policy.read(path, MDP_1)
    trial = MDP_1.space.values("trial")
    chosen = policy.choices(MDP_1)
    assert chosen[:-1].tolist() == [3 * (t == 1) for t in trial[:-1].tolist()]


# ---- writing ------------------------------------------------


def test_writing_is_whole_or_not_at_all(tmp_path: Path) -> None:
    policy = Policy.of(MDP_1, GOOD := dict.fromkeys(STATUSES, "none"))
    path = tmp_path / "p.json"
    policy.write(path)
    assert json.loads(path.read_text(encoding="utf-8")) == GOOD
    assert [file.name for file in tmp_path.iterdir()] == ["p.json"]
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask
    with pytest.raises(ModelError, match="cannot write"):
        policy.write(tmp_path / "nowhere" / "p.json")
    with pytest.raises(ModelError, match=r"name it \.csv or \.json"):
        policy.write(tmp_path / "p.yaml")
    with pytest.raises(ModelError, match="the policy reads subtask, trial, status"):
        Policy.of(MDP_1, "random").write(tmp_path / "all.json")


def test_the_header_names_what_is_read(tmp_path: Path) -> None:
    Policy.of(MDP_1, np.zeros(65, dtype=int)).write(tmp_path / "all.csv")
    lines = (tmp_path / "all.csv").read_text(encoding="utf-8").splitlines()
    assert lines[:2] == ["subtask,trial,status,action", "0,0,0000,none"]
    assert len(lines) == 65
    Policy.by(MDP_1, ["status"], [3] * 16).write(tmp_path / "status.csv")
    lines = (tmp_path / "status.csv").read_text(encoding="utf-8").splitlines()
    assert lines[:2] == ["status,action", "0000,directive"]


def test_a_policy_that_reads_nothing_is_not_written(tmp_path: Path) -> None:
    mdp = Scenario.load("yuan2025").compile()
    with pytest.raises(ModelError, match="reads no column"):
        Policy.of(mdp, "always:none").write(tmp_path / "always.csv")
    assert not list(tmp_path.iterdir())
