"""The one way from columns to a table: outcomes grouped by pair, sorted, joined and checked.

However a model is given, it comes down to next state, probability and reward of each outcome, pair
after pair. What rows of floats mean is read here (`mdp.forms.rows`); large tables of floats are
copied, sorted and looked at in one compiled pass.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from exact_mdp.mdp.forms.numbers import group_numbers, has_floats, merge_entries, rationalize_rows
from exact_mdp.mdp.forms.rows import LONG, fine_unit, put_right
from exact_mdp.mdp.table import (
    COMPILED,
    Floats,
    Integers,
    Numbers,
    OutcomeTable,
    all_rows,
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
    """Return the table of outcomes (N,), those of pair l from offsets[l] on; note what was floats.

    Rewards may be those of pairs (L,). Next states and probabilities are copied unless they are
    `own`. Outcomes with other `amounts` of components (N,) are not joined; their arrays are
    replaced by those of the outcomes of the table.
    """
    parts = {} if amounts is None else amounts
    taken = _copy_sorted_rows(offsets, following, chance, size, own=own) if by_pair else None
    if taken is not None:
        following, chance = taken
    else:
        chance = put_right(chance, offsets)
        positive = np.asarray(chance != 0, dtype=bool)
        if not (own and positive.all()):
            following, chance = following[positive], chance[positive]
            gain = gain if by_pair else gain[positive]
            parts |= {name: values[positive] for name, values in parts.items()}
            offsets = np.concatenate([[0], np.cumsum(positive)])[offsets]
    floats = has_floats(chance), has_floats(gain)
    for name, of_floats in zip(("float_probabilities", "float_rewards"), floats, strict=True):
        names[name] = names.get(name, False) or of_floats
    rising = taken is not None or _is_sorted(offsets, following)
    if not rising:
        keys = None if by_pair else _rank_rows([gain, *parts.values()])
        offsets, following, chance, first = merge_entries(
            offsets, following, chance, keys, chances=True
        )
        gain = gain if by_pair else gain[first]
        parts |= {name: values[first] for name, values in parts.items()}
    if not by_pair and len(gain) and np.diff(offsets).all():
        of_pair = gain[offsets[:-1]]
        if np.asarray(gain == np.repeat(of_pair, np.diff(offsets)), dtype=bool).all():
            gain, by_pair = of_pair, True
    weight, below = rationalize_rows(chance, offsets)
    earned = group_numbers(np.array(gain), np.arange(len(offsets)) if by_pair else offsets)
    sound = taken is not None or (weight.dtype == np.float64 and normalize_rows(weight, offsets))
    table = OutcomeTable(
        offsets=offsets,
        next=following if size < 2**31 else following.astype(np.int64),
        weight=weight,
        denominator=below,
        gain=earned[0],
        gain_denominator=earned[1],
    )
    vars(table).update(is_settled=True, sound=sound)  # what was made so need not be asked again
    if by_pair:
        vars(table)["rising"] = True
    return table


def _rank_rows(columns: list[Any]) -> Any:
    """Return numbers (N,) that are equal where all columns (N,) are, and in their order."""
    if len(columns) == 1:
        return columns[0]
    ranks = [np.unique(np.asarray(column), return_inverse=True)[1] for column in columns]
    return np.unique(np.stack(ranks, axis=1), axis=0, return_inverse=True)[1].reshape(-1)


def _is_sorted(offsets: Integers, following: Numbers) -> bool:
    """Return whether the next states of every pair rise strictly."""
    ahead, begins = following[1:] > following[:-1], offsets[1:-1]
    ahead[begins[(begins > 0) & (begins < len(following))] - 1] = True
    return bool(ahead.all())


def _copy_sorted_rows(
    offsets: Integers, following: Numbers, chance: Numbers, size: int, *, own: bool
) -> tuple[Numbers, Floats] | None:
    """Return next states in rising order and settled probabilities (N,), copied in one pass.

    None where there are too few for compiled loops, and where rows are not sound as they are.
    """
    if len(chance) < COMPILED or chance.dtype != np.float64 or size >= 2**31:
        return None
    if own:
        return (following, chance) if normalize_rows(chance, offsets) else None
    from exact_mdp.mdp.forms import loops

    columns, weights = np.empty_like(following), np.empty_like(chance)
    longest = int(np.diff(offsets).max(initial=0))
    if longest >= LONG:
        return None
    made = columns, weights, weights.view(np.int64), fine_unit(longest)
    sound = all_rows(loops.copy_block, offsets, size, following, chance, *made)
    return (columns, weights) if sound else None
