"""The optimum of a model with a proof in rationals that an independent checker has accepted.

How much a policy loses against the optimum: exactly where that is cheap, else within bounds.

    regret(s) = V*(s) - V^π(s) = Σ_s' d_s(s') gap(s', π(s')),    gap(s, a) = V*(s) - Q*(s, a)

with d_s the discounted visits of π that begins in s. V* comes with a certificate that its checker
has accepted. So does V^π of a deterministic policy, because the model in which every state offers
only what it takes there has that for an optimum; that of a mixed one solves its equations exactly
(`analysis.gate.exact_policy`). Large models and long cycles are bounded in floating point instead:
V* ≤ V + c w and V^π ≥ V + c' w as in `solvers.bounds.bounds`, which is narrow where little is lost,
or the two values, each with its error. Even there a regret of 0 can be certified: where in every
state that the policy reaches each action taken is better than all others by more than the errors
(or has the same row and reward), the policy is optimal.

Where all numbers are exact, an action is optimal where its gap is 0. With floats among them, it
ties with the best where its gap is at most what their rounding can move
(`analysis.gate.forgiveness`): by using the pair and then acting optimally, and by acting optimally,

    gap(s, a) ≤ e(s, a) + γ Σ_s' P(s, a, s') F*(s') + F*(s)

Doubles decide this where their errors allow it, and rational arithmetic decides the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.gate.action_bounds import ActionBounds
from exact_mdp.analysis.gate.exact_policy import Values, exact_gaps, exact_policy
from exact_mdp.analysis.gate.forgiveness import (
    Forgiveness,
    Range,
    bounds_at_start,
    exactly_per_use,
    in_all,
    of_floats,
    per_use,
)
from exact_mdp.mdp.chain import components, is_acyclic
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers import solve
from exact_mdp.solvers.bounds.bounds import Bounds, bounds
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, gains
from exact_mdp.solvers.bounds.linear import FixedPoint
from exact_mdp.solvers.dynamic.policy_iteration import improved
from exact_mdp.solvers.proof.certificate import Certificate
from exact_mdp.solvers.solution import Bounded, Certified, Claim, SolverError
from exact_mdp.solvers.values.evaluate import evaluate
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.visits import at_start

if TYPE_CHECKING:
    from exact_mdp.solvers.proof.certificate import Certificate


def proven(mdp: MDP) -> Certificate:
    """Return a certificate that its checker has accepted.

    Examples
    --------
    >>> print(proven(MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])).start)
    2 (certified)
    """
    from exact_mdp.solvers.proof.certify import certify

    found = certify(mdp)
    if faults := found.violations():
        raise RuntimeError(f"a certificate does not hold: {faults[0]}")
    return found


Flags = NDArray[np.bool_]
EXACT_TRANSITIONS = 100_000
EXACT_IN_TIME = 250_000  # of a model of episodes that stop: no cycle, a stage for each time
EXACT_CYCLE = 64  # states of the largest cycle
LAST_CYCLE = 200  # states of the largest cycle, where bounds leave a verdict open: about a second
ACCURATE = 2.0**-30  # relative errors of gaps from which on they are worked out exactly
IMPROVEMENTS = 100  # policies tried after a solver has stopped at its tolerance


@dataclass(frozen=True, kw_only=True, eq=False)
class Regret:
    """What the optimum and a policy are worth, and the difference.

    Attributes
    ----------
    optimal, learned, at_start : Certified or Bounded
        Values of the start distribution, and the regret there.
    optimal_value, learned_value, by_state : (S,)
        Values and regret of every state, as floats; NaN at discount 1 in states that the policy
        never reaches and need not end from.
    optimal_pairs : (L,) bool
        Optimal pairs: all and only these where certified; where bounded, all that the bounds do
        not prove to lose more than rounding can move.
    unclear : (L,) bool
        Pairs among them that the bounds do not prove to be optimal; none where certified.
    gap : (L,)
        What a pair falls short of the optimum, 0 for optimal pairs.
    optimum : Certificate or Bounds
        What vouches for the optimal values.
    forgiveness : Forgiveness
        What the rounding of the given floats can move at the start; 0 in an exact model. Of a
        bounded optimum, the policy's own part alone.
    """

    optimal: Certified | Bounded
    learned: Certified | Bounded
    at_start: Certified | Bounded
    optimal_value: Floats
    learned_value: Floats
    by_state: Floats
    optimal_pairs: Flags
    unclear: Flags
    gap: Floats
    optimum: Certificate | Bounds
    forgiveness: Forgiveness = field(
        default_factory=lambda: Forgiveness(low=Fraction(0), high=Fraction(0))
    )

    @property
    def claim(self) -> Claim:
        """Certified or bounded."""
        return self.at_start.claim

    @property
    def forgiven(self) -> Fraction:
        """The regret that counts as none, a lower bound of what rounding can move."""
        return self.forgiveness.low

    def decided(self, limit: Fraction) -> bool | None:
        """Return whether the regret is at most `limit`; None where the bounds do not tell."""
        if isinstance(self.at_start, Certified):
            return self.at_start.value <= limit
        low, high = self.at_start.interval
        if isfinite(high) and Fraction(high) <= limit:
            return True
        return False if isfinite(low) and Fraction(low) > limit else None

    @property
    def zero(self) -> bool | None:
        """Whether the regret is zero up to rounding; None where the bounds do not tell."""
        if isinstance(self.at_start, Certified):
            return self.forgiveness.covers(self.at_start.value)
        low, high = self.at_start.interval
        if isfinite(high) and Fraction(high) <= self.forgiveness.low:
            return True
        return False if Fraction(low) > self.forgiveness.high else None


def regret(
    mdp: MDP,
    chain: PolicyChain,
    *,
    exact: bool | None = None,
    optimum: Certificate | Bounds | None = None,
) -> Regret:
    """Return what a policy is worth against the optimum.

    Parameters
    ----------
    mdp : MDP
    chain : PolicyChain
        The model under the policy.
    exact : bool, optional
        Rational arithmetic or bounds; unless given, rational arithmetic in models of up to 100,000
        transitions (250,000 with a horizon) without cycles of over 64 states.
    optimum : Certificate or Bounds, optional
        What another policy's regret was found with; unless `exact` is given, this says how.

    Raises
    ------
    ModelError
        At discount 1 where not every policy ends.

    Examples
    --------
    >>> stay, move = [["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]
    >>> mdp = MDP.from_arrays([stay, move], [[1, 1], [0, 0]])
    >>> found = regret(mdp, PolicyChain.of(mdp, np.array([1, 0])))
    >>> print(found.at_start, found.gap.tolist())
    1 (certified) [0.0, 1.0, 0.0, 0.0]
    """
    if exact is None:
        exact = cheap(mdp) if optimum is None else isinstance(optimum, Certificate)
    if not exact:
        return _bounded(mdp, chain, optimum if isinstance(optimum, Bounds) else _optimum(mdp))
    return _certified(mdp, chain, optimum if isinstance(optimum, Certificate) else proven(mdp))


def under(mdp: MDP, pairs: Integers) -> MDP:
    """Return the model in which every state offers only the pair (S,) that a policy takes.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[1, 0], [0, 1]]], [1, 0], discount="1/2")
    >>> under(mdp, np.array([1, 2])).reward.tolist()
    [1.0, 0.0]
    """
    chosen = np.zeros(mdp.n_pairs)
    chosen[pairs] = 1.0
    table = PolicyChain(mdp=mdp, chosen=chosen).table
    return mdp.with_(
        table=table, pair_state=mdp.pair_state[pairs], pair_action=mdp.pair_action[pairs]
    )


def cheap(mdp: MDP, cycle: int = EXACT_CYCLE) -> bool:
    """Return whether rational arithmetic is quick: few transitions, cycles of few states."""
    if mdp.n_transitions > (EXACT_TRANSITIONS if mdp.space.untimed is None else EXACT_IN_TIME):
        return False
    return is_acyclic(mdp) or int(np.bincount(components(mdp)[1]).max()) <= cycle


# ---- rational arithmetic -----------------------------------------------------------------------


def _certified(mdp: MDP, chain: PolicyChain, best: Certificate) -> Regret:
    single = len(chain.pairs) == mdp.n_states
    own = proven(under(mdp, chain.pairs)) if single else exact_policy(chain)
    optimal, gap = _gaps(mdp, best)
    return Regret(
        optimal=best.start,
        learned=Certified(value=own.start_value),
        at_start=Certified(value=best.start_value - own.start_value),
        optimal_value=best.value_float,
        learned_value=own.value_float,
        by_state=_differences(best, own),
        optimal_pairs=optimal,
        unclear=np.zeros(mdp.n_pairs, dtype=bool),
        gap=gap,
        optimum=best,
        forgiveness=_forgiveness(mdp, chain, own.value_float, best, lambda: list(own.value)),
    )


def _differences(best: Values, own: Values) -> Floats:
    """Return (S,) the exact differences of the values, each rounded once."""
    found = []
    for state, (a, c) in enumerate(zip(best.numerator, own.numerator, strict=True)):
        b = best.denominator[best.group[state]]
        d = own.denominator[own.group[state]]
        found.append((a * d - c * b) / (b * d))
    return np.array(found)


def _gaps(mdp: MDP, best: Certificate) -> tuple[Flags, Floats]:
    """Return which pairs are optimal, ties of floats included, and the gaps of the others."""
    near = gains(mdp, best.value_float)
    # The noise covers that the values are rounded, too.
    gap, doubt = -near.value, near.noise * SLACK + TINY
    optimal = np.array(best.optimal_pairs)
    others = ~optimal & ~mdp.terminal[mdp.pair_state]
    rough = others & (doubt > ACCURATE * gap)
    if of_floats(mdp):
        tie = _ties(mdp, best)
        with np.errstate(invalid="ignore"):
            equal = others & (gap + doubt <= tie.low)
            open_ = others & ~equal & ~(gap - doubt > tie.high)
        equal |= _exact_ties(mdp, best, tie, np.flatnonzero(open_))
        optimal |= equal
        rough &= ~equal
    for pair, (top, bottom) in exact_gaps(mdp, best, np.flatnonzero(rough).tolist()).items():
        gap[pair] = top / bottom
    return optimal, np.where(optimal, 0.0, np.maximum(gap, 0.0))


def _ties(mdp: MDP, best: Certificate) -> Range:
    """Return (L,) the gap up to which each pair ties with the best: what rounding can move."""
    value = best.value_float
    return _tie_range(mdp, value, UNIT * np.abs(value) + TINY, _best_chain(mdp, best))


def _tie_range(mdp: MDP, value: Floats, error: Floats, best: PolicyChain) -> Range:
    each = per_use(mdp, value, error)
    later = in_all(best, each)
    low, high = (
        here + mdp.discount * (mdp.transition @ after) + after[mdp.pair_state]
        for here, after in ((each.low, later.low), (each.high, later.high))
    )
    return Range(low=low / SLACK, high=high * SLACK)


def _exact_ties(mdp: MDP, best: Certificate, tie: Range, pairs: Integers) -> Flags:
    """Return (L,) which of some pairs tie with the best, decided in rational arithmetic."""
    found = np.zeros(mdp.n_pairs, dtype=bool)
    later: Sequence[Fraction] | None = None
    for pair, (top, bottom) in exact_gaps(mdp, best, pairs.tolist()).items():
        gap, low, high = Fraction(top, bottom), float(tie.low[pair]), float(tie.high[pair])
        if gap <= Fraction(low) or (isfinite(high) and gap > Fraction(high)):
            found[pair] = gap <= Fraction(low)
            continue
        if later is None:
            later = _exactly_in_all(_best_chain(mdp, best), best.value.tolist())
        limit = exactly_per_use(mdp, best.value.tolist(), pair)
        row = mdp.table.row(pair)
        limit += mdp.discount_exact * sum((p * later[t] for p, t, _ in row), Fraction(0))
        found[pair] = gap <= limit + later[int(mdp.pair_state[pair])]
    return found


# ---- what rounding can move ----------------------------------------------------------------------


def _best_chain(mdp: MDP, best: Certificate | Bounds) -> PolicyChain:
    """Return the chain of the first optimal action of every state."""
    if isinstance(best, Bounds):
        pairs = best.pairs
    else:
        numbers = np.where(best.optimal_pairs, np.arange(mdp.n_pairs), mdp.n_pairs)
        pairs = np.minimum.reduceat(numbers, mdp.pair_offsets[:-1])
    chosen = np.zeros(mdp.n_pairs)
    chosen[pairs] = 1.0
    return PolicyChain(mdp=mdp, chosen=chosen)


def _forgiveness(
    mdp: MDP,
    chain: PolicyChain,
    value: Floats,
    best: Certificate,
    exactly: Callable[[], list[Fraction]],
) -> Forgiveness:
    """Return what rounding can move at the start, for exact values that were rounded once."""
    if not of_floats(mdp):
        return Forgiveness(low=Fraction(0), high=Fraction(0))
    ideal = _best_chain(mdp, best)

    def part(of: PolicyChain, worth: Floats) -> Range:
        return in_all(of, per_use(mdp, worth, UNIT * np.abs(worth) + TINY), reached=True)

    def make() -> Fraction:
        total = Fraction(0)
        for of, values in ((chain, exactly()), (ideal, best.value.tolist())):
            moved = _exactly_in_all(of, values)
            total += sum((weight * moved[state] for state, weight in mdp.start), Fraction(0))
        return total

    low, high = bounds_at_start(mdp, part(chain, value), part(ideal, best.value_float))
    return Forgiveness(low=low, high=high, make=make)


def _exactly_in_all(chain: PolicyChain, value: Sequence[Fraction]) -> Sequence[Fraction]:
    """Return F (S,) of a policy as rationals, for its exact values."""
    mdp, earned = chain.mdp, [Fraction(0)] * chain.mdp.n_states
    for state in np.flatnonzero(~mdp.terminal).tolist():
        for pair, share in chain.exact_weights(state).items():
            earned[state] += share * exactly_per_use(mdp, value, pair)
    return exact_policy(chain, earned).value


# ---- bounds --------------------------------------------------------------------------------------


def _bounded(mdp: MDP, chain: PolicyChain, optimum: Bounds) -> Regret:
    own = evaluate(mdp, chain)
    value, single = optimum.value, len(chain.pairs) == mdp.n_states
    near = ActionBounds.of(mdp, optimum)
    best = at_start(mdp, FixedPoint(value=value, error=optimum.state_error))
    mine = own.start
    forgiveness, tie = _bounded_forgiveness(mdp, chain, own.value, own.error, optimum)
    loses = near.least_gap > tie
    lost: Certified | Bounded
    if near.all_best(chain):
        lost = Certified(value=Fraction(0))
    else:
        low = max(0.0, best.interval[0] - mine.interval[1])
        high = best.interval[1] - mine.interval[0]
        if single:
            high = min(high, _narrow(mdp, value, chain))
        difference = min(max(best.value - mine.value, low), max(high, low))
        error = max(difference - low, high - difference) * SLACK
        lost = Bounded(value=difference, error=error)
    return Regret(
        optimal=best,
        learned=mine,
        at_start=lost,
        optimal_value=value,
        learned_value=own.value,
        by_state=np.maximum(value - own.value, 0.0),
        optimal_pairs=~loses,
        unclear=~loses & (near.most_gap > 0),
        gap=np.where(loses, near.gap, 0.0),
        optimum=optimum,
        forgiveness=forgiveness,
    )


def _bounded_forgiveness(
    mdp: MDP, chain: PolicyChain, value: Floats, error: Floats, optimum: Bounds
) -> tuple[Forgiveness, Floats]:
    """Return what rounding can move at the start, of the policy's own part, and at most by pair."""
    if not of_floats(mdp):
        return Forgiveness(low=Fraction(0), high=Fraction(0)), np.zeros(mdp.n_pairs)
    ideal = _best_chain(mdp, optimum)
    tie = _tie_range(mdp, optimum.value, optimum.state_error, ideal)
    own = in_all(chain, per_use(mdp, value, error), reached=True)
    best = in_all(ideal, per_use(mdp, optimum.value, optimum.state_error), reached=True)
    low, _ = bounds_at_start(mdp, own)
    _, high = bounds_at_start(mdp, own, best)
    return Forgiveness(low=low, high=high), tie.high


def _optimum(mdp: MDP) -> Bounds:
    """Return bounds around the optimal values, as narrow as double precision allows."""
    # A solver may stop at its tolerance; the values of a policy have no error but rounding.
    found, _, _ = improved(mdp, solve(mdp).pairs, IMPROVEMENTS)
    return found


def _narrow(mdp: MDP, value: Floats, chain: PolicyChain) -> float:
    """Return an upper bound on the regret that is narrow where the policy is nearly optimal."""
    try:
        found = bounds(mdp, value, chain.pairs)
    except SolverError:
        return float("inf")
    return float((found.high - found.low) * (mdp.start_distribution @ found.weight) * SLACK)
