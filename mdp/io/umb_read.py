"""What a UMB file says, as arrays, after every length and range has been checked.

The package umbi reads the index. Numbers are decoded here, all of a file at once: a rational is two
integers of the same width, a signed numerator and an unsigned denominator, little-endian; truth
values are bits, the lowest of each byte first; variables of a state are packed bit by bit. A UMB
file is a tar archive, plain or compressed with gzip, xz or bzip2. It is unpacked here, within
a limit that its size sets, and not by umbi: a compressed archive may expand a thousandfold, and the
headers of a tar archive may state any size.
"""

from __future__ import annotations

import bz2
import gzip
import io
import json
import logging
import lzma
import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.explicit import Explicit, Ratios, actions_of
from exact_mdp.mdp.io.files import LARGEST, read_bytes
from exact_mdp.mdp.io.own import CARRIER, GROUP
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.table import EXACT_IN_INT64, Integers, Numbers, ones
from exact_mdp.mdp.validate import Flags

binary = later("umbi.binary")
datatypes = later("umbi.datatypes")
umb_package = later("umbi.umb")
encoding = later("umbi.umb.umb_to_tar")

FREE, RATIO = 2**26, 200
"""An archive may unpack to 64 MiB, or to 200 times its own size, whichever is more."""

MOST_FILES = 10_000
WORD = 8
LZMA_MEMORY = 2**27
LARGEST_INDEX = 2**26
ANY_SIZE = 10**6
"""Numbers of states, choices, branches and actions that need no data in the file to be believed."""

# What umbi has to say of a file goes into the error, not to the terminal.
logging.getLogger("umbi").addHandler(logging.NullHandler())


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


def _numbers(data: bytes, count: int, kind: Any, where: str) -> Ratios:
    """Return the numbers of a file, whose length is known to be right."""
    types, size = datatypes.NumericPrimitiveType, kind.size_bits // 8
    if kind.type == types.DOUBLE:
        return Ratios(np.frombuffer(data, "<f8").astype(np.float64), ones(count))
    if kind.type in (types.INT, types.UINT) and kind.size_bits % 8 == 0:
        return Ratios(_integers(data, count, size, signed=kind.type == types.INT), ones(count))
    if kind.type != types.RATIONAL or kind.size_bits % 16:
        raise ModelError(
            f"{getattr(kind.type, 'value', kind.type)} is not a single number",
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
        files, umb = encoding.UmbDecoder(), umb_package.ExplicitUmb()
        files.update(files_of(path))
        if len(files.get("index.json", b"")) > LARGEST_INDEX:
            raise ModelError("the index is too large", where="index.json", fix="check the file")
        files.read_index_file(umb)
        _check_kind(umb.index.transition_system, files)
        _check_files(umb.index.transition_system, files)
        return _content(umb.index, files)
    except ModelError:
        raise
    except OSError as error:
        raise ModelError(
            f"cannot read the file: {error.strerror or error}", fix="check the path"
        ) from error
    except Exception as error:  # umbi, tarfile and the decompressors raise many kinds
        raise ModelError(
            f"the file is damaged, or of a kind that umbi cannot read: {str(error)[:200]}",
            fix="write the file again",
        ) from error


def _content(index: Any, files: Any) -> Explicit:
    system, listed, data = index.transition_system, index.annotations or {}, index.model_data
    states, choices, branches = _sizes(system).values()
    state_to_choices = _offsets(files, "state-to-choices", states, choices)
    ends = files.get("branch-to-target.bin", bytes(WORD * branches))
    target = _integers(ends, branches, WORD, signed=False)
    if branches and target.max() >= states:
        raise _damaged(f"a branch leads to state {target.max()} of {states}", "branch-to-target")
    chances = Ratios(np.ones(branches, np.int64), ones(branches))
    if system.branch_probability_type is not None:
        where = "branch-to-probability"
        chances = _numbers(files[f"{where}.bin"], branches, system.branch_probability_type, where)
    actions, names, words = _actions(system, files, state_to_choices)
    initial = np.zeros(states, dtype=bool)
    if system.num_initial_states:
        initial = _flags(files["state-is-initial.bin"], states)

    def annotations(group: str) -> dict[str, dict[str, Any]]:
        found = {
            str(key): _annotation(files, system, group, key, about)
            for key, about in (listed.get(group) or {}).items()
        }
        return {key: values for key, values in found.items() if values}

    own = annotations(GROUP)
    return Explicit(
        name=(data.name or "") if data is not None else "",
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
            group: {str(key): str(about.alias or key) for key, about in named.items()}
            for group in ("rewards", "aps")
            for named in [listed.get(group) or {}]
        },
        own={key: next(iter(values.values())) for key, values in own.items()},
        header=_header(listed.get(GROUP) or {}),
    )


def _annotation(files: Any, system: Any, group: str, key: str, about: Any) -> dict[str, Any]:
    """Return the values of an annotation by what it applies to; nothing where it holds texts."""
    found: dict[str, Any] = {}
    for over in about.applies_to or ():
        path = f"annotations/{group}/{key}/{over}/values.bin"
        count = _sizes(system)[over]
        if about.type is None or about.type.type == datatypes.PrimitiveType.STRING:
            continue
        _check_size(files, path, count, about.type)
        truth = about.type == binary.BOOL1
        data = files[path]
        found[over] = _flags(data, count) if truth else _numbers(data, count, about.type, path)
    return found


def _valuations(index: Any, files: Any, states: int) -> tuple[str, ...]:
    """Return each state's variables as words, where they are whole numbers that tell states apart.

    Other files of valuations are passed over: states have their numbers.
    """
    about = (index.valuations or {}).get("states")
    data = files.get("valuations/states/valuations.bin")
    if about is None or data is None or len(about.classes) != 1:
        return ()
    struct, types = about.classes[0], datatypes.NumericPrimitiveType
    if not struct.size_bytes or len(data) != states * struct.size_bytes:
        return ()
    bits = np.unpackbits(
        np.frombuffer(data, np.uint8).reshape(states, -1), axis=1, bitorder="little"
    )
    columns, place = [], 0
    for field in struct.fields:
        here = bits[:, place : place + field.size_bits]
        place += field.size_bits
        if not hasattr(field, "name"):  # padding
            continue
        kind = field.sized_type.type
        truth = kind == datatypes.PrimitiveType.BOOL
        whole = kind in (types.INT, types.UINT) and field.size_bits <= 63
        if field.is_optional or not (truth or whole):
            return ()
        value = here @ (1 << np.arange(field.size_bits, dtype=np.int64))
        if kind == types.INT:
            value -= here[:, -1].astype(np.int64) << field.size_bits
        shown = np.where(value == 1, "true", "false") if truth else value.astype(str)
        columns.append([f"{field.name}={each}" for each in shown.tolist()])
    words = tuple(map(", ".join, zip(*columns, strict=True)))
    return words if len(set(words)) == states else ()


def _header(own: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return what exact-mdp wrote of a model besides its numbers; None in files of others."""
    text = own[CARRIER].description if CARRIER in own else None
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


def _sizes(system: Any) -> dict[str, int]:
    return {
        "states": system.num_states,
        "choices": system.num_choices,
        "branches": system.num_branches,
    }


def _check_files(system: Any, files: Mapping[str, bytes]) -> None:
    """Raise ModelError unless the model's files have the sizes that its index gives them."""
    states, choices, branches = _sizes(system).values()
    for name, count, kind in (
        ("state-is-initial.bin", states, binary.BOOL1),
        ("state-to-choices.bin", states + 1, binary.UINT64),
        ("state-to-player.bin", states, binary.UINT32),
        ("choice-to-branches.bin", choices + 1, binary.UINT64),
        ("branch-to-target.bin", branches, binary.UINT64),
        ("branch-to-probability.bin", branches, system.branch_probability_type),
        ("actions/choices/values.bin", choices, binary.UINT32),
        ("actions/choices/string-mapping.bin", system.num_choice_actions + 1, binary.UINT64),
    ):
        _check_size(files, name, count, kind)
    ends = np.frombuffer(files.get("actions/choices/string-mapping.bin", b""), "<u8")
    if (ends[1:] < ends[:-1]).any():  # ranges that overlap would make much text of little
        raise _damaged("the ranges of the names fall", "actions")
    system.num_branch_actions = 0  # names of branches, which nothing here reads


def _check_size(files: Mapping[str, bytes], name: str, count: int, kind: Any) -> None:
    """Raise ModelError where a file has not the size of `count` values of a type."""
    data = files.get(name)
    if data is None or kind is None:
        return
    if kind == binary.BOOL1:
        good = -(-count // 8) <= len(data) <= 8 * -(-count // 64)
    else:
        good = len(data) * 8 == count * kind.size_bits
    if not good:
        raise _damaged(f"a file of {len(data):,} bytes for {count:,} values", name)


def _check_kind(system: Any, files: Mapping[str, bytes]) -> None:
    """Raise ModelError unless this is a chain or an MDP, no larger than its file."""
    kinds = {
        f"time is {system.time}": system.time != "discrete",
        f"{system.num_players} players": system.num_players > 1,
        f"{system.num_observations} observations": system.num_observations > 0,
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
    most = max(*_sizes(system).values(), system.num_choice_actions)
    if most > max(core // 8, ANY_SIZE):
        raise _damaged(f"the index claims {most:,} entries in {core:,} bytes", "index.json")


def _actions(
    system: Any, files: Any, state_to_choices: Integers
) -> tuple[Integers, tuple[str, ...], tuple[str, ...]]:
    """Return each choice's action, the names of actions, and these as the file lists them."""
    count, folder = system.num_choice_actions, "actions/choices"
    listed: tuple[str, ...] = ()
    if count and f"{folder}/string-mapping.bin" in files:
        mapping = f"{folder}/string-mapping.bin"
        listed = tuple(files.read_strings(f"{folder}/strings.bin", filename_csr=mapping))
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
