"""Bounds of the regret for every model that the records allow, distribution-free.

The sets of `analysis.gate.data.sets` hold all rows at once with the stated confidence, and so do
bounds for every model P within them (robust solves: Iyengar, Mathematics of Operations Research 30,
2005): L^π ≤ V^π ≤ U^π and L* ≤ V* ≤ U*, hence V* - V^π ≤ U* - L^π. That allows a different model on
each side. Under one P the regret D is the optimum of a model of advantages (Kakade and Langford,
ICML 2002): D(s) = max over pairs l of s of A_P(l) + γ P_l D, A_P(l) = Q^π(l) - V^π(s). With c
between L^π and U^π, h half their distance and π(l) the probability of l,

    A_P(l) = (1 - π(l)) (r_l + γ P_l c) - Σ_{k ≠ l} π(k) (r_k + γ P_k c) + γ (P_l - P_π) (V^π - c),

whose last term is at most γ Σ |P_l - P_π| h: h weighted by the recorded shares, and the largest h
times √(2 KL), the distance that a row may move (Pinsker). Every bound comes from a monotone
operator T: v + e / (1 - γ) is an upper bound on its fixed point if T v ≤ v + e. At discount 1 T
maps a valid bound to a valid bound, so a range that the user states can be narrowed step by step.
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
    parse_range,
)
from exact_mdp.analysis.gate.data.sets import Given, RowSets, Step
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import SLACK, UNIT, first_of
from exact_mdp.solvers.bounds.linear import LinearSystem
from exact_mdp.solvers.claims import Claim
from exact_mdp.solvers.robust.sets import advise_on_sets

Sides = Floats  # (2, S) bounds from below and from above


@dataclass(frozen=True, kw_only=True)
class Robust:
    """A distribution-free interval: it holds for every model that fits the records.

    Attributes
    ----------
    rewards : "known", or (low, high)
        "known" if state, action and next state determine the reward, so it is as recorded;
        otherwise a range in which rewards lie, as recorded rewards do not rule out others. Known
        rewards vary with the row, whose set widens with the number of states; the mean of rewards
        in a range has a set of its own. So either may be narrower: choose before you look.
    returns : (low, high), optional
        A range for the total reward from any state; needed at discount 1.

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
        """Return the interval; raise ModelError without counts or a range that is needed."""
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

    @advise_on_sets()
    def bounds(self, mdp: MDP, own: Floats, doubt: float) -> RobustBounds:
        """Return bounds that hold unless some row lies outside its set, of probability `doubt`."""
        sets, returns = RowSets.of(mdp, doubt, self.rewards), parse_range(self.returns, "returns")
        if returns is None:
            return robust_bounds(sets, own)
        if own.ndim > 1:
            what = "with a horizon the rewards already bound the total"
            fix = "leave it out (--evidence returns=, returns=)"
            raise ModelError(what, where="returns", fix=fix)
        _require_seen(mdp, returns)
        return robust_bounds(sets, own, mdp.sense.orient_interval(*returns))

    def assumptions(self, mdp: MDP, sets: RowSets) -> tuple[str, ...]:
        """Return the assumptions of the sets besides the records."""
        low, high = mdp.sense.orient_interval(*sets.rewards)
        said = list(of_process(mdp))
        if sets.known:
            said.append(
                "rewards are as recorded for state, action and next state; for a next state that "
                f"was never seen they lie from {low:g} to {high:g}, as all recorded rewards do"
            )
        else:
            said.append(f"rewards lie from {low:g} to {high:g}, as stated")
        if self.returns is not None:
            said.append(f"total rewards lie from {self.returns[0]} to {self.returns[1]}, as stated")
        if sets.unknown.any():
            said.append(
                "states in which episodes were cut off and which no record leaves, "
                f"{format_states(mdp, sets.unknown)}, have any value that rewards allow"
            )
        if (sets.counted[~mdp.terminal[mdp.pair_state]] == 0).any():
            said.append("actions that nobody took are as the model says")
        return tuple(said)


def _require_seen(mdp: MDP, returns: Ends) -> None:
    """Raise ModelError if a recorded transition excludes every total in the range stated."""
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
    """Bounds of the values and the regret of a policy, for every model within sets of rows."""

    sets: RowSets
    range: Ends  # the range of the values of all states
    own: Sides  # bounds of V^π
    best: Sides  # bounds of V*
    lost: Sides  # bounds of V* - V^π

    def at_start(self, mdp: MDP, whose: Sides) -> Ends:
        """Return the bounds of a value at the start, in the sense of the model given."""
        low, high = (self.sets.at_start(whose[most], most=bool(most)) for most in (0, 1))
        return mdp.sense.orient_interval(low, high)

    @property
    def regret(self) -> Ends:
        """Bounds of the regret at the start."""
        low, high = self.at_start(self.sets.mdp, self.lost)
        return max(low, 0.0), high


def robust_bounds(sets: RowSets, own: Floats, returns: Ends | None = None) -> RobustBounds:
    """Return the bounds for a policy (L,), with total rewards within `returns`.

    A policy (N, L) by time is for episodes of N steps; nature may choose other rows at each time.
    """
    if own.ndim == 1:
        if returns is None:
            returns = _bound_totals(sets)
        return Operators(sets=sets, own=own, ends=returns).bound_values()
    # Backward induction: the bounds with one more step to go, from the bounds after that step.
    none = np.zeros((2, sets.mdp.n_states))
    bounds = RobustBounds(sets=sets, range=(0.0, 0.0), own=none, best=none, lost=none)
    for steps in tqdm.trange(1, len(own) + 1, desc="stages", disable=None, delay=2):
        at = Operators(sets=sets, own=own[-steps], ends=_bound_totals(sets, steps))
        bounds = at.bound_values(bounds)
    return bounds


def _bound_totals(sets: RowSets, steps: int | None = None) -> Ends:
    """Return a range for the total of some steps, or of all, in every model of the sets."""
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
    return low * weight, high * weight


@dataclass(frozen=True, kw_only=True, eq=False)
class Operators:
    """The operators whose fixed points are V^π, V* and D."""

    sets: RowSets
    own: Floats  # (L,) the policy's probabilities of pairs
    ends: Ends  # the range of values, for states in which episodes were cut off

    @cached_property
    def mixing(self) -> sp.csr_array:
        """(S, L) the policy as a matrix that maps pairs to states."""
        offsets = self.sets.mdp.pair_offsets
        return sp.csr_array((self.own, np.arange(len(self.own)), offsets))

    def bound_values(self, later: RobustBounds | None = None) -> RobustBounds:
        """Return the bounds before a step that `later` follows; without it, of endless steps."""
        then: dict[str, Any] = dict.fromkeys(("own", "best", "lost"))
        if later is not None:
            then = vars(later)
        # V^π and V*, each from below (0) and from above (1).
        own, best = np.zeros((2, 2, self.sets.mdp.n_states))
        for most in (0, 1):
            own[most] = self.bound_fixed_point(most, then["own"], mixing=self.mixing)
            best[most] = self.bound_fixed_point(most, then["best"])
        after: dict[str, Any] = {"own": own, "best": best}
        if later is not None:
            after = vars(later)
        # D, which is at most the difference of the bounds of V* and V^π.
        lost = []
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
        """Apply the operator of V^π (with its `mixing`), of V*, or of D (with `losing`) once.

        The result bounds from above if `most`, else from below. For D, `losing` has two bounds (L,)
        of a pair: its advantage, to which the next D is added; and the difference of the bounds of
        V* and V^π, with a model for each side. The tighter one counts.
        """
        # Nature chooses the row of each pair, for or against.
        mdp, unknown = self.sets.mdp, self.sets.unknown
        nature = self.sets.solve_inner_problem(value, most=bool(most), rewards=losing is None)
        pairs, gain, off = nature.bound, self.ends[most], 0.0
        if losing is not None:
            advantage, apart = losing
            joint = advantage + nature.bound
            pairs = (np.minimum if most else np.maximum)(joint, apart)
            alone, gain = joint == pairs, (self.ends[1] - self.ends[0]) * most
        # Then V* and D take the best pair of each state, V^π a mixture.
        if mixing is None:
            best = np.maximum.reduceat(pairs, mdp.pair_offsets[:-1])
            taken = first_of(mdp, pairs == best[mdp.pair_state])
            each = np.ones(len(taken)), taken, np.arange(len(taken) + 1)
            mixing = sp.csr_array(each, (len(taken), len(pairs)))
        else:
            # A mixture is a sum of products, in which each product and the sum are rounded.
            off = 4 * UNIT * mdp.n_actions
            if not most:
                off = -off
        bound = mixing @ pairs + off * (mixing @ np.abs(pairs))

        def compute_piece() -> tuple[sp.csr_array, Floats]:
            rows, constant = nature.piece()
            if losing is not None:
                rows = rows.multiply(alone.astype(np.float64)[:, None])
                constant = np.where(alone, advantage, apart)
            mixed = sp.csr_array(mixing @ sp.csr_array(rows))
            if unknown.any():
                mixed = sp.csr_array(mixed.multiply((~unknown).astype(np.float64)[:, None]))
            return mixed, np.where(unknown, gain, mixing @ constant)

        return Step(np.where(unknown, gain, bound), compute_piece)

    def bound_advantages(self, low: Floats, high: Floats) -> tuple[Floats, Floats]:
        """Return bounds (L,) of A_P(l) in every model P, for V^π between `low` and `high`."""
        # c is the middle of the bounds of V^π, h half their distance.
        mdp, own, mixing = self.sets.mdp, self.own, self.mixing
        middle = (low + high) / 2
        half = np.maximum(high - middle, middle - low)
        least = self.sets.solve_inner_problem(middle, most=False).bound
        most = self.sets.solve_inner_problem(middle, most=True).bound
        # γ Σ |P_l - P_π| h: at the recorded shares, and by what the rows may move from there.
        moved = np.minimum(np.sqrt(2 * self.sets.radius), 2.0) * float(half.max())
        state = mdp.pair_state
        apart = abs(mdp.transition - (mixing @ mdp.transition)[state]) @ half
        others = (mixing @ moved)[state] - own * moved
        coupled = mdp.discount * (apart + (1 - own) * moved + others) * SLACK
        # Rounding errors of the sums over actions, and of their differences.
        size = np.maximum(np.maximum(np.abs(least), np.abs(most)), moved)
        coupled += 8 * UNIT * (mdp.n_actions + 4) * ((mixing @ size)[state] + size)
        # From below, the pair itself at its least and the others of the state at their most.
        advantages = []
        for mine, theirs, sign in ((least, most, -1), (most, least, 1)):
            rest = (mixing @ theirs)[state] - own * theirs
            advantages.append(np.where(own == 1, 0.0, (1 - own) * mine - rest + sign * coupled))
        return advantages[0], advantages[1]

    def bound_fixed_point(
        self, most: int, then: Sides | None, first: Floats | None = None, **of: Any
    ) -> Floats:
        """Return bounds (S,) of an operator's fixed point, from above if `most`, else from below.

        With `then`, bounds of the values after one step, return the bounds before it. `first` (S,)
        are bounds that are known already; by default the ends of the range, and 0 in ends.
        """
        mdp = self.sets.mdp
        sign: int
        take: np.ufunc
        if most:
            sign, take = 1, np.minimum
        else:
            sign, take = -1, np.maximum
        if then is not None:
            value = self.apply_operator(then[most], most=most, **of).bound
            if first is not None:
                value = take(value, first)
            return value
        if first is None:
            first = np.where(find_recorded_ends(mdp), 0.0, self.ends[most])
        value = known = first
        left = float(1 - mdp.discount_exact)
        # Stop once a step moves less than 1e-10 of the range: the bounds stay sound.
        scale = 1e-10 * (self.ends[1] - self.ends[0])
        # Bounds hold wherever the search ends, and are wider if it ends early: below discount 1 a
        # step solves a linear system, at discount 1 it is a single sweep.
        steps = 50
        if not left:
            steps = 1000
        for _ in range(steps):
            after = self.apply_operator(value, most=most, **of)
            if left:
                # v + e / (1 - γ) is a bound if T v ≤ v + e. The next v solves the linear piece of
                # T at v, as in policy iteration.
                beyond = max(float((sign * (after.bound - value)).max()), 0.0) / left * SLACK
                known = take(known, value + sign * (beyond + 4 * UNIT * (np.abs(value) + beyond)))
                chain, constant = after.piece()
                target = LinearSystem(chain, mdp.discount).approximate(constant)
            else:
                # T applied to a bound is a bound.
                target = known = take(known, after.bound)
            if np.abs(target - value).max() <= scale:
                break
            value = target
        return known
