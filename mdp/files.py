"""Reading and writing files so that nothing is left half-written and every failure is named."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from mdp.errors import ModelError


def read_text(path: str | Path) -> str:
    """Return a UTF-8 file's text; raises ModelError where it cannot be read."""
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ModelError(
            f"cannot read the file: {error.strerror}", where=str(path), fix="check the path"
        ) from error
    except UnicodeDecodeError as error:
        raise ModelError(
            "the file is not UTF-8 text", where=str(path), fix="save it as UTF-8 text"
        ) from error
    except ValueError as error:  # a null character in the name
        raise ModelError(
            f"cannot read the file: {error}", where=repr(str(path)), fix="check the path"
        ) from error


def write_atomically(path: str | Path, content: str | bytes) -> None:
    """Write a whole file or none: to a temporary file beside it, then one rename."""
    target = Path(path)
    data = content.encode("utf-8") if isinstance(content, str) else content
    try:
        handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
            os.chmod(temporary, 0o666 & ~_umask())
            os.replace(temporary, target)
        except BaseException:
            os.unlink(temporary)
            raise
    except OSError as error:
        raise ModelError(
            f"cannot write the file: {error.strerror}", where=str(path), fix="check the folder"
        ) from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
