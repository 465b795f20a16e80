"""What a UMB file says, as plain lists, after every length and range has been checked.

A UMB file is a tar archive, plain or compressed with gzip, xz or bzip2. It is unpacked here, within
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
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.io.files import LARGEST, read_bytes
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.table import OutcomeTable

binary = later("umbi.binary")
umb_package = later("umbi.umb")
encoding = later("umbi.umb.umb_to_tar")

GROUP, REWARD = "exact-mdp", "reward"
CARRIER = "start"
"""The annotation whose description is the header: what the format has no place for, as JSON."""

DOUBTS = tuple(
    field.name for field in fields(OutcomeTable) if field.default is None and field.name != "event"
)
"""Arrays of floats that a table of outcomes may have, each an annotation where it has it."""

FREE, RATIO = 2**26, 200
"""An archive may unpack to 64 MiB, or to 200 times its own size, whichever is more."""

MOST_FILES = 10_000
LZMA_MEMORY = 2**27
LARGEST_INDEX = 2**26
ANY_SIZE = 10**6
"""Numbers of states, choices, branches and actions that need no data in the file to be believed."""

# What umbi has to say of a file goes into the error, not to the terminal.
logging.getLogger("umbi").addHandler(logging.NullHandler())


def key_of(name: str) -> str:
    """Return the identifier of the annotation that holds an array of the table."""
    return name.replace("_", "-")


def component_key(number: int) -> str:
    """Return the identifier of the reward model that holds a component."""
    return f"component-{number}"


def label_key(number: int) -> str:
    """Return the identifier of the annotation that holds a label."""
    return f"label-{number}"


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


# ---- its content ---------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Content:
    """Lists over S states, C choices and N branches; numbers are int, float or Fraction."""

    name: str
    state_to_choices: list[int]  # (S+1,)
    choice_to_branches: list[int]  # (C+1,)
    target: list[int]  # (N,)
    probability: list[Any]  # (N,)
    actions: list[int]  # (C,)
    action_names: tuple[str, ...]
    listed_actions: tuple[str, ...]  # as the file lists them
    initial: list[bool]  # (S,)
    state_reward: list[Any]  # (S,)
    choice_reward: list[Any]  # (C,)
    branch_reward: list[Any]  # (N,)
    gain: list[Any] | None  # (N,)
    start: list[Any] | None  # (S,)
    header: Mapping[str, Any] | None  # of files that exact-mdp wrote
    event: list[int] | None  # (N,)
    doubts: Mapping[str, list[float]]  # (N,) or (C,)
    components: list[list[Any]]  # of (C,)
    ours: bool  # the rewards are those that the other annotations belong to
    labels: Mapping[str, NDArray[np.bool_]]  # (S,) by identifier
    goal: NDArray[np.bool_] | None  # (S,)


def read(path: str | Path, reward: str | None) -> Content:
    """Return what a file says of the model and of one reward model; raises ModelError."""
    try:
        decoder, umb = encoding.UmbDecoder(), umb_package.ExplicitUmb()
        decoder.update(files_of(path))
        if len(decoder.get("index.json", b"")) > LARGEST_INDEX:
            raise ModelError("the index is too large", where="index.json", fix="check the file")
        decoder.read_index_file(umb)
        _check_kind(umb.index.transition_system, decoder)
        _check_files(umb.index.transition_system, decoder)
        decoder.read_state_files(umb)
        decoder.read_transition_files(umb)
        listed = umb.index.annotations or {}
        rewards, own = listed.get("rewards") or {}, listed.get(GROUP) or {}
        chosen, header = _chosen(rewards, reward), _header(own)
        ours = chosen == REWARD
        umb.annotations = {"rewards": {}, "aps": {}, GROUP: {}}
        names = (header or {}).get("component_names")
        keys = map(component_key, range(len(names) if isinstance(names, list) else 0))
        parts = [key for key in keys if ours and key in rewards]
        for name in (chosen, *parts):
            _read_annotation(decoder, umb, "rewards", name, rewards[name])
        for name, about in (listed.get("aps") or {}).items():
            if about.applies_to == ["states"]:
                _read_annotation(decoder, umb, "aps", name, about)
        for name in (CARRIER, "event", "goal", *(("gain", *map(key_of, DOUBTS)) if ours else ())):
            if name in own:
                _read_annotation(decoder, umb, GROUP, name, own[name])
        return _content(umb, chosen, header, parts)
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


def _read_annotation(decoder: Any, umb: Any, group: str, name: str, about: Any) -> None:
    """Read one annotation, after the sizes of its files have been compared with the model's."""
    for over in about.applies_to or ():
        path = f"annotations/{group}/{name}/{over}/values.bin"
        _check_size(decoder, path, _sizes(umb.index.transition_system)[over], about.type)
    decoder.read_annotation(umb, group, name, about)


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


def _chosen(rewards: Any, wanted: str | None) -> str:
    """Return the identifier of the reward model called `wanted`, or of the only one."""
    names = {str(entry.alias or key): str(key) for key, entry in rewards.items()}
    if wanted is None:
        if REWARD in rewards or len(rewards) == 1:
            return REWARD if REWARD in rewards else next(iter(rewards))
        raise ModelError(
            f"{len(rewards)} reward models, none of them called {REWARD!r}",
            where="rewards",
            fix=f"name one: {', '.join(names)}" if names else "add a reward model to the file",
        )
    if wanted not in names and wanted not in rewards:
        raise ModelError(
            f"no reward model {wanted!r}", where="rewards", fix=suggest(wanted, names) or "add one"
        )
    return names.get(wanted, wanted)


def _content(
    umb: Any, chosen: str, header: Mapping[str, Any] | None, parts: Iterable[str]
) -> Content:
    reward, own = umb.annotations["rewards"][chosen], umb.annotations[GROUP]
    sizes = _sizes(umb.index.transition_system)
    states, choices, branches = sizes.values()
    state_to_choices = _mapping(umb.state_to_choices, states, choices, "state-to-choices")
    actions, names = _actions(umb, state_to_choices, choices)
    earned = {
        key: _numbers(reward.get(key, [0] * size), size, f"rewards of {key}")
        for key, size in sizes.items()
    }
    gain, start = own.get("gain", {}).get("branches"), own.get(CARRIER, {}).get("states")
    chances = umb.branch_to_probability
    data = umb.index.model_data
    return Content(
        name=(data.name or "") if data is not None else "",
        state_to_choices=state_to_choices,
        choice_to_branches=_mapping(
            umb.choice_to_branches, choices, branches, "choice-to-branches"
        ),
        target=_targets(umb.branch_to_target, states, branches),
        probability=_numbers(
            [1] * branches if chances is None else chances, branches, "branch-to-probability"
        ),
        actions=actions,
        action_names=names,
        listed_actions=tuple(umb.choice_action_to_string or ()),
        initial=_of_length(umb.state_is_initial, states, "state-is-initial"),
        state_reward=earned["states"],
        choice_reward=earned["choices"],
        branch_reward=earned["branches"],
        gain=None if gain is None else _numbers(gain, branches, f"{GROUP}/gain"),
        start=None if start is None else _numbers(start, states, f"{GROUP}/{CARRIER}"),
        header=header,
        event=own.get("event", {}).get("branches"),
        doubts={n: next(iter(own[key_of(n)].values())) for n in DOUBTS if key_of(n) in own},
        components=[umb.annotations["rewards"][key]["choices"] for key in parts],
        ours=chosen == REWARD,
        labels={
            key: _flags(values["states"], states, f"aps/{key}")
            for key, values in umb.annotations["aps"].items()
        },
        goal=_flags(own["goal"]["states"], states, "goal") if "goal" in own else None,
    )


def _flags(values: Sequence[Any], size: int, where: str) -> NDArray[np.bool_]:
    return np.array(_of_length(values, size, where), dtype=bool)


def _actions(
    umb: Any, state_to_choices: list[int], choices: int
) -> tuple[list[int], tuple[str, ...]]:
    """Return each choice's action and all names.

    Where two choices of a state have the same action, or none has one, actions are the places of
    the choices in their state.
    """
    count = umb.index.transition_system.num_choice_actions
    given = umb.choice_to_choice_action
    spans = [range(first, last) for first, last in pairwise(state_to_choices)]
    if count and given is not None:
        given = _of_length(given, choices, "actions of choices")
        names = umb.choice_action_to_string or [f"a{number}" for number in range(count)]
        names = [name or "unnamed" for name in names]
        if any(not 0 <= action < count for action in given) or len(names) != count:
            raise _damaged(
                f"{len(names)} names for {count} actions, or an action beyond them", "actions"
            )
        distinct = all(len({given[choice] for choice in span}) == len(span) for span in spans)
        if distinct and len(set(names)) == len(names):
            return given, tuple(names)
    places = [choice - span.start for span in spans for choice in span]
    return places, tuple(str(number) for number in range(max(places, default=0) + 1))


def _mapping(given: Sequence[int] | None, size: int, end: int, where: str) -> list[int]:
    """Return size+1 offsets from 0 to `end`; one each where none are given."""
    offsets = list(range(size + 1)) if given is None else list(given)
    rising = all(a <= b for a, b in pairwise(offsets))
    if len(offsets) != size + 1 or offsets[0] != 0 or offsets[-1] != end or not rising:
        raise _damaged(f"{len(offsets)} offsets that do not run from 0 to {end}", where)
    return offsets


def _targets(given: Sequence[int] | None, states: int, branches: int) -> list[int]:
    targets = _of_length([0] * branches if given is None else given, branches, "branch-to-target")
    if max(targets, default=-1) >= states:
        raise _damaged(f"a branch leads to state {max(targets)} of {states}", "branch-to-target")
    return targets


def _numbers(values: Sequence[Any], size: int, where: str) -> list[Any]:
    for value in values:
        if not isinstance(value, int | float | Fraction):
            raise ModelError(
                f"{value} is not a single number",
                where=where,
                fix="give a model without intervals or parameters",
            )
    return _of_length(values, size, where)


def _of_length(values: Sequence[Any] | None, size: int, where: str) -> list[Any]:
    if values is None or len(values) != size:
        raise _damaged(f"{0 if values is None else len(values)} values, not {size}", where)
    return list(values)
