"""Policies: what to do, by some of the state's named columns; deterministic or mixed.

A policy reads columns of the state (the status alone; status and trial; all of them) and gives
each action a probability. States with a single action (*skip*, the end) are outside its say:
that action is taken there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.mdp.errors import ModelError, check_names
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies import files
from exact_mdp.mdp.policies.arrays import (
    ArrayPolicy,
    ReadAs,
    action_numbers,
    by_time,
    checked_kind,
    numbers_of,
    policy_of_array,
    rows_read,
)
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import (
    EXACT_IN_INT64,
    FLOAT_ROW_TOLERANCE,
    Floats,
    Integers,
    Numbers,
    divide,
    exact,
    float_array,
    in_proportion,
    magnitude,
)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Policy:
    """π(a | columns): what to do for each combination of column values.

    A policy is an array, too: `np.asarray(policy)` is its `rule`, and so are indexing, `len`,
    iteration and comparison with other arrays. Two policies are equal where they are the same
    object.

    Attributes
    ----------
    space : StateSpace
        The columns that the policy reads, in row-major order; its extra states are read as well
        where the policy is one over all states.
    actions : tuple of str
    rule : (K,) int or (K, A) float
        Action numbers of a deterministic policy, -1 where it says nothing; else probabilities of
        actions. Rows sum to 1; a row of NaN says nothing, which is an error only where it is asked.
        Exact numbers (Fractions, "p/q") are taken as well: they are rounded here and kept in
        `shares`.
    shares : (K, A) integers, optional
        Whole numbers in proportion to the exact probabilities of each row, 0 in rows that say
        nothing. None where the floats of `rule` are what was given.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> policy = Policy.of(mdp, "always:directive")
    >>> policy.weights(mdp)[:4]
    array([0., 0., 0., 1.])
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
    >>> Policy.of(mdp, [1, 0])
    Policy([1 0], over state)
    >>> Policy.of(mdp, {"0": {"0": "9/10", "1": "1/10"}, "1": "0"}).shares.tolist()
    [[9, 1], [1, 0]]
    """

    space: StateSpace
    actions: tuple[str, ...]
    rule: Numbers
    shares: Numbers | None = None

    def __post_init__(self) -> None:
        check_names(self.actions, "action", where="policy")
        given: Numbers = np.asarray(self.rule)
        if given.ndim == 1 and given.dtype.kind in "iu":
            rule, shares = self._checked_numbers(given), None
        else:
            table = self._checked_table(given)
            shares = _rounded_away(given, table) if self.shares is None else self.shares
            if shares is not None:
                shares = self._checked_shares(shares, table)
            numbers = _numbers_alone(table)
            rule = table if numbers is None else numbers
            shares = shares if numbers is None else None
        rule.setflags(write=False)
        object.__setattr__(self, "rule", rule)
        object.__setattr__(self, "shares", shares)

    def _checked_numbers(self, given: Numbers) -> Numbers:
        rule: Numbers = np.array(given, dtype=np.int64)
        if rule.shape != (self.space.size,):
            self._refuse_shape(rule)
        if ((rule < -1) | (rule >= len(self.actions))).any():
            raise ModelError(
                f"an action number is outside 0 … {len(self.actions) - 1}",
                where="policy",
                fix="use the model's action numbers",
            )
        return rule

    def _checked_table(self, given: Numbers) -> Floats:
        table = float_array(given).copy()
        if table.shape != (self.space.size, len(self.actions)):
            self._refuse_shape(table)
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
        return table

    def _refuse_shape(self, table: Numbers) -> NoReturn:
        raise ModelError(
            f"a policy table of shape {table.shape}, not ({self.space.size}, {len(self.actions)})",
            where="policy",
            fix="give one row for each combination of the columns it reads",
        )

    def _checked_shares(self, given: Numbers, table: Floats) -> Numbers:
        """Return exact shares, read-only, or raise ModelError where they are not the table's."""
        shares: Numbers = np.array(given)
        right = shares.shape == table.shape and shares.dtype.kind in "iuO"
        if right:
            # The sums of the rows have to fit as well.
            narrow = magnitude(shares) * len(self.actions) < EXACT_IN_INT64
            shares = shares.astype(np.int64 if narrow else object)
            total = shares.sum(axis=1, keepdims=True)
            known = np.asarray(total > 0, dtype=bool)
            ratio = divide(shares, np.broadcast_to(np.where(known, total, 1), shares.shape))
            same = np.abs(ratio - np.nan_to_num(table)) <= FLOAT_ROW_TOLERANCE
            right = bool(same.all() and ((shares > 0) == (table > 0)).all())
        if not right:
            raise ModelError(
                "exact shares that are not those of the table",
                where="policy",
                fix="give whole numbers in proportion to each row of the table",
            )
        shares.setflags(write=False)
        return shares

    def __repr__(self) -> str:
        over = ", ".join(self.columns) or "no column"
        if not self.deterministic:
            return f"Policy(mixed {self.shape}, over {over})"
        return f"Policy({np.array2string(self.rule, threshold=20, edgeitems=8)}, over {over})"

    # ---- as an array -------------------------------------------------------------------------

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Numbers:
        return np.array(self.rule, dtype=dtype, copy=copy)

    def __len__(self) -> int:
        return len(self.rule)

    def __iter__(self) -> Iterator[Any]:
        return iter(self.rule)

    def __getitem__(self, key: Any) -> Any:
        return self.rule[key]

    def __eq__(self, other: object) -> Any:
        return self is other if isinstance(other, Policy) else self.rule == other

    def __ne__(self, other: object) -> Any:
        return self is not other if isinstance(other, Policy) else self.rule != other

    __hash__ = object.__hash__

    @property
    def shape(self) -> tuple[int, ...]:
        """(K,) of a deterministic policy, (K, A) of a mixed one."""
        return self.rule.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of the array: whole numbers of a deterministic policy, floats of a mixed one."""
        return self.rule.dtype

    @property
    def ndim(self) -> int:
        """1 of a deterministic policy, 2 of a mixed one."""
        return self.rule.ndim

    def tolist(self) -> list[Any]:
        """Return the array as lists of Python numbers."""
        return list(self.rule.tolist())

    # ---- what it says ------------------------------------------------------------------------

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that the policy reads."""
        return self.space.names

    @property
    def deterministic(self) -> bool:
        """True where every row has a single action."""
        return self.rule.ndim == 1

    @cached_property
    def table(self) -> Floats:
        """(K, A) probabilities of actions; NaN in rows that say nothing."""
        if not self.deterministic:
            return self.rule
        table = np.zeros((len(self.rule), len(self.actions)))
        said = self.rule >= 0
        table[np.flatnonzero(said), self.rule[said]] = 1
        table[~said] = np.nan
        table.setflags(write=False)
        return table

    def weights(self, mdp: MDP) -> Floats:
        """Return (L,) the probability of each pair given its state.

        Raises
        ------
        ModelError
            Where the policy says nothing of a state with a choice, or takes an action that the
            state does not offer.
        """
        keys = self._keys(mdp)
        numbers = np.array([*(mdp.action(name) for name in self.actions), -1])
        if self.deterministic:
            chosen = numbers[self.rule][keys]
            weights = (mdp.pair_action == chosen[mdp.pair_state]).astype(np.float64)
            weights[(chosen < 0)[mdp.pair_state]] = np.nan
            wanted: Numbers = np.ones(mdp.n_states, dtype=np.int64)
        else:
            by_action = np.zeros((self.space.size, mdp.n_actions))
            by_action[:, numbers[:-1]] = self.rule
            weights = by_action[keys[mdp.pair_state], mdp.pair_action]
            wanted = np.count_nonzero(by_action > 0, axis=1)[keys]
        offered = np.add.reduceat((weights > 0).astype(np.int64), mdp.pair_offsets[:-1])
        if mdp.space.extra and self.space.extra != mdp.space.extra:
            weights[mdp.pair_state >= mdp.space.regular] = np.nan
        weights[mdp.forced[mdp.pair_state]] = 1.0
        total = np.add.reduceat(weights, mdp.pair_offsets[:-1])
        bad = ~(np.abs(total - 1) <= FLOAT_ROW_TOLERANCE)
        bad |= (offered < wanted) & ~mdp.forced  # however rarely it is taken
        # What is done where everything has ended does not matter: it may be left open.
        ended = bad & mdp.terminal
        weights[ended[mdp.pair_state]] = 0.0
        weights[mdp.pair_offsets[:-1][ended]] = 1.0
        bad &= ~ended
        if bad.any():
            state = int(np.flatnonzero(bad)[0])
            missing = bool(np.isnan(total[state]))
            names = [mdp.actions[mdp.pair_action[pair]] for pair in mdp.pairs_of(state)]
            raise ModelError(
                "the policy says nothing of a state with a choice"
                if missing
                else "the policy takes an action that is not available",
                where=f"state ({mdp.space.label(state)})",
                fix=f"choose one of {', '.join(names)} there",
            )
        return np.asarray(weights, dtype=np.float64)

    def weights_exact(self, mdp: MDP) -> Numbers | None:
        """Return (L,) whole numbers in proportion to the exact probability of each pair.

        None where the floats of `weights`, divided by their exact sum, are the exact probabilities.

        Raises
        ------
        ModelError
            As `weights` does.

        Examples
        --------
        >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
        >>> Policy.of(mdp, {"0": {"0": "9/10", "1": "1/10"}, "1": "0"}).weights_exact(mdp).tolist()
        [9, 1, 1, 0]
        """
        if self.shares is None:
            return None
        taken = self.weights(mdp) > 0
        numbers = np.array([mdp.action(name) for name in self.actions])
        by_action = np.zeros((self.space.size, mdp.n_actions), dtype=self.shares.dtype)
        by_action[:, numbers] = self.shares
        found = by_action[self._keys(mdp)[mdp.pair_state], mdp.pair_action]
        # Where there is no choice, or all has ended, the policy is not asked.
        other = np.logical_or.reduceat((found > 0) != taken, mdp.pair_offsets[:-1])
        return np.where(other[mdp.pair_state], taken.astype(found.dtype), found)

    def choices(self, mdp: MDP) -> Integers:
        """Return (S,) the likeliest action of every state, the lowest number on a tie."""
        weights = self.weights(mdp)
        best = np.maximum.reduceat(weights, mdp.pair_offsets[:-1])
        first = np.where(weights == best[mdp.pair_state], np.arange(mdp.n_pairs), mdp.n_pairs)
        return mdp.pair_action[np.minimum.reduceat(first, mdp.pair_offsets[:-1])]

    def _keys(self, mdp: MDP) -> Integers:
        """Return (S,) the row of the table that each state reads."""
        return rows_read(mdp, self.space)

    # ---- construction ------------------------------------------------------------------------

    @classmethod
    def of(cls, mdp: MDP, policy: object, *, kind: str = "auto") -> Policy:
        """Return a policy from any form that the toolkit takes.

        Parameters
        ----------
        mdp : MDP
        policy : Policy, str, path, mapping, array, or object with an array `q` or `policy`
            A policy; "random", "always:ACTION" or a file; {status: action}; (S,) action numbers;
            a two-dimensional array of probabilities or action values. Where the model stops after N
            steps (`MDP.within`), S may be the states without their time, and (N, S) and (N, S, A)
            depend on time.
        kind : "auto", "q" or "policy"
            What a two-dimensional array holds; `mdp.policies.arrays` states the rule of "auto".

        Raises
        ------
        ModelError
            For what does not fit the model; where an array may be either, and they differ.

        Examples
        --------
        >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
        >>> Policy.of(mdp, [[0.5, 0.5], [0, 0]], kind="policy").weights(mdp).tolist()
        [0.5, 0.5, 1.0, 0.0]
        >>> Policy.of(mdp, [[0.5, 0.5], [0, 0]], kind="q").weights(mdp).tolist()
        [1.0, 0.0, 1.0, 0.0]
        """
        return taken(mdp, policy, kind=kind).policy

    @classmethod
    def uniform(cls, mdp: MDP) -> Policy:
        """Return the policy that draws one of each state's actions uniformly."""
        table = np.zeros((mdp.n_states, mdp.n_actions))
        counts = np.diff(mdp.pair_offsets)[mdp.pair_state]
        table[mdp.pair_state, mdp.pair_action] = 1 / counts
        shares = (table > 0).astype(np.int64)
        return cls(space=mdp.space, actions=mdp.actions, rule=table, shares=shares)

    @classmethod
    def always(cls, mdp: MDP, action: str) -> Policy:
        """Return the policy that takes one action wherever there is a choice."""
        number = mdp.action(action)
        return cls(space=StateSpace(columns=()), actions=mdp.actions, rule=np.array([number]))

    @classmethod
    def from_choices(cls, mdp: MDP, choices: ArrayLike) -> Policy:
        """Return the policy of (S,) action numbers; a forced end may be left out.

        Where the model stops after N steps, (S,) without the time and (N, S) are taken as well.
        """
        space, numbers = action_numbers(mdp, numbers_of(choices))
        return cls(space=space, actions=mdp.actions, rule=numbers)

    @classmethod
    def from_q(cls, mdp: MDP, table: ArrayLike) -> Policy:
        """Return the greedy policy of a Q-table; the lowest action number wins a tie.

        Parameters
        ----------
        table : (S, A) over all states, or (2^n, A) over the status vectors
            Action values, compared as they are; only the actions that a state offers count. Extra
            states (the end) may be left out where they offer no choice. See `mdp.policies.arrays`.
        """
        return _made(policy_of_array(mdp, numbers_of(table), "q"))

    @classmethod
    def by(cls, mdp: MDP, columns: Sequence[str], table: ArrayLike) -> Policy:
        """Return a policy that reads the named columns.

        Parameters
        ----------
        columns : names of columns of the model's states
        table : (K,) action numbers or (K, A) probabilities, row-major over the columns
            Exact probabilities (Fractions) stay exact.
        """
        space = StateSpace(columns=tuple(mdp.space.column(name) for name in columns))
        array: Numbers = np.asarray(table)
        inside = array.dtype.kind in "iu" and ((array >= 0) & (array < mdp.n_actions)).all()
        if array.ndim == 1 and not inside:
            raise ModelError(
                f"an action number is not whole, or outside 0 … {mdp.n_actions - 1}",
                where="policy",
                fix="use the model's action numbers",
            )
        return cls(space=space, actions=mdp.actions, rule=array)

    @classmethod
    def read(cls, path: str | Path, mdp: MDP, *, kind: str = "auto") -> Policy:
        """Read a policy or Q-table from `.json`, `.csv`, `.npy` or `.npz`; see the README."""
        return taken(mdp, Path(path), kind=kind).policy

    def write(self, path: str | Path) -> None:
        """Write the policy as `.csv` or (where it reads the status alone) `.json`, atomically."""
        files.write(self, path)


class Solved(Protocol):
    """Anything that has a policy: a solution, a certificate, a learner with its Q-table."""

    @property
    def policy(self) -> Any:
        """The policy."""


PolicyLike: TypeAlias = Policy | str | Path | Mapping[Any, Any] | ArrayLike | Solved
"""What is taken as a policy: one, its name or file, a mapping, an array, or what has one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Taken:
    """A policy, and what it was taken from.

    Attributes
    ----------
    policy : Policy
    read_as : "q" or "policy"
    array : bool
        Whether a two-dimensional array was read, which might have been either.
    values : (K, A), optional
        The Q-table as it is.
    """

    policy: Policy
    read_as: ReadAs = "policy"
    array: bool = False
    values: Numbers | None = None

    @property
    def said(self) -> str:
        """What was taken, in words; empty where there was no array."""
        if not self.array:
            return ""
        return "a Q-table: its greedy policy" if self.read_as == "q" else "action probabilities"


def taken(mdp: MDP, policy: Any, *, kind: str = "auto") -> Taken:
    """Return the policy of any form that the toolkit takes, and what was read; see `Policy.of`.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
    >>> taken(mdp, [[1.5, 2.5], [0, 0]]).read_as, taken(mdp, "random").read_as
    ('q', 'policy')
    """
    asked = checked_kind(kind)
    if isinstance(policy, str | Path) and Path(policy).suffix.lower() in (".npy", ".npz"):
        return files.array_file(policy, lambda array: _of_array(mdp, array, asked))
    if not isinstance(policy, Policy):
        if hasattr(policy, "q") and callable(getattr(policy, "policy", None)):
            return _of_array(mdp, numbers_of(policy.q), "q" if asked == "auto" else asked)
        policy = policy.policy if _chosen(policy) else policy
    found = _of_words(mdp, policy)
    if found is None:
        return _of_array(mdp, numbers_of(policy), asked)
    if asked == "q":
        raise ModelError(
            "this is a policy, not a Q-table",
            where="policy",
            fix="leave kind out, or give an array of action values, or a file of one",
        )
    return Taken(policy=found)


def _chosen(policy: object) -> bool:
    """Return whether something holds (S,) action numbers, as solutions and certificates do."""
    return isinstance(getattr(policy, "policy", None), np.ndarray | Policy)


def _of_words(mdp: MDP, policy: object) -> Policy | None:
    """Return the policy of anything but arrays; None where it must be one."""
    if isinstance(policy, Policy):
        return policy
    if isinstance(policy, Mapping):
        return _from_file(mdp, files.from_mapping(mdp, policy, where="policy"))
    if isinstance(policy, str) and policy == "random":
        return Policy.uniform(mdp)
    if isinstance(policy, str) and policy.startswith("always:"):
        return Policy.always(mdp, policy.removeprefix("always:"))
    if isinstance(policy, str | Path):
        return _from_file(mdp, files.read(policy, mdp))
    return None


def _of_array(mdp: MDP, array: Numbers, kind: str) -> Taken:
    timed = mdp.space.untimed is not None
    times = timed and array.ndim == 2 and by_time(mdp, array, 0).ndim == 1
    if times and array.dtype.kind in "iu" and kind != "q" and array.shape[1] != mdp.n_actions:
        return Taken(policy=Policy.from_choices(mdp, array))
    if times and array.dtype.kind in "iu" and kind == "auto":
        _refuse_two_meanings(mdp, array)
    if array.ndim == 2 or (timed and array.ndim == 3):
        found = policy_of_array(mdp, array, kind)
        values = found.values
        return Taken(policy=_made(found), read_as=found.read_as, array=True, values=values)
    if array.ndim == 1 and array.dtype.kind in "iu" and kind != "q":
        return Taken(policy=Policy.from_choices(mdp, array))
    raise ModelError(
        f"a policy of shape {array.shape} and type {array.dtype}",
        where="policy",
        fix=f"give ({mdp.n_states},) action numbers, or ({mdp.n_states}, {mdp.n_actions}) "
        "probabilities or action values",
    )


def _refuse_two_meanings(mdp: MDP, array: Numbers) -> None:
    """Raise ModelError where (N, S) action numbers may as well be (S, A) of something else."""
    try:
        numbers = Policy.from_choices(mdp, array).weights(mdp)
    except ModelError:  # these are no action numbers
        return
    if (numbers != _made(policy_of_array(mdp, array, "auto")).weights(mdp)).any():
        raise ModelError(
            f"an array of shape {array.shape} may be action numbers by time and state, or a table "
            "of states and actions, which differ",
            where="policy",
            fix='give probabilities (N, S, A), or say kind="q" (--kind q) of a Q-table',
        )


def _made(found: ArrayPolicy) -> Policy:
    return Policy(space=found.space, actions=found.actions, rule=found.table)


def _numbers_alone(table: Floats) -> Numbers | None:
    """Return (K,) action numbers where each row of (K, A) gives 1 to one action or is NaN."""
    one = table == 1
    silent = np.isnan(table).all(axis=1)
    if not ((one.any(axis=1) & (np.count_nonzero(table, axis=1) == 1)) | silent).all():
        return None
    return np.where(silent, -1, one.argmax(axis=1))


def _rounded_away(given: ArrayLike, table: Floats) -> Numbers | None:
    """Return (K, A) exact shares of the numbers given; None where the floats are these numbers."""
    array: Numbers = np.asarray(given)
    if array.dtype.kind in "biu" or (array.dtype.kind == "f" and array.dtype.itemsize <= 8):
        return None
    said = np.flatnonzero(~np.isnan(table).all(axis=1)).tolist()
    chances = {row: [exact(number) for number in array[row]] for row in said}
    if all(table[row].tolist() == numbers for row, numbers in chances.items()):
        return None
    rows = [in_proportion(chances[k]) if k in chances else None for k in range(len(table))]
    none = [0] * table.shape[1]
    return np.array([row or none for row in rows], dtype=object).reshape(table.shape)


def _from_file(mdp: MDP, found: files.FileTable) -> Policy:
    """Return the policy, with the file's name in what goes wrong; no row may be missing."""
    where = found.where
    policy = files.at_place(
        where, lambda: Policy(space=found.space, actions=mdp.actions, rule=found.table)
    )
    files.check_complete(mdp, found)
    files.at_place(where, lambda: policy.weights(mdp))
    return policy
