"""Checks that claimed values solve the Bellman equations, in integers over common denominators.

Claims are those of an exact certificate: V(s) = numerator[s] / denominator[group[s]], which pairs
attain it, and by how much the next best pair is worse. Groups whose denominators have a short
common multiple are checked together (`solvers.proof.losses`), long numbers state by state.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import lcm
from operator import mul

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.mdp.table import Integers, spans
from exact_mdp.solvers.proof.losses import losses, short_rows
from exact_mdp.solvers.proof.margins import Claims

SHORT = 768  # bits of a common denominator, for states to be checked together


def equation_violations(rows: BellmanRows, found: Claims) -> list[str]:
    """Return which equations, optimal pairs (L,) and gaps are not as claimed, in words."""
    wrong = [
        f"the gap of state {state} is not that of the model"
        for state, below in enumerate(found.gap_scale)
        if below <= 0
    ]
    left = np.flatnonzero(~_repeated(rows, found))
    short, listed = short_rows(rows), None
    for states, unit, groups in _blocks(rows, found, left):
        if short and unit.bit_length() <= SHORT:
            wrong += _together(rows, found, states, unit, groups)
        else:
            listed = listed or _Listed(rows, found)
            wrong += _one_by_one(listed, found, states, unit, groups)
    return wrong


def _blocks(
    rows: BellmanRows, found: Claims, left: Integers
) -> Iterator[tuple[Integers, int, list[int]]]:
    """Yield states, a common multiple of the denominators that they need, and these groups."""
    group, below = found.group, found.denominator
    first, last = rows.pair_offsets[left], rows.pair_offsets[left + 1]
    begin, end = rows.offsets[first], rows.offsets[last]
    count = len(below)
    met = np.repeat(group[left], end - begin) * count + group[rows.next[spans(begin, end)]]
    own, after = np.divmod(np.unique(np.concatenate([met, group[left] * (count + 1)])), count)
    order = left[np.argsort(group[left], kind="stable")]
    starts = np.flatnonzero(np.diff(own, prepend=-1))
    cuts = np.searchsorted(group[order], [*own[starts].tolist(), count])
    waiting: list[Integers] = []
    unit, members = 1, set[int]()
    for (begun, ended), (low, high) in zip(
        pairwise([*starts.tolist(), len(own)]), pairwise(cuts.tolist()), strict=True
    ):
        needed = after[begun:ended].tolist()
        shared = lcm(*[below[g] for g in needed])
        both = lcm(unit, shared) if shared.bit_length() <= SHORT else shared
        if both.bit_length() > SHORT:
            if shared.bit_length() > SHORT:
                yield order[low:high], shared, needed
                continue
            yield np.concatenate(waiting), unit, list(members)
            waiting, both, members = [], shared, set()
        unit = both
        members.update(needed)
        waiting.append(order[low:high])
    if waiting:
        yield np.concatenate(waiting), unit, list(members)


def _repeated(rows: BellmanRows, found: Claims) -> NDArray[np.bool_]:
    """Return (S,) True for states whose one pair leads to one state for nothing, of equal value.

    Their equation is that of the two values; a claim of more than these is left to others.
    """
    first, optimal = rows.pair_offsets[:-1], found.optimal_pairs
    alone = (np.diff(rows.pair_offsets) == 1) & (np.diff(rows.offsets)[first] == 1)
    states = np.flatnonzero(alone & (rows.constant[first] == 0) & ~rows.terminal & optimal[first])
    entries = rows.offsets[first[states]]
    kept = (rows.weight[entries] == rows.scale[states]).astype(bool)
    states, after = states[kept], rows.next[entries][kept]
    kept = found.group[states] == found.group[after]
    states, after = states[kept], after[kept]
    numerator, gap, below = found.numerator, found.gap, found.gap_scale
    same = [
        numerator[s] == numerator[t] and gap[s] is None and below[s] > 0
        for s, t in zip(states.tolist(), after.tolist(), strict=True)
    ]
    repeated = np.zeros(len(first), dtype=bool)
    repeated[states[np.array(same, dtype=bool)]] = True
    return repeated


def _together(
    rows: BellmanRows, found: Claims, states: Integers, unit: int, groups: list[int]
) -> list[str]:
    """Check states by arrays; `groups` are those whose denominators divide the unit."""
    first, last = rows.pair_offsets[states], rows.pair_offsets[states + 1]
    pairs = spans(first, last)
    times = {g: unit // found.denominator[g] for g in groups}
    value = _Scaled(found, times)
    lost = losses(rows, pairs, value, unit)
    over = np.repeat(rows.terminal[states], last - first)
    begin = np.cumsum(last - first) - (last - first)
    nothing = lost.nothing | over
    solved = np.logical_or.reduceat(nothing, begin)
    solved &= ~np.logical_or.reduceat(lost.negative & ~over, begin)
    marked = np.logical_and.reduceat(nothing == found.optimal_pairs[pairs], begin)
    wrong = [
        f"the value of state {s} does not solve the Bellman equation"
        for s in states[~solved].tolist()
    ] + [
        f"the optimal actions of state {s} are not those of the model"
        for s in states[~marked].tolist()
    ]
    worse = np.flatnonzero(~nothing & ~lost.negative)
    least = dict[int, int]()
    owner = np.repeat(states, last - first)[worse].tolist()
    for state, loss in zip(owner, lost.numbers(worse), strict=True):
        if loss < least.get(state, loss + 1):
            least[state] = loss
    gap, below = found.gap, found.gap_scale
    claimed = {state for state in states.tolist() if gap[state] is not None}
    wrong_gaps = claimed ^ least.keys()
    for state in claimed & least.keys():
        here = times[int(found.group[state])] * int(rows.scale[state])
        if gap[state] * here != least[state] * below[state]:
            wrong_gaps.add(state)
    return wrong + [f"the gap of state {s} is not that of the model" for s in sorted(wrong_gaps)]


class _Scaled:
    """Claimed values times a unit, by state."""

    def __init__(self, found: Claims, times: dict[int, int]) -> None:
        self.numerator, self.group, self.times = found.numerator, found.group.tolist(), times

    def __getitem__(self, state: int) -> int:
        return self.numerator[state] * self.times[self.group[state]]


def _one_by_one(
    rows: _Listed, found: Claims, states: Integers, unit: int, groups: list[int]
) -> list[str]:
    """Check states pair by pair; `groups` are those whose denominators divide the unit."""
    wrong = list[str]()
    pairs, offsets, following, weight = rows.pairs, rows.offsets, rows.next, rows.weight
    times = {g: unit // found.denominator[g] for g in groups}
    inside = states.tolist()
    known = {t for s in inside for t in following[offsets[pairs[s]] : offsets[pairs[s + 1]]]}
    scaled = _Scaled(found, times)
    value = {t: scaled[t] for t in known}
    for s in inside:
        first, last = pairs[s], pairs[s + 1]
        more = times[scaled.group[s]]
        here = found.numerator[s] * more * rows.scale[s]
        losses = []  # V - Q of each pair, times scale and unit
        for l in range(first, last):
            part = slice(offsets[l], offsets[l + 1])
            later = sum(map(mul, weight[part], map(value.__getitem__, following[part])))
            losses.append(here - rows.constant[l] * unit - later)
        if rows.terminal[s]:
            losses = [0] * len(losses)
        if min(losses) != 0:
            wrong.append(f"the value of state {s} does not solve the Bellman equation")
        if [loss == 0 for loss in losses] != rows.optimal[first:last]:
            wrong.append(f"the optimal actions of state {s} are not those of the model")
        least, gap = min((loss for loss in losses if loss > 0), default=None), found.gap[s]
        claimed = None if gap is None else gap * more * rows.scale[s]
        if claimed != (None if least is None else least * found.gap_scale[s]):
            wrong.append(f"the gap of state {s} is not that of the model")
    return wrong


class _Listed:
    """Equations in Python's own integers, and which pairs are claimed to be optimal."""

    def __init__(self, rows: BellmanRows, found: Claims) -> None:
        self.pairs, self.offsets = rows.pair_offsets.tolist(), rows.offsets.tolist()
        self.next, self.weight = rows.next.tolist(), rows.weight.tolist()
        self.constant, self.scale = rows.constant.tolist(), rows.scale.tolist()
        self.terminal, self.optimal = rows.terminal.tolist(), found.optimal_pairs.tolist()
