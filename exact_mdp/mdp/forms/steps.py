"""Models whose rows and rewards depend on the time: one model for each step, of the same states.

The states are pairs of a time and a state, as in `within`: the rows of step t lead from time t to
time t + 1. At time N, after the last step, every episode is over.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np

from exact_mdp.mdp.build import FromArrays
from exact_mdp.mdp.components import with_components
from exact_mdp.mdp.errors import ModelError, require_list
from exact_mdp.mdp.questions.ending import NO_DATA
from exact_mdp.mdp.questions.origin import origin_of
from exact_mdp.mdp.space import TIME, Column, StateSpace
from exact_mdp.mdp.table import Integers, Numbers, OutcomeTable, Rows, make_ones

SAME = {
    "actions": "actions",
    "discount_exact": "discount",
    "sense": "sense",
    "component_names": "components",
    "events": "events",
    "space": "states",
}
"""The parts that the models of all steps have in common, with a word for each."""


class FromSteps(FromArrays):
    """Models of several steps, each with its own rows and rewards."""

    @classmethod
    def from_steps(cls, models: Iterable[Self]) -> Self:
        """Build an episode of N steps from N models of the same states: rows that depend on time.

        Parameters
        ----------
        models : iterable of N MDP
            The rows, rewards and labels of steps 0 … N-1. States, actions, discount, sense and
            components must be the same. The first has the start.

        Returns
        -------
        MDP
            With the states of `within(N)`: a policy may be an array (N, S) of actions.

        Raises
        ------
        ModelError
            Without models, for a model that differs from the first, and for a model that answers a
            question: ask it of the result.

        Examples
        --------
        >>> from exact_mdp import MDP, certify
        >>> risks = ["1/10", "2/10", "3/10"]
        >>> years = [
        ...     MDP.from_arrays([[[f"{10 - int(risk[0])}/10", risk], [0, 1]]], [1, 0])
        ...     for risk in risks
        ... ]
        >>> certify(MDP.from_steps(years)).start_value  # 1 + 9/10 + 9/10 · 8/10
        Fraction(131, 50)
        """
        listed = require_list(models, "models, one for each step")
        _require_same_states(listed)
        first, steps = listed[0], len(listed)
        space = first.space
        if space.extra or not space.columns:
            space = StateSpace.plain(space.size, space.labels(range(space.size)))
        size, floats = space.size, all(m.table.weight.dtype == np.float64 for m in listed)
        kept = _list_pairs_kept(listed)
        tables = [model.table.of_pairs(own) for model, own in zip(listed, kept, strict=True)]
        table = _join_tables([*tables, _stay_put(tables, size, floats)], size)
        owners = [
            model.pair_state[pairs] + size * time
            for time, (model, pairs) in enumerate(zip(listed, kept, strict=True))
        ]
        actions = [model.pair_action[pairs] for model, pairs in zip(listed, kept, strict=True)]
        parts = {
            "table": table,
            "pair_state": np.concatenate([*owners, np.arange(size) + size * steps]),
            "pair_action": np.concatenate([*actions, np.zeros(size, np.int64)]),
            "space": StateSpace(columns=(Column(name=TIME, size=steps + 1), *space.columns)),
            "labels": {
                name: np.concatenate([model.labels[name] for model in (*listed, listed[-1])])
                for name in first.labels
            },
            "time_limit": None,
            **NO_DATA,
        }
        return replace(first, **parts)


def _list_pairs_kept(models: Sequence[Any]) -> list[Integers]:
    """Return the pairs of each step; a state in which an episode is over from then on has one."""
    over, kept = np.ones(models[0].n_states, dtype=bool), list[Integers]()
    for model in reversed(models):
        over = over & model.over
        inside = ~over[model.pair_state]
        inside[model.pair_offsets[:-1][over]] = True
        kept.append(np.flatnonzero(inside))
    return kept[::-1]


def _require_same_states(models: Sequence[Any]) -> None:
    """Raise ModelError unless models can be the steps of one episode."""
    if not models:
        fix = "give a list of MDP, one for each step"
        raise ModelError("there is no model", where="models", fix=fix)
    first = models[0]
    for step, model in enumerate(models):
        where = f"models[{step}]"
        if not isinstance(model, FromSteps):
            raise ModelError(
                f"{type(model).__name__} is not an MDP", where=where, fix="give an MDP"
            )
        if origin_of(model) is not None or model.goal is not None or TIME in model.space.names:
            fix = "ask the question of the model that from_steps returns"
            raise ModelError("the model answers a question already", where=where, fix=fix)
        differ = [name for name in SAME if getattr(model, name) != getattr(first, name)]
        if model.labels.keys() != first.labels.keys():
            differ.append("labels")
        if differ:
            what = f"the model differs from the first in its {SAME.get(differ[0], 'labels')}"
            raise ModelError(what, where=where, fix="build all steps alike")


def _stay_put(tables: Sequence[OutcomeTable], size: int, floats: bool) -> OutcomeTable:
    """Return the table of the last time, when every state stays and earns nothing."""
    kind = np.float64 if floats else np.int64
    rows = Rows(
        offsets=np.arange(size + 1),
        next=np.arange(size),
        weight=np.ones(size, kind),
        denominator=make_ones(size),
    )
    earned = all(table.gain.dtype == np.float64 for table in tables)
    gain = np.zeros(size, np.float64 if earned else np.int64)
    table = OutcomeTable(rows=rows, gain=gain, gain_denominator=make_ones(size))
    if tables[0].components is None:
        return table
    parts = tables[0].components
    nothing = np.zeros(size, np.float64 if parts.dtype == np.float64 else np.int64)
    return with_components(table, [(nothing, make_ones(size))] * parts.shape[1])


def _join_tables(tables: Sequence[OutcomeTable], size: int) -> OutcomeTable:
    """Return the table of all steps; step t leads to the states from (t + 1) · size on."""
    last = len(tables) - 1
    following = [
        table.next.astype(np.int64) + size * min(step + 1, last)
        for step, table in enumerate(tables)
    ]
    lengths = np.concatenate([np.diff(table.offsets) for table in tables])
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    if all(table.weight.dtype == np.float64 for table in tables):
        rows = Rows(
            offsets=offsets, next=np.concatenate(following),
            weight=np.concatenate([table.weight for table in tables]),
            denominator=make_ones(len(lengths)),
            sound=all(table.rows.sound for table in tables),
        )  # fmt: skip
    else:
        pairs = [table.rows.integers for table in tables]
        weight, below = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
        rows = Rows(
            offsets=offsets, next=np.concatenate(following), weight=weight, denominator=below
        )
    gain, under = _join_rewards(tables)
    joined = OutcomeTable(rows=rows, gain=gain, gain_denominator=under)
    if tables[0].components is None:
        return replace(joined, averaged=any(table.averaged for table in tables))
    columns = [
        _join_rewards([table.with_component_reward(number) for table in tables])
        for number in range(tables[0].components.shape[1])
    ]
    averaged = any(table.averaged for table in tables)
    return replace(with_components(joined, columns), averaged=averaged)


def _join_rewards(tables: Sequence[OutcomeTable]) -> tuple[Numbers, Numbers]:
    """Return the rewards of all tables: by pair, or by outcome if one table has them so."""
    by_outcome = any(len(table.gain) != table.pairs for table in tables)
    floats = all(table.gain.dtype == np.float64 for table in tables)
    gains, belows = [], []
    for table in tables:
        gain, below = table.gain, table.gain_denominator
        if not floats:
            gain, below = table.integer_gains
        if by_outcome and len(gain) == table.pairs:
            gain = gain[table.pair]
        gains.append(gain)
        belows.append(below)
    return np.concatenate(gains), np.concatenate(belows)
