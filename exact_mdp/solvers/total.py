"""The total reward: by a solver of choice where every policy ends, and where some policy does not.

In models with improper policies, `improper` decides where values are infinite, and makes the model
of the finite ones; pairs that clearly lose in cycles are left out of it, so that every policy ends,
and it is solved. That the omitted pairs are not better is verified, for values V with errors e:
V(s) - e(s) ≥ r + P (V + e). Where the reduction does not apply, or floats do not suffice, exact
levels decide (Bertsekas and Tsitsiklis, Mathematics of Operations Research 16, 1991).

Solvers stop once the values are accurate enough, and two actions whose values differ by less count
as tied. Their difference is known far more accurately than either value, because common terms of
the rows cancel:

    q(b) - q(a) = r_b - r_a + γ Σ (P_b - P_a) V,     with an error of γ Σ |P_b - P_a| |V - V*|

Actions that even this cannot distinguish differ by less than the error of the values.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, require_known_name
from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.bounds.gains import SLACK, compute_advantages, gamma, rounding_facts
from exact_mdp.solvers.claims import SolverError, Status, warn_of_precision
from exact_mdp.solvers.dynamic.base import Solver, check_tolerance, orient_start
from exact_mdp.solvers.dynamic.linear_program import LinearProgram
from exact_mdp.solvers.dynamic.methods import (
    BackwardInduction,
    GaussSeidel,
    ModifiedPolicyIteration,
    PolicyIteration,
    ValueIteration,
)
from exact_mdp.solvers.endless.average import AverageSolution
from exact_mdp.solvers.endless.improper import ImproperPolicies
from exact_mdp.solvers.endless.quotient import Quotient
from exact_mdp.solvers.exact.find import one_sign, prove_gain_and_bias, prove_goal_total
from exact_mdp.solvers.solution import Solution, answer_maximised

SOLVERS: dict[str, type[Solver]] = {
    "value-iteration": ValueIteration,
    "gauss-seidel": GaussSeidel,
    "modified-policy-iteration": ModifiedPolicyIteration,
    "policy-iteration": PolicyIteration,
    "backward-induction": BackwardInduction,
    "linear-program": LinearProgram,
}


def solve_total(
    mdp: MDP, solver: Any = "auto", tol: float | None = None, start: Any = None
) -> Solution:
    """Return the solution for the total reward; warn if floats do not suffice for `tol`."""
    find_best = partial(_maximise_total, solver=solver, tol=tol, start=orient_start(mdp, start))
    solution = answer_maximised(mdp, find_best)
    if solution.status is Status.PRECISION:
        warn_of_precision(solution.error_bound)
    return solution


def _maximise_total(mdp: MDP, solver: Any, tol: float | None, start: Any = None) -> Solution:
    """Return the solution of a model of maximised rewards."""
    if mdp.ends.has_improper_policy:
        return _solve_improper(mdp, partial(_maximise_total, solver=solver, tol=tol))
    if solver == "auto" and mdp.ends.is_acyclic:
        check_tolerance("solve", tol)
        solution = mark_if_imprecise(BackwardInduction().solve_rewards(mdp), tol)
    else:
        if solver == "auto":
            solver = ModifiedPolicyIteration()
        solution = _run_solver(configure_solver(solver, tol=tol, start=start), mdp)
    return break_near_ties(solution)


def _run_solver(solver: Any, mdp: MDP) -> Solution:
    """Return the solution of a model of rewards, by a solver of the toolkit or a user's own."""
    if isinstance(solver, Solver):
        return solver.solve_rewards(mdp)  # without a warning: `solve` gives it
    solution: Solution = solver.solve(mdp)
    return solution


def configure_solver(solver: Any, **settings: Any) -> Solver:
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


def mark_if_imprecise(solution: Solution, tol: float | None) -> Solution:
    """Return a direct solution; its status becomes PRECISION if its error bound exceeds `tol`."""
    if tol is None or solution.error_bound <= tol:
        return solution
    return replace(solution, status=Status.PRECISION)


# ---- improper policies ---------------------------------------------------------------------------


def _solve_improper(mdp: MDP, solve_proper: Callable[[MDP], Solution]) -> Solution:
    """Return values, infinite ones included, with bounds, and a policy that attains them.

    `solve_proper` solves models in which every policy ends. Raises ModelError if the start mixes +∞
    and -∞, and SolverError if floats cannot bound the values.
    """
    started = perf_counter()
    # Signs of rewards decide where values are infinite, or exact arithmetic does.
    improper = ImproperPolicies(mdp)
    if not improper.applies:
        return round_exact_solution(mdp)
    one_sign(mdp, improper.sign)
    # Solve the model of the finite values without the pairs that lose in cycles.
    whole = improper.apply()
    part = whole.omit_losing_pairs()
    try:
        solution = solve_proper(part.mdp)
    except SolverError as failed:
        failed.solution = None  # its states are not the states of the model
        raise
    # If the omission cannot be verified with these values, try the closer ones of policy iteration.
    if not _is_reduction_sound(whole, part, solution):
        closest = PolicyIteration().solve_rewards(part.mdp)
        if not _is_reduction_sound(whole, part, closest):
            raise SolverError(Status.NO_BOUND, "staying forever loses too little a step")
    # Back to the states of the model.
    values = improper.lift_values(part, solution)
    return replace(
        solution,
        mdp=mdp,
        value=values.value,
        state_error=values.error,
        pairs=improper.lift_policy(part, solution.pairs),
        seconds=perf_counter() - started,
    )


def _is_reduction_sound(whole: Quotient, part: Quotient, solution: Solution) -> bool:
    """Return whether no omitted pair is better, with rounding errors counted."""
    left_out = ~np.isin(whole.source, part.source)
    if not left_out.any():
        return True
    # d ≤ 0 for the exact values, if the advantage over V, plus all errors, is at most 0.
    gain, error = compute_advantages(whole.mdp, np.array(solution.value)), solution.state_error
    doubt = (whole.mdp.transition @ error + error[whole.mdp.pair_state]) * SLACK + gain.error
    return bool((gain.value + doubt <= 0)[left_out].all())


def round_exact_solution(mdp: MDP, criterion: str = "total") -> Solution:
    """Return exact values, or exact gain and bias for an average reward, each rounded once."""
    # Solve and prove in rationals; values of +∞ and -∞ must not meet at the start.
    started, average = perf_counter(), criterion == "average"
    if mdp.ends.has_goal and not average:
        proof = prove_goal_total(mdp)
    else:
        proof = prove_gain_and_bias(mdp, criterion)
    value = proof.value_float
    one_sign(mdp, proof.infinite_sign)
    # Rounding moves a finite value by less than the spacing of floats.
    with np.errstate(invalid="ignore"):
        error = np.where(np.isfinite(value), np.spacing(np.abs(value)), 0.0)
    parts: dict[str, Any] = {
        "mdp": mdp,
        "value": value,
        "pairs": proof.pairs,
        "state_error": error,
        "regret_bound": float(2 * error.max()),
        "status": Status.DIRECT,
        "method": "policy-iteration",
        "solver": "policy iteration in rational arithmetic",
        "iterations": 1,
        "seconds": perf_counter() - started,
    }
    if not average:
        return Solution(**parts)
    # For an average reward the bias is rounded, too.
    try:
        bias = proof.bias.astype(np.float64)
    except OverflowError as error:
        raise ModelError(
            "the bias is too large for a float",
            where="the average reward per step",
            fix='ask for it exactly: certify(mdp, criterion="average"), --certify; or scale the '
            "rewards",
        ) from error
    return AverageSolution(**parts, bias=bias, bias_error=np.spacing(np.abs(bias)))


# ---- near ties -----------------------------------------------------------------------------------


def break_near_ties(solution: Solution) -> Solution:
    """Return the solution with each pair replaced by a rival that is certainly better.

    Its values and bounds stay valid: no state takes a worse pair than before.
    """
    mdp, value, error = solution.mdp, solution.value, solution.state_error
    if not np.isfinite(value).all():
        return solution
    matrix, rate, facts = mdp.transition, mdp.discount, rounding_facts(mdp)
    # Rivals of a pair: pairs whose values are so near that errors may have hidden the better one.
    q, first, state = mdp.backup(value), mdp.pair_offsets[:-1], mdp.pair_state
    size = facts.size + rate * float(np.abs(value).max())
    doubt = gamma(facts.most + 8) * size + rate * float(error.max())
    near = (q + 2 * doubt >= np.maximum.reduceat(q, first)[state]) & ~mdp.terminal[state]
    near[solution.pairs] = False
    rivals = np.flatnonzero(near)
    if not len(rivals):
        return solution
    pairs = solution.pairs.copy()
    turn = np.arange(len(rivals)) - np.searchsorted(state[rivals], state[rivals])
    # Each state's first rival, then its second, and so on.
    for number in range(int(turn.max()) + 1):
        rival = rivals[turn == number]
        # Compare each rival with the pair that its state takes so far.
        holder = pairs[state[rival]]
        rows, earned = matrix[holder], mdp.reward[rival] - mdp.reward[holder]
        apart = matrix[rival] - rows
        row, share = np.repeat(np.arange(len(rival)), np.diff(apart.indptr)), apart.data
        # Both rows sum to 1, so any constant may be subtracted from the values. With the value
        # of the likeliest next state, the probability that was rounded most has the factor 0.
        most = np.repeat(np.maximum.reduceat(rows.data, rows.indptr[:-1]), np.diff(rows.indptr))
        places = np.where(rows.data == most, np.arange(rows.nnz), rows.nnz)
        likeliest = rows.indices[np.minimum.reduceat(places, rows.indptr[:-1])]
        # The difference of both values, its rounding error, and the effect of the values' errors.
        step = share * (value[apart.indices] - value[likeliest][row])
        unknown = np.abs(share) * error[apart.indices]
        sums = [np.bincount(row, each, len(rival)) for each in (step, np.abs(step), unknown)]
        noise = gamma(np.diff(apart.indptr) + 8) * (np.abs(earned) + rate * sums[1])
        better = earned + rate * sums[0] > noise + rate * sums[2]
        pairs[state[rival[better]]] = rival[better]
    return replace(solution, pairs=pairs)
