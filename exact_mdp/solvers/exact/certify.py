"""Make certificates: solve exactly and prove it, or widen a solution to proven bounds.

`solvers.exact.find` finds exact values and their proofs.

A bounded certificate takes the values V of a solution and the weights w of `solvers.bounds.bounds`:
high = V + c w and low = V - c' w, with the least c and c' that are proven to suffice in floats.
"""

from __future__ import annotations

import warnings
from fractions import Fraction
from functools import partial
from typing import Literal, overload

import numpy as np

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, named_options
from exact_mdp.mdp.exact import bellman_rows, fingerprint
from exact_mdp.mdp.model import MDP, cache_on_model
from exact_mdp.mdp.questions.advice import where_endless
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.arguments import is_average, mdp_of, require_average_applies
from exact_mdp.solvers.bounds.bounds import margin_weights
from exact_mdp.solvers.bounds.gains import UNIT, compute_advantages, first_of
from exact_mdp.solvers.claims import PrecisionWarning, SolverError, Status
from exact_mdp.solvers.exact.certificate import (
    BoundedCertificate,
    Certificate,
    require_sound_proof,
)
from exact_mdp.solvers.exact.find import build_certificate, prove_gain_and_bias, prove_goal_total
from exact_mdp.solvers.exact.levels import Level
from exact_mdp.solvers.exact.optimise import optimise_exactly
from exact_mdp.solvers.solution import Solution, answer_maximised
from exact_mdp.solvers.total import solve_total


@overload
def certify(
    model: MDP | Scenario, *, bounded: Literal[False] = ..., criterion: str = ...
) -> Certificate: ...
@overload
def certify(
    model: MDP | Scenario,
    *,
    bounded: Literal[True],
    solution: Solution | None = ...,
) -> BoundedCertificate: ...
@named_options
def certify(
    model: MDP | Scenario,
    *,
    bounded: bool = False,
    solution: Solution | None = None,
    criterion: str = "total",
) -> Certificate | BoundedCertificate:
    """Return a proof of the optimal values: exact, or as bounds in floats.

    Parameters
    ----------
    model : MDP or Scenario
        Any finite model. At discount 1 the total is the limit of discounted totals: it may be
        infinite, and policies may never end.
    bounded : bool
        Prove lower and upper bounds in floats, quickly for a million states, instead of the exact
        values. At discount 1 every policy must end.
    solution : Solution, optional
        Only with `bounded`: a solution of this model around which bounds are proven; by default the
        model is solved.
    criterion : "total" or "average"
        The criterion of optimality: the total reward with the model's discount, or the average
        reward per step, whatever the discount.

    Returns
    -------
    Certificate or BoundedCertificate

    Raises
    ------
    ModelError
        At discount 1, if one state of the start has the value +∞ and another -∞, or if costs can
        fall without bound before a goal. If a cycle has too many states to be solved exactly.
    SolverError
        Only with `bounded`: if double precision does not suffice.

    Examples
    --------
    >>> stop, on = ["1/3", "2/3", 0], [0, 0, 1]
    >>> mdp = MDP.from_arrays([[stop, on, on], [on, on, on]], [[3, 4], [0, 0], [0, 0]])
    >>> certificate = certify(mdp)
    >>> certificate.value[0], certificate.gaps[0], certificate.unique
    (Fraction(9, 2), Fraction(1, 2), False)
    >>> certificate.policy.tolist(), certificate.optimal_pairs.tolist()
    ([0, 0, 0], [True, False, True, True, True, True])
    >>> certificate.violations()
    []
    """
    mdp, average = mdp_of(model), is_average(criterion)
    if bounded and average:
        raise ModelError(
            "bounds prove a total reward, not an average",
            where="certify",
            fix='leave out bounded=True; solve(model, criterion="average") bounds its error',
        )
    if bounded and mdp.ends.has_improper_policy:
        raise ModelError(
            "bounds that a checker reads need every policy to end, at the goal if there is one, "
            "and some policy does not",
            where=where_endless(mdp),
            fix="leave out bounded=True: the proof is exact; solve() gives floats with bounds",
        )
    if bounded:
        if solution is not None and mdp.sense.costs:
            solution = solution.negated(mdp.maximised)
        return answer_maximised(mdp, partial(_certify_bounds, solution=solution))
    if solution is not None:
        raise ModelError(
            "a solution applies only to bounds", where="certify", fix="add bounded=True"
        )
    return _prove_optimum(mdp, average=average)


def certify_and_check(mdp: MDP, criterion: str = "total") -> Certificate:
    """Return the certificate of an optimum that its checker has accepted."""
    return require_sound_proof(_prove_optimum(mdp, average=is_average(criterion)))


proven_optimum = cache_on_model(certify_and_check)  # for the total reward, found once per model


def _prove_optimum(mdp: MDP, *, average: bool) -> Certificate:
    """Return the certificate of an optimum."""
    if average:
        require_average_applies(mdp)
        return answer_maximised(mdp, partial(prove_gain_and_bias, kind="average"))
    return answer_maximised(mdp, prove_total)


def prove_total(mdp: MDP) -> Certificate:
    """Return the proof of the greatest total reward."""
    # Improper policies need gain and bias, or with a goal a proof of where values are infinite.
    if mdp.ends.has_improper_policy:
        if mdp.ends.has_goal:
            return prove_goal_total(mdp)
        return prove_gain_and_bias(mdp, "total")
    # Otherwise the values alone, and at discount 1 ranks that prove that every policy ends.
    _, (value,), sign = optimise_exactly(bellman_rows(mdp))
    optimal = sign == 0
    return build_certificate(
        mdp,
        first_of(mdp, optimal),
        optimal,
        h=value,
        rank=mdp.ends.rank_in_proof,
        known_optimal=optimal,
    )


# ---- bounds --------------------------------------------------------------------------------------


def _certify_bounds(mdp: MDP, solution: Solution | None) -> BoundedCertificate:
    """Return bounds around a solution of a model of maximised rewards."""
    if solution is None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PrecisionWarning)  # the bounds show the precision
            solution = solve_total(mdp)
    elif len(solution.value) != mdp.n_states or solution.mdp.n_pairs != mdp.n_pairs:
        raise ModelError(
            "the solution belongs to another model", where="certify", fix="solve this one"
        )
    # The advantages over the solution's values, and weights w with their margins.
    weights, value = margin_weights(mdp), np.array(solution.value)
    near = compute_advantages(mdp, value)
    gain, first = near.value, near.error + 8 * UNIT * np.abs(value).max()

    def widen_values(pairs: Integers, sign: int) -> Level:
        """Return values over which no pair gains (sign 1), or none of the policy loses (-1)."""
        error = first
        # Moving the values changes their rounding errors, so that a first step may be too small; in
        # tests the second was always large enough.
        for _ in range(3):
            # Move the values by c w, with c from the advantages and errors, and check the result.
            ratios = weights.compute_ratios(sign * gain + error)[pairs]
            moved = value + sign * float(ratios.max(initial=0.0)) * weights.value
            after = compute_advantages(mdp, moved)
            if (sign * after.value[pairs] <= -after.error[pairs]).all():
                return Level.of([Fraction(number) for number in moved.tolist()])
            error = 2 * (after.error + 8 * UNIT * np.abs(moved).max())
        raise SolverError(Status.NO_BOUND)

    live = ~mdp.terminal
    return BoundedCertificate(
        kind="bounds",
        mdp=mdp,
        model=fingerprint(mdp),
        sense=mdp.sense,
        policy=mdp.pair_action[solution.pairs],
        low=widen_values(solution.pairs[live], -1),
        high=widen_values(np.flatnonzero(live[mdp.pair_state]), 1),
        rank=mdp.ends.rank_in_proof,
    )
