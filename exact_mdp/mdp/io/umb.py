"""Exchange with model checkers: models as UMB, the unified Markov binary format (package umbi).

A pair is a choice and an outcome a branch; probabilities are rationals if the model's are. The
reward model `reward` is Σ_i p_i r_i for each choice, which gives the same expected totals. An
annotation of a separate group, `exact-mdp`, which other tools ignore, has the initial distribution
(the format itself has a set of initial states). Its description is the whole model as an archive of
`mdp.io.npz`, compressed, in base 64, so nothing of a model is lost. If another program has changed
the other parts of the file, it is refused. Files of other programs have no such description; the
caller gives their discount, or it is 1 with a warning. A choice without an action is called
"unnamed", and the second choice of a state with the action `go` is `go#2`. In names of labels,
characters other than letters and digits become underscores; terminal states have the label
`terminal`. Storm, for example, then answers

    R{"reward"}max=? [F "terminal"].

Source of the format: https://pmc-tools.github.io/umb/spec
"""

from __future__ import annotations

import base64
import bz2
import gzip
import io
import lzma
import re
import zlib
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import (
    ModelError,
    locate_errors,
    require_extra,
    require_known_name,
    shown_text,
)
from exact_mdp.mdp.io.explicit import REWARD, build_explicit_model, name_states
from exact_mdp.mdp.io.files import (
    LARGEST,
    read_bytes,
    write_atomically,
)
from exact_mdp.mdp.io.npz import pack_model, unpack_model
from exact_mdp.mdp.io.structured import most_unpacked, unpacked_size
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Numbers

PACKED: dict[bytes, Any] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}
"""Kinds of compression. The checksum is at the end, up to which umbi does not read."""

GROUP, CARRIER = "exact-mdp", "start"
WRITTEN = (
    *("state_is_initial", "state_to_choices", "choice_to_branches", "branch_to_target"),
    *("branch_to_probability", "choice_to_choice_action", "choice_action_to_string"),
)
"""Parts of a file of exact-mdp that, with the annotations, no other program may have changed."""


def _import_umbi() -> Any:
    """Return the package umbi, with its submodules."""
    with require_extra("models"):
        import umbi
        import umbi.umb.index
        import umbi.umb.umb_to_tar
    return umbi


def write_umb(model: MDP, path: str | Path) -> None:
    """Write a model as a UMB file; the same model gives the same bytes, and nothing is lost."""
    encoder = _import_umbi().umb.umb_to_tar.UmbEncoder()
    encoder.encode(_umb_of(model), insert_umbi_metadata=False)
    with TemporaryDirectory() as folder:
        encoder.write(Path(folder) / "model.tar", compression=None)
        content = (Path(folder) / "model.tar").read_bytes()
    write_atomically(path, gzip.compress(content, mtime=0))  # umbi would include the time


def read_umb(
    path: str | Path,
    *,
    discount: object | None = None,
    reward: str | None = None,
    start: object = None,
) -> MDP:
    """Read a Markov chain or decision process from a UMB file.

    `discount` replaces the model's own; for a file of another program the default is 1, with a
    warning. `reward` names a reward model of such a file. By default the one named "reward" counts,
    or else the sum of all, which are its components; without reward models, rewards are 0. The
    default of `start` is the only initial state of the file, or its first, with a warning; all
    initial states have the label `init`. Raises ModelError for a damaged file, and for models in
    continuous time, of several players, partially observable, or with intervals.
    """
    with locate_errors(str(path)):
        umb, read = _decode_file(path)
        own = (umb.index.annotations or {}).get(GROUP, {}).get(CARRIER)
        if own is None or not own.description:
            read |= {"reward": reward, "discount": discount, "start": start}
            return build_explicit_model(shown_text(str(path)), **read)
        require_known_name(reward or REWARD, (REWARD,), "reward model", "rewards")
        mdp = _restore_model(umb, own.description)
        if discount is not None:
            mdp = mdp.with_(discount=discount)
        if start is not None:
            mdp = mdp.with_(start=start)
        return mdp


def _restore_model(umb: Any, packed: str) -> MDP:
    """Return a model written by exact-mdp from its description; refuse it if the file changed."""
    with locate_errors(f"annotations/{GROUP}/{CARRIER}"):
        try:
            archive = zlib.decompress(base64.b64decode(packed, validate=True))
        except (ValueError, zlib.error) as error:
            raise ModelError("the description is damaged", fix="save the model again") from error
        mdp = unpack_model(archive)
        written = _umb_of(mdp)
        changed = [name for name in WRITTEN if getattr(umb, name) != getattr(written, name)]
        for group, each in written.annotations.items():
            there = (umb.annotations or {}).get(group, {})
            changed += [f"{group}/{key}" for key in each if each[key] != there.get(key)]
        if changed:
            raise ModelError(
                f"another program changed {changed[0].replace('_', '-')}",
                fix=f"drop the annotations of group {GROUP}, which no longer fit the model",
            )
    return mdp


# ---- reading -------------------------------------------------------------------------------------


def _decode_file(path: str | Path) -> tuple[Any, dict[str, Any]]:
    """Return a file as decoded by umbi, and the parts of its model; raise ModelError if damaged.

    umbi returns Python numbers, so nothing is rounded. The sizes that the index claims are compared
    with the file first, because umbi allocates lists of that length.
    """
    package = _import_umbi().umb
    packed = read_bytes(path, most=LARGEST)  # a regular file, and not too large
    try:
        # Unpacking to the end raises an error if the checksum is wrong or missing.
        for begin, unpacked in PACKED.items():
            if packed.startswith(begin):
                unpacked_size(unpacked(io.BytesIO(packed)), most_unpacked(len(packed)))
        decoder, content = package.umb_to_tar.UmbDecoder(path), package.ExplicitUmb()
        decoder.read_index_file(content)
        _check_kind(content.index.transition_system, decoder)
        umb = decoder.decode()
        return umb, _read_model_parts(umb, Path(path).stem)
    except ModelError:
        raise
    except Exception as error:  # umbi, tarfile, JSON and the decompressors raise many kinds
        what = "the file is damaged, or not a UMB file, or umbi cannot read a part of it: "
        raise _damage_error(what + str(error)[:200]) from error


def _check_kind(system: Any, files: Any) -> None:
    """Raise ModelError unless this is a chain or an MDP, no larger than its file."""
    time, players, observations = system.time, system.num_players, system.num_observations
    if time != "discrete" or players > 1 or observations > 0:
        raise ModelError(
            "the model is neither an MDP nor a Markov chain: "
            f"time is {time}, {players} players, {observations} observations",
            where="index.json",
            fix="give a model in discrete time, of one player, fully observable",
        )
    # A state, choice or branch takes at least eight bytes, except in files of regular structure,
    # which may leave out data; up to a million of each are accepted without.
    core = sum(len(data) for name, data in files.items() if "/" not in name)
    most = max(*_read_sizes(system).values(), system.num_choice_actions)
    if most > max(core // 8, 10**6):
        raise _damage_error(f"the index claims {most:,} entries in {core:,} bytes", "index.json")


def _read_model_parts(umb: Any, name: str) -> dict[str, Any]:
    """Return the arguments of `build_explicit_model`."""
    # The sizes first: every list must have the length that the index states.
    states, choices, branches = _read_sizes(umb.index.transition_system).values()
    first_choice = _require_offsets(umb.state_to_choices, "state-to-choices", states, choices)
    first_branch = _require_offsets(umb.choice_to_branches, "choice-to-branches", choices, branches)
    targets = _require_length(umb.branch_to_target or [0] * branches, branches, "branch-to-target")
    chances = _require_length(
        umb.branch_to_probability or [1] * branches, branches, "branch-to-probability"
    )
    if max(targets, default=0) >= states:
        raise _damage_error(
            f"a branch leads to state {max(targets)} of {states}", "branch-to-target"
        )
    rewards = _read_annotations(umb, "rewards")
    choice_words, action_names = _read_actions(umb, choices)
    # The reward of a state without choices would never be earned.
    ends = []
    for state, own in enumerate(pairwise(first_choice)):
        if own[0] == own[1]:
            ends.append(state)
    for title, values in rewards.items():
        for end in ends:
            if "states" in values and values["states"][end]:
                raise ModelError(
                    "a reward in a state without choices",
                    where=f"state {end}, reward {title}",
                    fix="add a choice that stays there, or drop the reward",
                )
    # Initial states, and labels of states.
    initial = _require_length(umb.state_is_initial, states, "state-is-initial")
    labels = {}
    for title, each in _read_annotations(umb, "aps").items():
        if "states" in each:
            labels[title] = np.array(each["states"], dtype=bool)
    return {
        "name": (umb.index.model_data and umb.index.model_data.name) or name,
        "first_choice": first_choice,
        "first_branch": first_branch,
        "targets": targets,
        "chances": chances,
        "choice_words": choice_words,
        "action_names": action_names,
        "words": name_states((umb.valuations or {}).get("states", ())),
        "initial": [state for state, begins in enumerate(initial) if begins],
        "rewards": rewards,
        "labels": labels,
    }


def _read_annotations(umb: Any, group: str) -> dict[str, dict[str, Any]]:
    """Return the annotations of a group: {title: {"states", "choices" or "branches": values}}."""
    titled: dict[str, dict[str, Any]] = {}
    sizes = _read_sizes(umb.index.transition_system)
    for key, lists in (umb.annotations or {}).get(group, {}).items():
        title = umb.index.annotations[group][key].alias or key
        for over, values in lists.items():
            _require_length(values, sizes[over], f"{group}/{key}/{over}")
        if title in titled:  # two annotations have the same alias
            title = key
        titled[title] = lists
    return titled


def _read_actions(umb: Any, choices: int) -> tuple[Sequence[str], Sequence[str]]:
    """Return the name of each choice's action ("" for none), and the names of all actions."""
    count, given = umb.index.transition_system.num_choice_actions, umb.choice_to_choice_action
    names = umb.choice_action_to_string or [f"a{number}" for number in range(count)]
    if given is None:
        return [""] * choices, ()
    _require_length(given, choices, "actions")
    if max(given, default=0) >= count or len(names) != count:
        what = f"{len(names)} names for {count} actions, or an action beyond them"
        raise _damage_error(what, "actions")
    return [names[number] for number in given], [name for name in names if name]


def _read_sizes(system: Any) -> dict[str, int]:
    """Return the numbers of states, choices and branches."""
    return {each: getattr(system, f"num_{each}") for each in ("states", "choices", "branches")}


def _require_length(values: Sequence[Any], count: int, where: str) -> Sequence[Any]:
    """Return values if there are `count` of them; else raise ModelError."""
    if len(values) != count:
        raise _damage_error(f"{len(values):,} values, not {count:,}", where)
    return values


def _require_offsets(given: Sequence[int] | None, where: str, size: int, end: int) -> Sequence[int]:
    """Return size+1 offsets that rise from 0 to `end`; without any, each has one entry."""
    offsets = given
    if offsets is None:
        offsets = range(size + 1)
    falls = any(after < before for before, after in pairwise(offsets))
    if len(offsets) != size + 1 or offsets[0] != 0 or offsets[-1] != end or falls:
        raise _damage_error(f"{len(offsets)} offsets that do not run from 0 to {end}", where)
    return offsets


def _damage_error(what: str, where: str = "") -> ModelError:
    """Return the error for a damaged file."""
    return ModelError(what, where=where, fix="write the file again")


# ---- writing -------------------------------------------------------------------------------------


def _umb_of(model: MDP) -> Any:
    """Return a model in umbi's form."""
    umbi, table = _import_umbi(), model.table
    description, version = umbi.umb.index, umbi.version
    start = {state: weight for state, weight in model.start if weight > 0}
    # Exact rewards of pairs remain exact, even if probabilities are floats.
    floats = table.gain.dtype == np.float64 or (table.joint and table.weight.dtype == np.float64)
    kind, chances = _choose_type(
        _to_ratios(table.weight, np.repeat(table.denominator, np.diff(table.offsets)))
    )
    if floats:
        earned = model.reward.tolist()
    else:
        earned = _to_ratios(*table.expected_gain_exact)
    data = None
    if model.name:
        data = description.ModelData(name=model.name)
    archive = base64.b64encode(zlib.compress(pack_model(model))).decode("ascii")
    umb = umbi.umb.ExplicitUmb(
        index=description.UmbIndex(
            format_version=version.__format_version__,
            format_revision=version.__format_revision__,
            file_data=description.FileData(tool="exact-mdp"),
            model_data=data,
            transition_system=description.TransitionSystem(
                time="discrete",
                num_players=1,
                num_states=model.n_states,
                num_initial_states=len(start),
                num_choices=model.n_pairs,
                num_choice_actions=model.n_actions,
                num_branches=len(table.next),
                branch_probability_type=kind,
            ),
            annotations={"rewards": {}, "aps": {}, GROUP: {}},
        ),
        state_is_initial=[state in start for state in range(model.n_states)],
        state_to_choices=model.pair_offsets.tolist(),
        choice_to_branches=table.offsets.tolist(),
        branch_to_target=table.next.tolist(),
        branch_to_probability=chances,
        choice_to_choice_action=model.pair_action.tolist(),
        choice_action_to_string=list(model.actions),
        annotations={"rewards": {}, "aps": {}, GROUP: {}},
    )

    def add_annotation(group: str, key: str, over: str, values: Any, **described: Any) -> None:
        kind, numbers = _choose_type(values)
        umb.annotations[group][key] = {over: numbers}
        umb.index.annotations[group][key] = description.AnnotationDescription(
            applies_to=[over], type=kind, **described
        )

    add_annotation("rewards", REWARD, "choices", earned)
    add_annotation("aps", "terminal", "states", model.terminal.tolist())
    # Labels, under different names.
    taken = {"terminal"}
    for number, (name, states) in enumerate(model.labels.items()):
        # The query language of PRISM and Storm does not allow dots or hyphens in names.
        word = re.sub(r"\W", "_", name)
        if word in taken:
            word = f"{word}_{number}"
        taken.add(word)
        add_annotation(
            "aps", f"label-{number}", "states", states.tolist(), alias=word, description=name
        )
    chances = [start.get(state, Fraction(0)) for state in range(model.n_states)]
    add_annotation(GROUP, CARRIER, "states", chances, description=archive)
    return umb


def _choose_type(values: Sequence[Any]) -> tuple[Any, list[Any]]:
    """Return the type of some values (truth values, doubles or rationals), and the values in it."""
    umbi = _import_umbi()
    kind, numbers = umbi.datatypes.promote_scalars(values)
    bits = umbi.binary.max_num_bits_for_collection_element(numbers, kind)
    # Each half of a rational takes a multiple of 64 bits.
    if kind == umbi.datatypes.NumericPrimitiveType.RATIONAL:
        bits = 128 * -(-bits // 128)
    return umbi.binary.SizedType(kind, bits), numbers


def _to_ratios(top: Numbers, below: Numbers) -> list[Any]:
    """Return ratios of integers as Fractions; floats, whose denominators are 1, as they are."""
    if top.dtype == np.float64:
        return list(top.tolist())
    return [Fraction(a, b) for a, b in zip(top.tolist(), below.tolist(), strict=True)]
