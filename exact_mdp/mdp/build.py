"""Models from arrays, from rows and from lists of outcomes, floats or exact rationals alike.

Every number keeps its exact value, whatever stands beside it (`mdp.forms.numbers`); rows of floats
mean what `mdp.forms.rows` says, and outcomes that come twice are added exactly. Where all numbers
are doubles, and one at least was given as a float, the table holds them as floats; else as integers
over one denominator for each row.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from operator import index
from typing import Any, Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from exact_mdp.mdp.components import each_component, named_components, of_length
from exact_mdp.mdp.errors import DistributionError, ModelError, ShapeError, words_of
from exact_mdp.mdp.forms import listed
from exact_mdp.mdp.forms.columns import table_of
from exact_mdp.mdp.forms.numbers import (
    array_of,
    check_places,
    dense,
    is_table,
    one_kind,
    picked,
    whole_numbers,
)
from exact_mdp.mdp.forms.rows import counted
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import (
    Integers,
    OutcomeTable,
    integers,
    multiply,
)
from exact_mdp.mdp.validate import Parts as ModelParts
from exact_mdp.mdp.validate import as_discount, as_start, check_model, check_options

MOST_UNNAMED_ACTIONS = 100_000
LAYOUTS = {"ass": 1, "sas": 0}
"""Orders of the indices of P, action, state, next state or state, action, next state, and which of
the indices is that of the states."""

TABLE_FIELDS = fields(OutcomeTable)

Parts = dict[str, Any]
"""What `MDP` takes, by name."""


class FromArrays(ModelParts):
    """Models from arrays, from rows of pairs, and from lists of outcomes."""

    @classmethod
    def from_arrays(
        cls,
        P: object,
        R: object,
        discount: object = 1,
        *,
        layout: str | None = None,
        start: object = None,
        **names: Any,
    ) -> Self:
        """Build from transition and reward arrays, or from dictionaries, lists and quadruples.

        Parameters
        ----------
        P : (A, S, S) or (S, A, S) array, A sparse (S, S) matrices, or {action: (S, S) matrix}
            Transition probabilities: Fractions, ints, "p/q" and floats in any mixture; each number
            keeps its exact value, a float that of the binary fraction that it is. Or P[s][a][t] in
            dictionaries and lists, or quadruples (s, a, t, p): see `mdp.forms.listed`.
        R : (S,), (S, A) or (A, S, S) array, a sparse (S, A) matrix, or A sparse (S, S) ones
            Rewards of states, of pairs, or of transitions; beside quadruples for P also triples
            (s, a, r) or quadruples (s, a, t, r). An action with the reward -inf (inf
            where rewards are costs) is not available, whatever P says of it; all others are.
        discount : number or "p/q"
        layout : "ass" or "sas", optional
            Order of the indices action and state, of P and of rewards of transitions. The shape
            says it, but not where A = S: there it is needed if the two readings of P differ.
        start : state, {state: probability}, (S,) probabilities, or another model's `start`
            The first state unless given; `mdp.forms.names` says how a state is named.
        **names
            `actions` (A words), `states` (S words), `name`; `sense`, "max" or "min" where rewards
            are costs; `labels` {name: (S,) truth values}; `components` {name: amounts as `R` or
            `reward` has them, or one for each pair}: what they leave of the reward is a component
            "rest".

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            For shapes that do not fit, or fit two readings that differ; and as the constructor
            does.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> mdp = MDP.from_arrays([[["1/3", "2/3"], [0, 1]]], [1, 0], discount="9/10")
        >>> mdp.table.row(0)
        [(Fraction(1, 3), 0, Fraction(1, 1)), (Fraction(2, 3), 1, Fraction(1, 1))]
        """
        return cls(**_of_arrays(P, R, discount, layout, start, names))

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
            Or a sparse matrix of integers with the denominators (L,) of its rows.
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
        >>> counts = sp.csr_array([[1, 2], [0, 1]])
        >>> MDP.from_pairs([0, 1], [0, 0], (counts, [3, 1]), [0, 5]).table.row(0)[0][0]
        Fraction(1, 3)
        """
        check_options(names)
        state, action = (
            whole_numbers(pair_state, "pair_state"),
            whole_numbers(pair_action, "pair_action"),
        )
        below = None
        if isinstance(transition, tuple) and len(transition) == 2 and sp.issparse(transition[0]):
            transition, below = transition[0], whole_numbers(transition[1], "denominators")
        rows = array_of(transition, "transition", columns=False)
        if below is not None and (
            rows.dtype != np.int64 or below.shape != rows.shape[:1] or (below < 1).any()
        ):
            raise ModelError(
                f"{len(below)} denominators for a matrix of {rows.dtype} of shape {rows.shape}",
                where="transition",
                fix="give a sparse matrix of integers (L, S) and positive integers (L,)",
            )
        if rows.ndim != 2 or len(state) != rows.shape[0] or len(action) != len(state):
            raise ShapeError(
                f"{len(state)} states and {len(action)} actions for transitions of shape "
                f"{rows.shape}",
                where="pairs",
                fix="give one state, one action and one row of (L, S) for each pair",
            )
        rewards = _rewards_of_rows(reward, "reward", rows)
        each_component(names, lambda values, where: _rewards_of_rows(values, where, rows))
        order = _offered(rewards, names)
        if not _in_order(state, action):
            sorted_ = np.lexsort((action, state))
            order = sorted_ if order is None else sorted_[np.isin(sorted_, order)]
        if order is not None:
            _observed(names, order, len(state))
            state, action, rows, rewards = state[order], action[order], rows[order], rewards[order]
            each_component(names, lambda values, _: values[order])
            below = None if below is None else below[order]
        return cls(**_from_rows(state, action, rows, rewards, discount, start, names, below))

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
            One for each pair, in any order.
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
        check_options(names)
        return cls(**_of_outcomes(rows, discount, start, names))


def _of_arrays(
    P: Any,
    R: Any,
    discount: object,
    layout: str | None,
    start: object,
    names: dict[str, Any],
) -> Parts:
    check_options(names)
    if layout is not None and layout not in tuple(LAYOUTS):
        raise ModelError(f"{layout!r} is not a layout", where="layout", fix='give "ass" or "sas"')
    shape: tuple[int, ...] = ()
    if isinstance(P, Mapping) and P and all(map(is_table, P.values())):
        P, words = listed.of_tables(P, words_of(names.get("states"), "states"))
        if words:
            names, layout = names | {"states": words}, layout or "ass"
    by_entry = listed.is_listed(P)
    if by_entry:
        fitting = listed.layouts_of(P)
    else:
        P, shape = _array_or_matrices(P, "P")
        fitting = _layouts(shape)
    if layout is None and len(fitting) == 2:
        return _of_only_reading(P, R, discount, start, names)
    offered, keys = None, None
    if by_entry:
        if layout not in (None, *fitting):
            raise ModelError(
                f"these dictionaries or lists are not {layout!r}",
                where="layout",
                fix="leave it out; or give one square matrix for each action, by its name"
                if layout == "ass"
                else "leave it out; or give the rows of each state's actions, by state",
            )
        if (layout or fitting[0]) == "sas":
            rows, found = listed.rows_of(P, R, costs=names.get("sense") == "min")
            return _of_outcomes(rows, discount, start, found | names)
        P, offered, keys, found = listed.by_action(P)
        P, shape = _array_or_matrices(P, "P")
        names, layout = found | names, "ass"
    stacked, (states, actions), order = _stacked(P, shape, "P", "transitions", layout)
    pair = np.arange(actions * states)
    state, action = pair // actions, pair % actions

    def of_pairs(values: Any, where: str) -> Any:
        words = words_of(names.get("states"), "states")
        if keys is not None and is_table(values) and len(words) and {*values.index} == {*words}:
            values = values.T.to_dict()
        if keys is not None and isinstance(values, Mapping):
            values = listed.rewards_by_action(values, where, keys, words or range(states))
        like = order if states == actions else layout
        return _rewards_of_arrays(values, where, shape, order, like, (states, actions))

    def amounts(values: Any, where: str) -> Any:
        plain = not isinstance(values, Mapping) and not _is_sparse_list(values)
        if kept is not None and plain and array_of(values, where).shape == kept.shape:
            return array_of(values, where)  # of the pairs that are offered
        amounts_of = of_pairs(values, where)
        return amounts_of if kept is None else amounts_of[kept]

    reward = of_pairs(R, "R")
    names.setdefault("actions", [str(number) for number in range(actions)])
    kept = _offered(reward, names)
    if offered is not None:
        kept = np.flatnonzero(offered) if kept is None else kept[offered[kept]]
    each_component(names, amounts)
    if kept is not None:
        state, action, stacked, reward = state[kept], action[kept], stacked[kept], reward[kept]
    return _from_rows(state, action, stacked, reward, discount, start, names)


def _of_only_reading(
    P: Any, R: Any, discount: object, start: object, names: dict[str, Any]
) -> Parts:
    """Return the model of P whose shape fits both layouts; ModelError unless both make the same."""
    read: list[Parts] = []
    errors: dict[str, ModelError] = {}
    for layout in LAYOUTS:
        try:
            parts = _of_arrays(P, R, discount, layout, start, dict(names))
            check_model(ModelParts(**parts))
            read.append(parts)
        except ModelError as error:
            errors[layout] = error
    texts = {*map(str, errors.values())}
    for layout, fault in errors.items():
        if isinstance(fault, DistributionError) and (read or len(texts) == 2):
            other, shape = {"ass": ("sas", "(S, A, S)"), "sas": ("ass", "(A, S, S)")}[layout]
            fix = f'{fault.fix}; for P {shape} say layout="{other}"'
            raise type(fault)(fault.what, where=fault.where, fix=fix) from fault
    if not read:
        raise errors["ass"]
    if errors or not _same(*read):
        raise ModelError(
            "there are as many actions as states: P may go by action, then state, or by state, "
            "then action, and the models differ",
            where="P",
            fix='say which: layout="ass" for P[action][state][next state], layout="sas" for '
            "P[state][action][next state]",
        )
    return read[0]


def _same(one: Parts, other: Parts) -> bool:
    """Return whether two models are the same, number for number and name for name."""
    pairs = ("pair_state", "pair_action")
    arrays = [
        *((getattr(one["table"], f.name), getattr(other["table"], f.name)) for f in TABLE_FIELDS),
        *((one[name], other[name]) for name in pairs),
    ]
    named = ("space", "actions", "component_names", "component_table")
    return all(np.array_equal(*both) for both in arrays) and all(
        one.get(name) == other.get(name) for name in named
    )


def _rewards_of_arrays(
    R: Any,
    where: str,
    of_transitions: tuple[int, ...],
    order: str,
    layout: str | None,
    shape: tuple[int, int],
) -> Any:
    """Return rewards as `from_arrays` takes them for each pair (L,) or transition (L, S).

    Transitions have a shape and an order, rewards of transitions this layout where it is given.
    """
    states, actions = shape
    if isinstance(R, Mapping):
        raise ModelError(
            "the rewards are a dictionary, and P is an array",
            where=where,
            fix=f"give an array ({states}, {actions}), or P as a dictionary, too",
        )
    given, given_shape = _array_or_matrices(R, where)
    rewards = None if isinstance(given, list) else dense(given)
    if where != "R" and rewards is not None and rewards.shape == (states * actions,):
        return rewards  # a component's amounts, one for each pair
    if rewards is None or rewards.ndim == 3:
        reward, sizes, _ = _stacked(given, given_shape, where, "rewards", layout)
    else:
        sizes = {(states,): shape}.get(rewards.shape, rewards.shape)
        reward = np.repeat(rewards, actions) if rewards.ndim == 1 else rewards.reshape(-1)
    if sizes != shape:
        turned = f"transitions have shape {of_transitions}, (S, A, S), and " * (order == "sas")
        raise ShapeError(
            f"{turned}rewards have shape {given_shape}",
            where=where,
            fix=f"give ({states},), ({states}, {actions}) or ({actions}, {states}, {states})",
        )
    return reward


def _in_order(state: Integers, action: Integers) -> bool:
    """Return whether pairs are sorted by state, then action."""
    ahead, level = state[1:] > state[:-1], state[1:] == state[:-1]
    return bool((ahead | (level & (action[1:] >= action[:-1]))).all())


def _rewards_of_rows(reward: Any, where: str, rows: Any) -> Any:
    """Return rewards as `from_pairs` takes them: of pairs (L,) or transitions (L, S)."""
    rewards = array_of(reward, where)
    if rewards.shape != rows.shape:
        rewards = dense(rewards)
    if rewards.shape != rows.shape[:1] and rewards.shape != rows.shape:
        raise ShapeError(
            f"rewards have shape {rewards.shape}, not ({rows.shape[0]},)",
            where=where,
            fix="give one reward for each pair",
        )
    return rewards


def _of_outcomes(
    rows: Iterable[Any], discount: object, start: object, names: dict[str, Any]
) -> Parts:
    try:
        pairs = [(index(row[0]), index(row[1]), list(row[2])) for row in rows]
        order = sorted(range(len(pairs)), key=lambda number: pairs[number][:2])
        pairs = [pairs[number] for number in order]
        state = np.array([row[0] for row in pairs], dtype=np.int64)
        action = np.array([row[1] for row in pairs], dtype=np.int64)
        every = [(p, index(then), reward) for row in pairs for p, then, reward in row[2]]
        following = np.array([then for _, then, _ in every], dtype=np.int64)
    except (TypeError, ValueError, LookupError, OverflowError) as error:
        raise ModelError(
            f"a row or an outcome is not of the right form: {error}",
            where="rows",
            fix="give (state, action, [(probability, next state, reward), …]) with whole numbers "
            "for states and actions",
        ) from error
    size = int(max([*state, *following], default=-1)) + 1
    chance, gain = (one_kind([each[place] for each in every]) for place in (0, 2))
    offsets = np.cumsum([0, *(len(row[2]) for row in pairs)])
    table = table_of(offsets, following, chance, gain, size, names, by_pair=False, own=True)
    each_component(names, lambda values, where: of_length(values, where, len(pairs))[order])
    _observed(names, np.array(order, dtype=np.int64), len(order))
    return _assemble(state, action, table, size, discount, start, names)


def _observed(names: dict[str, Any], order: Integers, total: int) -> None:
    """Put observations of all pairs (L,) in the order of those that the model has."""
    if names.get("observations") is not None:
        seen = whole_numbers(names["observations"], "observations")
        if seen.shape != (total,):
            raise ShapeError(
                f"{len(seen)} observations for {total} pairs",
                where="observations",
                fix="give one number for each pair",
            )
        names["observations"] = seen[order]


def _counted(table: OutcomeTable, seen: Integers) -> OutcomeTable:
    """Return a table in which rows that were observed n times are counts over n.

    Where floats are not the ones next to such counts, or exact numbers not equal to them, the table
    stays, and the model refuses it.
    """
    lengths, watched = np.diff(table.offsets), seen > 0
    top, bottom = table.integer_weights()
    if table.weight.dtype == np.float64:
        some = table.of_pairs(np.flatnonzero(watched))
        counts = counted(some.weight, some.offsets, seen[watched])
        if counts is None:
            return table
    else:
        each = np.repeat(watched, lengths)
        share, left = np.divmod(
            multiply(top, np.repeat(seen, lengths))[each], np.repeat(bottom, lengths)[each]
        )
        if left.any():
            return table
        counts = share
    top = np.array(top, dtype=object)
    top[np.repeat(watched, lengths)] = counts
    weights, below = integers(top.tolist()), integers(np.where(watched, seen, bottom).tolist())
    return replace(table, weight=weights, denominator=below)


def _from_rows(
    state: Integers,
    action: Integers,
    rows: Any,
    reward: Any,
    discount: object,
    start: object,
    names: dict[str, Any],
    below: Integers | None = None,
) -> Parts:
    """Build from sorted pairs, their (L, S) rows, over `below` (L,), and rewards (L,) or (L, S)."""
    size, by_pair = rows.shape[1], reward.ndim == 1
    if sp.issparse(rows):
        offsets, following, chance = rows.indptr, rows.indices, rows.data
        check_places(rows, "transition")
    else:
        positive, column = rows != 0, np.arange(size, dtype=np.int32)
        offsets = np.concatenate([[0], np.cumsum(np.count_nonzero(positive, axis=1))])
        if offsets[-1] == rows.size:  # as masks take their time
            following, chance = np.tile(column, len(rows)), rows.flatten()
        else:
            following, chance = np.broadcast_to(column, rows.shape)[positive], rows[positive]
    if not by_pair:
        reward = picked(reward, np.repeat(np.arange(len(state)), np.diff(offsets)), following)
    columns = offsets.astype(np.int64), following, chance, reward
    own = not sp.issparse(rows)
    table = table_of(*columns, size, names, by_pair=by_pair, own=own, below=below)
    return _assemble(state, action, table, size, discount, start, names)


def _assemble(
    state: Integers,
    action: Integers,
    table: OutcomeTable,
    size: int,
    discount: object,
    start: object,
    names: dict[str, Any],
) -> Parts:
    words = words_of(names.pop("states", ()), "states")
    actions = words_of(names.pop("actions", ()), "actions")
    if not actions:
        last = int(action.max(initial=-1))
        if last >= MOST_UNNAMED_ACTIONS:
            raise ModelError(
                f"there is an action {last}, and actions without names go to "
                f"{MOST_UNNAMED_ACTIONS - 1:,}",
                where="pairs",
                fix="number actions from 0 on, or name them all: actions=[…]",
            )
        actions = tuple(map(str, range(last + 1)))
    if words and len(words) > size:
        size = len(words)
    seen = names.get("observations")
    if seen is not None:
        seen = names["observations"] = whole_numbers(seen, "observations")
        table = _counted(table, seen) if seen.shape == (table.pairs,) else table
    space = names.pop("space", None)
    if space is None or words:
        space = StateSpace.plain(size, words)
    names |= named_components(names, table)
    return dict(
        table=table,
        pair_state=state,
        pair_action=action,
        space=space,
        actions=actions,
        discount_exact=as_discount(discount),
        start=as_start(start, space) if space.size else (),
        **names,
    )


def _offered(reward: Any, names: dict[str, Any]) -> Integers | None:
    """Return the pairs whose reward is not the infinity of actions not offered; None: all are."""
    never = np.inf if names.get("sense") == "min" else -np.inf
    if sp.issparse(reward):
        return None
    missing: Any = np.asarray(reward == never, dtype=bool)
    missing = missing.all(axis=1) if missing.ndim == 2 else missing
    return np.flatnonzero(~missing) if missing.any() else None


def _is_sparse_list(values: Any) -> bool:
    row = isinstance(values, np.ndarray) and values.dtype == object and values.ndim == 1
    return (row or isinstance(values, Sequence)) and any(map(sp.issparse, values))


def _array_or_matrices(values: Any, where: str) -> tuple[Any, tuple[int, ...]]:
    """Return an array, or a list of sparse matrices of one shape, and the shape of all."""
    what = "transitions" if where == "P" else "rewards"
    if sp.issparse(values) and values.ndim > 2:
        raise ShapeError(
            f"sparse {what} have shape {values.shape}",
            where=where,
            fix="give a list of A sparse (S, S) matrices, or np.array",
        )
    if not _is_sparse_list(values):
        array = array_of(values, where)
        return array, array.shape
    if not all(sp.issparse(matrix) for matrix in values):
        raise ModelError(
            f"{where} mixes sparse and dense matrices", where=where, fix="use one kind"
        )
    shapes = {matrix.shape for matrix in values}
    if len(shapes) > 1 or len(values[0].shape) != 2:
        raise ShapeError(
            f"matrices of {what} have shapes {sorted(shapes)}",
            where=where,
            fix="give A square matrices of the same size",
        )
    return list(values), (len(values), *values[0].shape)


def _layouts(shape: tuple[int, ...]) -> list[str]:
    """Return the layouts that an array of some shape fits; of a sparse matrix none."""
    if len(shape) != 3 or 0 in shape:
        return []
    return [layout for layout, at in LAYOUTS.items() if shape[at] == shape[2]]


def _stacked(
    array: Any, shape: tuple[int, ...], where: str, what: str, layout: str | None
) -> tuple[Any, tuple[int, int], str]:
    """Return P, or R by transition, as (L, S) rows in pair order, (S, A), and the layout."""
    fits = _layouts(shape)
    if not fits or layout not in (None, *fits):
        kind = "sparse " if sp.issparse(array) else ""
        subject = (
            f"matrices of {what} have shapes" if isinstance(array, list) else f"{what} have shape"
        )
        raise ShapeError(
            f"{kind}{subject} {shape}",
            where=where,
            fix="give (A, S, S), (S, A, S), or a list of A sparse (S, S) matrices"
            + (f"; this is not {layout!r}" if fits else ""),
        )
    layout = layout or fits[0]
    sizes = (shape[0], shape[1]) if layout == "sas" else (shape[1], shape[0])
    rows = sizes[0] * sizes[1]
    if isinstance(array, list):
        stacked = sp.csr_array(sp.vstack([array_of(matrix, where) for matrix in array], "csr"))
        order = np.arange(rows).reshape(shape[:2]).T.reshape(-1)
        return stacked if layout == "sas" else stacked[order], sizes, layout
    return (array if layout == "sas" else array.transpose(1, 0, 2)).reshape(rows, -1), sizes, layout
