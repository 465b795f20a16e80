"""Models from arrays, from rows and from lists of outcomes, floats or exact rationals alike.

Every number keeps its exact value, whatever stands beside it (`mdp.forms.numbers`); rows of floats
mean what `mdp.rows` says, and outcomes that come twice are added exactly. Where all numbers are
doubles, and one at least was given as a float, the table holds them as floats; else as integers
over one denominator for each row.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from fractions import Fraction
from operator import index, itemgetter
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from exact_mdp.mdp.components import each_component, named_components, of_length
from exact_mdp.mdp.errors import DistributionError, ModelError, ShapeError, words_of
from exact_mdp.mdp.forms import listed
from exact_mdp.mdp.forms.numbers import (
    Grouped,
    added,
    array_of,
    as_given,
    chance_sum,
    chances,
    check_places,
    dense,
    grouped,
    is_table,
    picked,
    whole_numbers,
)
from exact_mdp.mdp.forms.threads import IN_CACHE, block_ends, run_blocks
from exact_mdp.mdp.rows import counted, meant
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import (
    COMPILED,
    Floats,
    Integers,
    Numbers,
    OutcomeTable,
    integers,
    multiply,
    ones,
    settle_rows,
)
from exact_mdp.mdp.validate import Parts as ModelParts
from exact_mdp.mdp.validate import as_discount, as_start, check_model, check_options, last_action

MOST_UNNAMED_ACTIONS = 100_000
LAYOUTS = {"ass": 1, "sas": 0}
"""Orders of the indices of P, action, state, next state or state, action, next state, and which of
the indices is that of the states."""

TABLE_FIELDS = fields(OutcomeTable)

Outcomes = dict[tuple[int, Fraction | float], Fraction | float]
"""Probabilities by next state and reward."""

Parts = dict[str, Any]
"""What `MDP` takes, by name."""


def from_arrays(
    P: Any,
    R: Any,
    discount: object,
    *,
    layout: str | None = None,
    start: object = None,
    **names: Any,
) -> Parts:
    """Return the parts of the model that `MDP.from_arrays` makes."""
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
            return from_outcomes(rows, discount, start=start, **(found | names))
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
        found = of_pairs(values, where)
        return found if kept is None else found[kept]

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
            parts = from_arrays(P, R, discount, layout=layout, start=start, **names)
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


def from_pairs(
    pair_state: ArrayLike,
    pair_action: ArrayLike,
    transition: Any,
    reward: object,
    discount: object,
    *,
    start: object = None,
    **names: Any,
) -> Parts:
    """Return the parts of the model that `MDP.from_pairs` makes."""
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
            f"{len(state)} states and {len(action)} actions for transitions of shape {rows.shape}",
            where="pairs",
            fix="give one state, one action and one row of (L, S) for each pair",
        )
    rewards = _rewards_of_rows(reward, "reward", rows)
    each_component(names, lambda values, where: _rewards_of_rows(values, where, rows))
    order = _offered(rewards, names)
    if last_action(state, action) < 0 and not _in_order(state, action):
        sorted_ = np.lexsort((action, state))
        order = sorted_ if order is None else sorted_[np.isin(sorted_, order)]
    if order is not None:
        _observed(names, order, len(state))
        state, action, rows, rewards = state[order], action[order], rows[order], rewards[order]
        each_component(names, lambda values, _: values[order])
        below = None if below is None else below[order]
    return _from_rows(state, action, rows, rewards, discount, start, names, below)


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


def from_outcomes(
    rows: Iterable[tuple[int, int, Sequence[tuple[Any, int, Any]]]],
    discount: object,
    *,
    start: object = None,
    **names: Any,
) -> Parts:
    """Return the parts of the model that `MDP.from_outcomes` makes."""
    check_options(names)
    try:
        listed = [(index(row[0]), index(row[1]), *_merged(row[2])) for row in rows]
        order = sorted(range(len(listed)), key=lambda number: listed[number][:2])
        listed = [listed[number] for number in order]
        state = np.array([row[0] for row in listed], dtype=np.int64)
        action = np.array([row[1] for row in listed], dtype=np.int64)
        merged = [row[2] for row in listed]
        following = np.array([key[0] for row in merged for key in row], dtype=np.int64)
    except (TypeError, ValueError, LookupError, OverflowError) as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(
            f"a row or an outcome is not of the right form: {error}",
            where="rows",
            fix="give (state, action, [(probability, next state, reward), …]) with whole numbers "
            "for states and actions",
        ) from error
    offsets = np.concatenate([[0], np.cumsum([len(row) for row in merged])]).astype(np.int64)
    weight = chances([value for row in merged for value in row.values()], offsets)
    rewards = [[reward for _, reward in row] for row in merged]
    if all(len(set(row)) == 1 for row in rewards):  # whatever follows
        gain = grouped([row[0] for row in rewards], np.arange(len(rewards) + 1))
    else:
        gain = grouped([reward for row in rewards for reward in row], offsets)
    table = _table(offsets, following, weight, gain)
    for place, name in ((3, "float_probabilities"), (4, "float_rewards")):
        names[name] = names.get(name, False) or any(row[place] for row in listed)
    each_component(names, lambda values, where: of_length(values, where, len(listed))[order])
    _observed(names, np.array(order, dtype=np.int64), len(order))
    size = int(max([*state, *following], default=-1)) + 1
    return _assemble(state, action, table, size, discount, start, names)


def _merged(outcomes: Iterable[tuple[Any, int, Any]]) -> tuple[Outcomes, bool, bool]:
    """Return a pair's positive probabilities, sorted; whether these, and rewards, are floats."""
    every = [(as_given(p), index(then), as_given(reward)) for p, then, reward in outcomes]
    keys = [(then, reward) for _, then, reward in every]
    row: Outcomes = dict(zip(keys, (chance for chance, _, _ in every), strict=True))
    if len(row) < len(keys):
        row = {}
        for key, chance in zip(keys, meant([chance for chance, _, _ in every]), strict=True):
            row[key] = chance_sum(row[key], chance) if key in row else chance
    kept = {key: chance for key, chance in sorted(row.items(), key=itemgetter(0)) if chance}
    chances, _, rewards = zip(*every, strict=True) if every else ((), (), ())
    return kept, _any_float(chances), _any_float(rewards)


def _any_float(numbers: Iterable[object]) -> bool:
    return any(isinstance(number, float) for number in numbers)


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
    size = rows.shape[1]
    rising = False
    sound = _taken(rows) if sp.issparse(rows) else None
    if sound is None and sp.issparse(rows):
        check_places(rows, "transition")
    if sound is not None:
        (offsets, following, data), rising = sound, True
        weight = Grouped(data, ones(len(state)), True)
    elif sp.issparse(rows) and rows.dtype == np.float64 and _canonical(rows):
        rows, lowest = _copied(rows)
        if lowest <= 0:
            rows.eliminate_zeros()
        rising = True
        offsets, following = rows.indptr.astype(np.int64), rows.indices
        weight = Grouped(rows.data, ones(len(state)), True)
    elif sp.issparse(rows):
        offsets, following, values = added(rows, chances=True)
        weight = chances(values, offsets)._replace(floats=rows.dtype.kind == "f")
        if below is not None:
            weight = Grouped(integers(map(int, values)), below, False)
    else:
        kept = rows.astype(bool)
        pair, following = np.nonzero(kept)
        offsets = np.concatenate([[0], np.cumsum(kept.sum(axis=1))]).astype(np.int64)
        weight = chances(rows[pair, following], offsets)
    if reward.ndim == 1:
        # A copy: the model freezes its arrays, and the caller's stay the caller's.
        gain = grouped(np.array(reward), np.arange(len(state) + 1))
    else:
        pair = np.repeat(np.arange(len(state)), np.diff(offsets))
        gain = grouped(picked(reward, pair, following), offsets)
    following = following if size < 2**31 else following.astype(np.int64)
    table = _table(offsets, following, weight, gain)
    names |= {"float_probabilities": weight.floats, "float_rewards": gain.floats}
    if rising:
        vars(table)["rising"] = True  # it was made so, and need not be asked again
        if sound is not None:
            vars(table)["sound"] = True
    return _assemble(state, action, table, size, discount, start, names)


def _table(offsets: Integers, following: Numbers, weight: Grouped, gain: Grouped) -> OutcomeTable:
    if weight.top.dtype == np.float64:
        settle_rows(weight.top, offsets)
    table = OutcomeTable(
        offsets=offsets,
        next=following,
        weight=weight.top,
        denominator=weight.bottom,
        gain=gain.top,
        gain_denominator=gain.bottom,
    )
    vars(table)["is_settled"] = True
    return table


def _taken(rows: Any) -> tuple[Integers, Numbers, Floats] | None:
    """Return offsets (L+1,), columns and numbers (N,) of a sparse matrix, copied in one pass.

    None where there are too few entries for compiled loops, and where rows are not sound as they
    are.
    """
    wide, small = rows.shape[1] >= 2**31, rows.nnz < COMPILED
    if small or rows.dtype != np.float64 or wide or not rows.shape[0]:
        return None
    offsets = rows.indptr.astype(np.int64)
    columns, data = np.empty(offsets[-1], dtype=rows.indices.dtype), np.empty(offsets[-1])
    ends, given = block_ends(offsets), (rows.shape[1], offsets, rows.indices, rows.data)
    longest = int((offsets[1:] - offsets[:-1]).max())
    from exact_mdp.mdp.forms import rows as loops

    good, size = [False] * (len(ends) - 1), max(longest, loops.DIGITS)

    def work(number: int, first: int, last: int) -> None:
        room = np.empty((3, size), dtype=np.int64)
        good[number] = loops.taken(first, last, *given, columns, data, room)

    run_blocks(ends, work)
    return (offsets, columns, data) if all(good) else None


def _canonical(rows: sp.csr_array) -> bool:
    """Return whether columns rise strictly in each row, whatever the matrix remembers of that."""
    parts = (rows.data, rows.indices, rows.indptr)
    return bool(sp.csr_array(parts, shape=rows.shape, copy=False).has_canonical_format)


def _copied(rows: sp.csr_array) -> tuple[sp.csr_array, float]:
    """Return a copy in floats, as the model's arrays are its own, and the least entry."""
    indptr = rows.indptr.copy()
    data, indices = np.empty(indptr[-1]), np.empty(indptr[-1], dtype=rows.indices.dtype)
    ends = block_ends(indptr, most=IN_CACHE)
    lowest = np.full(len(ends) - 1, np.inf)

    def work(number: int, first: int, last: int) -> None:
        here = slice(indptr[first], indptr[last])
        data[here], indices[here] = rows.data[here], rows.indices[here]
        lowest[number] = data[here].min(initial=np.inf)

    run_blocks(ends, work)
    return sp.csr_array((data, indices, indptr), shape=rows.shape, copy=False), lowest.min()


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
