"""From a scenario to its explicit transition matrix, exactly, without a loop over states.

All subtasks share a few block templates (inside a task, last of its task, last of all), which are
laid down one after the other. States are numbered so that every transition leads to a higher
number; the end comes last. A model with one block of each kind is built and checked row by row;
where blocks repeat, the whole model is laid out from the rows of that one.
"""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from mdp.blocks import Template, joined
from mdp.explicit_size import check_explicit
from mdp.laws import status_kernels
from mdp.model import MDP
from mdp.rules import kinds
from mdp.scenario import SKIP
from mdp.table import Integers, Numbers, OutcomeTable, integers

if TYPE_CHECKING:
    from mdp.scenario import Scenario


def compile_scenario(scenario: Scenario) -> MDP:
    """Return the explicit model of a scenario, without a warning; see `Scenario.compile`."""
    check_explicit(scenario)
    template = Template(scenario, status_kernels(scenario))
    places = kinds(scenario)
    # One block of each kind is itself a model.
    used = np.unique(places)
    small = _model(scenario, template, used)
    if np.array_equal(places, used):
        return small
    return _repeated(scenario, template, small, np.searchsorted(used, places))


def _model(scenario: Scenario, template: Template, places: Integers) -> MDP:
    """Return the checked model of blocks of the kinds `places` (K,), one after the other."""
    blocks = [template.block(last=kind > 0, final=kind == 2) for kind in places.tolist()]
    end = len(blocks) * template.size
    dtype = np.int32 if end < 2**31 - 1 else np.int64
    relative = [rows.next + i * template.size for i, rows in enumerate(blocks)]
    lengths = np.concatenate([*(rows.lengths for rows in blocks), [1]])
    state, action = template.pairs()
    table = OutcomeTable(
        offsets=np.concatenate([[0], np.cumsum(lengths)]),
        next=np.concatenate([*relative, [end]]).astype(dtype),
        weight=joined([rows.weight for rows in blocks], 1),
        denominator=joined([rows.denominator for rows in blocks], 1),
        gain=joined([rows.gain for rows in blocks], 0),
        gain_denominator=_same(template.scale, len(lengths)),
        event=np.concatenate([*(rows.event for rows in blocks), np.zeros(1, dtype=np.uint8)]),
    )
    starts = np.arange(len(blocks))[:, None] * template.size
    return MDP(
        table,
        np.append((starts + state).reshape(-1), end),
        np.append(np.tile(action, len(blocks)), 0),
        space=template.space(scenario.with_(tasks=[len(blocks)])),
        actions=template.actions,
        discount_exact=scenario.discount,
        component_names=scenario.components,
        components=np.concatenate(
            [*(rows.components for rows in blocks), np.zeros((1, len(scenario.components)))]
        ),
        events=(SKIP,),
        name=scenario.name,
        parameters=scenario.parameters,
    )


def _repeated(scenario: Scenario, template: Template, small: MDP, order: Integers) -> MDP:
    """Return the model of the blocks of `small` in the given order (K,), each a number there.

    Its rows are those of `small`, which were checked there, at other places.
    """
    count, size, table, matrix = len(order), template.size, small.table, small.transition
    end = count * size
    starts = np.append(np.arange(order.max() + 1) * size, small.n_states - 1)
    rows = small.pair_offsets[starts]
    shifts = (np.arange(count) - order) * size
    # Runs of blocks of one kind, laid down at once.
    first = np.flatnonzero(np.diff(order, prepend=-1))
    runs = list(zip(first.tolist(), [*first[1:].tolist(), count], strict=True))

    def lay(values: Numbers, cuts: Numbers, *, moved: bool = False) -> Numbers:
        """Repeat blocks of `values`, which `cuts` (kinds + 1,) delimit; add the shifts to states"""
        counts = np.diff(cuts)
        total = int(counts[order].sum()) + len(values) - int(cuts[-1])
        wide = np.int64 if moved and end >= 2**31 - 1 else values.dtype
        laid, at = np.empty((total, *values.shape[1:]), dtype=wide), 0
        for begin, stop in runs:
            kind, times = order[begin], stop - begin
            block = values[cuts[kind] : cuts[kind + 1]]
            place = laid[at : at + times * len(block)].reshape(times, *block.shape)
            if moved:
                np.add(block, shifts[begin:stop, None].astype(wide), out=place)
            else:
                place[:] = block
            at += times * len(block)
        laid[at:] = end if moved else values[cuts[-1] :]
        return laid

    def ends(lengths: Numbers, cuts: Numbers) -> Integers:
        return np.concatenate([[0], np.cumsum(lay(lengths, cuts), dtype=np.int64)])

    outcomes, entries = table.offsets[rows], matrix.indptr[rows]
    following = lay(table.next, outcomes, moved=True)
    indptr = ends(np.diff(matrix.indptr), rows)
    merged = len(matrix.indices) < len(table.next)
    indices = lay(matrix.indices, entries, moved=True) if merged else following
    parts: dict[str, Any] = {field.name: getattr(small, field.name) for field in fields(MDP)}
    parts |= {
        "table": OutcomeTable(
            offsets=ends(np.diff(table.offsets), rows) if merged else indptr,
            next=following,
            weight=lay(table.weight, outcomes),
            denominator=lay(table.denominator, rows),
            gain=lay(table.gain, outcomes),
            gain_denominator=_same(template.scale, len(indptr) - 1),
            event=None if table.event is None else lay(table.event, outcomes),
        ),
        "space": template.space(scenario),
        "pair_state": lay(small.pair_state, rows, moved=True),
        "pair_action": lay(small.pair_action, rows),
        "pair_offsets": ends(np.diff(small.pair_offsets), starts),
        "components": lay(small.components, rows),
        "reward": lay(small.reward, rows),
    }
    if indptr[-1] < 2**31 - 1:
        indptr = indptr.astype(indices.dtype)
    shape = (len(indptr) - 1, end + 1)
    parts["transition"] = sp.csr_array((lay(matrix.data, entries), indices, indptr), shape)
    parts["transition"].has_canonical_format = True
    vars(parts["table"])["sums_to_one"] = table.sums_to_one
    mdp = object.__new__(MDP)
    mdp.__setstate__(parts)
    return mdp


def _same(value: int, count: int) -> Numbers:
    """Return (count,) times one integer, in the memory of one."""
    return np.asarray(np.broadcast_to(integers([value]), (count,)))
