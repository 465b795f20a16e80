"""Values on their way to the optimum, and the steps that bring them nearer to it.

If no transition leads to an end (w = 1), values h need be right only up to a common constant, which
is held as the `level`: at the optimum the Bellman residual is T h - h = level instead of 0
(relative value iteration: White, J. Math. Anal. Appl. 6, 1963; bounds by MacQueen, J. Math. Anal.
Appl. 14, 1966). So h is as small as values differ, and loses no digits next to discount 1.
"""

from __future__ import annotations

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.bounds.bounds import Bounds
from exact_mdp.solvers.bounds.gains import RELATIVE_TOLERANCE
from exact_mdp.solvers.bounds.linear import LinearSystem, policy_chain
from exact_mdp.solvers.dynamic.bellman_pass import BellmanPass

NEARLY_ONE = 1 - 1e-7  # from this discount on, values are too large to be solved for as they are
PATIENCE = 5  # passes without progress, after which only the equations of a policy help


class Values:
    """Values h (S,) on their way to V*, with the bounds of the last pass around them.

    Attributes
    ----------
    value : (S,) floats
        The values h; `level` says which constant they share with V*.
    search : BellmanPass
        The last pass over all pairs: residual, greedy policy, bounds.
    passes, idle : int
        The number of passes, and of the last ones that narrowed the bounds by less than a tenth.
    narrowest : float
        The least half of the gap between bounds so far.
    """

    def __init__(self, mdp: MDP, value: Floats) -> None:
        self.mdp, self.value = mdp, value
        self.search = BellmanPass(mdp)
        self.weights, self.live = self.search.weights, self.search.live
        self.level = 0.0
        self.passes, self.idle, self.narrowest = 0, 0, np.inf
        self._last_step = value.copy()  # the values that the last step of this class left
        self._state_by_state = False
        self._solved: tuple[Integers, LinearSystem] | None = None

    # ---- passes over all pairs -----------------------------------------------------------------

    def pass_over_pairs(self) -> None:
        """Find the Bellman residual, a greedy policy and bounds on V* for the present values."""
        if not np.array_equal(self.value, self._last_step):
            self._state_by_state = True
        bottom, top = self._centre_values()
        self.search.run(self.value, bottom, top)
        self.passes += 1
        # A gap between bounds has to fall by a tenth to count as progress.
        if self.search.half_gap < 0.9 * self.narrowest:
            self.narrowest, self.idle = self.search.half_gap, 0
        else:
            self.idle += 1

    def _centre_values(self) -> tuple[float, float]:
        """Move a large common constant of the values into the level; return their range."""
        is_free = self.weights.uniform and self.live.any()
        values = self.value
        if is_free and self.mdp.terminal.any():
            values = values[self.live]
        bottom, top = float(values.min()), float(values.max())
        middle = (top + bottom) / 2
        if is_free and abs(middle) > top - bottom:
            self.value = self.live * (self.value - middle)
            self.level += self.search.facts.leak * middle
            return bottom - middle, top - middle
        return bottom, top

    def default_tolerance(self) -> float:
        """Return the tolerance if none was given: a part of the greatest value."""
        centre = self.search.low / 2 + self.search.high / 2
        largest = float(np.abs(self.value + centre * self.weights.value).max())
        return RELATIVE_TOLERANCE * max(1.0, largest)

    def prove_bounds(self) -> Bounds:
        """Return the bounds of the pass, widened by the greatest effect that rounding can have."""
        wide = self.search.bound_rounding()
        return Bounds(
            value=self.value,
            weight=self.weights.value,
            pairs=self.search.pairs,
            low=self.search.low - wide,
            high=self.search.high + wide,
        ).centre_bounds()

    # ---- steps ---------------------------------------------------------------------------------

    def apply_backup(self) -> None:
        """Move on to T h, at the level between the bounds.

        Once states have been improved one by one, their errors differ, and a change of level could
        bring back more error than a sweep removes.
        """
        if not self._state_by_state:
            self._set_level()
        self._add_to_values(self.search.residual - self.level)

    def sweep_states(self) -> None:
        """Improve one state after the other, upward and then downward in number (Gauss-Seidel).

        Each state sees what the states before it have become, so one sweep carries values
        along a whole chain of states.
        """
        from exact_mdp.solvers.kernels import bellman

        upward = np.arange(self.mdp.n_states)
        for order in (upward, upward[::-1]):
            bellman.relax_states(order, self.search.compiled_model, self.value, self.level)

    def solve_policy_equations(self, *, closely: bool = False) -> None:
        """Move on to the values of the greedy policy: h + x, where x - γ P_π x = T_π h - h.

        A remaining residual counts 1 / (1 - γ) times as much in values: if policies are improved by
        these equations alone, they are solved `closely`, or policies may cycle forever.
        """
        residual = self.policy_residual()
        is_near_one = NEARLY_ONE < self.mdp.discount < 1
        if self.weights.uniform and self.live.any() and is_near_one:
            margin = self.live * self.weights.margin
            self.correct_values(*self.policy_system.solve_relatively(residual, margin))
        else:
            self.correct_values(self.policy_system.solve_roughly(residual, closely=closely))

    def policy_residual(self) -> Floats:
        """Return T_π h - h (S,) of the greedy policy, beyond the level between the bounds."""
        self._set_level()
        return self.live * (self.search.residual - self.level)

    def correct_values(self, correction: Floats, constant: float = 0.0) -> None:
        """Add a correction (S,); if only differences matter, its middle goes into the level."""
        if self.weights.uniform:
            middle = float(correction.max() + correction.min()) / 2
            correction = correction - middle
            self.level += self.search.facts.leak * (middle + constant)
        self._add_to_values(correction)

    def _add_to_values(self, change: Floats) -> None:
        """Add to the values of all states that are not terminal."""
        self.value = self.value + self.live * change
        self._last_step = self.value.copy()

    def _set_level(self) -> None:
        """Set the level to the middle between the bounds, if only differences matter."""
        if self.weights.uniform:
            middle = self.search.low / 2 + self.search.high / 2
            self.level = middle * float(self.weights.margin[0])

    @property
    def policy_system(self) -> LinearSystem:
        """The linear equations of the greedy policy, made once for each policy."""
        if self._solved is None or not np.array_equal(self._solved[0], self.search.pairs):
            self._solved = None  # two systems at once would take twice the memory
            chain, _ = policy_chain(self.mdp, self.search.pairs)
            self._solved = self.search.pairs, LinearSystem(chain, self.mdp.discount)
        return self._solved[1]
