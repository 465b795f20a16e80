"""The one door to files: regular files alone, no larger than allowed, and nothing half-written.

What others print is kept from standard output, too, which holds results alone: see `aside`.

A file is opened first and looked at then, so that what was checked is what is read. It is opened
without waiting: a pipe, which has no size and may never end, is refused and not waited for.
"""

from __future__ import annotations

import errno
import io
import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from secrets import token_hex
from typing import BinaryIO

from exact_mdp.mdp.errors import ModelError

STANDARD_INPUT = "-"
PART = 2**20  # bytes of it that are read together
SMALL = 2**24
LARGE = 2**28
LARGEST = 2**32
"""16 MiB for what people write (scenarios, ranges), 256 MiB for policies, recordings and the like,
4 GiB for what this program writes of large models."""
# What the path is not to blame for: a full disk, a quota, too many open files, a failing device.
EXHAUSTED = (
    *(errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO),
    *(errno.EMFILE, errno.ENFILE, errno.ENOMEM),
)

# Waiting for the other end of a pipe, and taking over a terminal, are what opening could do.
FLAGS = os.O_RDONLY | sum(
    getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY")
)

FOLDER, PIPE = "a folder", "a pipe"
INSTEAD = {
    FOLDER: "name a file in it",
    PIPE: "write to a file and name that; a process substitution such as <(…) is a pipe too",
}


@contextmanager
def opened(path: str | Path, *, most: int = LARGE) -> Iterator[BinaryIO]:
    """Open a regular file of at most `most` bytes for reading; raises ModelError for another.

    A path of "-" is standard input.
    """
    if str(path) == STANDARD_INPUT:
        data = bytearray()  # in parts: what is asked for at once is room that is taken at once
        while part := sys.stdin.buffer.read(PART):
            data += part
            if len(data) > most:
                raise _too_large(path, len(data), most)
        yield io.BytesIO(data)
        return
    try:
        handle = os.open(path, FLAGS)
    except (OSError, ValueError) as error:
        raise _refused(path, "read", error) from error
    about = os.fstat(handle)
    if kind := kind_of(about.st_mode):
        os.close(handle)
        what = f"cannot read the file: {kind}, not a regular file"
        fix = INSTEAD.get(kind, "name a regular file")
        raise ModelError(what, where=str(path), fix=fix)
    with os.fdopen(handle, "rb") as file:
        if about.st_size > most:
            raise _too_large(path, about.st_size, most)
        try:
            yield file
        except OSError as error:
            raise _refused(path, "read", error) from error


def kind_of(mode: int) -> str:
    """Return what a file is, from its mode; nothing where it is a regular file."""
    if stat.S_ISREG(mode):
        return ""
    if stat.S_ISDIR(mode):
        return FOLDER
    if stat.S_ISFIFO(mode):
        return PIPE
    return "a socket" if stat.S_ISSOCK(mode) else "a device"


def read_bytes(path: str | Path, *, most: int = LARGE) -> bytes:
    """Return what a regular file of at most `most` bytes holds."""
    with opened(path, most=most) as file:
        # Files that the system makes up as they are read say that their size is 0.
        data = file.read(most + 1)
    if len(data) > most:
        raise _too_large(path, len(data), most)
    return data


def read_text(path: str | Path, *, most: int = LARGE) -> str:
    """Return a UTF-8 file's text; raises ModelError where it cannot be read."""
    try:
        text = read_bytes(path, most=most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ModelError(
            "the file is not UTF-8 text", where=str(path), fix="save it as UTF-8 text"
        ) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _too_large(path: str | Path, size: int, most: int) -> ModelError:
    what = f"the file has {size:,} bytes, more than the {most:,} that are read"
    return ModelError(what, where=str(path), fix="check that it is the right file")


def _refused(path: str | Path, verb: str, error: OSError | ValueError) -> ModelError:
    """Return the error for a path that the system refuses, or that holds a null character."""
    said = getattr(error, "strerror", None) or error
    folder = verb == "write" and isinstance(error, OSError)
    fix = "check the folder" if folder else "check the path"
    return ModelError(f"cannot {verb} the file: {said}", where=str(path), fix=fix)


def write_atomically(path: str | Path, content: str | bytes) -> None:
    """Write a whole file or none: to a temporary file beside it, then one rename.

    Raises ModelError where the path cannot be written to, OSError where the disk is full or the
    system fails in another way.
    """
    target = Path(path)
    data = content.encode("utf-8") if isinstance(content, str) else content
    try:
        kind = kind_of(target.stat().st_mode) if target.exists() else ""
        if not kind:
            temporary = target.with_name(f".{target.name}.{token_hex(8)}")
            try:
                with open(temporary, "xb") as stream:
                    stream.write(data)
                temporary.replace(target)
            except BaseException:
                temporary.unlink(missing_ok=True)  # a signal may come after the rename
                raise
    except (OSError, ValueError) as error:
        if isinstance(error, OSError) and error.errno in EXHAUSTED:
            raise OSError(error.errno, os.strerror(error.errno), str(path)) from error
        raise _refused(path, "write", error) from error
    if kind:  # the rename would put a file in its place
        what = f"cannot write the file: there is {kind} of this name"
        raise ModelError(what, where=str(path), fix="name another file")


@contextmanager
def aside() -> Iterator[None]:
    """Send what is printed, by Python or anything else, to standard error."""
    sys.stdout.flush()
    duplicate = os.dup(1)
    try:
        os.dup2(2, 1)
        with redirect_stdout(sys.stderr):
            yield
    finally:
        if sys.__stdout__ is not None:
            with suppress(OSError, ValueError):
                sys.__stdout__.flush()
        os.dup2(duplicate, 1)
        os.close(duplicate)
