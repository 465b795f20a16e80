"""What a UMB file says, as plain lists, after every length and range has been checked."""

from __future__ import annotations

import tarfile
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

from mdp.errors import ModelError, suggest

GROUP, REWARD = "exact-mdp", "reward"
LARGEST, RATIO = 2**28, 200
"""An archive may unpack to 256 MiB, or to 200 times its own size, whichever is more."""


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
    initial: list[bool]  # (S,)
    state_reward: list[Any]  # (S,)
    choice_reward: list[Any]  # (C,)
    branch_reward: list[Any]  # (N,)
    gain: list[Any] | None  # (N,)
    start: list[Any] | None  # (S,)


def read(path: str | Path, reward: str | None) -> Content:
    """Return what a file says of the model and of one reward model; raises ModelError."""
    try:
        from umbi.umb import ExplicitUmb
        from umbi.umb.umb_to_tar import UmbDecoder
    except ImportError as error:
        raise needs_umbi() from error
    try:
        size = _unpacked_size(path)
        decoder = UmbDecoder(umbpath=path)
        umb = ExplicitUmb()
        decoder.read_index_file(umb)
        _check_kind(umb.index.transition_system, size)
        decoder.read_state_files(umb)
        decoder.read_transition_files(umb)
        rewards = (umb.index.annotations or {}).get("rewards") or {}
        chosen = _chosen(rewards, reward)
        own = (umb.index.annotations or {}).get(GROUP) or {}
        umb.annotations = {"rewards": {}, GROUP: {}}
        decoder.read_annotation(umb, "rewards", chosen, rewards[chosen])
        for name in ("start", "gain"):
            if name in own and (name == "start" or chosen == REWARD):
                decoder.read_annotation(umb, GROUP, name, own[name])
        return _content(umb, umb.annotations["rewards"][chosen], umb.annotations[GROUP])
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


def _unpacked_size(path: str | Path) -> int:
    """Return the size of an archive's files, or raise where it is out of proportion."""
    limit = max(LARGEST, RATIO * Path(path).stat().st_size)
    total = 0
    with tarfile.open(path, mode="r:*") as archive:
        for member in archive:
            total += member.size
            if total > limit:
                raise ModelError(
                    f"the archive unpacks to over {limit:,} bytes", fix="use an uncompressed file"
                )
    return total


def _check_kind(system: Any, size: int) -> None:
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
    counts = (system.num_states, system.num_choices, system.num_branches)
    if max(counts) > max(size, 10**6):
        raise ModelError(
            f"the index claims {max(counts):,} entries in {size:,} bytes",
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


def _content(
    umb: Any, reward: dict[str, list[Any]], own: dict[str, dict[str, list[Any]]]
) -> Content:
    system = umb.index.transition_system
    states, choices, branches = system.num_states, system.num_choices, system.num_branches
    state_to_choices = _mapping(umb.state_to_choices, states, choices, "state-to-choices")
    actions, names = _actions(umb, state_to_choices, choices)
    sizes = {"states": states, "choices": choices, "branches": branches}
    earned = {
        key: _numbers(reward.get(key, [0] * size), size, f"rewards of {key}")
        for key, size in sizes.items()
    }
    gain, start = own.get("gain", {}).get("branches"), own.get("start", {}).get("states")
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
        initial=_of_length(umb.state_is_initial, states, "state-is-initial"),
        state_reward=earned["states"],
        choice_reward=earned["choices"],
        branch_reward=earned["branches"],
        gain=None if gain is None else _numbers(gain, branches, f"{GROUP}/gain"),
        start=None if start is None else _numbers(start, states, f"{GROUP}/start"),
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
