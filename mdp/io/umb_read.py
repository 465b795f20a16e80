"""What a UMB file says, as arrays, after every length and range has been checked.

The index says what the other files hold (`mdp.io.umb_index`). Numbers are decoded here, all of a
file at once: a rational is two integers of the same width, a signed numerator and an unsigned
denominator, little-endian; truth values are bits, the lowest of each byte first; variables of a
state are packed bit by bit. A UMB file is a tar archive, plain or compressed with gzip, xz or
bzip2. It is unpacked within a limit that its size sets: a compressed archive may expand a
thousandfold, and the headers of a tar archive may state any size.
"""

from __future__ import annotations

import bz2
import gzip
import io
import json
import lzma
import tarfile
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.explicit import Explicit, Ratios, actions_of
from exact_mdp.mdp.io.files import LARGEST, read_bytes
from exact_mdp.mdp.io.own import CARRIER, GROUP
from exact_mdp.mdp.io.umb_index import (
    TRUTH,
    WORD32,
    WORD64,
    Annotation,
    Index,
    Kind,
    System,
    index_of,
)
from exact_mdp.mdp.table import EXACT_IN_INT64, Integers, Numbers, ones
from exact_mdp.mdp.validate import Flags

FREE, RATIO = 2**26, 200
"""An archive may unpack to 64 MiB, or to 200 times its own size, whichever is more."""

MOST_FILES = 10_000
WORD = 8
LZMA_MEMORY = 2**27
LARGEST_INDEX = 2**26
ANY_SIZE = 10**6
"""Numbers of states, choices, branches and actions that need no data in the file to be believed."""


def _damaged(what: str, where: str) -> ModelError:
    return ModelError(what, where=where, fix="write the file again")


# ---- the archive ---------------------------------------------------------------------------------


def files_of(path: str | Path) -> dict[str, bytes]:
    """Return the regular files of an archive by name; raises ModelError for one too large."""
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
    if packed.startswith(b"\xfd7zXZ\x00"):
        # Headers of xz may ask for gigabytes of memory to begin with.
        decoder = lzma.LZMADecompressor(format=lzma.FORMAT_XZ, memlimit=LZMA_MEMORY)
        data = decoder.decompress(packed, max_length=limit + 1)
        if len(data) <= limit and not decoder.eof:
            raise EOFError("the archive is cut short")
    elif packed.startswith((b"\x1f\x8b", b"BZh")):
        opened = gzip.GzipFile(fileobj=stream) if packed[0] == 0x1F else bz2.BZ2File(stream)
        with cast(IO[bytes], opened) as unpacking:
            data = unpacking.read(limit + 1)
    else:
        return packed
    if len(data) > limit:
        raise _too_much(limit)
    return data


def _too_much(limit: int) -> ModelError:
    return ModelError(
        f"the archive unpacks to over {limit:,} bytes, or {MOST_FILES:,} files",
        fix="use an uncompressed file",
    )


# ---- numbers -------------------------------------------------------------------------------------


def _integers(data: bytes, count: int, size: int, *, signed: bool) -> Numbers:
    """Return `count` little-endian integers of `size` bytes each; 64 bits where they fit."""
    if size == WORD:
        values = np.frombuffer(data, "<i8" if signed else "<u8")
        if not len(values) or (values.max() < EXACT_IN_INT64 and values.min() > -EXACT_IN_INT64):
            return values.astype(np.int64)
    found = np.empty(count, dtype=object)
    order: Any = "little"
    found[:] = [
        int.from_bytes(data[size * k : size * (k + 1)], order, signed=signed) for k in range(count)
    ]
    return found if size >= WORD else found.astype(np.int64)


def _numbers(data: bytes, count: int, kind: Kind, where: str) -> Ratios:
    """Return the numbers of a file, whose length is known to be right."""
    size = kind.bits // 8
    if kind.type == "double":
        return Ratios(np.frombuffer(data, "<f8").astype(np.float64), ones(count))
    if kind.type in ("int", "uint") and kind.bits % 8 == 0:
        return Ratios(_integers(data, count, size, signed=kind.type == "int"), ones(count))
    if kind.type != "rational" or kind.bits % 16:
        raise ModelError(
            f"{kind.type} is not a single number",
            where=where,
            fix="give a model without intervals or parameters",
        )
    half = size // 2
    halves = np.frombuffer(data, np.uint8).reshape(2 * count, half)
    top = _integers(halves[::2].tobytes(), count, half, signed=True)
    bottom = _integers(halves[1::2].tobytes(), count, half, signed=False)
    if np.asarray(bottom == 0).any():
        raise _damaged("the file is damaged: a denominator is 0", where)
    shared = np.gcd(top, bottom)
    return Ratios(np.asarray(top // shared), np.asarray(bottom // shared))


def _flags(data: bytes, count: int) -> Flags:
    """Return truth values, one bit each."""
    bits = np.frombuffer(data, np.uint8)
    return np.asarray(np.unpackbits(bits, count=count, bitorder="little") == 1)


# ---- its content ---------------------------------------------------------------------------------


def read(path: str | Path) -> Explicit:
    """Return what a file says of the model; raises ModelError."""
    try:
        files = files_of(path)
        if len(files.get("index.json", b"")) > LARGEST_INDEX:
            raise ModelError("the index is too large", where="index.json", fix="check the file")
        index = index_of(files["index.json"])
        _check_kind(index.system, files)
        _check_files(index.system, files)
        return _content(index, files)
    except ModelError:
        raise
    except OSError as error:
        raise ModelError(
            f"cannot read the file: {error.strerror or error}", fix="check the path"
        ) from error
    except Exception as error:  # tarfile, JSON and the decompressors raise many kinds
        raise ModelError(
            f"the file is damaged, or not a UMB file: {str(error)[:200]}",
            fix="write the file again",
        ) from error


def _content(index: Index, files: Mapping[str, bytes]) -> Explicit:
    system, listed = index.system, index.annotations
    states, choices, branches = _sizes(system).values()
    state_to_choices = _offsets(files, "state-to-choices", states, choices)
    ends = files.get("branch-to-target.bin", bytes(WORD * branches))
    target = _integers(ends, branches, WORD, signed=False)
    if branches and target.max() >= states:
        raise _damaged(f"a branch leads to state {target.max()} of {states}", "branch-to-target")
    chances = Ratios(np.ones(branches, np.int64), ones(branches))
    if system.probability is not None:
        where = "branch-to-probability"
        chances = _numbers(files[f"{where}.bin"], branches, system.probability, where)
    actions, names, words = _actions(system, files, state_to_choices)
    initial = np.zeros(states, dtype=bool)
    if system.initial:
        initial = _flags(files["state-is-initial.bin"], states)

    def annotations(group: str) -> dict[str, dict[str, Any]]:
        found = {
            key: _annotation(files, system, group, key, about)
            for key, about in listed.get(group, {}).items()
        }
        return {key: values for key, values in found.items() if values}

    own = annotations(GROUP)
    return Explicit(
        name=index.name,
        state_to_choices=state_to_choices,
        choice_to_branches=_offsets(files, "choice-to-branches", choices, branches),
        target=target.astype(np.int64),
        probability=chances,
        actions=actions,
        action_names=names,
        listed_actions=words,
        initial=initial,
        words=_valuations(index, files, states),
        rewards=annotations("rewards"),
        labels={k: v["states"] for k, v in annotations("aps").items() if "states" in v},
        titles={
            group: {key: about.alias or key for key, about in listed.get(group, {}).items()}
            for group in ("rewards", "aps")
        },
        own={key: next(iter(values.values())) for key, values in own.items()},
        header=_header(listed.get(GROUP, {})),
    )


def _annotation(
    files: Mapping[str, bytes], system: System, group: str, key: str, about: Annotation
) -> dict[str, Any]:
    """Return the values of an annotation by what it applies to; nothing where it holds texts."""
    found: dict[str, Any] = {}
    for over in about.over:
        path = f"annotations/{group}/{key}/{over}/values.bin"
        count = _sizes(system)[over]
        if about.kind.type == "string":
            continue
        _check_size(files, path, count, about.kind)
        data = files[path]
        truth = about.kind == TRUTH
        found[over] = _flags(data, count) if truth else _numbers(data, count, about.kind, path)
    return found


def _valuations(index: Index, files: Mapping[str, bytes], states: int) -> tuple[str, ...]:
    """Return each state's variables as words, where they are whole numbers that tell states apart.

    Other files of valuations are passed over: states have their numbers.
    """
    data = files.get("valuations/states/valuations.bin")
    if data is None or not index.variables:
        return ()
    if len(data) != states * -(-sum(field.bits for field in index.variables) // 8):
        return ()
    bits = np.unpackbits(
        np.frombuffer(data, np.uint8).reshape(states, -1), axis=1, bitorder="little"
    )
    columns, place = [], 0
    for field in index.variables:
        here = bits[:, place : place + field.bits]
        place += field.bits
        if field.kind is None:
            continue
        kind = field.kind.type
        truth, whole = kind == "bool", kind in ("int", "uint") and field.bits <= 63
        if field.optional or not (truth or whole):
            return ()
        value = here @ (1 << np.arange(field.bits, dtype=np.int64))
        if kind == "int":
            value -= here[:, -1].astype(np.int64) << field.bits
        shown = np.where(value == 1, "true", "false") if truth else value.astype(str)
        columns.append([f"{field.name}={each}" for each in shown.tolist()])
    words = tuple(map(", ".join, zip(*columns, strict=True)))
    return words if len(set(words)) == states else ()


def _header(own: Mapping[str, Annotation]) -> Mapping[str, Any] | None:
    """Return what exact-mdp wrote of a model besides its numbers; None in files of others."""
    text = own[CARRIER].description if CARRIER in own else ""
    if not text:
        return None
    place = f"annotations/{GROUP}/{CARRIER}"
    try:
        header = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ModelError("its description is not JSON", where=place, fix="save it again") from error
    if not isinstance(header, dict):
        raise ModelError("its description is not a JSON object", where=place, fix="save it again")
    return header


def _sizes(system: System) -> dict[str, int]:
    return {"states": system.states, "choices": system.choices, "branches": system.branches}


def _check_files(system: System, files: Mapping[str, bytes]) -> None:
    """Raise ModelError unless the model's files have the sizes that its index gives them."""
    states, choices, branches = _sizes(system).values()
    for name, count, kind in (
        ("state-is-initial.bin", states, TRUTH),
        ("state-to-choices.bin", states + 1, WORD64),
        ("state-to-player.bin", states, WORD32),
        ("choice-to-branches.bin", choices + 1, WORD64),
        ("branch-to-target.bin", branches, WORD64),
        ("branch-to-probability.bin", branches, system.probability),
        ("actions/choices/values.bin", choices, WORD32),
        ("actions/choices/string-mapping.bin", system.actions + 1, WORD64),
    ):
        _check_size(files, name, count, kind)
    ends = np.frombuffer(files.get("actions/choices/string-mapping.bin", b""), "<u8")
    if (ends[1:] < ends[:-1]).any():  # ranges that overlap would make much text of little
        raise _damaged("the ranges of the names fall", "actions")


def _check_size(files: Mapping[str, bytes], name: str, count: int, kind: Kind | None) -> None:
    """Raise ModelError where a file has not the size of `count` values of a type."""
    data = files.get(name)
    if data is None or kind is None:
        return
    if kind == TRUTH:
        good = -(-count // 8) <= len(data) <= 8 * -(-count // 64)
    else:
        good = len(data) * 8 == count * kind.bits
    if not good:
        raise _damaged(f"a file of {len(data):,} bytes for {count:,} values", name)


def _check_kind(system: System, files: Mapping[str, bytes]) -> None:
    """Raise ModelError unless this is a chain or an MDP, no larger than its file."""
    kinds = {
        f"time is {system.time}": system.time != "discrete",
        f"{system.players} players": system.players > 1,
        f"{system.observations} observations": system.observations > 0,
    }
    for what, wrong in kinds.items():
        if wrong:
            raise ModelError(
                f"the model is neither an MDP nor a Markov chain: {what}",
                where="index.json",
                fix="give a model in discrete time, of one player, fully observable",
            )
    # A state, choice or branch takes at least eight bytes where there are many of them.
    core = sum(len(data) for name, data in files.items() if "/" not in name)
    most = max(*_sizes(system).values(), system.actions)
    if most > max(core // 8, ANY_SIZE):
        raise _damaged(f"the index claims {most:,} entries in {core:,} bytes", "index.json")


def _actions(
    system: System, files: Mapping[str, bytes], state_to_choices: Integers
) -> tuple[Integers, tuple[str, ...], tuple[str, ...]]:
    """Return each choice's action, the names of actions, and these as the file lists them."""
    count, folder = system.actions, "actions/choices"
    listed: tuple[str, ...] = ()
    if count and f"{folder}/string-mapping.bin" in files:
        ends = np.frombuffer(files[f"{folder}/string-mapping.bin"], "<u8").tolist()
        text = files[f"{folder}/strings.bin"]
        if ends[-1] > len(text):
            raise _damaged("the names end beyond their file", "actions")
        listed = tuple(text[a:b].decode("utf-8") for a, b in pairwise(ends))
    given = None
    names = tuple(name or "unnamed" for name in listed) or tuple(f"a{k}" for k in range(count))
    if count and f"{folder}/values.bin" in files:
        given = np.frombuffer(files[f"{folder}/values.bin"], "<u4").astype(np.int64)
        if given.max(initial=0) >= count or len(names) != count:
            raise _damaged(
                f"{len(names)} names for {count} actions, or an action beyond them", "actions"
            )
    return *actions_of(given, names, state_to_choices), listed


def _offsets(files: Mapping[str, bytes], where: str, size: int, end: int) -> Integers:
    """Return size+1 offsets from 0 to `end`; one each where none are given."""
    data = files.get(f"{where}.bin")
    if data is None:
        found = np.arange(size + 1, dtype=np.int64)
    else:
        given = np.frombuffer(data, "<u8")
        found = np.where(given > end, -1, given.astype(np.int64))
    if len(found) != size + 1 or found[0] != 0 or found[-1] != end or (np.diff(found) < 0).any():
        raise _damaged(f"{len(found)} offsets that do not run from 0 to {end}", where)
    return found
