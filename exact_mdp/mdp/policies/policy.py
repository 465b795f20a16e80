"""Policies: an action, or probabilities of actions, for each combination of some state columns.

A policy reads columns of the state (only the status; status and trial; all of them) and gives each
action a probability. In states with a single action (*skip*, the end) the policy has no effect:
that action is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exact_mdp.mdp.errors import (
    ModelError,
    check_names,
    locate_errors,
    no_such,
    require_known_name,
    require_type,
)
from exact_mdp.mdp.forms.numbers import float_array
from exact_mdp.mdp.io.formats import WRITTEN_POLICIES, find_written_format
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies import choices as reading
from exact_mdp.mdp.policies.arrays import (
    KINDS,
    Q_TABLE,
    action_numbers,
    are_distributions,
    find_table_axes,
    no_distribution,
    numbers_of,
    of_array,
    of_given_array,
    rows_read,
)
from exact_mdp.mdp.result import ROWS_SHOWN, data_frame, plain_report
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import (
    FLOAT_ROW_TOLERANCE,
    ByFields,
    Floats,
    Integers,
    Numbers,
    exact,
    in_proportion,
    to_integer_array,
)

if TYPE_CHECKING:
    from pandas import DataFrame

ReadAs = Literal["q", "policy"]
MODEL = "give an MDP first, then the policy; a scenario is compiled: scenario.compile()"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Policy(ByFields):
    """A policy π(a | columns): an action, or probabilities, for each combination of column values.

    `policy[row]` and `np.asarray(policy)` are entries of `rule`, and the whole of it.

    Attributes
    ----------
    space : StateSpace
        The columns that the policy reads, in row-major order, with the extra states if the policy
        is over all states.
    actions : tuple of str
    rule : (K,) int or (K, A) float
        Action numbers of a deterministic policy, -1 in rows without an action; else probabilities
        of actions, NaN in rows without an action, which is an error only if the action is needed.
        Exact numbers (Fractions, "p/q") are rounded here and kept in `shares`.
    shares : (K, A) integers, optional
        Whole numbers in proportion to the exact probabilities of each row, 0 in rows without an
        action. None if the floats of `rule` are exact.
    values : (K, A), optional
        The action values, if the policy is the greedy policy of a Q-table.
    source : str
        The meaning of the two-dimensional array from which the policy was read, if any, in words.

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
    shares: Numbers | None = field(default=None, init=False)
    values: Numbers | None = None
    source: str = ""

    def __post_init__(self) -> None:
        check_names(self.actions, "action", where="policy")
        # Action numbers (K,), or probabilities (K, A).
        given: Numbers = np.asarray(self.rule)
        numbers = given.ndim == 1 and given.dtype.kind in "iu"
        shape = (self.space.size, len(self.actions))
        expected: tuple[int, ...] = shape
        if numbers:
            expected = shape[:1]
        if given.shape != expected:
            raise ModelError(
                f"a policy table of shape {given.shape}, not {shape}",
                where="policy",
                fix="give one row for each combination of the columns it reads",
            )
        if numbers:
            wrong = (given < -1) | (given >= len(self.actions))
            if wrong.any():
                raise no_such("action", given[wrong][0], len(self.actions), where="policy")
            rule, shares = np.array(given, dtype=np.int64), None
        else:
            rule, shares = self._normalize_table(given)
        rule.setflags(write=False)
        object.__setattr__(self, "rule", rule)
        object.__setattr__(self, "shares", shares)

    def _normalize_table(self, given: Numbers) -> tuple[Numbers, Numbers | None]:
        """Return the rule of a table of probabilities and its shares; action numbers if it can."""
        # Every row is a distribution, or empty (NaN).
        table = float_array(given, "policy")
        silent = np.asarray(np.isnan(table).all(axis=1))
        wrong = ~silent & ~are_distributions(given, ~silent)
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise no_distribution(table[row].tolist(), self.space.label(row))
        total = table.sum(axis=1, keepdims=True)
        # Rows of a shorter type than double are divided by their sums.
        short = (np.abs(total - 1) > FLOAT_ROW_TOLERANCE).any()
        shares = _compute_proportions(given, table, exactly=short)
        if short:
            table /= np.where(silent[:, None], 1.0, total)
        # A policy with one action in each row is deterministic.
        alone = (table == 1).any(axis=1) & (np.count_nonzero(table, axis=1) == 1)
        if (alone | silent).all():
            return np.where(silent, -1, (table == 1).argmax(axis=1)), None
        return table, shares

    def __repr__(self) -> str:
        over = ", ".join(self.columns) or "no column"  # a policy that is the same everywhere
        if not self.deterministic:
            return f"Policy(mixed {self.rule.shape}, over {over})"
        return f"Policy({np.array2string(self.rule, threshold=20, edgeitems=8)}, over {over})"

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Numbers:
        return np.array(self.rule, dtype=dtype, copy=copy)

    def __getitem__(self, key: Any) -> Any:
        return self.rule[key]

    # ---- actions and probabilities -----------------------------------------------------------

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that the policy reads."""
        return self.space.names

    @property
    def deterministic(self) -> bool:
        """True if every row has a single action."""
        return self.rule.ndim == 1

    @cached_property
    def table(self) -> Floats:
        """(K, A) probabilities of actions; NaN in rows without an action."""
        if not self.deterministic:
            return self.rule
        table = np.zeros((len(self.rule), len(self.actions)))
        said = self.rule >= 0
        table[np.flatnonzero(said), self.rule[said]] = 1
        table[~said] = np.nan
        table.setflags(write=False)
        return table

    @property
    def read_as(self) -> ReadAs:
        """The kind of the input: "q" for a Q-table, with this greedy policy, or "policy"."""
        if self.source == Q_TABLE:
            return "q"
        return "policy"

    def frame(self) -> DataFrame:
        """Return the policy as a table with one row for each combination of column values.

        It has a column with the action, or, for a mixed policy, a column with the probability of
        each action; None or NaN in rows without an action.

        Examples
        --------
        >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
        >>> print(Policy.of(mdp, [1, 0]).frame())
          state action
        0     0      1
        1     1      0
        """
        return self._frame_rows(len(self.rule))

    def _frame_rows(self, first: int) -> DataFrame:
        """Return the first rows of the table of the policy."""
        rows = data_frame([dict(self.space.as_dict(row)) for row in range(first)]).fillna("")
        if self.deterministic:
            names = [*self.actions, None]  # number -1 stands for no action
            return rows.assign(action=[names[number] for number in self.rule[:first].tolist()])
        missing = [np.nan] * len(self.actions)
        mixed = [self._list_probabilities(row) or missing for row in range(first)]
        return rows.join(data_frame(mixed, columns=list(self.actions)))

    def _list_probabilities(self, row: int) -> list[Any]:
        """Return the exact probability of each action in a row; [] for a row without an action."""
        if self.shares is None:
            chances: list[Any] = self.table[row].tolist()
            if np.isnan(chances).all():
                return []
            return chances
        total = int(sum(self.shares[row]))
        if not total:
            return []
        return [Fraction(int(share), total) for share in self.shares[row]]

    def _repr_html_(self) -> str:
        few = self._frame_rows(min(len(self.rule), ROWS_SHOWN))
        return plain_report(self, few, len(self.rule)).html(ROWS_SHOWN)

    def weights(self, model: MDP) -> Floats:
        """Return (L,) the probability of each pair given its state.

        Raises
        ------
        ModelError
            If the policy gives no action for a state with a choice, or takes an action that is not
            available in the state.
        """
        return self._fill_weights(require_type(model, MDP, "model", MODEL))[0]

    def find_undecided(self, model: MDP) -> NDArray[np.bool_]:
        """Return (S,) True for states with a choice for which the policy gives no action.

        In these states the action does not matter: the episode is over, or all actions have the
        same outcomes. `weights` takes the first action there.
        """
        return np.asarray(
            self._fill_weights(require_type(model, MDP, "model", MODEL))[1] & ~model.forced
        )

    def _fill_weights(self, model: MDP) -> tuple[Floats, NDArray[np.bool_]]:
        """Return weights (L,), and (S,) True where they are filled in, since they do not matter."""
        weights, wanted = self._by_pair(model, self.rule)
        first = model.pair_offsets[:-1]
        # Most policies are deterministic and give an available action for each state.
        if self.deterministic and self.space.extra == model.space.extra:
            taken = np.flatnonzero(weights == 1)
            if np.array_equal(model.pair_state[taken], np.arange(model.n_states)):
                return weights, np.zeros(model.n_states, dtype=bool)
        # In states with a single action, and in extra states, the policy has no effect.
        weights = weights.astype(np.float64)
        offered = np.add.reduceat((weights > 0).astype(np.int64), first)
        if self.space.extra != model.space.extra:
            weights[model.pair_state >= model.space.regular] = np.nan
        weights[model.forced[model.pair_state]] = 1.0
        total = np.add.reduceat(weights, first)
        bad = ~(np.abs(total - 1) <= FLOAT_ROW_TOLERANCE)
        bad |= (offered < wanted) & ~model.forced  # some action is not available
        # Actions in states where the episode is over, or all actions are alike, may be missing.
        ended = bad & model.over
        if (bad & ~ended).any():
            ended |= bad & model.indifferent
        weights[ended[model.pair_state]] = 0.0
        weights[first[ended]] = 1.0
        if (bad & ~ended).any():
            state = int(np.flatnonzero(bad & ~ended)[0])
            names = [model.actions[model.pair_action[pair]] for pair in model.pairs_of(state)]
            what = "the policy takes an action that is not available"
            if np.isnan(total[state]):
                what = "the policy gives no action for a state with a choice"
            raise ModelError(
                what,
                where=model.space.place(state),
                fix=f"choose one of {', '.join(names)} there",
            )
        return weights, ended

    def weights_exact(self, model: MDP) -> Numbers | None:
        """Return (L,) whole numbers in proportion to the exact probability of each pair.

        None if the floats of `weights`, divided by their exact sum, are exact.

        Examples
        --------
        >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
        >>> Policy.of(mdp, {"0": {"0": "9/10", "1": "1/10"}, "1": "0"}).weights_exact(mdp).tolist()
        [9, 1, 1, 0]
        """
        if self.shares is None:
            return None
        taken = self.weights(model) > 0
        weights, _ = self._by_pair(model, self.shares)
        # Where `weights` are not the policy's own, they are 1 for a single pair.
        other = np.logical_or.reduceat((weights > 0) != taken, model.pair_offsets[:-1])
        alone = taken.astype(np.int64).astype(weights.dtype)  # integers, also if they are objects
        return np.where(other[model.pair_state], alone, weights)

    def _by_pair(self, model: MDP, rule: Numbers) -> tuple[Numbers, Integers]:
        """Return the entry of `rule` for each pair (L,), and the number of actions taken (S,)."""
        # Find the row of each state and the model's number of each action.
        keys = rows_read(model, self.space)
        places = {name: number for number, name in enumerate(model.actions)}
        columns = []
        for name in self.actions:
            if name not in places:
                places[name] = model.action(name)
            columns.append(places[name])
        if rule.ndim == 1:
            chosen = np.array([*columns, -1])[rule][keys]
            weights: Numbers = (model.pair_action == chosen[model.pair_state]).astype(np.float64)
            weights[(chosen < 0)[model.pair_state]] = np.nan
            return weights, np.ones(model.n_states, dtype=np.int64)
        by_action = np.zeros((self.space.size, model.n_actions), dtype=rule.dtype)
        by_action[:, columns] = rule
        wanted = np.count_nonzero(by_action > 0, axis=1)[keys]
        return by_action[keys[model.pair_state], model.pair_action], wanted

    def silent(self, model: MDP) -> NDArray[np.bool_]:
        """Return (S,) True for states with a choice for which the policy has no action."""
        said = self._by_pair(model, self.rule)[0]
        nothing = np.logical_or.reduceat(np.isnan(said), model.pair_offsets[:-1])
        if self.space.extra != model.space.extra:
            nothing[model.space.regular :] = True
        return np.asarray(nothing & ~model.forced)

    def choices(self, model: MDP) -> Integers:
        """Return (S,) the most likely action of each state, the lowest number on a tie."""
        weights = self.weights(model)
        best = np.maximum.reduceat(weights, model.pair_offsets[:-1])
        first = np.where(weights == best[model.pair_state], np.arange(model.n_pairs), model.n_pairs)
        return model.pair_action[np.minimum.reduceat(first, model.pair_offsets[:-1])]

    # ---- construction ------------------------------------------------------------------------

    @classmethod
    def of(cls, model: MDP, policy: PolicyLike, *, kind: str = "auto") -> Policy:
        """Return a policy from any form that the toolkit accepts.

        Parameters
        ----------
        model : MDP
        policy : PolicyLike
            A policy; "random", "always:ACTION" or a file; {status: action} or {state: action}, in
            which the action may also be {action: probability}, a row of A numbers, or, with
            kind="q", {action: value}; {(state, action): number}, a table; a function of a state
            that returns one of these; (S,) action numbers; a two-dimensional array of probabilities
            or action values; any object with an attribute `policy`.
            If the model stops after N steps (`MDP.within`), S may be the states without their time,
            and arrays (N, S) and (N, S, A) depend on time.
        kind : "auto", "q" or "policy"
            The meaning of an array or a dictionary of numbers; `mdp.policies.arrays` states the
            rule of "auto" for arrays.

        Returns
        -------
        Policy

        Raises
        ------
        ModelError
            If the policy does not fit the model, or an array is ambiguous.

        Examples
        --------
        >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
        >>> Policy.of(mdp, [[0.5, 0.5], [0, 0]], kind="policy").weights(mdp).tolist()
        [0.5, 0.5, 1.0, 0.0]
        >>> Policy.of(mdp, [[0.5, 0.5], [0, 0]], kind="q").weights(mdp).tolist()
        [1.0, 0.0, 1.0, 0.0]
        >>> Policy.of(mdp, [[1.5, 2.5], [0, 0]]).read_as, Policy.of(mdp, "random").read_as
        ('q', 'policy')
        """
        require_type(model, MDP, "model", MODEL)
        require_known_name(kind, KINDS, "kind of array", "kind")
        # Agents and networks of other libraries are callable, but not functions of a state.
        if callable(getattr(policy, "predict", None)):
            raise ModelError(
                f"{type(policy).__name__} is an agent, not a policy",
                where="policy",
                fix="give lambda state: agent.predict(state, deterministic=True)[0]",
            )
        if callable(getattr(policy, "forward", None)) and hasattr(policy, "parameters"):
            raise ModelError(
                f"{type(policy).__name__} is a network, not a policy",
                where="policy",
                fix="give a function that makes the network's input from a state: lambda state: "
                "net(encode(state)).argmax()",
            )
        policy_read = cls._read_policy(model, policy, kind)
        if kind == "q" and policy_read.read_as != "q":
            raise ModelError(
                "this is a policy, not a Q-table",
                where="policy",
                fix="leave kind out, or give an array of action values, "
                "{state: {action: value}}, or a file of one",
            )
        return policy_read

    @classmethod
    def _read_policy(cls, model: MDP, given: Any, kind: str) -> Policy:
        """Return a policy from any form; see `of`, which checks the kind."""
        if isinstance(given, Policy):
            return given
        if hasattr(given, "policy"):
            return cls._read_solution(model, given, kind)
        # Words and files.
        if isinstance(given, str | Path):
            if given == "random":
                return build_uniform_policy(
                    model, model.by_action(np.ones(model.n_pairs, dtype=bool))
                )
            if isinstance(given, str) and given.startswith("always:"):
                number = np.array([model.action(given.removeprefix("always:"))])
                return cls(space=StateSpace(columns=()), actions=model.actions, rule=number)
            with locate_errors(str(given)):
                return cls(**reading.of_file(model, given, kind))
        # Mappings, functions and arrays.
        with locate_errors("policy"):
            if isinstance(given, Mapping):
                return cls(**reading.of_mapping(model, given, kind))
            if callable(given):
                return cls(**reading.of_function(model, given, kind))
            # A tuple in a list is an action or a row of numbers.
            rows: list[Any] = []
            if isinstance(given, list | tuple):
                rows = [row for row in given if isinstance(row, tuple)]
            if any(map(model.action_names.has_name, rows)):
                raise ModelError(
                    "the list may hold actions, or rows of numbers, and the two differ",
                    fix="give {state: action}, or np.array(rows)",
                )
            return cls(**of_given_array(model, numbers_of(given), kind))

    @classmethod
    def _read_solution(cls, model: MDP, given: Any, kind: str) -> Policy:
        """Return the policy of a solution, a certificate or a learner with its Q-table."""
        # A learner: read its Q-table, unless that is over a space of its own.
        if hasattr(given, "q") and callable(given.policy):
            array = numbers_of(given.q)
            own, over = getattr(given, "space", None), find_table_axes(model, array.shape)
            if own is not None and (over is None or over[0] != own):
                return cls._read_policy(model, given.policy(model), kind)
            if kind == "auto":
                kind = "q"
            return cls(**of_array(model, array, kind))
        # A solution: an array of action numbers goes by the states of its own model.
        own = getattr(given, "mdp", None)
        if not isinstance(given.policy, np.ndarray):
            return cls._read_policy(model, given.policy, kind)
        if not isinstance(own, MDP) or np.shape(given.policy) != (own.n_states,):
            return cls(**action_numbers(model, numbers_of(given.policy)))
        policy = cls(space=own.space, actions=own.actions, rule=np.asarray(given.policy))
        policy.weights(model)  # raises an error unless the names of its own model fit this one
        return policy

    def write(self, path: str | Path) -> None:
        """Write the policy as `.csv`, atomically."""
        require_type(path, str | Path, "path", "give a text")
        form = find_written_format(path, WRITTEN_POLICIES, "a policy")
        rows = {}
        for key in range(self.space.regular):
            taken = {}
            for action, chance in zip(self.actions, self._list_probabilities(key), strict=False):
                if chance:
                    taken[action] = _format_probability(chance)
            if taken:
                rows[key] = taken
        form.write_file(self.space, rows, path)


def build_uniform_policy(model: MDP, among: NDArray[np.bool_]) -> Policy:
    """Return the policy with equal probabilities for some actions (S, A) of each state."""
    shares = among.astype(np.int64)
    rule = shares / shares.sum(axis=1, keepdims=True)
    policy = Policy(space=model.space, actions=model.actions, rule=rule)
    # Floats cannot hold probabilities such as 1/3; the shares are exact.
    if not policy.deterministic:
        shares.setflags(write=False)
        object.__setattr__(policy, "shares", shares)
    return policy


class Solved(Protocol):
    """Anything that has a policy: a solution, a certificate, a learner with its Q-table."""

    @property
    def policy(self) -> Any:
        """The policy."""


PolicyLike: TypeAlias = (
    Policy | str | Path | Mapping[Any, Any] | Callable[[Any], Any] | ArrayLike | Solved
)
"""The accepted forms of a policy: a Policy, its name or file, a mapping, a function, an array, a
Solution. Arrays and lists go by the numbers of states and actions; `mdp.forms.names` states the
rules for all other forms."""


def _format_probability(chance: Any) -> float | str:
    """Return a probability exactly: as a float if its decimal is exact, else as "p/q"."""
    if isinstance(chance, float) or Fraction(repr(float(chance))) == chance:
        return float(chance)
    return str(chance)


def _compute_proportions(given: Numbers, table: Floats, *, exactly: bool) -> Numbers | None:
    """Return the exact shares (K, A) of the given numbers; None if the floats are exact.

    With `exactly`, shares are always returned: the rows of floats will be divided by their sums.
    """
    plain = given.dtype.kind in "biu" or (given.dtype.kind == "f" and given.dtype.itemsize <= 8)
    if plain and not exactly:
        return None
    said = np.flatnonzero(~np.isnan(table).all(axis=1)).tolist()
    chances = {}
    for row in said:
        chances[row] = [*map(exact, given[row])]
        exactly = exactly or table[row].tolist() != chances[row]
    if not exactly:
        return None
    numbers: list[int] = []
    for row in range(len(table)):
        if row in chances:
            numbers += in_proportion(chances[row])
        else:
            numbers += [0] * table.shape[1]
    shares = to_integer_array(numbers).reshape(table.shape)
    shares.setflags(write=False)
    return shares
