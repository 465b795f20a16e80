"""The files inside a UMB archive: unpacked in memory, within a limit that its size sets.

A UMB file is a tar archive, plain or compressed with gzip, xz or bzip2. It is unpacked here, and
not by umbi: a compressed archive may expand a thousandfold, and the headers of a tar archive may
state any size.
"""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import tarfile
from pathlib import Path
from typing import IO, cast

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import LARGEST, read_bytes

FREE, RATIO = 2**26, 200
"""An archive may unpack to 64 MiB, or to 200 times its own size, whichever is more."""

MOST_FILES = 10_000
LZMA_MEMORY = 2**27

GZIP, XZ, BZIP2 = b"\x1f\x8b", b"\xfd7zXZ\x00", b"BZh"


def files_of(path: str | Path) -> dict[str, bytes]:
    """Return the regular files of an archive by name.

    Raises
    ------
    ModelError
        Where the file cannot be read, is damaged, or unpacks to more than its size allows.
    """
    packed = read_bytes(path, most=LARGEST)
    limit = max(FREE, RATIO * len(packed))
    data = _unpacked(packed, limit)
    found: dict[str, bytes] = {}
    total = 0
    with tarfile.open(fileobj=io.BytesIO(data), mode="r:") as archive:
        for number, member in enumerate(archive):
            total += member.size
            # A sparse file is stored in less than it claims.
            if total > limit or number >= MOST_FILES:
                raise _too_much(limit)
            file = archive.extractfile(member) if member.isfile() else None
            if file is not None:
                found[member.name] = file.read()
    return found


def _unpacked(packed: bytes, limit: int) -> bytes:
    """Return the tar archive in a compressed one of any kind; raises where it is too large."""
    stream = io.BytesIO(packed)
    if packed.startswith(GZIP):
        unpacking = cast(IO[bytes], gzip.GzipFile(fileobj=stream))
    elif packed.startswith(BZIP2):
        unpacking = cast(IO[bytes], bz2.BZ2File(stream))
    elif packed.startswith(XZ):
        return _unpacked_xz(packed, limit)
    else:
        return packed
    with unpacking:
        data = unpacking.read(limit + 1)
    if len(data) > limit:
        raise _too_much(limit)
    return data


def _unpacked_xz(packed: bytes, limit: int) -> bytes:
    """Return the same of xz, whose headers may ask for gigabytes of memory to begin with."""
    decoder = lzma.LZMADecompressor(format=lzma.FORMAT_XZ, memlimit=LZMA_MEMORY)
    data = decoder.decompress(packed, max_length=limit + 1)
    if len(data) > limit:
        raise _too_much(limit)
    if not decoder.eof:
        raise EOFError("the archive is cut short")
    return data


def _too_much(limit: int) -> ModelError:
    return ModelError(
        f"the archive unpacks to over {limit:,} bytes, or {MOST_FILES:,} files",
        fix="use an uncompressed file",
    )
