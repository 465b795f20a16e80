"""The stopping rule of all solvers that improve values: a proven bound, never a small change.

A search may stop once the bounds of its last pass are within the tolerance; then they are proven.
Often it is enough to widen them by the greatest rounding error of any pair; otherwise
`bound_optimal_values` counts rounding errors pair by pair. If bounds are as wide as rounding errors
and no longer narrow, double precision is at its limit. If bounds stay wide, this means nothing for
as many passes as there are states, as a pass carries values on by one transition (Haddad and
Monmege, Theoretical Computer Science 735, 2018, on why a small change proves nothing).
"""

from __future__ import annotations

from exact_mdp.solvers.bounds.bounds import Bounds, bound_optimal_values
from exact_mdp.solvers.claims import Status
from exact_mdp.solvers.dynamic.base import Solver, conclude_solution
from exact_mdp.solvers.dynamic.values import Values
from exact_mdp.solvers.solution import Solution

NEAR_ROUNDING = 20  # passes without progress that suffice if bounds are as wide as rounding errors
SLOW = 100  # passes without progress that call for equations


class StoppingRule:
    """Decides after each pass whether the search is over, and with which status and bounds.

    Parameters
    ----------
    values : Values
        The values that are improved.
    tol : float, optional
        The tolerance; a part of the greatest value if it is None.
    is_polished : bool
        Whether to find the values of the last policy as exactly as floats allow, so that tied
        actions show as ties: the search ends only with a policy that stays.
    """

    def __init__(self, values: Values, tol: float | None, *, is_polished: bool = False) -> None:
        self.values, self.tol, self.is_polished = values, tol, is_polished
        self.status: Status | None = None
        self.bounds: Bounds | None = None
        self.is_near = self.is_stalled = self.is_slow = False
        self._weight = float(values.weights.value.max(initial=0.0))
        self._limit = self._floor = 0.0
        self._was_near = False
        # The proven error in units of the error that the pass showed.
        self._proven_part = 1.0

    def is_reached(self) -> bool:
        """Return whether the search is over after the last pass."""
        self.measure()
        policy_stays = self.values.search.policy_stays
        may_stop = not self.is_polished or (self._was_near and policy_stays)
        if self.is_near and (self.is_stalled or may_stop):
            self.prove()
        else:
            self.give_up_if_hopeless()
        self._was_near = self._was_near or self.is_near
        return self.status is not None

    def measure(self) -> None:
        """Compare the bounds of the last pass with the tolerance and with rounding errors."""
        values = self.values
        half_gap = values.search.half_gap * self._weight
        self._floor = values.search.bound_rounding() * self._weight
        if self.tol is not None:
            self._limit = self.tol
        else:
            self._limit = values.default_tolerance()
        self.is_stalled = values.idle >= NEAR_ROUNDING and half_gap <= 4 * self._floor
        self.is_near = self._proven_part * half_gap <= self._limit or self.is_stalled

    def prove(self) -> None:
        """Prove the bounds, and set the status if the proven ones are near enough."""
        values = self.values
        self.bounds = None
        if self.tol is not None:
            self.bounds = values.prove_bounds()
        if self.bounds is None or self.bounds.error > self._limit:
            strict = self.tol is not None
            exact_count = bound_optimal_values(values.mdp, values.value, strict=strict)
            self.bounds = exact_count.centre_bounds()
        if self.bounds.error <= self._limit:
            self.status = Status.CONVERGED
        elif self.is_stalled and self.bounds.error <= 8 * self._floor:
            self.status = Status.PRECISION
        # A search that goes on is near only once its pass allows for what the proof adds.
        half_gap = values.search.half_gap * self._weight
        self._proven_part = 1.0
        if half_gap > 0:
            self._proven_part = self.bounds.error / half_gap

    def give_up_if_hopeless(self) -> None:
        """Set the status if the bounds have not fallen for very many passes."""
        if self.values.idle >= 2 * (SLOW + self.values.mdp.n_states):
            self.status = Status.NO_BOUND

    def needs_equations(self) -> bool:
        """Return whether passes bring so little that every second one should solve equations."""
        values = self.values
        self.is_slow = self.is_slow or values.idle >= SLOW
        return self.is_slow and values.passes % 2 == 1

    def choose_evaluation_tolerance(self) -> float:
        """Return the distance to which values should approach the policy's values, in units of w.

        It is a tenth of the least gap so far, and ever less while the gap does not fall; half of
        the tolerance if the policy stays; and 0, as near as floats allow, once the bounds are near.
        """
        values = self.values
        if self.is_near:
            return 0.0
        left = 0.0
        if not values.search.policy_stays:
            left = values.narrowest * 10.0 ** -max(1, values.idle - 3)
        return max(left, self._limit / 2 / (self._weight or 1.0))

    def conclude(self, solver: Solver, started: float) -> Solution:
        """Return the solution; raises SolverError if the search ended without a proof."""
        values = self.values
        status = self.status or Status.ITERATION_LIMIT
        bounds = self.bounds
        if bounds is None or status in (Status.ITERATION_LIMIT, Status.NO_BOUND):
            bounds = bound_optimal_values(values.mdp, values.value).centre_bounds()
        return conclude_solution(
            values.mdp,
            solver,
            bounds,
            status=status,
            iterations=values.passes,
            started=started,
        )
