"""Every kind of file that is opened is a regular one; tables are read in blocks."""

from __future__ import annotations

import io
import os
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from archives import array_header, zipped
from cli_runner import run

from exact_mdp import (
    MDP,
    BoundedCertificate,
    Certificate,
    ModelError,
    Policy,
    Scenario,
    fingerprint,
    load,
    load_ranges,
    load_uncertainty,
    save,
)
from exact_mdp.analysis.gate.data.interval import entered
from exact_mdp.mdp.care.perception import read as read_perception
from exact_mdp.mdp.care.perception import read_counts
from exact_mdp.mdp.io import transitions
from exact_mdp.mdp.io.arrays import read_array
from exact_mdp.mdp.io.files import opened, read_bytes, read_text, write_atomically
from exact_mdp.mdp.io.load import read_model
from exact_mdp.solvers.parallel import read_piece

MODEL = MDP.from_outcomes([(0, 0, [(1, 0, 1)])], "1/2")
CARE = Scenario.load("yuan2025").with_(tasks=[1], max_trial=1).compile()

READERS: dict[str, Callable[[Path], object]] = {
    "text": read_text,
    "bytes": read_bytes,
    "model.npz": load,
    "model.umb": load,
    "load.npz": read_model,
    "load.json": read_model,
    "load.umb": read_model,
    "load.toml": read_model,
    "scenario.toml": Scenario.load,
    "policy.csv": lambda path: Policy.of(MODEL, path),
    "policy.json": lambda path: Policy.of(MODEL, path),
    "policy.npy": lambda path: Policy.of(MODEL, path),
    "policy.npz": lambda path: Policy.of(MODEL, path),
    "array.npy": lambda path: read_array(path, called="q"),
    "perception.csv": lambda path: read_perception(path, CARE),
    "perception.toml": lambda path: read_perception(path, CARE),
    "counts.jsonl": lambda path: read_counts(path, CARE),
    "certificate.json": Certificate.load,
    "bounded.json": BoundedCertificate.load,
    "piece.npz": read_piece,
    "ranges.toml": lambda path: load_ranges(Scenario.load("yuan2025"), path),
    "uncertainty.toml": load_uncertainty,
}


@pytest.fixture(autouse=True)
def _in_time() -> Iterator[None]:
    """Fail, rather than wait, where a reader waits for the other end of a pipe."""

    def late(*_: object) -> None:
        pytest.fail("a reader waits")  # no OSError, which a reader would explain away

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("name", READERS)
def test_pipes_devices_folders_and_nothing_at_all(tmp_path: Path, name: str) -> None:
    """A FIFO does not block, /dev/zero is not read, a folder and a socket are named as such."""
    path = tmp_path / name
    words = "damaged" if name == "piece.npz" else "cannot read the file"
    if name != "piece.npz":  # a piece that is not there is one not yet computed
        with pytest.raises(ModelError, match=words):
            READERS[name](path)
    os.mkfifo(path)
    with pytest.raises(ModelError, match=words) as caught:
        READERS[name](path)
    assert caught.value.where.startswith(str(path))
    path.unlink()
    path.symlink_to("/dev/zero")
    with pytest.raises(ModelError, match=words):
        READERS[name](path)
    path.unlink()
    path.mkdir()
    with pytest.raises(ModelError, match=words):
        READERS[name](path)


def test_what_is_refused_is_named(tmp_path: Path) -> None:
    """The message says what the file is; a process substitution is told to be a pipe."""
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(ModelError, match="a pipe, not a regular file") as caught:
        read_text(tmp_path / "fifo")
    assert "<(…)" in caught.value.fix
    with pytest.raises(ModelError, match="a device"):
        read_text("/dev/zero")
    with pytest.raises(ModelError, match="a folder"):
        read_text(tmp_path)
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "s"))
        with pytest.raises(ModelError, match="cannot read the file"):
            read_text(tmp_path / "s")
    with pytest.raises(ModelError, match=r"null (byte|character)"):
        read_text("a\0b")
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(3):
        with pytest.raises(ModelError):
            read_text(tmp_path)
    assert len(os.listdir("/proc/self/fd")) == before


def test_nothing_but_a_regular_file_is_written_over(tmp_path: Path) -> None:
    """Renaming a finished file into place would put it where a device or a pipe was."""
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(ModelError, match="there is a pipe of this name"):
        write_atomically(tmp_path / "fifo", "text")
    with pytest.raises(ModelError, match="cannot write the file"):
        write_atomically(tmp_path / "a\0b", "text")
    assert [entry.name for entry in tmp_path.iterdir()] == ["fifo"]


def test_files_beyond_the_limit(tmp_path: Path) -> None:
    """The size of a file is known before a byte of it is read; what grows is cut off."""
    with open(tmp_path / "big", "wb") as file:
        file.truncate(2**29)
    with pytest.raises(ModelError, match="536,870,912 bytes"):
        read_bytes(tmp_path / "big")
    os.rename(tmp_path / "big", tmp_path / "big.toml")
    with pytest.raises(ModelError, match="536,870,912 bytes"):
        Scenario.load(tmp_path / "big.toml")
    with opened(tmp_path / "big.toml", most=2**30) as file:
        assert file.read(1) == b"\0"
    with pytest.raises(ModelError, match="more than the 10"):
        read_bytes("/proc/self/status", most=10)


def test_numbers_of_every_type_come_through(tmp_path: Path) -> None:
    """int64 and long double are handed on as they are, in either order of bytes and of axes."""
    for kind in ("i8", ">i8", "u8", "f4", ">f8", np.longdouble, "f2"):
        for order in "CF":
            values = np.asarray(np.arange(6).reshape(2, 3), dtype=kind, order=order)
            np.save(tmp_path / "q.npy", values)
            found = read_array(tmp_path / "q.npy", called="q")
            assert found.dtype == np.dtype(kind).newbyteorder("=")
            assert np.array_equal(found, values)
            np.savez_compressed(tmp_path / "q.npz", q=values, other=values)
            assert np.array_equal(read_array(tmp_path / "q.npz", called="q"), values)


def test_a_constant_piece_is_not_out_of_proportion(tmp_path: Path) -> None:
    """Pieces of a run are compressed as far as they go; our own are never refused."""
    from exact_mdp.solvers.parallel import write_piece

    write_piece(tmp_path / "a.npz", {"zeros": np.zeros(20_000_000)})
    found = read_piece(tmp_path / "a.npz")
    assert found is not None
    assert found["zeros"].shape == (20_000_000,)


NAMES = ["episode", "state", "action", "reward", "next_state"]


def table(rows: list[tuple[Any, ...]]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=NAMES)


@pytest.mark.parametrize("size", [1, 3, 100])
def test_one_and_one_point_zero_are_one_state(
    size: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pandas writes whole numbers as floats in a column where one is missing."""
    rows = [(1, 0, 1, 2, 1), (1, 1, 0, "1.0", 12), (2, 0, 0, 1, None), (3, 12, 1, 3, 0)]
    whole = table(rows).astype({"next_state": "Int64"})
    floats = table(rows)
    for name in ("episode", "state", "action", "next_state"):
        floats[name] = floats[name].astype(float)
    monkeypatch.setattr(transitions, "ROWS", size)
    wanted = MDP.from_transitions(whole)
    assert wanted.space.labels(range(4)) == ["state 0", "state 1", "state 12", "end"]
    assert wanted.actions == ("0", "1")
    for frame in (whole, table(rows), table(rows).astype({"next_state": float}), floats):
        assert fingerprint(MDP.from_transitions(frame)) == fingerprint(wanted)
        frame.to_csv(tmp_path / "log.csv", index=False)
        found = MDP.from_transitions(tmp_path / "log.csv")
        assert fingerprint(found) == fingerprint(wanted)
        assert found.space == wanted.space
        assert found.actions == wanted.actions
    frame.astype({"reward": str}).to_parquet(tmp_path / "log.parquet")
    assert fingerprint(MDP.from_transitions(tmp_path / "log.parquet")) == fingerprint(wanted)


CUT = [*NAMES, "truncated"]


def cut(rows: list[tuple[Any, ...]]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=CUT)


CUT_ROWS = [
    (1, "a", "x", 0, "b", False), (1, "b", "y", 1, "trap", True),
    (2, "a", "x", 0, "home", False), (3, "a", "y", 1, None, True),
    (4, "a", "x", 0, "a", True), (5, "a", "x", 0, "home", True), (6, "new", "x", 0, None, True),
]  # fmt: skip


@pytest.mark.parametrize("size", [1, 3, 100])
def test_where_episodes_were_cut_off_is_no_end(
    size: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transitions, "ROWS", size)
    frame = cut(CUT_ROWS)
    frame.to_csv(tmp_path / "log.csv", index=False)
    frame.astype({"truncated": int}).to_parquet(tmp_path / "log.parquet")
    found = [MDP.from_transitions(each, "1/2") for each in (frame, tmp_path / "log.parquet")]
    found.append(MDP.from_transitions(tmp_path / "log.csv", "1/2"))
    other = frame.rename(columns={"truncated": "timeout"})
    found.append(MDP.from_transitions(other, "1/2", columns={"truncated": "timeout"}))
    for mdp in found:
        names = [mdp.space.label(s).removeprefix("state ") for s in range(mdp.n_states)]
        assert [n for n, flag in zip(names, mdp.labels["cut off"], strict=True) if flag] == [
            "trap",
            "cut off",
        ]
        assert entered(mdp) == ("state home",)
        seen = {
            (names[s], mdp.actions[a]): n
            for s, a, n in zip(mdp.pair_state, mdp.pair_action, mdp.observations, strict=True)
            if n
        }  # type: ignore[arg-type]
        assert seen == {("a", "x"): 4, ("a", "y"): 1, ("b", "y"): 1, ("new", "x"): 1}
        assert mdp.episodes == 6
    record = transitions.counted(frame, None)
    assert record.n_cut_off == 5
    assert sum(record.stops.values()) == record.starts.total() == 6
    assert transitions.counted(frame.drop(columns="truncated"), None).n_cut_off == 1  # stops in a
    model = tmp_path / "m.npz"
    told = run("data", tmp_path / "log.csv", "--out", model, "--discount=1/2", "--json").result
    assert (told["cut_off"], told["n_never_taken"]) == (5, 2)
    assert told["cut_off_states"] == ["state trap", "cut off"]
    assert told["never_taken"] == ["state b: x", "state new: y"]
    assert load(model).labels["cut off"].sum() == 2
    plain = run("data", tmp_path / "log.csv", "--out", model, "--discount=1/2")
    assert "no medical advice" in plain.out
    assert "nobody knows what follows where episodes were cut off" in plain.err
    save(found[0], tmp_path / "m.umb")
    assert load(tmp_path / "m.umb").labels["cut off"].sum() == 2


def refused(content: bytes, name: str, folder: Path) -> str:
    path = folder / name
    path.write_bytes(content)
    with pytest.raises(ModelError) as caught:
        Policy.of(MODEL, path)
    assert caught.value.where.startswith(str(path))
    assert "pickle" not in str(caught.value)
    return caught.value.what


def test_a_policy_archive_that_expands(tmp_path: Path) -> None:
    """783 kB of .npz became 768 MB of memory; its directory says so before."""
    bomb = zipped({"q.npy": array_header("(20000000,)") + bytes(160_000_000)})
    assert len(bomb) < 1_000_000
    assert "claims to hold 160,000," in refused(bomb, "q.npz", tmp_path)


def test_arrays_that_claim_more_than_they_hold(tmp_path: Path) -> None:
    """The shape in a header takes no memory before the file's size has been compared."""
    huge, missing, short = (
        array_header(f"({size})") for size in ("9000000000000,", "4, 1", "1, 1")
    )
    for content in (huge, missing, short + bytes(7)):
        assert "bytes, not" in refused(content, "q.npy", tmp_path)
        assert "bytes, not" in refused(zipped({"q.npy": content}), "q.npz", tmp_path)
    assert "header is damaged" in refused(array_header("(" * 300), "q.npy", tmp_path)
    assert "header is damaged" in refused(array_header("(1,)" + " " * 60_000), "q.npy", tmp_path)
    assert "not a readable NumPy array" in refused(b"q", "q.npy", tmp_path)
    good = zipped({"q.npy": array_header("(1, 1)") + bytes(8)})
    for length in range(2, len(good) - 1, 9):
        refused(good[:length], "q.npz", tmp_path)


def test_numpy_is_not_quoted_on_pickles(tmp_path: Path) -> None:
    """An array of objects is refused in our words, which advise nobody to allow it."""
    stream = io.BytesIO()
    np.save(stream, np.array([[{}]], dtype=object), allow_pickle=True)
    assert "could run any program" in refused(stream.getvalue(), "q.npy", tmp_path)
    assert "could run any program" in refused(
        zipped({"q.npy": stream.getvalue()}), "q.npz", tmp_path
    )
    # What np.load takes for a pickle, because it is nothing else.
    refused(b"\x80\x04K\x01.", "q.npy", tmp_path)
