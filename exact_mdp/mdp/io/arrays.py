"""Arrays from `.npy` and `.npz` files: what a file claims is compared with its size before reading.

An array's header states its type and shape; an archive's directory states how large each member
becomes. Memory is taken for what these claim only where the file can hold it. Arrays of Python
objects are refused: reading them could run any program. What NumPy advises in that case, to allow
it, is not passed on.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from exact_mdp.mdp.errors import ModelError, shown_text
from exact_mdp.mdp.io.files import LARGEST, opened
from exact_mdp.mdp.table import Numbers

FREE, RATIO = 2**26, 50
"""A compressed archive may claim up to 64 MiB, or 50 times its own size, whichever is more."""

ZIP, NPY = b"PK", b"\x93NUMPY"
AGAIN = "save it again with numpy.save"

Check = Callable[[str, "np.dtype[Any]", tuple[int, ...]], None]


class Stream(Protocol):
    """What arrays are read from: an open file, or a member of an archive."""

    def read(self, size: int = -1, /) -> bytes:
        """Return the next bytes."""

    def readinto(self, room: memoryview, /) -> int | None:
        """Fill as much of `room` as there is and return how much that was."""


def read_array(path: str | Path, *, called: str) -> Numbers:
    """Return the array of a `.npy` file, or the one of that name (or the only one) of an `.npz`.

    Nothing is rounded. Raises ModelError where the file is not a regular file, is damaged, claims
    more than it can hold, or holds something other than real numbers.
    """
    where = str(path)
    with opened(path, most=LARGEST) as file, _named(where):
        begin = file.read(len(NPY))
        size = file.seek(0, 2)
        file.seek(0)
        if begin == NPY:
            return _array(cast(Stream, file), size, where, _real_numbers)
        if not begin.startswith(ZIP):
            raise ModelError("not a readable NumPy array", fix=AGAIN)
        with zipfile.ZipFile(file) as archive:
            members = members_of(archive)
            if len(members) != 1 and called not in members:
                raise ModelError(
                    f"the archive holds {', '.join(members)[:200] or 'nothing'}",
                    fix=f"save one array, or call it {called}",
                )
            name = called if called in members else next(iter(members))
            check_claims([members[name]], size)
            return member_array(archive, members[name], name, _real_numbers)


def read_arrays(
    path: str | Path,
    *,
    names: Callable[[Collection[str]], None],
    check: Check,
    ratio: int = RATIO,
) -> dict[str, Numbers]:
    """Return all arrays of an `.npz` file by name, as `read_array` does.

    `names` takes the names of all arrays, `check` the name, type and shape of each; they raise
    ModelError for what should not be. A compressed archive may claim `ratio` times its own size.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     np.savez(f"{folder}/a.npz", a=np.arange(3))
    ...     read_arrays(f"{folder}/a.npz", names=print, check=lambda *about: None)
    dict_keys(['a'])
    {'a': array([0, 1, 2])}
    """
    where = str(path)
    with opened(path, most=LARGEST) as file, _named(where):
        size = file.seek(0, 2)
        file.seek(0)
        with zipfile.ZipFile(file) as archive:
            members = members_of(archive)
            names(members.keys())
            check_claims(members.values(), size, ratio)
            return {
                name: member_array(archive, member, name, check) for name, member in members.items()
            }


def members_of(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """Return an archive's members by the names of their arrays; raises ModelError for twins."""
    listed = archive.infolist()
    members = {member.filename.removesuffix(".npy"): member for member in listed}
    if len(members) != len(listed):
        twins = [member.filename for member in listed]
        raise ModelError(
            f"the archive holds {', '.join(sorted(twins))[:200]}, one of them twice",
            fix="save it again",
        )
    return members


def check_claims(members: Iterable[zipfile.ZipInfo], size: int, ratio: int = RATIO) -> None:
    """Raise ModelError unless members of an archive of `size` bytes can be what they claim."""
    listed = list(members)
    methods = {member.compress_type for member in listed}
    encrypted = any(member.flag_bits & 1 for member in listed)
    if encrypted or not methods <= {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
        raise ModelError(
            "the archive is encrypted, or compressed in an unusual way", fix="save it again"
        )
    claimed = sum(member.file_size for member in listed)
    if claimed > (size if methods == {zipfile.ZIP_STORED} else max(FREE, ratio * size)):
        raise ModelError(
            f"the archive of {size:,} bytes claims to hold {claimed:,}",
            fix="save it again, uncompressed",
        )


def member_array(
    archive: zipfile.ZipFile, member: zipfile.ZipInfo, name: str, check: Check
) -> Numbers:
    """Return one array of an archive; its checksum is compared on the way."""
    with archive.open(member) as stream:
        return _array(cast(Stream, stream), member.file_size, name, check)


def _array(stream: Stream, size: int, where: str, check: Check) -> Numbers:
    """Return the array of a stream of `size` bytes, after its header has been looked at."""
    head = _Counted(stream)
    shape, fortran, kind = _header(head, where)
    if kind.hasobject:
        raise ModelError(
            "an array of type object, which could run any program when read",
            where=where,
            fix="save numbers alone",
        )
    check(where, kind, shape)
    wanted = head.count + prod(int(length) for length in shape) * kind.itemsize
    if wanted != size:
        raise ModelError(
            f"an array of shape {shape} and type {kind} in {size:,} bytes, not {wanted:,}",
            where=where,
            fix="save it again",
        )
    data = np.empty(prod(shape), dtype=kind)
    room = data.view(np.uint8).data if data.nbytes else memoryview(b"")
    done = 0
    while done < len(room):
        read = stream.readinto(room[done:])
        if not read:
            raise ModelError("the file is cut short", where=where, fix="save it again")
        done += read
    stream.read(1)  # at its end an archive compares the checksum
    array = data.reshape(shape, order="F" if fortran else "C")
    return array.astype(kind.newbyteorder("="), copy=False)


class _Counted:
    """A stream that counts what has been read of it."""

    def __init__(self, stream: Stream) -> None:
        self.stream, self.count = stream, 0

    def read(self, size: int = -1, /) -> bytes:
        data = self.stream.read(size)
        self.count += len(data)
        return data


def _header(stream: _Counted, where: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, order and type that an array's header states."""
    try:
        version = np.lib.format.read_magic(stream)
        if version == (1, 0):
            shape, fortran, kind = np.lib.format.read_array_header_1_0(stream)
        elif version == (2, 0):
            shape, fortran, kind = np.lib.format.read_array_header_2_0(stream)
        else:
            raise ModelError(
                f"array format {version[0]}.{version[1]}", where=where, fix="save it again"
            )
    except ModelError:
        raise
    except Exception as error:  # NumPy raises many kinds; its words advise to trust the file
        raise ModelError(
            "not a readable NumPy array: its header is damaged", where=where, fix="save it again"
        ) from error
    if min(shape, default=0) < 0:
        raise ModelError(f"an array of shape {shape}", where=where, fix="save it again")
    return tuple(int(length) for length in shape), fortran, kind


def _real_numbers(where: str, kind: np.dtype[Any], shape: tuple[int, ...]) -> None:
    if kind.kind not in "fiu":
        raise ModelError(f"an array of type {kind}", where=where, fix="save real numbers")


@contextmanager
def _named(where: str) -> Iterator[None]:
    """Put the file in front of an error's place, and name what damaged archives raise."""
    try:
        yield
    except ModelError as error:
        inside = error.where not in ("", shown_text(where))
        place = f"{where}, {error.where}" if inside else where
        raise ModelError(error.what, where=place, fix=error.fix) from error
    except OSError:
        raise
    except Exception as error:  # zipfile and zlib raise many kinds on damaged archives
        raise ModelError(
            "the file is damaged, or not an archive", where=where, fix="save it again"
        ) from error
