"""Make certificates: solve exactly and say what is optimal, or widen a solution to proven bounds.

An exact certificate needs a proof that values are unique: a discount, or a rank.

A bounded one takes the values V of a solution and the weights w of `solvers.bounds.bounds`:
upper = V + c w and lower = V - c' w, c and c' being the least that satisfy the inequalities of
`solvers.proof.checker`, in floats.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Literal, overload

import numpy as np

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.chain import endless, where_endless
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import bellman_rows, fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.average.certificate import AverageCertificate
from exact_mdp.solvers.average.certify import certify_average
from exact_mdp.solvers.bounds.bounds import margin_weights
from exact_mdp.solvers.endless.proven import certify_total
from exact_mdp.solvers.proof.certificate import BoundedCertificate, Certificate
from exact_mdp.solvers.proof.checker import one_optimum
from exact_mdp.solvers.proof.exact import solve_exactly
from exact_mdp.solvers.proof.margins import UNIT, alike, gains
from exact_mdp.solvers.proof.rationals import on_average
from exact_mdp.solvers.proof.uniqueness import uniqueness
from exact_mdp.solvers.solution import PrecisionWarning, Solution, SolverError, Status
from exact_mdp.solvers.solver import is_average, mdp_of, solve


@overload
def certify(
    model: MDP | Scenario, *, bounded: Literal[False] = ..., criterion: Literal["total"] = ...
) -> Certificate: ...
@overload
def certify(model: MDP | Scenario, *, criterion: Literal["average"]) -> AverageCertificate: ...
@overload
def certify(
    model: MDP | Scenario,
    *,
    bounded: Literal[True],
    tol: float | None = ...,
    solution: Solution | None = ...,
) -> BoundedCertificate: ...
def certify(
    model: MDP | Scenario,
    *,
    bounded: bool = False,
    tol: float | None = None,
    solution: Solution | None = None,
    criterion: str = "total",
) -> Certificate | BoundedCertificate | AverageCertificate:
    """Return a proof of the optimal values: exact, or as bounds in floats.

    Parameters
    ----------
    model : MDP or Scenario
        Any finite model. At discount 1 values may be infinite, and policies may never end.
    bounded : bool
        Prove floats that the values lie between, at once for a million states, instead of the
        values themselves. At discount 1 every policy has to end.
    tol : float, optional
        Only with `bounded`: the greatest `error_bound` to accept.
    solution : Solution, optional
        Only with `bounded`: a solution of this model to prove bounds around; solved unless given.
    criterion : "total" or "average"
        What is optimal: the total reward, discounted as the model says, or the average reward per
        step, exactly, whatever the discount.

    Returns
    -------
    Certificate, BoundedCertificate or AverageCertificate

    Raises
    ------
    ModelError
        At discount 1: where rewards cancel for ever and the total swings, and that may be best;
        where +∞ and -∞ come together with a mean of 0, or in the start; where the start's costs can
        fall without end before a goal. Where a cycle has too many states to be solved exactly.
    SolverError
        Only with `bounded`: where double precision does not suffice.

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
    if bounded and endless(mdp):
        raise ModelError(
            "bounds that a checker reads need every policy to end, at the goal where one is set; "
            "one does not",
            where=where_endless(mdp),
            fix="leave out bounded=True: the proof is exact; solve() gives floats with bounds",
        )
    if bounded:
        return _bounded(mdp, tol, solution)
    if tol is not None or solution is not None:
        raise ModelError(
            "tol and solution apply only to bounds", where="certify", fix="add bounded=True"
        )
    if average:
        return certify_average(mdp)
    if mdp.sense == "min":
        of_rewards = certify(mdp.maximised)
        return replace(
            of_rewards,
            mdp=mdp,
            model=fingerprint(mdp),
            numerator=[-number for number in of_rewards.numerator],
            start_value=-of_rewards.start_value,
            endless=None if of_rewards.endless is None else of_rewards.endless.negated(),
        )
    if endless(mdp):
        return certify_total(mdp)
    rank = uniqueness(mdp)
    pairs, optimal = _contenders(mdp), np.zeros(mdp.n_pairs, dtype=bool)
    same = alike(mdp, pairs)
    distinct = np.unique(same)
    found = solve_exactly(bellman_rows(mdp, distinct))
    optimal[distinct], first = found.optimal, mdp.pair_offsets[:-1]
    optimal[pairs] = optimal[same]
    numbers = np.where(optimal, np.arange(mdp.n_pairs), mdp.n_pairs)
    return Certificate(
        model=fingerprint(mdp),
        numerator=found.numerator,
        group=found.group,
        denominator=found.denominator,
        policy=mdp.pair_action[np.minimum.reduceat(numbers, first)],
        optimal_pairs=optimal,
        gap=found.gap,
        gap_scale=found.gap_scale,
        unique=one_optimum(mdp, optimal),
        start_value=on_average(mdp.start, found.numerator, found.group, found.denominator),
        rank=rank,
        mdp=mdp,
    )


MANY = 20_000  # transitions from which on floats choose the pairs that are solved exactly


def _contenders(mdp: MDP) -> Integers:
    """Return (K,) the pairs that floats do not prove worse than two others of their state.

    Bounds on the values bound what each pair is worth. Pairs above which another one is proven to
    be are not optimal; and those that another one of these is proven to be above do not make the
    gap.
    """
    every, state = np.arange(mdp.n_pairs), mdp.pair_state
    if mdp.n_transitions < MANY or mdp.n_pairs < 2 * mdp.n_states:
        return every
    try:
        found = _bounded(mdp, None, None)
    except (SolverError, ModelError):
        return every
    low, high = _worth(mdp, found.lower, -1), _worth(mdp, found.upper, 1)
    first = mdp.pair_offsets[:-1]
    behind = high < np.maximum.reduceat(low, first)[state]
    second = np.maximum.reduceat(np.where(behind, low, -np.inf), first)[state]
    return np.flatnonzero(~behind | (high >= second) | mdp.terminal[state])


def _worth(mdp: MDP, value: Floats, sign: int) -> Floats:
    """Return (L,) what pairs are worth before these values, at least (-1) or at most (1)."""
    gain, error = gains(mdp, value)
    own = value[mdp.pair_state]
    return np.asarray(own + gain + sign * (error + 4 * UNIT * (np.abs(own) + np.abs(gain) + error)))


WIDER = (1.0, 4.0, 16.0, 64.0)  # times the rounding errors, tried one after the other


def _bounded(mdp: MDP, tol: float | None, solution: Solution | None) -> BoundedCertificate:
    """Return bounds that floats prove."""
    if mdp.sense == "min":
        known = None if solution is None else solution.negated(mdp.maximised)
        found = _bounded(mdp.maximised, tol, known)
        low, high = 0.0 - found.upper, 0.0 - found.lower
        return replace(found, mdp=mdp, model=fingerprint(mdp), lower=low, upper=high)
    if solution is None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PrecisionWarning)  # the bounds say what was reached
            solution = solve(mdp, tol=None if tol is None else tol / 4)
    elif len(solution.value) != mdp.n_states or solution.mdp.n_pairs != mdp.n_pairs:
        raise ModelError("the solution is of another model", where="certify", fix="solve this one")
    weight = np.where(mdp.terminal, 0.0, margin_weights(mdp).value)
    loss, error = gains(mdp, weight, earning=False)
    margin, value = -(loss + error), np.array(solution.value)
    gain, error = gains(mdp, value)
    error += 8 * UNIT * np.abs(value).max()

    def widen(pairs: Integers, sign: int) -> Floats:
        """Return values proven not to gain (1), or not to lose (-1), by any of the pairs."""
        for times in WIDER:
            surplus = sign * gain[pairs] + times * error[pairs]
            step = max(0.0, float((surplus / margin[pairs]).max(initial=0.0)))
            moved = value + sign * step * weight
            after, doubt = gains(mdp, moved)
            if (sign * after[pairs] <= -doubt[pairs]).all():
                return moved
        raise SolverError(Status.NO_BOUND)

    live = ~mdp.terminal
    found = BoundedCertificate(
        model=fingerprint(mdp),
        lower=widen(solution.pairs[live], -1),
        upper=widen(np.flatnonzero(live[mdp.pair_state]), 1),
        policy=mdp.pair_action[solution.pairs],
        weight=weight,
        mdp=mdp,
    )
    if tol is not None and not found.error_bound <= tol:
        raise SolverError(Status.PRECISION, f"{found.error_bound:.2g} is the error bound")
    return found
