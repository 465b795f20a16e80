"""Linear programming: the least V above its own backup, and the visits that prove it least.

    primal   minimise α V     subject to   V(s) ≥ r(l) + γ P_l V     for every pair l of every s
    dual     maximise r y     subject to   Σ_{l of s} y(l) - γ Σ_l P(l, s) y(l) = α(s),   y ≥ 0

over the states that are not terminal; those have value 0. The weights α are positive and the same
everywhere, so the primal gives the value of every state (d'Epenoux, Management Science 10,
1963; Puterman, Markov Decision Processes, 1994, section 6.9).

An optimiser is right to six or eight digits. Policy iteration starts from its values, so the answer
has rounding errors alone, and the optimiser's objective is compared with it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import require_extra, require_known_name
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.bounds import margin_weights
from exact_mdp.solvers.claims import SolverError, Status
from exact_mdp.solvers.dynamic.base import Solver
from exact_mdp.solvers.dynamic.methods import PolicyIteration
from exact_mdp.solvers.solution import Solution

OPTIMISERS = ("CLARABEL", "HIGHS")


@dataclass(frozen=True, kw_only=True)
class LinearProgram(Solver):
    """Solve by a linear program.

    Parameters
    ----------
    solver : "CLARABEL" or "HIGHS"
        Interior points, or a simplex method.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[1, 0], [0, 1]], [[0, 1], [0, 1]]], [[1, -1], [2, 1]], "1/2")
    >>> LinearProgram().solve(mdp).value.tolist()
    [2.0, 4.0]
    """

    solver: str = "CLARABEL"

    name: ClassVar[str] = "linear-program"

    def __post_init__(self) -> None:
        require_known_name(self.solver, OPTIMISERS, "solver", "LinearProgram")

    def maximise(self, model: MDP) -> Solution:
        """Return the optimum up to rounding."""
        started, live = perf_counter(), ~model.terminal
        margin_weights(model)  # raises an error if no bound is possible
        start, objective, steps = self._run_optimiser(model, live)
        if not np.isfinite(start).all():
            raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
        solution = PolicyIteration(start=start).maximise(model)
        reached = 0.0
        if live.any():
            reached = float(solution.value[live].mean())
        scale = abs(reached) + float(np.abs(model.reward).max())
        # Optimisers stop at 1e-8 of their scale. No value rests on this limit.
        if not abs(objective - reached) <= 1e-5 * scale:
            detail = f"{self.solver} found a mean value of {objective:.9g}, not {reached:.9g}"
            raise SolverError(Status.PROGRAM_FAILED, detail)
        return replace(
            solution,
            method=self.name,
            solver=repr(self),
            iterations=steps + solution.iterations,
            seconds=perf_counter() - started,
        )

    def _run_optimiser(self, mdp: MDP, live: np.ndarray) -> tuple[Floats, float, int]:
        """Return the optimiser's values (S,), their mean, and its steps."""
        values, scale = np.zeros(mdp.n_states), float(np.abs(mdp.reward).max())
        if scale == 0.0:
            return values, 0.0, 0
        open_pairs, count = live[mdp.pair_state], int(live.sum())
        matrix = (own_states(mdp) - mdp.discount * mdp.transition)[open_pairs][:, live]
        least = mdp.reward[open_pairs] / scale
        mean = np.full(count, 1 / count)
        values[live], steps = least_above(mean, matrix, least, self.solver)
        return values * scale, float(mean @ values[live]) * scale, steps


def own_states(mdp: MDP) -> sp.csr_array:
    """Return (L, S) a 1 for the state of each pair."""
    rows = np.ones(mdp.n_pairs), mdp.pair_state, np.arange(mdp.n_pairs + 1)
    return sp.csr_array(rows, mdp.transition.shape)


def least_above(cost: Floats, matrix: sp.sparray, least: Floats, solver: str) -> tuple[Floats, int]:
    """Return x that minimises cost · x subject to A x ≥ least, and the steps of the optimiser.

    Raises SolverError if it finds no optimum.
    """
    with require_extra("lp"):
        import cvxpy
    x = cvxpy.Variable(len(cost))
    above = sp.csc_array(matrix) @ x >= least
    problem: Any = cvxpy.Problem(cvxpy.Minimize(cost @ x), [above])
    try:
        # cvxpy would only warn of an inaccurate solution; here it is an error.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            problem.solve(solver=solver)
    except cvxpy.SolverError as error:
        raise SolverError(Status.PROGRAM_FAILED, f"{solver}: {error}") from error
    if problem.status != cvxpy.OPTIMAL:
        raise SolverError(Status.PROGRAM_FAILED, f"{solver} says {problem.status}")
    return np.asarray(x.value), int(problem.solver_stats.num_iters or 0)
