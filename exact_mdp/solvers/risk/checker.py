"""Checks least shortages, and the mean of the worst episodes that follows from them.

Nothing here imports a solver. If G_s(w) = F_s(w) - λ M_s(w) is at most Σ p (G_s'(w - k) - λ k) for
every pair, and what the end asks for, then no policy has less at any w, whatever it remembers. The
distribution of the return under the claimed policy, carried forward from the start, has to have the
mean and the mean of its worst share that are claimed.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import lcm

import numpy as np

from exact_mdp.mdp.table import Integers, Numbers
from exact_mdp.solvers.risk.lattice import Lattice, tail_mean


@dataclass(frozen=True, kw_only=True, eq=False)
class Shortages:
    """Expected shortages and means for all that may be wanted, low(s) … high(s), in units.

    Attributes
    ----------
    lattice : Lattice
    trade : Fraction
        λ: what a unit of the mean is worth in units of shortage.
    lack, mean : list of (W,) integers, for each state
        Numerators.
    below : list of int
        Denominators.
    choice : list of (W,) int64
        The pair that is taken.
    """

    lattice: Lattice
    trade: Fraction
    lack: list[Numbers]
    mean: list[Numbers]
    below: list[int]
    choice: list[Integers]

    def pair(self, state: int, wanted: int) -> int:
        """Return what is taken where so much is wanted of the return from a state."""
        place = wanted - self.lattice.low[state]
        return int(self.choice[state][min(max(place, 0), len(self.choice[state]) - 1)])

    def at(self, state: int, wanted: int) -> tuple[Fraction, Fraction]:
        """Return shortage and mean."""
        lack, mean, below = self.lack[state], self.mean[state], self.below[state]
        place, last = wanted - self.lattice.low[state], len(lack) - 1
        within = min(max(place, 0), last)
        over = max(place - last, 0)
        return Fraction(lack[within], below) + over, Fraction(mean[within], below)

    @property
    def span(self) -> tuple[int, int]:
        """The least and the greatest return from the start."""
        begins = [state for state, weight in self.lattice.mdp.start if weight]
        low, high = self.lattice.low, self.lattice.high
        return min(low[state] for state in begins), max(high[state] for state in begins)

    def start(self, wanted: int) -> tuple[Fraction, Fraction]:
        """Return shortage and mean from the start."""
        found = [(weight, self.at(state, wanted)) for state, weight in self.lattice.mdp.start]
        lack = sum((weight * each[0] for weight, each in found), Fraction(0))
        return lack, sum((weight * each[1] for weight, each in found), Fraction(0))

    def met(self, threshold: Fraction) -> dict[int, dict[int, Fraction]]:
        """Return how likely each reward so far is in each state, of the policy for a threshold."""
        lattice, aim = self.lattice, int(threshold)
        ahead: defaultdict[int, defaultdict[int, Fraction]] = defaultdict(
            lambda: defaultdict(Fraction)
        )
        for state, weight in lattice.mdp.start:
            if weight:
                ahead[state][0] += weight
        for state in reversed(lattice.order):
            for so_far, mass in ahead.get(state, {}).items():
                weights, scale, ends = lattice.rows[self.pair(state, aim - so_far)]
                for part, (to, k) in zip(weights, ends, strict=True):
                    ahead[to][so_far + k] += mass * Fraction(part, scale)
        return {state: dict(sorted(masses.items())) for state, masses in sorted(ahead.items())}

    def returns(self, threshold: Fraction) -> dict[int, Fraction]:
        """Return the probability of every return, in units, of the policy for a threshold."""
        total: defaultdict[int, Fraction] = defaultdict(Fraction)
        for state, masses in self.met(threshold).items():
            if self.lattice.mdp.terminal[state]:
                for k, mass in masses.items():
                    total[k] += mass
        return dict(sorted(total.items()))


def tail_violations(
    found: Shortages,
    level: Fraction,
    weight: Fraction,
    value: Fraction,
    mean: Fraction,
    threshold: Fraction,
) -> list[str]:
    """Return what does not hold of a mean of the worst episodes, in units of the lattice."""
    wrong = [*_not_least(found)]
    if found.trade * (1 - weight) != level * weight:
        wrong.append("the shortages are those of another weight of the mean")
    low, high = found.span
    worth = {
        k: (1 - weight) * (k - lack / level) + weight * gain
        for k in range(low, high + 1)
        for lack, gain in [found.start(k)]
    }
    if threshold not in worth:
        return [*wrong, "the threshold is no possible return"]
    if not worth[int(threshold)] == (1 - weight) * value + weight * mean == max(worth.values()):
        wrong.append("another threshold gives more")
    returns = found.returns(threshold)
    if tail_mean([Fraction(k) for k in returns], [*returns.values()], level)[0] != value:
        wrong.append("the worst episodes of the policy have another mean")
    if sum(k * p for k, p in returns.items()) != mean:
        wrong.append("the policy has another mean")
    return wrong


def _not_least(found: Shortages) -> Iterator[str]:
    """Yield the states in which a pair leaves less than is claimed to be the least."""
    lattice, trade = found.lattice, found.trade
    for state, ends in enumerate(lattice.mdp.terminal.tolist()):
        if ends and (any(found.at(state, 0)) or lattice.low[state] or lattice.high[state]):
            yield f"more than nothing comes after the terminal state {state}"
    for state in lattice.order:
        claimed = range(lattice.low[state], lattice.high[state] + 1)
        if {len(found.lack[state]), len(found.mean[state])} != {len(claimed)}:
            yield f"a return from state {state} is missing"
            continue
        (least, most), (full, best) = found.at(state, claimed[0]), found.at(state, claimed[-1])
        if least != 0 or full != claimed[-1] - best or best != most:
            yield f"all or nothing is wanted of state {state}, and more or less is lacking"
        mine = _leaves(found, state, claimed.start, len(claimed))
        for pair in lattice.pairs[state]:
            weights, scale, outcomes = lattice.rows[pair]
            if any(
                lattice.low[state] > k + lattice.low[to]
                or lattice.high[state] < k + lattice.high[to]
                for to, k in outcomes
            ):
                yield f"a return from state {state} is missing"
                break
            if scale * best < sum(
                weight * (k + found.at(to, lattice.low[to])[1])
                for weight, (to, k) in zip(weights, outcomes, strict=True)
            ):
                yield f"a pair of state {state} has a greater mean"
            unit = lcm(*(found.below[to] for to, _ in outcomes))
            left: Numbers = np.zeros(len(claimed), dtype=object)
            for weight, (to, k) in zip(weights, outcomes, strict=True):
                after = _leaves(found, to, claimed.start - k, len(claimed))
                less = trade.numerator * k * found.below[to]
                left = left + weight * (unit // found.below[to]) * (after - less)
            if (mine * (unit * scale) > left * found.below[state]).any():
                yield f"a pair of state {state} leaves less"


def _leaves(found: Shortages, state: int, wanted: int, count: int) -> Numbers:
    """Return numerators of G_s(w) for `count` w from `wanted` on, over below(s) times that of λ."""
    lack, mean, trade = found.lack[state], found.mean[state], found.trade
    place = np.arange(count) + (wanted - found.lattice.low[state])
    last = len(lack) - 1
    inside, over = np.clip(place, 0, last), np.maximum(place - last, 0).astype(object)
    short = lack[inside] + over * found.below[state]
    return np.asarray(trade.denominator * short - trade.numerator * mean[inside])
