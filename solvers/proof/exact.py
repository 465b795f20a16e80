"""Exact optimal values, by backward induction and policy iteration in integers.

States are taken in the order in which they depend on each other, one stage after the other. Those
that depend on each other are the strongly connected components of the graph, waiting in place
aside; a component's level is the greatest number of steps to one without successors. All single
states of a level make one stage, every larger component, a cycle, makes one of its own. Where all
transitions lead to higher numbers, runs of consecutive states that do not lead to each other are
found faster than levels, and do as well. The values of a stage are integers over one denominator,
a multiple of the denominators that it builds on, so that no fraction is ever reduced; backward
induction is then one product of integer matrices for each stage. Where common denominators would be
far larger than those of single states, a stage is split.

The caller makes sure that the equations have one solution; `solvers.proof.certify` proves it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from math import lcm
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.table import Integers, Numbers, spans
from exact_mdp.solvers.bounds.layers import layers
from exact_mdp.solvers.proof.cycle import LARGEST, Cycle, Product, RightSides, endless

if TYPE_CHECKING:
    from flint import fmpz

flint = later("flint")


RUN = 4  # states in a run, on average, for runs to be used


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage:
    """States (K,) that are settled together; `cyclic` where they depend on each other."""

    states: Integers
    cyclic: bool


def stages(rows: BellmanRows) -> Iterator[Stage]:
    """Return the stages of a model in the order of solution, terminal states left out."""
    states = len(rows.scale)
    source = np.repeat(np.arange(states), np.diff(rows.offsets[rows.pair_offsets]))
    moving = rows.next != source
    if (rows.next[moving] > source[moving]).all():
        runs = _runs(states, source[moving], rows.next[moving])
        if RUN * len(runs) < states:
            for first, last in runs:
                run = np.arange(first, last)[~rows.terminal[first:last]]
                if len(run):
                    yield Stage(states=run, cyclic=False)
            return
    level, label = layers(source, rows.next, states)
    cyclic = np.bincount(label)[label] > 1
    group = np.where(cyclic, label + 1, 0)
    order = np.lexsort((group, level))
    order = order[~rows.terminal[order]]
    if not len(order):
        return
    fresh = (np.diff(level[order]) != 0) | (np.diff(group[order]) != 0)
    for part in np.split(order, np.flatnonzero(fresh) + 1):
        yield Stage(states=part, cyclic=bool(cyclic[part[0]]))


def _runs(states: int, source: Numbers, target: Numbers) -> list[tuple[int, int]]:
    """Return runs of states, last ones first, that lead out of their run, to higher numbers."""
    least = np.full(states, states)
    first = np.flatnonzero(np.diff(source, prepend=-1))
    if len(first):
        least[source[first]] = np.minimum.reduceat(target, first)
    runs, end = [], states
    for state, lowest in zip(range(states - 1, -1, -1), reversed(least.tolist()), strict=True):
        if lowest < end:
            runs.append((state + 1, end))
            end = state + 1
    return [*runs, (0, end)]


@dataclass(frozen=True, kw_only=True, eq=False)
class ExactValues:
    """Optimal values V(s) = numerator[s] / denominator[group[s]] and what attains them.

    V(s) less the next best Q is gap[s] / (gap_scale[s] · denominator[group[s]]); None in `gap`
    where every pair is optimal.
    """

    numerator: list[int]  # of length S
    group: Integers  # (S,)
    denominator: list[int]  # each positive
    optimal: NDArray[np.bool_]  # (L,) the pairs that attain the maximum
    gap: list[int | None]  # of length S
    gap_scale: list[int]  # of length S


def solve_exactly(rows: BellmanRows, *, positive: bool = False) -> ExactValues:
    """Return the exact optimal values of the Bellman equations `rows`.

    `positive` raises an error where a policy has a value that is not positive. With positive
    constants this shows that it does not end, which need not be known before.
    """
    solver = _Solver(rows)
    if positive:
        solver.require_leaving()
    for stage in stages(rows):
        if stage.cyclic:
            solver.cycle(stage.states, positive)
        else:
            solver.induction(stage.states)
    return ExactValues(
        numerator=_emptied(solver.value),
        group=np.array(solver.group, dtype=np.int64),
        denominator=_emptied(solver.denominator),
        optimal=np.array(solver.optimal),
        gap=_emptied(solver.gap),
        gap_scale=_emptied(solver.gap_scale),
    )


class _Choice(NamedTuple):
    """The best pair of a state: V(s) = worth / pivot, all over one denominator."""

    state: int
    pivots: list[int]
    rest: list[fmpz]
    best: int
    worth: fmpz
    pivot: int


class _Solver:
    """What is settled so far: values over the denominators of their groups."""

    def __init__(self, rows: BellmanRows) -> None:
        self.sides = RightSides(rows)
        self.pair_offsets: list[int] = rows.pair_offsets.tolist()
        self.value = [flint.fmpz(0)] * len(rows.scale)
        self.group = [0] * len(rows.scale)
        self.denominator = [flint.fmpz(1)]
        self.optimal = [True] * len(rows.constant)
        self.gap: list[fmpz | None] = [None] * len(rows.scale)
        self.gap_scale: list[Any] = rows.scale.tolist()

    def require_leaving(self) -> None:
        """Raise an error where a pair stays in its state with probability 1 or more, discounted."""
        pivot, live = np.array(self.sides.pivot, dtype=object), ~self.sides.rows.terminal
        state = self.sides.rows.pair_state
        stuck = np.flatnonzero(np.asarray(pivot <= 0, dtype=bool) & live[state])
        if len(stuck):
            raise endless(f"state {int(state[stuck[0]])}, which an action does not leave")

    # ---- states whose successors are all known -----------------------------------------------

    def induction(self, states: Integers, *, split: bool = True) -> None:
        """Settle states that lead to settled ones only."""
        products = list(self.sides.products(states))
        known = {state for product in products for state in product.columns}
        groups = {self.group[state] for state in known}
        base = self._common(groups)
        if split and _explodes(base, [self.denominator[group] for group in groups]):
            for alike in self._by_groups(states):
                self.induction(alike, split=False)
            return
        rest = _sums(products, self._scaled(known, base), base)
        chosen, first = [], 0
        for state in states.tolist():
            count = self.pair_offsets[state + 1] - self.pair_offsets[state]
            chosen.append(self._choice(state, rest[first : first + count]))
            first += count
        pivots = [choice.pivot for choice in chosen]
        apart = _explodes(lcm(*set(pivots)), pivots)
        for part in [[choice] for choice in chosen] if apart else [chosen]:
            self._settle_over(base, part, lowest=apart or not split)

    def _choice(self, state: int, rest: list[fmpz]) -> _Choice:
        """Return the first best pair of a state, from the right sides of its equations."""
        first, sides = self.pair_offsets[state], self.sides
        own, worth = sides.pivot[first : first + len(rest)], rest
        if sides.waits[state]:
            shared = lcm(*own)
            worth = [value * (shared // pivot) for value, pivot in zip(rest, own, strict=True)]
        best = worth.index(max(worth))
        factor = sides.factor[first + best]
        return _Choice(state, own, rest, best, rest[best] // factor, own[best] // factor)

    def _settle_over(self, base: fmpz, chosen: list[_Choice], *, lowest: bool) -> None:
        """Settle states by their best pairs, over `base` and what they add to it together."""
        times = lcm(*{choice.pivot for choice in chosen})
        values = [choice.worth * (times // choice.pivot) for choice in chosen]
        spare = times
        for value in values:
            if spare == 1:
                break
            spare = int(value.gcd(spare))
        times //= spare
        for choice, value in zip(chosen, values, strict=True):
            number = value if spare == 1 else value // spare
            if self.sides.waits[choice.state]:
                pairs = zip(choice.pivots, choice.rest, strict=True)
                losses, scale = [pivot * number - times * rest for pivot, rest in pairs], 1
            else:
                highest = choice.rest[choice.best]
                losses, scale = [highest - rest for rest in choice.rest], times
            self._settle(choice.state, number, losses, scale)
        self._close([choice.state for choice in chosen], base * times, lowest=lowest)

    def _by_groups(self, states: Integers) -> Iterator[Integers]:
        """Yield the states apart that build on different denominators."""
        alike: dict[frozenset[int], list[int]] = {}
        for state in states.tolist():
            (product,) = self.sides.products(np.array([state]))
            alike.setdefault(frozenset(self.group[t] for t in product.columns), []).append(state)
        yield from map(np.array, alike.values())

    # ---- states on a cycle -------------------------------------------------------------------

    def cycle(self, states: Integers, positive: bool) -> None:
        """Settle states that lead to each other and to settled ones."""
        if len(states) > LARGEST:
            raise ModelError(
                f"a cycle of {len(states)} states is too large to be solved exactly",
                fix="use certify(mdp, bounded=True), which proves bounds in floating point",
            )
        products = list(self.sides.products(states))
        inside = states.tolist()
        known = {state for product in products for state in product.columns} - set(inside)
        base = self._common({self.group[state] for state in known})
        outer = self._scaled(known, base)
        nothing = dict.fromkeys(inside, base * 0)
        cycle = Cycle.of(self.sides, states, _sums(products, outer | nothing, base))
        policy = cycle.policy()
        rows, numbers = self.sides.rows, np.arange(len(cycle.pivot))
        pairs = spans(rows.pair_offsets[states], rows.pair_offsets[states + 1])
        while True:
            value, below = cycle.values(policy)
            if positive and min(value) <= 0:
                raise endless()
            scaled = {state: own * below for state, own in outer.items()}
            scaled |= zip(inside, value, strict=True)
            others = np.setdiff1d(numbers, policy)
            products = list(self.sides.products_of(pairs[others]))
            sums = _sums(products, scaled, base * below)
            losses = cycle.losses(value, dict(zip(others.tolist(), sums, strict=True)))
            least = [min(of_state) for of_state in losses]
            if min(least) >= 0:
                break
            for i, loss in enumerate(least):
                if loss < 0:
                    policy[i] = cycle.offsets[i] + losses[i].index(loss)
        for state, own, of_state in zip(inside, value, losses, strict=True):
            self._settle(state, own, of_state)
        self._close(inside, base * below, lowest=True)

    # ---- numbers -----------------------------------------------------------------------------

    def _common(self, groups: Collection[int]) -> fmpz:
        """Return a common multiple of the groups' denominators: the largest, as a rule."""
        found: fmpz = max((self.denominator[g] for g in groups), default=self.denominator[0])
        for group in groups:
            if found % self.denominator[group]:
                found = found.lcm(self.denominator[group])
        return found

    def _scaled(self, states: Collection[int], base: fmpz) -> dict[int, fmpz]:
        """Return values of settled states, times `base`."""
        times = {
            group: base // self.denominator[group] for group in {self.group[s] for s in states}
        }
        return {
            state: self.value[state]
            if times[self.group[state]] == 1
            else self.value[state] * times[self.group[state]]
            for state in states
        }

    def _settle(self, state: int, value: fmpz, losses: list[fmpz], times: int = 1) -> None:
        """Keep a value and what each pair loses, over the denominator that is closed next."""
        self.value[state] = value
        first = self.pair_offsets[state]
        self.optimal[first : first + len(losses)] = [not loss for loss in losses]
        lost = [loss for loss in losses if loss]
        self.gap[state] = min(lost) * times if lost else None

    def _close(self, states: Collection[int], denominator: fmpz, *, lowest: bool) -> None:
        """Give states their denominator; in lowest terms where that saves time."""
        spare = denominator if lowest else self.denominator[0]
        for state in states:
            self.group[state] = len(self.denominator)
            spare = spare if spare == 1 else spare.gcd(self.value[state])
        if spare != 1:
            for state in states:
                self.value[state] //= spare
                self.gap_scale[state] *= spare
        self.denominator.append(denominator // spare)


def _emptied(numbers: list[Any]) -> list[Any]:
    """Return integers as Python's own, each replaced in place so that memory holds them once."""
    for i, number in enumerate(numbers):
        if number is not None:
            numbers[i] = int(number)
    return numbers


def _sums(products: list[Product], value: dict[int, fmpz], unit: fmpz) -> list[fmpz]:
    return [number for product in products for number in product(value, unit)]


def _explodes(common: fmpz | int, parts: list[fmpz] | list[int]) -> bool:
    """Return whether a common multiple is far longer than the numbers that it is one of."""
    longest = max((part.bit_length() for part in parts), default=0)
    return bool(common.bit_length() > 2 * longest + 128)
