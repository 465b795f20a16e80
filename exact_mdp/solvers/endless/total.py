"""The total reward at discount 1 in floats, with bounds, and a policy that attains it.

The merged model of finite values, without pairs that clearly lose (`solvers.endless.merged`), is
solved as any other model in which every policy ends. That the pairs left out are none the better is
verified:

    V(s) - e(s) ≥ r + P (V + e)     for values V with errors e, roundings counted

Where rewards cancel for ever, or +∞ and -∞ come together, rational arithmetic tells what is best.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.gains import SLACK, gains
from exact_mdp.solvers.endless.derived import Derived
from exact_mdp.solvers.endless.merged import lifted, without_losing
from exact_mdp.solvers.endless.structure import finite, structure
from exact_mdp.solvers.exact.find import expansion, reaching
from exact_mdp.solvers.solution import Solution, SolverError, Status


def solve_total(mdp: MDP, solved: Callable[[MDP], Solution]) -> Solution:
    """Return values, infinite ones included, with bounds, and a policy that attains them.

    `solved` solves a model in which every policy ends.

    Raises ModelError where the start mixes +∞ and -∞; SolverError where floats do not bound the
    values.
    """
    started = perf_counter()
    parts = structure(mdp)
    if parts is None:
        return _rounded(mdp, started)
    _check_start(mdp, parts.sign)
    whole = finite(parts)
    part = without_losing(whole)
    try:
        solution = solved(part.mdp)
    except SolverError as failed:
        failed.solution = None  # its states are not those of the model
        raise
    _verify(whole, part, solution)
    value, error = solution.value[whole.label], solution.state_error[whole.label]
    value[parts.sign > 0], value[parts.sign < 0] = np.inf, -np.inf
    chosen = part.source[solution.pairs]
    return replace(
        solution,
        mdp=mdp,
        value=value,
        pairs=lifted(parts, whole, chosen),
        state_error=np.where(parts.sign == 0, error, 0.0),
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


def _check_start(mdp: MDP, sign: Integers) -> None:
    """Raise ModelError where states of the start are worth +∞ (sign 1) and others -∞ (-1)."""
    if len({int(sign[state]) for state, weight in mdp.start if weight} - {0}) > 1:
        raise ModelError(
            "the value is +∞ from one state of the start and -∞ from another",
            where="start",
            fix="start in one state: --start, or mdp.with_(start=…)",
        )


def _rounded(mdp: MDP, started: float) -> Solution:
    """Return exact values, rounded once."""
    proof = expansion(mdp, "total") if mdp.goal is None else reaching(mdp)
    value, pairs = proof.value_float, proof.pairs
    _check_start(mdp, proof.infinite_sign)
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
