"""The total reward at discount 1 in floats, with bounds, and a policy that attains it.

The merged model of finite values, without pairs that clearly lose (`solvers.endless.merged`), is
solved as any other model in which every policy ends. That the pairs left out are none the better is
verified:

    V(s) - e(s) ≥ r + P (V + e)     for values V with errors e, roundings counted

Where rewards cancel in a component, floats cannot tell what is best, and rational arithmetic does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.bounds.gains import SLACK, UNIT, gains
from exact_mdp.solvers.endless.derived import Derived
from exact_mdp.solvers.endless.merged import lifted, without_losing
from exact_mdp.solvers.endless.proven import certify_total
from exact_mdp.solvers.endless.structure import finite, sign_at_start, structure
from exact_mdp.solvers.proof.checker import policy_pairs
from exact_mdp.solvers.solution import Solution, SolverError, Status


def solve_total(mdp: MDP, solved: Callable[[MDP], Solution]) -> Solution:
    """Return values, infinite ones included, with bounds, and a policy that attains them.

    `solved` solves a model in which every policy ends.

    Raises ModelError where the total swings for ever (`solvers.endless.structure`), or the start
    mixes +∞ and -∞; SolverError where floats do not bound the values.
    """
    started = perf_counter()
    found = structure(mdp)
    sign_at_start(mdp, found.sign)
    whole, swings = finite(found)
    if swings.any():
        return _rounded(mdp, started)
    part = without_losing(whole)
    solution = solved(part.mdp)
    _verify(whole, part, solution)
    height = np.zeros(mdp.n_states)
    height[list(found.height)] = [float(number) for number in found.height.values()]
    value = solution.value[whole.label] + height
    error = solution.state_error[whole.label]
    error = error + (2 * UNIT * (np.abs(value) + np.abs(height))) * (height != 0)
    value[found.sign > 0], value[found.sign < 0] = np.inf, -np.inf
    chosen = part.source[solution.pairs]
    return replace(
        solution,
        mdp=mdp,
        value=value,
        pairs=lifted(found, whole, chosen)[0],
        state_error=np.where(found.sign == 0, error, 0.0),
        seconds=perf_counter() - started,
        gaps=None,
        occupancy=None,
    )


def _verify(whole: Derived, part: Derived, solution: Solution) -> None:
    mdp = whole.mdp
    left = np.setdiff1d(whole.source, part.source)
    pairs = np.flatnonzero(np.isin(whole.source, left))
    if not len(pairs):
        return
    gain, error = gains(mdp, np.array(solution.value)), solution.state_error
    doubt = (mdp.transition @ error + error[mdp.pair_state]) * SLACK + gain.error
    if not (gain.value + doubt <= 0)[pairs].all():
        raise SolverError(Status.NO_BOUND, "staying for ever loses too little a step")


def _rounded(mdp: MDP, started: float) -> Solution:
    """Return exact values, rounded once."""
    proof = certify_total(mdp)
    value, pairs = proof.value_float, policy_pairs(mdp, proof.policy)
    assert pairs is not None
    with np.errstate(invalid="ignore"):
        error = np.where(np.isfinite(value), np.spacing(np.abs(value)), 0.0)
    return Solution(
        mdp=mdp,
        value=value,
        pairs=pairs,
        state_error=error,
        regret_bound=float(2 * error.max()),
        status=Status.DIRECT,
        method="policy-iteration",
        solver="policy iteration in rational arithmetic",
        iterations=1,
        seconds=perf_counter() - started,
    )
