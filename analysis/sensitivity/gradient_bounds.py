"""The same derivatives in floating point, with error bounds, for models too large for rationals.

With V and d each within e_V and e_d of the exact ones,

    |error| ≤ Σ_l [e_d |c| + (d + e_d) (γ Σ |∂P| e_V + |∂γ| Σ P e_V)] + rounding,

c being what a pair earns in `analysis.sensitivity.gradient_exact`. The derivative is that of the
optimum only where the policy is the only optimal one; gaps within the error bound count as ties,
and are refused.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from analysis.sensitivity.gradient_exact import refuse_endless
from analysis.sensitivity.gradient_result import Checked
from mdp.chain import reachable
from mdp.errors import ModelError
from mdp.model import MDP
from mdp.row_change import RowChange
from mdp.table import Floats, Numbers
from solvers import evaluate, solve
from solvers.bounds import gains
from solvers.policy_chain import PolicyChain
from solvers.rounding import SLACK, TINY, UNIT, gamma
from solvers.solution import Bounded
from solvers.visits import visits


class BoundedPass:
    """Value and occupancy of a policy in floats, and the derivatives that they give."""

    certificate = None

    def __init__(self, mdp: MDP, policy: object) -> None:
        self.mdp = mdp
        if isinstance(policy, str) and policy == "optimal":
            solution = solve(mdp)
            gain = gains(mdp, solution.value)
            tied = gain.value >= -2 * (solution.error_bound + gain.noise)
            _refuse_ties(mdp, tied)
            policy = solution
        self.found = evaluate(mdp, policy)
        self.chain: PolicyChain = self.found.chain
        live = ~np.isnan(self.found.value)
        self.value = np.where(live, self.found.value, 0.0)
        self.value_error = np.where(live, self.found.value_error, 0.0)
        seen = visits(mdp, self.chain.discounted)
        stay = 0.0 if mdp.discount_exact == 1 else 1 / (1 - mdp.discount)
        factor = np.where(mdp.terminal, stay, 1.0)[mdp.pair_state] * self.chain.weights
        self.uses = seen.value[mdp.pair_state] * factor
        rounding = float(gamma(8 + self.chain.roundings)) / max(1 - mdp.discount, UNIT)
        rounding = rounding if stay else float(gamma(4 + self.chain.roundings))
        self.doubt = seen.error[mdp.pair_state] * factor * SLACK + rounding * self.uses

    @property
    def start_value(self) -> Bounded:
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


def _refuse_ties(mdp: MDP, tied: np.ndarray) -> None:
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
