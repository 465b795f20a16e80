"""Linear programming: the least V above its own backup, and the visits that prove it least.

    primal   minimise α V     subject to   V(s) ≥ r(l) + γ P_l V     for every pair l of every s
    dual     maximise r y     subject to   Σ_{l of s} y(l) - γ Σ_l P(l, s) y(l) = α(s),   y ≥ 0

over the states that are not terminal; those have value 0. The weights α are positive and the same
everywhere, so that the primal gives the value of every state (d'Epenoux, Management Science 10,
1963; Puterman, Markov Decision Processes, 1994, section 6.9). What is returned as `occupancy` is
the dual's solution at α = the model's start: the visits of the optimal policy.

An optimiser is right to six or eight digits. The policy that it implies is evaluated, and improved
as in policy iteration where that shows it not to be optimal, so that the answer has rounding errors
alone; the optimiser's own objective is checked against it.

What comes out is a proof by weak duality: where V + c w satisfies all constraints of the primal
(see `solvers.bounds.bounds`), and y are the visits of a policy, which solve the equations of the
dual,

    Σ_l r(l) y(l)  ≤  optimal start value  ≤  Σ_s α(s) (V(s) + c w(s)),   α the start distribution.

Both sides are worked out apart, each with its rounding errors: see `Solution.program`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import extra, known
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.bounds import levels, margin_weights
from exact_mdp.solvers.bounds.gains import SLACK, UNIT, gains, gamma, rounding_facts
from exact_mdp.solvers.bounds.linear import FixedPoint, LinearSystem, policy_chain, transposed
from exact_mdp.solvers.dynamic.iterate import of_costs
from exact_mdp.solvers.dynamic.methods import PolicyIteration
from exact_mdp.solvers.solution import ProgramRun, Solution, SolverError, Status

OPTIMISERS = ("CLARABEL", "HIGHS")
AGREEMENT = 1e-5


@dataclass(frozen=True, kw_only=True)
class LinearProgram:
    """Solve by a linear program; adds the gap of every pair and the visits of the policy.

    Parameters
    ----------
    solver : "CLARABEL" or "HIGHS"
        Interior points, or a simplex method.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[1, 0], [0, 1]], [[0, 1], [0, 1]]], [[1, -1], [2, 1]], "1/2")
    >>> solution = LinearProgram().solve(mdp)
    >>> solution.value.tolist(), solution.gaps.tolist(), solution.occupancy.tolist()
    ([2.0, 4.0], [0.0, 1.0, 0.0, 1.0], [2.0, 0.0, 0.0, 0.0])
    """

    solver: str = "CLARABEL"

    name: ClassVar[str] = "linear-program"

    def __post_init__(self) -> None:
        known(self.solver, OPTIMISERS, "solver", "LinearProgram")

    @of_costs
    def solve(self, model: MDP) -> Solution:
        """Return the optimum up to rounding, with `gaps`, `occupancy` and `program`."""
        started = perf_counter()
        margin_weights(model)
        start, objective, steps = self._optimised(model)
        if not np.isfinite(start).all():
            raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
        solution = PolicyIteration(start=start).solve(model)
        if objective is not None:
            self._check(objective, model, solution.value)
        chain, alpha = policy_chain(model, solution.pairs)[0], model.start_distribution
        system = LinearSystem(chain, model.discount, order=levels(model))
        visits = transposed(system).solve(alpha, UNIT * alpha)
        lower, upper = _sides(model, solution, visits)
        occupancy = np.zeros(model.n_pairs)
        occupancy[solution.pairs] = np.where(model.terminal, 0.0, visits.value)
        return replace(
            solution,
            method=self.name,
            solver=repr(self),
            iterations=steps + solution.iterations,
            seconds=perf_counter() - started,
            gaps=0.0 - gains(model, solution.value).value,
            occupancy=occupancy,
            program=ProgramRun(
                by=self.solver,
                variables=int((~model.terminal).sum()),
                constraints=int((~model.terminal[model.pair_state]).sum()),
                steps=steps,
                lower=lower,
                upper=upper,
            ),
        )

    def _optimised(self, mdp: MDP) -> tuple[Floats, float | None, int]:
        """Return the optimiser's values (S,), their mean, and its steps."""
        with extra("lp"):
            import cvxpy
        live, scale = ~mdp.terminal, float(np.abs(mdp.reward).max())
        if scale == 0.0:
            return np.zeros(mdp.n_states), None, 0
        open_pairs = live[mdp.pair_state]
        own = sp.csr_array(
            (np.ones(mdp.n_pairs), mdp.pair_state, np.arange(mdp.n_pairs + 1)), mdp.transition.shape
        )
        matrix = sp.csc_array((own - mdp.discount * mdp.transition)[open_pairs][:, live])
        value, count = cvxpy.Variable(matrix.shape[1]), matrix.shape[1]
        above = matrix @ value >= mdp.reward[open_pairs] / scale
        problem = cvxpy.Problem(cvxpy.Minimize(np.full(count, 1 / count) @ value), [above])
        steps = optimised(problem, self.solver)
        values = np.zeros(mdp.n_states)
        values[live] = np.asarray(value.value) * scale
        return values, float(problem.value) * scale, steps

    def _check(self, objective: float, mdp: MDP, value: Floats) -> None:
        """Raise SolverError where the optimiser's mean is not that of the values (S,) reached."""
        reached, scale = float(value[~mdp.terminal].mean()), float(np.abs(mdp.reward).max())
        if not abs(objective - reached) <= AGREEMENT * (abs(reached) + scale):
            detail = f"{self.solver} found a mean value of {objective:.9g}, not {reached:.9g}"
            raise SolverError(Status.PROGRAM_FAILED, detail)


def optimised(problem: Any, solver: str) -> int:
    """Solve a program of cvxpy, and return the steps; SolverError where it finds no optimum."""
    with extra("lp"):
        import cvxpy
    try:
        # What cvxpy would warn of, an inaccurate solution, is an error here.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            problem.solve(solver=solver)
    except cvxpy.SolverError as error:
        raise SolverError(Status.PROGRAM_FAILED, f"{solver}: {error}") from error
    if problem.status != cvxpy.OPTIMAL:
        raise SolverError(Status.PROGRAM_FAILED, f"{solver} says {problem.status}")
    return int(problem.solver_stats.num_iters or 0)


def _sides(mdp: MDP, solution: Solution, visits: FixedPoint) -> tuple[float, float]:
    """Return lower and upper bound on the optimal start value, from visits and from values."""
    reward, facts = np.where(mdp.terminal, 0.0, mdp.reward[solution.pairs]), rounding_facts(mdp)
    below, size = float(reward @ visits.value), np.abs(visits.value)
    error = facts.reward_errors(mdp, 0, mdp.n_pairs)[solution.pairs]
    doubt = float(np.abs(reward) @ visits.error + error @ (size + visits.error))
    doubt += float(gamma(mdp.n_states + 2)) * float(np.abs(reward) @ size)
    return below - doubt * SLACK, solution.start.interval[1]
