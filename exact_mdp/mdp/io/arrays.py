"""Arrays from `.npy` and `.npz` files: what a file claims is compared with its size before reading.

An array's header states its type and shape; an archive's directory states how large each member
becomes. Memory is taken for what these claim only where the file can hold it. Arrays of Python
objects are refused: reading them could run any program.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import BinaryIO

import numpy as np

from exact_mdp.mdp.errors import ModelError, located
from exact_mdp.mdp.io.files import LARGEST, opened
from exact_mdp.mdp.table import Numbers

FREE, RATIO = 2**26, 50
"""A compressed archive may claim up to 64 MiB, or 50 times its own size, whichever is more."""

ZIP, NPY = b"PK", b"\x93NUMPY"
HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_array(path: str | Path, *, called: str) -> Numbers:
    """Return the array of a `.npy` file, or the one of that name (or the only one) of an `.npz`.

    Nothing is rounded. Raises ModelError where the file is not a regular file, is damaged, claims
    more than it can hold, or holds something other than real numbers.
    """
    where = str(path)
    with opened(path, most=LARGEST) as file, _named(where):
        begin = file.read(len(NPY))
        if begin == NPY:
            name, arrays = where, {where: _array(begin + file.read(), where)}
        elif begin.startswith(ZIP):
            arrays = _members(file, RATIO)
            if len(arrays) != 1 and called not in arrays:
                raise ModelError(
                    f"the archive holds {', '.join(arrays)[:200] or 'nothing'}",
                    fix=f"save one array, or call it {called}",
                )
            name = called if called in arrays else next(iter(arrays))
        else:
            raise ModelError("not a readable NumPy array", fix="save it again with numpy.save")
        if arrays[name].dtype.kind not in "fiu":
            what = f"an array of type {arrays[name].dtype}"
            raise ModelError(what, where=name, fix="save real numbers")
        return arrays[name]


def read_arrays(source: str | Path | bytes, *, ratio: int = RATIO) -> dict[str, Numbers]:
    """Return all arrays of an `.npz` file, or of its bytes, by name, as `read_array` does.

    A compressed archive may claim `ratio` times its own size.
    """
    if isinstance(source, bytes):
        with _named(""):
            return _members(io.BytesIO(source), ratio)
    with opened(source, most=LARGEST) as file, _named(str(source)):
        return _members(file, ratio)


def _members(file: BinaryIO, ratio: int) -> dict[str, Numbers]:
    """Return the arrays of an archive; raises ModelError unless it can be what it claims.

    A checksum is compared as a member is read.
    """
    size = file.seek(0, 2)
    with zipfile.ZipFile(file) as archive:
        listed = archive.infolist()
        members = {member.filename.removesuffix(".npy"): member for member in listed}
        if len(members) != len(listed):
            twins = ", ".join(sorted(archive.namelist()))[:200]
            raise ModelError(f"the archive holds {twins}, one of them twice", fix="save it again")
        methods = {member.compress_type for member in listed}
        encrypted = any(member.flag_bits & 1 for member in listed)
        if encrypted or not methods <= {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
            what = "the archive is encrypted, or compressed in an unusual way"
            raise ModelError(what, fix="save it again")
        claimed = sum(member.file_size for member in listed)
        if claimed > (size if methods == {zipfile.ZIP_STORED} else max(FREE, ratio * size)):
            raise ModelError(
                f"the archive of {size:,} bytes claims to hold {claimed:,}",
                fix="save it again, uncompressed",
            )
        return {name: _array(archive.read(member), name) for name, member in members.items()}


def _array(data: bytes, where: str) -> Numbers:
    """Return the array that a `.npy` file's bytes hold, after its header has been looked at."""
    stream = io.BytesIO(data)
    try:
        shape, fortran, kind = HEADERS[np.lib.format.read_magic(stream)](stream)
    except Exception as error:  # NumPy raises many kinds; its words advise to trust the file
        what = "not a readable NumPy array: its header is damaged"
        raise ModelError(what, where=where, fix="save it again") from error
    if kind.hasobject:
        what = "an array of type object, which could run any program when read"
        raise ModelError(what, where=where, fix="save numbers alone")
    begin = stream.tell()
    wanted = begin + prod(shape) * kind.itemsize
    if min(shape, default=0) < 0 or wanted != len(data):
        what = f"an array of shape {shape} and type {kind} in {len(data):,} bytes, not {wanted:,}"
        raise ModelError(what, where=where, fix="save it again")
    flat = np.frombuffer(data, kind, prod(shape), begin) if prod(shape) else np.empty(0, kind)
    array = flat.reshape(shape, order="F" if fortran else "C")
    return array.astype(kind.newbyteorder("="), copy=True)


@contextmanager
def _named(where: str) -> Iterator[None]:
    """Put the file in front of an error's place, and name what damaged archives raise."""
    with located(where):
        try:
            yield
        except (ModelError, OSError):
            raise
        except Exception as error:  # zipfile and zlib raise many kinds on damaged archives
            what = "the file is damaged, or not an archive"
            raise ModelError(what, fix="save it again") from error
