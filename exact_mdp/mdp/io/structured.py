"""Reading TOML, JSON, CSV and arrays within limits, and checking JSON against a required shape.

Integers of more than 4,000 digits, tables nested more than 100 deep and syntax errors are refused:
Python does not convert integers of more than 4,300 digits to text, and stops a recursion after
about a thousand calls. Arrays are read from `.npy` files and from `.npz` archives.
"""

from __future__ import annotations

import csv
import io
import json
import re
import tomllib
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import numpy as np

from exact_mdp.mdp.errors import ModelError, locate_errors, once_each, shorten_text
from exact_mdp.mdp.io.files import LARGE, LARGEST, PIECE, open_file
from exact_mdp.mdp.table import MOST_DIGITS, Numbers, exact

WORDS = {dict: "an object", list: "a list", str: "a text", bool: "true or false"}


def toml_of(text: str, where: str, *, number: Callable[[str], Any] = exact) -> dict[str, Any]:
    r"""Return the content of a TOML text from the file `where`, with exact decimals."""
    content: dict[str, Any] = _parse_text(
        partial(tomllib.loads, parse_float=number), text, "TOML", where
    )
    return content


TOO_LONG = 10**MOST_DIGITS  # the least integer with more digits


def json_of(text: str | bytes, where: str, **hooks: Any) -> Any:
    """Return the content of a JSON text; refuse repeated keys. `hooks` are for `json.loads`."""
    read = partial(json.loads, object_pairs_hook=once_each, **hooks)
    return _parse_text(read, text, "JSON", where)


def _parse_text(read: Callable[[Any], Any], text: str | bytes, kind: str, where: str) -> Any:
    """Parse a text with the function `read`; turn its errors into ModelErrors."""
    try:
        with locate_errors(where, instead=True):
            content = read(text)
        _check_limits(content, 100)  # no valid file is nested more than five deep
    except ModelError:
        raise
    except RecursionError as error:
        what = "tables or lists are nested more than 100 deep"
        raise ModelError(what, where=where, fix="use fewer levels") from error
    except ValueError as error:
        what = shorten_text(str(error), 200)
        if "string conversion" in str(error):
            what = f"an integer of over {MOST_DIGITS:,} digits"
        fix = "correct that place"
        if (where, kind) == ("-", "JSON"):
            fix = "standard input (-) takes JSON, such as a model.json: name other files instead"
        raise ModelError(f"broken {kind}: {what}", where=where, fix=fix) from error
    return content


def _check_limits(content: Any, levels: int) -> None:
    """Raise RecursionError for more than `levels` levels, ValueError for too many digits."""
    if isinstance(content, dict):
        content = list(content.values())
    if isinstance(content, list):
        if not levels:
            raise RecursionError
        for each in content:
            _check_limits(each, levels - 1)
    elif isinstance(content, int) and abs(content) >= TOO_LONG:
        raise ValueError("string conversion")


def find_separator(line: str) -> str:
    """Return the sign between the values of a line: a comma, else a tab, a semicolon, a space."""
    plain = re.sub(r'"[^"]*"|\([^()]*\)', "", line)  # names may be quoted, or tuples
    return next((sign for sign in ",\t;" if sign in plain), " ")


def csv_of(
    lines: Iterable[str], where: str = "", *, fix: str = "correct the line"
) -> Iterator[tuple[int, list[str]]]:
    """Yield (line, values) for each row of a CSV text that is not blank; the first is the header.

    Values are separated as in the first line. Raises ModelError, with `fix`, if a row does not have
    as many values as the header.
    """
    lines, head = iter(lines), [""]
    for text in lines:
        head.append(text)
        if text.strip():
            break
    every = chain(head[1:], lines)
    separator = find_separator(head[-1]).replace(" ", ",")
    reader = csv.reader(every, delimiter=separator, strict=True)
    line = width = 0
    begin = ""
    if where:
        begin = f"{where}, "
    try:
        for row in reader:
            if row:
                width = width or len(row)
                if len(row) != width:
                    what = f"{len(row)} values under {width} headings"
                    raise ModelError(what, where=f"{begin}line {line + 1}", fix=fix)
                yield line + 1, row
            line = reader.line_num
    except csv.Error as error:
        place = f"{begin}line {reader.line_num}"
        raise ModelError(f"broken CSV: {error}", where=place, fix="correct that line") from error


def require_column_names(names: Sequence[str], where: str) -> None:
    """Raise ModelError for a column of a table without a name, or two of one name."""
    if "" in map(str.strip, names):
        fix = "name it, or leave it out, such as the index that pandas writes"
        raise ModelError("a column has no name", where=where, fix=fix)
    if len({*names}) < len(names):
        raise ModelError("two columns have one name", where=where, fix="rename one of them")


# ---- the required shape of JSON ------------------------------------------------------------------


def require_shape(given: Any, kind: Any) -> Any:
    """Return JSON in the shape of `kind`; raise ModelError with the place that differs.

    A kind is a type; a function of the value; [kind], a list; (kind, …), a list of that length;
    {str: kind}, an object with any keys; or {key: kind, …}, an object with these keys, in which a
    missing key is read as null and other keys are ignored. Lists become tuples.
    """
    if isinstance(kind, type):
        if type(given) is not kind:
            refuse_value(given, WORDS[kind])
        return given
    if callable(kind):
        return kind(given)
    # Objects.
    if isinstance(kind, dict):
        if type(given) is not dict:
            refuse_value(given, WORDS[dict])
        kinds = kind
        if str in kind:
            kinds = dict.fromkeys(given, kind[str])
        return {key: _require_shape_at(key, given.get(key), each) for key, each in kinds.items()}
    # Lists, of a fixed length or of any length.
    if isinstance(kind, tuple):
        if type(given) is not list or len(given) != len(kind):
            refuse_value(given, f"a list of {len(kind)}")
        listed = list(kind)
    else:
        if type(given) is not list:
            refuse_value(given, WORDS[list])
        listed = kind * len(given)
    return tuple(map(_require_shape_at, range(len(given)), given, listed))


def _require_shape_at(place: str | int, given: Any, kind: Any) -> Any:
    """Return JSON in the shape of `kind`; add the place to the error otherwise."""
    try:
        return require_shape(given, kind)
    except ModelError as error:
        where = str(place)
        if error.where:
            where = f"{place}, {error.where}"
        raise ModelError(error.what, where=where, fix=error.fix) from error


def or_null(kind: Any) -> Callable[[Any], Any]:
    """Return a kind that also allows null."""

    def require_shape_or_null(given: Any) -> Any:
        if given is None:
            return None
        return require_shape(given, kind)

    return require_shape_or_null


def refuse_value(given: object, wanted: str) -> NoReturn:
    """Raise the ModelError "… is not …" for a value of another kind than wanted."""
    raise ModelError(f"{shorten_text(repr(given), 80)} is not {wanted}", fix="correct it")


# ---- arrays --------------------------------------------------------------------------------------


def most_unpacked(packed: int) -> int:
    """Return the number of bytes to which an archive of `packed` bytes may unpack.

    It is 64 times its own size, or 256 MiB: enough for any real model, and little enough that a
    small hostile file cannot fill the memory.
    """
    return min(LARGEST, max(LARGE, 64 * packed))


def refuse_size(size: int, most: int, *, table: bool = False) -> None:
    """Raise ModelError for more than `most` bytes; `table` is True for the table of a policy."""
    if size <= most:
        return
    fix = "check that it is the right file, or save it again without compression"
    if table:
        fix = "check that it is the right file: a policy has a number for each state and action"
    what = f"the data unpacks to {size:,} bytes, more than the {most:,} that are read"
    raise ModelError(what, fix=fix)


def unpacked_size(stream: Any, most: int) -> int:
    """Return the unpacked size of a compressed stream; stop with an error beyond `most` bytes."""
    size = 0
    for piece in iter(partial(stream.read, PIECE), b""):
        size += len(piece)
        refuse_size(size, most)
    return size


def read_array(
    path: str | Path, name: str | None = None, *, called: str, most: int = LARGE
) -> Numbers:
    """Return the array of a `.npy` file, or an array of an `.npz` file.

    It is the array `name`; without a name the array `called`, or the only one. Nothing is rounded.
    Raises ModelError for a file that is damaged or not a regular file, for anything but real
    numbers, and for more than `most` bytes, before they are read.
    """
    with open_file(path, most=LARGEST) as file, locate_errors(str(path)):
        alone = name or called
        array = _read_archive(file, alone=alone, exactly=name is not None, most=most)[alone]
        if array.dtype.kind not in "fiu":
            raise ModelError(f"an array of type {array.dtype}", fix="save real numbers")
    return array


def read_arrays(source: str | Path | bytes) -> dict[str, Numbers]:
    """Return all arrays of an `.npz` file, or of its bytes, by name."""
    if isinstance(source, bytes):
        return _read_archive(io.BytesIO(source), most=most_unpacked(len(source)))
    with open_file(source, most=LARGEST) as file, locate_errors(str(source)):
        return _read_archive(file, most=most_unpacked(file.seek(0, io.SEEK_END)))


def _read_archive(
    file: BinaryIO, *, most: int, alone: str = "", exactly: bool = False
) -> dict[str, Numbers]:
    """Return the arrays of an archive; each is read completely, so that its checksum is compared.

    With `alone`, return a single array under that name: the array of a `.npy` file, or the array of
    that name in an archive, or the only array of the archive unless it has to have `exactly` that
    name.
    """
    try:
        # A file that is not an archive is one array.
        if alone and not zipfile.is_zipfile(file):
            refuse_size(file.seek(0, io.SEEK_END), most, table=True)
            file.seek(0)
            return {alone: _parse_npy(file.read())}
        with zipfile.ZipFile(file) as archive:
            members = {each.filename.removesuffix(".npy"): each for each in archive.infolist()}
            if alone and alone not in members and (exactly or len(members) != 1):
                raise ModelError(
                    f"the archive holds {', '.join(members)[:200] or 'nothing'}",
                    fix=f"say which: {file.name}#{next(iter(members), 'NAME')}",
                )
            if alone:
                members = {alone: members.get(alone, next(iter(members.values())))}
            size = sum(each.file_size for each in members.values())
            refuse_size(size, most, table=bool(alone))
            arrays = {}
            for name, each in members.items():
                # In pieces, so that it cannot exceed its stated size.
                with archive.open(each) as member:
                    arrays[name] = _parse_npy(b"".join(iter(partial(member.read, PIECE), b"")))
            return arrays
    except (ModelError, OSError):
        raise
    except Exception as error:  # NumPy, zipfile and zlib raise many kinds on damaged files
        raise ModelError(
            "not a readable NumPy array, or an archive of these: damaged, or with Python objects",
            fix="save it again, with numbers only",
        ) from error


def _parse_npy(content: bytes) -> Numbers:
    """Return the array of a `.npy` file in the machine's byte order."""
    # From a file, older versions of NumPy would read a length of -1 as everything that follows.
    array = np.load(io.BytesIO(content), allow_pickle=False)
    return np.asarray(array.astype(array.dtype.newbyteorder("="), copy=False))
