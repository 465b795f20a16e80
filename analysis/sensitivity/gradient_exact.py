"""Derivatives of the start value in rationals, on either side of a tie.

With V a policy's value and d its discounted occupancy, each pair l earns

    c(l) = ∂r(l) + γ Σ_s' ∂P(l, s') V(s') + ∂γ Σ_s' P(l, s') V(s'),        dV/dθ = Σ_l d(l) c(l).

Where several policies are optimal, the derivatives of V* on both sides are the optimum, greatest or
least, of the model that is left with optimal actions and earns c (see
`analysis.sensitivity.gradient`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from analysis.proven_optimum import proven
from analysis.sensitivity.exact_chain import ExactChain, fraction, rational
from analysis.sensitivity.gradient_result import Checked, claimed
from analysis.sensitivity.rational_rows import worth
from mdp.errors import ModelError
from mdp.model import MDP
from mdp.row_change import RowChange
from mdp.table import common, integers
from solvers.solution import Certified

if TYPE_CHECKING:
    from flint import fmpq

    from solvers.certificate import Certificate


class ExactPass:
    """Value and occupancy of a policy in rationals, and the derivatives that they give."""

    def __init__(self, mdp: MDP, policy: object) -> None:
        self.mdp = mdp
        self.certificate: Certificate | None = None
        if isinstance(policy, str) and policy == "optimal":
            self.certificate = proven(mdp)
            policy = self.certificate.policy
        self.chain = ExactChain(mdp, policy)
        self.value = self.chain.values(self.chain.reward)
        self.uses = self.chain.uses(self.chain.visits)
        self.used = [bool(use) for use in self.uses]

    @property
    def start_value(self) -> Certified:
        """The policy's value at the start."""
        pairs = zip(self.chain.start, self.value, strict=True)
        return Certified(value=fraction(sum((m * v for m, v in pairs), rational(0))))

    def side(self, change: RowChange, sign: int) -> Certified | Checked:
        """Return the derivative on one side: sign 1 for the right one, -1 for the left one."""
        return claimed(self._slope(change, sign), change.checked)

    def _slope(self, change: RowChange, sign: int) -> Fraction:
        if self.certificate is None or self.certificate.unique:
            earned = earnings(self.chain, change, self.value, self.used)
            return fraction(worth(self.uses, earned))
        mdp, optimal = self.mdp, self.certificate.optimal_pairs
        everything = earnings(self.chain, change, self.value)
        gains = [sign * fraction(everything.get(pair, rational(0))) for pair in range(mdp.n_pairs)]
        tied = rewarded(mdp, np.flatnonzero(optimal), gains)
        return sign * proven(tied).start_value


def earnings(
    chain: ExactChain,
    change: RowChange,
    value: Sequence[fmpq],
    wanted: Sequence[bool] | None = None,
) -> dict[int, fmpq]:
    """Return ∂r + γ ∂P V + ∂γ P V of the wanted pairs (L,), where it is not zero by rule."""
    mdp = chain.mdp
    wanted = [True] * mdp.n_pairs if wanted is None else wanted
    found: dict[int, fmpq] = {}
    zero = rational(0)
    pair, state = np.divmod(change.transition.key, mdp.n_states)
    for row, following, slope in zip(
        pair.tolist(), state.tolist(), change.transition.slope, strict=True
    ):
        if wanted[row]:
            found[row] = found.get(row, zero) + rational(slope) * value[following]
    found = {row: chain.rate * gain for row, gain in found.items()}
    for row, slope in zip(change.reward.key.tolist(), change.reward.slope, strict=True):
        if wanted[row] or mdp.terminal[mdp.pair_state[row]]:
            found[row] = found.get(row, zero) + rational(slope)
    if change.discount:
        rate = rational(change.discount)
        for row in range(mdp.n_pairs):
            if wanted[row]:
                found[row] = found.get(row, zero) + rate * chain.ahead(row, value)
    if chain.whole:
        refuse_endless(mdp, [row for row, gain in found.items() if gain], change.name)
    return found


def refuse_endless(mdp: MDP, rows: Sequence[int], name: str) -> None:
    """Raise ModelError where a parameter makes a terminal state earn, without end at discount 1."""
    for row in rows:
        if mdp.terminal[mdp.pair_state[row]]:
            raise ModelError(
                "a terminal state would earn for ever",
                where=f"parameter {name}, {mdp.where(row)}",
                fix="choose a discount below 1",
            )


def rewarded(mdp: MDP, pairs: np.ndarray, gains: Sequence[Fraction]) -> MDP:
    """Return the model that offers some of the pairs (K,) only and earns `gains` (L,) on them."""
    top, bottom = common([gains[pair] for pair in pairs.tolist()])
    return mdp.with_(
        table=replace(
            mdp.table.of_pairs(pairs),
            gain=integers(top),
            gain_denominator=integers([bottom] * len(pairs)),
            event=None,
            gain_doubt=None,
        ),
        pair_state=mdp.pair_state[pairs],
        pair_action=mdp.pair_action[pairs],
        events=(),
    )
