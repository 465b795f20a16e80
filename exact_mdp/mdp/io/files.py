"""All access to files: only regular files of a limited size are read, and only whole ones written.

Standard output is for results only: `redirect_output` sends the output of libraries elsewhere.
"""

from __future__ import annotations

import io
import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from secrets import token_hex
from typing import BinaryIO

from exact_mdp.mdp.errors import ModelError

STANDARD_INPUT = "-"
# Limits of size in bytes, so that a wrong file cannot fill the memory: 16 MiB for files written by
# hand (scenarios, ranges), 256 MiB for policies and recordings, 4 GiB for files of large models.
SMALL, LARGE, LARGEST = 2**24, 2**28, 2**32
PIECE = 2**20  # bytes that are read at a time

KINDS = {stat.S_IFREG: "", stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe"}


@contextmanager
def open_file(path: str | Path, *, most: int = LARGE) -> Iterator[BinaryIO]:
    """Open a regular file of at most `most` bytes for reading; raise ModelError for any other.

    The path "-" is standard input.
    """
    if str(path) == STANDARD_INPUT:
        pieces = iter(partial(sys.stdin.buffer.read, PIECE), b"")
        content = b"".join(islice(pieces, most // PIECE + 1))
        if len(content) > most:
            raise _size_error(path, most)
        yield io.BytesIO(content)
        return
    # Check before opening: opening a pipe waits for a program at its other end.
    kind = _describe_kind(path, "read")
    if kind:
        raise ModelError(
            f"cannot read the file: {kind}, not a regular file",
            where=str(path),
            fix="name a regular file; a process substitution such as <(…) is a pipe",
        )
    try:
        with open(path, "rb") as file:
            if os.fstat(file.fileno()).st_size > most:
                raise _size_error(path, most)
            yield file
    except OSError as error:
        raise _access_error(path, "read", error) from error


def _describe_kind(path: str | Path, verb: str) -> str:
    """Return the kind of a file in words; "" for a regular file."""
    try:
        return KINDS.get(stat.S_IFMT(os.stat(path).st_mode), "a device or socket")
    except (OSError, ValueError) as error:
        raise _access_error(path, verb, error) from error


def read_bytes(path: str | Path, *, most: int = LARGE) -> bytes:
    """Return the content of a regular file of at most `most` bytes."""
    with open_file(path, most=most) as file:
        return file.read()


def read_text(path: str | Path, *, most: int = LARGE) -> str:
    """Return the text of a UTF-8 file with line feeds as line ends; ModelError if unreadable."""
    try:
        text = read_bytes(path, most=most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ModelError(
            "the file is not UTF-8 text", where=str(path), fix="save it as UTF-8 text"
        ) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _size_error(path: str | Path, most: int) -> ModelError:
    """Return the error for a file that is too large."""
    what = f"the file has more than the {most:,} bytes that are read"
    return ModelError(what, where=str(path), fix="check that it is the right file")


def _access_error(path: str | Path, verb: str, error: OSError | ValueError) -> ModelError:
    """Return the error for a path that the system refuses, or that contains a null character."""
    said = getattr(error, "strerror", None) or error
    fix = "check the path"
    if verb == "write" and isinstance(error, OSError):
        fix = "check the folder"
    return ModelError(f"cannot {verb} the file: {said}", where=str(path), fix=fix)


def write_atomically(path: str | Path, content: str | bytes) -> None:
    """Write a file completely or not at all: a temporary file in the same folder, then a rename.

    Raises ModelError if the path cannot be written to, and OSError if the disk is full or the
    system fails in another way.
    """
    target = Path(path)
    if isinstance(content, str):
        content = content.encode("utf-8")
    # The rename would replace a folder or a device by a file.
    kind = ""
    if os.path.exists(target):
        kind = _describe_kind(target, "write")
    if kind:
        what = f"cannot write the file: there is {kind} of this name"
        raise ModelError(what, where=str(path), fix="name another file")
    try:
        temporary = target.with_name(f".{target.name}.{token_hex(8)}")
        temporary.touch(exist_ok=False)
    except (OSError, ValueError) as error:
        raise _access_error(path, "write", error) from error
    try:
        temporary.write_bytes(content)
        temporary.replace(target)
    except BaseException as error:
        temporary.unlink(missing_ok=True)  # after a signal the rename may be done already
        if isinstance(error, OSError):
            error.filename = str(path)
        raise


@contextmanager
def redirect_output() -> Iterator[None]:
    """Send everything that is printed, by Python or any library, to standard error."""
    # Libraries in C write to file descriptor 1, and Python to sys.stdout: redirect both.
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
