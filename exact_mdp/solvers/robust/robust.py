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

from copy import copy
from dataclasses import dataclass
from time import perf_counter
from typing import Literal

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.components import require_amounts
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import find_reachable_nodes
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import MOST_BYTES, Floats, Integers
from exact_mdp.solvers.bounds.gains import POLICIES, RELATIVE_TOLERANCE, SLACK, UNIT
from exact_mdp.solvers.bounds.linear import LinearSystem
from exact_mdp.solvers.claims import SolverError, Status, warn_of_precision
from exact_mdp.solvers.dynamic.base import check_counts, check_tolerance
from exact_mdp.solvers.robust.sets import (
    Ambiguity,
    Inner,
    list_entries,
    side_by_side,
    solve_inner_problem,
)
from exact_mdp.solvers.solution import Found
from exact_mdp.solvers.values.policy_chain import PolicyChain

Nature = Literal["worst", "best"]
OF_OUTCOME = 360  # bytes for each outcome, measured over the analysis of both sides


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RobustSolution(Found, Result):
    """Robust values with error bounds for every state, and the choices that attain them.

    |value - V*| is at most `state_error`, and so is |value - V^π| for the policy found here. If a
    policy was given, `pairs` is None.
    """

    nature: Nature  # "worst" is against the agent, "best" with it
    transition: sp.csr_array  # (S, S) under the policy and nature's choice
    reward: Floats  # (S,) expected rewards under both

    def __repr__(self) -> str:
        return (
            f"RobustSolution({self.mdp.sense}, nature {self.nature}: start value {self.start}, "
            f"iterations: {self.iterations}, {self.seconds:.3g} s; {self.status})"
        )


def solve_robust(
    model: MDP,
    ambiguity: Ambiguity,
    *,
    nature: Nature = "worst",
    policy: PolicyLike | None = None,
    tol: float | None = None,
    max_iterations: int = 100_000,
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

    Returns
    -------
    RobustSolution

    Raises
    ------
    ModelError
        If the sets do not fit the model; at discount 1, if an episode never ends under some policy
        and some choice of nature.
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
    beside = model.ends.outside_goal
    if beside.any():
        raise ModelError(
            "a run that ends outside the goal is worth infinity, and robust values are finite",
            where=model.space.place(int(beside.argmax())),
            fix="choose a discount below 1, or ask for the chance of getting there "
            "(--reach LABEL, model.reaching(label))",
        )
    check_tolerance("robust", tol)
    check_counts("robust", max_iterations=max_iterations)
    # Solve the model of maximised rewards; a given policy fixes the probabilities of pairs.
    weights = None
    if policy is not None:
        weights = PolicyChain.of(model, policy).weights
    game = Game(model.maximised, ambiguity, against=nature == "worst", weights=weights)
    with np.errstate(over="ignore", invalid="ignore"):
        status, value, error, asked, iterations = _iterate_values(game, tol, max_iterations)
    # The choices of both sides at the final values.
    share, pairs = game.choose_pairs(asked.value), None
    if policy is None:
        pairs = model.pair_offsets[:-1].copy()
        pairs[game.live] = game.pairs[share == 1]
    chain, earned = game.build_chain(asked.distributions, share)
    if status is Status.PRECISION:
        warn_of_precision(float(error.max()))
    return RobustSolution(
        mdp=model,
        nature=nature,
        value=model.sense.orient(value),
        state_error=error,
        pairs=pairs,
        transition=chain,
        reward=model.sense.orient(earned),
        status=status,
        iterations=iterations,
        seconds=perf_counter() - started,
    )


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


class Game:
    """A model and nature's sets; T states that are not terminal, with U pairs that may be taken."""

    def __init__(
        self, mdp: MDP, ambiguity: Ambiguity, *, against: bool, weights: Floats | None
    ) -> None:
        """Nature minimises if `against`, else maximises; `weights` (L,) fix a policy."""
        self.mdp, self.ambiguity, self.against, self.weights = mdp, ambiguity, against, weights
        self.rewards = True  # whether rewards count
        self.live = np.flatnonzero(~mdp.terminal)
        # A given policy leaves only the pairs that it takes.
        taken = ~mdp.terminal[mdp.pair_state]
        if weights is not None:
            taken &= weights > 0
        self.pairs = np.flatnonzero(taken)
        state = mdp.pair_state[self.pairs]
        self.first = np.searchsorted(state, self.live)  # (T,) the first of each state's pairs
        self.row_state = np.searchsorted(self.live, state)  # (U,) the place of each state in `live`
        table = mdp.table
        rows = table.offsets[self.pairs], np.diff(table.offsets)[self.pairs]
        outcomes = table.next, table.compute_probabilities(), table.compute_gains()
        self.blocks = side_by_side(self.pairs, rows, outcomes)

    def solve_inner_problem(self, value: Floats) -> Inner:
        """Return nature's best distribution for each of `pairs`, at values (S,)."""
        return solve_inner_problem(
            self.ambiguity,
            self.blocks,
            value,
            discount=self.mdp.discount,
            against=self.against,
            rewards=self.rewards,
        )

    def choose_pairs(self, q: Floats) -> Floats:
        """Return (U,) the probability with which the agent takes each pair, given values (U,)."""
        if self.weights is not None:
            share = self.weights[self.pairs]
            return np.asarray(share / np.add.reduceat(share, self.first)[self.row_state])
        # The first of the best pairs in each state.
        best = np.maximum.reduceat(q, self.first)
        number = np.where(q == best[self.row_state], np.arange(len(q)), len(q))
        share = np.zeros(len(q))
        share[np.minimum.reduceat(number, self.first)] = 1.0
        return share

    def average_pairs(self, share: Floats, q: Floats) -> Floats:
        """Return (T,) the mean of pair values (U,)."""
        return np.asarray(np.add.reduceat(share * q, self.first))

    def back_up_pairs(self, q: Floats) -> Floats:
        """Return (T,) the values of states, given pair values (U,)."""
        return self.average_pairs(self.choose_pairs(q), q)

    def solve_chain(self, asked: Inner, share: Floats, order: Integers | None) -> Floats:
        """Solve for the values (S,) under nature's choice and the agent's shares (U,)."""
        chain, earned = self.build_chain(asked.distributions, share)
        return LinearSystem(chain, self.mdp.discount, order=order).approximate(earned)

    def build_chain(
        self, distributions: list[Floats], share: Floats
    ) -> tuple[sp.csr_array, Floats]:
        """Return transitions (S, S) and rewards (S,) under distributions and shares (U,)."""
        place, following, probability, earned = list_entries(self.blocks, distributions)
        source, states = self.live[self.row_state], self.mdp.n_states
        taken = share[place] > 0
        place, following, probability = place[taken], following[taken], probability[taken]
        parts = (probability * share[place], (source[place], following))
        total = np.bincount(source, weights=earned * share, minlength=states)
        return sp.csr_array(parts, (states, states)), np.asarray(total, dtype=np.float64)


def verify_margins(game: Game) -> tuple[Floats, Floats]:
    """Return weights (S,), and verified margins (T,) of the states that are not terminal."""
    # A game in which both sides maximise the number of steps.
    late = copy(game)
    late.against, late.rewards = False, False
    # Weights as in `bounds.bounds`: levels of an acyclic model, else 1, else expected steps.
    order = game.mdp.ends.most_steps
    if order is not None:
        weight = order.astype(np.float64)
    elif game.mdp.discount < 1:
        weight = (~game.mdp.terminal).astype(np.float64)
    else:
        weight = _maximise_expected_steps(late)
    # Verified by an upper bound on γ max Σ q w.
    later = np.maximum.reduceat(late.solve_inner_problem(weight).high, game.first)
    margin = np.asarray((weight[game.live] - later) * (1 - 4 * UNIT))
    if not np.all(margin > 0):
        what = "no margin against the worst distributions can be verified"
        raise SolverError(Status.NO_BOUND, what)
    return weight, margin


def _maximise_expected_steps(game: Game) -> Floats:
    """Estimate the greatest expected number of steps, by policy iteration on both choices."""
    mdp, live = game.mdp, ~game.mdp.terminal
    weight = live.astype(np.float64)
    for iteration in range(POLICIES):
        asked = game.solve_inner_problem(weight)
        gain = 1 + game.back_up_pairs(asked.value) - weight[game.live]
        # If no pair adds half a step or more, all margins exceed a half.
        if iteration and gain.max() < 0.5:
            return weight
        chain, _ = game.build_chain(asked.distributions, game.choose_pairs(asked.value))
        # The expected number of steps is infinite if some state has no way to the end.
        stuck = np.flatnonzero(~find_reachable_nodes(chain.T.tocsr(), mdp.terminal.copy()))
        if len(stuck):
            named = ", ".join(f"({label})" for label in mdp.space.labels(stuck[:4]))
            more = ""
            if len(stuck) > 4:
                more = f" and {len(stuck) - 4} more"
            raise ModelError(
                "discount 1 needs every episode to end, and under some distributions within the "
                "sets one does not",
                where=f"it stays forever among {named}{more}",
                fix="choose a discount below 1, or smaller sets that keep a way out possible",
            )
        weight = LinearSystem(chain).approximate(live.astype(np.float64))
        if not np.all(np.isfinite(weight)):
            break
    what = "the end is too many steps away under the worst distributions"
    raise SolverError(Status.NO_BOUND, what)


def _iterate_values(
    game: Game, tol: float | None, max_iterations: int
) -> tuple[Status, Floats, Floats, Inner, int]:
    """Return values and their errors (S,), nature's choice at them, and the iterations."""
    live, value, order = game.live, np.zeros(game.mdp.n_states), game.mdp.ends.most_steps
    if not len(live):
        return Status.CONVERGED, value, value.copy(), game.solve_inner_problem(value), 0
    # `best` is the least error so far, `trust` the one that solving the equations has to improve
    # on, and `step` the result of value iteration to fall back on.
    weight, margin = verify_margins(game)
    most, best, trust, step = float(weight.max()), np.inf, np.inf, value
    if game.weights is None:
        terms = 1
    else:
        terms = np.diff(np.append(game.first, len(game.pairs))).max() + 1
    for iteration in range(1, max_iterations + 1):
        # Both sides choose.
        asked, here = game.solve_inner_problem(value), value[live]
        share = game.choose_pairs(asked.value)
        # Rounding errors of the mean over pairs and of the difference from the value.
        size = np.abs(here) + np.maximum.reduceat(np.abs(asked.value), game.first)
        doubt = 4 * UNIT * terms * size
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
            return status, value, np.asarray(error * weight * SLACK), asked, iteration
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
            for _ in range(100):
                before = value
                value = game.solve_chain(game.solve_inner_problem(value), share, order)
                if not (np.abs(value - before) > 8 * UNIT * np.abs(before).max()).any():
                    break
    detail = f"{best * most:.2g} is the error bound after {max_iterations} iterations"
    raise SolverError(Status.ITERATION_LIMIT, detail)
