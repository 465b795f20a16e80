"""The arrays of a model for compiled loops, and the rows of a Q-table that its states read.

A learner that reads only some of the state's columns shares one row of its Q-table among all states
that agree in them. The end of a scenario has no columns and reads the first row: the row of status
0000, in which a completed subtask ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.random import SeedSequence
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import rows_read, space_over
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Integers, Numbers
from exact_mdp.mdp.validate import RNG, seed_of

if TYPE_CHECKING:
    from exact_mdp.solvers.kernels.learning import SamplingTables


Seed: TypeAlias = RNG | SeedSequence


@dataclass(frozen=True, kw_only=True, eq=False)
class QTableRows:
    """Rows of a Q-table, by the columns of the state that it reads."""

    space: StateSpace  # the meaning of each of the K rows
    key: Integers  # (S,) the row that each state reads
    # (K, A) the actions compared in each row: the actions of its states with a choice, or of all
    # its states if none has a choice.
    offered: NDArray[np.bool_]


def build_q_table_rows(mdp: MDP, columns: Sequence[str] | None = None) -> QTableRows:
    """Return the rows of a Q-table that reads `columns` of the state.

    By default these are the status alone if the model has one, else all columns. States with a
    choice that share a row must offer the same actions.
    """
    names = mdp.space.names
    if columns is None:
        columns = names
        if "status" in names:
            columns = ("status",)
    space = space_over(mdp, tuple(columns))
    key = rows_read(mdp, space)
    # The actions of each state, and of each row: all states with a choice have to agree.
    mine = np.zeros((mdp.n_states, mdp.n_actions), dtype=bool)
    mine[mdp.pair_state, mdp.pair_action] = True
    offered = np.zeros((space.size, mdp.n_actions), dtype=bool)
    free = ~mdp.forced
    np.logical_or.at(offered, key[free], mine[free])
    unlike = free & (mine != offered[key]).any(axis=1)
    if unlike.any():
        raise ModelError(
            "states that share a row of the Q-table offer different actions",
            where=mdp.space.place(int(np.flatnonzero(unlike)[0])),
            fix=f"read more columns: {', '.join(names)}",
        )
    # Rows without such a state get the actions of all their states; rows that no state reads, one.
    inside = np.logical_not(offered.any(axis=1))[key]
    np.logical_or.at(offered, key[inside], mine[inside])
    offered[~offered.any(axis=1), 0] = True
    return QTableRows(space=space, key=key, offered=offered)


def build_sampling_tables(mdp: MDP, rows: QTableRows) -> SamplingTables:
    """Return the model as flat arrays for `solvers.kernels`."""
    table = mdp.table
    cut = np.empty(len(table.next))
    alias, small, large = np.empty((3, len(table.next)), dtype=np.int64)
    offsets = np.ascontiguousarray(table.offsets, dtype=np.int64)
    from exact_mdp.solvers.kernels import learning as kernels

    # Each column has two sides: its own outcome and its alias.
    kernels.alias_tables(offsets, table.compute_probabilities(), cut, alias, small, large)
    sides = np.stack([np.arange(len(alias)), alias], axis=1).reshape(-1)
    # The entries that each state compares; terminal states get positions behind all pairs.
    low, high = mdp.pair_offsets[:-1].copy(), mdp.pair_offsets[1:].copy()
    row, action = np.nonzero(rows.offered)
    row_offsets = np.searchsorted(row, np.arange(len(rows.offered) + 1))
    row_entry = row * mdp.n_actions + action
    entry = [rows.key[mdp.pair_state] * mdp.n_actions + mdp.pair_action]
    total = mdp.n_pairs
    for state in np.flatnonzero(mdp.terminal):
        at = rows.key[state]
        entry.append(row_entry[row_offsets[at] : row_offsets[at + 1]])
        low[state], high[state] = total, total + len(entry[-1])
        total += len(entry[-1])
    starts = [state for state, weight in mdp.start if weight]
    weights = [float(weight) for _, weight in mdp.start if weight]
    return kernels.SamplingTables(
        low=low,
        high=high,
        entry=np.concatenate(entry),
        offsets=offsets,
        cut=cut,
        next=table.next[sides].astype(np.int64),
        gain=table.compute_gains()[sides],
        terminal=np.array(mdp.terminal),
        start=np.array(starts, dtype=np.int64),
        start_total=np.cumsum(weights),
        row_offsets=row_offsets.astype(np.int64),
        row_entry=row_entry.astype(np.int64),
    )


def make_random_stream(rng: Seed) -> Numbers:
    """Return the (4,) uint64 state of a random stream; 0 is a seed like any other."""
    return as_sequence(rng).generate_state(4, np.uint64)


def as_sequence(rng: Seed) -> SeedSequence:
    """Return the seed sequence of an integer or a generator, or the given sequence."""
    if isinstance(rng, SeedSequence):
        return rng
    return SeedSequence(seed_of(rng))


def spawn_child_seed(rng: Seed, number: int) -> SeedSequence:
    """Return the child `number` of `SeedSequence.spawn`, without changing the parent's count."""
    parent = as_sequence(rng)
    return SeedSequence(parent.entropy, spawn_key=(*parent.spawn_key, number))
