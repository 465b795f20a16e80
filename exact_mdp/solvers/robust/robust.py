"""Robust values: the agent chooses actions, nature chooses each row's distribution from a set.

    V(s) = max over pairs l of s of  min over q in U_l of  Σ q_i (r_i + γ V(s_i))

or with max and min exchanged on either side; nature chooses for each pair independently. The
algorithm alternates between choosing the actions and distributions that are best for V, and solving
the equations of these choices; if that does not bring the bounds closer, it takes a step of value
iteration (Iyengar, Mathematics of Operations Research 30, 2005; Kaufman and Schaefer, INFORMS
Journal on Computing 25, 2013). If the choices of both sides cycle, nature's choice is optimised
first for fixed actions (Hoffman and Karp, Management Science 12, 1966). With T the right side, and
w > 0 except in terminal states,

    m(s) = w(s) - γ max over the pairs l of s, and q in U_l, of Σ q w  > 0,
    T V - V ≤ c m  gives  V* ≤ V + c w   (c ≥ 0),     T V - V ≥ c m  gives  V* ≥ V + c w   (c ≤ 0),

as nature's optimum σ satisfies σ(V + c w) ≤ σ(V) + c γ max Σ q w for c ≥ 0. A margin m proves that
episodes end under every policy and every choice of nature.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter
from typing import Literal

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.components import require_amounts
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import MOST_BYTES, Floats, Integers
from exact_mdp.solvers.arguments import Criterion, OfCriterion, is_average, require_average_applies
from exact_mdp.solvers.bounds.gains import RELATIVE_TOLERANCE, SLACK, BoundedVector
from exact_mdp.solvers.claims import SolverError, Status, warn_of_precision
from exact_mdp.solvers.dynamic.base import check_counts, check_tolerance
from exact_mdp.solvers.exact.find import one_sign
from exact_mdp.solvers.robust.average import RobustAverages, choose_tolerance
from exact_mdp.solvers.robust.game import Game, verify_margins
from exact_mdp.solvers.robust.improper import RobustImproperPolicies
from exact_mdp.solvers.robust.sets import Ambiguity, Inner, advise_on_sets
from exact_mdp.solvers.solution import Found
from exact_mdp.solvers.values.policy_chain import PolicyChain

Nature = Literal["worst", "best"]
OF_OUTCOME = 360  # bytes for each outcome, measured over the analysis of both sides


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RobustSolution(OfCriterion, Found, Result):
    """Robust values with error bounds for every state, and the choices that attain them.

    |value - V*| is at most `state_error`, and so is |value - V^π| for the policy found here. Values
    may be infinite at discount 1. If a policy was given, `pairs` is None.
    """

    nature: Nature  # "worst" is against the agent, "best" with it
    transition: sp.csr_array  # (S, S) under the policy and nature's choice
    reward: Floats  # (S,) expected rewards under both
    criterion: str = "total"  # or "average": the value is the reward per step

    def __repr__(self) -> str:
        return (
            f"RobustSolution({self.mdp.sense}, nature {self.nature}: start {self.measure} "
            f"{self.start}, iterations: {self.iterations}, {self.seconds:.3g} s; {self.status})"
        )


@advise_on_sets()
def solve_robust(
    model: MDP,
    ambiguity: Ambiguity,
    *,
    nature: Nature = "worst",
    policy: PolicyLike | None = None,
    tol: float | None = None,
    max_iterations: int = 100_000,
    criterion: Criterion = "total",
) -> RobustSolution:
    """Return the value of the best policy, or of a given one, if nature chooses distributions.

    Parameters
    ----------
    model : MDP
    ambiguity : Intervals, L1Ball, Likelihood, or another `Ambiguity`
    nature : "worst" or "best"
        Against the agent (robust), or with it (cooperative).
    policy : PolicyLike, optional
        Evaluate this policy instead of choosing the best.
    tol : float, optional
        Greatest absolute error in any state; 1e-9 · max(1, |V|) by default.
    max_iterations : int
        The most steps in which nature and the agent choose again.
    criterion : "total" or "average"
        The total reward with the model's discount, or the average reward per step in the long run,
        whatever the discount.

    Returns
    -------
    RobustSolution

    Raises
    ------
    ModelError
        If the sets do not fit the model; at discount 1, if gains and losses may cancel forever, if
        +∞ and -∞ meet, or if nature can make outcomes impossible and so prevent the end; for an
        average, if it can do so and no state is visited again and again, whichever single outcome
        it leaves of these pairs, even of those that its set keeps possible.
    SolverError
        At the iteration limit, or if double precision cannot bound the error.

    Examples
    --------
    >>> from exact_mdp.solvers.robust.sets import Intervals
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])  # the value is 1 / (1 - p)
    >>> print(solve_robust(mdp, Intervals.relative(mdp, 0.2)).start)
    1.66666666667 ± ... (bounded)
    """
    started = perf_counter()
    if nature not in ("worst", "best"):
        raise ModelError(f"unknown nature {nature!r}", where="robust", fix="say worst or best")
    if not callable(getattr(ambiguity, "check", None)):
        fix = "give sets, such as Intervals.relative(model, 0.1), for ± 10 %"
        raise ModelError(
            f"{ambiguity!r:.60} is not a set of distributions", where="ambiguity", fix=fix
        )
    require_room_for_rows(model)
    ambiguity.check(model)
    require_amounts(model.table, "a value under other rows")
    check_tolerance("robust", tol)
    check_counts("robust", max_iterations=max_iterations)
    average = is_average(criterion)
    if average:
        require_average_applies(model)
    # Solve the model of maximised rewards; a given policy fixes the probabilities of pairs.
    if policy is None:
        weights, endless = None, model.ends.has_improper_policy
    else:
        chain = PolicyChain.of(model, policy, criterion=criterion)
        weights = chain.weights
        endless = model.discount_exact == 1 and not chain.reaches_goal.all()
    mdp, against = model.maximised, nature == "worst"
    game = Game(mdp, ambiguity, against=against, weights=weights)
    with np.errstate(over="ignore", invalid="ignore"):
        if average:
            steps = RobustAverages(mdp.undiscounted, ambiguity, against, weights)
            found, pairs, distributions = _solve_average(steps, tol, max_iterations)
        elif endless:
            improper = RobustImproperPolicies.of(mdp, ambiguity, against=against, weights=weights)
            found, pairs = _solve_finite_part(improper, tol, max_iterations)
            # Nature's choice where the value is infinite does not matter for finite values.
            finite = np.where(np.isinf(found.value), 0.0, found.value)
            distributions = game.solve_inner_problem(finite).distributions
        else:
            found = _iterate_values(game, tol, max_iterations)
            distributions, pairs = found.asked.distributions, found.choose_pairs(game)
    if policy is None:
        share = game.take_pairs(pairs)
    else:
        share = game.choose_pairs(np.zeros(len(game.pairs)))
    transition, earned = game.build_chain(distributions, share)
    if found.status is Status.PRECISION:
        warn_of_precision(float(found.error.max()), status=found.status.with_sets)
    return RobustSolution(
        mdp=model,
        nature=nature,
        value=model.sense.orient(found.value),
        state_error=found.error,
        pairs=pairs if policy is None else None,
        transition=transition,
        reward=model.sense.orient(earned),
        criterion=criterion,
        status=found.status.with_sets,
        iterations=found.iterations,
        seconds=perf_counter() - started,
    )


def _solve_average(
    averages: RobustAverages, tol: float | None, max_iterations: int
) -> tuple[_Iterated, Integers, list[Floats]]:
    """Return gains (S,), the pairs (S,) that attain them, and nature's choice."""
    gains = averages.bound_gains(tol, max_iterations)
    part, game = averages.apply(gains)
    limit = float(np.max(choose_tolerance(tol, gains.middle))) / 2
    found = _iterate_values(game, limit, max_iterations)
    status = found.status
    if gains.status is Status.PRECISION:
        status = gains.status
    value = found.value[part.new_state]
    each = replace(
        found,
        value=value,
        error=(found.error[part.new_state] + gains.error) * SLACK,
        status=status,
        iterations=gains.iterations + found.iterations,
    )
    pairs = averages.lift_policy(part, gains, found.choose_pairs(game))
    return each, pairs, averages.choose_distributions(gains, value)


def require_room_for_rows(model: MDP) -> None:
    """Raise ModelError if the sets of all rows would not fit in memory."""
    size = OF_OUTCOME * len(model.table.next)
    if size > MOST_BYTES:
        most = MOST_BYTES // OF_OUTCOME
        raise ModelError(
            f"robust values of {len(model.table.next):,} outcomes take {size / 1e9:,.0f} GB of "
            f"memory, more than {MOST_BYTES / 1e9:g} GB",
            where="robust",
            fix=f"use a model of at most {most:,} outcomes",
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Iterated(BoundedVector):
    """Values (S,) with error bounds, and how they were found."""

    asked: Inner  # nature's choice at these values
    status: Status
    iterations: int

    def choose_pairs(self, game: Game) -> Integers:
        """Return the pair (S,) that the agent takes in each state; the first in terminal ones."""
        pairs = game.mdp.pair_offsets[:-1].copy()
        if game.weights is None:
            pairs[game.live] = game.pairs[game.choose_pairs(self.asked.value) == 1]
        return pairs


def _solve_finite_part(
    improper: RobustImproperPolicies, tol: float | None, max_iterations: int
) -> tuple[_Iterated, Integers]:
    """Return values (S,), infinite ones included, and the pairs (S,) that attain them."""
    improper.require_applicable()
    one_sign(improper.given, improper.sign)
    whole = improper.apply()
    part = improper.omit_losing_pairs(whole)
    game = improper.build_game(part)
    found = _iterate_values(game, tol, max_iterations)
    improper.require_losses(whole, part, found)
    values = improper.lift_values(part, found)
    pairs = improper.lift_policy(part, found.choose_pairs(game))
    return replace(found, value=values.value, error=values.error), pairs


def _iterate_values(game: Game, tol: float | None, max_iterations: int) -> _Iterated:
    """Return bounded values of a game in which every run ends, or the discount is below 1."""
    live, value, order = game.live, np.zeros(game.mdp.n_states), game.mdp.ends.most_steps
    if not len(live):
        return _Iterated(
            value=value,
            error=value.copy(),
            asked=game.solve_inner_problem(value),
            status=Status.CONVERGED,
            iterations=0,
        )
    # `best` is the least error so far, `trust` the one that solving the equations has to improve
    # on, and `step` the result of value iteration to fall back on.
    weight, margin = verify_margins(game)
    most, best, trust, step = float(weight.max()), np.inf, np.inf, value
    for iteration in range(1, max_iterations + 1):
        # Both sides choose.
        asked, here = game.solve_inner_problem(value), value[live]
        share = game.choose_pairs(asked.value)
        doubt = game.bound_rounding(value, asked)
        # Bounds on T V - V, for the optimum and for the policy that takes these pairs.
        least = np.minimum(game.back_up_pairs(asked.low), game.average_pairs(share, asked.low))
        low = least - here - doubt
        greatest = np.maximum(game.back_up_pairs(asked.high), game.average_pairs(share, asked.high))
        high = greatest - here + doubt
        # NumPy's maximum is NaN if one of the numbers is, as beyond the range of floats.
        error = float(np.max([0.0, (high / margin).max(), -(low / margin).min()])) * SLACK
        # The equations led away from the optimum: go back to a step of value iteration, which
        # cannot.
        if not error < trust:
            if trust == np.inf:
                raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
            value, trust = step, np.inf
            continue
        # Stop if the error is small enough, or no longer falls because all of it is rounding.
        better = game.average_pairs(share, asked.value)
        limit = tol or RELATIVE_TOLERANCE * max(1.0, float(np.abs(better).max()))
        noise = float((asked.high - asked.low).max() + doubt.max()) / float(margin.min())
        if error * most <= limit or best <= error <= 4 * noise:
            if error * most <= limit:
                status = Status.CONVERGED
            else:
                status = Status.PRECISION
            off = np.asarray(error * weight * SLACK)
            return _Iterated(
                value=value, error=off, asked=asked, status=status, iterations=iteration
            )
        best = min(best, error)
        step = value.copy()
        step[live] = better
        # Solve the equations of both choices.
        value = game.solve_chain(asked, share, order)
        trust = error
        # A few steps suffice unless the choices of both sides cycle, each undoing the other's. Then
        # optimise nature's choice for the agent's policy first: the policy improves in each round,
        # whatever the bounds do on the way.
        if iteration > 20:
            trust = np.inf
            value = game.solve_nature(value, share, order)
    detail = f"{best * most:.2g} is the error bound after {max_iterations} iterations"
    raise SolverError(Status.ITERATION_LIMIT, detail)
