"""The probability mass of (state, reward so far), carried through an episode block by block.

    m(s', x + r) += p · m(s, x)        for each outcome (p, s', r) of s

The states that an episode may visit fall into blocks: those of the same greatest distance from the
start once states that lead back to each other count as one. Every transition leads to a later
block, or back into its own. So a block is complete when its turn comes, and can be forgotten.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from fractions import Fraction
from itertools import accumulate
from math import inf, lcm
from operator import mul
from typing import Any

import numpy as np
import scipy.sparse as sp
import tqdm

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import Mask, longest_ways
from exact_mdp.mdp.table import Integers, Numbers, concatenate_ranges
from exact_mdp.solvers.bounds.gains import TINY
from exact_mdp.solvers.values.policy_chain import PolicyChain

# What is left out is counted, whatever these are: what cycles have left, at most REMAINING, and
# masses below the part SLOW_EDGE of that, or a slow cycle would drag long tails along.
REMAINING, SLOW_EDGE = 1e-12, 1e-12
EDGE = 1e-290  # masses below are left out: above 2⁻¹⁰²² / UNIT, where underflow costs no digit
# More is refused. 10⁹ masses times outcomes take half a minute; 2²⁵ at once, a gigabyte.
STEPS, CELLS, SWEEPS = 10**9, 2**25, 1_000_000
FEW = 200  # states of a block of which a power of the matrix tells at once whether it is left
DENSE, MERGED = 8, 64  # numbers of an array for each mass in it; sweeps kept apart; for speed


Mass = tuple[Integers, Numbers, Numbers]  # states, multiples and masses (K,)


class MassFlow:
    """The outcomes that an episode can meet, among states numbered by block, with their returns.

    The ends are a block of their own, the last: all finite ones together, and those for a return of
    -∞ and of ∞. Their numbers follow the numbers of the states.
    """

    def __init__(
        self, chain: PolicyChain, gain: Numbers, lost: Mapping[float, Mask], *, exact: bool
    ) -> None:
        """Take a chain that ends, rewards (N,) as multiples of a unit, and infinite ends (S,)."""
        mdp = chain.mdp
        inside = chain.reached & ~mdp.terminal
        members = np.flatnonzero(inside)
        _, level = longest_ways(chain.graph[members][:, members].T.tocsr())
        order = np.argsort(level, kind="stable")
        place = np.full(mdp.n_states, len(members))
        for number, sign in enumerate((-inf, inf), 1):
            place[lost.get(sign, [])] += number
        place[members[order]] = np.arange(len(members))
        used = np.flatnonzero(inside[chain.source])
        source, target = place[chain.source[used]], place[chain.table.next[used]]
        self.block = np.append(level[order], [level.max(initial=-1) + 1] * 3)  # of each state
        self.last = int(self.block[-1])
        self.first = np.searchsorted(self.block, np.arange(self.last + 2))  # states of the blocks
        inner = self.block[source] == self.block[target]
        self.cyclic = np.bincount(self.block[source[inner]], minlength=self.last + 1) > 0
        if exact and self.cyclic.any():
            raise ModelError(
                "states lead back to each other, so that returns have no end",
                where="policy",
                fix="leave out exact=True: all but 10^-12 of the probability is then found",
            )
        entering = np.bincount(target, minlength=len(self.block))  # outcomes that lead to a state
        self.entering, self.chain = np.maximum.reduceat(entering, self.first[:-1]), chain
        self.start = defaultdict[int, Any](Fraction)
        for state, weight in mdp.start:
            if weight:
                self.start[int(place[state])] += weight
        self.total, shares = 1, chain.probability[used]
        if exact:
            shares = self._to_integer_shares(used, source, target)
        else:
            self.start |= {state: float(weight) for state, weight in self.start.items()}
        # Several actions may do the same: their outcomes become one.
        count = len(self.block)
        pair, self.gain, self.share = _sum_masses([(source * count + target, gain[used], shares)])
        self.source, self.target = np.divmod(pair, count)
        self.inner = self.block[self.source] == self.block[self.target]
        self.lost: Any = 0
        self.work = 0

    def _to_integer_shares(self, used: Integers, source: Integers, target: Integers) -> Numbers:
        """Return the shares (M,) of outcomes as integers; make the masses at the start integers.

        A mass of block b is over start · common[0] ⋯ common[b-1]: the share of a transition that
        skips blocks is multiplied by every denominator between. `total` is the one at the end.
        """
        (weight, below), block = self.chain.odds, self.block.tolist()
        unders = below[self.chain.source[used]].tolist()
        chances = [*map(Fraction, weight[used].tolist(), unders)]
        ways = list(zip(chances, self.block[source], self.block[target], strict=True))
        common = [1] * self.last
        for chance, here, _ in ways:
            common[here] = lcm(common[here], chance.denominator)
        product = [*accumulate(common, mul, initial=1)]
        shares = np.empty(len(ways), dtype=object)
        shares[:] = [int(p * common[i]) * (product[j] // product[i + 1]) for p, i, j in ways]
        bottom = lcm(*(weight.denominator for weight in self.start.values()))
        self.start |= {s: int(p * bottom) * product[block[s]] for s, p in self.start.items()}
        self.total = bottom * product[-1]
        return shares

    def carry_mass(self) -> tuple[Numbers, Numbers, Any, int]:
        """Return multiples and masses at the ends, the mass that is not in them, its roundings."""
        waiting, roundings = defaultdict[int, list[Mass]](list), 0
        tolerance = REMAINING / max(int(self.cyclic.sum()), 1)  # left in each cyclic block
        for state, weight in self.start.items():
            begin = np.zeros(1, dtype=self.gain.dtype), np.array([weight], self.share.dtype)
            waiting[int(self.block[state])].append((np.array([state]), *begin))
        blocks = range(self.last)
        for block in tqdm.tqdm(blocks, desc="returns", unit="block", delay=2, disable=None):
            if block not in waiting:  # what led here was too small to speak of
                continue
            moving = _sum_masses(waiting.pop(block))
            visits, sweep = [moving], 0
            own = np.arange(*np.searchsorted(self.source, self.first[block : block + 2]))
            inner = self.inner[own]
            if (
                self.cyclic[block]
                and self._estimate_remaining(block, moving, own[inner]) > 2 * tolerance
            ):
                raise ModelError(
                    f"after {SWEEPS:,} steps among states that lead back to each other the end is "
                    "still to come",
                    where="policy",
                    fix="evaluate() gives mean and sd, simulate(…, horizon=1000) samples returns",
                )
            while self.cyclic[block]:
                moving = self._drop_small(
                    _sum_masses([self._handed_on(moving, own[inner])]), tolerance
                )
                left, sweep = float(moving[2].sum()), sweep + 1
                if left <= tolerance:
                    self.lost += left
                    break
                if sweep == SWEEPS:
                    raise ModelError(
                        f"after {sweep:,} sweeps {left:.1g} of the probability has not reached "
                        "the end",
                        where="policy",
                        fix="evaluate() gives mean and sd, simulate() samples returns",
                    )
                visits.append(moving)
                if len(visits) == MERGED:
                    visits = [_sum_masses(visits)]
            met = self._drop_small(_sum_masses(visits), 0.0)
            roundings += (int(self.entering[block]) + self.chain.roundings + 7) * (sweep + 1)
            following = self._handed_on(met, own[~inner])
            leads = self.block[following[0]]
            for there in np.flatnonzero(np.bincount(leads)).tolist():
                to, multiple, mass = (part[leads == there] for part in following)
                waiting[there].append((to, multiple, mass))
        end, multiples, masses = self._drop_small(_sum_masses(waiting[self.last]), 0.0)
        if masses.dtype == object:
            masses = np.array([Fraction(mass, self.total) for mass in masses.tolist()], object)
        finite, above = np.searchsorted(end, len(self.block) - np.array([2, 1]))
        listed, chances = multiples[:finite], masses[:finite]
        for sign, some in ((-inf, masses[finite:above]), (inf, masses[above:])):
            if len(some):
                if sign < 0:
                    place = 0
                else:
                    place = len(listed)
                listed = np.insert(listed.astype(object), place, sign)
                chances = np.insert(chances, place, some.sum())
        roundings += int(self.entering[self.last]) + 10 + len(end) - int(finite)
        return listed, chances, self.lost, roundings

    def _estimate_remaining(self, block: int, moving: Mass, inner: Integers) -> float:
        """Return about the mass that is still in a cyclic block after all sweeps; 0 if unknown."""
        first, last = self.first[block : block + 2]
        if last - first > FEW:
            return 0.0
        matrix = np.zeros((last - first, last - first))
        places = self.source[inner] - first, self.target[inner] - first
        np.add.at(matrix, places, self.share[inner].astype(np.float64))
        mass = np.bincount(moving[0] - first, moving[2].astype(np.float64), last - first)
        return float((mass @ np.linalg.matrix_power(matrix, SWEEPS)).sum())

    def _handed_on(self, moving: Mass, outcomes: Integers) -> Mass:
        """Propagate a probability mass along some outcomes, in the order of their sources."""
        state, multiple, mass = moving
        first, after = (
            np.searchsorted(self.source[outcomes], state, side) for side in ("left", "right")
        )
        count = int((after - first).sum())
        self.work += count
        if self.work > STEPS or count > CELLS:
            raise ModelError(
                "too many different returns for their distribution to be worked out",
                where="rewards",
                fix="round the rewards to a coarser grid; evaluate() gives mean and sd, "
                "simulate() samples",
            )
        if (products := self._in_products(moving, outcomes)) is not None:
            if mass.min() * self.share[outcomes].min() < EDGE:  # underflow takes some away
                self.lost += TINY * count
            return products
        by, each = (
            outcomes[concatenate_ranges(first, after)],
            np.repeat(np.arange(len(state)), after - first),
        )
        onward = mass[each] * self.share[by]
        self.lost += TINY * (len(onward) - np.count_nonzero(onward))  # underflow takes some away
        return self.target[by], multiple[each] + self.gain[by], onward

    def _in_products(self, moving: Mass, outcomes: Integers) -> Mass | None:
        """Return the same in products of matrices, where few numbers of an array are 0."""
        state, multiple, mass = moving
        if (
            multiple.dtype != np.int64
            or mass.dtype != np.float64
            or not min(len(mass), len(outcomes))
        ):
            return None
        gains, kind = np.unique(self.gain[outcomes], return_inverse=True)
        to, row = np.unique(self.target[outcomes], return_inverse=True)
        low, least = int(multiple.min()), int(state.min())
        rows, width = int(state.max()) - least + 1, int(multiple.max()) - low + 1
        spread = int(gains[-1] - gains[0])
        if max(rows, len(to)) * (width + spread) > DENSE * len(mass):
            return None
        own, there = np.zeros((rows, width)), np.zeros((len(to), width + spread))
        own[state - least, multiple - low] = mass
        for number, first in enumerate((gains - gains[0]).tolist()):
            some = outcomes[kind == number]
            begins = np.searchsorted(self.source[some], np.arange(least, least + rows + 1))
            inside = slice(begins[0], begins[-1])
            parts = self.share[some][inside], row[kind == number][inside], begins - begins[0]
            there[:, first : first + width] += sp.csc_array(parts, (len(to), rows)) @ own
        place, further = np.nonzero(there)
        return to[place], low + int(gains[0]) + further, there[place, further]

    def _drop_small(self, moving: Mass, tolerance: float) -> Mass:
        """Return a mass without its negligible parts, and count these as lost."""
        if moving[2].dtype == object:
            return moving
        small = moving[2] < max(EDGE, tolerance * SLOW_EDGE)
        self.lost += float(moving[2][small].sum())
        state, multiple, mass = (part[~small] for part in moving)
        return state, multiple, mass


def _sum_masses(parts: list[Mass]) -> Mass:
    """Return masses in the order of states and multiples; equal places are added up."""
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
    total = mass
    if len(first):
        total = np.add.reduceat(mass[order], first)
    return state[order][first], multiple[order][first], total
