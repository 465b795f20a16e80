"""The one door to files: regular files alone, no larger than allowed, and nothing half-written.

Standard output holds results alone: see `redirect_output` for what others print.
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
PIECE = 2**20
SMALL = 2**24
LARGE = 2**28
LARGEST = 2**32
"""16 MiB for what people write (scenarios, ranges), 256 MiB for policies, recordings and the like,
4 GiB for what this program writes of large models."""

KINDS = {stat.S_IFREG: "", stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe"}


@contextmanager
def open_file(path: str | Path, *, most: int = LARGE) -> Iterator[BinaryIO]:
    """Open a regular file of at most `most` bytes for reading; raises ModelError for another.

    A path of "-" is standard input.
    """
    if str(path) == STANDARD_INPUT:
        pieces = iter(partial(sys.stdin.buffer.read, PIECE), b"")
        content = b"".join(islice(pieces, most // PIECE + 1))
        if len(content) > most:
            raise _size_error(path, most)
        yield io.BytesIO(content)
        return
    if kind := _describe_kind(
        path, "read"
    ):  # looked at first: to open a pipe is to wait for its other end
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
    """Return what a file is; nothing where it is a regular file."""
    try:
        return KINDS.get(stat.S_IFMT(os.stat(path).st_mode), "a device or socket")
    except (OSError, ValueError) as error:
        raise _access_error(path, verb, error) from error


def read_bytes(path: str | Path, *, most: int = LARGE) -> bytes:
    """Return what a regular file of at most `most` bytes holds."""
    with open_file(path, most=most) as file:
        return file.read()


def read_text(path: str | Path, *, most: int = LARGE) -> str:
    """Return a UTF-8 file's text; raises ModelError where it cannot be read."""
    try:
        text = read_bytes(path, most=most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ModelError(
            "the file is not UTF-8 text", where=str(path), fix="save it as UTF-8 text"
        ) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _size_error(path: str | Path, most: int) -> ModelError:
    what = f"the file has more than the {most:,} bytes that are read"
    return ModelError(what, where=str(path), fix="check that it is the right file")


def _access_error(path: str | Path, verb: str, error: OSError | ValueError) -> ModelError:
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
    if kind := os.path.exists(target) and _describe_kind(target, "write"):
        # The rename would put a file in its place.
        what = f"cannot write the file: there is {kind} of this name"
        raise ModelError(what, where=str(path), fix="name another file")
    try:
        temporary = target.with_name(f".{target.name}.{token_hex(8)}")
        temporary.touch(exist_ok=False)
    except (OSError, ValueError) as error:
        raise _access_error(path, "write", error) from error
    try:
        temporary.write_bytes(data)
        temporary.replace(target)
    except BaseException as error:
        temporary.unlink(missing_ok=True)  # a signal may come after the rename
        if isinstance(error, OSError):
            error.filename = str(path)
        raise


@contextmanager
def redirect_output() -> Iterator[None]:
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
