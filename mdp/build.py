"""Models from arrays, from rows and from lists of outcomes, floats or exact rationals alike.

Numbers that are all Fractions, integers or "p/q" strings stay exact; where a float is among them,
the row is kept in floats, each being the dyadic rational that it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from operator import index
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from mdp.errors import ModelError
from mdp.model import MDP, as_discount, as_start
from mdp.space import StateSpace
from mdp.table import (
    Integers,
    Numbers,
    OutcomeTable,
    as_float,
    common,
    exact,
    float_array,
    integers,
    ones,
)
from mdp.threads import IN_CACHE, block_ends, run_blocks

MOST_UNNAMED_ACTIONS = 100_000


def from_arrays(P: object, R: object, discount: object, *, start: object = 0, **names: Any) -> MDP:
    """See `MDP.from_arrays`."""
    stacked, actions, states = _stacked(P)
    pair = np.arange(actions * states)
    state, action = pair // actions, pair % actions
    rewards = _stacked(R)[0] if _is_sparse_list(R) else _sparse_or_array(R)
    if rewards.shape == (actions * states, states) and _is_sparse_list(R):
        reward = rewards
    elif rewards.shape == (states,):
        reward = np.repeat(rewards, actions)
    elif rewards.shape == (states, actions):
        reward = rewards.reshape(-1)
    elif rewards.shape == (actions, states, states):
        reward = rewards.transpose(1, 0, 2).reshape(actions * states, states)
    else:
        raise ModelError(
            f"rewards have shape {rewards.shape}",
            where="R",
            fix=f"give ({states},), ({states}, {actions}) or ({actions}, {states}, {states})",
        )
    names.setdefault("actions", [str(number) for number in range(actions)])
    return _from_rows(state, action, stacked, reward, discount, start, names)


def from_pairs(
    pair_state: ArrayLike,
    pair_action: ArrayLike,
    transition: object,
    reward: object,
    discount: object,
    *,
    start: object = 0,
    **names: Any,
) -> MDP:
    """See `MDP.from_pairs`."""
    state, action = _indices(pair_state, "pair_state"), _indices(pair_action, "pair_action")
    rows = _sparse_or_array(transition)
    rewards = _sparse_or_array(reward)
    if rows.ndim != 2 or len(state) != rows.shape[0] or len(action) != len(state):
        raise ModelError(
            f"{len(state)} states and {len(action)} actions for transitions of shape {rows.shape}",
            where="pairs",
            fix="give one state, one action and one row of (L, S) for each pair",
        )
    if rewards.shape != (len(state),) and rewards.shape != rows.shape:
        raise ModelError(
            f"rewards have shape {rewards.shape}, not ({len(state)},)",
            where="reward",
            fix="give one reward for each pair",
        )
    ahead, level = state[1:] > state[:-1], state[1:] == state[:-1]
    if not (ahead | (level & (action[1:] >= action[:-1]))).all():
        order = np.lexsort((action, state))
        state, action, rows, rewards = state[order], action[order], rows[order], rewards[order]
    return _from_rows(state, action, rows, rewards, discount, start, names)


def from_outcomes(
    rows: Iterable[tuple[int, int, Sequence[tuple[Any, int, Any]]]],
    discount: object,
    *,
    start: object = 0,
    **names: Any,
) -> MDP:
    """See `MDP.from_outcomes`."""
    try:
        listed = [(index(row[0]), index(row[1]), _merged(row[2])) for row in rows]
        listed.sort(key=lambda row: row[:2])
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
    flat = [key for row in merged for key in row]
    offsets = np.concatenate([[0], np.cumsum([len(row) for row in merged])]).astype(np.int64)
    weight, denominator = _grouped([value for row in merged for value in row.values()], offsets)
    gain, gain_denominator = _grouped([key[1] for key in flat], offsets)
    table = OutcomeTable(
        offsets=offsets,
        next=following,
        weight=weight,
        denominator=denominator,
        gain=gain,
        gain_denominator=gain_denominator,
    )
    table = by_outcome(table)
    size = int(max([*state, *following], default=-1)) + 1
    return _assemble(state, action, table, size, discount, start, names)


def _merged(outcomes: Iterable[tuple[Any, int, Any]]) -> dict[tuple[int, Any], Any]:
    """Return the positive probabilities of one pair by next state and reward, sorted."""
    row: dict[tuple[int, Any], Any] = {}
    for probability, then, reward in outcomes:
        key = (index(then), _number(reward))
        row[key] = row.get(key, 0) + _number(probability)
    return {key: row[key] for key in sorted(row) if row[key] != 0}


def _from_rows(
    state: Integers,
    action: Integers,
    rows: Any,
    reward: Any,
    discount: object,
    start: object,
    names: dict[str, Any],
) -> MDP:
    """Build from sorted pairs, their (L, S) rows and rewards (L,) or (L, S)."""
    size = rows.shape[1]
    if sp.issparse(rows):
        rows, lowest = _copied(rows)
        rows.sum_duplicates()
        if lowest <= 0:
            rows.eliminate_zeros()
        rising = True
        offsets, following = rows.indptr.astype(np.int64), rows.indices
        weight: Numbers = rows.data
        denominator = ones(len(state))
    else:
        rising = False
        kept = np.array(rows != 0, dtype=bool)
        pair, following = np.nonzero(kept)
        offsets = np.concatenate([[0], np.cumsum(kept.sum(axis=1))]).astype(np.int64)
        weight, denominator = _grouped(rows[pair, following], offsets)
    if reward.ndim == 1:
        # A copy: the model freezes its arrays, and the caller's stay the caller's.
        gain, gain_denominator = _grouped(np.array(reward), np.arange(len(state) + 1))
    else:
        pair = np.repeat(np.arange(len(state)), np.diff(offsets))
        gain, gain_denominator = _grouped(np.asarray(reward[pair, following]), offsets)
    table = OutcomeTable(
        offsets=offsets,
        next=following if size < 2**31 else following.astype(np.int64),
        weight=weight,
        denominator=denominator,
        gain=gain,
        gain_denominator=gain_denominator,
    )
    if rising:
        vars(table)["rising"] = True  # SciPy made it so, and need not be asked again
    if reward.ndim == 2:
        table = by_outcome(table)
    return _assemble(state, action, table, size, discount, start, names)


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


def by_outcome(table: OutcomeTable) -> OutcomeTable:
    """Return a table whose rewards belong to outcomes beyond doubt.

    With one outcome for each pair, rewards of outcomes look like rewards of pairs. That is the same
    unless a float probability is only nearly 1; such outcomes are told as two exact halves.
    """
    exact_rows = table.weight.dtype != np.float64 or (table.weight == 1).all()
    if len(table.next) != table.pairs or exact_rows:
        return table
    return replace(
        table,
        offsets=2 * table.offsets,
        next=np.repeat(table.next, 2),
        weight=np.repeat(table.weight / 2, 2),
        gain=np.repeat(table.gain, 2),
    )


def _assemble(
    state: Integers,
    action: Integers,
    table: OutcomeTable,
    size: int,
    discount: object,
    start: object,
    names: dict[str, Any],
) -> MDP:
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
    space = names.pop("space", None) or StateSpace.plain(size, words)
    return MDP(
        table,
        state,
        action,
        space=space,
        actions=actions,
        discount_exact=as_discount(discount),
        start=as_start(start),
        **names,
    )


def _is_sparse_list(values: Any) -> bool:
    return isinstance(values, Sequence) and any(sp.issparse(matrix) for matrix in values)


def _stacked(P: Any) -> tuple[Any, int, int]:
    """Return P as (L, S) rows in pair order, with the numbers of actions and states."""
    if _is_sparse_list(P):
        if not all(sp.issparse(matrix) for matrix in P):
            raise ModelError("P mixes sparse and dense matrices", where="P", fix="use one kind")
        actions, shapes = len(P), {matrix.shape for matrix in P}
        states = P[0].shape[0]
        if shapes != {(states, states)}:
            raise ModelError(
                f"transition matrices have shapes {sorted(shapes)}",
                where="P",
                fix="give A square matrices of the same size",
            )
        rows = sp.vstack([sp.csr_array(matrix) for matrix in P], format="csr")
        order = np.arange(actions * states).reshape(actions, states).T.reshape(-1)
        return _sparse_or_array(rows[order]), actions, states
    array = _sparse_or_array(P)
    if array.ndim != 3 or array.shape[1] != array.shape[2] or not array.size:
        raise ModelError(
            f"transitions have shape {array.shape}",
            where="P",
            fix="give (A, S, S), or a list of A sparse (S, S) matrices",
        )
    actions, states = array.shape[:2]
    return array.transpose(1, 0, 2).reshape(actions * states, states), actions, states


def _sparse_or_array(values: object) -> Any:
    """Return a sparse matrix as a CSR array, anything else as floats, or as exact objects."""
    if isinstance(values, sp.sparray | sp.spmatrix):
        if values.dtype.kind not in "fiub":
            raise ModelError(f"a sparse matrix of type {values.dtype}", fix="give real numbers")
        return sp.csr_array(values)
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise ModelError("rows of different lengths", fix="make the array rectangular") from error
    if array.dtype.kind in "iub":
        return array.astype(object) if array.dtype == np.uint64 else array.astype(np.int64)
    if array.dtype.kind in "OUS":
        flat = np.empty(array.size, dtype=object)
        flat[:] = [_number(value) for value in array.flat]
        return flat.reshape(array.shape)
    if array.dtype.kind == "f":
        return float_array(array)
    raise ModelError(f"an array of type {array.dtype}", fix="give real numbers")


def _number(value: object) -> Fraction | float:
    """Return an exact number, or the float itself where a float was given."""
    if isinstance(value, np.floating):
        value = float(value)
    return value if isinstance(value, float) else exact(value)


def _indices(values: ArrayLike, what: str) -> Integers:
    array = np.asarray(values)
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise ModelError(
            f"{what} is not a list of whole numbers", where=what, fix="give integers of shape (L,)"
        )
    return array.astype(np.int64)


def _grouped(values: Any, offsets: Integers) -> tuple[Numbers, Numbers]:
    """Return numbers as an array with one denominator for each group of them."""
    array = np.asarray(values) if not isinstance(values, list) else None
    groups = len(offsets) - 1
    if array is not None and array.dtype != object:
        return np.ascontiguousarray(array), ones(groups)
    flat = list(values)
    if any(isinstance(value, float) for value in flat):
        return np.array([as_float(value) for value in flat], dtype=np.float64), ones(groups)
    tops: list[int] = []
    bottoms: list[int] = []
    for first, last in pairwise(offsets.tolist()):
        top, bottom = common([exact(value) for value in flat[first:last]])
        tops += top
        bottoms.append(bottom)
    return integers(tops), integers(bottoms)
