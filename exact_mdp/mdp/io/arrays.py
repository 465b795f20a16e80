"""Arrays of numbers from `.npy` and `.npz` files; Python objects, which could run code, are not."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import BinaryIO

import numpy as np

from exact_mdp.mdp.errors import ModelError, located
from exact_mdp.mdp.io.files import LARGEST, opened
from exact_mdp.mdp.table import Numbers


def read_array(path: str | Path, *, called: str) -> Numbers:
    """Return the array of a `.npy` file, or the one of that name (or the only one) of an `.npz`.

    Nothing is rounded. Raises ModelError where the file is no regular file or damaged, and for
    anything but real numbers.
    """
    with opened(path, most=LARGEST) as file, located(str(path)):
        arrays = _arrays(file, alone=called)
        if len(arrays) != 1 and called not in arrays:
            raise ModelError(
                f"the archive holds {', '.join(arrays)[:200] or 'nothing'}",
                fix=f"save one array, or call it {called}",
            )
        array = arrays[called if called in arrays else next(iter(arrays))]
        if array.dtype.kind not in "fiu":
            raise ModelError(f"an array of type {array.dtype}", fix="save real numbers")
    return array


def read_arrays(source: str | Path | bytes) -> dict[str, Numbers]:
    """Return all arrays of an `.npz` file, or of its bytes, by name, as `read_array` does."""
    if isinstance(source, bytes):
        return _arrays(io.BytesIO(source))
    with opened(source, most=LARGEST) as file, located(str(source)):
        return _arrays(file)


def _arrays(file: BinaryIO, *, alone: str = "") -> dict[str, Numbers]:
    """Return the arrays of an archive, each read whole, so that its checksum is compared.

    `alone` is the name of the array where the file is that one.
    """
    try:
        if alone and not zipfile.is_zipfile(file):
            file.seek(0)
            return {alone: _array(file.read())}
        with zipfile.ZipFile(file) as archive:
            claimed = sum(member.file_size for member in archive.infolist())
            if claimed > LARGEST:
                raise ModelError(
                    f"the archive claims to hold {claimed:,} bytes", fix="save it again"
                )
            names = archive.namelist()
            return {name.removesuffix(".npy"): _array(archive.read(name)) for name in names}
    except (ModelError, OSError):
        raise
    except Exception as error:  # NumPy, zipfile and zlib raise many kinds on damaged files
        raise ModelError(
            "not a readable NumPy array, or an archive of these: damaged, or with Python objects",
            fix="save it again, numbers alone",
        ) from error


def _array(content: bytes) -> Numbers:
    # From a file, older versions of NumPy take a length of -1 for all that follows.
    array = np.load(io.BytesIO(content), allow_pickle=False)
    return np.asarray(array.astype(array.dtype.newbyteorder("="), copy=False))
