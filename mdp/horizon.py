"""Episodes that stop after N steps: the model with the time written into its states.

    V_N(s) = 0,    V_t(s) = max over pairs l of s of  r(l) + γ Σ_s' P(l, s') V_{t+1}(s')

(Puterman, Markov Decision Processes, 1994, section 4.3.) A state of the new model is a time t and a
state s; every step leads from t to t + 1, and at t = N all is over, without a further reward. The
discount applies as before. That model has no cycles, so that whatever solves, proves, checks or
evaluates models does so here, exactly and at any discount. A policy that reads the state alone is
stationary; one that reads the time as well depends on time; both are policies of this one model.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.space import TIME, Column, StateSpace
from exact_mdp.mdp.table import (
    MOST_BYTES,
    NARROW,
    WIDE,
    Integers,
    Numbers,
    OutcomeTable,
    by_outcome,
    spans,
)
from exact_mdp.mdp.validate import Model, counted


def unrolled(mdp: Model, steps: object) -> dict[str, Any]:
    """Return the parts that change where episodes stop after N steps; see `MDP.within`."""
    count, space = counted(steps, "horizon"), _in_columns(mdp)
    own, states, parts = space.regular, mdp.n_states, len(mdp.component_names)
    if TIME in space.names:
        raise ModelError(
            f"the model has a column {TIME!r} of its own",
            where="state space",
            fix="unroll the model that it was made from, or name that column differently",
        )
    table, first = mdp.table, mdp.pair_offsets
    # A terminal state stays one, whatever the time, and needs no more than one action.
    kept = ~mdp.terminal[mdp.pair_state]
    kept[first[:-1][mdp.terminal]] = True
    rows = np.flatnonzero(kept[: first[own]])
    _check_size(mdp, own, count, int(np.diff(table.offsets)[rows].sum()))
    chosen = spans(table.offsets[rows], table.offsets[rows + 1])
    lengths = np.diff(table.offsets)[rows]

    def per_pair(values: Numbers, final: int) -> Numbers:
        return _layers(values[rows], count, np.full(states, final, dtype=values.dtype))

    def per_outcome(values: Numbers, final: int) -> Numbers:
        return _layers(values[chosen], count, np.full(states, final, dtype=values.dtype))

    gain = per_pair if len(table.gain) == table.pairs else per_outcome
    ones = np.ones(states, dtype=np.int64)
    layered = OutcomeTable(
        offsets=np.concatenate([[0], np.cumsum(_layers(lengths, count, ones))]),
        next=_following(mdp, own, rows, chosen, count),
        weight=per_outcome(table.weight, 1),
        denominator=per_pair(table.denominator, 1),
        gain=gain(table.gain, 0),
        gain_denominator=per_pair(table.gain_denominator, 1),
        weight_doubt=None if table.weight_doubt is None else per_outcome(table.weight_doubt, 0),
        gain_doubt=None if table.gain_doubt is None else gain(table.gain_doubt, 0),
        event=None if table.event is None else per_outcome(table.event, 0),
    )
    time = np.repeat(np.arange(count + 1), [*[len(rows)] * count, states])
    return {
        "table": by_outcome(layered) if gain is per_outcome else layered,
        "pair_state": _layers(mdp.pair_state[rows], count, np.arange(states)) + own * time,
        "pair_action": _layers(mdp.pair_action[rows], count, mdp.pair_action[first[:-1]]),
        "space": StateSpace(
            columns=(Column(name=TIME, size=count + 1), *space.columns),
            extra=space.extra,
        ),
        "start": tuple((s if s < own else s + own * count, weight) for s, weight in mdp.start),
        "components": np.concatenate(
            [np.tile(mdp.components[rows], (count, 1)), np.zeros((states, parts))]
        ),
        "time_limit": None,
    }


def _in_columns(mdp: Model) -> StateSpace:
    """Return the model's states, in one plain column where the process goes on in an extra state.

    Extra states have no time; those in which all is over need none.
    """
    space = mdp.space
    if mdp.terminal[space.regular :].all() and space.columns:
        return space
    return StateSpace.plain(space.size, space.labels(range(space.size)))


def _check_size(mdp: Model, own: int, count: int, outcomes: int) -> None:
    table = mdp.table
    wide = object in (table.weight.dtype, table.gain.dtype, table.denominator.dtype)
    each, states = WIDE if wide else NARROW, own * (count + 1)
    most = outcomes * count + states
    if most * each > MOST_BYTES:
        raise ModelError(
            f"{count:,} steps of this model make {states:,} states and {most:,} outcomes of {each} "
            f"bytes each, more than {MOST_BYTES / 1e9:g} GB",
            where="horizon",
            fix="choose fewer steps, or none where the process ends by itself or the discount "
            "leaves late steps no weight",
        )


def _layers(values: Numbers, count: int, last: Numbers) -> Numbers:
    """Return what each of the times 0 … N-1 has, and what the last one has."""
    return np.concatenate([np.tile(values, count), last])


def _following(mdp: Model, own: int, rows: Integers, chosen: Integers, count: int) -> Numbers:
    """Return the next states: a step later, but in terminal states and at time N."""
    lengths = np.diff(mdp.table.offsets)[rows]
    after, time = mdp.table.next[chosen].astype(np.int64), np.arange(count)
    later = np.repeat(~mdp.terminal[mdp.pair_state[rows]], lengths).astype(np.int64)
    shift = np.where(after < own, own * (time[:, None] + later), own * count)
    found = np.concatenate([(after + shift).ravel(), np.arange(mdp.n_states) + own * count])
    return found.astype(np.int32) if own * (count + 1) + mdp.n_states < 2**31 else found
