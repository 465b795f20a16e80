"""Exact optimal values, by backward induction and policy iteration in integers.

States are taken in the order in which they depend on each other (`solvers.proof.stages`): cycles
each as one, other states one by one, or by products of integer matrices where rows are long.

Values are integers over denominators that states share: of a stage, or of what a state builds on,
so that few fractions are ever reduced. A common denominator that would be far longer than those of
single states is not taken.

Two guesses are cheap to prove, since any solution of the equations is the one: that all states are
worth the same, the most that a pair makes of the chance to end,

    constant(l) ≤ V (scale(s) - Σ weight(i)),   i not terminal, with equality for a pair of each s

as a probability of 1 is; and that a cycle in which nothing is earned is worth, throughout, the
greatest value that it leads to.

The caller makes sure that the equations have one solution; `solvers.exact.certify` proves it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import gcd, lcm
from operator import mul
from typing import TYPE_CHECKING, Any, NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import BellmanRows, row_sums
from exact_mdp.mdp.table import COMPILED, Floats, Integers, magnitude, spans
from exact_mdp.solvers.proof.cycle import CHUNK, LARGEST, Cycle, Product, RightSides
from exact_mdp.solvers.proof.equations import judged
from exact_mdp.solvers.proof.margins import quotient
from exact_mdp.solvers.proof.stages import Kind, stages

if TYPE_CHECKING:
    from flint import fmpz

SHORT = 2**31  # numbers of which two products add up to a 64-bit integer
NONE = np.iinfo(np.int64).max
MANY = 32  # states with a choice from which on floats choose first


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


def solve_exactly(rows: BellmanRows) -> ExactValues:
    """Return the exact optimal values of Bellman equations of which every policy ends."""
    if (same := _same_everywhere(rows)) is not None:
        return same
    found = _solved(rows, guess=True) or _solved(rows, guess=False)
    assert found is not None
    return found


def _solved(rows: BellmanRows, *, guess: bool) -> ExactValues | None:
    """Return the values; None where pairs that floats were left to choose are not the best ones."""
    solver = _Solver(rows, guess=guess)
    for stage in stages(rows):
        if stage.kind is Kind.CYCLE:
            solver.cycle(stage.states)
        elif stage.kind is Kind.CHAIN:
            solver.chain(stage.states)
        else:
            solver.induction(stage.states)
    found = ExactValues(
        numerator=_emptied(solver.value),
        group=np.array(solver.group, dtype=np.int64),
        denominator=_emptied(solver.denominator),
        optimal=np.array(solver.optimal),
        gap=_emptied(solver.gap),
        gap_scale=_emptied(solver.gap_scale),
    )
    state = rows.pair_state
    for block in judged(rows, found, np.flatnonzero((solver.best >= 0)[state])):
        if block.negative.any():
            return None
        found.optimal[block.pairs] = block.nothing
        for own, (loss, over) in block.least.items():
            found.gap[own], found.gap_scale[own] = loss, over
    return found


def _same_everywhere(rows: BellmanRows) -> ExactValues | None:
    """Return the values where all states that are not terminal have the same one, in short numbers.

    None where they have not, or where numbers are long.
    """
    live, state = ~rows.terminal, rows.pair_state
    flow = row_sums(np.where(live[rows.next], rows.weight, 0), rows.offsets)
    if max(map(magnitude, (rows.scale, flow, rows.constant))) >= SHORT:
        return None
    leaving = np.asarray(rows.scale[state] - flow, dtype=np.int64)
    constant = np.asarray(rows.constant, dtype=np.int64)
    open_ = np.flatnonzero(live[state] & (leaving > 0))
    if not len(open_):
        return None
    best = open_[int((constant[open_] / leaving[open_]).argmax())]
    value = Fraction(int(constant[best]), int(leaving[best]))
    top, bottom = value.numerator, value.denominator
    loss = top * leaving - bottom * constant
    optimal = (loss == 0) | ~live[state]
    first = rows.pair_offsets[:-1]
    if (loss[live[state]] < 0).any() or not np.logical_or.reduceat(optimal, first).all():
        return None
    gap = np.minimum.reduceat(np.where(optimal, NONE, loss), first)
    return ExactValues(
        numerator=np.where(live, top, 0).tolist(),
        group=live.astype(np.int64),
        denominator=[1, bottom],
        optimal=optimal,
        gap=[None if least == NONE else least for least in gap.tolist()],
        gap_scale=rows.scale.tolist(),
    )


class _Choice(NamedTuple):
    """The best pair of a state: V(s) = worth / pivot, all over one denominator."""

    state: int
    pivots: list[int]
    rest: list[Any]
    best: int
    worth: Any
    pivot: int


class _Solver:
    """What is settled so far: values over the denominators of their groups."""

    def __init__(self, rows: BellmanRows, *, guess: bool) -> None:
        self.sides = RightSides(rows)
        self.best = np.full(len(rows.scale), -1)  # pairs that floats chose, to be judged at last
        live = ~rows.terminal[rows.pair_state]
        self._guessing = guess and bool((self.sides.pivots[live] > 0).all())
        self.pair_offsets: list[int] = rows.pair_offsets.tolist()
        self.value: list[Any] = [0] * len(rows.scale)
        self.group = [0] * len(rows.scale)
        self.denominator: list[Any] = [1]
        self._groups = {1: 0}  # by denominator
        self.optimal = [True] * len(rows.constant)
        self.gap: list[Any] = [None] * len(rows.scale)
        self.gap_scale: list[Any] = rows.scale.tolist()

    # ---- states one by one -------------------------------------------------------------------

    @cached_property
    def _listed(self) -> tuple[list[int], ...]:
        """Each pair's constant and offset, each transition's next state and weight."""
        rows = self.sides.rows
        listed = (rows.constant, rows.offsets, rows.next, rows.weight)
        return tuple(each.tolist() for each in listed)

    @cached_property
    def _follows(self) -> list[int]:
        """Each state's only successor where its value is that of this one, or -1."""
        rows = self.sides.rows
        first = rows.pair_offsets[:-1]
        found = np.full(len(first), -1)
        alone = (np.diff(rows.pair_offsets) == 1) & (np.diff(rows.offsets)[first] == 1)
        pairs = first[alone & self._idle[first]]
        found[rows.pair_state[pairs]] = rows.next[rows.offsets[pairs]]
        return found.tolist()

    def chain(self, states: Integers) -> None:
        """Settle states one after the other, each after those that it leads to."""
        constant, offsets, following, weight = self._listed
        value, group, denominator, first_pair = *self._settled, self.pair_offsets
        pivots, factors, follows = self.sides.pivot, self.sides.factor, self._follows
        best = self._chosen(states)
        for state in states.tolist():
            if (after := follows[state]) >= 0:
                value[state], group[state] = value[after], group[after]
                continue
            first, last = first_pair[state], first_pair[state + 1]
            if best is not None and last - first > 1:
                first = best[state]
                last = first + 1
            begin, end = offsets[first], offsets[last]
            met = {group[t] for t in following[begin:end] if value[t]} or {0}
            shared: int | None
            known: Any = value
            if len(met) == 1:
                (shared,) = met
                base: int = denominator[shared]
            else:
                shared, found = self._largest(met)
                base = int(found)
                known = self._scaled(following[begin:end], base)
            if last - first == 1:
                number = sum(
                    map(mul, weight[begin:end], map(known.__getitem__, following[begin:end])),
                    constant[first] * base,
                )
                factor, times = factors[first], pivots[first]
                if factor != 1:
                    number, times = number // factor, times // factor
                rest = [number]
            else:
                rest = []
                for pair in range(first, last):
                    part = slice(offsets[pair], offsets[pair + 1])
                    ahead = map(mul, weight[part], map(known.__getitem__, following[part]))
                    rest.append(sum(ahead, constant[pair] * base))
                choice = self._choice(state, rest)
                number, times = choice.worth, choice.pivot
            if times != 1:
                spare = gcd(number, times)
                number, times = number // spare, times // spare
            if len(rest) > 1:
                self._settle(state, number, *self._losses(choice, number, times))
            value[state] = number
            if times != 1 or shared is None:
                below = base * times
                # What has become twice as long is put in lowest terms, and common multiples.
                if shared is None or below.bit_length() >= 1 << base.bit_length().bit_length():
                    spare = gcd(number, below)
                    value[state], below = number // spare, below // spare
                    self.gap_scale[state] *= spare
                shared = self._groups.setdefault(below, len(denominator))
                if shared == len(denominator):
                    denominator.append(below)
            group[state] = shared

    @property
    def _settled(self) -> tuple[list[Any], list[int], list[Any]]:
        return self.value, self.group, self.denominator

    def _chosen(self, states: Integers) -> list[int] | None:
        """Return the pairs that floats choose, by state; None where few have a choice."""
        rows = self.sides.rows
        choosing = states[np.diff(rows.pair_offsets)[states] > 1]
        pays = len(choosing) >= MANY and len(rows.next) >= COMPILED
        if not (self._guessing and pays) or self._floats is None:
            return None
        about, (matrix, constant, pivot) = self._about, self._floats
        inside = np.zeros(len(about), dtype=bool)
        inside[states] = True
        begin, end = rows.pair_offsets[states], rows.pair_offsets[states + 1]
        ahead = rows.next[spans(rows.offsets[begin], rows.offsets[end])]
        for state in np.unique(ahead[np.isnan(about[ahead]) & ~inside[ahead]]).tolist():
            below = self.denominator[self.group[state]]
            about[state] = quotient(int(self.value[state]), int(below))
        best = np.empty(len(about), dtype=np.int64)
        from exact_mdp.solvers.kernels import bellman

        bellman.best_pairs(states, rows.pair_offsets, matrix, constant, pivot, about, best)
        self.best[choosing] = best[choosing]
        found: list[int] = best.tolist()
        return found

    @cached_property
    def _about(self) -> Floats:
        """(S,) values in floats, of the states that were needed."""
        return np.where(self.sides.rows.terminal, 0.0, np.nan)

    @cached_property
    def _floats(self) -> tuple[Any, Floats, Floats] | None:
        """Transitions, constants and pivots; None where an integer is beyond the floats."""
        rows = self.sides.rows
        try:
            weight, constant, pivot = (
                np.asarray(each).astype(np.float64)
                for each in (rows.weight, rows.constant, self.sides.pivots)
            )
        except OverflowError:
            return None
        from exact_mdp.solvers.kernels.linear import Rows

        return Rows(rows.offsets, rows.next, weight), constant, pivot

    def _losses(self, choice: _Choice, number: Any, times: int) -> tuple[list[Any], int]:
        """Return what each pair loses against V(s) = number / times, over a scale."""
        if self.sides.waits[choice.state]:
            pairs = zip(choice.pivots, choice.rest, strict=True)
            return [pivot * number - times * rest for pivot, rest in pairs], 1
        highest = choice.rest[choice.best]
        return [highest - rest for rest in choice.rest], times

    def _largest(self, groups: Collection[int]) -> tuple[int | None, Any]:
        """Return a common multiple of the groups' denominators, and the group that has it."""
        first = max(groups, key=self.denominator.__getitem__)
        owner: int | None = first
        found = self.denominator[first]
        for group in groups:
            if found % self.denominator[group]:
                owner, found = None, flint.fmpz(found).lcm(self.denominator[group])
        return owner, found

    # ---- states together, whose successors are all known -------------------------------------

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
            self._settle(choice.state, number, *self._losses(choice, number, times))
        self._close([choice.state for choice in chosen], base * times, lowest=lowest)

    def _by_groups(self, states: Integers) -> Iterator[Integers]:
        """Yield the states apart that build on different denominators."""
        alike: dict[frozenset[int], list[int]] = {}
        for state in states.tolist():
            (product,) = self.sides.products(np.array([state]))
            alike.setdefault(frozenset(self.group[t] for t in product.columns), []).append(state)
        yield from map(np.array, alike.values())

    # ---- states on a cycle -------------------------------------------------------------------

    def cycle(self, states: Integers) -> None:
        """Settle states that lead to each other and to settled ones."""
        if len(states) > LARGEST:
            raise ModelError(
                f"a cycle of {len(states)} states is too large to be solved exactly",
                fix="use certify(mdp, bounded=True), which proves bounds in floating point",
            )
        rows, inside = self.sides.rows, states.tolist()
        pairs = spans(rows.pair_offsets[states], rows.pair_offsets[states + 1])
        ahead = rows.next[spans(rows.offsets[pairs], rows.offsets[pairs + 1])]
        known = set(ahead.tolist()).difference(inside)
        if known and self._idle[pairs].all() and self._alike(states, known):
            return
        products = list(self.sides.products(states))
        base = self._common({self.group[state] for state in known})
        outer = self._scaled(known, base)
        nothing = dict.fromkeys(inside, base * 0)
        cycle = Cycle.of(self.sides, states, _sums(products, outer | nothing, base))
        policy = cycle.policy()
        numbers = np.arange(len(cycle.pivot))
        while True:
            value, below = cycle.values(policy)
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
        for state in inside:
            self.value[state] = int(self.value[state])
        self.denominator[-1] = int(self.denominator[-1])

    @cached_property
    def _idle(self) -> NDArray[np.bool_]:
        """(L,) True for pairs that earn nothing, and whose weights and pivot are in balance."""
        rows = self.sides.rows
        flow, pivot = row_sums(rows.weight, rows.offsets), np.array(self.sides.pivot)
        return np.asarray((flow == pivot) & (flow > 0) & (rows.constant == 0), dtype=bool)

    def _alike(self, states: Integers, ahead: Collection[int]) -> bool:
        """Settle states by the greatest value ahead, if all attain it; they earn nothing."""
        found = {(self.value[state], self.group[state]) for state in ahead}
        value, group = max(
            found, key=lambda each: Fraction(int(each[0]), int(self.denominator[each[1]]))
        )
        below, inside = self.denominator[group], states.tolist()
        for state in inside:
            self.value[state], self.group[state] = value, group
        for part in np.split(states, range(CHUNK, len(states), CHUNK)):
            self.chain(part)
            for state in part.tolist():
                if self.value[state] * below != value * self.denominator[self.group[state]]:
                    for other in inside:
                        self.gap_scale[other] = int(self.sides.rows.scale[other])
                    return False
        return True

    # ---- numbers -----------------------------------------------------------------------------

    def _common(self, groups: Collection[int]) -> fmpz:
        """Return a common multiple of the groups' denominators: the largest, as a rule."""
        found: fmpz = flint.fmpz(self._largest(groups or {0})[1])
        return found

    def _scaled(self, states: Collection[int], base: fmpz | int) -> dict[int, Any]:
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
    if {*map(type, numbers)} <= {int, type(None)}:
        return numbers
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
