"""Every file is a regular one and no larger than it says, or it is refused at once, in words."""

from __future__ import annotations

import io
import os
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from archives import array_header, zipped

from exact_mdp import (
    MDP,
    BoundedCertificate,
    Certificate,
    ModelError,
    Policy,
    Scenario,
    load,
    load_ranges,
    load_uncertainty,
)
from exact_mdp.mdp.care.perception import read as read_perception
from exact_mdp.mdp.care.perception import read_counts
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
