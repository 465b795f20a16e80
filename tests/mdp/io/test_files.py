"""Every kind of file that is opened is a regular one, no larger than it says; logs in blocks."""

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

MODEL = MDP.from_outcomes([(0, 0, [(1, 0, 1)])], "1/2")


def perceived(path: Path) -> None:
    done = run("evaluate", "yuan2025", "random", "--perception", path)
    assert (done.status, done.out) == (2, "")
    what, _, rest = done.err.removeprefix("error: ").partition("\n  where: ")
    raise ModelError(what, where=rest.partition("\n")[0], fix="")


READERS: dict[str, Callable[[Path], object]] = {
    "model.npz": load,
    "model.umb": load,
    "model.json": MDP.load,
    "scenario.toml": Scenario.load,
    "policy.csv": lambda path: Policy.of(MODEL, path),
    "policy.json": lambda path: Policy.of(MODEL, path),
    "policy.npy": lambda path: Policy.of(MODEL, path),
    "policy.npz": lambda path: Policy.of(MODEL, path),
    "perception.csv": perceived,
    "perception.toml": perceived,
    "certificate.json": Certificate.load,
    "bounded.json": BoundedCertificate.load,
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
    """A FIFO does not block, /dev/zero is not read; each is named, and nothing stays open."""
    path, before = tmp_path / name, len(os.listdir("/proc/self/fd"))

    def refused() -> ModelError:
        with pytest.raises(ModelError, match="cannot read the file") as caught:
            READERS[name](path)
        return caught.value

    refused()
    os.mkfifo(path)
    assert refused().where.startswith(str(path))
    assert "a pipe, not a regular file" in refused().what
    path.unlink()
    path.symlink_to("/dev/zero")
    assert "a device" in refused().what
    path.unlink()
    path.mkdir()
    assert "a folder" in refused().what
    path.rmdir()
    with socket.socket(socket.AF_UNIX) as listening:
        os.chdir(tmp_path)  # whose name may be too long for a socket
        listening.bind(name)
        refused()
    assert len(os.listdir("/proc/self/fd")) == before


def test_what_can_be_neither_read_nor_written(tmp_path: Path) -> None:
    """Renaming a finished file into place would put it where a device or a pipe was."""
    os.mkfifo(tmp_path / "p.json")
    policy = Policy.of(MODEL, [0])
    with pytest.raises(ModelError, match="there is a pipe of this name"):
        policy.write(tmp_path / "p.json")
    with pytest.raises(ModelError, match="cannot write the file"):
        policy.write(tmp_path / "a\0b.json")
    assert [entry.name for entry in tmp_path.iterdir()] == ["p.json"]
    with pytest.raises(ModelError, match=r"null (byte|character)"):
        Scenario.load("a\0b.toml")
    with pytest.raises(ModelError) as caught:
        Policy.of(MODEL, tmp_path / "p.json")
    assert "<(…)" in caught.value.fix
    with open(tmp_path / "big.toml", "wb") as file:
        file.truncate(2**29)
    with pytest.raises(ModelError, match="536,870,912 bytes"):  # known before a byte is read
        Scenario.load(tmp_path / "big.toml")


@pytest.mark.parametrize("kind", ["i8", ">i8", "u8", "f4", ">f8", np.longdouble, "f2"])
def test_numbers_of_every_type_come_through(tmp_path: Path, kind: Any) -> None:
    """In either order of bytes and of axes; wide ones are not rounded to floats."""
    mdp = MDP.from_arrays([np.eye(2)] * 3, [[0] * 3] * 2, "1/2")
    wide = (np.dtype(kind).itemsize == 8 and np.dtype(kind).kind != "f") or kind is np.longdouble
    values = np.array([[1, 2, 0], [3, 4, 5]], dtype=kind) + np.array(2**54 * wide, dtype=kind)
    for order in "CF":
        np.save(tmp_path / "q.npy", np.asarray(values, order=order))
        np.savez_compressed(tmp_path / "q.npz", q=np.asarray(values, order=order), other=values)
        for name in ("q.npy", "q.npz"):
            assert Policy.of(mdp, tmp_path / name, kind="q").tolist() == [1, 2]


def refused(content: bytes, name: str, folder: Path) -> str:
    path = folder / name
    path.write_bytes(content)
    with pytest.raises(ModelError) as caught:
        Policy.of(MODEL, path)
    assert caught.value.where.startswith(str(path))
    assert "pickle" not in str(caught.value)
    return caught.value.what


def test_arrays_that_claim_what_they_do_not_hold(tmp_path: Path) -> None:
    """The shape in a header takes no memory before the file's size has been compared."""
    bomb = zipped({"q.npy": array_header("(20000000,)") + bytes(160_000_000)})
    assert len(bomb) < 1_000_000
    assert "claims to hold 160,000," in refused(bomb, "q.npz", tmp_path)
    huge, missing, short = (array_header(f"({n})") for n in ("9000000000000,", "4, 1", "1, 1"))
    for content in (huge, missing, short + bytes(7)):
        assert "bytes, not" in refused(content, "q.npy", tmp_path)
        assert "bytes, not" in refused(zipped({"q.npy": content}), "q.npz", tmp_path)
    for shape in ("(" * 300, "(1,)" + " " * 60_000):
        assert "header is damaged" in refused(array_header(shape), "q.npy", tmp_path)
    assert "not a readable NumPy array" in refused(b"q", "q.npy", tmp_path)
    good = zipped({"q.npy": array_header("(1, 1)") + bytes(8)})
    for length in range(2, len(good) - 1, 9):
        refused(good[:length], "q.npz", tmp_path)
    stream = io.BytesIO()
    np.save(stream, np.array([[{}]], dtype=object), allow_pickle=True)
    for name, content in (
        ("q.npy", stream.getvalue()),
        ("q.npz", zipped({"q.npy": stream.getvalue()})),
    ):
        assert "could run any program" in refused(content, name, tmp_path)
    refused(b"\x80\x04K\x01.", "q.npy", tmp_path)  # what np.load takes for a pickle


NAMES = ["episode", "state", "action", "reward", "next_state"]


def test_one_and_one_point_zero_are_one_state(tmp_path: Path) -> None:
    """Pandas writes whole numbers as floats in a column where one is missing."""
    rows = [(1, 0, 1, 2, 1), (1, 1, 0, "1.0", 12), (2, 0, 0, 1, None), (3, 12, 1, 3, 0)]
    log = pd.DataFrame(rows, columns=NAMES)
    kinds = [log.astype({"next_state": "Int64"}), log, log.astype({"next_state": float})]
    kinds.append(log.astype(dict.fromkeys(("episode", "state", "action", "next_state"), float)))
    wanted = MDP.from_transitions(kinds[0])
    assert wanted.space.labels(range(4)) == ["state 0", "state 1", "state 12", "end"]
    assert wanted.actions == ("0", "1")
    for frame in kinds:
        frame.to_csv(tmp_path / "log.csv", index=False)
        frame.astype({"reward": str}).to_parquet(tmp_path / "log.parquet")
        for log_ in (frame, tmp_path / "log.csv", tmp_path / "log.parquet"):
            mdp = MDP.from_transitions(log_)
            assert fingerprint(mdp) == fingerprint(wanted)
            assert (mdp.space, mdp.actions) == (wanted.space, wanted.actions)


@pytest.mark.parametrize("rows_in_a_block", [1, 3, 100])
def test_where_episodes_were_cut_off_is_no_end(
    tmp_path: Path, rows_in_a_block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("exact_mdp.mdp.io.transitions.ROWS", rows_in_a_block)
    rows = [
        (1, "a", "x", 0, "b", False), (1, "b", "y", 1, "trap", True),
        (2, "a", "x", 0, "home", False), (3, "a", "y", 1, None, True),
        (4, "a", "x", 0, "a", True), (5, "a", "x", 0, "home", True), (6, "new", "x", 0, None, True),
    ]  # fmt: skip
    frame = pd.DataFrame(rows, columns=[*NAMES, "truncated"])
    frame.to_csv(tmp_path / "log.csv", index=False)
    frame.astype({"truncated": int}).to_parquet(tmp_path / "log.parquet")
    renamed = frame.rename(columns={"truncated": "timeout"})
    models = [
        *(MDP.from_transitions(log, "1/2") for log in (frame, tmp_path / "log.csv",
                                                        tmp_path / "log.parquet")),
        MDP.from_transitions(renamed, "1/2", columns={"truncated": "timeout"}),
    ]  # fmt: skip
    for mdp in models:
        names = [label.removeprefix("state ") for label in mdp.space.labels(range(mdp.n_states))]
        cut = mdp.labels["cut off"]
        assert [n for n, flag in zip(names, cut, strict=True) if flag] == ["trap", "cut off"]
        pairs = zip(mdp.pair_state, mdp.pair_action, mdp.observations, strict=True)
        counts = {(names[s], mdp.actions[a]): n for s, a, n in pairs if n}
        assert counts == {("a", "x"): 4, ("a", "y"): 1, ("b", "y"): 1, ("new", "x"): 1}
        assert mdp.episodes == 6
    model = tmp_path / "m.npz"
    result = run("data", tmp_path / "log.csv", "--out", model, "--discount=1/2", "--json").result
    assert (result["cut_off"], result["n_never_taken"]) == (5, 2)
    assert result["cut_off_states"] == ["state trap", "cut off"]
    assert result["never_taken"] == ["state b: x", "state new: y"]
    plain = run("data", tmp_path / "log.csv", "--out", model, "--discount=1/2")
    assert "no medical advice" in plain.out
    assert "nobody knows what follows where episodes were cut off" in plain.err
    save(models[0], tmp_path / "m.umb")
    assert (
        load(model).labels["cut off"].sum() == load(tmp_path / "m.umb").labels["cut off"].sum() == 2
    )


def test_a_signal_after_the_rename_is_what_ends_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The temporary file is gone by then, which was reported in the signal's place."""
    rename = os.replace

    def replace(source: str, target: Path) -> None:
        rename(source, target)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(KeyboardInterrupt):
        save(MODEL, tmp_path / "model.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["model.npz"]
