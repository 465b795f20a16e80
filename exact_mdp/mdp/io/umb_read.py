"""What a UMB file says, as arrays: the package umbi decodes it, and every length is checked here.

umbi gives each number as Python has it: whole numbers, floats, truth values, and rationals as
fractions, so that nothing is rounded. What it cannot read (texts as variables, random annotations)
is refused in its words. The sizes that the index claims are compared with the file first, as umbi
makes lists of that length.
"""

from __future__ import annotations

import bz2
import gzip
import lzma
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, extra
from exact_mdp.mdp.io.explicit import Explicit, actions_of, named_by
from exact_mdp.mdp.io.files import LARGEST, read_bytes
from exact_mdp.mdp.table import Integers

PACKED = {b"\x1f\x8b": gzip.decompress, b"BZh": bz2.decompress, b"\xfd7zXZ": lzma.decompress}
"""Kinds of compression, which umbi does not read to the end."""

ANY_SIZE = 10**6
"""Numbers of states, choices, branches and actions that need no data in the file to be believed."""


def read(path: str | Path) -> tuple[Any, Explicit]:
    """Return a file as umbi decodes it, and what it says of the model; raises ModelError."""
    with extra("models"):
        from umbi import umb as umb_package
        from umbi.umb import umb_to_tar as decoding
    packed = read_bytes(path, most=LARGEST)  # a regular file, and not too large
    try:
        for begin, unpacked in PACKED.items():
            if packed.startswith(begin):
                unpacked(packed)  # raises where a checksum, at the end, is wrong or missing
        decoder, found = decoding.UmbDecoder(path), umb_package.ExplicitUmb()
        decoder.read_index_file(found)
        _check_kind(found.index.transition_system, decoder)
        umb = decoder.decode()
        return umb, _content(umb)
    except ModelError:
        raise
    except NotImplementedError as error:
        raise ModelError(
            f"the package umbi cannot read this file: {error}", fix="write the file without that"
        ) from error
    except Exception as error:  # umbi, tarfile, JSON and the decompressors raise many kinds
        raise ModelError(
            f"the file is damaged, or not a UMB file: {str(error)[:200]}",
            fix="write the file again",
        ) from error


def _content(umb: Any) -> Explicit:
    system, about = umb.index.transition_system, umb.index.annotations or {}
    states, choices, branches = _sizes(system).values()
    offsets = _offsets(umb.state_to_choices, "state-to-choices", states, choices)
    ends = [0] * branches if umb.branch_to_target is None else umb.branch_to_target
    target = _sized(ends, branches, "branch-to-target")
    if max(target, default=0) >= states:
        raise _damaged(f"a branch leads to state {max(target)} of {states}", "branch-to-target")
    chances: Sequence[Any] = [1] * branches
    if umb.branch_to_probability is not None:
        chances = _sized(umb.branch_to_probability, branches, "branch-to-probability")
    actions, names = _actions(umb, offsets)
    annotated = _annotations(umb, "aps")
    labels = {key: each["states"] for key, each in annotated.items() if "states" in each}
    return Explicit(
        name=(umb.index.model_data and umb.index.model_data.name) or "",
        state_to_choices=offsets,
        choice_to_branches=_offsets(
            umb.choice_to_branches, "choice-to-branches", choices, branches
        ),
        target=target,
        probability=_numbers(chances, "branch-to-probability"),
        actions=actions,
        action_names=names,
        initial=np.array(_sized(umb.state_is_initial, states, "state-is-initial"), dtype=bool),
        words=named_by((umb.valuations or {}).get("states", ())),
        rewards=_annotations(umb, "rewards"),
        labels={key: np.array(flags, dtype=bool) for key, flags in labels.items()},
        titles={
            group: {key: each.alias or key for key, each in about.get(group, {}).items()}
            for group in ("rewards", "aps")
        },
    )


def _annotations(umb: Any, group: str) -> dict[str, dict[str, Any]]:
    """Return the annotations of a group, each by what it applies to; texts are left out."""
    found: dict[str, dict[str, Any]] = {}
    sizes = _sizes(umb.index.transition_system)
    for key, lists in (umb.annotations or {}).get(group, {}).items():
        for over, values in lists.items():
            where = f"annotations/{group}/{key}/{over}"
            if over not in sizes:
                raise ModelError(
                    f"an annotation of {over}", where=where, fix=f"give {', '.join(sizes)} values"
                )
            if str not in set(map(type, _sized(values, sizes[over], where))):
                found.setdefault(key, {})[over] = _numbers(values, where)
    return found


def _numbers(values: Sequence[Any], where: str) -> Any:
    """Return numbers; raises ModelError for intervals."""
    with extra("models"):
        from umbi import datatypes
    if any(isinstance(value, datatypes.Interval) for value in values):
        raise ModelError(
            "an interval is not a single number",
            where=where,
            fix="give a model without intervals or parameters",
        )
    return values


def _actions(umb: Any, offsets: Integers) -> tuple[Integers, tuple[str, ...]]:
    """Return each choice's action, and the names of actions."""
    count = umb.index.transition_system.num_choice_actions
    listed = tuple(umb.choice_action_to_string or ())
    names = tuple(name or "unnamed" for name in listed) or tuple(f"a{k}" for k in range(count))
    given = None
    if umb.choice_to_choice_action is not None:
        given = np.array(
            _sized(umb.choice_to_choice_action, int(offsets[-1]), "actions"), dtype=np.int64
        )
        if given.max(initial=0) >= count or len(names) != count:
            raise _damaged(
                f"{len(names)} names for {count} actions, or an action beyond them", "actions"
            )
    return actions_of(given, names, offsets)


# ---- sizes ---------------------------------------------------------------------------------------


def _sizes(system: Any) -> dict[str, int]:
    return {
        "states": system.num_states,
        "choices": system.num_choices,
        "branches": system.num_branches,
    }


def _check_kind(system: Any, files: Any) -> None:
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


def _sized(values: Sequence[Any], count: int, where: str) -> Sequence[Any]:
    """Return values; raises ModelError where there are not as many as the index says."""
    if len(values) != count:
        raise _damaged(f"{len(values):,} values, not {count:,}", where)
    return values


def _offsets(given: Sequence[int] | None, where: str, size: int, end: int) -> Integers:
    """Return size+1 offsets from 0 to `end`; one each where none are given."""
    found = list(range(size + 1)) if given is None else list(given)
    falls = any(after < before for before, after in pairwise(found))
    if len(found) != size + 1 or found[0] != 0 or found[-1] != end or falls:
        raise _damaged(f"{len(found)} offsets that do not run from 0 to {end}", where)
    return np.array(found, dtype=np.int64)


def _damaged(what: str, where: str) -> ModelError:
    return ModelError(what, where=where, fix="write the file again")
