"""A front of two totals as a chain of policies, each one switch from the next, proven by signs.

For weights (t, 1 - t), 0 ≤ t ≤ 1, what a pair loses against a policy is linear in t. A policy is
optimal from the t at which one pair loses nothing to the t at which another does; there it switches
to that pair. Switching back from the new policy π', what is lost is

    loss' = -loss (1 + γ (P' - P) G' e) = -loss · det(I - γ P) / det(I - γ P'),   G' = (I - γ P')⁻¹,

of the opposite sign at every t, as both determinants are positive: where π ceases to be optimal, π'
begins to be so. So a chain of switches from t = 0 to t = 1 has the greatest weighted total for all
weights, and the t of an edge never needs to be known: a bracket, at whose ends all signs are proven
(`.fixed_point`), and the pair whose loss is 0 define it.

A switch in a state that is reached moves the totals: beyond its t the new policy is strictly
better. In a state that is not reached it leaves them; at discount 0 only the start is reached.
Where several pairs of the same moves switch at one t, which then is known exactly, the policies
between are on the edge.

Nothing here imports a solver.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.fixed_point import UNKNOWN, FixedPoint, bounds_errors

Bracket = tuple[Fraction, Fraction]
START, END = (Fraction(0), Fraction(0)), (Fraction(1), Fraction(1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """The policies that are optimal for some weights (t, 1 - t), from t = 0 to t = 1.

    Attributes
    ----------
    first : (S,) int64
        The pairs of the policy that is optimal at t = 0.
    switches : tuple of int
        The pairs that are taken one after the other.
    brackets : tuple of (Fraction, Fraction)
        Where t is at each switch; exactly there, if both are equal.
    totals : tuple of ((Fraction, Fraction), (Fraction, Fraction))
        Bounds on both totals of each policy, more of which is better.
    weight : tuple of int
        Bounds errors: see `fixed_point`.
    """

    first: Integers
    switches: tuple[int, ...]
    brackets: tuple[Bracket, ...]
    totals: tuple[tuple[Bracket, ...], ...]
    weight: tuple[int, ...]

    def policies(self, of: Objectives) -> Iterator[Integers]:
        """Give the pairs (S,) of each policy in turn."""
        pairs = self.first.copy()
        yield pairs.copy()
        for pair in self.switches:
            pairs[of.mdp.pair_state[pair]] = pair
            yield pairs.copy()


class Corner(NamedTuple):
    """A vertex: the number of its policy in the chain, and the switches that lead to it."""

    policy: int
    switches: tuple[int, ...]


def corners(of: Objectives, chain: Chain) -> list[Corner]:
    """Return the vertices of the front: policies optimal on a stretch, whose totals differ."""
    found, moved = list[Corner](), list[int]()
    ends = [START, *chain.brackets, END]
    before = chain.first
    for number, pairs in enumerate(chain.policies(of)):
        if number:
            state = of.mdp.pair_state[chain.switches[number - 1]]
            if of.reached(before)[state]:
                moved.append(number - 1)
        before = pairs
        if not _at_once(ends[number], ends[number + 1]) and (moved or not found):
            found.append(Corner(number, tuple(moved) if found else ()))
            moved = []
    return found


def _at_once(low: Bracket, high: Bracket) -> bool:
    return low == high and low[0] == low[1]


def chain_violations(of: Objectives, chain: Chain) -> list[str]:
    """Return what does not hold of a chain, in words: nothing where it is sound."""
    try:
        return _violations(of, chain)
    except (OverflowError, RuntimeError):  # beyond the floats, or singular in them
        return ["floats, which propose the totals of its policies, do not hold the model"]


def _violations(of: Objectives, chain: Chain) -> list[str]:
    mdp, count = of.mdp, len(chain.switches)
    weight = np.array(chain.weight, dtype=object)
    if not all(0 <= pair < mdp.n_pairs for pair in (*chain.first.tolist(), *chain.switches)):
        return ["a pair is none of the model"]
    if len(weight) != mdp.n_states or not bounds_errors(of, weight):
        return ["nothing proves that the equations of every policy have one solution"]
    if not np.array_equal(mdp.pair_state[chain.first], np.arange(mdp.n_states)):
        return ["the first policy does not take one pair of each state"]
    if (len(chain.brackets), len(chain.totals), len(of.amounts)) != (count, count + 1, 2):
        return ["switches, their weights and totals do not go together"]
    ends, wrong, left = [START, *chain.brackets, END], list[str](), None
    fixed = FixedPoint(of, weight, chain.first)
    for number, pair in enumerate([*chain.switches, None]):
        low, high = ends[number], ends[number + 1]
        if not optimal_between(fixed, low, high, left, pair):
            wrong.append(f"nothing proves policy {number} optimal between its switches")
        if not _within(fixed, chain.totals[number]):
            wrong.append(f"the totals of policy {number} are not within their bounds")
        if pair is not None:
            left = int(fixed.pairs[mdp.pair_state[pair]])
            if left == pair:
                return [*wrong, f"switch {number} is none"]
            fixed.switch(pair)
    return wrong


def optimal_between(
    fixed: FixedPoint, low: Bracket, high: Bracket, at_low: int | None, at_high: int | None
) -> bool:
    """Return whether a policy is proven optimal between the t at which two pairs lose nothing.

    The pairs do so within these brackets, and lose something between; at None the range ends.
    """
    ordered = 0 <= low[0] <= low[1] and high[0] <= high[1] <= 1
    if not ordered or not (low[1] <= high[0] or _at_once(low, high)):
        return False
    while (proven := _signs_tell(fixed, low, high, at_low, at_high)) is None:
        if not fixed.sharpen():
            return False
    return proven


def _signs_tell(
    fixed: FixedPoint, low: Bracket, high: Bracket, at_low: int | None, at_high: int | None
) -> bool | None:
    """Return what the signs known so far prove; None where more bits may tell."""
    signs = [
        np.delete(fixed.signs(shares(t)), [] if pair is None else pair)
        for t, pair in ((low[0], at_low), (high[1], at_high))
    ]
    for pair, (inner, outer) in ((at_low, low[::-1]), (at_high, high)):
        if pair is None:
            continue
        here = [int(fixed.signs(shares(t), [pair])[0]) for t in (inner, outer)]
        if inner == outer:
            first, second = (loss[0] for loss in fixed.losses([pair]))
            rises = first > second if pair == at_low else first < second
            good = bool(fixed.known[pair]) and here[0] == 0 and rises
        else:
            good = here == [1, -1]
        signs.append(np.array([1 if good else UNKNOWN if UNKNOWN in here else -1]))
    every = np.concatenate(signs)
    return False if (every == -1).any() else None if (every == UNKNOWN).any() else True


def shares(t: Fraction) -> tuple[int, int]:
    """Return whole numbers in the proportion of t to 1 - t."""
    return t.numerator, t.denominator - t.numerator


def _within(fixed: FixedPoint, bounds: Sequence[Bracket]) -> bool:
    """Return whether the totals are proven to lie within bounds."""
    while True:
        each = list(zip(fixed.totals(), bounds, strict=True))
        if all(b[0] <= own[0] and own[1] <= b[1] for own, b in each):
            return True
        if any(own[1] < b[0] or b[1] < own[0] for own, b in each) or not fixed.sharpen():
            return False
