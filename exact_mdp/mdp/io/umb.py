"""Exchange with model checkers: models as UMB, the unified Markov binary format (package umbi).

A pair is a choice and an outcome a branch; probabilities are rationals if the model's are. What the
format has no place for is written as annotations of a separate group, `exact-mdp`, which other
tools skip:

    start        the initial distribution (the format itself has a set of initial states)

Its description is the whole model as an archive of `mdp.io.npz`, compressed, in base 64, so nothing
of a model is lost. If another program changed what the format does have, the file is refused. Files
of other programs have no such description; the caller gives their discount, or it is 1 with a
warning. For other tools

    rewards/reward   is Σ_i p_i r_i for each choice, from which expected totals are the same,

and every reward component is a reward model, called by its name with underscores for other signs
than letters and digits (`subtask_complete`). States where the process has ended have the label
`terminal`; the columns of the state space are the states' valuations (-1 for states outside the
product). Storm, for example, then answers

    R{"reward"}max=? [F "terminal"].

Source of the format: https://pmc-tools.github.io/umb/spec
"""

from __future__ import annotations

import base64
import bz2
import gzip
import lzma
import re
import zlib
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, extra, known, located, shown_text
from exact_mdp.mdp.io import npz
from exact_mdp.mdp.io.explicit import REWARD, Explicit, model_of, named_by
from exact_mdp.mdp.io.files import LARGEST, read_bytes, write_atomically
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers, Numbers, OutcomeTable

PACKED = {b"\x1f\x8b": gzip.decompress, b"BZh": bz2.decompress, b"\xfd7zXZ": lzma.decompress}
"""Kinds of compression, which umbi does not read to the end."""
ANY_SIZE = 10**6
"""Numbers of states, choices, branches and actions that need no data in the file to be believed."""

TERMINAL, COMPONENT = "terminal", "component-"
GROUP, CARRIER = "exact-mdp", "start"
WRITTEN = (
    *("state_is_initial", "state_to_choices", "choice_to_branches", "branch_to_target"),
    *("branch_to_probability", "choice_to_choice_action", "choice_action_to_string", "annotations"),
)
"""What has to be as it was written, where a file is of exact-mdp."""


def _umbi() -> Any:
    """Return the package umbi, with its parts."""
    with extra("models"):
        import umbi
        import umbi.umb.index
        import umbi.umb.umb_to_tar
    return umbi


def save(model: MDP, path: str | Path) -> None:
    """Write a model as a UMB file, from which `load` returns all of it; always the same bytes."""
    encoder = _umbi().umb.umb_to_tar.UmbEncoder()
    encoder.encode(_umb_of(model), insert_umbi_metadata=False)
    with TemporaryDirectory() as folder:
        encoder.write(Path(folder) / "model.tar", compression=None)
        content = (Path(folder) / "model.tar").read_bytes()
    write_atomically(path, gzip.compress(content, mtime=0))  # umbi would write the time


def load(
    path: str | Path,
    *,
    discount: object | None = None,
    reward: str | None = None,
    start: object = None,
) -> MDP:
    """Read a Markov chain or decision process from a UMB file.

    `discount` stands instead of the model's own; where another program wrote the file it is 1
    unless it is given, with a warning. `reward` names a reward model; unless it is named, the one
    called "reward" counts, or the sum of all, which are its components; without any, rewards are 0.
    `start` is the file's only initial state unless it is given, or its first, with a warning; where
    there are several, they have the label `init`. Raises ModelError for a damaged file, and for
    models in continuous time, of several players, partially observable, or with intervals.
    """
    with located(str(path)):
        umb, content = _read(path)
        own = (umb.index.annotations or {}).get(GROUP, {}).get(CARRIER)
        if own is not None and own.description:
            mdp = _restored(umb, own.description, reward)
            mdp = mdp if discount is None else mdp.with_(discount=discount)
            return mdp if start is None else mdp.with_(start=start)
        named = replace(content, name=content.name or Path(path).stem)
        where = shown_text(str(path))
        return model_of(named, where, reward=reward, discount=discount, start=start)


def _restored(umb: Any, packed: str, reward: str | None) -> MDP:
    """Return a model that exact-mdp wrote, with everything that the format has no place for."""
    where = f"annotations/{GROUP}/{CARRIER}"
    with located(where):
        try:
            archive = zlib.decompress(base64.b64decode(packed, validate=True))
        except (ValueError, zlib.error) as error:
            raise ModelError("the description is damaged", fix="save the model again") from error
        mdp = npz.unpacked(archive)
    written = _umb_of(mdp)
    for name in WRITTEN:
        if getattr(umb, name) != getattr(written, name):
            raise ModelError(
                f"another program changed {name.replace('_', '-')}",
                where=where,
                fix=f"drop the annotations of group {GROUP}, which no longer describe the model",
            )
    keys = {_title(key, each): key for key, each in written.index.annotations["rewards"].items()}
    chosen = known(REWARD if reward is None else reward, keys, "reward model", "rewards")
    if chosen == REWARD:
        return mdp
    table = mdp.table.earning_component(int(keys[chosen].removeprefix(COMPONENT)))
    return replace(mdp, table=table, component_names=(chosen,))


def _title(key: str, described: Any) -> str:
    return described.alias or key


# ---- reading -------------------------------------------------------------------------------------


def _read(path: str | Path) -> tuple[Any, Explicit]:
    """Return a file as umbi decodes it, and what it says of the model; raises ModelError.

    umbi gives each number as Python has it, so that nothing is rounded. The sizes that the index
    claims are compared with the file first, as umbi makes lists of that length.
    """
    package = _umbi().umb
    packed = read_bytes(path, most=LARGEST)  # a regular file, and not too large
    try:
        for begin, unpacked in PACKED.items():
            if packed.startswith(begin):
                unpacked(packed)  # raises where a checksum, at the end, is wrong or missing
        decoder, content = package.umb_to_tar.UmbDecoder(path), package.ExplicitUmb()
        decoder.read_index_file(content)
        _check_kind(content.index.transition_system, decoder)
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
    system = umb.index.transition_system
    states, choices, branches = _sizes(system).values()
    offsets = _offsets(umb.state_to_choices, "state-to-choices", states, choices)
    ends = [0] * branches if umb.branch_to_target is None else umb.branch_to_target
    target = _sized(ends, branches, "branch-to-target")
    if max(target, default=0) >= states:
        raise _damaged(f"a branch leads to state {max(target)} of {states}", "branch-to-target")
    chances: Sequence[Any] = [1] * branches
    if umb.branch_to_probability is not None:
        chances = _sized(umb.branch_to_probability, branches, "branch-to-probability")
    actions, names = _actions(umb, choices)
    return Explicit(
        name=(umb.index.model_data and umb.index.model_data.name) or "",
        state_to_choices=offsets,
        choice_to_branches=_offsets(
            umb.choice_to_branches, "choice-to-branches", choices, branches
        ),
        target=target,
        probability=chances,
        actions=actions,
        action_names=names,
        initial=np.array(_sized(umb.state_is_initial, states, "state-is-initial"), dtype=bool),
        words=named_by((umb.valuations or {}).get("states", ())),
        rewards=_annotations(umb, "rewards"),
        labels={
            title: np.array(each["states"], dtype=bool)
            for title, each in _annotations(umb, "aps").items()
            if "states" in each
        },
    )


def _annotations(umb: Any, group: str) -> dict[str, dict[str, Any]]:
    """Return the annotations of a group by title and what they apply to; texts are left out."""
    by_title: dict[str, dict[str, Any]] = {}
    sizes = _sizes(umb.index.transition_system)
    for key, lists in (umb.annotations or {}).get(group, {}).items():
        title = _title(key, umb.index.annotations[group][key])
        numbers = {
            over: values
            for over, values in lists.items()
            if str not in {*map(type, _sized(values, sizes[over], f"{group}/{key}/{over}"))}
        }
        if numbers:
            by_title[key if title in by_title else title] = numbers
    return by_title


def _actions(umb: Any, choices: int) -> tuple[Integers | None, tuple[str, ...]]:
    """Return each choice's action, if they are stated, and the names of actions."""
    count = umb.index.transition_system.num_choice_actions
    listed = tuple(umb.choice_action_to_string or ())
    names = tuple(name or "unnamed" for name in listed) or tuple(f"a{k}" for k in range(count))
    given = None
    if umb.choice_to_choice_action is not None:
        given = np.array(_sized(umb.choice_to_choice_action, choices, "actions"), dtype=np.int64)
        if given.max(initial=0) >= count or len(names) != count:
            raise _damaged(
                f"{len(names)} names for {count} actions, or an action beyond them", "actions"
            )
    return given, names


def _sizes(system: Any) -> dict[str, int]:
    return {each: getattr(system, f"num_{each}") for each in ("states", "choices", "branches")}


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
    """Return values; raises ModelError unless they are numbers, as many as the index says."""
    if len(values) != count:
        raise _damaged(f"{len(values):,} values, not {count:,}", where)
    interval = _umbi().datatypes.Interval
    if any(isinstance(value, interval) for value in values):
        raise ModelError(
            "an interval is not a single number",
            where=where,
            fix="give a model without intervals or parameters",
        )
    return values


def _offsets(given: Sequence[int] | None, where: str, size: int, end: int) -> Integers:
    """Return size+1 offsets from 0 to `end`; one each where none are given."""
    offsets = list(range(size + 1)) if given is None else list(given)
    falls = any(after < before for before, after in pairwise(offsets))
    if len(offsets) != size + 1 or offsets[0] != 0 or offsets[-1] != end or falls:
        raise _damaged(f"{len(offsets)} offsets that do not run from 0 to {end}", where)
    return np.array(offsets, dtype=np.int64)


def _damaged(what: str, where: str) -> ModelError:
    return ModelError(what, where=where, fix="write the file again")


# ---- writing -------------------------------------------------------------------------------------


def _umb_of(model: MDP) -> Any:
    umbi, table = _umbi(), model.table
    description, version = umbi.umb.index, umbi.version
    start = {state: weight for state, weight in model.start if weight > 0}
    kind, numbers = _typed(_ratios(table.weight, table.denominator, table.offsets))
    index = description.UmbIndex(
        format_version=version.__format_version__,
        format_revision=version.__format_revision__,
        file_data=description.FileData(tool="exact-mdp"),
        model_data=description.ModelData(name=model.name) if model.name else None,
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
    )
    umb = umbi.umb.ExplicitUmb(
        index=index,
        state_is_initial=[state in start for state in range(model.n_states)],
        state_to_choices=model.pair_offsets.tolist(),
        choice_to_branches=table.offsets.tolist(),
        branch_to_target=table.next.tolist(),
        branch_to_probability=numbers,
        choice_to_choice_action=model.pair_action.tolist(),
        choice_action_to_string=list(model.actions),
        annotations={"rewards": {}, "aps": {}, GROUP: {}},
    )
    _annotate(umb, "rewards", REWARD, "choices", _earned(table))
    if table.components is not None:
        for number, name in enumerate(model.component_names):
            values = _earned(table.earning_component(number))
            _annotate(umb, "rewards", f"{COMPONENT}{number}", "choices", values, alias=name)
    _annotate(umb, "aps", TERMINAL, "states", model.terminal.tolist())
    for number, (name, states) in enumerate(model.labels.items()):
        _annotate(umb, "aps", f"label-{number}", "states", states.tolist(), alias=name)
    chances = [start.get(state, Fraction(0)) for state in range(model.n_states)]
    archive = base64.b64encode(zlib.compress(npz.packed(model))).decode("ascii")
    _annotate(umb, GROUP, CARRIER, "states", chances, about=archive)
    _add_valuations(umb, model)
    return umb


def _annotate(
    umb: Any, group: str, key: str, over: str, values: Any, *, alias: str = "", about: str = ""
) -> None:
    """Add an annotation; an alias is its description too, and as an identifier its name."""
    kind, numbers = _typed(values)
    # The query language of PRISM and Storm knows no dots or hyphens in names.
    word = re.sub(r"\W", "_", alias) if alias else None
    taken = {entry.alias or other for other, entry in umb.index.annotations[group].items()}
    while word in taken:
        word = f"{word}_"
    umb.index.annotations[group][key] = _umbi().umb.index.AnnotationDescription(
        alias=word, description=about or alias or None, applies_to=[over], type=kind
    )
    umb.annotations[group][key] = {over: numbers}


def _typed(values: Sequence[Any]) -> tuple[Any, list[Any]]:
    """Return values with their type: truth values, doubles, or wide rationals."""
    umbi = _umbi()
    kind, numbers = umbi.datatypes.promote_scalars(values)
    bits = umbi.binary.max_num_bits_for_collection_element(numbers, kind)
    # Each half of a rational takes a multiple of 64 bits.
    wide = kind == umbi.datatypes.NumericPrimitiveType.RATIONAL
    return umbi.binary.SizedType(kind, 128 * -(-bits // 128) if wide else bits), numbers


def _ratios(top: Numbers, bottom: Numbers, offsets: Numbers) -> list[Any]:
    """Return top[i] / bottom[l] for the entries i of each pair l: Fractions, or floats."""
    if top.dtype == np.float64:
        return list(top.tolist())
    below = np.repeat(bottom, np.diff(offsets)).tolist()
    return [Fraction(a, b) for a, b in zip(top.tolist(), below, strict=True)]


def _earned(table: OutcomeTable) -> list[Any]:
    """Return the expected rewards of the pairs, exact where they follow from exact numbers."""
    each = np.arange(table.pairs + 1)
    if len(table.gain) == table.pairs:
        return _ratios(table.gain, table.gain_denominator, each)
    if np.float64 in (table.weight.dtype, table.gain.dtype):
        return list(table.expected_gain().tolist())
    return _ratios(*table.expected_gain_exact(), each)


def _add_valuations(umb: Any, model: MDP) -> None:
    """Add the columns of the states as 32-bit variables; a lone column is the state's number."""
    names, umbi = model.space.names, _umbi()
    if len(names) < 2 or len(set(names)) < len(names):
        return
    struct, whole = umbi.binary.StructType(), umbi.datatypes.NumericPrimitiveType.INT
    for name in names:
        struct.add_attribute(name, umbi.binary.SizedType(whole, 32))
    unique = len(model.space.extra) < 2
    described = umbi.umb.index.ValuationDescription(unique=unique, classes=[struct])
    values = zip(*(model.space.values(name).tolist() for name in names), strict=True)
    umb.index.valuations = {"states": described}
    umb.valuations = {"states": [dict(zip(names, each, strict=True)) for each in values]}
