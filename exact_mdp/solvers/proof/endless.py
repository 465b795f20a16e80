"""Checks total rewards at discount 1 where some policy never ends, finite and infinite ones.

Rows count as divided by their sums. What a policy does for ever is an end component: states that
its pairs connect and never leave. All of it has one order in the rules below, since pairs that may
lead to a lower order do not lead back: states of the lowest order in it use none of these.

Upper sides, for all pairs, with a potential h, or w:

    finite      V(s) ≥ r + P V; and where that is an equation, the pair may lead to a lower order,
                or leads to its own order only and V(s) + w(s) ≥ P w. So n steps earn at most
                V(s) - E V(X_n), and V is 0 or more on average where nothing is lost for ever
    -∞          the pair may lead to a state of -∞ of lower order, or leads to its own order only
                and r + P h < h(s)

Lower sides, for the policy's pairs:

    finite      V(s) = r + P V; the pair may lead to a lower rank, down to rank 0, which it never
                leaves and where V = 0; or else V + w = P w, in classes without a period, so that
                E V(X_n) vanishes
    +∞          it leads to no state of -∞, and may lead to a lower rank among those of +∞, down to
                rank 0, which it never leaves and where r + P h > h(s)

Pairs of other states must not lead to states of +∞, and a finite state's pair that leads to other
than finite states must be one that may lead to -∞. Where +∞ and -∞ come together, the greatest mean
reward g says by its sign which it is: for all pairs g ≥ P g, with equality only if g + x ≥ r + P x
and, in finite states, the pair leads to such states only; equations both for the policy's pairs in
infinite states.

With a goal, a run is worth `unreached` exactly where it never leaves states other than the goal,
and this needs no h. Where that is -∞, rank 0 is the goal, and w is not needed either; a value of +∞
is no policy's, but that of going round as above as often as one likes, and on to the goal for sure.
Where it is +∞, the order has to fall along all pairs of finite states.

Sources: Puterman, Markov Decision Processes, 1994, sections 7.2 and 10.2 (g, V and w are the first
terms of a Laurent series); de Alfaro, Formal Verification of Probabilistic Systems, 1997; for
rewards of one sign, Chatterjee, Quatmann, Schäffeler, Weininger, Winkler and Zilken, Fixed Point
Certificates for Reachability and Expected Rewards in MDPs, TACAS 2025.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import gcd, inf

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from exact_mdp.mdp.chain import strong_components
from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers

Mask = NDArray[np.bool_]
FAR = np.iinfo(np.int64).max


@dataclass(frozen=True, kw_only=True, eq=False)
class EndlessClaims:
    """What shows that values are those of a total reward; see the module.

    Attributes
    ----------
    sign : (S,) int64
        1 where the value is +∞, -1 where it is -∞, else 0.
    rank, order : (S,) int64
    potential : (S,) sequence of Fraction
        h in infinite states, w in finite ones.
    drift : pair of (S,) sequences of Fraction, optional
        g and x, where +∞ and -∞ come together.
    """

    sign: Integers
    rank: Integers
    order: Integers
    potential: Sequence[Fraction]
    drift: tuple[Sequence[Fraction], Sequence[Fraction]] | None = None

    def __post_init__(self) -> None:
        for array in (self.sign, self.rank, self.order):
            array.setflags(write=False)

    def negated(self) -> EndlessClaims:
        """Return the claims about costs: infinite values change their sign, proofs do not."""
        return replace(self, sign=-self.sign)


def malformed(claims: EndlessClaims, states: int) -> list[str]:
    """Return why claims are not of the form that is checked."""
    arrays = {"signs": claims.sign, "ranks": claims.rank, "orders": claims.order}
    wrong = [
        f"its {name} are of type {array.dtype} and shape {array.shape}"
        for name, array in arrays.items()
        if array.dtype.kind != "i" or array.shape != (states,)
    ]
    means, biases = claims.drift or (claims.potential, claims.potential)
    for name, values in (("potentials", claims.potential), ("means", means), ("biases", biases)):
        if len(values) != states or {*map(type, values)} - {Fraction}:
            wrong.append(f"its {name} are not {states} Fractions")
    if not wrong and not set(claims.sign.tolist()) <= {-1, 0, 1}:
        wrong.append("a sign is none of -1, 0 and 1")
    return wrong


def optimal_infinite(claims: EndlessClaims, rows: BellmanRows) -> Mask:
    """Return (L,) the pairs of infinite states that attain their value."""
    sign = claims.sign[rows.pair_state]
    if claims.drift is not None:
        rises = [_ahead(rows, *each, claims.drift[0]) > 0 for each in enumerate(rows.pair_state)]
        return np.asarray((sign < 0) | (sign > 0) & np.array(rises))
    after = claims.sign[rows.next]
    safe = np.minimum.reduceat(after, rows.offsets[:-1]) >= 0
    gains = np.maximum.reduceat(after, rows.offsets[:-1]) > 0
    return np.asarray((sign < 0) | (sign > 0) & safe & gains)


def endless_violations(
    claims: EndlessClaims,
    mdp: MDP,
    rows: BellmanRows,
    pairs: Integers,
    optimal: Mask,
    value: Callable[[int], Fraction],
    value_sign: Integers,
) -> list[str]:
    """Return what does not hold of signs, ranks, orders, potentials and means, in words.

    The equations of finite states, and which of their pairs are `optimal` (L,), are checked
    elsewhere. `pairs` (S,) are the policy's; `value` gives that of a finite state, and `value_sign`
    (S,) its sign.
    """
    return _Check(claims, mdp, rows, pairs, optimal, value, value_sign).wrong()


@dataclass(frozen=True, eq=False)
class _Check:
    claims: EndlessClaims
    mdp: MDP
    rows: BellmanRows
    pairs: Integers
    optimal: Mask
    value: Callable[[int], Fraction]
    value_sign: Integers

    def wrong(self) -> list[str]:
        claims, rows, mdp = self.claims, self.rows, self.mdp
        sign, state, first = claims.sign, rows.pair_state, rows.offsets[:-1]
        after, own, goal = sign[rows.next], sign[rows.pair_state], mdp.goal
        missing = 0.0 if goal is None else mdp.unreached
        wrong: list[str] = []
        if goal is not None and (
            claims.drift
            or sign[goal].any()
            or (missing > 0 and (sign < 0).any())
            or (missing == 0 and (sign > 0).any())
        ):
            wrong.append("a goal leaves no room for such an infinite value")
        least, most = np.minimum.reduceat(after, first), np.maximum.reduceat(after, first)
        leaving = (own == 0) & ((least != 0) | (most != 0))
        unsafe = leaving & (least >= 0)
        if missing != -inf:  # otherwise a run that may miss the goal is worth -∞ all the same
            unsafe |= (own < 1) & (most > 0)
        if claims.drift is None and unsafe.any():
            wrong.append("a pair leads to +∞ from a state that is not worth it")
        if goal is not None and missing == -inf and ((sign > 0) & ~self._arriving(goal)).any():
            wrong.append("nothing shows that the goal is reached from a state of +∞")
        # Where the order may fall among states of the same sign, and where it stays for sure.
        order = np.where(after == own[rows.pair], claims.order[rows.next], FAR)
        low, high = np.minimum.reduceat(order, first), np.maximum.reduceat(order, first)
        falls, level = low < claims.order[state], (low == high) & (low == claims.order[state])
        over = mdp.terminal if goal is None else goal
        finite = (own == 0) & ~leaving & ~over[state] & (missing != -inf)
        open_ = finite & ~falls & (self.optimal | (missing == inf))
        held = self._held(open_ & level) if missing == 0 else ~open_
        wrong += self._named(open_ & ~held, "nothing shows that the value cannot be more")
        if claims.drift is not None:
            wrong += self._drift(leaving, *claims.drift)
        else:
            open_ = (own < 0) & ~falls
            lost = level if goal is not None else level & self._sloping(open_ & level, -1)
            wrong += self._named(open_ & ~lost, "nothing shows that the value is -∞")
        return wrong + self._lower(missing)

    def _lower(self, missing: float) -> list[str]:
        """Check what the policy attains."""
        claims, rows, pairs = self.claims, self.rows, self.pairs
        sign, rank, part = claims.sign, claims.rank, rows.of_pairs(self.pairs)
        first, owner = part.offsets[:-1], np.repeat(sign, np.diff(part.offsets))
        after, alike = sign[part.next], sign[part.next] == owner
        ahead = np.where(alike, rank[part.next], FAR)
        falls = np.minimum.reduceat(ahead, first) < rank
        stays = (rank == 0) & (np.maximum.reduceat(ahead, first) == 0)
        nothing = self._vanishing(part, stays & (sign == 0))
        if missing == -inf and self.mdp.goal is not None:
            nothing &= self.mdp.goal
        rising = np.ones(len(sign), dtype=bool)
        if missing < inf:
            asked = np.zeros(len(rows.constant), dtype=bool)
            asked[pairs] = stays & (sign > 0)
            rising = self._sloping(asked, 1)[pairs]
        ends = stays & np.where(sign == 0, nothing, rising)
        safe = (sign < 1) | (np.minimum.reduceat(after, first) >= 0)
        holds = safe & (rank >= 0) & np.where(rank > 0, falls, ends)
        shown = sign == 0 if claims.drift is not None else sign >= 0
        return [
            f"nothing shows that the policy attains the value of state {state}"
            for state in np.flatnonzero(shown & ~holds).tolist()
        ]

    def _arriving(self, goal: Mask) -> Mask:
        """Return (S,) True where some policy reaches the goal with probability 1.

        The greatest set in which the goal can be reached along pairs that do not leave the set.
        """
        rows, found = self.rows, np.ones(len(goal), dtype=bool)
        first = rows.offsets[:-1]
        while True:
            inside = np.logical_and.reduceat(found[rows.next], first)
            near, size = goal.copy(), -1
            while size != (size := int(near.sum())):
                some = inside & np.logical_or.reduceat(near[rows.next], first)
                near[rows.pair_state[some]] = True
            if (near == found).all():
                return found
            found = near

    def _vanishing(self, part: BellmanRows, resting: Mask) -> Mask:
        """Return (S,) True for states of rank 0, never left, where E V(X_n) vanishes."""
        found = resting.copy()
        while (left := found & ~np.logical_and.reduceat(found[part.next], part.offsets[:-1])).any():
            found &= ~left
        resting = found.copy()
        if not self.value_sign[resting].any():
            return found
        states = np.flatnonzero(resting)
        value = {state: self.value(state) for state in states.tolist()}
        rows = [slice(*part.offsets[s : s + 2]) for s in states.tolist()]
        following = [np.searchsorted(states, part.next[row]).tolist() for row in rows]
        for group in _apart(following):
            own = states[sorted(group)].tolist()
            if any(value[state] for state in own):
                potential = self.claims.potential
                steady = all(
                    value[s] + potential[s] == _ahead(part, s, s, potential) for s in own
                ) and aperiodic([following[i] for i in group], list(group))
                found[own] = steady
        return found

    def _named(self, bad: Mask, what: str) -> list[str]:
        return [
            f"{what} in state {state}" for state in np.unique(self.rows.pair_state[bad]).tolist()
        ]

    def _drift(
        self, leaving: Mask, mean: Sequence[Fraction], bias: Sequence[Fraction]
    ) -> list[str]:
        """Check which means are the greatest, and that the policy has them in infinite states."""
        rows, taken = self.rows, {*self.pairs[self.claims.sign != 0].tolist()}
        wrong = [
            f"the sign of state {state} is not that of its mean"
            for state, (g, sign) in enumerate(zip(mean, self.claims.sign.tolist(), strict=True))
            if (g > 0) - (g < 0) != sign
        ]
        for pair, state in enumerate(rows.pair_state.tolist()):
            less = mean[state] - _ahead(rows, pair, state, mean)
            earned = Fraction(int(rows.constant[pair]), int(rows.scale[state]))
            short = mean[state] + bias[state] - earned - _ahead(rows, pair, state, bias)
            if less < 0 or (less == 0 and (short < 0 or leaving[pair])):
                wrong.append(f"the mean of state {state} is less than can be had")
            if pair in taken and (less or short):
                wrong.append(f"the policy does not have the mean of state {state}")
        return wrong

    def _held(self, some: Mask) -> Mask:
        """Return (L,) True for those of `some` pairs where V + w ≥ P w."""
        potential, rows = self.claims.potential, self.rows
        zero = next((each for each in potential if not each), None)  # often one object for all
        flat = np.array([each is zero or not each for each in potential])
        plain = some & flat[rows.pair_state]
        plain &= np.logical_and.reduceat(flat[rows.next], rows.offsets[:-1])
        found: Mask = plain & (self.value_sign >= 0)[rows.pair_state]
        for pair, state in _listed(some & ~plain, rows):
            ahead = _ahead(rows, pair, state, potential)
            found[pair] = self.value(state) + potential[state] >= ahead
        return found

    def _sloping(self, some: Mask, way: int) -> Mask:
        """Return (L,) True for those of `some` pairs where r + P h - h is above 0 (1) or below."""
        rows, potential = self.rows, self.claims.potential
        found = np.zeros(len(some), dtype=bool)
        for pair, state in _listed(some, rows):
            earned = Fraction(int(rows.constant[pair]), int(rows.scale[state]))
            ahead = _ahead(rows, pair, state, potential)
            found[pair] = way * (earned + ahead - potential[state]) > 0
        return found


def _listed(some: Mask, rows: BellmanRows) -> Iterator[tuple[int, int]]:
    """Return some pairs (L,), each with its state."""
    pairs = np.flatnonzero(some)
    return zip(pairs.tolist(), rows.pair_state[pairs].tolist(), strict=True)


def _apart(following: Sequence[Sequence[int]]) -> list[list[int]]:
    """Return the parts of a graph that are not connected, from each node's successors."""
    count = len(following)
    ends = [(i, j) for i, after in enumerate(following) for j in after]
    graph = sp.csr_array((np.ones(len(ends)), tuple(np.transpose(ends))), (count, count))
    label = strong_components(sp.csr_array(graph + graph.T))
    return [np.flatnonzero(label == part).tolist() for part in range(int(label.max()) + 1)]


def aperiodic(following: Sequence[Sequence[int]], states: Sequence[int]) -> bool:
    """Return whether no recurrent class of a closed chain has a period, from states' successors.

    In a class, the lengths of all ways from one state to another are the same modulo its period.

    Examples
    --------
    >>> aperiodic([[1], [0]], [0, 1]), aperiodic([[1], [0, 1]], [0, 1])
    (False, True)
    """
    after = dict(zip(states, following, strict=True))
    for root in states:
        depth, frontier = {root: 0}, [root]
        for state in frontier:
            for to in after[state]:
                if to not in depth:
                    depth[to] = depth[state] + 1
                    frontier.append(to)
        back = {root}
        while more := {s for s in depth if s not in back and not back.isdisjoint(after[s])}:
            back |= more
        if len(back) < len(depth):
            continue  # transient
        if gcd(*(depth[s] + 1 - depth[t] for s in depth for t in after[s])) != 1:
            return False
    return True


def _ahead(rows: BellmanRows, pair: int, state: int, values: Sequence[Fraction]) -> Fraction:
    """Return Σ P(s') x(s') of a pair of a state."""
    here = slice(int(rows.offsets[pair]), int(rows.offsets[pair + 1]))
    terms = zip(rows.weight[here].tolist(), rows.next[here].tolist(), strict=True)
    return sum((w * values[s] for w, s in terms if values[s]), Fraction(0)) / int(rows.scale[state])
