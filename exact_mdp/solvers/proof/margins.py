"""What floats prove of exact claims, so that few pairs are left to exact arithmetic.

A pair l of state s loses V(s) - r(l) - γ P_l V. With V rounded to floats v, |V - v| ≤ u |v|, the
loss is known but for the rounding errors of its own sum and u (|v(s)| + γ P_l |v|) (Higham,
Accuracy and Stability of Numerical Algorithms, SIAM 2002, section 3.1). Where it is above a claimed
gap by more than that, the pair is neither optimal nor the best of the others, and need not be
looked at again. The same holds of w > γ P w. Numbers beyond the floats decide nothing. Actions with
the same outcomes, as those that stand for one mean action, are one pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from operator import truediv
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers, Numbers, spans

UNIT, TINY, SLACK = 2.0**-53, 2.0**-1000, 1 + 2.0**-20
CHUNK = 2**21
LARGE, MIX = 2**61 - 1, np.uint64(0x9E3779B97F4A7C15)  # of a hash
LONG = 1000  # bits from which on division needs the leading digits alone


class Values(Protocol):
    """Exact values V(s) = numerator[s] / denominator[group[s]]."""

    @property
    def numerator(self) -> Sequence[int]:
        """One for each state."""

    @property
    def group(self) -> Integers:
        """(S,) the place of each state's denominator."""

    @property
    def denominator(self) -> Sequence[int]:
        """Each positive."""


class Claims(Values, Protocol):
    """Exact values, what is optimal, and gaps."""

    @property
    def optimal_pairs(self) -> NDArray[np.bool_]:
        """(L,) the pairs that attain the maximum."""

    @property
    def gap(self) -> Sequence[int | None]:
        """The next best Q is gap[s] / (gap_scale[s] · denominator[group[s]]) below V(s)."""

    @property
    def gap_scale(self) -> Sequence[int]:
        """One for each state."""


def undecided(mdp: MDP, found: Claims) -> Integers:
    """Return (K,) the pairs, one of each state at least, that floats do not prove to lose enough.

    Enough is more than the claimed gap of their state.
    """
    if mdp.n_pairs == mdp.n_states:
        return np.arange(mdp.n_pairs)
    below = [found.denominator[group] for group in found.group.tolist()]
    value = np.array(_quotients(found.numerator, below))
    gap = np.full(mdp.n_states, np.inf)
    some = [state for state, number in enumerate(found.gap) if number is not None]
    tops = [number for number in found.gap if number is not None]
    gap[some] = _quotients(tops, [found.gap_scale[s] * below[s] for s in some])
    state = mdp.pair_state
    with np.errstate(all="ignore"):
        gain, error = _about(mdp, value, earning=True)
        least = gap[state] * (1 + 4 * UNIT) + TINY
        decided = ~found.optimal_pairs & ~mdp.terminal[state] & (-gain - error > least)
    return others(mdp, decided)


def others(mdp: MDP, decided: NDArray[np.bool_]) -> Integers:
    """Return (K,) the pairs that are not among the (L,) `decided`, one of each state at least."""
    first, kept = mdp.pair_offsets[:-1], ~decided
    kept[first] |= np.logical_and.reduceat(decided, first)
    return np.flatnonzero(kept)


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


def _quotients(tops: Sequence[int], bottoms: Sequence[int]) -> list[float]:
    """Return `quotient` of each two numbers."""
    if max(bottoms, default=0).bit_length() < LONG > max(tops, default=0).bit_length():
        with suppress(OverflowError, ZeroDivisionError):
            return list(map(truediv, tops, bottoms))
    return list(map(quotient, tops, bottoms))


def quotient(top: int, bottom: int) -> float:
    """Return a float off by at most u (1 + 2⁻⁹⁰) times its size; not a number where there is none.

    Long numbers are divided by their leading digits.
    """
    spare = max(0, min(top.bit_length(), bottom.bit_length()) - 100)
    try:
        return (top >> spare) / (bottom >> spare)
    except (OverflowError, ZeroDivisionError):
        return np.nan


def _about(mdp: MDP, value: Floats, *, earning: bool) -> tuple[Floats, Floats]:
    """Return `gains` of numbers that were rounded to `value`, with a bound on all errors."""
    gain, error = gains(mdp, value, earning=earning)
    size = np.abs(value)
    spread = size[mdp.pair_state] + mdp.discount * (mdp.transition @ size)
    return gain, (error + 2 * UNIT * spread) * SLACK + 4 * TINY


def gains(mdp: MDP, value: Floats, *, earning: bool = True) -> tuple[Floats, Floats]:
    """Return r + γ P V - V(s) for each pair (L,) with a bound (L,) on its rounding error."""
    table, matrix, rate = mdp.table, mdp.transition, mdp.discount
    terms = np.diff(table.offsets) * 1.0
    steps, flow = np.empty(mdp.n_pairs), np.empty(mdp.n_pairs)
    cuts = np.unique([*np.searchsorted(matrix.indptr, range(0, matrix.nnz, CHUNK)), mdp.n_pairs])
    with np.errstate(all="ignore"):
        for first, last in pairwise(cuts.tolist()):
            begin, end = matrix.indptr[first], matrix.indptr[last]
            own = np.repeat(
                value[mdp.pair_state[first:last]], np.diff(matrix.indptr[first : last + 1])
            )
            share, begins = matrix.data[begin:end], matrix.indptr[first:last] - begin
            term = share * (value[matrix.indices[begin:end]] - own)
            steps[first:last] = np.add.reduceat(term, begins)
            flow[first:last] = np.add.reduceat(np.abs(term), begins)
        own = value[mdp.pair_state]
        leak = float(1 - mdp.discount_exact)
        reward, reward_error = mdp.reward * earning, UNIT * np.abs(mdp.reward) * earning
        floats = np.float64 in (table.weight.dtype, table.gain.dtype)
        if earning and floats and table.joint:
            size = np.add.reduceat(
                table.probabilities() * np.abs(table.gains()), table.offsets[:-1]
            )
            reward_error = (terms + 4) * UNIT * size
        error = (2 * terms + 8) * UNIT * rate * flow + reward_error
        error += 4 * UNIT * (np.abs(reward) + np.abs(leak * own))
        error = error * SLACK + TINY * (terms + 1) * (1 + np.abs(value).max())
        return np.asarray(reward + rate * steps - leak * own), np.asarray(error)
