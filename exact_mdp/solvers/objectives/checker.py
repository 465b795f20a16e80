"""Checks totals, weighted optima and optima under limits against the model alone, in integers.

Nothing here imports a solver. V ≥ c_w + γ P V for all pairs bounds the weighted total of every
policy at the start by μ V, because the equations of every policy have one solution (see
`solvers.exact.checker`; `sound` checks that); V = c + γ P V for the pairs of a policy is its total.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from math import inf, lcm
from typing import NamedTuple

import numpy as np

from exact_mdp.mdp.table import Integers, Numbers, common, shown
from exact_mdp.solvers.exact.levels import Level, fraction, surplus
from exact_mdp.solvers.objectives.amounts import Objectives

Point = tuple[Fraction, ...]


class Values(NamedTuple):
    """Values of the states, as integers over one positive denominator."""

    top: list[int]
    below: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Attained:
    """A deterministic policy, the values of each objective under it, and its totals at the start.

    More is better in all of them: those of a model of costs are negated.
    """

    pairs: Integers
    values: tuple[Values, ...]
    total: Point


Rank = Integers | None
"""(S,) integers that each pair may lower, where a run goes on: every policy ends, at discount 1."""


def sound(of: Objectives, rank: Rank) -> list[str]:
    """Return why the equations may have several solutions; nothing where they have one."""
    mdp, table = of.ending, of.ending.table
    if mdp.discount_exact < 1:
        return []
    if rank is not None and rank.shape == mdp.terminal.shape:
        falls = np.minimum.reduceat(rank[table.next], table.offsets[:-1]) < rank[mdp.pair_state]
        if (falls | mdp.terminal[mdp.pair_state]).all():
            return []
    return ["nothing proves that the equations of every policy have one solution"]


def slack(
    of: Objectives, amount: Numbers, values: Values, pairs: Integers | None = None
) -> Numbers:
    """Return what V is above amount + γ P V, times positive integers; V itself at ends.

    Of some pairs, all by default.
    """
    state = of.mdp.pair_state if pairs is None else of.mdp.pair_state[pairs]
    rows, level = replace(of.rows, constant=amount), Level.over(values.top, values.below)
    ((tops, _),) = surplus(rows, level, pairs=pairs)
    own = np.array(values.top, dtype=object)[state]
    return np.where(rows.terminal[state], own, -np.array(tops, dtype=object))


def tight(of: Objectives, weights: Sequence[Fraction], values: Values) -> Integers:
    """Return (S,) the first pair of each state whose inequality is tight; at ends, the first."""
    loss = _weighted_slack(of, weights, values)
    state = of.mdp.pair_state
    pairs = np.flatnonzero(np.asarray(loss == 0, dtype=bool) | of.rows.terminal[state])
    return np.asarray(pairs[np.flatnonzero(np.diff(state[pairs], prepend=-1))])


def _weighted_slack(of: Objectives, weights: Sequence[Fraction], values: Values) -> Numbers:
    whole, below = common(list(weights))
    unit = lcm(below, values.below)  # prices and values share long denominators
    times = unit // values.below
    earned = of.weighted([number * (unit // below) for number in whole])
    return slack(of, earned, Values([number * times for number in values.top], 1))


def wrong_totals(of: Objectives, policy: Attained, name: str) -> list[str]:
    """Return what does not hold of a policy's totals."""
    if not np.array_equal(of.mdp.pair_state[policy.pairs], np.arange(of.mdp.n_states)):
        return [f"{name} does not take one pair of each state"]
    for amount, values, total in zip(of.amounts, policy.values, policy.total, strict=True):
        if values.below <= 0 or slack(of, amount, values, policy.pairs).any():
            return [f"the values of {name} do not solve its equations"]
        if of.at_start(*values) != total:
            return [f"{name} has other totals at the start"]
    return []


def wrong_bound(
    of: Objectives, weights: Sequence[Fraction], values: Values, bound: Fraction
) -> bool:
    """Return whether values do not prove that no policy has a weighted total above the bound."""
    if values.below <= 0 or of.at_start(*values) > bound:
        return True
    return bool((_weighted_slack(of, weights, values) < 0).any())


def front_violations(
    of: Objectives, rank: Rank, vertices: Sequence[Attained], duals: Mapping[Point, Values]
) -> list[str]:
    """Return what does not hold of an exact front of two or three objectives.

    The greatest weighted total H(w) is convex in the weights, that of the vertices h(w) too. Where
    both agree at points whose hulls, taken over the points of each vertex, fill all weights that
    sum to 1, h is linear between such points, H ≤ h, and no policy is beyond the vertices. Cells of
    two vertices share no area, so that areas add up: a vertex that is written twice is refused.
    """
    wrong = sound(of, rank)
    for number, vertex in enumerate(vertices):
        wrong += wrong_totals(of, vertex, f"vertex {number}")
    cells: list[list[Point]] = [[] for _ in vertices]
    totals = [vertex.total for vertex in vertices]
    if len(set(totals)) < len(totals):
        wrong.append("a vertex is written twice")
    for weights, best in best_for(duals, totals).items():
        worth = sum((w * v for w, v in zip(weights, totals[best[0]], strict=True)), Fraction(0))
        if sum(weights) != 1 or min(weights) < 0 or wrong_bound(of, weights, duals[weights], worth):
            shown = ", ".join(map(str, weights))
            wrong.append(f"the bound for weights ({shown}) does not hold")
        for number in best:
            cells[number].append(weights)
    if sum(map(_size, cells)) != 1:
        wrong.append("the bounds do not cover all weights")
    if any(not _size(cell) for cell in cells):
        wrong.append("a vertex is not one: others are as good for all weights")
    return wrong


def best_for(weights: Iterable[Point], totals: Sequence[Point]) -> dict[Point, tuple[int, ...]]:
    """Return which of the totals are greatest for each of the weights.

    Two totals along a chain that falls and bends down rise and then fall for all weights ≥ 0, and
    the best ones move along it with the weights: each is looked at a few times.
    """
    found = {}
    if _chained(totals):
        order = sorted(range(len(totals)), key=lambda number: totals[number])
        at = 0
        for own in sorted(weights):
            while at + 1 < len(order) and _beats(own, totals[order[at + 1]], totals[order[at]]) > 0:
                at += 1
            tied = at + 1 < len(order) and not _beats(own, totals[order[at + 1]], totals[order[at]])
            found[own] = tuple(sorted(order[at : at + 1 + tied]))
        return found
    for own in weights:
        worth = [sum(w * v for w, v in zip(own, total, strict=True)) for total in totals]
        found[own] = tuple(i for i, value in enumerate(worth) if value == max(worth))
    return found


def _chained(totals: Sequence[Point]) -> bool:
    chain = sorted(totals)
    return (
        len(chain) > 0
        and len(chain[0]) == 2
        and all(a[0] < b[0] and a[1] > b[1] for a, b in pairwise(chain))
        and all(_turn(a, b, c) < 0 for a, b, c in zip(chain, chain[1:], chain[2:], strict=False))
    )


def _beats(weights: Point, a: Point, b: Point) -> Fraction:
    return sum((w * (x - y) for w, x, y in zip(weights, a, b, strict=True)), Fraction(0))


def _size(points: Sequence[Point]) -> Fraction:
    """Return the length or area of a convex hull of weights, of which all make 1."""
    if len(points) < 2:
        return Fraction(0)
    if len(points[0]) == 2:
        first = [point[0] for point in points]
        return max(first) - min(first)
    flat = sorted({point[:2] for point in points})
    return sum((_half(part) for part in (flat, flat[::-1])), Fraction(0))


def _half(points: Sequence[Point]) -> Fraction:
    """Return what one chain of a convex hull adds to twice its area (Andrew, 1979)."""
    chain: list[Point] = []
    for point in points:
        while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= 0:
            chain.pop()
        chain.append(point)
    return sum((a[0] * b[1] - a[1] * b[0] for a, b in pairwise(chain)), Fraction(0))


def _turn(a: Point, b: Point, c: Point) -> Fraction:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


Flow = dict[int, Fraction]
"""Expected visits from the start, of pairs; none of other pairs."""


class Visits(Mapping[int, Fraction]):
    """The same as integers over one denominator; a fraction of them is made when it is asked for.

    Lowest terms of 1,000 long fractions take as long as it takes to find them.
    """

    def __init__(self, top: Mapping[int, int], below: int) -> None:
        self.top, self.below = top, below

    def __getitem__(self, pair: int) -> Fraction:
        return fraction(self.top[pair], self.below)

    def __iter__(self) -> Iterator[int]:
        return iter(self.top)

    def __len__(self) -> int:
        return len(self.top)


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A total is at least (sign 1) or at most (sign -1) a bound."""

    name: str
    sign: int
    bound: Fraction

    def __str__(self) -> str:
        return self._with(str(self.bound))

    def text(self, digits: int) -> str:
        """Return the limit with its bound in decimals."""
        return self._with(shown(self.bound, digits))

    def _with(self, bound: str) -> str:
        return f"{self.name} {'>=' if self.sign > 0 else '<='} {bound}"


def moved_by(step: Fraction, limit: Limit) -> Limit:
    """Return a limit that is easier to keep by a step."""
    return replace(limit, bound=limit.bound - limit.sign * step)


def totals_of(of: Objectives, flow: Mapping[int, Fraction]) -> Point:
    """Return what the pairs visited earn of each objective."""
    share, below = _over_scales(of, flow)
    return tuple(
        Fraction(sum(v * int(own[l]) for l, v in zip(flow, share, strict=True)), below)
        for own in of.amounts
    )


def _over_scales(of: Objectives, flow: Mapping[int, Fraction]) -> tuple[list[int], int]:
    """Return visits over the scales of their states, as integers over one denominator."""
    scale = [int(of.rows.scale[of.mdp.pair_state[pair]]) for pair in flow]
    if isinstance(flow, Visits):
        parts = [divmod(top, unit) for top, unit in zip(flow.top.values(), scale, strict=True)]
        if not any(rest for _, rest in parts):
            return [whole for whole, _ in parts], flow.below
    return common([visits / unit for visits, unit in zip(flow.values(), scale, strict=True)])


def constrained_violations(
    of: Objectives,
    rank: Rank,
    limits: Sequence[Limit],
    flow: Mapping[int, Fraction],
    price: Sequence[Fraction],
    dual: Values,
    shift: Fraction,
) -> list[str]:
    """Return what does not hold of an optimum under limits, or of the proof that there is none.

    `price` begins with that of the reward: 1, or 0 where no policy keeps the limits. Prices p ≥ 0
    bound p₀ r(π) + Σ p c(π) by μ V; a flow that keeps the limits and meets the bound is optimal.
    """
    wrong, (reward, *each) = [*sound(of, rank), *_not_reward(of)], price
    if reward not in (0, 1) or min(each, default=0) < 0 or shift < 0 or (reward and shift):
        wrong.append("a price or the step of the limits is negative")
    if not _flows(of, flow):
        wrong.append("the visits are not those of a policy")
        return wrong
    totals, names = totals_of(of, flow), of.names
    weights = dict.fromkeys(names, Fraction(0)) | {names[0]: Fraction(reward)}
    right = Fraction(0)
    for limit, own in zip(limits, each, strict=True):
        weights[limit.name] += of.sign * limit.sign * own
        right += own * limit.sign * limit.bound
        if limit.sign * (of.sign * totals[names.index(limit.name)] - limit.bound) + shift < 0:
            wrong.append(f"the policy does not keep {limit}")
    bound = right + totals[0] if reward else right - shift
    if wrong_bound(of, list(weights.values()), dual, bound):
        wrong.append("the values do not prove that no policy is better")
    if not reward and (shift <= 0 or sum(each) != 1):
        wrong.append("nothing proves that no policy keeps the limits")
    return wrong


def _not_reward(of: Objectives) -> Iterator[str]:
    """Yield a fault where the first objective is not the reward."""
    gain, below = of.mdp.table.expected_gain_exact()
    scale = of.sign * of.rows.scale.astype(object)[of.mdp.pair_state]
    if (of.amounts[0] * below.astype(object) != gain * scale).any():
        yield "what is maximised is not the reward"


def room(of: Objectives, limit: Limit, totals: Point) -> Fraction:
    """Return by how much totals, of which more is better, keep a limit; negative if they do not."""
    return limit.sign * (of.sign * totals[of.names.index(limit.name)] - limit.bound)


def _flows(of: Objectives, flow: Mapping[int, Fraction]) -> bool:
    """Return whether visits are positive, and what leaves each state has come into it."""
    rows, state = of.rows, of.mdp.pair_state
    share, below = _over_scales(of, flow)
    if below <= 0 or min(share, default=1) <= 0 or rows.terminal[state[list(flow)]].any():
        return False
    first, parts = common([weight for _, weight in of.mdp.start])
    left = [0] * of.mdp.n_states
    for (own, _), weight in zip(of.mdp.start, first, strict=True):
        left[own] += weight * below
    for pair, number in zip(flow, share, strict=True):
        visits, own = number * parts, int(state[pair])
        left[own] -= visits * int(rows.scale[own])
        for i in range(int(rows.offsets[pair]), int(rows.offsets[pair + 1])):
            left[int(rows.next[i])] += visits * int(rows.weight[i])
    return not any(rest for s, rest in enumerate(left) if not rows.terminal[s])


@dataclass(frozen=True, kw_only=True, eq=False)
class Cut:
    """A policy, by its visits, that is worth at most as much as another one; and a multiplier."""

    flow: Flow
    multiplier: Fraction


@dataclass(frozen=True, kw_only=True, eq=False)
class Interval:
    """Multipliers of one weight for which a policy is optimal, or None; and what proves it.

    Attributes
    ----------
    low, high : Fraction, infinite, or None
    at_low, at_high : Values, optional
        What no policy exceeds at the ends; at infinity, of this component alone.
    cuts : tuple of {pair: Fraction}
        Visits of policies that are better beyond the ends.
    """

    low: Fraction | None
    high: Fraction | float | None
    at_low: Values | None
    at_high: Values | None
    cuts: tuple[Flow, ...]

    @property
    def ends(self) -> tuple[Fraction, Fraction | float] | None:
        """Both ends, or None."""
        return None if self.low is None or self.high is None else (self.low, self.high)


def allowed(
    lines: Sequence[tuple[Flow, Fraction, Fraction]],
) -> tuple[Fraction, Fraction | float, tuple[Flow, ...]]:
    """Return the least and the greatest x ≥ 0 with slope x + rest ≤ 0 on all lines, and which bind.

    The least is above the greatest where there are none.
    """
    low: Fraction = Fraction(0)
    high: Fraction | float = inf
    below, above = list[Flow](), list[Flow]()
    for flow, slope, rest in lines:
        if slope < 0 and rest / -slope > low:
            low, below = rest / -slope, [flow]
        elif slope > 0 and -rest / slope < high:
            high, above = -rest / slope, [flow]
        elif slope == 0 < rest:
            return Fraction(1), Fraction(0), (flow,)
    return low, high, (*below, *above)


def rationalization_violations(
    of: Objectives,
    rank: Rank,
    flow: Mapping[int, Fraction],
    weights: Sequence[Fraction],
    change: Fraction,
    dual: Values,
    cuts: Sequence[Cut],
    intervals: Sequence[Interval],
) -> list[str]:
    """Return what does not hold of the least change of weights that makes a policy optimal.

    For multipliers x ≥ 0 of other policies, D = Σ x (v(ρ) - v(π)) satisfies w D ≤ 0 for all weights
    under which π is optimal, so that |w - 1| ≤ t needs t ≥ Σ D / Σ |D|.
    """
    wrong = sound(of, rank)
    flows = [flow, *(cut.flow for cut in cuts), *(own for each in intervals for own in each.cuts)]
    if not all(_flows(of, own) for own in flows):
        return [*wrong, "visits are not those of a policy"]
    totals = totals_of(of, flow)

    def lead(other: Flow) -> list[Fraction]:
        return [a - b for a, b in zip(totals_of(of, other), totals, strict=True)]

    def beaten(at: Sequence[Fraction], values: Values | None) -> bool:
        worth = sum((w * v for w, v in zip(at, totals, strict=True)), Fraction(0))
        return values is None or wrong_bound(of, at, values, worth)

    if len(weights) != len(totals) or max(abs(w - 1) for w in weights) != change:
        wrong.append("the weights are not changed by that much")
    if beaten(weights, dual):
        wrong.append("the values do not prove the policy optimal for the weights")
    leads = [[cut.multiplier * x for x in lead(cut.flow)] for cut in cuts]
    total = [sum(column, Fraction(0)) for column in zip(*leads, strict=True)]
    least = max(Fraction(0), sum(total, Fraction(0)))
    if any(c.multiplier < 0 for c in cuts) or least != change * sum(map(abs, total)):
        wrong.append("nothing proves that a smaller change does not do")
    if not total and change:
        wrong.append("nothing proves that the weights have to change")
    for k, (name, own) in enumerate(zip(of.names, intervals, strict=True)):
        lines = [(cut, step[k], sum(step) - step[k]) for cut in own.cuts for step in [lead(cut)]]
        low, high, _ = allowed(lines)
        if own.ends is None:
            good = low > high
        else:
            first, last = (
                [Fraction(j == k) if x == inf else Fraction(x) if j == k else Fraction(1)
                 for j in range(len(totals))]
                for x in own.ends
            )  # fmt: skip
            good = own.ends == (low, high)
            good &= not (beaten(first, own.at_low) or beaten(last, own.at_high))
        if not good:
            wrong.append(f"the interval of {name} alone is not proven")
    return wrong
