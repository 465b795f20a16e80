"""How much a policy loses against the optimum: exactly where that is cheap, else within bounds.

    regret(s) = V*(s) - V^π(s) = Σ_s' d_s(s') gap(s', π(s')),    gap(s, a) = V*(s) - Q*(s, a)

with d_s the discounted visits of π that begins in s. V* comes with a certificate that its checker
has accepted. So does V^π, because the model in which every state offers only what a deterministic
policy takes there has that for an optimum. Mixed policies, large models and long cycles are bounded
in floating point instead: V* ≤ V + c w and V^π ≥ V + c' w as in `solvers.bounds`, which is narrow
where little is lost, or the two values, each with its error.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from analysis.proven_optimum import proven
from mdp.chain import components, is_acyclic
from mdp.errors import ModelError
from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers import solve
from solvers.bounds import Bounds, bounds, gains
from solvers.certificate import Certificate
from solvers.evaluation import evaluate
from solvers.linear import FixedPoint
from solvers.policy_chain import PolicyChain
from solvers.policy_iteration import improved
from solvers.rounding import SLACK
from solvers.solution import Bounded, Certified, Claim, SolverError
from solvers.visits import at_start

Flags = NDArray[np.bool_]
EXACT_TRANSITIONS = 100_000
EXACT_IN_TIME = 250_000  # of a model of episodes that stop: no cycle, a stage for each time
EXACT_CYCLE = 64  # states of the largest cycle
ROUNDING = 1e-12  # of max(1, |V|): gaps of a model of floats that are smaller are ties
UNDECIDED = 1e-8  # of max(1, |V|): wider bounds show nothing about a regret of zero
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
        Optimal pairs: all and only these where certified, up to the error bound where bounded; in
        a model of floats, up to rounding.
    gap : (L,)
        What a pair falls short of the optimum, 0 for optimal pairs.
    tie : float
        Gaps up to this count as none.
    optimum : Certificate or Bounds
        What vouches for the optimal values.
    """

    optimal: Certified | Bounded
    learned: Certified | Bounded
    at_start: Certified | Bounded
    optimal_value: Floats
    learned_value: Floats
    by_state: Floats
    optimal_pairs: Flags
    gap: Floats
    tie: float
    optimum: Certificate | Bounds

    @property
    def claim(self) -> Claim:
        """Certified or bounded."""
        return self.at_start.claim

    def decided(self, limit: Fraction) -> bool | None:
        """Return whether the regret is at most `limit`; None where the bounds do not tell."""
        if isinstance(self.at_start, Certified):
            return self.at_start.value <= limit
        low, high = self.at_start.interval
        if Fraction(high) <= limit:
            return True
        return False if Fraction(low) > limit else None

    @property
    def zero(self) -> bool:
        """True where the regret is zero up to rounding."""
        low, high = self.at_start.interval
        if isinstance(self.at_start, Certified):
            return self.at_start.value <= Fraction(self.tie)
        scale = max(1.0, float(np.abs(self.optimal_value).max()))
        return low <= ROUNDING * scale and high <= UNDECIDED * scale


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
        Rational arithmetic or bounds; unless given, rational arithmetic for deterministic policies
        in models of up to 100,000 transitions (250,000 with a horizon) without cycles of over 64
        states.
    optimum : Certificate or Bounds, optional
        What another policy's regret was found with; unless `exact` is given, this says how.

    Raises
    ------
    ModelError
        At discount 1 where not every policy ends; for exact values of a mixed policy.

    Examples
    --------
    >>> stay, move = [["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]
    >>> mdp = MDP.from_arrays([stay, move], [[1, 1], [0, 0]])
    >>> found = regret(mdp, PolicyChain.of(mdp, np.array([1, 0])))
    >>> print(found.at_start, found.gap.tolist())
    1 (certified) [0.0, 1.0, 0.0, 0.0]
    """
    single = len(chain.pairs) == mdp.n_states
    if exact is None:
        exact = single and (_cheap(mdp) if optimum is None else isinstance(optimum, Certificate))
    if not exact:
        known = optimum if isinstance(optimum, Bounds) else _optimum(mdp)
        return _bounded(mdp, chain, known, single=single)
    if not single:
        raise ModelError(
            "exact values are for deterministic policies", where="policy", fix="ask for bounds"
        )
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


def _cheap(mdp: MDP) -> bool:
    if mdp.n_transitions > (EXACT_TRANSITIONS if mdp.space.untimed is None else EXACT_IN_TIME):
        return False
    return is_acyclic(mdp) or int(np.bincount(components(mdp)[1]).max()) <= EXACT_CYCLE


def _certified(mdp: MDP, chain: PolicyChain, best: Certificate) -> Regret:
    own = proven(under(mdp, chain.pairs))
    tie = _tie(mdp, best.value_float)
    gap = -gains(mdp, best.value_float).value
    optimal = best.optimal_pairs | (gap <= tie if tie else False)
    return Regret(
        optimal=best.start,
        learned=own.start,
        at_start=Certified(value=best.start_value - own.start_value),
        optimal_value=best.value_float,
        learned_value=own.value_float,
        by_state=_differences(best, own),
        optimal_pairs=optimal,
        gap=np.where(optimal, 0.0, np.maximum(gap, 0.0)),
        tie=tie,
        optimum=best,
    )


def _differences(best: Certificate, own: Certificate) -> Floats:
    """Return (S,) the exact differences of the values, each rounded once."""
    found = []
    for state, (a, c) in enumerate(zip(best.numerator, own.numerator, strict=True)):
        b = best.denominator[best.group[state]]
        d = own.denominator[own.group[state]]
        found.append((a * d - c * b) / (b * d))
    return np.array(found)


def _bounded(mdp: MDP, chain: PolicyChain, optimum: Bounds, *, single: bool) -> Regret:
    own = evaluate(mdp, chain)
    value, gain = optimum.value, gains(mdp, optimum.value)
    tie = 2 * optimum.error + float(gain.noise.max())
    optimal = gain.value >= -tie
    best = at_start(mdp, FixedPoint(value=value, error=optimum.state_error))
    mine = Bounded(value=own.mean, error=own.error_bound)
    low = max(0.0, best.interval[0] - mine.interval[1])
    high = best.interval[1] - mine.interval[0]
    if single:
        high = min(high, _narrow(mdp, value, chain))
    difference = min(max(best.value - mine.value, low), max(high, low))
    error = max(difference - low, high - difference) * SLACK
    return Regret(
        optimal=best,
        learned=mine,
        at_start=Bounded(value=difference, error=error),
        optimal_value=value,
        learned_value=own.value,
        by_state=np.maximum(value - own.value, 0.0),
        optimal_pairs=optimal,
        gap=np.where(optimal, 0.0, -gain.value),
        tie=tie,
        optimum=optimum,
    )


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


def _tie(mdp: MDP, value: Floats) -> float:
    floats = np.float64 in (mdp.table.weight.dtype, mdp.table.gain.dtype)
    return ROUNDING * max(1.0, float(np.abs(value).max())) if floats else 0.0
