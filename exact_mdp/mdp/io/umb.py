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
import gzip
import io
import re
import tarfile
import zlib
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, extra, located, shown_text
from exact_mdp.mdp.io import npz
from exact_mdp.mdp.io.explicit import REWARD, Explicit, identifier, model_of
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.io.umb_read import read
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import (
    Numbers,
)

TERMINAL, COMPONENT = "terminal", "component-"
GROUP, CARRIER = "exact-mdp", "start"
WRITTEN = {
    "state_is_initial": "the initial states",
    "state_to_choices": "the choices of states",
    "choice_to_branches": "the branches of choices",
    "branch_to_target": "where branches lead",
    "branch_to_probability": "the probabilities",
    "choice_to_choice_action": "the actions of choices",
    "choice_action_to_string": "the names of the actions",
    "annotations": "the rewards or the labels",
}
"""What has to be as it was written, where a file is of exact-mdp."""


def save(model: MDP, path: str | Path) -> None:
    """Write a model as a UMB file, from which `load` returns all of it.

    Examples
    --------
    >>> import tempfile
    >>> mdp = MDP.from_outcomes([(0, 0, [("1/3", 0, "1/7"), ("2/3", 1, 0)]), (1, 0, [(1, 1, 0)])])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save(mdp, f"{folder}/small.umb")
    ...     load(f"{folder}/small.umb").table.row(0)
    [(Fraction(1, 3), 0, Fraction(1, 7)), (Fraction(2, 3), 1, Fraction(0, 1))]
    """
    write_atomically(path, _archive_of(model))


def load(
    path: str | Path,
    *,
    discount: object | None = None,
    reward: str | None = None,
    start: object = None,
) -> MDP:
    """Read a Markov chain or decision process from a UMB file.

    `discount` stands instead of the model's own. The format has none: where another program wrote
    the file, it is 1 unless it is given, and a warning says so. `reward` names a reward model,
    whose rewards of states, choices and branches add up. Unless it is named, the one called
    "reward" counts, or the sum of all, which are its components; without any, rewards are 0.
    `start` is a state or {state: probability}; unless it is given, the file's only initial state,
    or its first, with a warning. Where there are several, they have the label `init`.

    Raises ModelError where the file cannot be read, is damaged, or holds a model of another kind:
    in continuous time, of several players, partially observable, with intervals for probabilities.
    """
    with located(str(path)):
        umb, content = read(path)
        own = (umb.index.annotations or {}).get(GROUP, {}).get(CARRIER)
        if own is not None and own.description:
            mdp = _restored(umb, content, own.description, reward)
            mdp = mdp if discount is None else mdp.with_(discount=discount)
            return mdp if start is None else mdp.with_(start=start)
        named = replace(content, name=content.name or Path(path).stem)
        where = shown_text(str(path))
        return model_of(named, where, reward=reward, discount=discount, start=start)


def _restored(umb: Any, content: Explicit, packed: str, reward: str | None) -> MDP:
    """Return a model that exact-mdp wrote, with everything that the format has no place for."""
    where = f"annotations/{GROUP}/{CARRIER}"
    with located(where):
        try:
            archive = zlib.decompress(base64.b64decode(packed, validate=True))
        except (ValueError, zlib.error) as error:
            raise ModelError("the description is damaged", fix="save the model again") from error
        mdp = npz.unpacked(archive)
    written = _umb_of(mdp)
    for name, what in WRITTEN.items():
        if getattr(umb, name) != getattr(written, name):
            raise ModelError(
                f"another program changed {what}",
                where=where,
                fix=f"drop the annotations of group {GROUP}, which no longer describe the model",
            )
    chosen = identifier(content, REWARD if reward is None else reward)
    if chosen == REWARD or mdp.component_table is None:
        return mdp
    gain, below = mdp.component_table.column(int(chosen.removeprefix(COMPONENT)))
    table = replace(mdp.table, gain=gain, gain_denominator=below)
    title = content.titles["rewards"][chosen]
    return replace(mdp, table=table, component_table=None, component_names=(title,))


# ---- writing -------------------------------------------------------------------------------------


def _archive_of(model: MDP) -> bytes:
    """Return the gzipped archive; the same model gives the same bytes."""
    with extra("models"):
        from umbi.umb import umb_to_tar as encoding
    encoder, umb = encoding.UmbEncoder(), _umb_of(model)
    encoder.add_index_file(umb)
    encoder.add_state_files(umb)
    encoder.add_transition_files(umb)
    encoder.add_annotation_files(umb)
    if umb.index.valuations is not None:
        # 32-bit integers in a row need no packing of bits.
        columns = [model.space.values(name) for name in model.space.names]
        values = np.stack(columns, axis=1).astype("<i4").tobytes()
        encoder.add_file("valuations/states/valuations.bin", values)
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name, data in encoder.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return gzip.compress(stream.getvalue(), mtime=0)


def _umb_of(model: MDP) -> Any:
    with extra("models"):
        from umbi import umb as umb_package
        from umbi import version
        from umbi.umb import index as description
    table = model.table
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
        valuations=_valuations(model),
    )
    umb = umb_package.ExplicitUmb(
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
    _annotate(umb, "rewards", REWARD, "choices", _expected(model))
    known = model.component_table
    if known is not None:
        for number, name in enumerate(model.component_names):
            each = np.arange(model.n_pairs + 1)
            values = _ratios(known.amount[:, number], known.denominator, each)
            _annotate(umb, "rewards", f"{COMPONENT}{number}", "choices", values, alias=name)
    _annotate(umb, "aps", TERMINAL, "states", model.terminal.tolist())
    for number, (name, states) in enumerate(model.labels.items()):
        _annotate(umb, "aps", f"label-{number}", "states", states.tolist(), alias=name)
    chances = [start.get(state, Fraction(0)) for state in range(model.n_states)]
    archive = base64.b64encode(zlib.compress(npz.packed(model))).decode("ascii")
    _annotate(umb, GROUP, CARRIER, "states", chances, about=archive)
    return umb


def _annotate(
    umb: Any,
    group: str,
    key: str,
    over: str,
    values: Sequence[Any],
    *,
    alias: str = "",
    about: str = "",
) -> None:
    """Add an annotation; an alias is its description too, and as an identifier its name."""
    with extra("models"):
        from umbi.umb import index as description
    kind, numbers = _typed(values)
    # The query language of PRISM and Storm knows no dots or hyphens in names.
    word = re.sub(r"\W", "_", alias) if alias else None
    taken = {entry.alias or other for other, entry in umb.index.annotations[group].items()}
    while word in taken:
        word = f"{word}_"
    umb.index.annotations[group][key] = description.AnnotationDescription(
        alias=word, description=about or alias or None, applies_to=[over], type=kind
    )
    umb.annotations[group][key] = {over: numbers}


def _typed(values: Sequence[Any]) -> tuple[Any, list[Any]]:
    """Return values with their type: truth values, small integers, doubles, or wide rationals."""
    with extra("models"):
        from umbi import binary, datatypes
    kinds, numeric = set(map(type, values)), datatypes.NumericPrimitiveType
    if kinds <= {bool}:
        return binary.SizedType(datatypes.PrimitiveType.BOOL, 1), list(values)
    if kinds == {float}:
        return binary.SizedType(numeric.DOUBLE, 64), list(values)
    if kinds == {int}:
        return binary.SizedType(numeric.UINT, 64), list(values)
    rationals = [Fraction(value) for value in values]
    # The numerator is signed; each half of a rational takes a multiple of 64 bits.
    bits = max(max(x.numerator.bit_length() + 1, x.denominator.bit_length()) for x in rationals)
    return binary.SizedType(numeric.RATIONAL, 128 * -(-bits // 64)), rationals


def _ratios(top: Numbers, bottom: Numbers, offsets: Numbers) -> list[Any]:
    """Return top[i] / bottom[l] for the entries i of each pair l: Fractions, or floats."""
    if top.dtype == np.float64:
        return list(top.tolist())
    below = np.repeat(bottom, np.diff(offsets)).tolist()
    return [Fraction(a, b) for a, b in zip(top.tolist(), below, strict=True)]


def _expected(model: MDP) -> list[Any]:
    """Return the expected rewards of the pairs, exact where they follow from exact numbers."""
    table = model.table
    each = np.arange(model.n_pairs + 1)
    if len(table.gain) == model.n_pairs:
        return _ratios(table.gain, table.gain_denominator, each)
    if np.float64 in (table.weight.dtype, table.gain.dtype):
        return list(model.reward.tolist())
    return _ratios(*table.expected_gain_exact(), each)


def _valuations(model: MDP) -> dict[str, Any] | None:
    """Return the columns of the states as 32-bit variables; a lone column is the state's number."""
    with extra("models"):
        from umbi import binary, datatypes
        from umbi.umb import index as description
    names = model.space.names
    if len(names) < 2 or len(set(names)) < len(names):
        return None
    struct = binary.StructType()
    for name in names:
        struct.add_attribute(name, binary.SizedType(datatypes.NumericPrimitiveType.INT, 32))
    unique = len(model.space.extra) < 2
    return {"states": description.ValuationDescription(unique=unique, classes=[struct])}
