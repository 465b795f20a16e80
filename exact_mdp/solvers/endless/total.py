"""The total reward at discount 1 in models with improper policies: infinite and finite values.

`improper` decides where values are infinite, and makes the model of the finite ones; pairs that
clearly lose in cycles are left out of it, so that every policy ends, and it is solved. That the
omitted pairs are not better is verified, for values V with errors e: V(s) - e(s) ≥ r + P (V + e).
Where the reduction does not apply, or floats do not suffice, exact levels decide (Bertsekas and
Tsitsiklis, Mathematics of Operations Research 16, 1991).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.bounds.gains import SLACK, compute_advantages
from exact_mdp.solvers.claims import SolverError, Status
from exact_mdp.solvers.dynamic.methods import PolicyIteration
from exact_mdp.solvers.endless.average import AverageSolution
from exact_mdp.solvers.endless.improper import ImproperPolicies
from exact_mdp.solvers.endless.quotient import Quotient
from exact_mdp.solvers.exact.find import one_sign, prove_gain_and_bias, prove_goal_total
from exact_mdp.solvers.solution import Solution


def solve_total(mdp: MDP, solve_proper: Callable[[MDP], Solution]) -> Solution:
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
