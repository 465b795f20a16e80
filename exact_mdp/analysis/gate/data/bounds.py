"""Regret bounded for every model that the records allow, distribution-free.

The sets of `analysis.gate.data.sets` hold all rows at once with the stated confidence, and so do
bounds that hold for every model P within them. Values come from four robust solves (Iyengar,
Mathematics of Operations Research 30, 2005; Nilim and El Ghaoui, Operations Research 53, 2005):

    L^π ≤ V^π ≤ U^π,      L* ≤ V* ≤ U*,      hence  V* - V^π ≤ U* - L^π.

That difference lets nature choose one model for the optimum and another for the policy. Under one
and the same P, the regret D = V* - V^π is the optimum of a model whose rewards are the advantages
of the policy's own values (the performance difference lemma: Kakade and Langford, ICML 2002):

    D(s) = max over pairs l of s of  A_P(l) + γ P_l D,      A_P(l) = Q^π(l) - V^π(s).

An action that the policy takes for certain has advantage 0 in every model, so that what is unsure
about both sides cancels. With c between U^π and L^π, h half their distance and π(l) the policy's
probability of l,

    A_P(l) = (1 - π(l)) (r_l + γ P_l c) - Σ_{k ≠ l} π(k) (r_k + γ P_k c) + γ (P_l - P_π) (V^π - c),

and the last term is at most γ Σ |P_l - P_π| h: h at the shares that were seen, and what a row may
move by (Pinsker: Σ |q - p| ≤ √(2 KL)) times the largest h. With the first terms each at its worst,
this bounds D by dynamic programming from above, and from below likewise; in every state the better
of this bound and that by two separate models is taken.

States in which episodes were cut off, and which no record leaves, may be worth whatever rewards
allow, to the optimum and to the policy, so that they may cost the whole range.

Every bound is that of a monotone operator T, a contraction where γ < 1: T v ≤ v + e gives
v + e / (1 - γ) as an upper bound, whatever v is, and policy iteration finds a good v. At discount 1
T is applied to a range that the user states, and keeps it valid however often. Ends are worth 0 at
any discount, so that the range shrinks in every state by the chance to get there; it stays for ever
only where episodes were cut off, and where the sets allow that an episode never ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from exact_mdp.analysis.gate.data.interval import Ends
from exact_mdp.analysis.gate.data.sets import Rows, RowSets
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.bounds.gains import SLACK, UNIT
from exact_mdp.solvers.bounds.linear import LinearSystem

IMPROVEMENTS = 50
SWEEPS = 1000
SMALL = 1e-10  # of the range: steps not worth another one; bounds hold wherever the search ends


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """An operator at some values: a bound of what it gives (S,), and its linear piece there."""

    bound: Floats
    piece: Callable[[], tuple[sp.csr_array, Floats]]


@dataclass(frozen=True, kw_only=True, eq=False)
class RobustBounds:
    """Values and regret of a policy for every model within sets of rows.

    Attributes
    ----------
    sets : RowSets
    own : (L,)
        The policy's probabilities of pairs.
    returns : (float, float), optional
        Where total rewards lie.
    """

    sets: RowSets
    own: Floats
    returns: Ends | None = None

    @property
    def mdp(self) -> MDP:
        """The model of rewards."""
        return self.sets.mdp

    @cached_property
    def range(self) -> Ends:
        """Where the values of all states lie."""
        rate = self.mdp.discount_exact
        if self.returns is not None:
            return self.returns
        if rate == 1:
            raise ModelError(
                "at discount 1 the records alone do not say how long an episode may go on",
                where="returns",
                fix="state where total rewards lie: returns=(low, high), --returns LOW,HIGH; or "
                "choose a discount below 1",
            )
        certain = self.mdp.reward[self.sets.counted == 0]
        least = min(0.0, self.sets.rewards[0], *certain) / float(1 - rate)
        most = max(0.0, self.sets.rewards[1], *certain) / float(1 - rate)
        return least * SLACK, most * SLACK

    @cached_property
    def over(self) -> Flags:
        """(S,) ends, worth 0 in every model of the sets: no row counted, nobody cut off."""
        counted = self.sets.counted > 0
        left = np.logical_or.reduceat(counted, self.mdp.pair_offsets[:-1])
        found: Flags = self.mdp.terminal & ~left & ~self.sets.unknown
        return found

    @cached_property
    def own_low(self) -> Floats:
        """(S,) lower bounds of V^π."""
        return self._settled(self.under_policy(False), 0)

    @cached_property
    def own_high(self) -> Floats:
        """(S,) upper bounds of V^π."""
        return self._settled(self.under_policy(True), 1)

    @cached_property
    def best_low(self) -> Floats:
        """(S,) lower bounds of V*."""
        return self._settled(self.optimum(False), 0)

    @cached_property
    def best_high(self) -> Floats:
        """(S,) upper bounds of V*."""
        return self._settled(self.optimum(True), 1)

    def at_start(self, mdp: MDP, whose: str) -> Ends:
        """Return the bounds of a value at the start, in the sense of the model given."""
        best = whose == "best"
        low = self.sets.at_start(self.best_low if best else self.own_low, most=False)
        high = self.sets.at_start(self.best_high if best else self.own_high, most=True)
        return (low, high) if mdp.sense == "max" else (-high, -low)

    @property
    def regret(self) -> Ends:
        """Bounds of the regret at the start."""
        low = max(self.sets.at_start(self.least_regret, most=False), 0.0)
        return low, self.sets.at_start(self.most_regret, most=True)

    @cached_property
    def most_regret(self) -> Floats:
        """(S,) upper bounds of V* - V^π."""
        apart = np.maximum(self.best_high - self.own_low, 0.0)
        return self._settled(self._joint(True), 1, apart)

    @cached_property
    def least_regret(self) -> Floats:
        """(S,) lower bounds of V* - V^π."""
        apart = np.maximum(self.best_low - self.own_high, 0.0)
        return self._settled(self._joint(False), 0, apart)

    # ---- operators -------------------------------------------------------------------------------

    def _unknown(self, step: Callable[[Floats], Step], worth: float) -> Callable[[Floats], Step]:
        """Return an operator that takes states of which nobody knows what follows for `worth`."""
        unknown = self.sets.unknown
        if not unknown.any():
            return step

        def told(value: Floats) -> Step:
            found = step(value)

            def piece() -> tuple[sp.csr_array, Floats]:
                laws, constant = found.piece()
                kept = laws.multiply((~unknown).astype(np.float64).reshape(-1, 1))
                return sp.csr_array(kept), np.where(unknown, worth, constant)

            return Step(bound=np.where(unknown, worth, found.bound), piece=piece)

        return told

    def under_policy(self, most: bool) -> Callable[[Floats], Step]:
        """Return the operator of V^π."""
        mixing = self._mixing

        def step(value: Floats) -> Step:
            rows = self.sets.worth(value, most=most)

            def piece() -> tuple[sp.csr_array, Floats]:
                laws, reward = rows.chosen
                return sp.csr_array(mixing @ laws), np.asarray(mixing @ reward)

            return Step(bound=mixing @ rows.bound, piece=piece)

        return self._unknown(step, self.range[most])

    def optimum(self, most: bool) -> Callable[[Floats], Step]:
        """Return the operator of V*."""

        def step(value: Floats) -> Step:
            rows = self.sets.worth(value, most=most)
            taken = self._best(rows.bound)

            def piece() -> tuple[sp.csr_array, Floats]:
                laws, reward = rows.chosen
                return laws[taken], reward[taken]

            return Step(bound=rows.bound[taken], piece=piece)

        return self._unknown(step, self.range[most])

    def _joint(self, most: bool) -> Callable[[Floats], Step]:
        if most:
            return self.gaining(True, self.best_high, self.own_low)
        return self.gaining(False, self.best_low, self.own_high)

    def gaining(self, most: bool, best: Floats, own: Floats) -> Callable[[Floats], Step]:
        """Return the operator of D: no action gains more than with a model for each side.

        `best` (S,) bounds the V* that follows, and `own` (S,), from the other side, V^π here.
        """
        apart = self.sets.worth(best, most=most).bound - own[self.mdp.pair_state]
        advantage = self._advantages[most]
        choose = np.minimum if most else np.maximum

        def step(value: Floats) -> Step:
            rows: Rows = self.sets.worth(value, most=most, rewards=False)
            joint = advantage + rows.bound
            bound = choose(joint, apart)
            taken = self._best(bound)

            def piece() -> tuple[sp.csr_array, Floats]:
                laws, _ = rows.chosen
                alone = (joint == bound)[taken].astype(np.float64)
                constant = np.where(alone, advantage[taken], apart[taken])
                return sp.csr_array(laws[taken].multiply(alone.reshape(-1, 1))), constant

            return Step(bound=bound[taken], piece=piece)

        return self._unknown(step, self.range[1] - self.range[0] if most else 0.0)

    @cached_property
    def _advantages(self) -> tuple[Floats, Floats]:
        """(L,) and (L,) bounds of A_P(l) in every model P of the sets."""
        mdp, own, mixing, rate = self.mdp, self.own, self._mixing, self.mdp.discount
        low, high = self.own_low, self.own_high
        middle = (low + high) / 2
        half = np.maximum(high - middle, middle - low)
        least = self.sets.worth(middle, most=False).bound
        most = self.sets.worth(middle, most=True).bound
        moved = np.minimum(np.sqrt(2 * self.sets.radius) * SLACK, 2.0) * float(half.max())
        state = mdp.pair_state
        apart = abs(mdp.transition - (mixing @ mdp.transition)[state]) @ half
        others = (mixing @ moved)[state] - own * moved
        coupled = rate * (apart + (1 - own) * moved + others) * SLACK
        size = np.maximum(np.abs(least), np.abs(most))
        doubt = 8 * UNIT * (mdp.n_actions + 4) * ((mixing @ size)[state] + size)
        found = []
        for mine, theirs, sign in ((least, most, -1), (most, least, 1)):
            rest = (mixing @ theirs)[state] - own * theirs
            free = (1 - own) * mine - rest + sign * (coupled + doubt)
            found.append(np.where(own == 1, 0.0, free))
        return found[0], found[1]

    @cached_property
    def _mixing(self) -> sp.csr_array:
        """(S, L) the policy."""
        mdp = self.mdp
        return sp.csr_array((self.own, np.arange(mdp.n_pairs), mdp.pair_offsets))

    def _best(self, worth: Floats) -> Integers:
        """Return (S,) the best pair of each state."""
        first, state = self.mdp.pair_offsets[:-1], self.mdp.pair_state
        best = np.maximum.reduceat(worth, first)
        number = np.where(worth == best[state], np.arange(len(worth)), len(worth))
        return np.minimum.reduceat(number, first)

    # ---- fixed points ----------------------------------------------------------------------------

    def _settled(
        self, step: Callable[[Floats], Step], side: int, first: Floats | None = None
    ) -> Floats:
        """Return (S,) bounds of an operator's fixed point: from below at side 0, above at 1.

        `first` (S,) are such bounds, unless given the ends of the range, and 0 where all is over.
        """
        sign, take = (1, np.minimum) if side else (-1, np.maximum)
        known = np.where(self.over, 0.0, self.range[side]) if first is None else first
        rate, left = self.mdp.discount, float(1 - self.mdp.discount_exact)
        scale = SMALL * (self.range[1] - self.range[0])
        if not left:
            for _ in range(SWEEPS):
                value = take(known, step(known).bound)
                if np.abs(value - known).max() <= scale:
                    break
                known = value
            return value
        value = known
        for _ in range(IMPROVEMENTS):
            found = step(value)
            over = max(float((sign * (found.bound - value)).max()), 0.0) / left * SLACK
            known = take(known, value + sign * (over + 4 * UNIT * (np.abs(value) + over)))
            chain, constant = found.piece()
            target = LinearSystem(chain, rate).approximate(constant)
            if np.abs(target - value).max() <= scale:
                break
            value = target
        return np.asarray(known)
