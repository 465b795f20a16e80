"""What all solvers share: their interface, the values to begin with, and the stopping rule.

A search begins with zeros, given values, or the values of a given policy. It may stop once the
bounds of its last pass are within the tolerance; then they are proven, so a small change alone
never ends it (Haddad and Monmege, Theoretical Computer Science 735, 2018, on why a small change
proves nothing). Often it is enough to widen bounds by the greatest rounding error of any pair;
otherwise `bound_optimal_values` counts rounding errors pair by pair. If bounds are as wide as
rounding errors and no longer narrow, double precision is at its limit. If bounds stay wide, this
means nothing for as many passes as there are states, as a pass carries values on by one transition.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from numbers import Real
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from exact_mdp.mdp.errors import ModelError, ShapeError, locate_errors, require_type
from exact_mdp.mdp.forms.numbers import refuse_masked
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import Floats
from exact_mdp.mdp.validate import require_count
from exact_mdp.solvers.bounds.bounds import Bounds, bound_optimal_values, evaluate_pairs
from exact_mdp.solvers.claims import SolverError, Status, warn_of_precision
from exact_mdp.solvers.dynamic.values import Values
from exact_mdp.solvers.solution import Solution, answer_maximised


class Solver(ABC):
    """An algorithm with its settings, and the one verb."""

    name: ClassVar[str]

    def solve(self, model: MDP) -> Solution:
        """Return optimal values, a policy and their error bounds; see `solvers.solve`."""
        require_type(model, MDP, "model", "give an MDP")
        solution = answer_maximised(model, self.solve_rewards)
        if solution.status is Status.PRECISION:
            warn_of_precision(solution.error_bound)
        return solution

    def solve_rewards(self, model: MDP) -> Solution:
        """Return the solution of a model whose sense is "max"; its status alone tells of `tol`."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self.maximise(model)

    @abstractmethod
    def maximise(self, model: MDP) -> Solution:
        """Return the greatest values of a model whose sense is "max"."""


def conclude_solution(
    mdp: MDP, solver: Solver, bounds: Bounds, *, status: Status, iterations: int, started: float
) -> Solution:
    """Return the solution, whose status says whether the tolerance is met.

    Raises
    ------
    SolverError
        If the solver gave up; the error holds the solution that it had reached.
    """
    solution = Solution(
        mdp=mdp,
        value=np.array(bounds.value),
        pairs=bounds.pairs,
        state_error=bounds.state_error,
        regret_bound=bounds.regret,
        status=status,
        method=solver.name,
        solver=repr(solver),
        iterations=iterations,
        seconds=perf_counter() - started,
    )
    if status in (Status.ITERATION_LIMIT, Status.NO_BOUND):
        detail = f"{solution.error_bound:.2g} is the error bound after {iterations} iterations"
        raise SolverError(status, detail, solution)
    return solution


def check_tolerance(where: str, tol: Any) -> None:
    """Raise ModelError unless a tolerance is None or a positive, finite number."""
    number = isinstance(tol, Real) and not isinstance(tol, bool)
    if tol is not None and not (number and 0 < tol < np.inf):
        if number:
            shown = tol
        else:
            shown = repr(tol)
        raise ModelError(f"tol is {shown}", where=where, fix="choose a positive number, or None")


def check_counts(where: str, **counts: Any) -> None:
    """Raise ModelError unless every count is a whole number from 1 up; True is not one."""
    with locate_errors(where):
        for key, count in counts.items():
            require_count(count, key)


# ---- the start -----------------------------------------------------------------------------------


def read_start_values(mdp: MDP, start: Any) -> Floats:
    """Return the values (S,) to begin with: given values, or the values of a given policy."""
    if start is None:
        return np.zeros(mdp.n_states)
    value = given_values(mdp, start)
    if value is None:
        policy = Policy.of(mdp, start)
        if not policy.deterministic:
            raise ModelError(
                "the policy is mixed: it draws its actions",
                where="start",
                fix="give a solution of this model, a deterministic policy, or an action number "
                "for each state",
            )
        return evaluate_pairs(mdp, np.flatnonzero(policy.weights(mdp)))
    return np.where(mdp.terminal, 0.0, value)


def given_values(mdp: MDP, start: Any) -> Floats | None:
    """Return the values (S,) of a solution or an array of floats; None for anything else."""
    refuse_masked(start, "start")
    if isinstance(start, Solution):
        start = start.value
    if isinstance(start, list | tuple) and start and all(isinstance(x, float) for x in start):
        start = np.array(start)
    if not (isinstance(start, np.ndarray) and start.dtype.kind == "f" and start.ndim == 1):
        return None
    if start.shape != (mdp.n_states,) or not np.isfinite(start).all():
        raise ShapeError(
            f"values of shape {start.shape}, or not finite, for {mdp.n_states} states",
            where="start",
            fix="give one finite float for each state, or a policy",
        )
    return np.asarray(start, dtype=np.float64)


def orient_start(mdp: MDP, start: Any) -> Any:
    """Return the start for maximised rewards: values of costs negated, a policy unchanged."""
    if not mdp.sense.costs:
        return start
    if isinstance(start, Solution):
        return start.policy
    if start is None:
        return None
    value = given_values(mdp, start)
    if value is None:
        return start
    return -value


# ---- the end -------------------------------------------------------------------------------------

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
