"""A folder of finished pieces of a long computation: a record of what it is, a file for each piece.

The record is JSON and says everything that the pieces depend on: the model, the settings, the seed.
A folder is used again only by a computation with the same record, so that pieces of two different
ones cannot be mixed. Record and pieces are written whole or not at all.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sized
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.arrays import read_arrays
from exact_mdp.mdp.io.files import read_text, write_atomically
from exact_mdp.mdp.io.structured import json_of
from exact_mdp.mdp.table import Numbers

Arrays = dict[str, Numbers]
DIGEST = "sha256"  # the name of the array that holds the digest of the others

MOST = 1100
"""Times its own size: pieces are compressed as far as they go, and their arrays may be constant."""


def open_folder(
    folder: str | Path, record: Mapping[str, object], *, name: str, what: str = "pieces"
) -> Path:
    """Return the folder, made where it is missing, after checking that it is of this record.

    The record has the JSON values that the pieces depend on, `name` is its file, and `what` says
    in messages what the folder holds.
    """
    folder = Path(folder)
    text = json.dumps(record, indent=2)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ModelError(
            f"cannot make the folder: {error.strerror}", where=str(folder), fix="choose another"
        ) from error
    path = folder / name
    if not path.exists():
        write_atomically(path, text + "\n")
        return folder
    try:
        found = json_of(read_text(path), str(path))
    except ModelError as error:
        raise ModelError(error.what, where=error.where, fix="choose another folder") from error
    wanted = json.loads(text)
    if found != wanted:
        known = found if isinstance(found, dict) else {}
        joined = ", ".join(key for key, value in wanted.items() if known.get(key) != value)
        raise ModelError(
            f"the folder holds {what} whose record differs{f' in {joined}' if joined else ''}",
            where=str(folder),
            fix="choose another folder, or delete this one",
        )
    return folder


def write_piece(path: Path, arrays: Mapping[str, Numbers]) -> None:
    """Write arrays, of no Python objects, as an .npz file; equal arrays give equal bytes.

    A digest of them all is written with them, so that no other content is taken for theirs.
    """
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays, **{DIGEST: _digest(arrays)})
    write_atomically(path, buffer.getvalue())


def read_piece(path: Path) -> Arrays | None:
    """Return the arrays of a piece; None where it is missing, ModelError where it is damaged."""
    if not path.exists():
        return None
    try:
        arrays = read_arrays(path, names=_any, check=_any, ratio=MOST)
        stated = arrays.pop(DIGEST).tobytes()
    except (ModelError, KeyError) as error:
        raise damaged(path) from error
    if stated != _digest(arrays).tobytes():
        raise damaged(path)
    return arrays


def _digest(arrays: Mapping[str, Numbers]) -> Numbers:
    """Return (32,) bytes that differ where names, types, shapes or numbers differ."""
    digest = sha256()
    for name in sorted(arrays):
        array = np.asarray(arrays[name])
        content = array.tobytes()
        head = [name, array.dtype.str, list(array.shape), len(content)]
        digest.update(json.dumps(head).encode() + content)
    return np.frombuffer(digest.digest(), dtype=np.uint8)


@contextmanager
def kept(done: Sized, total: int, what: str, folder: Path | None) -> Iterator[None]:
    """Let an interruption say what is finished: whoever ends the program tells of it."""
    try:
        yield
    except KeyboardInterrupt as stop:
        if folder is not None:
            stop.add_note(
                f"what is finished ({what}: {len(done)} of {total}) is kept in {folder}, "
                "and the same command goes on from there"
            )
        raise


def _any(*_: object) -> None:
    """Let every name and every type pass: who reads a piece knows what it should hold."""


def damaged(path: Path) -> ModelError:
    """Return the error for a piece's file that cannot be used."""
    return ModelError(
        "the file is damaged", where=str(path), fix="delete it: its runs are then done again"
    )
