"""The probability mass of (state, reward so far), carried through an episode block by block.

    m(s', x + r) += p · m(s, x)        for each outcome (p, s', r) of s

States that lead back to each other count as one. The states that an episode may visit then fall
into blocks of the same greatest distance from the start. Every transition leads to a later block or
stays in its own, so a block is complete when its turn comes, and can be forgotten after it.
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
from exact_mdp.solvers.bounds.gains import TINY, UNIT
from exact_mdp.solvers.values.policy_chain import PolicyChain

# Omitted mass is counted in the error, whatever these numbers are. At most REMAINING is left in
# cycles. Masses below that part of it are dropped too: the tails that a slow cycle carries along
# would take as long again, measured.
REMAINING = 1e-12
EDGE = np.finfo(float).tiny / UNIT  # smaller masses are dropped, as their products lose digits
# More work is refused. 10⁹ products of a mass and an outcome take half a minute; 2²⁵ at once take a
# gigabyte.
STEPS, CELLS, SWEEPS = 10**9, 2**25, 1_000_000
FEW = 200  # states in a block for which a power of the matrix is cheap enough to estimate the rest
# For speed, arrays hold at most DENSE numbers per mass; for memory, MERGED sweeps are added up.
DENSE, MERGED = 8, 64


Mass = tuple[Integers, Numbers, Numbers]  # states, multiples and masses (K,)


class MassFlow:
    """The outcomes that an episode can meet, with states numbered by block.

    The last block has three ends: one for all finite returns, one for -∞ and one for ∞. Their
    numbers follow the numbers of the states.
    """

    def __init__(
        self, chain: PolicyChain, gain: Numbers, lost: Mapping[float, Mask], *, exact: bool
    ) -> None:
        """Take a chain that ends, rewards (N,) as multiples of a unit, and infinite ends (S,)."""
        mdp = chain.mdp
        inside = chain.reached & ~mdp.terminal
        members = np.flatnonzero(inside)
        # The block of a state is its greatest distance from the start; number states by block.
        _, level = longest_ways(chain.graph[members][:, members].T.tocsr())
        order = np.argsort(level, kind="stable")
        place = np.full(mdp.n_states, len(members))
        for number, sign in enumerate((-inf, inf), 1):
            place[lost.get(sign, [])] += number
        place[members[order]] = np.arange(len(members))
        # The outcomes of these states, between the new numbers.
        used = np.flatnonzero(inside[chain.source])
        source, target = place[chain.source[used]], place[chain.table.next[used]]
        self.block = np.append(level[order], [level.max(initial=-1) + 1] * 3)  # of each state
        self.last = int(self.block[-1])
        self.first = np.searchsorted(self.block, np.arange(self.last + 2))  # states of the blocks
        # A block is cyclic if a transition stays in it.
        inner = self.block[source] == self.block[target]
        self.cyclic = np.bincount(self.block[source[inner]], minlength=self.last + 1) > 0
        if exact and self.cyclic.any():
            raise ModelError(
                "states lead back to each other, so there are infinitely many returns",
                where="policy",
                fix="leave out exact=True: all but 10^-12 of the probability is then found",
            )
        # A mass adds up as many products as outcomes enter its state, which bounds its rounding.
        entering = np.bincount(target, minlength=len(self.block))
        self.entering, self.chain = np.maximum.reduceat(entering, self.first[:-1]), chain
        # Probabilities at the start and of outcomes: integers if exact, else floats.
        self.start = defaultdict[int, Any](Fraction)
        for state, weight in mdp.start:
            if weight:
                self.start[int(place[state])] += weight
        self.total, shares = 1, chain.probability[used]
        if exact:
            shares = self._to_integer_shares(used, source, target)
        else:
            self.start |= {state: float(weight) for state, weight in self.start.items()}
        # Outcomes with the same states and the same reward become one.
        count = len(self.block)
        pair, self.gain, self.share = _sum_masses([(source * count + target, gain[used], shares)])
        self.source, self.target = np.divmod(pair, count)
        self.inner = self.block[self.source] == self.block[self.target]
        self.lost: Any = 0
        self.work = 0

    def _to_integer_shares(self, used: Integers, source: Integers, target: Integers) -> Numbers:
        """Return the shares (M,) of outcomes as integers; make the masses at the start integers.

        A mass of block b has the denominator start · common[0] ⋯ common[b-1]: the share of a
        transition that skips blocks is multiplied by every denominator between. `total` is the
        denominator at the end.
        """
        (weight, below), block = self.chain.exact_outcomes, self.block.tolist()
        unders = below[self.chain.source[used]].tolist()
        chances = [*map(Fraction, weight[used].tolist(), unders)]
        ways = list(zip(chances, self.block[source], self.block[target], strict=True))
        # One denominator for all outcomes of a block.
        common = [1] * self.last
        for chance, here, _ in ways:
            common[here] = lcm(common[here], chance.denominator)
        product = [*accumulate(common, mul, initial=1)]
        # A transition from block i to block j takes the factors of the blocks i + 1 … j - 1 along.
        shares = [int(p * common[i]) * (product[j] // product[i + 1]) for p, i, j in ways]
        bottom = lcm(*(weight.denominator for weight in self.start.values()))
        self.start |= {s: int(p * bottom) * product[block[s]] for s, p in self.start.items()}
        self.total = bottom * product[-1]
        return np.array(shares, dtype=object)

    def carry_mass(self) -> tuple[Numbers, Numbers, Any, int]:
        """Return multiples and masses at the ends, the mass that is lost, and the roundings."""
        incoming, roundings = defaultdict[int, list[Mass]](list), 0
        # All cyclic blocks together may lose REMAINING.
        tolerance = REMAINING / max(int(self.cyclic.sum()), 1)
        # Start with a return of 0 in the block of each start state.
        for state, weight in self.start.items():
            begin = np.zeros(1, dtype=self.gain.dtype), np.array([weight], self.share.dtype)
            incoming[int(self.block[state])].append((np.array([state]), *begin))
        blocks = range(self.last)
        for block in tqdm.tqdm(blocks, desc="returns", unit="block", delay=2, disable=None):
            # All mass that led to this block may have been negligible.
            if block not in incoming:
                continue
            # All of its mass has arrived: earlier blocks are finished.
            moving = _sum_masses(incoming.pop(block))
            visits, sweep = [moving], 0
            own = np.arange(*np.searchsorted(self.source, self.first[block : block + 2]))
            inner = self.inner[own]
            # Refuse a block that is left too slowly before sweeping it a million times.
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
            # Sweep: move all mass one step inside the block, until almost all of it has left.
            # Every visit counts, as mass leaves the block from each.
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
            # Hand the mass of all visits on to later blocks, where it waits for their turn.
            following = self._handed_on(met, own[~inner])
            leads = self.block[following[0]]
            for there in np.flatnonzero(np.bincount(leads)).tolist():
                to, multiple, mass = (part[leads == there] for part in following)
                incoming[there].append((to, multiple, mass))
        # In the last block are the returns themselves, sorted by end and then by multiple.
        end, multiples, masses = self._drop_small(_sum_masses(incoming[self.last]), 0.0)
        if masses.dtype == object:
            masses = np.array([Fraction(mass, self.total) for mass in masses.tolist()], object)
        # An infinite return is one entry, below or above all finite ones.
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
        """Estimate the mass that is still in a cyclic block after all sweeps; 0 if unknown."""
        first, last = self.first[block : block + 2]
        if last - first > FEW:
            return 0.0
        # The mass after n sweeps is m Qⁿ; repeated squaring finds Qⁿ in 20 products.
        matrix = np.zeros((last - first, last - first))
        places = self.source[inner] - first, self.target[inner] - first
        np.add.at(matrix, places, self.share[inner].astype(np.float64))
        mass = np.bincount(moving[0] - first, moving[2].astype(np.float64), last - first)
        return float((mass @ np.linalg.matrix_power(matrix, SWEEPS)).sum())

    def _handed_on(self, moving: Mass, outcomes: Integers) -> Mass:
        """Propagate a probability mass along some outcomes, in the order of their sources."""
        state, multiple, mass = moving
        # The outcomes of each mass lie side by side, as outcomes are sorted by their source.
        sources = self.source[outcomes]
        first = np.searchsorted(sources, state, "left")
        after = np.searchsorted(sources, state, "right")
        count = int((after - first).sum())
        self.work += count
        if self.work > STEPS or count > CELLS:
            raise ModelError(
                "too many different returns for their distribution to be worked out",
                where="rewards",
                fix="round the rewards to a coarser grid; evaluate() gives mean and sd, "
                "simulate() samples",
            )
        products = self._in_products(moving, outcomes)
        if products is not None:
            # A product that may underflow counts as lost.
            if mass.min() * self.share[outcomes].min() < EDGE:
                self.lost += TINY * count
            return products
        # Pair each mass with each outcome of its state: m(s', x + r) += p m(s, x).
        by = outcomes[concatenate_ranges(first, after)]
        each = np.repeat(np.arange(len(state)), after - first)
        onward = mass[each] * self.share[by]
        # No mass is 0, so a product of 0 has underflowed.
        self.lost += TINY * (len(onward) - np.count_nonzero(onward))
        return self.target[by], multiple[each] + self.gain[by], onward

    def _in_products(self, moving: Mass, outcomes: Integers) -> Mass | None:
        """Propagate by products of matrices, if few entries of the arrays are 0; else None."""
        state, multiple, mass = moving
        if (
            multiple.dtype != np.int64
            or mass.dtype != np.float64
            or not min(len(mass), len(outcomes))
        ):
            return None
        # An array over states and returns: with few zeros it is faster than a list of masses.
        gains, kind = np.unique(self.gain[outcomes], return_inverse=True)
        to, row = np.unique(self.target[outcomes], return_inverse=True)
        low, least = int(multiple.min()), int(state.min())
        rows, width = int(state.max()) - least + 1, int(multiple.max()) - low + 1
        spread = int(gains[-1] - gains[0])
        if max(rows, len(to)) * (width + spread) > DENSE * len(mass):
            return None
        own, there = np.zeros((rows, width)), np.zeros((len(to), width + spread))
        own[state - least, multiple - low] = mass
        # All outcomes of one reward shift the returns alike: one sparse product for each reward.
        for number, first in enumerate((gains - gains[0]).tolist()):
            some = outcomes[kind == number]
            begins = np.searchsorted(self.source[some], np.arange(least, least + rows + 1))
            inside = slice(begins[0], begins[-1])
            parts = self.share[some][inside], row[kind == number][inside], begins - begins[0]
            there[:, first : first + width] += sp.csc_array(parts, (len(to), rows)) @ own
        place, further = np.nonzero(there)
        return to[place], low + int(gains[0]) + further, there[place, further]

    def _drop_small(self, moving: Mass, tolerance: float) -> Mass:
        """Return a mass without its negligible parts, which count as lost."""
        if moving[2].dtype == object:
            return moving
        small = moving[2] < max(EDGE, tolerance * REMAINING)
        self.lost += float(moving[2][small].sum())
        state, multiple, mass = (part[~small] for part in moving)
        return state, multiple, mass


def _sum_masses(parts: list[Mass]) -> Mass:
    """Return masses sorted by state and multiple; masses with the same of both are added up."""
    state, multiple, mass = (np.concatenate(each) for each in zip(*parts, strict=True))
    # Count in an array over all states and multiples, if it is not much longer than the list.
    if multiple.dtype == np.int64 and mass.dtype == np.float64 and len(mass):
        low, least = int(multiple.min()), int(state.min())
        width, count = int(multiple.max()) - low + 1, int(state.max()) - least + 1
        if width * count <= DENSE * len(mass):
            total = np.bincount((state - least) * width + (multiple - low), mass)
            place = np.flatnonzero(total)
            row, column = np.divmod(place, width)
            return least + row, low + column, total[place]
    # Otherwise sort by a key, and add up the runs of equal keys.
    different, place = np.unique(multiple, return_inverse=True)
    key = state * len(different) + place
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    total = mass
    if len(first):
        total = np.add.reduceat(mass[order], first)
    return state[order][first], multiple[order][first], total
