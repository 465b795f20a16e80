"""The probability mass of (state, reward so far), carried through an episode block by block.

    m(s', x + r) += p · m(s, x)        for each outcome (p, s', r) of s

The states that an episode may visit fall into blocks: those of the same greatest distance from the
start once states that lead back to each other count as one. Every transition leads to a later
block, or back into its own. So a block is complete when its turn comes, and can be forgotten.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import accumulate
from math import lcm
from operator import mul
from typing import Any

import numpy as np
import scipy.sparse as sp
import tqdm

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import Mask, longest_ways
from exact_mdp.mdp.table import Integers, Numbers, spans
from exact_mdp.solvers.bounds.gains import TINY
from exact_mdp.solvers.values.policy_chain import PolicyChain

REMAINING = 1e-12
# Of what may be left in a cycle anyway: without it, a slow one would drag long tails along.
SLOW_EDGE = 1e-12
EDGE = 1e-290  # masses below are dropped before they lose their digits, and the processor its speed
STEPS, CELLS = 10**9, 2**25  # masses times outcomes: in all, and at once
DENSE = 8  # numbers of an array for each mass that it may hold
SWEEPS, MERGED = 1_000_000, 64  # sweeps of a block, and those whose masses are kept apart


@dataclass(frozen=True, kw_only=True, eq=False)
class Flow:
    """The outcomes that an episode can meet, among states numbered by block.

    All terminal states together are the end, a block of its own, the last.
    """

    chain: PolicyChain
    used: Integers  # (M,) which of the chain's outcomes
    source: Integers  # (M,) outcome by outcome
    target: Integers  # (M,) the number of states stands for the end
    gain: Numbers  # (M,)
    block: Integers  # (n+1,) block of each state, in increasing order
    start: dict[int, Fraction]  # {state: probability}

    @classmethod
    def of(cls, chain: PolicyChain, gain: Numbers, ends: Mask) -> Flow:
        """Return the flow of a chain that ends, with (N,) rewards as multiples of a unit.

        What comes to other ends than `ends` (S,) is left out.
        """
        mdp = chain.mdp
        inside = chain.reached & ~mdp.terminal
        members = np.flatnonzero(inside)
        _, level = longest_ways(chain.graph[members][:, members].T.tocsr())
        order = np.argsort(level, kind="stable")
        place = np.full(mdp.n_states, len(members))
        place[members[order]] = np.arange(len(members))
        used = np.flatnonzero(inside[chain.source] & (inside | ends)[chain.table.next])
        start: dict[int, Fraction] = defaultdict(Fraction)
        for state, weight in mdp.start:
            if inside[state] or ends[state]:
                start[int(place[state])] += weight
        return cls(
            chain=chain,
            used=used,
            source=place[chain.source[used]],
            target=place[chain.table.next[used]],
            gain=gain[used],
            block=np.append(level[order], level.max(initial=-1) + 1),
            start={state: weight for state, weight in start.items() if weight},
        )

    @property
    def end(self) -> int:
        """The number that stands for the end."""
        return len(self.block) - 1

    @cached_property
    def first(self) -> Integers:
        """(B+1,) the first state of each block, and one past the end."""
        return np.searchsorted(self.block, np.arange(self.block[-1] + 2))

    @cached_property
    def cyclic(self) -> Mask:
        """(B,) True for blocks with transitions into themselves."""
        inner = self.block[self.source] == self.block[self.target]
        return np.bincount(self.block[self.source[inner]], minlength=self.block[-1] + 1) > 0

    @property
    def tolerance(self) -> float:
        """Mass that may be left in each cyclic block."""
        return REMAINING / max(int(self.cyclic.sum()), 1)

    @property
    def entering(self) -> Integers:
        """(n+1,) the number of outcomes that lead to each state."""
        return np.bincount(self.target, minlength=self.end + 1)


Mass = tuple[Integers, Numbers, Numbers]  # states, multiples and masses (K,)


def carried(flow: Flow, *, exact: bool) -> tuple[Numbers, Numbers, Any, int]:
    """Return multiples and masses at the end, the mass that is not in them, and its roundings.

    Masses are floats, or Fractions if they are `exact`.
    """
    if exact and flow.cyclic.any():
        raise ModelError(
            "states lead back to each other, so that returns have no end",
            where="policy",
            fix="leave out exact=True: all but 10^-12 of the probability is then found",
        )
    total, ends = 1, flow.end + 1
    shares = flow.chain.probability[flow.used]
    start: dict[int, Any] = {state: float(weight) for state, weight in flow.start.items()}
    if exact:
        shares, start, total = _integers(flow)
    # Several actions may do the same: their outcomes become one.
    pair, gain, share = _summed([(flow.source * ends + flow.target, flow.gain, shares)])
    source, target = np.divmod(pair, ends)
    inner = flow.block[source] == flow.block[target]
    lost: Any = 0
    work, roundings, last = 0, 0, int(flow.block[-1])
    entering = np.maximum.reduceat(flow.entering, flow.first[:-1])

    def in_products(moving: Mass, outcomes: Integers) -> Mass | None:
        """Return the same in products of matrices, where few numbers of an array are 0."""
        state, multiple, mass = moving
        if (
            multiple.dtype != np.int64
            or mass.dtype != np.float64
            or not min(len(mass), len(outcomes))
        ):
            return None
        gains, kind = np.unique(gain[outcomes], return_inverse=True)
        to, row = np.unique(target[outcomes], return_inverse=True)
        low, least = int(multiple.min()), int(state.min())
        rows, width = int(state.max()) - least + 1, int(multiple.max()) - low + 1
        spread = int(gains[-1] - gains[0])
        if max(rows, len(to)) * (width + spread) > DENSE * len(mass):
            return None
        own, there = np.zeros((rows, width)), np.zeros((len(to), width + spread))
        own[state - least, multiple - low] = mass
        for number, first in enumerate((gains - gains[0]).tolist()):
            some = outcomes[kind == number]
            begins = np.searchsorted(source[some], np.arange(least, least + rows + 1))
            inside = slice(begins[0], begins[-1])
            parts = share[some][inside], row[kind == number][inside], begins - begins[0]
            there[:, first : first + width] += sp.csc_array(parts, (len(to), rows)) @ own
        place, further = np.nonzero(there)
        return to[place], low + int(gains[0]) + further, there[place, further]

    def handed_on(moving: Mass, outcomes: Integers) -> Mass:
        """Return what becomes of a mass by some outcomes, in the order of their sources."""
        nonlocal work, lost
        state, multiple, mass = moving
        first, after = (
            np.searchsorted(source[outcomes], state, side) for side in ("left", "right")
        )
        count = int((after - first).sum())
        work += count
        if work > STEPS or count > CELLS:
            raise ModelError(
                "too many different returns for their distribution to be worked out",
                where="rewards",
                fix="round the rewards to a coarser grid; evaluate() gives mean and sd, "
                "simulate() samples",
            )
        if (products := in_products(moving, outcomes)) is not None:
            if mass.min() * share[outcomes].min() < EDGE:  # underflow takes some away
                lost += TINY * count
            return products
        by, each = outcomes[spans(first, after)], np.repeat(np.arange(len(state)), after - first)
        onward = mass[each] * share[by]
        lost += TINY * (len(onward) - np.count_nonzero(onward))  # underflow takes some away
        return target[by], multiple[each] + gain[by], onward

    waiting: dict[int, list[Mass]] = defaultdict(list)
    for state, weight in start.items():
        first = np.array([state]), np.zeros(1, dtype=gain.dtype), np.array([weight], share.dtype)
        waiting[int(flow.block[state])].append(first)
    for block in tqdm.tqdm(range(last), desc="returns", unit="block", delay=2, disable=None):
        if block not in waiting:  # what led here was too small to speak of
            continue
        moving = _summed(waiting.pop(block))
        visits, sweep = [moving], 0
        own = np.arange(*np.searchsorted(source, flow.first[block : block + 2]))
        while flow.cyclic[block]:
            moving, small = _large(_summed([handed_on(moving, own[inner[own]])]), flow.tolerance)
            left, sweep = float(moving[2].sum()), sweep + 1
            lost += small
            if left <= flow.tolerance:
                lost += left
                break
            if sweep == SWEEPS:
                raise ModelError(
                    f"after {sweep:,} sweeps {left:.1g} of the probability has not reached the end",
                    where="policy",
                    fix="evaluate() gives mean and sd, simulate() samples returns",
                )
            visits.append(moving)
            if len(visits) == MERGED:
                visits = [_summed(visits)]
        met, small = _large(_summed(visits), 0.0)
        lost += small
        roundings += (int(entering[block]) + flow.chain.roundings + 7) * (sweep + 1)
        following = handed_on(met, own[~inner[own]])
        leads = flow.block[following[0]]
        for there in np.flatnonzero(np.bincount(leads)).tolist():
            to, multiple, mass = (part[leads == there] for part in following)
            waiting[there].append((to, multiple, mass))
    if not waiting:
        return gain[:0], share[:0], lost, roundings
    (_, multiples, masses), small = _large(_summed(waiting[last]), 0.0)
    if exact:
        masses = np.array([Fraction(mass, total) for mass in masses.tolist()], dtype=object)
    return multiples, masses, lost + small, roundings + int(entering[last]) + 10


def _integers(flow: Flow) -> tuple[Numbers, dict[int, int], int]:
    """Return shares (M,) and masses at the start as integers, and the denominator at the end.

    A mass of block b is over start · common[0] ⋯ common[b-1]: the share of a transition that skips
    blocks is multiplied by every denominator between.
    """
    (weight, below), block = flow.chain.odds, flow.block.tolist()
    unders = below[flow.chain.source[flow.used]].tolist()
    chances = [*map(Fraction, weight[flow.used].tolist(), unders)]
    ways = list(zip(chances, flow.block[flow.source], flow.block[flow.target], strict=True))
    common = [1] * block[-1]
    for chance, here, _ in ways:
        common[here] = lcm(common[here], chance.denominator)
    product = [*accumulate(common, mul, initial=1)]
    shares = np.empty(len(ways), dtype=object)
    shares[:] = [int(p * common[i]) * (product[j] // product[i + 1]) for p, i, j in ways]
    bottom = lcm(*(weight.denominator for weight in flow.start.values()))
    start = {s: int(weight * bottom) * product[block[s]] for s, weight in flow.start.items()}
    return shares, start, bottom * product[-1]


def _large(moving: Mass, tolerance: float) -> tuple[Mass, Any]:
    """Return the mass without what is too small to speak of, and that in all."""
    if moving[2].dtype == object:
        return moving, 0
    small = moving[2] < max(EDGE, tolerance * SLOW_EDGE)
    state, multiple, mass = (part[~small] for part in moving)
    return (state, multiple, mass), float(moving[2][small].sum())


def _summed(parts: list[Mass]) -> Mass:
    """Return masses in the order of states and multiples, those of the same added up."""
    state, multiple, mass = (np.concatenate(each) for each in zip(*parts, strict=True))
    if multiple.dtype == np.int64 and mass.dtype == np.float64 and len(mass):
        low, least = int(multiple.min()), int(state.min())
        width, count = int(multiple.max()) - low + 1, int(state.max()) - least + 1
        if width * count <= DENSE * len(mass):
            total = np.bincount((state - least) * width + (multiple - low), mass)
            place = np.flatnonzero(total)
            row, column = np.divmod(place, width)
            return least + row, low + column, total[place]
    different, place = np.unique(multiple, return_inverse=True)
    key = state * len(different) + place
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    total = np.add.reduceat(mass[order], first) if len(first) else mass
    return state[order][first], multiple[order][first], total
