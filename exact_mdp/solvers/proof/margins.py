"""Actions with the same outcomes, as those that stand for one mean action; and long quotients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers, Numbers, spans

LARGE, MIX = 2**61 - 1, np.uint64(0x9E3779B97F4A7C15)  # of a hash


def alike(mdp: MDP, pairs: Integers) -> Integers:
    """Return (K,) for each of these rising pairs the first with the same state and outcomes.

    Pairs of one hash are compared number by number.
    """
    table, found, state = mdp.table, pairs.copy(), mdp.pair_state[pairs]
    places = np.flatnonzero(np.bincount(state)[state] > 1)
    if not len(places):
        return found
    of_pair = len(table.gain) == table.pairs
    of_pairs = [table.denominator, table.gain_denominator, *([table.gain] if of_pair else [])]
    of_outcomes = [table.next, table.weight, *([] if of_pair else [table.gain])]
    chosen, state = pairs[places], state[places]
    begin, lengths = table.offsets[chosen], np.diff(table.offsets)[chosen]
    entries = spans(begin, begin + lengths)
    starts = np.cumsum(lengths) - lengths
    place = (np.arange(len(entries)) - np.repeat(starts, lengths)).astype(np.uint64)
    mixed = _mixed([part[entries] for part in of_outcomes]) * (2 * place + 1)
    code = np.add.reduceat(mixed, starts) + _mixed([part[chosen] for part in of_pairs])
    order = np.lexsort((chosen, lengths, code, state))
    fresh = np.ones(len(order), dtype=bool)
    for key in (state, code, lengths):
        fresh[1:] &= key[order][1:] == key[order][:-1]
    fresh[0] = False
    first = order[np.maximum.accumulate(np.where(fresh, 0, np.arange(len(order))))]
    copies = order[fresh]
    model = first[fresh]
    same = np.ones(len(copies), dtype=bool)
    for part in of_pairs:
        same &= _same(part[chosen[copies]], part[chosen[model]])
    inner = np.cumsum(lengths[copies]) - lengths[copies]
    left, right = (spans(begin[x], begin[x] + lengths[x]) for x in (copies, model))
    for part in of_outcomes:
        if len(copies):
            same &= np.logical_and.reduceat(_same(part[left], part[right]), inner)
    found[places[copies[same]]] = chosen[model[same]]
    return found


def _mixed(parts: Sequence[Numbers]) -> NDArray[np.uint64]:
    """Return a hash of numbers that stand side by side in some arrays."""
    found = np.zeros(len(parts[0]), dtype=np.uint64)
    for part in parts:
        plain = part % LARGE if part.dtype == object else part
        bits = plain.astype(np.int64) if plain.dtype.kind in "iuO" else plain
        found = (found ^ np.ascontiguousarray(bits).view(np.uint64)) * MIX
        found ^= found >> np.uint64(29)
    return found


def _same(left: Numbers, right: Numbers) -> NDArray[np.bool_]:
    return np.asarray(left == right, dtype=bool)


def quotient(top: int, bottom: int) -> float:
    """Return a float off by at most u (1 + 2⁻⁹⁰) times its size; not a number where there is none.

    Long numbers are divided by their leading digits.
    """
    spare = max(0, min(top.bit_length(), bottom.bit_length()) - 100)
    try:
        return (top >> spare) / (bottom >> spare)
    except (OverflowError, ZeroDivisionError):
        return np.nan
