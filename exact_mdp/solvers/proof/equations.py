"""What pairs lose against values V(s) = numerator[s] / denominator[group[s]], in integers.

Groups whose denominators have a short common multiple are judged together (`solvers.proof.losses`),
long numbers pair by pair.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import lcm
from operator import mul
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.mdp.table import Integers, spans
from exact_mdp.solvers.proof.losses import distinct, losses, short_rows

FEW = 64  # pairs that are not worth the arrays
SHORT = 768  # bits of a common denominator, for states to be judged together


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Judged:
    """What some pairs (K,) lose against the values of their states (N,).

    Attributes
    ----------
    states : (N,) int64
    pairs, first : (K,) and (N,) int64
        Pairs of states[n] begin at first[n] in `pairs`.
    nothing, negative : (K,) bool
        Where V(s) - Q(l) is 0, and below 0.
    least : {int: (int, int)}
        The least loss above 0 of a state, a / (b · denominator of the state), as (a, b).
    """

    states: Integers
    pairs: Integers
    first: Integers
    nothing: NDArray[np.bool_]
    negative: NDArray[np.bool_]
    least: dict[int, tuple[int, int]]


def judged(rows: BellmanRows, values: Values, pairs: Integers) -> Iterator[Judged]:
    """Yield what pairs (K,), rising numbers, lose against the values, some states at a time."""
    if not len(pairs):
        return
    state = rows.pair_state[pairs]
    short, listed, group = short_rows(rows), None, values.group.tolist()
    for places, unit, groups in _blocks(rows, values, pairs, state):
        chosen, own = pairs[places], state[places]
        first = np.flatnonzero(np.diff(own, prepend=-1))
        scaled = _Scaled(values, group, unit, groups)
        if short and len(chosen) >= FEW and unit.bit_length() <= SHORT:
            lost = losses(rows, chosen, scaled, unit)
            nothing, negative = lost.nothing, lost.negative
            worse = np.flatnonzero(~(nothing | negative))
            numbers = zip(own[worse].tolist(), lost.numbers(worse), strict=True)
        else:
            listed = listed or _Listed(rows)
            lost_by = listed.losses(chosen.tolist(), own.tolist(), scaled, unit)
            nothing = np.array([loss == 0 for loss in lost_by])
            negative = np.array([loss < 0 for loss in lost_by])
            numbers = zip(own.tolist(), lost_by, strict=True)
        least = dict[int, int]()
        for s, loss in numbers:
            if 0 < loss < least.get(s, loss + 1):
                least[s] = loss
        times = scaled.times
        yield Judged(
            states=own[first],
            pairs=chosen,
            first=first,
            nothing=nothing,
            negative=negative,
            least={s: (loss, times[group[s]] * int(rows.scale[s])) for s, loss in least.items()},
        )


def _blocks(
    rows: BellmanRows, values: Values, pairs: Integers, state: Integers
) -> Iterator[tuple[Integers, int, list[int]]]:
    """Yield places of pairs, a common multiple of denominators that they need, and these groups.

    Pairs of a state are in one block, those of a denominator too.
    """
    group, below = values.group, values.denominator
    begin, end = rows.offsets[pairs], rows.offsets[pairs + 1]
    own, count = group[state], len(below)
    met = np.repeat(own, end - begin) * count + group[rows.next[spans(begin, end)]]
    of, needed = np.divmod(distinct(np.concatenate([met, own * (count + 1)]), count**2), count)
    order = np.argsort(own, kind="stable")
    starts = np.flatnonzero(np.diff(of, prepend=-1))
    cuts = np.searchsorted(own[order], [*of[starts].tolist(), count]).tolist()
    listed, ends = needed.tolist(), [*starts.tolist(), len(of)]
    waiting: list[Integers] = []
    unit, members = 1, set[int]()
    for n, (low, high) in enumerate(pairwise(cuts)):
        groups = listed[ends[n] : ends[n + 1]]
        shared = lcm(*map(below.__getitem__, groups))
        if shared.bit_length() > SHORT:
            yield order[low:high], shared, groups
            continue
        both = lcm(unit, shared)
        if both.bit_length() > SHORT:
            yield np.concatenate(waiting), unit, list(members)
            waiting, both, members = [], shared, set()
        unit = both
        members.update(groups)
        waiting.append(order[low:high])
    if waiting:
        yield np.concatenate(waiting), unit, list(members)


class _Scaled:
    """Values times a unit."""

    def __init__(self, values: Values, group: list[int], unit: int, groups: list[int]) -> None:
        self.numerator, self.group = values.numerator, group
        self.times = {g: unit // values.denominator[g] for g in groups}

    def __call__(self, states: Iterable[int]) -> list[int]:
        numerator, group, times = self.numerator, self.group, self.times
        return [numerator[state] * times[group[state]] for state in states]


class _Listed:
    """Equations in Python's own integers."""

    def __init__(self, rows: BellmanRows) -> None:
        self.offsets, self.next, self.weight = (
            each.tolist() for each in (rows.offsets, rows.next, rows.weight)
        )
        self.constant, self.scale = rows.constant.tolist(), rows.scale.tolist()

    def losses(self, pairs: list[int], states: list[int], scaled: _Scaled, unit: int) -> list[int]:
        """Return V - Q of each pair, times the scale of its state and the unit."""
        offsets, following, weight = self.offsets, self.next, self.weight
        known = {t for l in pairs for t in following[offsets[l] : offsets[l + 1]]}
        known.update(states)
        value = dict(zip(known, scaled(known), strict=True))
        found, before, here = list[int](), -1, 0
        for l, s in zip(pairs, states, strict=True):
            if s != before:
                before, here = s, value[s] * self.scale[s]
            part = slice(offsets[l], offsets[l + 1])
            later = sum(map(mul, weight[part], map(value.__getitem__, following[part])))
            found.append(here - self.constant[l] * unit - later)
        return found
