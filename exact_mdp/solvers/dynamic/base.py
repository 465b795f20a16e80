"""The interface of all solvers, and their common parts: checks of settings, and the answer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from numbers import Real
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from exact_mdp.mdp.errors import ModelError, locate_errors, require_type
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.validate import require_count
from exact_mdp.solvers.bounds.bounds import Bounds
from exact_mdp.solvers.claims import SolverError, Status, warn_of_precision
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
