"""Every kind of file that is opened is a regular one, no larger than it says; logs in blocks."""

import gzip
import io
import os
import re
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from archives import array_header, unzipped, zipped
from cli_runner import run
from refusal_tables import refused

from exact_mdp import (
    MDP,
    BoundedCertificate,
    Certificate,
    ModelError,
    Policy,
    Scenario,
    fingerprint,
    load,
    one_way,
    save,
    uncertainty,
)

MODEL = MDP.from_outcomes([(0, 0, [(1, 0, 1)])], "1/2")


def perceived(path: Path) -> None:
    raise run("evaluate", "yuan2025", "random", "--perception", path).error()


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
    "ranges.toml": lambda path: one_way(Scenario.load("yuan2025"), "base.anger", path, points=2),
    "uncertainty.toml": lambda path: uncertainty(Scenario.load("yuan2025").parametric(), path),
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

    def reading_is_refused(*said: str) -> None:
        assert "cannot read the file" in refused(lambda: READERS[name](path), *said).what

    reading_is_refused()
    os.mkfifo(path)
    reading_is_refused("a pipe, not a regular file", str(path))
    path.unlink()
    path.symlink_to("/dev/zero")
    reading_is_refused("a device")
    path.unlink()
    path.mkdir()
    reading_is_refused("a folder")
    path.rmdir()
    with socket.socket(socket.AF_UNIX) as listening:
        os.chdir(tmp_path)  # whose name may be too long for a socket
        listening.bind(name)
        reading_is_refused()
    assert len(os.listdir("/proc/self/fd")) == before


def test_what_can_be_neither_read_nor_written(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "p.csv")
    policy = Policy.of(MODEL, [0])
    refused(lambda: policy.write(tmp_path / "p.csv"), "there is a pipe of this name")
    refused(lambda: policy.write(tmp_path / "a\0b.csv"), "cannot write the file")
    assert [entry.name for entry in tmp_path.iterdir()] == ["p.csv"]
    with pytest.raises(ModelError, match=r"null (byte|character)"):
        Scenario.load("a\0b.toml")
    refused(lambda: Policy.of(MODEL, tmp_path / "p.csv"), "", "", "<(…)")
    with open(tmp_path / "big.toml", "wb") as file:
        file.truncate(2**29)
    with pytest.raises(
        ModelError, match="more than the 16,777,216 bytes"
    ):  # known before a byte is read
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
            assert Policy.of(mdp, tmp_path / name, kind="q").rule.tolist() == [1, 2]


class Trap:
    def __reduce__(self) -> tuple[Any, ...]:
        return sys.exit, ("a pickle was opened",)


def pickled() -> bytes:
    np.save(stream := io.BytesIO(), np.array([[Trap()]], dtype=object), allow_pickle=True)
    return stream.getvalue()


ARRAYS: list[bytes] = [
    *(array_header(shape) + bytes(more) for shape, more in (
        ("(9000000000000,)", 0), (f"(9{'0' * 24},)", 16), ("(4, 1)", 0), ("(1, 1)", 7))),
    *(array_header(shape) + bytes(16) for shape in (
        "(" * 300, "(1,)" + " " * 60_000, "'x'", "(1.5,)", "(1,), 'more': 3")),
    array_header("(-1,)", "<i8") + bytes(16),
    array_header("(1,)", "nonsense") + bytes(16),
    b"q",
    b"\x80\x04K\x01.",  # what np.load takes for a pickle
    pickled(),
    zipped({}),
]  # fmt: skip


def contents(name: str, folder: Path) -> tuple[dict[str, bytes], str]:
    if name == "policy.npz":
        return {"q.npy": array_header("(1, 1)") + bytes(8)}, "q.npy"
    save(MODEL, folder / "good.npz")
    return unzipped(folder / "good.npz"), "pair_state.npy"


@pytest.mark.parametrize("name", ["policy.npy", "policy.npz", "model.npz"])
@pytest.mark.parametrize("array", ARRAYS, ids=range(len(ARRAYS)))
def test_arrays_that_are_not_what_they_claim(tmp_path: Path, name: str, array: bytes) -> None:
    """No pickle is opened, and a shape beyond the memory is refused."""
    path = tmp_path / name
    if name == "policy.npy":
        path.write_bytes(array)
    else:
        members, place = contents(name, tmp_path)
        path.write_bytes(zipped(members | {place: array}))
    words = "archive holds nothing" if array == zipped({}) and path.suffix == ".npy" else "damaged"
    refused(lambda: READERS[name](path), words, str(path))


@pytest.mark.parametrize("name", ["policy.npz", "model.npz"])
def test_an_archive_that_claims_more_than_is_read(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    members, _ = contents(name, tmp_path)
    content = bytearray(zipped(members))
    for match in re.finditer(b"PK\x01\x02", bytes(content)):  # the sizes in its list
        content[match.start() + 24 : match.start() + 28] = b"\x00\x00\x00\x30"
    path.write_bytes(content)
    size = len(members) * 0x30000000
    refused(lambda: READERS[name](path), f"unpacks to {size:,} bytes", str(path), "right file")


def test_an_archive_that_holds_more_than_it_claims(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    members, place = contents("policy.npz", tmp_path)
    content = bytearray(zipped(members | {place: members[place] + bytes(10**6)}))
    at = content.index(b"PK\x01\x02") + 24
    content[at : at + 4] = len(members[place]).to_bytes(4, "little")
    path.write_bytes(content)
    refused(lambda: READERS["policy.npz"](path), "damaged", str(path))


def test_of_an_archive_only_the_table_is_read(tmp_path: Path) -> None:
    """A list of other arrays beside it may be large, or hold objects."""
    np.savez(tmp_path / "q.npz", q=[[1.0]], log=np.array([{}], dtype=object))
    assert Policy.of(MODEL, tmp_path / "q.npz").read_as == "policy"


def test_a_compressed_umb_file_is_unpacked_in_bounds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "model.umb"
    path.write_bytes(gzip.compress(bytes(10**6)))
    monkeypatch.setattr("exact_mdp.mdp.io.structured.LARGE", 1000)
    refused(lambda: load(path), "more than the", str(path))


NAMES = ["episode", "state", "action", "reward", "next_state"]


def test_a_model_that_is_written_again_keeps_the_names_of_its_states(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    mdp = MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0], states=["a", "b"])
    for _ in range(3):
        assert mdp.space.labels([0, 1]) == ["state a", "state b"]
        mdp.save(path)
        mdp = MDP.load(path)


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
