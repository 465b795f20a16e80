"""How much a policy loses against the optimum: exactly where that is cheap, else within bounds.

    regret(s) = V*(s) - V^π(s) = Σ_s' d_s(s') gap(s', π(s')),    gap(s, a) = V*(s) - Q*(s, a)

with d_s the discounted visits of π that begins in s. Large models and long cycles are bounded in
floating point; even there a regret of 0 is certified where every action that a policy takes is
proven to be optimal. With floats among the given numbers, an action ties with the best where its
gap is at most what their rounding can move (`analysis.gate.forgiveness`).
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

from exact_mdp.analysis.gate.forgiveness import (
    bound_per_use,
    compute_rounding_allowance,
    compute_tie_gaps,
    round_finite_values,
)
from exact_mdp.analysis.gate.waiting import chain_of_pairs, compute_exact_row, final_class, to_blame
from exact_mdp.analysis.optimum import require_sound_proof
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import (
    has_improper_policy,
    is_acyclic,
    label_components,
    other_question,
    ways_out,
)
from exact_mdp.mdp.model import MDP, cache_on_model
from exact_mdp.mdp.result import Brief
from exact_mdp.mdp.table import LARGEST, Floats, format_rational
from exact_mdp.mdp.table import exact as exact_number
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.bounds.bounds import Bounds, bound_optimal_values, margin_weights
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, compute_advantages, first_of
from exact_mdp.solvers.bounds.linear import FixedPoint
from exact_mdp.solvers.dynamic.methods import PolicyIteration
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.exact.certify import certify
from exact_mdp.solvers.solution import (
    Bounded,
    Certified,
    Claim,
    Number,
    SolverError,
    at_start,
    compute_regret,
    in_decimals,
)
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.evaluate import evaluate
from exact_mdp.solvers.values.policy_chain import PolicyChain


def certify_and_check(mdp: MDP, criterion: str = "total") -> Certificate:
    """Return a certificate that its checker has accepted."""
    return require_sound_proof(certify(mdp, criterion=criterion))


# Up to these numbers a regret is certified, in a few seconds; beyond, its bounds are proven.
EXACT_TRANSITIONS = 100_000
EXACT_IN_TIME = 250_000  # of a model of episodes that stop: no cycle, a stage for each time
EXACT_CYCLE = 200  # states of the largest cycle
LAST_CYCLE = 500  # states of the largest cycle, where bounds leave a verdict open: about a second
CLOSE = 2.0**-36  # of the largest value: wider bounds, of a solver that stops at 1e-9, are redone


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Regret(Brief):
    """What the optimum and a policy are worth, and the difference.

    Optimal pairs are all and only these where certified; where bounded, all that the bounds do not
    prove to lose more than rounding can move.
    """

    optimal: Certified | Bounded  # at the start, as the next two
    learned: Certified | Bounded
    at_start: Certified | Bounded
    optimal_value: Floats  # (S,), as the next two; NaN where a policy that need not end never comes
    learned_value: Floats
    by_state: Floats
    optimal_pairs: Flags  # (L,)
    gap: Floats  # (L,) what a pair falls short of the optimum, 0 for optimal pairs
    unclear: Flags | bool = False  # (L,) which optimal ones the bounds do not prove to be
    optimum: Certificate | Bounds | None = None  # of a total, what vouches for the values
    movable: Callable[[], Fraction] = Fraction  # works out `compute_rounding_allowance`

    @classmethod
    def from_values(
        cls, best: tuple[Number, Floats], own: tuple[Number, Floats], optimal: Flags, **parts: Any
    ) -> Regret:
        """Return the regret, by what both are worth at the start and in every state (S,)."""
        parts["gap"] = np.where(optimal, 0.0, parts["gap"])
        return cls(
            optimal=best[0],
            learned=own[0],
            at_start=compute_regret(best[0], own[0]),
            optimal_value=best[1],
            learned_value=own[1],
            optimal_pairs=optimal,
            **parts,
        )

    def __repr__(self) -> str:
        optimal, learned = float(self.optimal.value), float(self.learned.value)
        lost = f"{float(self.at_start.value):.6g} ({self.claim})"
        return f"Regret({lost}: optimal {optimal:.6g}, learned {learned:.6g})"

    def of_sense(self, sense: str) -> Regret:
        """Return the same of costs where the sense is "min", and this is of their negative.

        What is lost stays as it is, and `optimum` that of the rewards.
        """
        if sense == "max":
            return self
        return replace(
            self,
            optimal=-self.optimal,
            learned=-self.learned,
            optimal_value=0.0 - self.optimal_value,
            learned_value=0.0 - self.learned_value,
        )

    @property
    def claim(self) -> Claim:
        """Certified or bounded."""
        return self.at_start.claim

    @cached_property
    def forgiven(self) -> Fraction:
        """The regret that counts as none: what the rounding of the given floats can move."""
        return self.movable()

    def keeps_limit(self, limit: Fraction) -> bool | None:
        """Return whether the regret is at most `limit`; None where the bounds do not decide."""
        return is_at_most(interval_of(self.at_start), limit)


def interval_of(number: Certified | Bounded) -> tuple[Fraction | float, Fraction | float]:
    """Return between what a number lies: exactly where it is certified."""
    return (number.value, number.value) if isinstance(number, Certified) else number.interval


def is_at_most(within: tuple[Fraction | float, Fraction | float], limit: Fraction) -> bool | None:
    """Return whether a number between two ends is at most `limit`; None where it may be."""
    low, high = within
    if high <= limit:
        return True
    return False if low > limit else None


proven_optimum = cache_on_model(certify_and_check)  # of the total reward, found once for each model


def policy_regret(chain: PolicyChain, *, exact: bool | None = None) -> Regret:
    """Return what a policy is worth against the optimum of its model.

    `exact` asks for rational arithmetic, or for bounds; unless given, the model's size decides.
    """
    mdp = chain.mdp
    if mdp.sense == "min":
        negated = replace(chain, mdp=mdp.maximised)
        return policy_regret(negated, exact=exact).of_sense(mdp.sense)
    exact = is_cheap_to_certify(mdp) if exact is None else exact
    if exact or has_improper_policy(mdp):  # bounds are of models in which every policy ends
        return _certify_regret(mdp, chain, proven_optimum(mdp))
    return _bound_regret(mdp, chain, bounded_optimum(mdp))


def limit_of(name: str, limit: object) -> Fraction:
    """Return a limit of the regret, checked."""
    value = exact_number(limit, name)
    if not 0 <= value <= LARGEST:
        large = value > 0
        beyond, fix = (", beyond the floats", "choose less") if large else ("", "choose 0 or more")
        raise ModelError(f"{name} is {format_rational(value)}{beyond}", where=name, fix=fix)
    return value


def is_cheap_to_certify(mdp: MDP, cycle: int = EXACT_CYCLE) -> bool:
    """Return whether rational arithmetic is quick: few transitions, cycles of few states."""
    most = EXACT_TRANSITIONS if mdp.space.untimed is None else EXACT_IN_TIME
    return mdp.n_transitions <= most and _longest_cycle(mdp) <= cycle


@cache_on_model
def _longest_cycle(mdp: MDP) -> int:
    """Return the greatest number of states that lead to one another."""
    return 1 if is_acyclic(mdp) else int(np.bincount(label_components(mdp)[1]).max())


# ---- rational arithmetic -----------------------------------------------------------------------


def _certify_regret(mdp: MDP, chain: PolicyChain, best: Certificate) -> Regret:
    """Return the exact regret.

    At discount 1 where some policy never ends, a pair that keeps the value of a state need not
    attain it, so that the policy is judged by its own model, in which it is the only one.
    """
    unending = has_improper_policy(mdp)
    own = certify_and_check(chain.model) if unending else best
    value, mine, learned, level = best.value_float, own.value_float, own.start_value, own.h
    if not unending and not best.optimal_pairs[chain.pairs].all():
        level = chain.exact_value
        mine, learned = level.to_floats(), level.compute_mean(mdp.start)
    if isinstance(learned, float) and learned == best.start_value:
        raise ModelError(
            "the optimum and the policy are both infinite, so that nothing can be compared",
            where="the total at discount 1",
            fix=ways_out(mdp, other_question(mdp)),
        )
    lost = best.start_value - learned
    ideal = chain_of_pairs(mdp, best.pairs if unending else first_of(mdp, best.optimal_pairs))
    known = (chain, round_finite_values(mine)), (ideal, round_finite_values(value))
    movable = (
        partial(compute_rounding_allowance, mdp, *known) if isinstance(lost, Fraction) else Fraction
    )
    # The exact differences, each rounded once.
    parts = zip(best.h.top, best.h.each_below, level.top, level.each_below, strict=True)
    by_state = np.array([(a * d - c * b) / (b * d) for a, b, c, d in parts])
    optimal, gap = np.array(best.optimal_pairs), np.array(in_decimals(best.losses[-1]))
    if unending:
        with np.errstate(invalid="ignore"):
            apart = np.where(value == mine, 0.0, value - mine)
        by_state = np.where(np.isfinite(value) & np.isfinite(mine), by_state, apart)
        # A pair that is in a state of infinite value, or may lead to one, is optimal or loses all.
        beyond = ~np.isfinite(value)
        gap[(mdp.transition @ beyond > 0) | beyond[mdp.pair_state]] = inf
        gap[optimal] = 0.0
        # What keeps a value without attaining it is found where the policy stays for ever.
        blamed = to_blame(chain, best, by_state)
        optimal[blamed] = False
        # Who passes through gives an infinite value up here; who stays loses it by waiting.
        gap[blamed & (np.isposinf(by_state) & (final_class(chain) < 0))[mdp.pair_state]] = inf
        if lost and lost <= movable():  # what all of it loses is rounding: so each part
            optimal |= (chain.chosen > 0) & chain.reached[mdp.pair_state]
    elif mdp.floats:
        with suppress(SolverError):
            near = np.nextafter(gap, inf) <= compute_tie_gaps(ideal, round_finite_values(value))
            optimal = include_near_ties(chain, optimal, near, lost, movable)
    both = (best.start, value), (Certified(value=learned), mine)
    return Regret.from_values(
        *both, optimal, by_state=by_state, gap=gap, optimum=best, movable=movable
    )


def include_near_ties(
    chain: PolicyChain,
    optimal: Flags,
    near: Flags,
    lost: Fraction | float,
    movable: Callable[[], Fraction],
) -> Flags:
    """Return the optimal pairs (L,), with those whose gap the rounding of floats may have caused.

    Without these where each pair of the policy loses that little, and all of them too much.
    """
    both = optimal | near
    return optimal if both[chain.pairs].all() and lost > movable() else both


# ---- bounds --------------------------------------------------------------------------------------


def _bound_regret(mdp: MDP, chain: PolicyChain, optimum: Bounds) -> Regret:
    own = known = FixedPoint(value=optimum.value, error=optimum.state_error)
    if not np.array_equal(chain.pairs, optimum.pairs):
        evaluation = evaluate(mdp, chain)
        own = FixedPoint(value=evaluation.value, error=evaluation.error)
    near, ideal = ActionBounds(mdp, optimum), chain_of_pairs(mdp, optimum.pairs)
    loses = _find_losing_pairs(ideal, known, near.least_gap)
    lost = Regret.from_values(
        (at_start(mdp, known), known.value),
        (at_start(mdp, own), own.value),
        ~loses,
        by_state=np.maximum(known.value - own.value, 0.0),
        unclear=~loses & near.open,
        gap=near.gap,
        optimum=optimum,
        movable=partial(compute_rounding_allowance, mdp, (chain, own), (ideal, known)),
    )
    certain = near.all_best(chain)
    return replace(lost, at_start=Certified(value=Fraction(0))) if certain else lost


def _find_losing_pairs(ideal: PolicyChain, known: FixedPoint, least_gap: Floats) -> Flags:
    """Return the pairs (L,) that lose more than rounding can move."""
    mdp, loses = ideal.mdp, least_gap > 0
    if mdp.floats:
        # Few pairs are so near to the best that it could: F ≤ E w / m, as w - γ P w ≥ m > 0.
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
    solved = solve(mdp)
    bounds = bound_optimal_values(mdp, solved.value)
    if bounds.error <= CLOSE * float(np.abs(bounds.value).max()):
        return bounds
    # A solver may stop at its tolerance; the values of a policy have no error but rounding.
    better = bound_optimal_values(mdp, PolicyIteration(start=solved).solve(mdp).value)
    return better if better.error <= bounds.error else bounds


class ActionBounds:
    """What bounds on V* say of each pair: `low` and `high` of Q*(l) - V(s), and the gap.

    `least_gap` bounds the gap from below; `open` is where another pair of the state may be better.
    """

    def __init__(self, mdp: MDP, optimum: Bounds) -> None:
        # Q*(l) - V(s) = d(l) + γ P_l (V* - V), and low · w ≤ V* - V ≤ high · w.
        self.mdp, added = mdp, compute_advantages(mdp, optimum.value)
        value, flow = added.value, mdp.discount * (mdp.transition @ optimum.weight)
        off = (added.error + 8 * UNIT * np.abs(value)) * SLACK + TINY
        off += (SLACK - 1) * max(abs(optimum.low), abs(optimum.high)) * flow
        self.low, self.high = value - off + optimum.low * flow, value + off + optimum.high * flow
        first, state = mdp.pair_offsets[:-1], mdp.pair_state
        best = np.maximum.reduceat(self.low, first)[state]
        self.gap = np.maximum.reduceat(value, first)[state] - value
        self.least_gap = np.nextafter(best - self.high, -inf)
        order, last = np.lexsort((self.high, state)), mdp.pair_offsets[1:] - 1
        other = self.high[order[last]][state]  # the greatest of the other pairs
        other[order[last]] = self.high[order[last - 1]]
        self.open = (other > self.low) & ~mdp.forced[state]

    def all_best(self, chain: PolicyChain) -> bool:
        """Return whether all that a policy does where it comes is proven to be optimal."""
        mdp = self.mdp
        live = (chain.reached & ~mdp.terminal)[mdp.pair_state]
        return all(  # all other pairs are worse, or have the same outcomes
            compute_exact_row(mdp, other) == compute_exact_row(mdp, pair)
            for pair in np.flatnonzero(live & (chain.chosen > 0) & self.open).tolist()
            for other in mdp.pairs_of(int(mdp.pair_state[pair]))
            if other != pair and self.high[other] > self.low[pair]
        )
