"""Models from arrays, from rows and from lists of outcomes, floats or exact rationals alike.

Every number keeps its exact value, whatever stands beside it: Fractions, integers and "p/q" strings
are what they say, a float is the dyadic rational that it is, and outcomes that come twice are added
exactly. Where all numbers are doubles, and one at least was given as a float, the table holds them
as floats; else as integers over one denominator for each row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from functools import reduce
from math import isfinite
from operator import index, itemgetter
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from exact_mdp.mdp.components import completed
from exact_mdp.mdp.errors import ModelError, ShapeError, located
from exact_mdp.mdp.forms import listed
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import (
    Floats,
    Given,
    Integers,
    Numbers,
    OutcomeTable,
    as_float,
    by_outcome,
    exact,
    given,
    integers,
    ones,
    over_groups,
    rounding_of,
)
from exact_mdp.mdp.threads import IN_CACHE, block_ends, run_blocks
from exact_mdp.mdp.validate import as_discount, as_start

MOST_UNNAMED_ACTIONS = 100_000
LAYOUTS = {"ass": 1, "sas": 0}
"""Orders of the indices of P, and which of them is that of the states; where both fit, the first
is taken: action, state, next state."""

Outcomes = dict[tuple[int, Any, bool], Any]
"""Probabilities by next state, reward, and whether that may be a rounded one."""

Parts = dict[str, Any]
"""What `MDP` takes, by name."""


def from_arrays(
    P: Any, R: Any, discount: object, *, layout: str | None = None, start: object = 0, **names: Any
) -> Parts:
    """Return the parts of the model that `MDP.from_arrays` makes."""
    if layout != "ass" and listed.is_listed(P):
        rows, found = listed.rows_of(P, R, costs=names.get("sense") == "min")
        return from_outcomes(rows, discount, start=start, **(found | names))
    stacked, (states, actions), layout = _stacked(P, "P", "transitions", layout)
    pair = np.arange(actions * states)
    state, action = pair // actions, pair % actions

    def of_pairs(values: Any, where: str) -> Any:
        return _rewards_of_arrays(values, where, P, layout, (states, actions))

    reward = of_pairs(R, "R")
    _each_component(names, of_pairs)
    names.setdefault("actions", [str(number) for number in range(actions)])
    kept = _offered(reward, names)
    if kept is not None:
        state, action, stacked, reward = state[kept], action[kept], stacked[kept], reward[kept]
        _each_component(names, lambda values, _: values[kept])
    return _from_rows(state, action, stacked, reward, discount, start, names)


def _rewards_of_arrays(
    R: Any, where: str, P: Any, layout: str | None, shape: tuple[int, int]
) -> Any:
    """Return rewards as `from_arrays` takes them for each pair (L,) or transition (L, S)."""
    states, actions = shape
    rewards = None if _is_sparse_list(R) else _dense(_numbers(R, where))
    if where != "R" and rewards is not None and rewards.shape == (states * actions,):
        return rewards  # a component's amounts, one for each pair
    if rewards is None or rewards.ndim == 3:
        reward, sizes, _ = _stacked(R, where, "rewards", layout if states == actions else None)
    else:
        sizes = {(states,): shape}.get(rewards.shape, rewards.shape)
        reward = np.repeat(rewards, actions) if rewards.ndim == 1 else rewards.reshape(-1)
    if sizes != shape:
        turned = f"transitions have shape {np.shape(P)}, (S, A, S), and " if layout == "sas" else ""
        given = (len(R), *R[0].shape) if rewards is None else rewards.shape
        raise ShapeError(
            f"{turned}rewards have shape {given}",
            where=where,
            fix=f"give ({states},), ({states}, {actions}) or ({actions}, {states}, {states})",
        )
    return reward


@contextmanager
def hinting(P: Any, layout: str | None) -> Iterator[None]:
    """Add to an error that P may be meant as (S, A, S), where its shape does not tell."""
    try:
        yield
    except ModelError as error:
        try:
            shape = np.shape(P)
        except ValueError:  # rows of different lengths
            shape = ()
        if layout is None and len(shape) == 3 and len(set(shape)) == 1:
            fix = f'{error.fix}; for P (S, A, S) say layout="sas"'
            raise type(error)(error.what, where=error.where, fix=fix) from error
        raise


def from_pairs(
    pair_state: ArrayLike,
    pair_action: ArrayLike,
    transition: Any,
    reward: object,
    discount: object,
    *,
    start: object = 0,
    **names: Any,
) -> Parts:
    """Return the parts of the model that `MDP.from_pairs` makes."""
    state, action = _indices(pair_state, "pair_state"), _indices(pair_action, "pair_action")
    below = None
    if isinstance(transition, tuple) and len(transition) == 2 and sp.issparse(transition[0]):
        transition, below = transition[0], _indices(transition[1], "denominators")
    rows = _numbers(transition, "transition")
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
    _each_component(names, lambda values, where: _rewards_of_rows(values, where, rows))
    order = _offered(rewards, names)
    ahead, level = state[1:] > state[:-1], state[1:] == state[:-1]
    if not (ahead | (level & (action[1:] >= action[:-1]))).all():
        sorted_ = np.lexsort((action, state))
        order = sorted_ if order is None else sorted_[np.isin(sorted_, order)]
    if order is not None:
        state, action, rows, rewards = state[order], action[order], rows[order], rewards[order]
        _each_component(names, lambda values, _: values[order])
        below = None if below is None else below[order]
    return _from_rows(state, action, rows, rewards, discount, start, names, below)


def _rewards_of_rows(reward: Any, where: str, rows: Any) -> Any:
    """Return rewards as `from_pairs` takes them: of pairs (L,) or transitions (L, S)."""
    rewards = _numbers(reward, where)
    if rewards.shape != rows.shape:
        rewards = _dense(rewards)
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
    start: object = 0,
    **names: Any,
) -> Parts:
    """Return the parts of the model that `MDP.from_outcomes` makes."""
    try:
        listed = [(index(row[0]), index(row[1]), _merged(row[2])) for row in rows]
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
    weight = grouped([value for row in merged for value in row.values()], offsets)
    owned = _owned(merged)
    if owned is None:
        gain = grouped([reward for row in merged for reward in _earned(row)], offsets)
    else:
        gain = grouped(owned, np.arange(len(merged) + 1))
    table = _table(offsets, following, weight, gain, of_pairs=owned is not None)
    _each_component(names, lambda values, where: _of_length(values, where, len(listed))[order])
    size = int(max([*state, *following], default=-1)) + 1
    return _assemble(state, action, table, size, discount, start, names)


def _merged(outcomes: Iterable[tuple[Any, int, Any]]) -> Outcomes:
    """Return the positive probabilities of one pair by next state and reward, sorted.

    Rewards that are equal, one given as a float and one as an exact number, are kept apart.
    """
    row: Outcomes = {}
    for probability, then, reward in outcomes:
        earned, chance = _number(reward), _number(probability)
        key, known = (index(then), earned, rounding_of(earned) > 0), len(row)
        before = row.setdefault(key, chance)  # one look-up: fractions are slow to hash
        if len(row) == known:
            row[key] = _sum(before, chance)
    return {key: chance for key, chance in sorted(row.items(), key=itemgetter(0)) if chance}


def _owned(rows: list[Outcomes]) -> list[Any] | None:
    """Return the rewards of pairs where some are certain and none is of an outcome; else None.

    `OutcomeTable.row` says that a reward is certain where the pair earns it in full, although the
    probabilities do not sum to 1.
    """
    if not any(isinstance(key[1], Given) and key[1].certain for row in rows for key in row):
        return None
    for row in rows:
        rewards = {key[1] for key in row}
        if len(rewards) != 1 or not (_certain(row) or rewards == {0} or _total(row) == 1):
            return None
    return [next(iter(row))[1] for row in rows]


def _earned(row: Outcomes) -> list[Any]:
    """Return the rewards of a pair's outcomes, of which certain ones average what they are."""
    rewards = [key[1] for key in row]
    if not _certain(row):
        return rewards
    total = _total(row)
    return [Given(exact(reward) / total, rounding=rounding_of(reward)) for reward in rewards]


def _certain(row: Outcomes) -> bool:
    return bool(row) and all(isinstance(key[1], Given) and key[1].certain for key in row)


def _total(row: Outcomes) -> Fraction:
    return sum(map(exact, row.values()), Fraction(0))


def _sum(left: Fraction | float, right: Fraction | float) -> Fraction | float:
    """Return the exact sum of two numbers, of which each may be off by its rounding."""
    for value in (left, right):
        if isinstance(value, float) and not isfinite(value):
            return value  # no model: it is refused by its place
    total, off = exact(left) + exact(right), rounding_of(left) + rounding_of(right)
    return Given(total, rounding=off) if off else total


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
    if sp.issparse(rows) and rows.dtype == np.float64 and rows.has_canonical_format:
        rows, lowest = _copied(rows)
        if lowest <= 0:
            rows.eliminate_zeros()
        rising = True
        offsets, following = rows.indptr.astype(np.int64), rows.indices
        weight = _Grouped(rows.data, ones(len(state)))
    elif sp.issparse(rows):
        offsets, following, values = _added(rows)
        weight = grouped(values, offsets)
        if below is not None:
            weight = _Grouped(integers(map(int, values)), below)
    else:
        kept = rows.astype(bool)
        pair, following = np.nonzero(kept)
        offsets = np.concatenate([[0], np.cumsum(kept.sum(axis=1))]).astype(np.int64)
        weight = grouped(rows[pair, following], offsets)
    if reward.ndim == 1:
        # A copy: the model freezes its arrays, and the caller's stay the caller's.
        gain = grouped(np.array(reward), np.arange(len(state) + 1))
    else:
        pair = np.repeat(np.arange(len(state)), np.diff(offsets))
        gain = grouped(_picked(reward, pair, following), offsets)
    following = following if size < 2**31 else following.astype(np.int64)
    table = _table(offsets, following, weight, gain, of_pairs=reward.ndim == 1)
    if rising and len(table.next) == len(following):
        vars(table)["rising"] = True  # SciPy made it so, and need not be asked again
    return _assemble(state, action, table, size, discount, start, names)


def _each_component(names: dict[str, Any], change: Callable[[Any, str], Any]) -> None:
    """Replace what is given for each component of the reward by what a function makes of it."""
    given = names.get("components")
    if given is None:
        return
    if not isinstance(given, Mapping):
        columns = _numbers(given, "components")
        words = tuple(names.get("component_names", ()))
        if columns.ndim != 2 or columns.shape[1] != len(words):
            raise ModelError(
                f"components have shape {columns.shape} for {len(words)} names",
                where="components",
                fix="give {name: amounts}",
            )
        given = dict(zip(words, columns.T, strict=True))
    found = {str(name): change(values, f"component {name}") for name, values in given.items()}
    if not found:
        raise ModelError("no component is given", where="components", fix="name one, or none")
    names["components"] = found


def _of_length(values: Any, where: str, pairs: int) -> Any:
    """Return amounts (L,) for L pairs."""
    amounts = _numbers(values, where)
    if amounts.shape != (pairs,):
        raise ShapeError(
            f"amounts have shape {amounts.shape}, not ({pairs},)",
            where=where,
            fix="give one amount for each pair",
        )
    return amounts


def named_components(parts: Parts, table: OutcomeTable) -> Parts:
    """Take `components` out of parts; return names and table of them, the rest of the reward too.

    Amounts are those of the table's pairs (L,), or of transitions (L, S).
    """
    if parts.get("components") is None:
        parts.pop("components", None)
        return {}
    _each_component(
        parts, lambda values, where: _of_length(values, where, table.pairs)
        if len(np.shape(values)) < 2 else values,
    )  # fmt: skip
    columns = {}
    for name, values in parts.pop("components").items():
        if values.ndim == 1:
            found = grouped(np.array(values), np.arange(table.pairs + 1))
            top, bottom = found.top, found.bottom
        else:
            found = grouped(_picked(values, table.pair, table.next), table.offsets)
            earning = replace(table, gain=found.top, gain_denominator=found.bottom)
            top, bottom = by_outcome(earning).expected_gain_exact()
        _check_finite(top, name)
        columns[name] = top, bottom
    names, known = completed(columns, table)
    return {"component_names": names, "component_table": known}


def _check_finite(values: Numbers, name: str) -> None:
    if values.dtype == np.float64 and not np.isfinite(values).all():
        raise ModelError(
            f"an amount is {values[~np.isfinite(values)][0]}",
            where=f"component {name}",
            fix="give a finite number",
        )


def _table(
    offsets: Integers, following: Numbers, weight: _Grouped, gain: _Grouped, *, of_pairs: bool
) -> OutcomeTable:
    table = OutcomeTable(
        offsets=offsets,
        next=following,
        weight=weight.top,
        denominator=weight.bottom,
        gain=gain.top,
        gain_denominator=gain.bottom,
        weight_doubt=weight.doubt,
        gain_doubt=gain.doubt,
    )
    return table if of_pairs else by_outcome(table)


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


def _added(matrix: sp.csr_array) -> tuple[Integers, Numbers, Any]:
    """Return where rows begin, columns in rising order, and values, equal places added exactly."""
    matrix = matrix.copy()
    matrix.sort_indices()
    row = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    fresh = np.ones(len(row), dtype=bool)
    fresh[1:] = (np.diff(row) != 0) | (np.diff(matrix.indices) != 0)
    values: Any = matrix.data
    if not fresh.all():
        first = np.flatnonzero(fresh)
        parts = [_number(value) for value in matrix.data]
        values = np.empty(len(first), dtype=object)
        ends = [*first[1:].tolist(), len(parts)]
        values[:] = [
            reduce(_sum, parts[begin:end]) for begin, end in zip(first.tolist(), ends, strict=True)
        ]
        row = row[first]
    kept = np.asarray(values != 0, dtype=bool)
    counts = np.bincount(row[kept], minlength=matrix.shape[0])
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return offsets, matrix.indices[fresh][kept], values[kept]


def _picked(rewards: Any, row: Integers, column: Numbers) -> Any:
    """Return the entries of a dense or sparse (L, S) array of rewards at some places."""
    if not sp.issparse(rewards):
        return np.asarray(rewards[row, column])
    offsets, following, values = _added(rewards)
    places = np.arange(1, len(following) + 1)
    lookup = sp.csr_array((places, following, offsets), shape=rewards.shape)
    return np.append(values, values.dtype.type(0) if values.dtype != object else 0)[
        np.asarray(lookup[row, column]) - 1
    ]


def _dense(values: Any) -> Any:
    """Return a sparse array as a dense one; others as they are."""
    if not sp.issparse(values):
        return values
    offsets, following, found = _added(values)
    array = np.zeros(values.shape, dtype=found.dtype)
    array[np.repeat(np.arange(values.shape[0]), np.diff(offsets)), following] = found
    return array


def _assemble(
    state: Integers,
    action: Integers,
    table: OutcomeTable,
    size: int,
    discount: object,
    start: object,
    names: dict[str, Any],
) -> Parts:
    words = names.pop("states", ())
    actions = tuple(str(name) for name in names.pop("actions", ()))
    if not actions:
        if int(action.max(initial=-1)) >= MOST_UNNAMED_ACTIONS:
            raise ModelError(
                f"action {int(action.max())} is outside 0 … {MOST_UNNAMED_ACTIONS - 1}",
                where="pairs",
                fix="number actions from 0 on, or name them all",
            )
        actions = tuple(str(number) for number in range(int(action.max(initial=-1)) + 1))
    if words and len(words) > size:
        size = len(words)
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
    return isinstance(values, Sequence) and any(sp.issparse(matrix) for matrix in values)


def _stacked(
    values: Any, where: str, what: str, layout: str | None
) -> tuple[Any, tuple[int, int], str]:
    """Return P, or R by transition, as (L, S) rows in pair order, (S, A), and the layout."""
    array: Any
    if _is_sparse_list(values):
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
        array, shape, what = values, (len(values), *values[0].shape), f"matrices of {what}"
    else:
        array = values if sp.issparse(values) else _numbers(values, where)
        shape = array.shape
    flat = sp.issparse(array) or len(shape) != 3 or 0 in shape
    fits = [] if flat else [name for name, at in LAYOUTS.items() if shape[at] == shape[2]]
    if layout is not None and layout not in LAYOUTS:
        raise ModelError(f"{layout!r} is not a layout", where="layout", fix='give "ass" or "sas"')
    if not fits or layout not in (None, *fits):
        raise ShapeError(
            f"{'sparse ' if sp.issparse(array) else ''}{what} have shapes {shape}"
            if _is_sparse_list(values)
            else f"{'sparse ' if sp.issparse(array) else ''}{what} have shape {shape}",
            where=where,
            fix="give (A, S, S), (S, A, S), or a list of A sparse (S, S) matrices"
            + (f"; this is not {layout!r}" if fits else ""),
        )
    layout = layout or fits[0]
    sizes = (shape[0], shape[1]) if layout == "sas" else (shape[1], shape[0])
    rows = sizes[0] * sizes[1]
    if not isinstance(array, np.ndarray):
        stacked = sp.csr_array(sp.vstack([_numbers(matrix, where) for matrix in values], "csr"))
        order = np.arange(rows).reshape(shape[:2]).T.reshape(-1)
        return stacked if layout == "sas" else stacked[order], sizes, layout
    return (array if layout == "sas" else array.transpose(1, 0, 2)).reshape(rows, -1), sizes, layout


def _numbers(values: object, where: str) -> Any:
    """Return a sparse matrix as a CSR array, others as an array of one kind or of objects.

    Numbers of several kinds, or exact ones, are objects: floats, and `Fraction`s.
    """
    with located(where):
        return _sparse(values) if sp.issparse(values) else _array(values)


def _sparse(values: Any) -> sp.csr_array:
    """Return a sparse matrix as a CSR array; places that come twice still do."""
    if values.dtype.kind not in "fiub":
        raise ModelError(f"a sparse matrix of type {values.dtype}", fix="give real numbers")
    if values.ndim != 2:
        raise ModelError(
            f"a sparse array of {values.ndim} dimensions", fix="give a sparse matrix, or np.array"
        )
    if values.format in ("csr", "csc", "coo"):
        _check_places(values)
    found = sp.csr_array(values)
    if values.format == "coo" and found.nnz != values.nnz:
        # SciPy added up what comes twice, in floats: here it stays.
        order = np.lexsort((values.col, values.row))
        counts = np.bincount(values.row, minlength=values.shape[0])
        indptr = np.concatenate([[0], np.cumsum(counts)]).astype(values.col.dtype)
        parts = (values.data[order], values.col[order], indptr)
        found = sp.csr_array(parts, shape=values.shape)
    whole = found.dtype.kind in "iub" and found.dtype != np.uint64
    return found.astype(np.int64) if whole else found


def _check_places(matrix: Any) -> None:
    """Raise ModelError where a sparse matrix names a row or column that it does not have."""
    sizes = dict(zip(("row", "column"), matrix.shape, strict=True))
    if matrix.format == "coo":
        named = {"row": matrix.row, "column": matrix.col}
    else:
        named = {"column" if matrix.format == "csr" else "row": matrix.indices}
        ends = matrix.indptr
        if ends[0] != 0 or ends[-1] != len(matrix.indices) or (np.diff(ends) < 0).any():
            raise ModelError(
                "a sparse matrix whose indptr does not run from 0 to its number of entries",
                fix="build it anew, from coordinates for example",
            )
    for what, numbers in named.items():
        if len(numbers) and not 0 <= numbers.min() <= numbers.max() < sizes[what]:
            worst = numbers.min() if numbers.min() < 0 else numbers.max()
            raise ModelError(
                f"a sparse matrix of shape {matrix.shape} has an entry in {what} {worst}",
                fix=f"number its {what}s from 0 to {sizes[what] - 1}",
            )


def _array(values: Any) -> Any:
    kinds = _kinds(values)
    try:
        if len(kinds) == 1 or kinds <= {float, np.float64} or kinds <= {int, bool}:
            array = np.asarray(values)
        else:
            array = np.array(_leaves(values), dtype=object)
            if any(isinstance(value, list) for value in array.flat):
                raise ValueError
    except ValueError as error:
        raise ModelError("rows of different lengths", fix="make the array rectangular") from error
    if array.dtype.kind in "iub" and array.dtype != np.uint64:
        return array.astype(np.int64)
    if array.dtype.kind == "f" and int not in kinds:
        return array
    if array.dtype.kind not in "OUSuf":
        raise ModelError(f"an array of type {array.dtype}", fix="give real numbers")
    if array.dtype != object:
        array = np.array(_leaves(values), dtype=object)
    flat = np.empty(array.size, dtype=object)
    zero = Fraction(0)  # one for all: rows are mostly zeros
    flat[:] = [zero if type(value) is int and not value else _number(value) for value in array.flat]
    return flat.reshape(array.shape)


def _kinds(values: Any) -> set[Any]:
    """Return the types of the numbers in an array, or in lists of lists."""
    if isinstance(values, np.ndarray):
        return {values.dtype.type}
    if not isinstance(values, list | tuple):
        return {type(values)}
    kinds = set(map(type, values))
    if any(issubclass(kind, list | tuple | np.ndarray) for kind in kinds):
        return set().union(*map(_kinds, values))
    return kinds


def _leaves(values: Any) -> Any:
    """Return lists of lists of the numbers as they were given, each of its own type."""
    if isinstance(values, list | tuple) or (isinstance(values, np.ndarray) and values.ndim):
        return [_leaves(value) for value in values]
    return values


def _number(value: object) -> Fraction | float:
    """Return an exact number, or the double itself where one was given."""
    if isinstance(value, Fraction) or type(value) is float:
        return value
    return float(value) if isinstance(value, float) else given(value)


def _indices(values: ArrayLike, what: str) -> Integers:
    array = np.asarray(values)
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise ModelError(
            f"{what} is not a list of whole numbers", where=what, fix="give integers of shape (L,)"
        )
    return array.astype(np.int64)


class _Grouped(NamedTuple):
    """Numbers as the arrays of a table: top over one bottom for each group, and their roundings."""

    top: Numbers
    bottom: Numbers
    doubt: Floats | None = None


def grouped(values: Any, offsets: Integers) -> _Grouped:
    """Return numbers as an array with one denominator for each group of them."""
    groups = len(offsets) - 1
    if isinstance(values, np.ndarray) and values.dtype in (np.float64, np.int64):
        return _Grouped(np.ascontiguousarray(values), ones(groups))
    if isinstance(values, np.ndarray) and values.dtype != object:
        with np.errstate(over="ignore"):
            doubles = values.astype(np.float64)
        if values.dtype.kind == "f" and not (doubles != values).any():
            off = np.where(values == 0, 0, np.spacing(np.abs(values)).astype(np.float64) / 2)
            return _Grouped(doubles, ones(groups), _doubt(doubles, off))
        values = [_number(value) for value in values]
    flat = list(values)
    if set(map(type, flat)) == {float}:
        return _Grouped(np.array(flat), ones(groups))
    off = np.array([rounding_of(value) for value in flat])
    if off.any() or any(isinstance(value, float) for value in flat):
        if any(isinstance(value, float) and not isfinite(value) for value in flat):
            # The model is refused, by the place of the number.
            return _Grouped(np.array([as_float(value) for value in flat]), ones(groups))
        if all(isinstance(value, float) or _is_double(value) for value in flat):
            doubles = np.array([float(value) for value in flat])
            return _Grouped(doubles, ones(groups), _doubt(doubles, off))
    top, bottom = over_groups([exact(value) for value in flat], offsets)
    return _Grouped(top, bottom, off if off.any() else None)


def _doubt(doubles: Floats, off: Floats) -> Floats | None:
    """Return the roundings of doubles, None where they are those of any doubles."""
    usual = np.where(doubles == 0, 0.0, np.spacing(np.abs(doubles)) / 2)
    return None if np.array_equal(usual, off) else np.asarray(off, dtype=np.float64)


def _is_double(value: Fraction) -> bool:
    """Return whether a double has exactly this value."""
    try:
        return float(value) == value
    except OverflowError:
        return False
