"""Models from arrays, from rows of pairs and from lists of outcomes, floats or exact rationals.

Every form is turned into columns: state and action of each pair; next state, probability, reward
and component amounts of each outcome. `_parts_from_columns` makes the parts of a model from them.
Every number keeps its exact value (`mdp.forms.numbers`); `mdp.forms.rows` defines the exact
distribution that a row of floats stands for. If all numbers fit in doubles, and at least one was
given as a float, the table holds floats; else integers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from operator import index
from typing import Any, Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from exact_mdp.mdp.components import each_component, named_components, require_length
from exact_mdp.mdp.errors import ModelError, ShapeError, words_of
from exact_mdp.mdp.forms import listed
from exact_mdp.mdp.forms.columns import table_of
from exact_mdp.mdp.forms.listed import OutcomeColumns
from exact_mdp.mdp.forms.names import action_names, name_things
from exact_mdp.mdp.forms.numbers import (
    array_of,
    as_given,
    is_pandas_table,
    one_kind,
    to_dense,
    whole_numbers,
)
from exact_mdp.mdp.sense import Sense
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Integers, concatenate_ranges, exact
from exact_mdp.mdp.validate import COUNTED, Flags, Parts, as_discount, as_start, check_options

# An action number from here on, without names for the actions, is more likely a typing error, and a
# name for each smaller number would fill the memory.
MOST_UNNAMED_ACTIONS = 100_000
ACTIONS_LAST = "ssa"
LAYOUTS = {"ass": 1, "sas": 0}
"""The two orders of the indices of P, "action, state, next state" and "state, action, next state",
and the place of the state in each."""


class FromArrays(Parts):
    """Models from arrays, from rows of pairs, and from lists of outcomes."""

    @classmethod
    def from_arrays(
        cls,
        P: Any,
        R: Any = None,
        discount: object = 1,
        *,
        layout: str | None = None,
        start: object = None,
        **names: Any,
    ) -> Self:
        """Build from transition and reward arrays, or from dictionaries, lists and quadruples.

        Parameters
        ----------
        P : (A, S, S), (S, A, S) or (S, S, A) array, A sparse (S, S) matrices, or {action: matrix}
            Transition probabilities: Fractions, ints, "p/q" and floats in any mixture. Each number
            keeps its exact value; a float is the binary fraction that it stores. Or P[s][a][t] in
            dictionaries, or quadruples (s, a, t, p): see `mdp.forms.listed`.
        R : (S,), (S, A) or (A, S, S) array, a sparse (S, A) matrix, or A sparse (S, S) ones
            Rewards of states, of pairs, or of transitions. An action with the reward -inf (inf for
            costs) is not available, whatever its row in P; all others are.
        discount : number or "p/q"
        layout : "ass", "sas" or "ssa", optional
            Order of the indices action and state, in P and in rewards of transitions. It follows
            from the shape, unless A = S: then it is needed if the two readings of P differ. "ssa",
            P[state, next state, action], must always be given.
        start : state, {state: probability}, (S,) probabilities, or another model's `start`
            The first state by default; see `mdp.forms.names` for ways to name a state.
        **names
            `actions` (A words), `states` (S words), `name`; `sense`, "max" or "min" (for costs);
            `labels` {name: (S,) truth values}; `components` {name: amounts in the form of `R` or
            `reward`, or one for each pair}. The reward less all given components is the component
            "rest".

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            For shapes that do not fit, or that allow two different readings; and as the constructor
            does.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> mdp = MDP.from_arrays([[["1/3", "2/3"], [0, 1]]], [1, 0], discount="9/10")
        >>> mdp.table.row(0)
        [(Fraction(1, 3), 0, Fraction(1, 1)), (Fraction(2, 3), 1, Fraction(1, 1))]
        """
        check_options(names, COUNTED)
        if layout not in (None, *LAYOUTS, ACTIONS_LAST):
            raise ModelError(
                f"{layout!r} is not a layout", where="layout", fix='give "ass", "sas" or "ssa"'
            )
        if R is None:
            raise ModelError(
                "no rewards are given",
                where="R",
                fix="give them beside P: MDP.from_arrays(P, R); if each outcome comes with its "
                "reward, use MDP.from_outcomes",
            )
        # Nested dictionaries and quadruples list outcomes.
        if listed.is_listed(P):
            if layout not in (None, "sas"):
                fix = "leave it out; dictionaries go by state, then action"
                raise ModelError(f"dictionaries are not {layout!r}", where="layout", fix=fix)
            outcomes, names = listed.columns_from_listed(P, R, {**names, "start": start})
            return cls._from_columns(outcomes, discount, names.pop("start"), names)
        # Bring P into rows (L, S), sorted by state, then action.
        if layout == ACTIONS_LAST:
            P, R, layout = _move_actions_first(P, "P"), _move_actions_first(R, "R"), "ass"
            each_component(names, _move_actions_first)
        keys: list[Any] = []
        if isinstance(P, Mapping):
            keys = listed.keys_of(P)
            P = [P[key] for key in keys]
        P, R, layout, listed_pairs = listed.fill_missing_rows(P, R, layout)
        rows, shape, order = _rows_of_matrices(P, "P", layout)
        states, actions = shape
        # With as many actions as states, the shape does not tell which index is which.
        swapped = None
        if layout is None and states == actions > 1:
            swapped = np.arange(states * actions).reshape(shape).T.reshape(-1)
            _check_alike(rows, swapped)
        # Keys of a dictionary of matrices are names of the first index.
        if keys != [*range(len(keys))]:
            if order == "sas":
                names = {"states": name_things(keys, "state")} | names
            else:
                names = action_names(keys) | names

        def of_pairs(values: Any, where: str) -> Any:
            """Return rewards, or amounts of a component, by pair or by transition."""
            if isinstance(values, Mapping) and keys and values.keys() == {*keys}:
                matrices = [values[key] for key in keys]
                if all(np.ndim(each) == 2 for each in matrices):
                    values = matrices
            like = layout
            if states == actions:
                like = order
            rewards, of_transitions = _rewards_of_arrays(values, where, shape, like, order)
            if swapped is not None and of_transitions:
                _check_alike(rewards, swapped)
            return rewards

        # An infinite reward marks an action that is not available.
        reward = of_pairs(R, "R")
        offered = _find_available_pairs(reward, names, listed_pairs)
        count = states * actions
        if offered is not None:
            count = int(np.count_nonzero(offered))

        def read_amounts(values: Any, where: str) -> Any:
            """Return the amounts of a component: one for each pair, or in a form of R."""
            other = isinstance(values, Mapping) or is_pandas_table(values) or _holds_sparse(values)
            if not other:
                array = array_of(values, where)
                if array.shape in ((count,), (states * actions,)):
                    return array
            return of_pairs(values, where)

        names.setdefault("actions", [str(number) for number in range(actions)])
        each_component(names, read_amounts)
        pair = np.arange(states * actions)
        columns = pair // actions, pair % actions, rows, reward, offered
        # The table may use the rows as they are only if they are not the user's own array.
        own = not hasattr(P, "__array__")
        if isinstance(P, np.ndarray):
            own = not np.may_share_memory(rows, P)
        return cls(
            **_parts_from_pairs(*columns, names | {"discount": discount, "start": start}, own=own)
        )

    @classmethod
    def from_pairs(
        cls,
        pair_state: ArrayLike,
        pair_action: ArrayLike,
        transition: Any,
        reward: object,
        discount: object = 1,
        *,
        start: object = None,
        **names: Any,
    ) -> Self:
        """Build from one row per available state-action pair, in any order.

        Parameters
        ----------
        pair_state, pair_action : (L,) ints
        transition : (L, S) array or sparse matrix
        reward : (L,) array
        discount, start, **names
            As in `from_arrays`.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            For shapes that do not fit, and as the constructor does.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> MDP.from_pairs([1, 0], [0, 0], [[0, 1], ["1/2", "1/2"]], [0, 5]).reward.tolist()
        [5.0, 0.0]
        """
        check_options(names, COUNTED)
        state = whole_numbers(pair_state, "pair_state")
        action = whole_numbers(pair_action, "pair_action")
        rows = array_of(transition, "transition")
        if rows.ndim != 2 or len(state) != rows.shape[0] or len(action) != len(state):
            raise ShapeError(
                f"{len(state)} states and {len(action)} actions for transitions of shape "
                f"{rows.shape}",
                where="pairs",
                fix="give one state, one action and one row of (L, S) for each pair",
            )
        rewards = _rewards_of_rows(reward, "reward", rows)
        each_component(names, lambda values, where: _rewards_of_rows(values, where, rows))
        offered = _find_available_pairs(rewards, names)
        names |= {"discount": discount, "start": start}
        return cls(**_parts_from_pairs(state, action, rows, rewards, offered, names))

    @classmethod
    def from_outcomes(
        cls,
        rows: Iterable[tuple[int, int, Sequence[tuple[Any, int, Any]]]],
        discount: object = 1,
        *,
        start: object = None,
        **names: Any,
    ) -> Self:
        """Build from (state, action, [(probability, next state, reward), …]) rows, kept exact.

        Parameters
        ----------
        rows : iterable
            One row for each pair, in any order. Instead of a reward, an outcome may have
            {component: amount}; the reward is their sum. In `components`, the amount of a pair may
            also be a list with the amount of each of its outcomes.
        discount, start, **names
            As in `from_arrays`.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            For rows of another form, and as the constructor does.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> mdp = MDP.from_outcomes([(0, 0, [("1/2", 0, 1), ("1/2", 1, 0)]), (1, 0, [(1, 1, 0)])])
        >>> mdp.reward.tolist()
        [0.5, 0.0]
        """
        check_options(names, COUNTED)
        columns = OutcomeColumns()
        try:
            for row in rows:
                outcomes = [(p, index(to), r) for p, to, r in row[2]]
                columns.add_pair(index(row[0]), index(row[1]), outcomes)
            np.array([*columns.state, *columns.action, *columns.following], dtype=np.int64)
        except (TypeError, ValueError, LookupError, OverflowError) as error:
            raise ModelError(
                f"a row or an outcome has the wrong form: {error}",
                where="rows",
                fix="give (state, action, [(probability, next state, reward), …]) with whole "
                "numbers for states and actions",
            ) from error
        return cls._from_columns(columns, discount, start, names)

    @classmethod
    def _from_columns(
        cls, columns: OutcomeColumns, discount: object, start: object, names: dict[str, Any]
    ) -> Self:
        """Return the model of pairs in any order, and their outcomes; see `from_outcomes`."""
        # Sort the pairs by state, then action, and their outcomes with them.
        given = (columns.state, columns.action, columns.length, columns.following)
        state, action, length, following = (np.array(each, dtype=np.int64) for each in given)
        order, ends = np.lexsort((action, state)), np.cumsum(length)
        places = concatenate_ranges((ends - length)[order], ends[order])
        state, action, following = state[order], action[order], following[places]
        chance, gain = (
            [each[k] for k in places.tolist()] for each in (columns.chance, columns.gain)
        )
        size = int(max(state.max(initial=-1), following.max(initial=-1))) + 1
        lengths = length[order].tolist()
        offsets = np.cumsum([0, *lengths])
        # Amounts of components by outcome: in place of rewards, or listed in `components`.
        amounts: dict[str, Any] = {}
        if any(issubclass(kind, Mapping) for kind in set(map(type, gain))):
            gain, amounts = _collect_amounts(gain, names)
        listed = _list_outcome_amounts(names.get("components"), lengths, order)
        if listed:
            amounts = listed
            names.pop("components")
        each_component(names, lambda values, where: require_length(values, where, len(order)))
        names |= {"discount": discount, "start": start}
        outcomes = offsets, following, one_kind(chance), one_kind(gain)
        settings: dict[str, Any] = {"by_pair": False, "amounts": amounts}
        return cls(**_parts_from_columns(state, action, *outcomes, size, order, names, **settings))


def _collect_amounts(gains: list[Any], names: dict[str, Any]) -> tuple[list[Any], dict[str, Any]]:
    """Return the rewards (N,), and {component: amounts (N,)}, of outcomes {component: amount}.

    Other rewards are returned as they are.
    """
    columns: dict[str, list[Fraction]] = {}
    rewards, floats, zero = list(gains), False, Fraction(0)
    # Most amounts occur many times; to make a fraction takes longer than to look one up.
    known: dict[tuple[type, Any], Fraction] = {}
    totals: dict[tuple[int, ...], Fraction] = {}  # by the places of amounts in memory
    for place, gain in enumerate(gains):
        if not isinstance(gain, Mapping):
            continue
        own = []
        for name, amount in gain.items():
            key = type(amount), amount
            number = known.get(key)
            if number is None:
                number = known[key] = exact(amount)
                floats = floats or isinstance(as_given(amount), float)
            # An outcome that does not name a component has the amount 0.
            column = columns.get(str(name))
            if column is None:
                column = columns[str(name)] = [zero] * len(gains)
            column[place] = number
            own.append(number)
        parts = tuple(map(id, own))
        total = totals.get(parts)
        if total is None:
            total = totals[parts] = sum(own, zero)
        rewards[place] = total
    names.setdefault("float_rewards", floats)
    return rewards, {name: np.array(each, dtype=object) for name, each in columns.items()}


def _lists_outcomes(amounts: Any) -> bool:
    """Return whether some pair's amount is itself a list, of amounts by outcome."""
    if not isinstance(amounts, list | tuple):
        return False
    return any(isinstance(amount, list | tuple) for amount in amounts)


def _list_outcome_amounts(given: Any, lengths: list[int], order: Integers) -> dict[str, Any]:
    """Return {component: amounts (N,)} if some amounts are listed by outcome; else {}.

    `given` is {component: a number or a list of numbers for each pair}, with the pairs as the user
    listed them; `order` is their order in the model.
    """
    if not isinstance(given, Mapping):
        return {}
    if not any(map(_lists_outcomes, given.values())):
        return {}
    amounts = {}
    for name, values in given.items():
        own = [*values]
        if len(own) != len(order):
            raise ShapeError(
                f"amounts for {len(own)} pairs, not {len(order)}",
                where=f"component {name}",
                fix="give one amount for each pair, or a list for its outcomes",
            )
        every = list[Any]()
        for number, count in zip(order.tolist(), lengths, strict=True):
            amount = own[number]
            # One number is the amount of all outcomes of the pair.
            if not isinstance(amount, list | tuple):
                amount = [amount] * count
            if len(amount) != count:
                raise ShapeError(
                    f"{len(amount)} amounts for {count} outcomes",
                    where=f"component {name}, pair {number}",
                    fix="give one amount for each outcome, or one for the pair",
                )
            every += map(as_given, amount)
        amounts[str(name)] = np.array(every, dtype=object)
    return amounts


# ---- layouts of arrays ---------------------------------------------------------------------------


def _move_actions_first(values: Any, where: str) -> Any:
    """Return an array (S, S, A) as (A, S, S), and other arrays as they are."""
    if isinstance(values, Mapping) or _holds_sparse(values):
        raise ModelError(
            "a dictionary, or a list of sparse matrices, has one entry for each action",
            where=where,
            fix='leave layout="ssa" out',
        )
    array = array_of(values, where)
    if array.ndim == 3:
        return np.moveaxis(array, 2, 0)
    return values


def _check_alike(rows: Any, swapped: Integers) -> None:
    """Raise ModelError unless rows (L, …) are the same with states and actions swapped."""
    differ = rows[swapped] != rows
    if sp.issparse(differ):
        differ = differ.data
    if np.asarray(differ, dtype=bool).any():
        raise ModelError(
            "there are as many actions as states: P may go by action, then state, or by state, "
            "then action, and the models differ",
            where="P",
            fix='say which: layout="ass" for P[action][state][next state], layout="sas" for '
            "P[state][action][next state]",
        )


def _rewards_of_arrays(
    R: Any, where: str, shape: tuple[int, int], layout: str | None, order: str
) -> tuple[Any, bool]:
    """Return rewards by pair (L,) or by transition (L, S), and whether they are by transition."""
    states, actions = shape
    if isinstance(R, Mapping):
        raise ModelError(
            "the rewards are a dictionary that does not match P",
            where=where,
            fix=f"give an array ({states}, {actions}); or {{action: matrix}} beside such a P, and "
            "{state: {action: reward}} beside {state: {action: {next state: probability}}}",
        )
    # Three indices, or a list of matrices, are rewards of transitions; fewer, of states or pairs.
    sparse = _holds_sparse(R)
    given = R
    if not sparse:
        given = to_dense(array_of(R, where))
    of_transitions = sparse or given.ndim == 3
    if of_transitions:
        reward, sizes, _ = _rows_of_matrices(given, where, layout)
        size: tuple[int, ...] = (sizes[1], sizes[0], reward.shape[1])
        fits = sizes == shape
    else:
        size = given.shape
        fits = size in ((states,), shape)
        reward = given.reshape(-1)
        if given.ndim == 1:  # rewards of states
            reward = np.repeat(given, actions)
    if not fits:
        what = f"rewards have shape {size}"
        if order == "sas":
            what = f"transitions have shape ({states}, {actions}, {states}), (S, A, S), and {what}"
        raise ShapeError(
            what,
            where=where,
            fix=f"give ({states},), ({states}, {actions}) or ({actions}, {states}, {states})",
        )
    return reward, of_transitions


def _holds_sparse(values: Any) -> bool:
    """Return whether values are a list, or an array of objects, with a sparse matrix in it."""
    row = isinstance(values, np.ndarray) and values.dtype == object and values.ndim == 1
    return (row or isinstance(values, Sequence)) and any(map(sp.issparse, values))


def _rows_of_matrices(
    values: Any, where: str, layout: str | None
) -> tuple[Any, tuple[int, int], str]:
    """Return P, or R by transition, as (L, S) rows in pair order, (S, A), and the layout."""
    # Read the shape as the shape of an array with three indices.
    what = "rewards"
    if where == "P":
        what = "transitions"
    if _holds_sparse(values):
        if not all(map(sp.issparse, values)):
            raise ModelError(
                f"{where} mixes sparse and dense matrices", where=where, fix="use one kind"
            )
        shapes = sorted({matrix.shape for matrix in values})
        shape = (len(values), *shapes[0])
    else:
        array = array_of(values, where)
        shapes, shape = [array.shape[1:]], array.shape
    # A layout fits if its state index is as long as the index of next states, which is the last.
    fits = [each for each, at in LAYOUTS.items() if len(shape) == 3 and shape[at] == shape[2]]
    if len(shapes) > 1 or 0 in shape or not fits or layout not in (None, *fits):
        found = f"{what} have shape {shape}"
        if len(shapes) > 1:
            found = f"matrices of {what} have shapes {shapes}"
        fix = "give (A, S, S), (S, A, S), or a list of A sparse (S, S) matrices"
        if len(shape) == 4:
            fix += "; rows that depend on the time are a model for each step: MDP.from_steps"
        if fits and layout is not None:
            fix += f"; this is not {layout!r}"
        if len(shape) == 3 and shape[0] == shape[1]:
            fix += '; layout="ssa" if it is P[state, next state, action]'
        raise ShapeError(found, where=where, fix=fix)
    layout = layout or fits[0]
    sizes = (shape[1], shape[0])
    if layout == "sas":
        sizes = (shape[0], shape[1])
    rows = sizes[0] * sizes[1]
    # Rows are sorted by state, then action: the layout "ass" has to be transposed.
    if not _holds_sparse(values):
        if layout == "ass":
            array = array.transpose(1, 0, 2)
        return array.reshape(rows, -1), sizes, layout
    stacked = sp.csr_array(sp.vstack([array_of(matrix, where) for matrix in values], "csr"))
    if layout == "ass":
        stacked = stacked[np.arange(rows).reshape(shape[:2]).T.reshape(-1)]
    return stacked, sizes, layout


# ---- from columns to the parts of a model --------------------------------------------------------


def _rewards_of_rows(reward: Any, where: str, rows: Any) -> Any:
    """Return rewards in a form that `from_pairs` accepts: by pair (L,) or transition (L, S)."""
    rewards = array_of(reward, where)
    if rewards.shape != rows.shape:
        rewards = to_dense(rewards)
    if rewards.shape != rows.shape[:1] and rewards.shape != rows.shape:
        raise ShapeError(
            f"rewards have shape {rewards.shape}, not ({rows.shape[0]},)",
            where=where,
            fix="give one reward for each pair",
        )
    return rewards


def _find_available_pairs(
    reward: Any, names: dict[str, Any], listed: Flags | None = None
) -> Flags | None:
    """Return (L,) True for available pairs: listed, and not of infinite loss; None for all."""
    if sp.issparse(reward):
        return listed
    offered: Flags = np.asarray(reward != Sense.of_options(names).worst, dtype=bool)
    if offered.ndim == 2:
        offered = np.asarray(offered.any(axis=1))
    if listed is not None:
        offered = offered & listed
    if offered.all():
        return None
    return offered


def _parts_from_pairs(
    state: Integers,
    action: Integers,
    rows: Any,
    reward: Any,
    offered: Flags | None,
    names: dict[str, Any],
    *,
    own: bool = False,
) -> dict[str, Any]:
    """Return a model's parts from pairs in any order; dense rows are copied unless `own`."""
    # Sort the pairs, and drop the pairs that are not available.
    order, total = np.arange(len(state)), len(state)
    next_state, same_state = state[1:] > state[:-1], state[1:] == state[:-1]
    rising = (next_state | (same_state & (action[1:] >= action[:-1]))).all()
    if not rising:
        order = np.lexsort((action, state))
    if offered is not None:
        order = order[offered[order]]
    if offered is not None or not rising:
        state, action, rows, reward = state[order], action[order], rows[order], reward[order]
    # The outcomes of a pair are the entries of its row that are not 0.
    size, by_pair, sparse = rows.shape[1], reward.ndim == 1, sp.issparse(rows)
    if sparse:
        offsets, following, chance = rows.indptr, rows.indices, rows.data
    else:
        positive, column = rows != 0, np.arange(size, dtype=np.int32)
        offsets = np.concatenate([[0], np.cumsum(np.count_nonzero(positive, axis=1))])
        if offsets[-1] == rows.size:  # without zeros no mask is needed, which is faster
            following, chance = np.tile(column, len(rows)), rows.ravel()
            if not own:
                chance = rows.flatten()
        else:
            following, chance = np.broadcast_to(column, rows.shape)[positive], rows[positive]
    if not by_pair:
        reward = reward[np.repeat(np.arange(len(state)), np.diff(offsets)), following]
    columns = state, action, offsets.astype(np.int64), following, chance, reward
    settings = {"by_pair": by_pair, "own": not sparse, "total": total}
    return _parts_from_columns(*columns, size, order, names, **settings)


def _parts_from_columns(
    state: Integers,
    action: Integers,
    offsets: Integers,
    following: Any,
    chance: Any,
    gain: Any,
    size: int,
    order: Integers,
    names: dict[str, Any],
    *,
    by_pair: bool,
    own: bool = True,
    total: int = 0,
    amounts: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return a model's parts from columns: sorted pairs (L,), and their outcomes (N,).

    `order` (L,) are the places of the model's pairs among the `total` pairs that were given, which
    components by pair follow. `amounts` are components by outcome {name: (N,)}.
    """
    total, parts = total or len(order), dict(amounts or {})
    table = table_of(offsets, following, chance, gain, size, names, parts, by_pair=by_pair, own=own)

    def select_pairs(given: Any, _: str) -> Any:
        if len(given) == total:
            return given[order]
        return given

    # Components that are given for all pairs lose the pairs that are not available.
    each_component(names, select_pairs)
    # Name the states and the actions.
    words = words_of(names.pop("states", ()), "states")
    actions = words_of(names.pop("actions", ()), "actions")
    if not actions:
        last = int(action.max(initial=-1))
        if last >= MOST_UNNAMED_ACTIONS:
            raise ModelError(
                f"the number of an action is {last}, and actions without names go up to "
                f"{MOST_UNNAMED_ACTIONS - 1:,}",
                where="pairs",
                fix="number actions from 0 on, or name them all: actions=[…]",
            )
        actions = tuple(map(str, range(last + 1)))
    space = names.pop("space", None)
    if space is None or words:
        space = StateSpace.plain(max(size, len(words)), words)
    # Components, and the start, which needs the names of the states.
    names |= named_components(names, table, parts)
    discount, start = names.pop("discount"), names.pop("start")
    return dict(
        pair_state=state,
        pair_action=action,
        space=space,
        actions=actions,
        discount_exact=as_discount(discount),
        start=as_start(start, space) if space.size else (),
        **names,
    )
