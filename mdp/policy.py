"""Policies: what to do, by some of the state's named columns; deterministic or mixed.

A policy reads columns of the state (the status alone; status and trial; all of them) and gives
each action a probability. States with a single action (*skip*, the end) are outside its say:
that action is taken there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mdp.errors import ModelError, suggest
from mdp.model import MDP
from mdp.space import Column, StateSpace
from mdp.table import FLOAT_ROW_TOLERANCE, Floats, Integers, Numbers, float_array


@dataclass(frozen=True, kw_only=True, eq=False)
class Policy:
    """π(a | columns): one row of action probabilities for each combination of column values.

    Attributes
    ----------
    space : StateSpace
        The columns that the policy reads, in row-major order; its extra states are read as well
        where the policy is one over all states.
    actions : tuple of str
    table : (K, A) float
        Rows sum to 1; a row of NaN says nothing, which is an error only where it is asked.

    Examples
    --------
    >>> from mdp import Scenario
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> policy = Policy.of(mdp, "always:directive")
    >>> policy.weights(mdp)[:4]
    array([0., 0., 0., 1.])
    """

    space: StateSpace
    actions: tuple[str, ...]
    table: Floats

    def __post_init__(self) -> None:
        table = float_array(self.table).copy()
        if table.shape != (self.space.size, len(self.actions)):
            raise ModelError(
                f"a policy table of shape {table.shape}, not "
                f"({self.space.size}, {len(self.actions)})",
                where="policy",
                fix="give one row for each combination of the columns it reads",
            )
        silent = np.isnan(table).all(axis=1)
        wrong = ~silent & ~(
            (np.abs(table.sum(axis=1) - 1) <= FLOAT_ROW_TOLERANCE) & (table >= 0).all(axis=1)
        )
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise ModelError(
                f"action probabilities are {table[row].tolist()}, not a distribution",
                where=f"policy, {self.space.label(row)}",
                fix="make them at least 0, with sum 1",
            )
        table.setflags(write=False)
        object.__setattr__(self, "table", table)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that the policy reads."""
        return self.space.names

    @property
    def deterministic(self) -> bool:
        """True where every row has a single action."""
        return bool(((self.table == 1).any(axis=1) | np.isnan(self.table).all(axis=1)).all())

    def weights(self, mdp: MDP) -> Floats:
        """Return (L,) the probability of each pair given its state.

        Raises
        ------
        ModelError
            Where the policy says nothing of a state with a choice, or takes an action that the
            state does not offer.
        """
        keys = self._keys(mdp)
        numbers = np.array([mdp.action(name) for name in self.actions])
        by_action = np.zeros((self.space.size, mdp.n_actions))
        by_action[:, numbers] = self.table
        weights = by_action[keys[mdp.pair_state], mdp.pair_action]
        weights[mdp.forced[mdp.pair_state]] = 1.0
        total = np.add.reduceat(weights, mdp.pair_offsets[:-1])
        bad = ~(np.abs(total - 1) <= FLOAT_ROW_TOLERANCE)
        if bad.any():
            state = int(np.flatnonzero(bad)[0])
            missing = bool(np.isnan(total[state]))
            offered = [mdp.actions[mdp.pair_action[pair]] for pair in mdp.pairs_of(state)]
            raise ModelError(
                "the policy says nothing of a state with a choice"
                if missing
                else "the policy takes an action that is not available",
                where=f"state ({mdp.space.label(state)})",
                fix=f"choose one of {', '.join(offered)} there",
            )
        return np.asarray(weights, dtype=np.float64)

    def choices(self, mdp: MDP) -> Integers:
        """Return (S,) the likeliest action of every state, the lowest number on a tie."""
        weights = self.weights(mdp)
        best = np.maximum.reduceat(weights, mdp.pair_offsets[:-1])
        first = np.where(weights == best[mdp.pair_state], np.arange(mdp.n_pairs), mdp.n_pairs)
        return mdp.pair_action[np.minimum.reduceat(first, mdp.pair_offsets[:-1])]

    def _keys(self, mdp: MDP) -> Integers:
        """Return (S,) the row of the table that each state reads."""
        if self.space.columns == mdp.space.columns and self.space.extra == mdp.space.extra:
            return np.arange(mdp.n_states)
        keys = np.zeros(mdp.n_states, dtype=np.int64)
        for column in self.space.columns:
            theirs = mdp.space.column(column.name)
            if theirs != column:
                raise ModelError(
                    f"column {column.name} has {column.size} values here and {theirs.size} "
                    "in the model",
                    where="policy",
                    fix="use a policy made for this model",
                )
            keys = keys * column.size + np.maximum(mdp.space.values(column.name), 0)
        return keys

    # ---- construction ------------------------------------------------------------------------

    @classmethod
    def of(cls, mdp: MDP, policy: object) -> Policy:
        """Return a policy from any form that the toolkit takes.

        Parameters
        ----------
        mdp : MDP
        policy : Policy, str, path, mapping or array
            A policy; "random", "always:ACTION" or a file; {status: action}; (S,) action numbers;
            (S, A) probabilities. Where the model stops after N steps (`MDP.within`), S may be the
            states without their time, and (N, S) and (N, S, A) depend on time.
        """
        if isinstance(policy, Policy):
            return policy
        if isinstance(policy, Mapping):
            from mdp.policy_file import from_mapping

            return from_mapping(mdp, policy, where="policy")
        if isinstance(policy, str) and policy == "random":
            return cls.uniform(mdp)
        if isinstance(policy, str) and policy.startswith("always:"):
            return cls.always(mdp, policy.removeprefix("always:"))
        if isinstance(policy, str | Path):
            return cls.read(policy, mdp)
        array = np.asarray(policy)
        if array.dtype.kind in "iu" and _layout(mdp, by_time(mdp, array, 0), 1) is not None:
            return cls.from_choices(mdp, array)
        if array.dtype.kind == "f" and array.ndim > 1 and array.shape[-1] == mdp.n_actions:
            table = by_time(mdp, array, np.nan, of_actions=True)
            space = _layout(mdp, table, 2)
            if space is not None and (space == mdp.space or mdp.space.untimed is not None):
                return cls(space=space, actions=mdp.actions, table=table)
        raise ModelError(
            f"a policy of type {type(policy).__name__} with shape {array.shape}",
            where="policy",
            fix=f"give ({mdp.n_states},) action numbers or ({mdp.n_states}, {mdp.n_actions}) "
            "probabilities; for a Q-table use Policy.from_q",
        )

    @classmethod
    def uniform(cls, mdp: MDP) -> Policy:
        """Return the policy that draws one of each state's actions uniformly."""
        table = np.zeros((mdp.n_states, mdp.n_actions))
        counts = np.diff(mdp.pair_offsets)[mdp.pair_state]
        table[mdp.pair_state, mdp.pair_action] = 1 / counts
        return cls(space=mdp.space, actions=mdp.actions, table=table)

    @classmethod
    def always(cls, mdp: MDP, action: str) -> Policy:
        """Return the policy that takes one action wherever there is a choice."""
        number = mdp.action(action)
        return cls(
            space=StateSpace(columns=()),
            actions=mdp.actions,
            table=np.eye(mdp.n_actions)[[number]],
        )

    @classmethod
    def from_choices(cls, mdp: MDP, choices: ArrayLike) -> Policy:
        """Return the policy of (S,) action numbers; a forced end may be left out.

        Where the model stops after N steps, (S,) without the time and (N, S) are taken as well.
        """
        numbers = by_time(mdp, np.asarray(choices, dtype=np.int64), 0)
        space = _layout(mdp, numbers, 1)
        if space is None or ((numbers < 0) | (numbers >= mdp.n_actions)).any():
            raise ModelError(
                f"action numbers of shape {numbers.shape}, or outside 0 … {mdp.n_actions - 1}",
                where="policy",
                fix=f"give one action number for each of the {mdp.n_states} states",
            )
        return cls(space=space, actions=mdp.actions, table=np.eye(mdp.n_actions)[numbers])

    @classmethod
    def from_q(cls, mdp: MDP, table: ArrayLike) -> Policy:
        """Return the greedy policy of a Q-table; the lowest action number wins a tie.

        Parameters
        ----------
        table : (S, A) over all states, or (2^n, A) over the status vectors
            Action values; only the actions that a state offers are compared. Extra states
            (the end) may be left out where they offer no choice. Where the model stops after N
            steps, S may be the states without their time; (N, S, A) depends on time.
        """
        values = by_time(mdp, float_array(table), 0.0, of_actions=True)
        space, actions, offered = _q_layout(mdp, values)
        if np.isnan(values[offered]).any():
            row = int(np.flatnonzero((np.isnan(values) & offered).any(axis=1))[0])
            raise ModelError(
                "an action value is NaN",
                where=f"Q-table, {space.label(row)}",
                fix="give a number for every available action",
            )
        greedy = np.argmax(np.where(offered, values, -np.inf), axis=1)
        # A row of -inf would make argmax fall on an action that is not offered.
        lowest = np.argmax(offered, axis=1)
        chosen = np.where(offered[np.arange(len(greedy)), greedy], greedy, lowest)
        return cls(space=space, actions=actions, table=np.eye(len(actions))[chosen])

    @classmethod
    def by(cls, mdp: MDP, columns: Sequence[str], table: ArrayLike) -> Policy:
        """Return a policy that reads the named columns.

        Parameters
        ----------
        columns : names of columns of the model's states
        table : (K,) action numbers or (K, A) probabilities, row-major over the columns
        """
        space = StateSpace(columns=tuple(mdp.space.column(name) for name in columns))
        array: Numbers = np.asarray(table)
        if array.ndim == 1:
            if ((array < 0) | (array >= mdp.n_actions)).any():
                raise ModelError(
                    f"an action number is outside 0 … {mdp.n_actions - 1}",
                    where="policy",
                    fix="use the model's action numbers",
                )
            array = np.eye(mdp.n_actions)[array.astype(np.int64)]
        return cls(space=space, actions=mdp.actions, table=array)

    @classmethod
    def read(cls, path: str | Path, mdp: MDP) -> Policy:
        """Read a policy or Q-table from `.json`, `.csv`, `.npy` or `.npz`; see the README."""
        from mdp.policy_file import read

        return read(path, mdp)

    def write(self, path: str | Path) -> None:
        """Write the policy as `.csv` or (where it reads the status alone) `.json`, atomically."""
        from mdp.policy_file import write

        write(self, path)


def _q_layout(mdp: MDP, values: Floats) -> tuple[StateSpace, tuple[str, ...], Numbers]:
    """Return the space, the actions and the (K, A) availability that a Q-table is over."""
    offered: Numbers = np.zeros((mdp.n_states, mdp.n_actions), dtype=bool)
    offered[mdp.pair_state, mdp.pair_action] = True
    space = _layout(mdp, values, 2) if values.shape[1:] == (mdp.n_actions,) else None
    if space is not None:
        return space, mdp.actions, offered[: len(values)]
    free = np.flatnonzero(offered[~mdp.forced].any(axis=0))
    actions = tuple(mdp.actions[number] for number in free)
    expected = [f"({mdp.n_states}, {mdp.n_actions}) over all states"]
    untimed = mdp.space.untimed
    if untimed is not None:
        expected.append(f"({untimed.size}, {mdp.n_actions}) over the states without their time")
    if "status" in mdp.space.names:
        column: Column = mdp.space.column("status")
        if values.shape == (column.size, len(actions)):
            return StateSpace(columns=(column,)), actions, np.ones(values.shape, dtype=bool)
        expected.append(f"({column.size}, {len(actions)}) over the statuses")
    raise ModelError(
        f"a Q-table of shape {values.shape}", where="Q-table", fix=f"give {' or '.join(expected)}"
    )


def by_time(mdp: MDP, table: Numbers, rest: float, *, of_actions: bool = False) -> Numbers:
    """Return a table (N, S) or (N, S, A) over times and states as one over all states of `mdp`.

    Parameters
    ----------
    mdp : MDP
        Where its first column is not the time, the table is returned as it is; so are tables of
        other shapes.
    table : (N, S) or (N, S, A)
        S are the states without their time, with or without the extra ones; time N, where all is
        over, may be there as well or not.
    rest : float
        What is put where all is over.
    of_actions : bool
        Whether the last axis is that of the actions.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]]] * 2, [[1, 3], [0, 0]]).within(2)
    >>> by_time(mdp, np.array([[0, 1], [1, 1]]), 0).tolist()
    [0, 1, 1, 1, 0, 0]
    """
    untimed = mdp.space.untimed
    if untimed is None or table.ndim != 2 + of_actions:
        return table
    times, own = mdp.space.columns[0].size, untimed.regular
    over = bool(mdp.forced[(times - 1) * own :].all())
    steps = times - 1 if over else times
    if table.shape[0] not in (steps, times) or table.shape[1] not in (own, untimed.size):
        return table
    kind = table.dtype if float(rest).is_integer() else np.result_type(table.dtype, np.float64)
    found = np.full((mdp.n_states, *table.shape[2:]), rest, dtype=kind)
    found[: steps * own] = table[:steps, :own].reshape(-1, *table.shape[2:])
    return found


def _layout(mdp: MDP, table: Numbers, axes: int) -> StateSpace | None:
    """Return the states that the rows of a table stand for; None where there are no such.

    All states; without the extra ones, where these offer no choice; or, where the first column is
    the time, the states without it.
    """
    if table.ndim != axes:
        return None
    space, rows = mdp.space, len(table)
    if rows == space.size:
        return space
    if space.untimed is not None:
        untimed = space.untimed
        bare = StateSpace(columns=untimed.columns)
        return untimed if rows == untimed.size else bare if rows == bare.size else None
    free = rows == space.regular and bool(mdp.forced[space.regular :].all())
    return StateSpace(columns=space.columns) if free else None


def check_action(name: str, actions: Sequence[str], where: str) -> int:
    """Return the number of a named action, or raise ModelError with the place."""
    if name not in actions:
        raise ModelError(f"unknown action {name!r}", where=where, fix=suggest(name, actions))
    return list(actions).index(name)
