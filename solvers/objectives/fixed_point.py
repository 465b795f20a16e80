"""The totals of a policy in fixed point, and the signs of what pairs lose: no long fraction.

The values V of a policy are known as integers n over 2^b. What n leaves of its equations,

    r(s) = amount(l) 2^b + Σ_i weight(i) n(next(i)) - scale(s) n(s),     l the pair taken in s,

is exact. With w > 0 and the margin m(s) = scale(s) w(s) - Σ_i weight(i) w(next(i)) > 0 for all
pairs, V is off by ρ w / 2^b at most, ρ = max |r| / m; w = 1 does where the discount is below 1.
(-ρ w and ρ w bound the error from below and above, as the equations are monotone: Collatz, Archive
for Rational Mechanics and Analysis 3, 1952.) So what a pair loses against the policy,

    loss(l) 2^b = scale(s) n(s) - amount(l) 2^b - Σ_i weight(i) n(next(i))
                  ± ρ (scale(s) w(s) + Σ_i weight(i) w(next(i))),

has a sign that is proven, or one that more bits will tell. A pair that moves as the one taken does
loses what it earns less: that is known exactly. Floats propose n: each round of corrections with
one factored matrix gains some forty bits. A policy that differs in one pair needs no new one
(Sherman and Morrison, Annals of Mathematical Statistics 21, 1950).

Nothing here imports a solver.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.exact import row_sums
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.table import Floats, Integers, Numbers, spans
from exact_mdp.solvers.objectives.amounts import Objectives

linalg = later("scipy.sparse.linalg")
sparse = later("scipy.sparse")

BITS = (96, 384, 1536)  # tried one after the other
SWITCHES = 40  # that one factored matrix serves
UNKNOWN = 2  # a sign
MOST = 900  # bits that fit in a float

Signs = NDArray[np.int8]


class FixedPoint:
    """A policy, one pair (S,) of each state, with its values of every objective.

    `weight` (S,) are integers w, of which the margins have to be positive; see `margins`.
    """

    def __init__(self, of: Objectives, weight: Numbers, pairs: Integers) -> None:
        self.of, self.pairs, self.level = of, pairs.copy(), 0
        rows, state = of.rows, of.mdp.pair_state
        self.live = np.flatnonzero(~rows.terminal)
        self.open = ~rows.terminal[state]
        self.weight = np.where(rows.terminal, 0, weight.astype(object))
        self.margin = margins(of, self.weight)
        self.spread = 2 * rows.scale[state] * self.weight[state] - self.margin
        parts = -(-self.spread[self.open] // self.margin[self.open])
        self.fewest = max(map(int, parts), default=0)
        self.moves = _moves(of)
        self.entry, self.scale = rows.weight.astype(object), rows.scale.astype(object)
        self.top = [np.zeros(of.mdp.n_states, dtype=object) for _ in of.amounts]
        self.rho: list[int]
        self.lost: list[Numbers] | None = None
        self._factor()
        self._settle()

    @property
    def bits(self) -> int:
        """The number of bits b after the point."""
        return BITS[self.level]

    def switch(self, pair: int) -> None:
        """Take another pair of a state."""
        state = int(self.of.mdp.pair_state[pair])
        moves, _ = self.of.in_floats
        change = moves[[self.pairs[state]]] - moves[[pair]]
        unit = np.zeros(len(self.pairs))
        unit[state] = 1.0
        column = self._solve(unit)
        growth = 1 + change.data @ column[change.indices]
        self.switched.append((column / growth, change.indices, change.data))
        self.pairs[state] = pair
        if len(self.switched) > SWITCHES or not np.isfinite(growth) or growth <= 0:
            self._factor()
        self._at(0)

    def sharpen(self) -> bool:
        """Take more bits; False where there are no more."""
        if self.level + 1 == len(BITS):
            return False
        self._at(self.level + 1)
        return True

    def losses(self, pairs: slice | list[int] = slice(None)) -> list[Numbers]:
        """Return what some pairs lose of each objective, times scale and 2^b."""
        if self.lost is None:
            self.lost = [self._lost(*each) for each in zip(self.of.amounts, self.top, strict=True)]
        return [loss[pairs] for loss in self.lost]

    def signs(self, shares: Sequence[int], pairs: slice | list[int] = slice(None)) -> Signs:
        """Return the signs of what some pairs lose of a sum with these shares of at least 0.

        Those of the pairs taken, and of ends, are 0; it is UNKNOWN where more bits have to tell.
        """
        each = zip(shares, self.losses(pairs), strict=True)
        total = sum((share * loss for share, loss in each if share), np.zeros(1, dtype=object))
        most = sum(share * rho for share, rho in zip(shares, self.rho, strict=True))
        known = self.known[pairs]
        error = np.where(known, 0, most * self.spread[pairs])
        up, down = total > error, total < -error
        return np.where(up, 1, np.where(down, -1, np.where(known, 0, UNKNOWN))).astype(np.int8)

    def totals(self) -> list[tuple[Fraction, Fraction]]:
        """Return bounds on the totals at the start."""
        of, unit = self.of, 1 << self.bits
        width = of.at_start(self.weight.tolist(), unit)
        middle = [of.at_start(top.tolist(), unit) for top in self.top]
        return [(v - rho * width, v + rho * width) for v, rho in zip(middle, self.rho, strict=True)]

    def _lost(self, amount: Numbers, top: Numbers) -> Numbers:
        """Return what each pair (L,) loses of one objective."""
        rows, state, own = self.of.rows, self.of.mdp.pair_state, amount.astype(object)
        after = row_sums(self.entry * top[rows.next], rows.offsets)
        loss = self.scale[state] * top[state] - (own << self.bits) - after
        exact = (own[self.pairs[state]] - own) << self.bits
        return np.where(self.known, np.where(self.open, exact, 0), loss)

    def _at(self, level: int) -> None:
        by, self.level = BITS[level] - self.bits, level
        self.top = [top << by if by >= 0 else top >> -by for top in self.top]
        self._settle()

    def _settle(self) -> None:
        """Correct the values until no correction helps, and bound what is left."""
        self.rho, self.lost = [0 for _ in self.top], None
        self.known = ~self.open | (self.moves == self.moves[self.pairs[self.of.mdp.pair_state]])
        if not len(self.live):
            return
        rows = self.of.rows
        taken = self.pairs[self.live]
        first, last = rows.offsets[taken], rows.offsets[taken + 1]
        entries, begins = spans(first, last), np.concatenate([[0], np.cumsum(last - first)])
        weight, ahead = self.entry[entries], rows.next[entries]
        scale, margin = self.scale[self.live], self.margin[taken]
        for k, amount in enumerate(self.of.amounts):
            earned, top, best = amount[taken].astype(object) << self.bits, self.top[k], None
            while True:
                rest = earned + row_sums(weight * top[ahead], begins) - scale * top[self.live]
                rho = max(int(x) for x in -(-np.abs(rest) // margin))
                if best is not None and 2 * rho > best[0]:
                    rho, top = min((rho, top), best, key=lambda each: each[0])
                    break
                best = rho, top
                if rho <= self.fewest:
                    break
                top = top + self._correction(rest)
            self.top[k], self.rho[k] = top, rho

    def _correction(self, rest: Numbers) -> Numbers:
        """Return integers (S,) that solve the equations for what is left, about."""
        spare = max(0, max(int(x).bit_length() for x in rest) - MOST)
        right = np.zeros(len(self.pairs))
        right[self.live] = (rest >> spare).astype(np.float64) / self.scale[self.live].astype(float)
        found = self._solve(right)
        found[~np.isfinite(found)] = 0
        return np.array([int(x) << spare for x in np.rint(found)], dtype=object)

    def _factor(self) -> None:
        moves, _ = self.of.in_floats
        stay = sparse.eye_array(len(self.pairs), format="csc")
        self.factors = linalg.splu((stay - moves[self.pairs]).tocsc())
        self.switched: list[tuple[Floats, Integers, Floats]] = []

    def _solve(self, right: Floats) -> Floats:
        found: Floats = self.factors.solve(right)
        for column, index, change in self.switched:
            found = found - column * (change @ found[index])
        return found


def margins(of: Objectives, weight: Numbers) -> Numbers:
    """Return (L,) scale w - Σ weight w(next): where all are positive, w bounds every error."""
    rows = of.rows
    after = row_sums(rows.weight.astype(object) * weight[rows.next], rows.offsets)
    return np.asarray(
        rows.scale[of.mdp.pair_state].astype(object) * weight[of.mdp.pair_state] - after
    )


def bounds_errors(of: Objectives, weight: Numbers) -> bool:
    """Return whether weights (S,), 0 at ends, bound the errors of all policies."""
    live, state = ~of.rows.terminal, of.mdp.pair_state
    own = np.where(live, weight, 0)
    return bool((own[live] > 0).all() and (margins(of, own)[live[state]] > 0).all())


def _moves(of: Objectives) -> Integers:
    """Return (L,) for each pair the first of its state that leads to the same states alike."""
    rows, found = of.rows, np.arange(of.mdp.n_pairs)
    following, weight, offsets = rows.next.tolist(), rows.weight.tolist(), rows.offsets.tolist()
    seen = dict[object, int]()
    for pair, state in enumerate(of.mdp.pair_state.tolist()):
        here = slice(offsets[pair], offsets[pair + 1])
        found[pair] = seen.setdefault((state, tuple(following[here]), tuple(weight[here])), pair)
    return found
