"""A model as the bytes of a UMB file; see `mdp.io.umb` for what goes where."""

from __future__ import annotations

import gzip
import io
import json
import re
import tarfile
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np

from exact_mdp.mdp.io.npz import as_header
from exact_mdp.mdp.io.umb_read import (
    CARRIER,
    DOUBTS,
    GROUP,
    REWARD,
    component_key,
    key_of,
    needs_umbi,
)
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Numbers

TERMINAL = "terminal"


def archive_of(mdp: MDP) -> bytes:
    """Return the gzipped archive; the same model gives the same bytes."""
    try:
        import umbi.umb.umb_to_tar as encoding
    except ImportError as error:
        raise needs_umbi() from error
    encoder, umb = encoding.UmbEncoder(), _umb_of(mdp)
    encoder.add_index_file(umb)
    encoder.add_state_files(umb)
    encoder.add_transition_files(umb)
    encoder.add_annotation_files(umb)
    if umb.index.valuations is not None:
        # 32-bit integers in a row need no packing of bits.
        columns = [mdp.space.values(name) for name in mdp.space.names]
        values = np.stack(columns, axis=1).astype("<i4").tobytes()
        encoder.add_file("valuations/states/valuations.bin", values)
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name, data in encoder.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return gzip.compress(stream.getvalue(), mtime=0)


def _umb_of(mdp: MDP) -> Any:
    import umbi.umb as umb_package
    import umbi.umb.index as description
    import umbi.version

    table = mdp.table
    start = {state: weight for state, weight in mdp.start if weight > 0}
    probability = _ratios(table.weight, table.denominator, table.offsets)
    kind, numbers = _typed(probability)
    index = description.UmbIndex(
        format_version=umbi.version.__format_version__,
        format_revision=umbi.version.__format_revision__,
        file_data=description.FileData(tool="exact-mdp"),
        model_data=description.ModelData(name=mdp.name) if mdp.name else None,
        transition_system=description.TransitionSystem(
            time="discrete",
            num_players=1,
            num_states=mdp.n_states,
            num_initial_states=len(start),
            num_choices=mdp.n_pairs,
            num_choice_actions=mdp.n_actions,
            num_branches=len(table.next),
            branch_probability_type=kind,
        ),
        annotations={"rewards": {}, "aps": {}, GROUP: {}},
        valuations=_valuations(mdp),
    )
    umb = umb_package.ExplicitUmb(
        index=index,
        state_is_initial=[state in start for state in range(mdp.n_states)],
        state_to_choices=mdp.pair_offsets.tolist(),
        choice_to_branches=table.offsets.tolist(),
        branch_to_target=table.next.tolist(),
        branch_to_probability=numbers,
        choice_to_choice_action=mdp.pair_action.tolist(),
        choice_action_to_string=list(mdp.actions),
        annotations={"rewards": {}, "aps": {}, GROUP: {}},
    )
    _annotate(umb, "rewards", REWARD, "choices", _expected(mdp))
    # A lone component of the usual name is the reward itself.
    if mdp.component_names != (REWARD,) or (mdp.components[:, 0] != mdp.reward).any():
        for number, name in enumerate(mdp.component_names):
            values = mdp.components[:, number].tolist()
            _annotate(umb, "rewards", component_key(number), "choices", values, alias=name)
    _annotate(umb, "aps", TERMINAL, "states", mdp.terminal.tolist())
    chances = [start.get(state, Fraction(0)) for state in range(mdp.n_states)]
    header = json.dumps(as_header(mdp))
    _annotate(umb, GROUP, CARRIER, "states", chances, description=header)
    if len(table.gain) != mdp.n_pairs:
        gains = _ratios(table.gain, table.gain_denominator, table.offsets)
        _annotate(umb, GROUP, "gain", "branches", gains)
    if table.event is not None:
        _annotate(umb, GROUP, "event", "branches", table.event.tolist())
    for name in DOUBTS:
        values = getattr(table, name)
        if values is not None:
            over = "choices" if len(values) == mdp.n_pairs else "branches"
            _annotate(umb, GROUP, key_of(name), over, values.tolist())
    return umb


def _annotate(
    umb: Any,
    group: str,
    key: str,
    over: str,
    values: Sequence[Any],
    *,
    alias: str = "",
    description: str = "",
) -> None:
    """Add an annotation; an alias is its description too, and as an identifier its name."""
    from umbi.umb.index import AnnotationDescription

    kind, numbers = _typed(values)
    # The query language of PRISM and Storm knows no dots or hyphens in names.
    word = re.sub(r"\W", "_", alias) if alias else None
    taken = {entry.alias or other for other, entry in umb.index.annotations[group].items()}
    while word in taken:
        word = f"{word}_"
    umb.index.annotations[group][key] = AnnotationDescription(
        alias=word, description=description or alias or None, applies_to=[over], type=kind
    )
    umb.annotations[group][key] = {over: numbers}


def _typed(values: Sequence[Any]) -> tuple[Any, list[Any]]:
    """Return truth values and small integers as they are, floats as doubles, others as rationals
    wide enough."""
    from umbi.binary import SizedType
    from umbi.datatypes import NumericPrimitiveType, PrimitiveType

    if all(isinstance(value, bool) for value in values):
        return SizedType(PrimitiveType.BOOL, 1), list(values)
    if all(isinstance(value, float) for value in values):
        return SizedType(NumericPrimitiveType.DOUBLE, 64), list(values)
    if all(isinstance(value, int) for value in values):
        return SizedType(NumericPrimitiveType.UINT, 64), list(values)
    rationals = [Fraction(value) for value in values]
    # The numerator is signed; each half of a rational takes a multiple of 64 bits.
    bits = max(max(x.numerator.bit_length() + 1, x.denominator.bit_length()) for x in rationals)
    return SizedType(NumericPrimitiveType.RATIONAL, 128 * -(-bits // 64)), rationals


def _ratios(top: Numbers, bottom: Numbers, offsets: Numbers) -> list[Any]:
    """Return top[i] / bottom[l] for the entries i of each pair l: Fractions, or floats."""
    if top.dtype == np.float64:
        return [float(value) for value in top]
    values, denominators = top.tolist(), bottom.tolist()
    return [
        Fraction(values[i], denominators[pair])
        for pair, (first, last) in enumerate(pairwise(offsets.tolist()))
        for i in range(first, last)
    ]


def _expected(mdp: MDP) -> list[Any]:
    """Return the expected rewards of the pairs, exact where they follow from exact numbers."""
    table = mdp.table
    if len(table.gain) == mdp.n_pairs:
        return _ratios(table.gain, table.gain_denominator, np.arange(mdp.n_pairs + 1))
    if mdp.table.weight.dtype == np.float64 or mdp.table.gain.dtype == np.float64:
        return [float(value) for value in mdp.reward]
    top, bottom = mdp.table.expected_gain_exact()
    return [Fraction(a, b) for a, b in zip(top.tolist(), bottom.tolist(), strict=True)]


def _valuations(mdp: MDP) -> dict[str, Any] | None:
    """Return the columns of the states as 32-bit variables; a lone column is the state's number."""
    names = mdp.space.names
    if len(names) < 2 or len(set(names)) < len(names):
        return None
    from umbi.binary import SizedType, StructType
    from umbi.datatypes import NumericPrimitiveType
    from umbi.umb.index import ValuationDescription

    struct = StructType()
    for name in mdp.space.names:
        struct.add_attribute(name, SizedType(NumericPrimitiveType.INT, 32))
    return {"states": ValuationDescription(unique=len(mdp.space.extra) < 2, classes=[struct])}
