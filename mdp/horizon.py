"""Episodes that stop after N steps: the model with the time written into its states.

    V_N(s) = 0,    V_t(s) = max over pairs l of s of  r(l) + γ Σ_s' P(l, s') V_{t+1}(s')

(Puterman, Markov Decision Processes, 1994, section 4.3.) A state of the new model is a time t and a
state s; every step leads from t to t + 1, and at t = N all is over, without a further reward. The
discount applies as before. That model has no cycles, so that whatever solves, proves, checks or
evaluates models does so here, exactly and at any discount. A policy that reads the state alone is
stationary; one that reads the time as well depends on time; both are policies of this one model.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from exact_mdp.mdp.components import ComponentTable
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.space import TIME, Column, StateSpace
from exact_mdp.mdp.table import (
    MOST_BYTES,
    NARROW,
    WIDE,
    Integers,
    Numbers,
    by_outcome,
    spans,
)
from exact_mdp.mdp.validate import Flags, Parts, counted


def by_time(model: Any, weights: Numbers, steps: int) -> Numbers:
    """Return (N, L) what pairs of `model.within(N)` have, by time and pair of the model itself.

    A terminal state keeps its first pair, with the number 1.
    """
    rows = _kept(model, model.pair_offsets, model.terminal)
    found = np.zeros((steps, model.n_pairs))
    found[:, model.pair_offsets[:-1][model.terminal]] = 1.0
    found[:, rows] = weights[: steps * len(rows)].reshape(steps, len(rows))
    return found


def _kept(model: Parts, offsets: Integers, terminal: Flags) -> Integers:
    """Return the pairs that each time but the last has.

    A terminal state stays one, whatever the time, and needs no more than one action.
    """
    kept = ~terminal[model.pair_state]
    kept[offsets[:-1][terminal]] = True
    return np.flatnonzero(kept[: offsets[_in_columns(model, terminal).regular]])


def unrolled(model: Parts, steps: object, *, offsets: Integers, terminal: Flags) -> dict[str, Any]:
    """Return the parts that change where episodes stop after N steps; see `MDP.within`.

    `offsets` (S+1,) says where the pairs of each state begin, `terminal` (S,) where all is over.
    """
    count, space = counted(steps, "horizon"), _in_columns(model, terminal)
    own, states = space.regular, model.n_states
    if TIME in space.names:
        raise ModelError(
            f"the model has a column {TIME!r} of its own",
            where="state space",
            fix="unroll the model that it was made from, or name that column differently",
        )
    table, first, known = model.table, offsets, model.component_table
    rows = _kept(model, offsets, terminal)
    lengths = np.diff(table.offsets)[rows]
    _check_size(model, own, count, int(lengths.sum()))
    chosen = spans(table.offsets[rows], table.offsets[rows + 1])

    def layers(values: Numbers, last: Numbers) -> Numbers:
        """Return what each of the times 0 … N-1 has, and what the last one has."""
        return np.concatenate([np.tile(values, count), last])

    def ending(name: str, values: Numbers) -> Numbers:
        one = name in ("weight", "denominator", "gain_denominator")
        return layers(values, np.full(states, int(one), dtype=values.dtype))

    by_pair = len(table.gain) == table.pairs
    layered = replace(
        table.mapped(
            lambda name, values: ending(name, values[rows]),
            lambda name, values: ending(name, values[chosen]),
        ),
        offsets=np.concatenate([[0], np.cumsum(layers(lengths, np.ones(states, np.int64)))]),
        next=_following(model, own, terminal, rows, chosen, count),
    )
    time = np.repeat(np.arange(count + 1), [*[len(rows)] * count, states])
    return {
        "table": layered if by_pair else by_outcome(layered),
        "pair_state": layers(model.pair_state[rows], np.arange(states)) + own * time,
        "pair_action": layers(model.pair_action[rows], model.pair_action[first[:-1]]),
        "space": StateSpace(
            columns=(Column(name=TIME, size=count + 1), *space.columns), extra=space.extra
        ),
        "start": tuple((s if s < own else s + own * count, weight) for s, weight in model.start),
        "component_table": None
        if known is None
        else ComponentTable(
            amount=np.concatenate(
                [
                    np.tile(known.amount[rows], (count, 1)),
                    np.zeros((states, known.amount.shape[1]), dtype=known.amount.dtype),
                ]
            ),
            denominator=layers(known.denominator[rows], np.ones(states, np.int64)),
        ),
        "time_limit": None,
        "labels": {
            name: np.append(np.tile(flags[:own], count + 1), flags[own:])
            for name, flags in model.labels.items()
        },
        "goal": None,  # every episode is over at time N
        "observations": None,  # a pair has one number of them, not one for each time
        "episodes": None,
    }


def _in_columns(model: Parts, terminal: Flags) -> StateSpace:
    """Return the model's states, in one plain column where the process goes on in an extra state.

    Extra states have no time; those in which all is over need none.
    """
    space = model.space
    if terminal[space.regular :].all() and space.columns:
        return space
    return StateSpace.plain(space.size, space.labels(range(space.size)))


def _check_size(model: Parts, own: int, count: int, outcomes: int) -> None:
    table = model.table
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


def _following(
    model: Parts, own: int, terminal: Flags, rows: Integers, chosen: Integers, count: int
) -> Numbers:
    """Return the next states: a step later, but in terminal states and at time N."""
    lengths = np.diff(model.table.offsets)[rows]
    after, time = model.table.next[chosen].astype(np.int64), np.arange(count)
    later = np.repeat(~terminal[model.pair_state[rows]], lengths).astype(np.int64)
    shift = np.where(after < own, own * (time[:, None] + later), own * count)
    found = np.concatenate([(after + shift).ravel(), np.arange(model.n_states) + own * count])
    return found.astype(np.int32) if own * (count + 1) + model.n_states < 2**31 else found
