"""Derivatives of the start value on either side of a tie: in rationals, and in floats with bounds.

With V a policy's value and d its discounted occupancy, each pair l earns

    c(l) = ∂r(l) + γ Σ_s' ∂P(l, s') V(s') + ∂γ Σ_s' P(l, s') V(s'),        dV/dθ = Σ_l d(l) c(l).

Where several policies are optimal, the derivatives of V* on both sides are the optimum, greatest or
least, of the model that is left with optimal actions and earns c (see
`analysis.vary.curves.gradient`).

In floating point, with V and d each within e_V and e_d of the exact ones,

    |error| ≤ Σ_l [e_d |c| + (d + e_d) (γ Σ |∂P| e_V + |∂γ| Σ P e_V)] + rounding.

The derivative is that of the optimum only where the policy is the only optimal one; gaps within the
error bound count as ties, and are refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.gate.regret import proven
from exact_mdp.analysis.vary.curves.exact_chain import ExactChain
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import fraction, rational
from exact_mdp.mdp.graph import reachable
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.row_change import RowChange
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.table import Floats, Integers, Numbers, common, integers
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, gains, gamma
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.solution import Bounded, Certified, Claim
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.evaluate import evaluate
from exact_mdp.solvers.values.visits import visits

if TYPE_CHECKING:
    from flint import fmpq


@dataclass(frozen=True, kw_only=True)
class Checked:
    """An exact number that relies on an unproven degree of a polynomial.

    Attributes
    ----------
    value : Fraction
    points : int
        At this many values of the parameter the model is what the polynomial says.

    Examples
    --------
    >>> print(Checked(value=Fraction(4), points=6))
    4 (checked: the degree holds at 6 points, and is not proven)
    """

    value: Fraction
    points: int

    def __neg__(self) -> Checked:
        return Checked(value=-self.value, points=self.points)

    @property
    def claim(self) -> Claim:
        """Checked."""
        return Claim.CHECKED

    def __str__(self) -> str:
        text = str(Certified(value=self.value)).partition(" (")[0]
        return f"{text} ({self.claim}: the degree holds at {self.points} points, and is not proven)"


def claimed(value: Fraction, change: RowChange) -> Certified | Checked:
    """Return a derivative with what is proven of it: the degree of the change, or points alone."""
    if change.checked is None:
        return Certified(value=value)
    return Checked(value=value, points=change.checked)


class ExactPass:
    """Value and occupancy of a policy in rationals, and the derivatives that they give."""

    def __init__(self, mdp: MDP, policy: PolicyLike) -> None:
        self.mdp = mdp
        self.certificate: Certificate | None = None
        if isinstance(policy, str) and policy == "optimal":
            self.certificate = proven(mdp)
            policy = self.certificate.policy
        self.chain = ExactChain(mdp, policy)
        self.value = self.chain.values(self.chain.reward)
        self.uses = self.chain.uses()

    @property
    def start(self) -> Certified:
        """The policy's value at the start."""
        return Certified(
            value=sum((w * fraction(self.value[state]) for state, w in self.mdp.start), Fraction(0))
        )

    def side(self, change: RowChange, sign: int) -> Certified | Checked:
        """Return the derivative on one side: sign 1 for the right one, -1 for the left one."""
        return claimed(self._slope(change, sign), change)

    def _slope(self, change: RowChange, sign: int) -> Fraction:
        if self.certificate is None or self.certificate.unique:
            earned = self._earnings(change, [bool(use) for use in self.uses])
            total = sum((self.uses[pair] * gain for pair, gain in earned.items()), rational(0))
            return fraction(total)
        everything = self._earnings(change, [True] * self.mdp.n_pairs)
        gains = [Fraction(0)] * self.mdp.n_pairs
        for pair, gain in everything.items():
            gains[pair] = sign * fraction(gain)
        tied = _rewarded(self.mdp, np.flatnonzero(self.certificate.optimal_pairs), gains)
        return sign * Fraction(proven(tied).start_value)

    def _earnings(self, change: RowChange, wanted: Sequence[bool]) -> dict[int, fmpq]:
        """Return ∂r + γ ∂P V + ∂γ P V of the wanted pairs (L,), where it is not zero by rule."""
        mdp, chain, zero = self.mdp, self.chain, rational(0)
        found: dict[int, fmpq] = {}
        moved = zip(change.transition.key.tolist(), change.transition.slope, strict=True)
        for key, slope in moved:
            pair, following = divmod(key, mdp.n_states)
            if wanted[pair]:
                ahead = chain.rate * rational(slope) * self.value[following]
                found[pair] = found.get(pair, zero) + ahead
        for pair, slope in zip(change.reward.key.tolist(), change.reward.slope, strict=True):
            if wanted[pair] or mdp.terminal[mdp.pair_state[pair]]:
                found[pair] = found.get(pair, zero) + rational(slope)
        if change.discount:
            rate = rational(change.discount)
            for pair in range(mdp.n_pairs):
                if wanted[pair]:
                    ahead = rate * chain.ahead(pair, self.value)
                    found[pair] = found.get(pair, zero) + ahead
        if chain.whole:
            refuse_endless(mdp, [pair for pair, gain in found.items() if gain], change.name)
        return found


def refuse_endless(mdp: MDP, pairs: Sequence[int], name: str) -> None:
    """Raise ModelError where a parameter makes a terminal state earn, without end at discount 1."""
    for pair in pairs:
        if mdp.terminal[mdp.pair_state[pair]]:
            raise ModelError(
                "a terminal state would earn for ever",
                where=f"parameter {name}, {mdp.where(pair)}",
                fix="choose a discount below 1",
            )


def _rewarded(mdp: MDP, pairs: Integers, gains: Sequence[Fraction]) -> MDP:
    """Return the model that offers some of the pairs (K,) only and earns `gains` (L,) on them."""
    top, bottom = common([gains[pair] for pair in pairs.tolist()])
    return mdp.with_(
        table=replace(
            mdp.table.of_pairs(pairs),
            gain=integers(top),
            gain_denominator=integers([bottom] * len(pairs)),
            event=None,
        ),
        pair_state=mdp.pair_state[pairs],
        pair_action=mdp.pair_action[pairs],
        events=(),
    )


class BoundedPass:
    """Value and occupancy of a policy in floats, and the derivatives that they give."""

    def __init__(self, mdp: MDP, policy: PolicyLike) -> None:
        self.mdp = mdp
        if isinstance(policy, str) and policy == "optimal":
            solution = solve(mdp)
            gain = gains(mdp, solution.value)
            tied = gain.value >= -2 * (solution.error_bound + gain.noise)
            _refuse_ties(mdp, tied)
            policy = solution
        self.found = evaluate(mdp, policy)
        chain = self.found.chain
        live = ~np.isnan(self.found.value)
        self.value = np.where(live, self.found.value, 0.0)
        self.value_error = np.where(live, self.found.error, 0.0)
        seen = visits(mdp, chain.discounted)
        stay = 0.0 if mdp.discount_exact == 1 else 1 / (1 - mdp.discount)
        factor = np.where(mdp.terminal, stay, 1.0)[mdp.pair_state] * chain.weights
        self.uses = seen.value[mdp.pair_state] * factor
        rounding = float(gamma(8 + chain.roundings)) / max(1 - mdp.discount, UNIT)
        rounding = rounding if stay else float(gamma(4 + chain.roundings))
        self.doubt = seen.error[mdp.pair_state] * factor * SLACK + rounding * self.uses

    @property
    def start(self) -> Bounded:
        """The policy's value at the start."""
        return self.found.numbers["mean"]

    def side(self, change: RowChange, sign: int) -> Bounded | Checked:
        """Return the derivative; both sides are alike where one policy is optimal."""
        found = self._slope(change)
        if change.checked is None:
            return found
        return Checked(value=Fraction(found.value), points=change.checked)

    def _slope(self, change: RowChange) -> Bounded:
        mdp, rate = self.mdp, self.mdp.discount
        earned, size, off = np.zeros((3, mdp.n_pairs))
        pair, state = np.divmod(change.transition.key, mdp.n_states)
        slope = rate * _floats(change.transition.slope)
        np.add.at(earned, pair, slope * self.value[state])
        np.add.at(size, pair, np.abs(slope * self.value[state]))
        np.add.at(off, pair, np.abs(slope) * self.value_error[state])
        gain = _floats(change.reward.slope)
        np.add.at(earned, change.reward.key, gain)
        np.add.at(size, change.reward.key, np.abs(gain))
        if change.discount:
            growth = float(change.discount)
            earned += growth * (mdp.transition @ self.value)
            size += abs(growth) * (mdp.transition @ np.abs(self.value))
            off += abs(growth) * (mdp.transition @ self.value_error)
        if mdp.discount_exact == 1:
            refuse_endless(mdp, np.flatnonzero(size).tolist(), change.name)
        terms = int(np.diff(mdp.transition.indptr).max()) * 2 + mdp.n_pairs + 8
        used = self.uses + self.doubt
        error = self.doubt @ size + used @ off + float(gamma(terms)) * (used @ size)
        return Bounded(value=float(self.uses @ earned), error=float(error * SLACK + TINY * terms))


def _floats(numbers: Numbers) -> Floats:
    return np.array([float(number) for number in numbers], dtype=np.float64)


def _refuse_ties(mdp: MDP, tied: NDArray[np.bool_]) -> None:
    """Raise ModelError unless every state that optimal pairs reach has one of them."""
    several = np.add.reduceat(tied, mdp.pair_offsets[:-1], dtype=np.int64) != 1
    seen = reachable(mdp, pairs=tied) & ~mdp.terminal
    if (several & seen).any():
        state = int(np.flatnonzero(several & seen)[0])
        raise ModelError(
            "several actions are optimal, or floats cannot tell them apart",
            where=f"state ({mdp.space.label(state)})",
            fix="ask for exact=True, which gives one-sided derivatives at a tie",
        )
