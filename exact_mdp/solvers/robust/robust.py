"""Robust values: the agent chooses actions, nature chooses each row's law from a set.

    V(s) = max over pairs l of s of  min over laws q in U_l of  Σ q_i (r_i + γ V(s_i))

or with either side turned round; nature chooses for each pair on its own. The equations of the
present policy and laws are solved in turn with choosing both anew, or where that brings the bounds
no closer, a step of value iteration is taken (Iyengar, Mathematics of Operations Research 30, 2005;
Kaufman and Schaefer, INFORMS Journal on Computing 25, 2013). If both go round, nature settles first
(Hoffman and Karp, Management Science 12, 1966). With T the right side, and w > 0 but at ends,

    m(s) = w(s) - γ max over the pairs l of s, and the laws q of l, of Σ q w  > 0,
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
from exact_mdp.mdp.graph import beside_goal, find_reachable_nodes, topological_levels
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import MOST_BYTES, Floats, Integers
from exact_mdp.solvers.bounds.gains import POLICIES, SLACK, UNIT
from exact_mdp.solvers.bounds.linear import LinearSystem
from exact_mdp.solvers.dynamic.base import RELATIVE_TOLERANCE, check_counts, check_tolerance
from exact_mdp.solvers.robust.sets import (
    Ambiguity,
    Inner,
    list_entries,
    side_by_side,
    solve_inner_problem,
)
from exact_mdp.solvers.solution import Found, SolverError, Status, warn_of_precision
from exact_mdp.solvers.values.policy_chain import PolicyChain

Nature = Literal["worst", "best"]
OF_OUTCOME = 360  # bytes that the analysis of both sides takes for each outcome, as measured
TURNS, SETTLING = 20, 100  # choices of both sides at once; of nature alone after one of the agent


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RobustSolution(Found, Result):
    """Robust values with bounds that hold in every state, and who does what to reach them.

    |value - V*| is at most `state_error`, and so is |value - V^π| for the policy found here; where
    one was given, `pairs` is None.
    """

    nature: Nature  # "worst" is against the agent, "best" with it
    transition: sp.csr_array  # (S, S) under that policy and laws by which nature comes to `value`
    reward: Floats  # (S,) expected rewards there

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
    """Return the value of the best policy, or of a given one, where nature chooses the laws.

    Parameters
    ----------
    model : MDP
    ambiguity : Intervals, L1Ball, Likelihood, or another `Ambiguity`
    nature : "worst" or "best"
        Against the agent (robust), or with it (cooperative).
    policy : PolicyLike, optional
        Hold this policy instead of choosing the best.
    tol : float, optional
        Greatest absolute error in any state; 1e-9 · max(1, |V|) unless given.
    max_iterations : int
        How often nature and the agent choose anew.

    Returns
    -------
    RobustSolution

    Raises
    ------
    ModelError
        Where the sets do not fit the model; at discount 1, where under some policy and laws an
        episode never ends.
    SolverError
        At the iteration limit, or where double precision cannot bound the error.

    Examples
    --------
    >>> from exact_mdp.solvers.robust.sets import Intervals
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])  # worth 1 / (1 - p)
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
    if model.discount_exact == 1 and (beside := beside_goal(model)).any():
        raise ModelError(
            "a run that ends beside the goal is worth infinity, and robust values are finite",
            where=model.space.place(int(beside.argmax())),
            fix="choose a discount below 1, or ask for the chance of getting there "
            "(--reach LABEL, model.reaching(label))",
        )
    check_tolerance("robust", tol)
    check_counts("robust", max_iterations=max_iterations)
    game = Game(
        model.maximised,
        ambiguity,
        against=nature == "worst",
        weights=None if policy is None else PolicyChain.of(model, policy).weights,
    )
    with np.errstate(over="ignore", invalid="ignore"):
        status, value, error, asked, iterations = _iterate_values(game, tol, max_iterations)
    share, pairs = game.choose_pairs(asked.value), None
    if policy is None:
        pairs = model.pair_offsets[:-1].copy()
        pairs[game.live] = game.pairs[share == 1]
    chain, earned = game.build_chain(asked.laws, share)
    if status is Status.PRECISION:
        warn_of_precision(float(error.max()))
    return RobustSolution(
        mdp=model,
        nature=nature,
        value=model.sign * value + 0.0,
        state_error=error,
        pairs=pairs,
        transition=chain,
        reward=model.sign * earned + 0.0,
        status=status,
        iterations=iterations,
        seconds=perf_counter() - started,
    )


def require_room_for_rows(model: MDP) -> None:
    """Raise ModelError where the sets of all rows would not fit in memory."""
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
        """Nature is `against` high values of rows, or for them; `weights` (L,) fix a policy."""
        self.mdp, self.ambiguity, self.against, self.weights = mdp, ambiguity, against, weights
        self.rewards = True  # whether they count
        self.live = np.flatnonzero(~mdp.terminal)
        taken = ~mdp.terminal[mdp.pair_state]
        self.pairs = np.flatnonzero(taken if weights is None else taken & (weights > 0))
        state = mdp.pair_state[self.pairs]
        self.first = np.searchsorted(state, self.live)  # (T,) of each state's pairs
        self.row_state = np.searchsorted(self.live, state)  # (U,)
        table = mdp.table
        rows = table.offsets[self.pairs], np.diff(table.offsets)[self.pairs]
        outcomes = table.next, table.compute_probabilities(), table.compute_gains()
        self.blocks = side_by_side(self.pairs, rows, outcomes)

    def solve_inner_problem(self, value: Floats) -> Inner:
        """Return nature's best reply to each of `pairs`, at values (S,)."""
        return solve_inner_problem(
            self.ambiguity,
            self.blocks,
            value,
            discount=self.mdp.discount,
            against=self.against,
            rewards=self.rewards,
        )

    def choose_pairs(self, q: Floats) -> Floats:
        """Return (U,) the agent's share of each pair, given their values (U,)."""
        if self.weights is not None:
            share = self.weights[self.pairs]
            return np.asarray(share / np.add.reduceat(share, self.first)[self.row_state])
        best = np.maximum.reduceat(q, self.first)
        number = np.where(q == best[self.row_state], np.arange(len(q)), len(q))
        share = np.zeros(len(q))
        share[np.minimum.reduceat(number, self.first)] = 1.0
        return share

    def average_pairs(self, share: Floats, q: Floats) -> Floats:
        """Return (T,) the mean of pair values (U,)."""
        return np.asarray(np.add.reduceat(share * q, self.first))

    def back_up_pairs(self, q: Floats) -> Floats:
        """Return (T,) what the agent makes of pair values (U,)."""
        return self.average_pairs(self.choose_pairs(q), q)

    def solve_chain(self, asked: Inner, share: Floats, order: Integers | None) -> Floats:
        """Return about the values (S,) under what nature chose and shares (U,)."""
        chain, earned = self.build_chain(asked.laws, share)
        return LinearSystem(chain, self.mdp.discount, order=order).approximate(earned)

    def build_chain(self, laws: list[Floats], share: Floats) -> tuple[sp.csr_array, Floats]:
        """Return transitions (S, S) and expected rewards (S,) under laws and shares (U,)."""
        place, following, probability, earned = list_entries(self.blocks, laws)
        source, states = self.live[self.row_state], self.mdp.n_states
        taken = share[place] > 0
        place, following, probability = place[taken], following[taken], probability[taken]
        parts = (probability * share[place], (source[place], following))
        total = np.bincount(source, weights=earned * share, minlength=states)
        return sp.csr_array(parts, (states, states)), np.asarray(total, dtype=np.float64)


def verify_margins(game: Game) -> tuple[Floats, Floats]:
    """Return weights (S,), and verified margins (T,) of the states that are not terminal."""
    late = copy(game)  # both sides are after steps
    late.against, late.rewards = False, False
    if (order := topological_levels(game.mdp)) is not None:
        weight = order.astype(np.float64)
    elif game.mdp.discount < 1:
        weight = (~game.mdp.terminal).astype(np.float64)
    else:
        weight = _maximise_expected_steps(late)
    later = np.maximum.reduceat(late.solve_inner_problem(weight).high, game.first)
    margin = np.asarray((weight[game.live] - later) * (1 - 4 * UNIT))
    if not np.all(margin > 0):
        raise SolverError(Status.NO_BOUND, "no margin against the worst laws can be verified")
    return weight, margin


def _maximise_expected_steps(game: Game) -> Floats:
    """Return about the greatest expected number of steps, by policy iteration on both choices."""
    mdp, live = game.mdp, ~game.mdp.terminal
    weight = live.astype(np.float64)
    for iteration in range(POLICIES):
        asked = game.solve_inner_problem(weight)
        gain = 1 + game.back_up_pairs(asked.value) - weight[game.live]
        # What adds less than half a step leaves a margin of over a half.
        if iteration and gain.max() < 0.5:
            return weight
        chain, _ = game.build_chain(asked.laws, game.choose_pairs(asked.value))
        stuck = np.flatnonzero(~find_reachable_nodes(chain.T.tocsr(), mdp.terminal.copy()))
        if len(stuck):
            named = ", ".join(f"({label})" for label in mdp.space.labels(stuck[:4]))
            more = ""
            if len(stuck) > 4:
                more = f" and {len(stuck) - 4} more"
            raise ModelError(
                "discount 1 needs every episode to end, and under laws within the sets one does "
                "not",
                where=f"it stays forever among {named}{more}",
                fix="choose a discount below 1, or smaller sets that keep a way out possible",
            )
        weight = LinearSystem(chain).approximate(live.astype(np.float64))
        if not np.all(np.isfinite(weight)):
            break
    raise SolverError(Status.NO_BOUND, "the end is too many steps away under the worst laws")


def _iterate_values(
    game: Game, tol: float | None, max_iterations: int
) -> tuple[Status, Floats, Floats, Inner, int]:
    """Return values and their errors (S,), what nature makes of them, and the iterations."""
    live, value, order = game.live, np.zeros(game.mdp.n_states), topological_levels(game.mdp)
    if not len(live):
        return Status.CONVERGED, value, value.copy(), game.solve_inner_problem(value), 0
    weight, margin = verify_margins(game)
    most, best, trust, step = float(weight.max()), np.inf, np.inf, value
    if game.weights is None:
        terms = 1
    else:
        terms = np.diff(np.append(game.first, len(game.pairs))).max() + 1
    for iteration in range(1, max_iterations + 1):
        asked, here = game.solve_inner_problem(value), value[live]
        share = game.choose_pairs(asked.value)
        # What rounds here: the mean over pairs, and the difference from the value.
        size = np.abs(here) + np.maximum.reduceat(np.abs(asked.value), game.first)
        doubt = 4 * UNIT * terms * size
        # Bounds of what a step adds, to the optimum and to the policy that takes these pairs.
        low = (
            np.minimum(game.back_up_pairs(asked.low), game.average_pairs(share, asked.low))
            - here
            - doubt
        )
        high = (
            np.maximum(game.back_up_pairs(asked.high), game.average_pairs(share, asked.high))
            - here
            + doubt
        )
        # NumPy's maximum is not a number where one of them is none, as beyond the range of floats.
        error = float(np.max([0.0, (high / margin).max(), -(low / margin).min()])) * SLACK
        if not error < trust:  # the equations led away: a step of value iteration does not
            if trust == np.inf:
                raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
            value, trust = step, np.inf
            continue
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
        value = game.solve_chain(asked, share, order)
        # Both at once may go round, each undoing the other's choice: then nature settles first, and
        # what the agent gains grows, whatever the bounds do on the way.
        trust = error
        if iteration > TURNS:
            trust = np.inf
        for _ in range(SETTLING if iteration > TURNS else 0):
            before, value = value, game.solve_chain(game.solve_inner_problem(value), share, order)
            if not (np.abs(value - before) > 8 * UNIT * np.abs(before).max()).any():
                break
    detail = f"{best * most:.2g} is the error bound after {max_iterations} iterations"
    raise SolverError(Status.ITERATION_LIMIT, detail)
