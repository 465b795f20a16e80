"""What a UMB file says, as plain lists, after every length and range has been checked."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.io.umb_archive import files_of
from exact_mdp.mdp.table import OutcomeTable

GROUP, REWARD = "exact-mdp", "reward"
CARRIER = "start"
"""The annotation whose description is the header: what the format has no place for, as JSON."""

DOUBTS = tuple(
    field.name for field in fields(OutcomeTable) if field.default is None and field.name != "event"
)
"""Arrays of floats that a table of outcomes may have, each an annotation where it has it."""

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
    components: list[list[float]]  # of (C,)
    ours: bool  # the rewards are those that the other annotations belong to


def read(path: str | Path, reward: str | None) -> Content:
    """Return what a file says of the model and of one reward model; raises ModelError."""
    try:
        from umbi.umb import ExplicitUmb
        from umbi.umb.umb_to_tar import UmbDecoder
    except ImportError as error:
        raise needs_umbi() from error
    try:
        decoder, umb = UmbDecoder(), ExplicitUmb()
        decoder.update(files_of(path))
        if len(decoder.get("index.json", b"")) > LARGEST_INDEX:
            raise ModelError("the index is too large", where="index.json", fix="check the file")
        decoder.read_index_file(umb)
        _check_kind(umb.index.transition_system, decoder)
        _check_files(umb.index.transition_system, decoder)
        decoder.read_state_files(umb)
        decoder.read_transition_files(umb)
        rewards = (umb.index.annotations or {}).get("rewards") or {}
        chosen = _chosen(rewards, reward)
        own = (umb.index.annotations or {}).get(GROUP) or {}
        header = _header(own)
        ours = chosen == REWARD
        umb.annotations = {"rewards": {}, GROUP: {}}
        parts = [key for key in _component_keys(header) if ours and key in rewards]
        for name in (chosen, *parts):
            _read_annotation(decoder, umb, "rewards", name, rewards[name])
        numbers = ("gain", *map(key_of, DOUBTS))
        for name in (CARRIER, "event", *(numbers if ours else ())):
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


def needs_umbi() -> ModelError:
    """Return the error that says how to install umbi."""
    return ModelError(
        "the package umbi is not installed", fix='install it: pip install "exact-mdp[umb]"'
    )


def _header(own: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return what exact-mdp wrote of a model besides its numbers; None in files of others."""
    text = own[CARRIER].description if CARRIER in own else None
    if not text:
        return None
    place = f"annotations/{GROUP}/{CARRIER}"
    try:
        header = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ModelError("its description is no JSON", where=place, fix="save it again") from error
    if not isinstance(header, dict):
        raise ModelError("its description is no object", where=place, fix="save it again")
    return header


def _read_annotation(decoder: Any, umb: Any, group: str, name: str, about: Any) -> None:
    """Read one annotation, after the sizes of its files have been compared with the model's."""
    system = umb.index.transition_system
    for over in about.applies_to or ():
        path = f"annotations/{group}/{name}/{over}/values.bin"
        _check_size(decoder, path, _sizes(system)[over], about.type)
    decoder.read_annotation(umb, group, name, about)


def _sizes(system: Any) -> dict[str, int]:
    return {
        "states": system.num_states,
        "choices": system.num_choices,
        "branches": system.num_branches,
    }


def _check_files(system: Any, files: Mapping[str, bytes]) -> None:
    """Raise ModelError unless the model's files have the sizes that its index gives them."""
    from umbi.binary import BOOL1, UINT32, UINT64

    states, choices, branches = _sizes(system).values()
    listed: list[tuple[str, int, Any]] = [
        ("state-is-initial.bin", states, BOOL1),
        ("state-to-choices.bin", states + 1, UINT64),
        ("state-to-player.bin", states, UINT32),
        ("choice-to-branches.bin", choices + 1, UINT64),
        ("branch-to-target.bin", branches, UINT64),
        ("branch-to-probability.bin", branches, system.branch_probability_type),
        ("actions/choices/values.bin", choices, UINT32),
        ("actions/choices/string-mapping.bin", system.num_choice_actions + 1, UINT64),
    ]
    for name, count, kind in listed:
        _check_size(files, name, count, kind)
    mapping = files.get("actions/choices/string-mapping.bin")
    if mapping is not None:
        ends = np.frombuffer(mapping, "<u8")
        # Ranges that overlap would make much text of little.
        if (ends[1:] < ends[:-1]).any():
            raise ModelError(
                "the ranges of the names fall", where="actions", fix="write the file again"
            )
    system.num_branch_actions = 0  # names of branches, which nothing here reads


def _check_size(files: Mapping[str, bytes], name: str, count: int, kind: Any) -> None:
    """Raise ModelError where a file has not the size of `count` values of a type."""
    from umbi.binary import BOOL1

    data = files.get(name)
    if data is None or kind is None:
        return
    if kind == BOOL1:
        good = -(-count // 8) <= len(data) <= 8 * -(-count // 64)
    else:
        good = len(data) * 8 == count * kind.size_bits
    if not good:
        raise ModelError(
            f"a file of {len(data):,} bytes for {count:,} values",
            where=name,
            fix="write the file again",
        )


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
                f"the model is no MDP or Markov chain: {what}",
                where="index.json",
                fix="give a model in discrete time, of one player, fully observable",
            )
    # A state, choice or branch takes at least eight bytes where there are many of them.
    core = sum(len(data) for name, data in files.items() if "/" not in name)
    counts = (*_sizes(system).values(), system.num_choice_actions)
    if max(counts) > max(core // 8, ANY_SIZE):
        raise ModelError(
            f"the index claims {max(counts):,} entries in {core:,} bytes",
            where="index.json",
            fix="write the file again",
        )


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


def _component_keys(header: Mapping[str, Any] | None) -> list[str]:
    names = header.get("component_names") if header else None
    return [component_key(number) for number in range(len(names) if isinstance(names, list) else 0)]


def _content(
    umb: Any, chosen: str, header: Mapping[str, Any] | None, parts: Iterable[str]
) -> Content:
    reward, own = umb.annotations["rewards"][chosen], umb.annotations[GROUP]
    system = umb.index.transition_system
    states, choices, branches = system.num_states, system.num_choices, system.num_branches
    state_to_choices = _mapping(umb.state_to_choices, states, choices, "state-to-choices")
    actions, names = _actions(umb, state_to_choices, choices)
    earned = {
        key: _numbers(reward.get(key, [0] * size), size, f"rewards of {key}")
        for key, size in _sizes(system).items()
    }
    doubts = {
        name: next(iter(own[key_of(name)].values())) for name in DOUBTS if key_of(name) in own
    }
    gain, start = own.get("gain", {}).get("branches"), own.get(CARRIER, {}).get("states")
    data = umb.index.model_data
    return Content(
        name=(data.name or "") if data is not None else "",
        state_to_choices=state_to_choices,
        choice_to_branches=_mapping(
            umb.choice_to_branches, choices, branches, "choice-to-branches"
        ),
        target=_targets(umb.branch_to_target, states, branches),
        probability=_numbers(
            [1] * branches if umb.branch_to_probability is None else umb.branch_to_probability,
            branches,
            "branch-to-probability",
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
        doubts=doubts,
        components=[umb.annotations["rewards"][key]["choices"] for key in parts],
        ours=chosen == REWARD,
    )


def _actions(
    umb: Any, state_to_choices: list[int], choices: int
) -> tuple[list[int], tuple[str, ...]]:
    """Return each choice's action and all names; where two choices of a state have the same
    action, or none has one, actions are the places of the choices in their state."""
    count = umb.index.transition_system.num_choice_actions
    given = umb.choice_to_choice_action
    spans = [
        range(*state_to_choices[state : state + 2]) for state in range(len(state_to_choices) - 1)
    ]
    if count and given is not None:
        given = _of_length(given, choices, "actions of choices")
        names = umb.choice_action_to_string or [f"a{number}" for number in range(count)]
        names = [name or "unnamed" for name in names]
        if any(not 0 <= action < count for action in given) or len(names) != count:
            raise ModelError(
                f"{len(names)} names for {count} actions, or an action beyond them",
                where="actions",
                fix="write the file again",
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
        raise ModelError(
            f"{len(offsets)} offsets that do not run from 0 to {end}",
            where=where,
            fix="write the file again",
        )
    return offsets


def _targets(given: Sequence[int] | None, states: int, branches: int) -> list[int]:
    targets = _of_length([0] * branches if given is None else given, branches, "branch-to-target")
    for target in targets:
        if target >= states:
            raise ModelError(
                f"a branch leads to state {target} of {states}",
                where="branch-to-target",
                fix="write the file again",
            )
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
        raise ModelError(
            f"{0 if values is None else len(values)} values, not {size}",
            where=where,
            fix="write the file again",
        )
    return list(values)
