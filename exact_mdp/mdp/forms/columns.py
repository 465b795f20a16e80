"""From columns to a table of outcomes: grouped by pair, sorted, merged and checked.

Every form of input is reduced to next state, probability and reward of each outcome, pair after
pair. Here rows of floats are replaced by the exact distributions that they stand for
(`mdp.forms.rows`); large tables of floats are copied, sorted and checked in one compiled pass.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from exact_mdp.mdp.forms.numbers import (
    group_numbers,
    has_floats,
    merge_entries,
    order_entries,
    rationalize_rows,
)
from exact_mdp.mdp.forms.rows import LONG, fine_unit, put_right
from exact_mdp.mdp.table import (
    COMPILED,
    Floats,
    Integers,
    Numbers,
    OutcomeTable,
    Rows,
    all_rows,
    find_distinct,
    find_nonzero,
    hold_same_numbers,
    normalize_rows,
)


def table_of(
    offsets: Integers,
    following: Numbers,
    chance: Any,
    gain: Any,
    size: int,
    names: dict[str, Any],
    amounts: dict[str, Any] | None = None,
    *,
    by_pair: bool,
    own: bool,
) -> OutcomeTable:
    """Return the table of outcomes (N,); the outcomes of pair l begin at offsets[l].

    Rewards are `by_pair` (L,) or by outcome. Next states and probabilities are copied unless they
    are `own`. Outcomes to the same next state are merged if their rewards and their `amounts`
    {component: (N,)} agree; `amounts` is changed to the outcomes of the table. `names` gets the
    entries `float_probabilities` and `float_rewards`.
    """
    parts = amounts
    if parts is None:
        parts = {}
    # Rows of floats go through one pass, if nothing is wrong with them.
    taken = None
    if by_pair:
        taken = _sort_and_normalize(offsets, following, chance, size, own=own)
    # All others: correct rounding errors, and drop outcomes of probability 0.
    if taken is not None:
        following, chance = taken
    else:
        chance = put_right(chance, offsets)
        positive = find_nonzero(chance)
        if not (own and positive.all()):
            following, chance = following[positive], chance[positive]
            if not by_pair:
                gain = gain[positive]
            parts |= {name: values[positive] for name, values in parts.items()}
            offsets = np.concatenate([[0], np.cumsum(positive)])[offsets]
    floats = has_floats(chance), has_floats(gain)
    for name, of_floats in zip(("float_probabilities", "float_rewards"), floats, strict=True):
        names[name] = names.get(name, False) or of_floats
    # Sort the outcomes of each pair by next state, and merge equal ones.
    rising = taken is not None or _is_sorted(offsets, following)
    if not rising:
        keys = None
        if not by_pair:
            keys = _rank_rows([gain, *parts.values()])
        offsets, following, chance, first = merge_entries(
            offsets, following, chance, keys, chances=True
        )
        if not by_pair:
            gain = gain[first]
        parts |= {name: values[first] for name, values in parts.items()}
    # Rewards that are equal in all outcomes of a pair are stored by pair.
    if not by_pair and len(gain) and np.diff(offsets).all():
        of_pair = gain[offsets[:-1]]
        if hold_same_numbers(gain, np.repeat(of_pair, np.diff(offsets))):
            gain, by_pair = of_pair, True
    # Bring rows and rewards into the form of a table.
    weight, below = rationalize_rows(chance, offsets)
    groups = offsets
    if by_pair:
        groups = np.arange(len(offsets))
    earned = group_numbers(np.array(gain), groups)
    if size >= 2**31:
        following = following.astype(np.int64)
    rows = Rows(
        offsets=offsets,
        next=following,
        weight=weight,
        denominator=below,
        sound=taken is not None,
    )
    if by_pair:
        vars(rows)["rising"] = True  # known now, and need not be computed again
    return OutcomeTable(rows=rows, gain=earned[0], gain_denominator=earned[1])


def _rank_rows(columns: list[Any]) -> Any:
    """Return numbers (N,) that order rows as the columns (N,) do; equal rows have equal numbers."""
    if len(columns) == 1:
        return columns[0]
    ranks = [_rank_values(np.asarray(column)) for column in columns]
    return np.unique(np.stack(ranks, axis=1), axis=0, return_inverse=True)[1].reshape(-1)


def _rank_values(column: Numbers) -> Integers:
    """Return (N,) ranks of values; fractions are told apart before they are sorted.

    Fractions made once are the same object wherever they occur, which is told without hashing.
    """
    if column.dtype != object:
        return np.unique(column, return_inverse=True)[1]
    objects, copies = find_distinct(column.tolist())
    rank = {value: number for number, value in enumerate(sorted({*objects}))}
    return np.array([rank[value] for value in objects], dtype=np.int64)[copies]


def _is_sorted(offsets: Integers, following: Numbers) -> bool:
    """Return whether the next states of every pair rise strictly."""
    ahead, begins = following[1:] > following[:-1], offsets[1:-1]
    ahead[begins[(begins > 0) & (begins < len(following))] - 1] = True
    return bool(ahead.all())


def _sort_and_normalize(
    offsets: Integers, following: Numbers, chance: Numbers, size: int, *, own: bool
) -> tuple[Numbers, Floats] | None:
    """Return sorted next states and normalized probabilities (N,), copied unless they are `own`.

    Return None if a row is not a distribution, or leads twice to a state.
    """
    if chance.dtype != np.float64 or size >= 2**31:
        return None
    # Rows that may be changed in place are sorted already.
    if own or len(chance) < COMPILED:
        if not own:
            order = order_entries(offsets, following)[2]
            following, chance = following[order], chance[order]
            if not _is_sorted(offsets, following):
                return None
        if normalize_rows(chance, offsets):
            return following, chance
        return None
    from exact_mdp.mdp.forms import loops

    columns, weights = np.empty_like(following), np.empty_like(chance)
    longest = int(np.diff(offsets).max(initial=0))
    if longest >= LONG:
        return None
    made = columns, weights, weights.view(np.int64), fine_unit(longest)
    if all_rows(loops.copy_block, offsets, size, following, chance, *made):
        return columns, weights
    return None
