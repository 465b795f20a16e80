"""Checks fronts, optima under limits, and weights of a reward against a model, in integers.

With the amounts c that pairs earn, weights w, and values V,

    V ≥ w c + γ P V   for every pair, and V ≥ 0 where all has ended,

bounds the weighted total of every policy at the start by μ V, because the equations of every policy
have one solution: below discount 1, or where a rank that each pair may lower shows that runs end.
V = w c + γ P V for the pairs of a policy is its total. Visits x of pairs that balance in each state
are those of a policy, which earns x c. More is better in all amounts.

Like `checker`, on which this builds, it needs Python's standard library alone, and looks at every
pair. What it is given are records with the fields that their files have.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from itertools import pairwise
from math import inf, lcm
from typing import Any

from exact_mdp.solvers.exact.checker import Level, Model, ensure

Point = Sequence[Fraction]


def _read_level(given: Any, count: int) -> Level:
    """Return numbers of states, or of pairs; raises Unreadable where they are none."""
    parts = {"top": given.top, "below": given.below, "group": [*map(int, given.group)]}
    return Level(parts, "values", count)


class Totals:
    """Objectives of a model: a name for each, and the amounts of its pairs (L,); more is better."""

    def __init__(self, model: Model, names: Sequence[str], amounts: Sequence[Point]) -> None:
        self.model, self.names, self.amounts = model, [*names], amounts
        # A state ends runs if its pairs lead back to it alone, and no amount is earned there.
        self.ends = {*range(model.states)}
        for state, after in zip(model.state, model.next, strict=True):
            if after != [state]:
                self.ends.discard(state)
        for own in amounts:
            for state, amount in zip(model.state, own, strict=True):
                if amount:
                    self.ends.discard(state)

    def find_faults(self, rank: Any) -> Iterator[str]:
        """Yield a fault where the equations of a policy may have several solutions."""
        model = self.model
        if model.discount == 1:
            fits = rank is not None and len(rank) == model.states and min(rank) >= 0
            ensure(fits, "the rank is missing, or negative")
            for state, after in zip(model.state, model.next, strict=True):
                if state not in self.ends and min(rank[t] for t in after) >= rank[state]:
                    yield "the rank does not show that every policy ends"
                    break
        if model.goal is not None:
            onward: list[set[int]] = [set() for _ in range(model.states)]
            for state, following in zip(model.state, model.next, strict=True):
                onward[state].update(following)
            met = {*(waiting := [*model.odds[1]])}
            for state in waiting:
                waiting += (fresh := onward[state] - met)
                met |= fresh
            if met & self.ends - model.goal:
                yield "a run may end outside the goal, and its totals are not finite"

    def compute_advantage_sign(self, weights: Point, value: Level, pair: int) -> int:
        """Return the sign of w c + γ P V - V; at an end, of -V."""
        if (state := self.model.state[pair]) in self.ends:
            return int(-value.top[state])
        each = zip(weights, self.amounts, strict=True)
        earned = sum((w * own[pair] for w, own in each), Fraction())
        ratio = earned.as_integer_ratio()
        return self.model.gain(self.model.discount, pair, value, ratio)

    def is_upper_bound(self, weights: Point, given: Any, most: Fraction) -> bool:
        """Return whether values prove that no policy has a weighted total above `most`."""
        value = _read_level(given, self.model.states)
        at_start = Fraction(*value.weigh(*self.model.odds))
        pairs = range(len(self.model.state))
        return at_start <= most and all(
            self.compute_advantage_sign(weights, value, pair) <= 0 for pair in pairs
        )

    def is_attained(self, pairs: Any, values: Any, total: Point) -> bool:
        """Return whether a policy has these values, and these totals at the start."""
        model = self.model
        each = [_read_level(value, model.states) for value in values]
        ensure(len(each) == len(total) == len(self.names), "not one total for each objective")
        listed = [*map(int, pairs)]
        ensure({*listed} <= {*range(len(model.state))}, "a pair is none of the model")
        if [model.state[pair] for pair in listed] != [*range(model.states)]:
            return False
        for k, (value, claimed) in enumerate(zip(each, total, strict=True)):
            unit = [Fraction(k == i) for i in range(len(each))]
            if any(self.compute_advantage_sign(unit, value, pair) for pair in listed):
                return False
            if Fraction(*value.weigh(*model.odds)) != claimed:
                return False
        return True

    def compute_earnings(self, flow: Any) -> list[Fraction]:
        """Return the totals of visits; raises Unreadable unless they are the visits of a policy."""
        model, pairs = self.model, [*map(int, flow.pairs)]
        visits = _read_level(flow.visits, len(pairs))
        ensure({*pairs} <= {*range(len(model.state))}, "a pair is none of the model")
        ensure(len({*pairs}) == len(pairs) and min(visits.top, default=1) > 0, "visits are not > 0")
        unit = lcm(*visits.below)
        top = []
        for n, k in zip(visits.top, visits.group, strict=True):
            top.append(n * (unit // visits.below[k]))
        left = [Counter[int]() for _ in range(model.states)]  # by denominator
        for state, share in model.start:
            left[state][share.denominator] += share.numerator * unit
        for pair, number in zip(pairs, top, strict=True):
            left[model.state[pair]][1] -= number
            below = model.discount.denominator * model.under[pair]
            for state, weight in zip(model.next[pair], model.weight[pair], strict=True):
                left[state][below] += model.discount.numerator * weight * number
        for state, parts in enumerate(left):
            rest = sum(Fraction(number, below) for below, number in parts.items())
            ensure(state in self.ends or not rest, "visits are not those of a policy")
        ensure(self.ends.isdisjoint(model.state[pair] for pair in pairs), "visits of an end")
        earned = []
        for own in self.amounts:
            parts = Counter[int]()
            for pair, number in zip(pairs, top, strict=True):
                parts[own[pair].denominator] += own[pair].numerator * number
            total = sum((Fraction(n, below) for below, n in parts.items()), Fraction())
            earned.append(total / unit)
        return earned


def check_front(totals: Totals, proof: Any) -> Iterator[str]:
    """Yield what does not hold of an exact front of two or three objectives.

    The greatest weighted total H(w) is convex in the weights, that of the vertices h(w) too. Where
    both agree at points whose hulls, taken over the points of each vertex, fill all weights that
    sum to 1, h is linear between such points, H ≤ h, and no policy is beyond the vertices. Cells of
    two vertices share no area, so that areas add up: a vertex that is written twice is refused.
    """
    size, vertices = len(totals.names), proof.attained
    ensure(size in (2, 3), "a front is of two or three objectives")
    for number, vertex in enumerate(vertices):
        if not totals.is_attained(vertex.pairs, vertex.values, vertex.total):
            yield f"vertex {number} has other totals"
    if len({tuple(vertex.total) for vertex in vertices}) < len(vertices):
        yield "a vertex is written twice"
    cells: list[list[Point]] = [[] for _ in vertices]
    for corner in proof.corners:
        ensure(len(corner.weights) == size, "not one weight for each objective")
        totals_of = [weigh_values(corner.weights, vertex.total) for vertex in vertices]
        most = max(totals_of, default=Fraction())
        tight = [number for number, own in enumerate(totals_of) if own == most]
        for number in tight:
            cells[number].append(corner.weights)
        fits = sum(corner.weights) == 1 and min(corner.weights) >= 0 and [*corner.best] == tight
        if not fits or not totals.is_upper_bound(corner.weights, corner.dual, most):
            yield f"the bound for weights ({', '.join(map(str, corner.weights))}) does not hold"
    if len({tuple(corner.weights) for corner in proof.corners}) < len(proof.corners):
        yield "weights are written twice"
    if sum(map(_measure_hull, cells)) != 1:
        yield "the bounds do not cover all weights"
    if not all(map(_measure_hull, cells)):
        yield "a vertex is not one: others are as good for all weights"


def weigh_values(weights: Sequence[Any], values: Point) -> Fraction:
    """Return the weighted sum of some values."""
    return sum((w * v for w, v in zip(weights, values, strict=True)), Fraction())


def _measure_hull(points: Sequence[Point]) -> Fraction:
    """Return the length, or the area, of the hull of some weights, where all weights make 1."""
    flat = sorted({(*point[:2],) for point in points})
    if not points or len(points[0]) == 2:
        return flat[-1][0] - flat[0][0] if flat else Fraction()
    return sum((_twice_below(part) for part in (flat, flat[::-1])), Fraction())


def _twice_below(points: Sequence[Point]) -> Fraction:
    """Return twice the area that one chain of a convex hull contributes (Andrew, 1979)."""
    chain: list[Point] = []
    for c in points:
        while len(chain) > 1:
            a, b = chain[-2:]
            if (b[0] - a[0]) * (c[1] - a[1]) > (b[1] - a[1]) * (c[0] - a[0]):
                break
            chain.pop()
        chain.append(c)
    return sum((a[0] * b[1] - a[1] * b[0] for a, b in pairwise(chain)), Fraction())


def check_limits(totals: Totals, proof: Any) -> Iterator[str]:
    """Yield what does not hold of an optimum under limits, or of the proof that there is none.

    Prices p ≥ 0 bound r(π) + Σ p c(π) by μ V; a flow that keeps the limits and meets the bound is
    optimal. Without the reward, such a bound proves that no policy keeps the limits.
    """
    names, sign, prices, reward = totals.names, totals.model.sign, proof.price, proof.feasible
    ensure({x.name for x in proof.limits} <= {*names[1:]}, "what is limited is not counted")
    ensure(len(prices) == len(proof.limits), "not one price for each limit")
    ensure({x.sign for x in proof.limits} <= {1, -1}, "a limit is neither >= nor <=")
    rewards = zip(totals.amounts[0], totals.model.top, totals.model.below, strict=True)
    if any(own * below != sign * top for own, top, below in rewards):
        yield "what is maximised is not the reward"
    if min(prices, default=0) < 0 or (proof.shift == 0) is not reward or proof.shift < 0:
        yield "a price or the step of the limits is negative, or contradicts that they can be kept"
    earned, bound = totals.compute_earnings(proof.flow), Fraction()
    weights = [Fraction(reward)] + [Fraction()] * (len(names) - 1)
    for limit, price in zip(proof.limits, prices, strict=True):
        k = names.index(limit.name)
        weights[k] += sign * limit.sign * price
        bound += price * limit.sign * limit.bound
        if limit.sign * (sign * earned[k] - limit.bound) + proof.shift < 0:
            yield f"the policy does not keep {limit.name}"
    bound += earned[0] if reward else -proof.shift
    if not totals.is_upper_bound(weights, proof.dual, bound):
        yield "the values do not prove that no policy is better"
    if not reward and sum(prices) != 1:
        yield "nothing proves that no policy keeps the limits"


def check_weights(totals: Totals, proof: Any) -> Iterator[str]:
    """Yield what does not hold of the least change of weights that makes a policy optimal.

    For multipliers x ≥ 0 of other policies, D = Σ x (v(ρ) - v(π)) satisfies w D ≤ 0 for all weights
    under which π is optimal, so that |w - 1| ≤ t needs t ≥ Σ D / Σ |D|.
    """
    names, own = totals.names, totals.compute_earnings(proof.flow)
    ensure(len(proof.multipliers) == len(proof.intervals) == len(names), "not one of each weight")
    if max(abs(w - 1) for w in proof.multipliers) != proof.change:
        yield "the weights are not changed by that much"

    def compute_lead(flow: Any) -> list[Fraction]:
        return [a - b for a, b in zip(totals.compute_earnings(flow), own, strict=True)]

    def is_optimal(at: Point, values: Any) -> bool:
        return values is not None and totals.is_upper_bound(at, values, weigh_values(at, own))

    if not is_optimal(proof.multipliers, proof.dual):
        yield "the values do not prove the policy optimal for the weights"
    leads = []
    for cut in proof.cuts:
        leads.append([cut.multiplier * x for x in compute_lead(cut.flow)])
    total = [sum(column, Fraction()) for column in zip(*leads, strict=True)]
    least, size = max(Fraction(), sum(total, Fraction())), sum(map(abs, total))
    if any(cut.multiplier < 0 for cut in proof.cuts) or least != proof.change * size:
        yield "nothing proves that a smaller change does not do"
    if not size and proof.change:
        yield "nothing proves that the weights have to change"
    for k, (name, interval) in enumerate(zip(names, proof.intervals, strict=True)):
        steps = [compute_lead(flow) for flow in interval.cuts]
        low, high = solve_inequalities([(step[k], sum(step) - step[k]) for step in steps])
        if interval.low is None or interval.high is None:
            if low <= high or interval.low is not interval.high:
                yield f"nothing proves that {name} alone does not do"
            continue
        fits = (low, high) == (interval.low, interval.high)
        for x, values in ((low, interval.at_low), (high, interval.at_high)):
            at = [Fraction(x != inf)] * len(names)  # at infinity, this one alone
            at[k] = Fraction(1) if isinstance(x, float) else x
            fits = fits and is_optimal(at, values)
        if not fits:
            yield f"the interval of {name} alone is not proven"


def solve_inequalities(
    lines: Sequence[tuple[Fraction, Fraction]],
) -> tuple[Fraction, Fraction | float]:
    """Return the least and the greatest x ≥ 0 with slope x + rest ≤ 0 on all lines, or 1 and 0."""
    low: Fraction = Fraction()
    high: Fraction | float = inf
    for slope, rest in lines:
        if slope == 0 < rest:
            return Fraction(1), Fraction()
        if slope < 0:
            low = max(low, rest / -slope)
        elif slope > 0 and -rest / slope < high:
            high = -rest / slope
    return low, high


KINDS: dict[str, Callable[[Totals, Any], Iterator[str]]] = {
    "front": check_front, "limits": check_limits, "weights": check_weights,
}  # fmt: skip


def list_totals_violations(totals: Totals, proof: Any) -> list[str]:
    """Return the violations of a proof about totals in words: an empty list if it is sound.

    Raises Unreadable where numbers of the proof do not fit the model.
    """
    return [*totals.find_faults(proof.rank), *KINDS[proof.kind](totals, proof)]
