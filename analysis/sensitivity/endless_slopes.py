"""Derivatives of a total reward at discount 1 where some policy never ends.

With V* the optimal values, each pair l of the Bellman equation's optimal ones earns

    c(l) = ∂r(l) + Σ_s' ∂P(l, s') V*(s') + ∂γ Σ_s' P(l, s') V*(s')

and the derivative on one side is the optimum, greatest or least, of the model that is left with
these pairs and earns c, over the policies that attain V*. A policy of them attains V* exactly where
it stays for ever only where V* is 0, or in the goal (`solvers.proof.endless`). Elsewhere, waiting
in an end component keeps V* and attains nothing: its states are merged into one, which has to be
left. V* is the same in all of them.

What is earned for ever changes by c. So the value is infinite beyond today's parameter where an end
component that can be reached has a pair with c above 0, which is refused, as are rewards that
cancel for ever and chances that rise from 0, which add end components or take them away.
Source: Milgrom and Segal, Econometrica 70, 2002; the optimum is that of finitely many policies.
"""

from __future__ import annotations

from fractions import Fraction
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.gate.regret import proven
from exact_mdp.analysis.sensitivity.derivatives import Checked, claimed, refuse_endless
from exact_mdp.mdp.chain import reachable
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.row_change import RowChange, reward_entries
from exact_mdp.solvers.endless.graph import Graph
from exact_mdp.solvers.solution import Certified

Mask = NDArray[np.bool_]


class EndlessPass:
    """The optimum of a model whose rows sum to 1, and the derivatives that it gives."""

    def __init__(self, mdp: MDP) -> None:
        self.mdp, self.certificate, self.graph = mdp, proven(mdp), Graph.of(mdp)
        self.value = self.certificate.value
        if not isfinite(self.certificate.start_value):
            raise ModelError(
                f"the optimal value is {'+' if self.certificate.start_value > 0 else '-'}∞, "
                "which has no derivative",
                where="the total reward at discount 1",
                fix="give a discount below 1, or a number of steps (--horizon N)",
            )
        finite = np.array([isfinite(v) for v in self.value])
        over = mdp.terminal if mdp.goal is None else mdp.terminal | mdp.goal
        self.ended = over | ~finite
        tied = np.array(self.certificate.optimal_pairs) & self.graph.every(finite)
        self.tied: Mask = tied & ~self.ended[mdp.pair_state]
        self.home = over.copy()
        if mdp.goal is None or mdp.unreached == 0:
            self.home |= np.array([v == 0 for v in self.value])
        _, self.inside = self.graph.end_components(self.tied)
        top = reward_entries(mdp)[1]
        self.seen = self.inside & reachable(mdp)[mdp.pair_state]
        for pair in np.flatnonzero(self.inside).tolist():
            if top[pair]:
                self._refuse("rewards cancel for ever, and may do so no longer", pair)

    @property
    def start(self) -> Certified:
        """The optimal value at the start."""
        return Certified(value=Fraction(self.certificate.start_value))

    def side(self, change: RowChange, sign: int) -> Certified | Checked:
        """Return the derivative on one side: sign 1 for the right one, -1 for the left one."""
        return claimed(sign * self._slope(change, sign), change)

    def _slope(self, change: RowChange, sign: int) -> Fraction:
        earned = self._earned(change)
        for pair in np.flatnonzero(self.seen).tolist():
            if sign * earned[pair] > 0:
                side = "above" if sign > 0 else "below"
                what = f"the value may be infinite {side} today's {change.name}: waiting would earn"
                self._refuse(what, pair)
        found = proven(self._merged([sign * gain for gain in earned])).start_value
        if not isfinite(found):
            raise ModelError(
                f"the value falls without end as {change.name} moves",
                where=f"parameter {change.name}",
                fix="give a discount below 1, or leave this parameter out (names=…, --parameter)",
            )
        return Fraction(found)

    def _earned(self, change: RowChange) -> list[Fraction]:
        """Return c of the pairs (L,) that are optimal, and 0 of the others."""
        mdp, earned = self.mdp, [Fraction(0)] * self.mdp.n_pairs
        if change.discount and mdp.goal is not None and abs(mdp.unreached) == inf:
            raise ModelError(
                "a run that misses its goal is infinite at discount 1 alone",
                where=f"parameter {change.name}",
                fix="leave it out (names=…, --parameter), or give a discount below 1",
            )
        for key, slope in zip(change.transition.key.tolist(), change.transition.slope, strict=True):
            pair, following = divmod(key, mdp.n_states)
            row = {to: p for p, to, _ in mdp.table.row(pair)}
            if not row.get(following):
                self._refuse(f"a chance is 0 today and moves with {change.name}", pair)
            if self.tied[pair]:
                earned[pair] += Fraction(slope) * self.value[following]
        for part in change.reward.coefficients[1:]:
            for key, bend in zip(change.reward.key.tolist(), part, strict=True):
                if bend and self.inside[key]:
                    self._refuse(f"a reward of waiting bends with {change.name}", key)
        for key, slope in zip(change.reward.key.tolist(), change.reward.slope, strict=True):
            if self.tied[key]:
                earned[key] += Fraction(slope)
            elif slope and mdp.terminal[mdp.pair_state[key]]:
                refuse_endless(mdp, [key], change.name)
        if change.discount:
            for pair in np.flatnonzero(self.tied).tolist():
                ahead = sum((p * self.value[to] for p, to, _ in mdp.table.row(pair)), Fraction(0))
                earned[pair] += Fraction(change.discount) * ahead
        return earned

    def _merged(self, earned: list[Fraction]) -> MDP:
        """Return the model of the tied pairs that earns some rewards (L,), waiting merged away."""
        mdp, free = self.mdp, np.array([not gain for gain in earned])
        waits = self.inside & free & ~self.home[mdp.pair_state]
        label, within = self.graph.end_components(waits)
        first = {int(number): int(np.argmax(label == number)) for number in np.unique(label)}
        rows: dict[int, list[tuple[Fraction, list[tuple[Fraction, int]]]]] = {}
        for state in range(mdp.n_states):
            owner = state if label[state] < 0 else first[int(label[state])]
            here = rows.setdefault(owner, [])
            if owner != state:
                rows[state] = [(Fraction(0), [(Fraction(1), owner)])]
            if self.ended[state]:
                here.append((Fraction(0), [(Fraction(1), state)]))
            for pair in mdp.pairs_of(state):
                if self.tied[pair] and not within[pair]:
                    here.append((earned[pair], [(p, to) for p, to, _ in mdp.table.row(pair)]))
        outcomes = [
            (state, action, [(p, to, gain) for p, to in row])
            for state in range(mdp.n_states)
            for action, (gain, row) in enumerate(rows[state])
        ]
        return MDP.from_outcomes(outcomes, start=dict(mdp.start))

    def _refuse(self, what: str, pair: int) -> None:
        raise ModelError(
            what,
            where=self.mdp.where(pair),
            fix="give a discount below 1, or leave this parameter out (names=…, --parameter)",
        )
