"""The evaluation step of modified policy iteration, done in the cheapest way.

In a small model the equations of the policy are solved. In a large model the policy is swept as
long as its chain mixes fast. If it mixes slowly, states are improved one by one, until this has
taken as much time as a solution of the equations, which are then solved: most policies on the way
are soon improved upon, and need no solution of their own.
"""

from __future__ import annotations

import numpy as np

from exact_mdp.solvers.bounds.gains import UNIT
from exact_mdp.solvers.bounds.linear import sweep_system
from exact_mdp.solvers.dynamic.values import PATIENCE, Values

# Transitions, 12 MB: beyond a cache, rows are read twice as fast side by side, measured; below, a
# copy would save no time, and take memory.
CACHED = 1_000_000
PRICE = 2000  # sweeps that take the time of a policy's equations, if no band tells it
# Multiplications within a band that take the time of a transition; measured: without this price,
# queues and inventories take 2 to 5 times as long.
BAND = 8


class PolicyEvaluation:
    """Brings values near to the values of their greedy policy."""

    def __init__(self, values: Values) -> None:
        mdp = values.mdp
        self.values = values
        self.mixes_slowly = False
        # Work is counted in transitions that are looked at, since the last solution of equations.
        self.price = PRICE * mdp.n_transitions / mdp.n_pairs * mdp.n_states
        self._passes_paid, self._sweeps = 0, 0

    def run(self, tolerance: float) -> None:
        """Bring values near to the policy's values, or nearer to V* for less than that costs.

        Parameters
        ----------
        tolerance : float
            The residual at which sweeps end, in units of w; 0 for the policy's exact values.
        """
        values = self.values
        if not values.search.is_large:
            values.solve_policy_equations()
            return
        if not self.mixes_slowly:
            if self._sweep_policy(tolerance):
                return
            self.mixes_slowly = True
            self.price = values.policy_system.work / BAND or self.price
        # A policy that no longer changes, while bounds hardly fall, is solved for at once.
        policy_stays = values.search.policy_stays
        is_due = self._work() >= self.price or (policy_stays and values.idle > 0) or tolerance == 0
        if is_due:
            values.solve_policy_equations()
            self._passes_paid, self._sweeps = values.passes, 0
            self.price = values.policy_system.work / BAND or self.price
        else:
            values.apply_backup()
        if not is_due or (not policy_stays and values.idle >= PATIENCE):
            values.sweep_states()
            self._sweeps += 1

    def _sweep_policy(self, tolerance: float) -> bool:
        """Sweep the policy until its residual is within the tolerance; return whether it is."""
        values, mdp = self.values, self.values.mdp
        enough = tolerance * values.weights.smallest
        # Up to rounding, these are the exact values.
        fine = 0.0
        if tolerance == 0:
            fine = 8 * UNIT
        is_closed = values.weights.uniform and bool(values.live.all())
        matrix, rows = mdp.transition, values.search.pairs
        if mdp.n_transitions > CACHED:
            matrix, rows = values.policy_system.transition, np.arange(mdp.n_states)
        residual = values.policy_residual()
        correction, succeeded = sweep_system(
            matrix, rows, mdp.discount, residual, is_closed, enough, fine
        )
        if succeeded:
            values.correct_values(correction)
        return succeeded

    def _work(self) -> float:
        """Return the transitions looked at since the last solution: 2 a pass, 4 a double sweep."""
        passes = self.values.passes - self._passes_paid
        return self.values.mdp.n_transitions * (2 * passes + 4 * self._sweeps)
