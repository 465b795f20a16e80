"""Arrays of numbers from `.npy` and `.npz` files; pickled objects, which run code, are refused."""

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


def most_unpacked(packed: int) -> int:
    """Return the number of bytes to which an archive of `packed` bytes may unpack.

    It is 64 times its own size, or 256 MiB: enough for any real model, and little enough that a
    small hostile file cannot fill the memory.
    """
    return min(LARGEST, max(LARGE, 64 * packed))


def refuse_size(size: int, most: int, *, table: bool = False) -> None:
    """Raise ModelError for more than `most` bytes; `table` is True for the table of a policy."""
    if size <= most:
        return
    fix = "check that it is the right file, or save it again without compression"
    if table:
        fix = "check that it is the right file: a policy has a number for each state and action"
    what = f"the data unpacks to {size:,} bytes, more than the {most:,} that are read"
    raise ModelError(what, fix=fix)


def unpacked_size(stream: Any, most: int) -> int:
    """Return the unpacked size of a compressed stream; stop with an error beyond `most` bytes."""
    size = 0
    for piece in iter(partial(stream.read, PIECE), b""):
        size += len(piece)
        refuse_size(size, most)
    return size


def read_array(path: str | Path, *, called: str, most: int = LARGE) -> Numbers:
    """Return the array of a `.npy` file, or the array `called` (or the only one) of an `.npz` file.

    Nothing is rounded. Raises ModelError for a file that is damaged or not a regular file, for
    anything but real numbers, and for more than `most` bytes, before they are read.
    """
    with open_file(path, most=LARGEST) as file, locate_errors(str(path)):
        array = _read_archive(file, alone=called, most=most)[called]
        if array.dtype.kind not in "fiu":
            raise ModelError(f"an array of type {array.dtype}", fix="save real numbers")
    return array


def read_arrays(source: str | Path | bytes) -> dict[str, Numbers]:
    """Return all arrays of an `.npz` file, or of its bytes, by name."""
    if isinstance(source, bytes):
        return _read_archive(io.BytesIO(source), most=most_unpacked(len(source)))
    with open_file(source, most=LARGEST) as file, locate_errors(str(source)):
        return _read_archive(file, most=most_unpacked(file.seek(0, io.SEEK_END)))


def _read_archive(file: BinaryIO, *, most: int, alone: str = "") -> dict[str, Numbers]:
    """Return the arrays of an archive; each is read completely, so that its checksum is compared.

    With `alone`, return a single array under that name: the array of a `.npy` file, or the array of
    that name in an archive, or the only array of the archive.
    """
    try:
        # A file that is not an archive is one array.
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
            arrays = {}
            for name, each in members.items():
                arrays[name] = _parse_npy(_unpack_member(archive, each))
            return arrays
    except (ModelError, OSError):
        raise
    except Exception as error:  # NumPy, zipfile and zlib raise many kinds on damaged files
        raise ModelError(
            "not a readable NumPy array, or an archive of these: damaged, or with Python objects",
            fix="save it again, with numbers only",
        ) from error


def _unpack_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Return the content of a member, read in pieces, so that it cannot exceed its stated size."""
    with archive.open(member) as file:
        return b"".join(iter(partial(file.read, PIECE), b""))


def _parse_npy(content: bytes) -> Numbers:
    """Return the array of a `.npy` file in the machine's byte order."""
    # From a file, older versions of NumPy would read a length of -1 as everything that follows.
    array = np.load(io.BytesIO(content), allow_pickle=False)
    return np.asarray(array.astype(array.dtype.newbyteorder("="), copy=False))
