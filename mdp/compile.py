"""From a scenario to its explicit transition matrix, exactly, without a loop over states.

All subtasks share a few block templates (inside a task, last of its task, last of all), which are
laid down one after the other. States are numbered so that every transition leads to a higher
number; the end comes last.
"""

from __future__ import annotations

from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np

from mdp.blocks import Template, joined
from mdp.laws import status_kernels
from mdp.model import MDP
from mdp.scenario import SKIP
from mdp.space import Column, StateSpace
from mdp.table import OutcomeTable, integers

if TYPE_CHECKING:
    from mdp.scenario import Scenario


def compile_scenario(scenario: Scenario) -> MDP:
    """Return the explicit model of a scenario; see `Scenario.compile`."""
    template = Template(scenario, status_kernels(scenario))
    last = list(accumulate(scenario.tasks))
    count = last[-1]
    kinds = np.zeros(count, dtype=np.int64)
    kinds[np.array(last) - 1] = 1
    kinds[-1] = 2
    built = {kind: template.block(last=kind > 0, final=kind == 2) for kind in set(kinds.tolist())}
    blocks = [built[kind] for kind in kinds.tolist()]
    end = count * template.size
    dtype = np.int32 if end < 2**31 - 1 else np.int64

    relative = {kind: rows.next.astype(dtype) for kind, rows in built.items()}
    following = np.concatenate([*(relative[kind] for kind in kinds.tolist()), np.zeros(1, dtype)])
    per_block = [len(rows.next) for rows in blocks]
    shift = (np.arange(count) * template.size).astype(dtype)
    following[:-1] += np.repeat(shift, per_block)
    following[-1] = end
    lengths = np.concatenate([*(rows.lengths for rows in blocks), [1]])
    pairs = len(lengths)
    state, action = template.pairs()
    gain_denominator = np.broadcast_to(integers([template.scale]), (pairs,))
    table = OutcomeTable(
        offsets=np.concatenate([[0], np.cumsum(lengths)]),
        next=following,
        weight=joined([rows.weight for rows in blocks], 1),
        denominator=joined([rows.denominator for rows in blocks], 1),
        gain=joined([rows.gain for rows in blocks], 0),
        gain_denominator=np.asarray(gain_denominator),
        event=np.concatenate([*(rows.event for rows in blocks), np.zeros(1, dtype=np.uint8)]),
    )
    return MDP(
        table,
        np.append((np.arange(count)[:, None] * template.size + state).reshape(-1), end),
        np.append(np.tile(action, count), 0),
        space=_space(scenario, template),
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


def _space(scenario: Scenario, template: Template) -> StateSpace:
    columns = [
        Column(name="subtask", size=sum(scenario.tasks)),
        Column(name="trial", size=template.trials + template.own),
        Column(name="status", size=template.vectors, bits=len(scenario.statuses)),
    ]
    if template.flags == 2:
        columns.insert(2, Column(name="skipped", size=2))
    return StateSpace(columns=tuple(columns), extra=("end",))
