"""The regret of a policy: exact if that is cheap, otherwise within bounds.

    regret(s) = V*(s) - V^π(s) = Σ_s' d_s(s') gap(s', π(s')),    gap(s, a) = V*(s) - Q*(s, a)

with d_s the discounted visits of π from s. In large models and long cycles the regret is bounded in
floating point; even there a regret of 0 is certified if every action that a policy takes is proven
to be optimal. In a model of floats, an action ties with the best if their rounding may explain its
gap (`analysis.gate.forgiveness`).
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from math import inf
from typing import Any

import numpy as np

from exact_mdp.analysis.gate.class_losses import (
    compute_exact_row,
    final_class,
    to_blame,
)
from exact_mdp.analysis.gate.forgiveness import (
    bound_per_use,
    compute_rounding_allowance,
    compute_tie_gaps,
    round_finite_values,
)
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.mdp.graph import find_reachable_states, label_components
from exact_mdp.mdp.model import MDP, cache_on_model
from exact_mdp.mdp.questions.advice import other_question, ways_out
from exact_mdp.mdp.result import Brief
from exact_mdp.mdp.table import LARGEST, Floats, format_rational
from exact_mdp.mdp.table import exact as exact_number
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.bounds.bounds import Bounds, bound_optimal_values, margin_weights
from exact_mdp.solvers.bounds.gains import (
    SLACK,
    TINY,
    UNIT,
    BoundedVector,
    compute_advantages,
    first_of,
)
from exact_mdp.solvers.claims import (
    Bounded,
    Certified,
    Claim,
    ClaimedNumber,
    LowHigh,
    Number,
    SolverError,
    compute_regret,
    in_decimals,
    is_at_most,
)
from exact_mdp.solvers.dynamic.methods import PolicyIteration
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.exact.certify import certify_and_check, proven_optimum
from exact_mdp.solvers.exact.levels import Level
from exact_mdp.solvers.exact.linear import evaluate_exactly
from exact_mdp.solvers.exact.optimise import optimise_exactly
from exact_mdp.solvers.solution import answer_maximised, at_start
from exact_mdp.solvers.total import solve_total
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.policy_values import find_policy_values

# The most transitions for which a regret is certified at once: a few seconds of rational
# arithmetic. A model with a horizon has no cycles, which allows more.
EXACT_TRANSITIONS, EXACT_IN_TIME = 100_000, 250_000
# The largest cycle, in states, for which a verdict that bounds leave open is certified: rational
# arithmetic grows with the cube of a cycle, and takes about a second at this size.
LAST_CYCLE = 500


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StateLosses(Brief):
    """Where a regret arises: the values and losses of states, and the gaps of pairs.

    In an exact regret, `optimal_pairs` are exactly the optimal ones; in a bounded one, they are all
    pairs that are not proven to lose more than rounding can explain.
    """

    optimal_value: Floats  # (S,), as the next two; NaN in states that an improper policy never sees
    learned_value: Floats
    by_state: Floats
    optimal_pairs: Flags  # (L,)
    gap: Floats  # (L,) suboptimality gaps, 0 for optimal pairs
    unclear: Flags | bool = False  # (L,) the `optimal_pairs` that are not proven to be optimal

    def __post_init__(self) -> None:
        object.__setattr__(self, "gap", np.where(self.optimal_pairs, 0.0, self.gap))
        super().__post_init__()


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Regret(ClaimedNumber, Brief):
    """The values of the optimum and of a policy at the start, and their difference.

    As a number it is the regret at the start: `audit.regret < 0.05`, `f"{audit.regret:.3f}"`. There
    is no rounding allowance in a comparison, and `==` compares the numbers at the start alone.

    `find_losses` and `movable` are called only when a report or a verdict needs their answer.
    """

    optimal: Certified | Bounded  # at the start, as the next two
    learned: Certified | Bounded
    at_start: Certified | Bounded
    find_losses: Callable[[], StateLosses]
    optimum: Certificate | Bounds | None = None  # the proof of the values of a total reward
    movable: Callable[[], Fraction] = Fraction  # computes the rounding allowance

    @classmethod
    def from_values(
        cls,
        optimal: Number,
        learned: Number,
        find_losses: Callable[[], StateLosses],
        **parts: Any,
    ) -> Regret:
        """Return the regret, given both values at the start."""
        return cls(
            optimal=optimal,
            learned=learned,
            at_start=compute_regret(optimal, learned),
            find_losses=find_losses,
            **parts,
        )

    @cached_property
    def losses(self) -> StateLosses:
        """Where the regret arises."""
        return self.find_losses()

    @property
    def by_state(self) -> Floats:
        """(S,) the regret of a start in each state."""
        return self.losses.by_state

    @property
    def optimal_value(self) -> Floats:
        """(S,) the optimal values."""
        return self.losses.optimal_value

    @property
    def learned_value(self) -> Floats:
        """(S,) the values of the policy."""
        return self.losses.learned_value

    @property
    def optimal_pairs(self) -> Flags:
        """(L,) the optimal pairs."""
        return self.losses.optimal_pairs

    @property
    def gap(self) -> Floats:
        """(L,) the suboptimality gaps."""
        return self.losses.gap

    @property
    def unclear(self) -> Flags | bool:
        """(L,) the optimal pairs that are not proven to be optimal."""
        return self.losses.unclear

    @property
    def bounds(self) -> LowHigh:
        """The two ends between which the regret at the start lies."""
        return self.at_start.bounds

    @property
    def advice(self) -> str:
        """The fix if a comparison is open."""
        return self.at_start.advice

    def __float__(self) -> float:
        return float(self.at_start)

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Regret):
            return self.at_start == other.at_start
        return self.at_start == other

    def __hash__(self) -> int:
        return hash(self.at_start)

    def __repr__(self) -> str:
        optimal, learned = float(self.optimal.value), float(self.learned.value)
        lost = f"{float(self.at_start.value):.6g} ({self.claim})"
        return f"Regret({lost}: optimal {optimal:.6g}, learned {learned:.6g})"

    def negated(self, mdp: MDP) -> Regret:
        """Return this regret for `mdp`, the model with negated rewards.

        Losses stay the same, and `optimum` remains the proof for the model of rewards.
        """
        return replace(
            self,
            optimal=-self.optimal,
            learned=-self.learned,
            find_losses=partial(_negate_values, self),
        )

    @property
    def claim(self) -> Claim:
        """Certified or bounded."""
        return self.at_start.claim

    @cached_property
    def forgiven(self) -> Fraction:
        """The rounding allowance: a regret that rounding of the given floats may explain."""
        return self.movable()

    def keeps_limit(self, limit: Fraction) -> bool | None:
        """Return whether the regret is at most `limit`; None if the bounds do not decide."""
        return is_at_most(self.bounds, (limit, limit))


def _negate_values(lost: Regret) -> StateLosses:
    """Return the losses of a regret with the values of states times -1."""
    each = lost.losses
    return replace(
        each, optimal_value=0.0 - each.optimal_value, learned_value=0.0 - each.learned_value
    )


def policy_regret(chain: PolicyChain, *, exact: bool | None = None) -> Regret:
    """Return the regret of a policy against the optimum of its model.

    `exact` is True for rational arithmetic and False for bounds; by default the model's size
    decides.
    """
    return answer_maximised(chain.mdp, lambda mdp: _compute_regret(chain.over(mdp), exact))


def _compute_regret(chain: PolicyChain, exact: bool | None) -> Regret:
    """Return the regret in a model of maximised rewards."""
    mdp, cheap = chain.mdp, exact
    if exact is None:
        cheap = is_cheap_to_certify(mdp)
    if cheap or mdp.ends.has_improper_policy:  # bounds need every policy to be proper
        return _certify_regret(mdp, chain, proven_optimum(mdp))
    lost = _bound_regret(mdp, chain, bounded_optimum(mdp))
    low, _ = lost.bounds
    if exact is None and low <= 0 and isinstance(lost.at_start, Bounded) and mdp.ends.is_acyclic:
        return _decide_exactly(chain, lost)
    return lost


def limit_of(name: str, limit: object) -> Fraction:
    """Return a limit of the regret as an exact number; raise ModelError if it cannot be one."""
    value = exact_number(limit, name)
    said = f"{name} is {format_rational(value)}"
    if value < 0:
        raise ModelError(said, where=name, fix="choose 0 or more")
    if value > LARGEST:
        raise ModelError(f"{said}, beyond the floats", where=name, fix="choose less")
    return value


def is_cheap_to_certify(mdp: MDP, cycle: int = 200) -> bool:
    """Return whether rational arithmetic takes a few seconds at most.

    That is so with few transitions, if no cycle has more than `cycle` states.
    """
    most = EXACT_IN_TIME
    if mdp.space.untimed is None:
        most = EXACT_TRANSITIONS
    if mdp.n_transitions > most:
        return False
    return mdp.n_states <= cycle or _longest_cycle(mdp) <= cycle


@cache_on_model
def _longest_cycle(mdp: MDP) -> int:
    """Return the number of states in the largest strongly connected component."""
    return int(np.bincount(label_components(mdp)[1]).max())


# ---- rational arithmetic -----------------------------------------------------------------------


def _certify_regret(mdp: MDP, chain: PolicyChain, best: Certificate) -> Regret:
    """Return the exact regret.

    If some policy is improper, a pair that keeps the value of a state need not attain it. The
    policy is then evaluated by the certificate of its own model, in which it is the only policy.
    """
    # The policy's value, in every state and at the start.
    improper = mdp.ends.has_improper_policy
    own = best
    if improper:
        own = certify_and_check(chain.model)
    value, mine, learned, level = best.value_float, own.value_float, own.start_value, own.h
    if not improper and not best.optimal_pairs[chain.pairs].all():
        level = chain.exact_value
        mine, learned = level.to_floats(), level.compute_mean(mdp.start)
    if isinstance(learned, float) and learned == best.start_value:
        raise ModelError(
            "the optimum and the policy are both infinite, so nothing can be compared",
            where="the total at discount 1",
            fix=ways_out(mdp, other_question(mdp)),
        )
    both = _ExactValues(chain, best, level, value, mine, best.start_value - learned)
    return Regret.from_values(
        best.start,
        Certified(value=learned),
        both.find_losses,
        optimum=best,
        movable=both.get_allowance,
    )


@dataclass(frozen=True, eq=False)
class _ExactValues:
    """The exact values of a policy beside the optimal values."""

    chain: PolicyChain
    best: Certificate
    level: Level  # the values of the policy, if they are finite
    value: Floats  # (S,) the optimal values, rounded or infinite
    mine: Floats  # (S,) the values of the policy, in the same form
    lost: Fraction | float  # the regret at the start

    @cached_property
    def ideal(self) -> PolicyChain:
        """The chain of an optimal policy: if all policies end, of the first optimal pairs."""
        mdp, best = self.chain.mdp, self.best
        if mdp.ends.has_improper_policy:
            return PolicyChain.of_pairs(mdp, best.pairs)
        return PolicyChain.of_pairs(mdp, first_of(mdp, best.optimal_pairs))

    @cached_property
    def allowance(self) -> Fraction:
        """The rounding allowance; 0 for an infinite regret."""
        if not isinstance(self.lost, Fraction):
            return Fraction(0)
        known = round_finite_values(self.value)
        own = self.chain, round_finite_values(self.mine)
        return compute_rounding_allowance(self.chain.mdp, own, (self.ideal, known))

    def get_allowance(self) -> Fraction:
        """Return the rounding allowance, which is computed only once."""
        return self.allowance

    def find_losses(self) -> StateLosses:
        """Return where the regret arises."""
        chain, best, level, lost = self.chain, self.best, self.level, self.lost
        mdp, value, mine = chain.mdp, self.value, self.mine

        # 1. The regret of each state: the exact differences a/b - c/d, each rounded once.
        parts = zip(best.h.top, best.h.each_below, level.top, level.each_below, strict=True)
        by_state = np.array([(a * d - c * b) / (b * d) for a, b, c, d in parts])

        # 2. The gap of each pair, and which are optimal.
        optimal, gap = np.array(best.optimal_pairs), np.array(in_decimals(best.losses[-1]))
        if mdp.ends.has_improper_policy:
            with np.errstate(invalid="ignore"):
                apart = np.where(value == mine, 0.0, value - mine)
            by_state = np.where(np.isfinite(value) & np.isfinite(mine), by_state, apart)
            # In and before states of infinite value, a pair is optimal or loses an infinite amount.
            beyond = ~np.isfinite(value)
            gap[(mdp.transition @ beyond > 0) | beyond[mdp.pair_state]] = inf
            gap[optimal] = 0.0
            # Pairs that keep a value without attaining it, in classes where the policy stays.
            blamed = to_blame(chain, best, by_state)
            optimal[blamed] = False
            # In a transient state such a pair gives an infinite value up; in a recurrent class the
            # loss is counted as the loss of the class.
            gap[blamed & (np.isposinf(by_state) & (final_class(chain) < 0))[mdp.pair_state]] = inf
            # If rounding may explain the whole regret, it may explain each part.
            if lost and lost <= self.allowance:
                optimal |= (chain.chosen > 0) & chain.reached[mdp.pair_state]
        elif mdp.floats:
            with suppress(SolverError):
                most = compute_tie_gaps(self.ideal, round_finite_values(value))
                near = np.nextafter(gap, inf) <= most
                optimal = include_near_ties(chain, optimal, near, lost, self.get_allowance)
        return StateLosses(
            optimal_value=value,
            learned_value=mine,
            by_state=by_state,
            optimal_pairs=optimal,
            gap=gap,
        )


def include_near_ties(
    chain: PolicyChain,
    optimal: Flags,
    near: Flags,
    lost: Fraction | float,
    movable: Callable[[], Fraction],
) -> Flags:
    """Return the optimal pairs (L,) together with the near ties, whose gap rounding may explain.

    Near ties are left out if the policy takes nothing else and yet loses more than rounding can
    explain: its regret must be due to some pairs.
    """
    both = optimal | near
    if both[chain.pairs].all() and lost > movable():
        return optimal
    return both


# ---- bounds --------------------------------------------------------------------------------------


def _bound_regret(mdp: MDP, chain: PolicyChain, optimum: Bounds) -> Regret:
    own = known = BoundedVector(value=optimum.value, error=optimum.state_error)
    if not np.array_equal(chain.pairs, optimum.pairs):
        own = find_policy_values(chain)
    # Pairs that are not proven to lose count as optimal; some of them are open.
    near, ideal = ActionBounds(mdp, optimum), PolicyChain.of_pairs(mdp, optimum.pairs)
    loses = _find_losing_pairs(ideal, known, near.least_gap)
    losses = partial(
        StateLosses,
        optimal_value=known.value,
        learned_value=own.value,
        by_state=np.maximum(known.value - own.value, 0.0),
        optimal_pairs=~loses,
        gap=near.gap,
        unclear=~loses & near.open,
    )
    lost = Regret.from_values(
        at_start(mdp, known),
        at_start(mdp, own),
        losses,
        optimum=optimum,
        movable=partial(compute_rounding_allowance, mdp, (chain, own), (ideal, known)),
    )
    if near.all_best(chain):
        return replace(lost, at_start=Certified(value=Fraction(0)))
    return lost


def _decide_exactly(chain: PolicyChain, lost: Regret) -> Regret:
    """Return a bounded regret with exact values at the start, if few pairs are open.

    Pairs that the bounds prove to lose cannot be optimal: the best of the others, from the states
    that they reach, is the optimum. The model has no cycles.
    """
    mdp, optimum = chain.mdp, lost.optimum
    assert isinstance(optimum, Bounds)
    open_ = ActionBounds(mdp, optimum).least_gap <= 0
    reached = find_reachable_states(mdp, pairs=open_)
    pairs = np.flatnonzero(open_ & reached[mdp.pair_state])
    if np.diff(mdp.transition.indptr)[pairs].sum() > EXACT_TRANSITIONS:
        return lost

    def mean_at_start(level: Level, states: Flags) -> Fraction:
        number = np.cumsum(states) - 1
        return level.compute_mean([(int(number[s]), p) for s, p in mdp.start if p])

    _, (best,), _ = optimise_exactly(bellman_rows(mdp).within(reached, pairs))
    alone, own = chain.build_bellman_rows(), chain.reached
    (mine,) = evaluate_exactly(alone.within(own, np.flatnonzero(own)))
    optimal, learned = mean_at_start(best, reached), mean_at_start(mine, own)
    return replace(
        lost,
        optimal=Certified(value=optimal),
        learned=Certified(value=learned),
        at_start=Certified(value=optimal - learned),
    )


def _find_losing_pairs(ideal: PolicyChain, known: BoundedVector, least_gap: Floats) -> Flags:
    """Return the pairs (L,) that lose more than rounding can explain."""
    mdp, loses = ideal.mdp, least_gap > 0
    if mdp.floats:
        # A cheap test first: w - γ P w ≥ m > 0, so F ≤ E w / m for E the largest e. Few pairs
        # are near enough to the best to need the gaps up to which they tie.
        weights = margin_weights(mdp)
        uses = float(weights.value.max() / weights.smallest)
        open_ = loses & (least_gap <= bound_per_use(mdp, known) * (1 + 2 * uses) * SLACK)
        if open_.any():
            with suppress(SolverError):
                loses &= ~open_ | (least_gap > compute_tie_gaps(ideal, known))
    return loses


@cache_on_model
def bounded_optimum(mdp: MDP) -> Bounds:
    """Return bounds around the optimal values, as narrow as double precision allows."""
    solved = solve_total(mdp)
    bounds = bound_optimal_values(mdp, solved.value)
    # 2^-36 of the largest value is about 1e-11: wider bounds come from a solver that stopped at its
    # tolerance of 1e-9, while the values of a policy are exact up to rounding.
    if bounds.error <= 2.0**-36 * float(np.abs(bounds.value).max()):
        return bounds
    better = bound_optimal_values(mdp, PolicyIteration(start=solved).solve_rewards(mdp).value)
    if better.error <= bounds.error:
        return better
    return bounds


class ActionBounds:
    """Bounds of each pair, from bounds on V*: `low` and `high` of Q*(l) - V(s), and of the gap.

    `least_gap` bounds the gap from below; `open` marks pairs that another of the state may beat.
    """

    def __init__(self, mdp: MDP, optimum: Bounds) -> None:
        # Q*(l) - V(s) = d(l) + γ P_l (V* - V), and low · w ≤ V* - V ≤ high · w.
        self.mdp, added = mdp, compute_advantages(mdp, optimum.value)
        value, flow = added.value, mdp.discount * (mdp.transition @ optimum.weight)
        off = added.error + 8 * UNIT * np.abs(value) + TINY
        off += (SLACK - 1) * max(abs(optimum.low), abs(optimum.high)) * flow
        self.low, self.high = value - off + optimum.low * flow, value + off + optimum.high * flow

        # The gap is at least the best lower bound of the state, less the pair's upper bound.
        first, state = mdp.pair_offsets[:-1], mdp.pair_state
        best = np.maximum.reduceat(self.low, first)[state]
        self.gap = np.maximum.reduceat(value, first)[state] - value
        self.least_gap = np.nextafter(best - self.high, -inf)

        # The greatest upper bound among the other pairs of the state: the second greatest for the
        # pair that has the greatest.
        order, last = np.lexsort((self.high, state)), mdp.pair_offsets[1:] - 1
        other = self.high[order[last]][state]
        other[order[last]] = self.high[order[last - 1]]
        self.open = (other > self.low) & ~mdp.forced[state]

    def all_best(self, chain: PolicyChain) -> bool:
        """Return whether all actions that a policy takes are proven to be optimal."""
        mdp = self.mdp
        live = (chain.reached & ~mdp.terminal)[mdp.pair_state]
        for pair in np.flatnonzero(live & (chain.chosen > 0) & self.open).tolist():
            for other in mdp.pairs_of(int(mdp.pair_state[pair])):
                # Another pair that may be better must be a twin, with the same row and reward.
                may_be_better = other != pair and self.high[other] > self.low[pair]
                if may_be_better and (
                    compute_exact_row(mdp, other) != compute_exact_row(mdp, pair)
                ):
                    return False
        return True
