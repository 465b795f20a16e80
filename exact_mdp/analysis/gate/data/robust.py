"""Regret bounded for every model that the records allow, distribution-free.

The sets of `analysis.gate.data.sets` hold all rows at once with the stated confidence, and so do
bounds for every model P within them (robust solves: Iyengar, Mathematics of Operations Research 30,
2005): L^π ≤ V^π ≤ U^π and L* ≤ V* ≤ U*, hence V* - V^π ≤ U* - L^π. That lets nature choose two
models. Under one P the regret D is the optimum of a model of advantages (Kakade and Langford, ICML
2002): D(s) = max over pairs l of s of A_P(l) + γ P_l D, A_P(l) = Q^π(l) - V^π(s). With c between
L^π and U^π, h half their distance and π(l) the probability of l,

    A_P(l) = (1 - π(l)) (r_l + γ P_l c) - Σ_{k ≠ l} π(k) (r_k + γ P_k c) + γ (P_l - P_π) (V^π - c),

its last term at most γ Σ |P_l - P_π| h: h at the shares seen, and the largest h times what a row
may move by, √(2 KL) (Pinsker). Every bound is that of a monotone operator T: v + e / (1 - γ) is one
from above if T v ≤ v + e. At discount 1 T keeps a range that the user states valid however often.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
import tqdm

from exact_mdp.analysis.gate.data.interval import (
    Ends,
    RegretInterval,
    cut_off,
    find_recorded_ends,
    format_states,
    observations_of,
    of_process,
    of_sense,
    parse_range,
)
from exact_mdp.analysis.gate.data.sets import Given, RowSets, Step
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import SLACK, UNIT, first_of
from exact_mdp.solvers.bounds.linear import LinearSystem
from exact_mdp.solvers.solution import Claim

# Bounds hold wherever the search ends, and are wider where it ends early.
IMPROVEMENTS, SWEEPS = 50, 1000  # below discount 1, and at it
SMALL = 1e-10  # of the range: steps not worth another one
Sides = Floats  # (2, S) bounds from below and from above


@dataclass(frozen=True, kw_only=True)
class Robust:
    """An interval that assumes no distribution: it holds for every model that fits the records.

    Attributes
    ----------
    rewards : "known", or (low, high)
        Rewards that state, action and next state decide, and which are as seen; or a range in which
        rewards lie. It has to be stated: those that were seen do not prove that no other comes.
    returns : (low, high), optional
        Where the total reward from any state lies; needed at discount 1.

    Examples
    --------
    >>> import pandas as pd
    >>> from exact_mdp import check
    >>> names = ["episode", "state", "action", "reward", "next_state"]
    >>> rows = [(n, "ill", "wait", 0, None) for n in range(60)]
    >>> rows += [(n + 60, "ill", "treat", 1, None) for n in range(60)]
    >>> mdp = MDP.from_transitions(pd.DataFrame(rows, columns=names), discount="1/2")
    >>> print(check(mdp, "always:treat", confidence=0.95, by=Robust(rewards="known")).interval)
    [0, 0] at 95 % confidence, robust
    """

    rewards: Given = None
    returns: Ends | None = None
    by: ClassVar[str] = "robust"

    def interval(self, mdp: MDP, own: Floats, confidence: Fraction) -> RegretInterval:
        """Return the interval; raises ModelError without counts or a range that is needed."""
        bounds = self.bounds(mdp, own, float(1 - confidence))
        low, high = bounds.regret
        return RegretInterval(
            low=low,
            high=high,
            confidence=float(confidence),
            by=self.by,
            assumptions=self.assumptions(mdp, bounds.sets),
            found={
                "optimal_value": bounds.at_start(mdp, bounds.best),
                "learned_value": bounds.at_start(mdp, bounds.own),
            },
            claim=Claim.BOUNDED,
        )

    def bounds(self, mdp: MDP, own: Floats, doubt: float) -> RobustBounds:
        """Return the bounds within sets of rows that some are outside of with this probability."""
        sets, returns = RowSets.of(mdp, doubt, self.rewards), parse_range(self.returns, "returns")
        if returns is None:
            return robust_bounds(sets, own)
        if own.ndim > 1:
            what = "with a horizon rewards bound what totals can be"
            fix = "leave it out (--evidence returns=, returns=)"
            raise ModelError(what, where="returns", fix=fix)
        _require_seen(mdp, returns)
        return robust_bounds(sets, own, of_sense(mdp, returns))

    def assumptions(self, mdp: MDP, sets: RowSets) -> tuple[str, ...]:
        """Return what the sets rest on besides the records."""
        low, high = of_sense(mdp, sets.rewards)
        said = list(of_process(mdp))
        if sets.known:
            said.append(
                "rewards are those seen for state, action and next state; where a next state was "
                f"never seen they lie from {low:g} to {high:g}, as all that were seen"
            )
        else:
            said.append(f"rewards lie from {low:g} to {high:g}, as stated")
        if self.returns is not None:
            said.append(f"total rewards lie from {self.returns[0]} to {self.returns[1]}, as stated")
        if sets.unknown.any():
            said.append(
                "what follows where episodes were cut off and no record leaves, "
                f"{format_states(mdp, sets.unknown)}, is worth whatever rewards allow"
            )
        if (sets.counted[~mdp.terminal[mdp.pair_state]] == 0).any():
            said.append("actions that nobody took are worth what the model says")
        return tuple(said)


def _require_seen(mdp: MDP, returns: Ends) -> None:
    """Raise ModelError where a recorded transition cannot have a total in the range stated."""
    table = mdp.table
    seen, ended = observations_of(mdp)[table.pair] > 0, mdp.terminal & ~cut_off(mdp)
    gain, after = table.compute_gains(), np.where(ended[table.next], 0.0, mdp.discount)
    low, high = (gain + after * end for end in returns)
    outside = seen & ((low > returns[1]) | (high < returns[0]))
    if outside.any():
        first = int(outside.argmax())
        raise ModelError(
            f"a reward of {gain[first]:g} was seen, after which no total lies from "
            f"{returns[0]:g} to {returns[1]:g}",
            where=mdp.where(int(table.pair[first])),
            fix="state a range that holds all totals: returns=(low, high), "
            "--evidence returns=LOW,HIGH",
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class RobustBounds:
    """Values and regret of a policy, from below and above, for every model within sets of rows."""

    sets: RowSets
    range: Ends  # where the values of all states lie
    own: Sides  # of V^π
    best: Sides  # of V*
    lost: Sides  # of V* - V^π

    def at_start(self, mdp: MDP, whose: Sides) -> Ends:
        """Return the bounds of a value at the start, in the sense of the model given."""
        low, high = (self.sets.at_start(whose[most], most=bool(most)) for most in (0, 1))
        return of_sense(mdp, (low, high))

    @property
    def regret(self) -> Ends:
        """Bounds of the regret at the start."""
        low, high = self.at_start(self.sets.mdp, self.lost)
        return max(low, 0.0), high


def robust_bounds(sets: RowSets, own: Floats, returns: Ends | None = None) -> RobustBounds:
    """Return the bounds for a policy (L,), with total rewards within `returns`.

    With a policy (N, L) by time, of episodes of N steps; nature may choose other rows at each time.
    """
    if own.ndim == 1:
        ends = _bound_totals(sets) if returns is None else returns
        return Operators(sets=sets, own=own, ends=ends).bound_values()
    none = np.zeros((2, sets.mdp.n_states))
    bounds = RobustBounds(sets=sets, range=(0.0, 0.0), own=none, best=none, lost=none)
    for steps in tqdm.trange(1, len(own) + 1, desc="stages", disable=None, delay=2):
        at = Operators(sets=sets, own=own[-steps], ends=_bound_totals(sets, steps))
        bounds = at.bound_values(bounds)
    return bounds


def _bound_totals(sets: RowSets, steps: int | None = None) -> Ends:
    """Return where the total of some steps lies, or of all, in every model of the sets."""
    (low, high), rest = sets.of_a_step, 1 - sets.mdp.discount_exact
    if steps is None and not rest:
        raise ModelError(
            "at discount 1 the records alone do not say how long an episode may go on",
            where="returns",
            fix="state where total rewards lie: returns=(low, high), --evidence "
            "returns=LOW,HIGH; or choose a discount below 1",
        )
    if steps is None:
        return low / float(rest) * SLACK, high / float(rest) * SLACK
    weight = float(np.cumsum(sets.mdp.discount ** np.arange(steps))[-1]) * SLACK
    return low * weight * SLACK, high * weight * SLACK


@dataclass(frozen=True, kw_only=True, eq=False)
class Operators:
    """The operators of V^π, V* and D."""

    sets: RowSets
    own: Floats  # (L,) the policy's probabilities of pairs
    ends: Ends  # what a state may be worth of which nobody knows what follows

    @cached_property
    def mixing(self) -> sp.csr_array:
        """(S, L) the policy."""
        offsets = self.sets.mdp.pair_offsets
        return sp.csr_array((self.own, np.arange(len(self.own)), offsets))

    def bound_values(self, later: RobustBounds | None = None) -> RobustBounds:
        """Return the bounds before a step that `later` follows; unless given, it comes for ever."""
        then = dict.fromkeys(("own", "best", "lost")) if later is None else vars(later)
        own, best = (
            np.array([self.bound_fixed_point(most, then[whose], mixing=mixing) for most in (0, 1)])
            for whose, mixing in (("own", self.mixing), ("best", None))
        )
        after, lost = {"own": own, "best": best} if later is None else vars(later), []
        for most, advantage in enumerate(self.bound_advantages(*after["own"])):
            ahead = self.sets.solve_inner_problem(after["best"][most], most=bool(most)).bound
            apart = ahead - own[1 - most][self.sets.mdp.pair_state]
            first = np.maximum(best[most] - own[1 - most], 0.0)
            lost.append(
                self.bound_fixed_point(most, then["lost"], first, losing=(advantage, apart))
            )
        sides = {"own": own, "best": best, "lost": np.array(lost)}
        return RobustBounds(sets=self.sets, range=self.ends, **sides)

    def apply_operator(
        self,
        value: Floats,
        *,
        most: int,
        mixing: sp.csr_array | None = None,
        losing: tuple[Floats, Floats] | None = None,
    ) -> Step:
        """Return what V^π, with its `mixing`, or V* is before a step; from below or above.

        Of D, no action gains more than its advantage (L,) and what it keeps of D, nor than with a
        model for each side: what the best may be worth less what the policy is (L,).
        """
        mdp, unknown = self.sets.mdp, self.sets.unknown
        nature = self.sets.solve_inner_problem(value, most=bool(most), rewards=losing is None)
        pairs, gain, off = nature.bound, self.ends[most], 0.0
        if losing is not None:
            advantage, apart = losing
            joint = advantage + nature.bound
            pairs = (np.minimum if most else np.maximum)(joint, apart)
            alone, gain = joint == pairs, (self.ends[1] - self.ends[0]) * most
        if mixing is None:
            best = np.maximum.reduceat(pairs, mdp.pair_offsets[:-1])
            taken = first_of(mdp, pairs == best[mdp.pair_state])
            each = np.ones(len(taken)), taken, np.arange(len(taken) + 1)
            mixing = sp.csr_array(each, (len(taken), len(pairs)))
        else:  # a policy's mixture is a sum of products, each of them rounded, as is the sum
            off = (4 if most else -4) * UNIT * mdp.n_actions
        bound = mixing @ pairs + off * (mixing @ np.abs(pairs))

        def compute_piece() -> tuple[sp.csr_array, Floats]:
            laws, constant = nature.piece()
            if losing is not None:
                laws = laws.multiply(alone.astype(np.float64)[:, None])
                constant = np.where(alone, advantage, apart)
            mixed = sp.csr_array(mixing @ sp.csr_array(laws))
            if unknown.any():
                mixed = sp.csr_array(mixed.multiply((~unknown).astype(np.float64)[:, None]))
            return mixed, np.where(unknown, gain, mixing @ constant)

        return Step(np.where(unknown, gain, bound), compute_piece)

    def bound_advantages(self, low: Floats, high: Floats) -> tuple[Floats, Floats]:
        """Return bounds (L,) of A_P(l) in every model P, with V^π that follows within bounds."""
        mdp, own, mixing = self.sets.mdp, self.own, self.mixing
        middle = (low + high) / 2
        half = np.maximum(high - middle, middle - low)
        least, most = (
            self.sets.solve_inner_problem(middle, most=side).bound for side in (False, True)
        )
        moved = np.minimum(np.sqrt(2 * self.sets.radius) * SLACK, 2.0) * float(half.max())
        state = mdp.pair_state
        apart = abs(mdp.transition - (mixing @ mdp.transition)[state]) @ half
        others = (mixing @ moved)[state] - own * moved
        coupled = mdp.discount * (apart + (1 - own) * moved + others) * SLACK
        size = np.maximum(np.abs(least), np.abs(most))
        coupled += 8 * UNIT * (mdp.n_actions + 4) * ((mixing @ size)[state] + size)
        advantages = []
        for mine, theirs, sign in ((least, most, -1), (most, least, 1)):
            rest = (mixing @ theirs)[state] - own * theirs
            advantages.append(np.where(own == 1, 0.0, (1 - own) * mine - rest + sign * coupled))
        return advantages[0], advantages[1]

    def bound_fixed_point(
        self, most: int, then: Sides | None, first: Floats | None = None, **of: Any
    ) -> Floats:
        """Return (S,) bounds of the fixed point of a step, or of one step: from below or above.

        `first` (S,) are such bounds, unless given the ends of the range, and 0 where all is over;
        `then` are those of what follows the step.
        """
        mdp, (sign, take) = self.sets.mdp, (1, np.minimum) if most else (-1, np.maximum)
        if then is not None:
            value = self.apply_operator(then[most], most=most, **of).bound
            return value if first is None else take(value, first)
        known = np.where(find_recorded_ends(mdp), 0.0, self.ends[most]) if first is None else first
        left, scale = float(1 - mdp.discount_exact), SMALL * (self.ends[1] - self.ends[0])
        value = known
        for _ in range(IMPROVEMENTS if left else SWEEPS):
            after = self.apply_operator(value, most=most, **of)
            if left:
                beyond = max(float((sign * (after.bound - value)).max()), 0.0) / left * SLACK
                known = take(known, value + sign * (beyond + 4 * UNIT * (np.abs(value) + beyond)))
                chain, constant = after.piece()
                target = LinearSystem(chain, mdp.discount).approximate(constant)
            else:
                target = known = take(known, after.bound)
            if np.abs(target - value).max() <= scale:
                break
            value = target
        return known
