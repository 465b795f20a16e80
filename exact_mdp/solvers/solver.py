"""The function `solve`, and the list of solvers.

A solver is an object with a `name` and a method `solve(model)`; `solvers.dynamic` says how to add
one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, named_options, require_known_name
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import COMPILED
from exact_mdp.solvers.arguments import (
    is_average,
    mdp_of,
    require_average_applies,
    require_no_horizon,
)
from exact_mdp.solvers.claims import SolverError, Status, warn_of_precision
from exact_mdp.solvers.dynamic.base import Solver, check_tolerance
from exact_mdp.solvers.dynamic.linear_program import LinearProgram
from exact_mdp.solvers.dynamic.methods import (
    BackwardInduction,
    GaussSeidel,
    ModifiedPolicyIteration,
    PolicyIteration,
    ValueIteration,
)
from exact_mdp.solvers.dynamic.start import orient_start
from exact_mdp.solvers.endless.average import solve_average
from exact_mdp.solvers.endless.total import round_exact_solution, solve_total
from exact_mdp.solvers.objectives.limits import solve_under
from exact_mdp.solvers.solution import Solution, answer_maximised
from exact_mdp.solvers.ties import break_near_ties

SOLVERS: dict[str, type[Solver]] = {
    "value-iteration": ValueIteration,
    "gauss-seidel": GaussSeidel,
    "modified-policy-iteration": ModifiedPolicyIteration,
    "policy-iteration": PolicyIteration,
    "backward-induction": BackwardInduction,
    "linear-program": LinearProgram,
}


@named_options
def solve(
    model: MDP | Scenario,
    solver: Any = "auto",
    *,
    tol: float | None = None,
    horizon: int | None = None,
    terminal_value: Any = None,
    start: Any = None,
    criterion: str = "total",
    subject_to: Mapping[str, Any] | None = None,
) -> Any:
    """Return optimal values and a policy, with bounds on their error.

    The optimal value is the greatest, or the least if the model's sense is "min". At discount 1 a
    value is infinite if the rewards of policies have no bound; a policy may go on forever.

    Parameters
    ----------
    model : MDP or Scenario
        A scenario is compiled.
    solver : Solver or str
        A solver with its settings, or a name in `SOLVERS`; "auto" takes backward induction for
        models without cycles and modified policy iteration for others.
    tol : float, optional
        Greatest absolute error in any state, for a solver with this setting. Backward induction, if
        "auto" takes it, is as exact as floats allow; it warns if that is not enough.
    horizon : int, optional
        Stop after this many steps: solve `mdp.within(horizon)`, whose states are pairs of a time
        and a state.
    terminal_value : (S,) numbers or {state: number}, optional
        The value of each state when the horizon is reached, 0 by default; see `mdp.within`.
    start : a solution, (S,) floats or PolicyLike, optional
        Values near the optimum, or a policy, as a warm start, for example from a similar model. It
        changes neither the optimum nor the validity of the bounds, nor the start distribution or
        terminal values. Models without cycles, and models with a policy that never ends, ignore it.
    criterion : "total" or "average"
        The criterion of optimality: the total reward with the model's discount, or the average
        reward per step in the long run, whatever the discount. Averages are found by policy
        iteration, by relative value iteration or by a linear program; "auto" uses rationals for
        small models if floats cannot bound the error.
    subject_to : {name: ">= p/q" or "<= p/q"}, optional
        Limits on expected totals of reward components, steps, events or sums of these
        (`solvers.objectives.amounts`), or on their averages per step, as for `tradeoff`. The
        optimum under limits is exact, and its policy may randomise.

    Returns
    -------
    Solution
        A ConstrainedSolution if there are limits; an AverageSolution, whose value is the gain and
        which has a bias, for an average reward.

    Raises
    ------
    ModelError
        For an unknown name, or a `tol` for a solver without this setting; at discount 1, if no
        policy attains the best total (see `certify`), or if one state of the start has the value +∞
        and another -∞.
    SolverError
        If a solver reaches a limit of iterations or of double precision.

    Examples
    --------
    >>> wait, go = [["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]
    >>> mdp = MDP.from_arrays([wait, go], [[1, "3/2"], [0, 0]])
    >>> solution = solve(mdp, horizon=3)
    >>> solution.start_value, [solution.mdp.actions[a] for a in solution.policy[[0, 2, 4]]]
    (1.875, ['0', '0', '1'])
    >>> solve(mdp, horizon=3, terminal_value=[4, 0]).start_value
    2.25
    >>> solve(mdp, "value-iteration", tol=1e-3).error_bound < 1e-3
    True
    >>> turns = MDP.from_arrays([[[0, 1], [1, 0]]], [1, 4])
    >>> solve(turns, criterion="average").value.tolist()
    [2.5, 2.5]
    """
    if solver is None:
        solver = "auto"
    _check_fit(horizon, terminal_value, start, subject_to, (solver, tol, start))
    mdp = mdp_of(model)
    # An average reward has solvers of its own.
    if is_average(criterion):
        require_no_horizon(horizon)
        require_average_applies(mdp)
        if subject_to is not None:
            return solve_under(mdp, subject_to, average=True)
        check_tolerance("solve", tol)
        solution = _find_best_average(mdp, solver, tol, start)
    else:
        if horizon is not None:
            mdp = mdp.within(horizon, terminal_value=terminal_value)
        if subject_to is not None:
            return solve_under(mdp, subject_to)
        solution = _find_best_total(mdp, solver, tol, start)
    if solution.status is Status.PRECISION:
        warn_of_precision(solution.error_bound)
    return solution


def _find_best_average(mdp: MDP, solver: Any, tol: float | None, start: Any) -> Solution:
    """Return the solution for the average reward; floats fail if a chain mixes too slowly."""
    chosen: Solver = PolicyIteration()
    if solver != "auto":
        chosen = _configure_solver(solver, tol=tol)
    try:
        solution: Solution = solve_average(mdp, _configure_solver(chosen, start=start))
    except SolverError:
        if solver != "auto" or mdp.n_transitions > COMPILED:
            raise
        solution = answer_maximised(mdp, partial(round_exact_solution, criterion="average"))
    return _mark_if_imprecise(solution, tol)


def _find_best_total(mdp: MDP, solver: Any, tol: float | None, start: Any) -> Solution:
    """Return the solution for the total reward; costs are solved as rewards."""
    find_best = partial(_maximise_total, solver=solver, tol=tol, start=orient_start(mdp, start))
    return answer_maximised(mdp, find_best)


def _maximise_total(mdp: MDP, solver: Any, tol: float | None, start: Any = None) -> Solution:
    """Return the solution of a model of maximised rewards."""
    if mdp.ends.has_improper_policy:
        return solve_total(mdp, partial(_maximise_total, solver=solver, tol=tol))
    if solver == "auto" and mdp.ends.is_acyclic:
        check_tolerance("solve", tol)
        solution = _mark_if_imprecise(BackwardInduction().solve_rewards(mdp), tol)
    else:
        if solver == "auto":
            solver = ModifiedPolicyIteration()
        solution = _run_solver(_configure_solver(solver, tol=tol, start=start), mdp)
    return break_near_ties(solution)


def _run_solver(solver: Any, mdp: MDP) -> Solution:
    """Return the solution of a model of rewards, by a solver of the toolkit or a user's own."""
    if isinstance(solver, Solver):
        return solver.solve_rewards(mdp)  # without a warning: `solve` gives it
    solution: Solution = solver.solve(mdp)
    return solution


def _check_fit(
    horizon: object, terminal_value: object, start: object, subject_to: object, given: object
) -> None:
    """Raise ModelError for options that do not go with limits or a horizon, or that need one."""
    if subject_to is not None and given != ("auto", None, None):
        raise ModelError(
            "limits have one solver, which is exact",
            where="subject_to",
            fix="leave out solver, tol and start",
        )
    if horizon is not None and start is not None:
        raise ModelError(
            "start holds values to begin the search with, and a horizon is solved in one pass",
            where="start",
            fix="give the values of states at the end as terminal_value, and where episodes begin "
            "as the model's own start: mdp.with_(start=...)",
        )
    if horizon is None and terminal_value is not None:
        raise ModelError(
            "a terminal value is the value of a state when a horizon is reached",
            where="terminal_value",
            fix="give a horizon, too",
        )


def _configure_solver(solver: Any, **settings: Any) -> Solver:
    """Return a solver, given as an object or by name, with the settings given to `solve`."""
    if isinstance(solver, str):
        solver = SOLVERS[require_known_name(solver, [*SOLVERS, "auto"], "solver", "solve")]()
    if isinstance(solver, type):
        name = solver.__name__
        raise ModelError(f"{name} is a class", where="solve", fix=f"write {name}()")
    if not callable(getattr(solver, "solve", None)):
        raise ModelError(
            f"{solver!r} is not a solver",
            where="solve",
            fix="give a name, or PolicyIteration(); a tolerance is tol=: solve(model, tol=1e-6)",
        )
    # A setting that the solver does not have is refused, with the solvers that have it.
    why = {"tol": "its error is what rounding leaves", "start": "nothing known shortens it"}
    given = {name: value for name, value in settings.items() if value is not None}
    for name in given:
        if name not in getattr(type(solver), "__dataclass_fields__", {}):
            takers = [key for key, kind in SOLVERS.items() if hasattr(kind, name)]
            raise ModelError(
                f"{solver.name} takes no {name}: {why[name]}",
                where="solve",
                fix=f"leave {name} out, or choose {', '.join(takers)}",
            )
    chosen: Solver = solver
    if given:
        chosen = replace(solver, **given)
    return chosen


def _mark_if_imprecise(solution: Solution, tol: float | None) -> Solution:
    """Return a direct solution; its status becomes PRECISION if its error bound exceeds `tol`."""
    if tol is None or solution.error_bound <= tol:
        return solution
    return replace(solution, status=Status.PRECISION)
