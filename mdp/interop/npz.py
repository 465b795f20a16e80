"""Models saved as NumPy archives, without loss, and read by any program that reads `.npz`.

The arrays of an archive, nothing in it being a pickle:

    header        (B,) uint8     UTF-8 text of a JSON object, see below
    pair_state    (L,) int64     state of each state-action pair, sorted by state, then action
    pair_action   (L,) int64     its action
    offsets       (L+1,) int64   outcomes of pair l are offsets[l] … offsets[l+1]-1
    next          (N,) int32 or int64   next state of each outcome
    weight        (N,) integers or float64   probability of outcome i of pair l is
    denominator   (L,) integers              weight[i] / denominator[l]
    gain          (N,) or (L,) integers or float64   reward of an outcome, or of a pair, is
    gain_denominator (L,) integers                   gain[i] / gain_denominator[l]
    event         (N,) uint8     optional: bit b is set where event number b happens
    components    (L, C) float64 expected reward of each pair by component

Integers are int64 where they fit. Where they do not, the array is uint8 of shape (…, k): each row
is one integer of k ≥ 8 bytes, little-endian, two's complement. The header has the keys `format`
("exact-mdp model"), `version` (1), `name`, `discount` ("p/q"), `start` ([[state, "p/q"], …]),
`actions`, `columns` ([{"name", "size", "bits", "words"}, …]: a state's number is that of its column
values in row-major order), `extra` (names of the states after those), `component_names`, `events`
`parameters` ([{"name", "value", "low", "high"}, …], low and high may be null) and `time_limit` (a
number of steps or null; older files lack it).

`np.load(path)["pair_state"]` and so on read the arrays, `json.loads` reads the bytes of the header.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from math import prod
from pathlib import Path

import numpy as np

from mdp.errors import ModelError
from mdp.files import write_atomically
from mdp.interop.npz_header import as_header, parts_of
from mdp.model import MDP
from mdp.table import Numbers, OutcomeTable

INTEGERS = ("weight", "denominator", "gain", "gain_denominator")
KINDS: Mapping[str, tuple[str, ...]] = {
    "header": ("uint8",),
    "pair_state": ("int64",),
    "pair_action": ("int64",),
    "offsets": ("int64",),
    "next": ("int32", "int64"),
    "weight": ("int64", "float64", "uint8"),
    "denominator": ("int64", "uint8"),
    "gain": ("int64", "float64", "uint8"),
    "gain_denominator": ("int64", "uint8"),
    "event": ("uint8",),
    "components": ("float64",),
}
"""Every array with the types it may have; uint8 among several means rows of bytes."""

OPTIONAL = ("event",)
WIDTH = 8
SMALL, RATIO = 2**26, 50
"""A compressed archive may claim up to 64 MiB, or 50 times its own size, whichever is more."""


def save(mdp: MDP, path: str | Path) -> None:
    """Write a model to `path`, whole or not at all.

    Raises
    ------
    ModelError
        Where the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> mdp = MDP.from_outcomes([(0, 0, [("1/3", 0, "1/7"), ("2/3", 1, 0)]), (1, 0, [(1, 1, 0)])])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save(mdp, f"{folder}/small.npz")
    ...     load(f"{folder}/small.npz").table.row(0)
    [(Fraction(1, 3), 0, Fraction(1, 7)), (Fraction(2, 3), 1, Fraction(0, 1))]
    """
    table = mdp.table
    text = json.dumps(as_header(mdp)).encode("ascii")
    arrays: dict[str, Numbers] = {
        "header": np.frombuffer(text, dtype=np.uint8),
        "pair_state": mdp.pair_state,
        "pair_action": mdp.pair_action,
        "offsets": table.offsets,
        "next": table.next,
        "components": mdp.components,
    }
    arrays |= {name: _as_bytes(getattr(table, name)) for name in INTEGERS}
    if table.event is not None:
        arrays["event"] = table.event
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **arrays)
    write_atomically(path, stream.getvalue())


def load(path: str | Path) -> MDP:
    """Read a model that `save` wrote.

    Raises
    ------
    ModelError
        Where the file cannot be read, is damaged, claims more data than it holds, or does not
        hold a valid model.
    """
    where = str(path)
    try:
        arrays = _arrays(path)
        parts = parts_of(_header(arrays.pop("header")), pairs=len(arrays["pair_state"]))
        numbers = {name: _as_integers(arrays.pop(name)) for name in INTEGERS}
        table = OutcomeTable(
            offsets=arrays["offsets"], next=arrays["next"], event=arrays.get("event"), **numbers
        )
        state, action = arrays["pair_state"], arrays["pair_action"]
        return MDP(table, state, action, components=arrays["components"], **parts)
    except ModelError as error:
        place = f"{where}, {error.where}" if error.where else where
        raise ModelError(error.what, where=place, fix=error.fix) from error
    except OSError as error:
        raise ModelError(
            f"cannot read the file: {error.strerror or error}", where=where, fix="check the path"
        ) from error


def _header(data: Numbers) -> object:
    try:
        return json.loads(data.tobytes().decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise ModelError(
            f"broken JSON: {str(error)[:200]}", where="header", fix="save the model again"
        ) from error


def _arrays(path: str | Path) -> dict[str, Numbers]:
    """Return the arrays of an archive, after its claims have been compared with its size."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = {m.filename.removesuffix(".npy"): m for m in archive.infolist()}
            _check_members(archive, members, Path(path).stat().st_size)
            return {name: _array(archive, member, name) for name, member in members.items()}
    except (ModelError, OSError):
        raise
    except Exception as error:  # zipfile and NumPy raise many kinds on damaged archives
        raise ModelError(
            f"the file is damaged or no archive: {str(error)[:200]}", fix="save the model again"
        ) from error


def _check_members(
    archive: zipfile.ZipFile, members: Mapping[str, zipfile.ZipInfo], size: int
) -> None:
    """Raise ModelError unless an archive of `size` bytes holds the arrays of a model, plainly."""
    needed = {name for name in KINDS if name not in OPTIONAL}
    if len(members) != len(archive.infolist()) or not needed <= members.keys() <= KINDS.keys():
        raise ModelError(
            f"the archive holds {', '.join(members)[:200] or 'nothing'}",
            fix="give a model that exact-mdp wrote; a Q-table is a policy, not a model",
        )
    methods = {member.compress_type for member in members.values()}
    encrypted = any(member.flag_bits & 1 for member in members.values())
    if encrypted or not methods <= {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
        raise ModelError(
            "the archive is encrypted, or compressed in an unusual way", fix="save the model again"
        )
    claimed = sum(member.file_size for member in members.values())
    if claimed > (size if methods == {zipfile.ZIP_STORED} else max(SMALL, RATIO * size)):
        raise ModelError(
            f"the archive of {size:,} bytes claims to hold {claimed:,}",
            fix="save the model again, uncompressed",
        )


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, name: str) -> Numbers:
    _check_claim(archive, member, name)
    with archive.open(member) as stream:
        array: Numbers = np.lib.format.read_array(stream, allow_pickle=False)
        # Reading on to the end makes zipfile compare the checksum.
        if stream.read(1):
            raise ModelError("data after the array", where=name, fix="save the model again")
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def _check_claim(archive: zipfile.ZipFile, member: zipfile.ZipInfo, name: str) -> None:
    """Raise ModelError unless an array's header agrees with its size, before memory is taken."""
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        if version == (1, 0):
            shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
        elif version == (2, 0):
            shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
        else:
            raise ModelError(
                f"array format {version[0]}.{version[1]}", where=name, fix="save the model again"
            )
        start = stream.tell()
    kinds, kind = KINDS[name], str(dtype.newbyteorder("="))
    bytewise = kind == "uint8" and len(kinds) > 1
    dimensions = 2 if bytewise or name == "components" else 1
    if (
        kind not in kinds
        or len(shape) != dimensions
        or min(shape) < 1
        or (bytewise and shape[1] < WIDTH)
    ):
        raise ModelError(
            f"an array of type {dtype} and shape {shape}",
            where=name,
            fix=f"give {' or '.join(kinds)}, as the format says",
        )
    if start + prod(int(length) for length in shape) * dtype.itemsize != member.file_size:
        raise ModelError(
            f"an array of shape {shape} in {member.file_size:,} bytes",
            where=name,
            fix="save the model again",
        )


def _as_bytes(array: Numbers) -> Numbers:
    """Return Python integers as rows of bytes; other arrays as they are."""
    if array.dtype != object:
        return array
    values = [int(value) for value in array]
    width = max([WIDTH, *(value.bit_length() // 8 + 1 for value in values)])
    data = b"".join(value.to_bytes(width, "little", signed=True) for value in values)
    return np.frombuffer(data, dtype=np.uint8).reshape(len(values), width)


def _as_integers(array: Numbers) -> Numbers:
    """Return rows of bytes as Python integers; other arrays as they are."""
    if array.dtype != np.uint8:
        return array
    values = [int.from_bytes(row.tobytes(), "little", signed=True) for row in array]
    wide = np.empty(len(values), dtype=object)
    wide[:] = values
    return wide
