"""The best policy for the entropic risk of the return Z, its certainty equivalent ρ(Z).

    ρ(Z) = - log(E exp(-λ Z)) / λ,     λ > 0: risk is avoided,     λ < 0: it is sought.

With t = exp(-λ u), u the unit of rewards, E exp(-λ Z) = Σ_k P(Z = k u) t^k is a polynomial in t
(of negative powers, too), and with a policy that is best after every state,

    G_s = Σ p t^k G_s',     the least (λ > 0) or greatest (λ < 0) over the pairs of s,

and G = 1 at the end (Howard and Matheson, Risk-sensitive Markov decision processes, Management
Science 18, 1972): the state alone decides. t is transcendental for rational λ ≠ 0 (Lindemann), so
that two such numbers are equal only if their polynomials are, which is decided exactly; else
intervals (FLINT's arb) tell them apart at some precision. So the policy is exactly the best one,
and ρ is bounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.numbers import fraction, rational
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Integers, exact
from exact_mdp.solvers.risk.entropic_checker import entropic_violations
from exact_mdp.solvers.risk.lattice import Lattice
from exact_mdp.solvers.solution import Bounded, Claim
from exact_mdp.solvers.solver import mdp_of

if TYPE_CHECKING:
    from pandas import DataFrame

flint = later("flint")
pandas = later("pandas")

PRECISION, MOST_PRECISION = 128, 2**16  # bits


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class EntropicOptimum(Result):
    """A policy with the greatest certainty equivalent of the return.

    Attributes
    ----------
    mdp : MDP
        The model; with a horizon, that with the time in its states.
    aversion : Fraction
        λ.
    value : Bounded
        The certainty equivalent at the start.
    policy : (S,) int64
        Action numbers: the first of those that are best.
    optimal : (L,) bool
        All pairs that are best.
    returns : {return: probability}
        The exact distribution of the return under the policy.
    """

    mdp: MDP
    aversion: Fraction
    value: Bounded
    policy: Integers
    optimal: Any
    returns: dict[Fraction, Fraction]

    claim = Claim.BOUNDED

    def __repr__(self) -> str:
        return f"EntropicOptimum(λ = {float(self.aversion):.6g}: {self.value})"

    @property
    def mean(self) -> Fraction:
        """The expected return under the policy."""
        return sum((value * p for value, p in self.returns.items()), Fraction(0))

    def distribution(self) -> dict[Fraction, Fraction]:
        """Return the exact probability of every return under the policy, in rising order."""
        return dict(self.returns)

    def violations(self) -> list[str]:
        """Return what does not hold, in words: nothing where the policy is the best.

        The checker knows no solver, and compares pairs by fractions of its own.
        """
        sign = 1 if self.mdp.sense == "max" else -1
        middle, far = sign * Fraction(self.value.value), Fraction(self.value.error)
        return entropic_violations(
            Lattice.of(self.mdp),
            self.aversion,
            self.policy,
            self.optimal,
            (middle - far, middle + far),
            {sign * value: p for value, p in self.returns.items()},
        )

    def frame(self) -> DataFrame:
        """Return the action of each state."""
        names = [self.mdp.actions[action] for action in self.policy]
        labels = self.mdp.space.labels(range(self.mdp.n_states))
        return pandas.DataFrame({"state": labels, "action": names})


@dataclass(frozen=True, kw_only=True, eq=False)
class _Powers:
    """Σ c_k t^k for k from `low` on."""

    poly: Any
    low: int

    def aligned(self, low: int) -> Any:
        return self.poly * type(self.poly)([0] * (self.low - low) + [1])

    def equals(self, other: _Powers) -> bool:
        low = min(self.low, other.low)
        return bool(self.aligned(low) == other.aligned(low))

    def at(self, rate: Any) -> Any:
        """Return an interval around the number, for one around λ u."""
        poly, tilt = flint.arb_poly(self.poly), (-rate).exp()
        return poly(tilt) * (-rate * self.low).exp()


def best_entropic(
    model: MDP | Scenario, aversion: object, *, horizon: int | None = None
) -> EntropicOptimum:
    """Return the policy with the greatest certainty equivalent of the return.

    In a model of costs, with the least: log(E exp(λ Z)) / λ.

    Parameters
    ----------
    model : MDP or Scenario
        With discount 1 and without cycles, or with a horizon.
    aversion : number or "p/q"
        λ, for a unit of reward: above 0 to avoid risk, below 0 to seek it.
    horizon : int, optional
        Stop after so many steps.

    Returns
    -------
    EntropicOptimum

    Raises
    ------
    ModelError
        For other discounts, cycles, too many returns, and λ = 0.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 1, 10), ("1/2", 1, 0)]), (0, 1, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
    >>> mdp = MDP.from_outcomes(rows)
    >>> best_entropic(mdp, "1/100").policy.tolist(), best_entropic(mdp, 1).policy.tolist()
    ([0, 0], [1, 0])
    """
    mdp, tilt = mdp_of(model), exact(aversion)
    if tilt == 0:
        fix = "choose a number above 0 (risk is avoided) or below 0 (it is sought); without "
        fix += "aversion, solve() maximises the mean"
        raise ModelError("an aversion of 0", where="entropic risk", fix=fix)
    lattice = Lattice.of(mdp, horizon)
    worth = [_Powers(poly=flint.fmpq_poly([1]), low=0)] * lattice.mdp.n_states
    optimal = lattice.mdp.terminal[lattice.mdp.pair_state]
    rate = tilt * lattice.unit
    for state in lattice.order:
        low = lattice.low[state]
        every = [_ahead(lattice, pair, worth, low) for pair in lattice.pairs[state]]
        best = 0
        for k, each in enumerate(every):
            if _less(each, every[best], rate) if tilt > 0 else _less(every[best], each, rate):
                best = k
        worth[state] = every[best]
        for pair, each in zip(lattice.pairs[state], every, strict=True):
            optimal[pair] = each.equals(every[best])
    low = min(lattice.low[state] for state, _ in lattice.mdp.start)
    total = flint.fmpq_poly()
    for state, weight in lattice.mdp.start:
        total = total + worth[state].aligned(low) * rational(weight)
    pairs = np.flatnonzero(optimal)
    first = pairs[np.searchsorted(pairs, lattice.mdp.pair_offsets[:-1])]
    sign = 1 if mdp.sense == "max" else -1
    returns = {
        sign * lattice.unit * (low + k): fraction(c) for k, c in enumerate(total.coeffs()) if c
    }
    return EntropicOptimum(
        mdp=mdp if horizon is None else mdp.within(horizon),
        aversion=tilt,
        value=_equivalent(_Powers(poly=total, low=low), rate, tilt, sign),
        policy=lattice.mdp.pair_action[first],
        optimal=optimal,
        returns=dict(sorted(returns.items())),
    )


def _ahead(lattice: Lattice, pair: int, worth: list[_Powers], low: int) -> _Powers:
    weights, scale, ends = lattice.rows[pair]
    total = flint.fmpq_poly()
    for weight, (to, k) in zip(weights, ends, strict=True):
        total = total + worth[to].aligned(low - k) * weight
    return _Powers(poly=total / scale, low=low)


def _less(one: _Powers, other: _Powers, rate: Fraction) -> bool:
    """Whether a number is less than another, exactly."""
    if one is other or one.equals(other):
        return False
    low = min(one.low, other.low)
    gap = _Powers(poly=one.aligned(low) - other.aligned(low), low=low)
    before, bits = flint.ctx.prec, PRECISION
    try:
        while bits <= MOST_PRECISION:
            flint.ctx.prec = bits
            found = gap.at(flint.arb(rational(rate)))
            if found > 0 or found < 0:
                return bool(found < 0)
            bits *= 2
    finally:
        flint.ctx.prec = before
    raise ModelError(
        "two actions differ by less than intervals of 65,536 bits can tell",
        where="entropic risk",
        fix="choose an aversion nearer to 0",
    )


def _equivalent(mean: _Powers, rate: Fraction, tilt: Fraction, sign: int) -> Bounded:
    """Return - log(mean) / λ as a float and a bound on its error."""
    before = flint.ctx.prec
    try:
        flint.ctx.prec = 4 * PRECISION
        found = sign * -mean.at(flint.arb(rational(rate))).log() / flint.arb(rational(tilt))
        value = float(found.mid())
        return Bounded(
            value=value, error=float(abs(found - flint.arb(value)).upper()) * (1 + 2**-50)
        )
    finally:
        flint.ctx.prec = before
