"""Arrays of numbers from `.npy` and `.npz` files; Python objects, which could run code, are not."""

from __future__ import annotations

import io
import zipfile
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from exact_mdp.mdp.errors import ModelError, locate_errors
from exact_mdp.mdp.io.files import LARGE, LARGEST, PIECE, open_file
from exact_mdp.mdp.table import Numbers

TIMES = 64  # as large as it is itself an archive may unpack to; beyond 256 MiB no honest one does


def most_unpacked(packed: int) -> int:
    """Return how many bytes an archive of a size may unpack to."""
    return min(LARGEST, max(LARGE, TIMES * packed))


def refuse_size(size: int, most: int, *, table: bool = False) -> None:
    """Raise ModelError for data of more bytes than are read, be it a table of a policy or not."""
    if size > most:
        fix = "check that it is the right file"
        more = ": a policy has a number for each state and action"
        raise ModelError(
            f"the data unpacks to {size:,} bytes, more than the {most:,} that are read",
            fix=fix + (more if table else ", or save it again without compression"),
        )


def unpacked_size(stream: Any, most: int) -> int:
    """Return how much a compressed stream unpacks to, reading no more of it than is allowed."""
    size = 0
    for piece in iter(partial(stream.read, PIECE), b""):
        size += len(piece)
        refuse_size(size, most)
    return size


def read_array(path: str | Path, *, called: str, most: int = LARGE) -> Numbers:
    """Return the array of a `.npy` file, or the one of that name (or the only one) of an `.npz`.

    Nothing is rounded. Raises ModelError where the file is no regular file or damaged, for anything
    but real numbers, and for more than `most` bytes, before they are read.
    """
    with open_file(path, most=LARGEST) as file, locate_errors(str(path)):
        array = _read_archive(file, alone=called, most=most)[called]
        if array.dtype.kind not in "fiu":
            raise ModelError(f"an array of type {array.dtype}", fix="save real numbers")
    return array


def read_arrays(source: str | Path | bytes) -> dict[str, Numbers]:
    """Return all arrays of an `.npz` file, or of its bytes, by name, as `read_array` does."""
    if isinstance(source, bytes):
        return _read_archive(io.BytesIO(source), most=most_unpacked(len(source)))
    with open_file(source, most=LARGEST) as file, locate_errors(str(source)):
        return _read_archive(file, most=most_unpacked(file.seek(0, io.SEEK_END)))


def _read_archive(file: BinaryIO, *, most: int, alone: str = "") -> dict[str, Numbers]:
    """Return the arrays of an archive, each read whole, so that its checksum is compared.

    `alone` is the name of the only one that is wanted: the array that the file is, or the one of
    that name in an archive, or the only one there.
    """
    try:
        if alone and not zipfile.is_zipfile(file):
            refuse_size(file.seek(0, io.SEEK_END), most, table=True)
            file.seek(0)
            return {alone: _parse_npy(file.read())}
        with zipfile.ZipFile(file) as archive:
            members = {each.filename.removesuffix(".npy"): each for each in archive.infolist()}
            if alone and len(members) != 1 and alone not in members:
                raise ModelError(
                    f"the archive holds {', '.join(members)[:200] or 'nothing'}",
                    fix=f"save one array, or call it {alone}",
                )
            if alone:
                members = {alone: members.get(alone, next(iter(members.values())))}
            size = sum(each.file_size for each in members.values())
            refuse_size(size, most, table=bool(alone))
            return {
                name: _parse_npy(_unpack_member(archive, each)) for name, each in members.items()
            }
    except (ModelError, OSError):
        raise
    except Exception as error:  # NumPy, zipfile and zlib raise many kinds on damaged files
        raise ModelError(
            "not a readable NumPy array, or an archive of these: damaged, or with Python objects",
            fix="save it again, numbers alone",
        ) from error


def _unpack_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Return what a member holds; in pieces, as at once zipfile unpacks more than is claimed."""
    with archive.open(member) as file:
        return b"".join(iter(partial(file.read, PIECE), b""))


def _parse_npy(content: bytes) -> Numbers:
    # From a file, older versions of NumPy take a length of -1 for all that follows.
    array = np.load(io.BytesIO(content), allow_pickle=False)
    return np.asarray(array.astype(array.dtype.newbyteorder("="), copy=False))
