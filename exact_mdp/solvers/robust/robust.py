"""Robust values: the agent chooses actions, nature chooses each row's law from a set.

    V(s) = max over pairs l of s of  min over laws q in U_l of  Σ q_i (r_i + γ V(s_i))

or with either side turned round: robust and cooperative, to maximise and to minimise. The sets are
(s, a)-rectangular: nature chooses for each pair on its own, and may choose anew in every step. For
models without cycles one pass from the end gives the values up to rounding; for others value
iteration, with sweeps under the present policy and laws in between, which are kept only where they
help (after Kaufman and Schaefer, INFORMS Journal on Computing 25, 2013), until the bounds of
`solvers.robust.bounds` meet the tolerance. Sources: Iyengar, Mathematics of Operations Research 30
(2005); Nilim and El Ghaoui, Operations Research 53 (2005); Givan, Leach and Dean (2000).
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Literal

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, PolicyLike
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats, Integers, spans
from exact_mdp.solvers.bounds.gains import SLACK
from exact_mdp.solvers.bounds.linear import DIRECT_STATES, LinearSystem
from exact_mdp.solvers.dynamic.stopping import RELATIVE_TOLERANCE, check_counts
from exact_mdp.solvers.robust.bounds import Game, Margins, RobustBounds, margins, robust_bounds
from exact_mdp.solvers.robust.sets import Ambiguity, blocks_of, inner
from exact_mdp.solvers.solution import Bounded, Claim, SolverError, Status, warn_of_precision
from exact_mdp.solvers.values.policy_chain import PolicyChain

if TYPE_CHECKING:
    from pandas import DataFrame


Nature = Literal["worst", "best"]
SWEEPS = 30  # under one policy and one law of each row, between two questions to nature
MOST_SWEEPS = 500
PATIENCE = 20


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RobustSolution(Result):
    """Robust values with bounds that hold in every state, and who does what to reach them.

    Attributes
    ----------
    mdp : MDP
    nature : "worst" (against the agent) or "best" (with it)
    value : (S,)
    state_error : (S,)
        |value - V*| is at most this, and so is |value - V^π| for the policy found here.
    pairs : (S,) int64, or None
        The pair that the agent takes in each state; None where a policy was given.
    transition : (S, S)
        The chain under that policy and laws of the sets by which nature comes to about `value`;
        rows of terminal states are empty.
    reward : (S,)
        Expected rewards there.
    """

    mdp: MDP
    nature: Nature
    value: Floats
    state_error: Floats
    pairs: Integers | None
    transition: sp.csr_array
    reward: Floats
    status: Status
    iterations: int
    seconds: float
    claim: Claim = Claim.BOUNDED

    def __post_init__(self) -> None:
        for array in (self.value, self.state_error, self.pairs, self.reward):
            if array is not None:
                array.setflags(write=False)

    @property
    def policy(self) -> Policy | None:
        """The policy, which also is the array (S,) of action numbers; None where one was given."""
        mdp, pairs = self.mdp, self.pairs
        if pairs is None:
            return None
        return Policy(space=mdp.space, actions=mdp.actions, rule=mdp.pair_action[pairs])

    @property
    def error(self) -> Floats:
        """(S,) the value is off by at most this."""
        return self.state_error

    @property
    def error_bound(self) -> float:
        """The greatest error of a state."""
        return float(self.state_error.max())

    @property
    def start(self) -> Bounded:
        """The value of the start distribution with its error bound."""
        weights = self.mdp.start_distribution
        terms = weights * self.value
        rounding = (np.count_nonzero(weights) + 2) * 2.0**-52 * float(np.abs(terms).sum())
        error = float(weights @ self.state_error) * (1 + 1e-9) + rounding
        return Bounded(value=float(terms.sum()), error=error)

    @property
    def start_value(self) -> float:
        """Value of the start distribution."""
        return self.start.value

    def frame(self) -> DataFrame:
        """Return the value, its error bound and the action of each state."""
        import pandas

        mdp, policy = self.mdp, self.policy
        states = [mdp.space.label(state) for state in range(mdp.n_states)]
        found = {"state": states, "value": self.value, "error": self.state_error}
        if policy is not None:
            found["action"] = [mdp.actions[action] for action in policy.tolist()]
        return pandas.DataFrame(found)

    def __repr__(self) -> str:
        return (
            f"RobustSolution({self.mdp.sense}, nature {self.nature}: start value {self.start}, "
            f"{self.iterations} iterations, {self.seconds:.3g} s; {self.status})"
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
    ambiguity : Intervals, L1Ball, Likelihood, RelativeEntropy, or another `Ambiguity`
    nature : "worst" or "best"
        Against the agent (robust), or with it (cooperative).
    policy : PolicyLike, optional
        Hold this policy instead of choosing the best.
    tol : float, optional
        Greatest absolute error in any state; 1e-9 · max(1, |V|) unless given.
    max_iterations : int
        Of value iteration, for models with cycles.

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
    ambiguity.check(model)
    game = Game(
        mdp=model,
        ambiguity=ambiguity,
        against=(nature == "worst") == (model.sense == "max"),
        most=model.sense == "max",
        weights=None if policy is None else PolicyChain.of(model, policy).weights,
    )
    if tol is not None and not 0 < tol < np.inf:
        raise ModelError(f"tol is {tol}", where="robust", fix="choose a positive number, or None")
    check_counts("robust", max_iterations=max_iterations)
    found = margins(game)
    if game.order is None:
        status, end, iterations = _iterate(game, found, tol, max_iterations)
    else:
        end = robust_bounds(game, found, _one_pass(game, game.order))
        status, iterations = Status.DIRECT, int(game.order.max(initial=0))
    pairs = None
    if end.chosen is not None:
        pairs = model.pair_offsets[:-1].copy()
        pairs[game.live] = game.pairs[end.chosen]
    chain, earned = game.chain(end.asked.laws, end.chosen)
    solution = RobustSolution(
        mdp=model,
        nature=nature,
        value=np.array(end.value),
        state_error=np.asarray(end.error * end.weight * SLACK),
        pairs=pairs,
        transition=chain,
        reward=earned,
        status=status,
        iterations=iterations,
        seconds=perf_counter() - started,
    )
    if status is Status.PRECISION:
        message = f"the error bound is {solution.error_bound:.2g}: {status}"
        warn_of_precision(message)
    return solution


def _one_pass(game: Game, level: Integers) -> Floats:
    """Return (S,) robust values of an acyclic model, level by level from the end."""
    mdp = game.mdp
    value = np.zeros(mdp.n_states)
    states, state_level = game.live, level[game.live]
    lengths = np.diff(np.append(game.first, len(game.pairs)))
    for depth in range(1, int(level.max(initial=0)) + 1):
        now = np.flatnonzero(state_level == depth)
        positions = spans(game.first[now], game.first[now] + lengths[now])
        rows = blocks_of(mdp, game.pairs[positions])
        found = inner(game.ambiguity, rows, value, discount=mdp.discount, against=game.against)
        first = np.cumsum(lengths[now]) - lengths[now]
        if game.weights is not None:
            worth = np.add.reduceat(game.share[positions] * found.value, first)
        else:
            worth = (np.maximum if game.most else np.minimum).reduceat(found.value, first)
        value[states[now]] = worth
    return value


def _iterate(
    game: Game, found: Margins, tol: float | None, max_iterations: int
) -> tuple[Status, RobustBounds, int]:
    """Improve values until their bounds meet the tolerance, or rounding stops them."""
    live, rate = game.live, game.mdp.discount
    weight, most = found.weight, float(found.weight.max(initial=0.0))
    value = kept = np.zeros(game.mdp.n_states)
    if not len(live):
        return Status.CONVERGED, robust_bounds(game, found, value), 0
    sweeps, trust, best, idle, near = SWEEPS, np.inf, np.inf, 0, np.inf
    for iteration in range(1, max_iterations + 1):
        asked = game.ask(value)
        worth = game.agent(asked.value)
        ratio = (worth - value[live]) / found.margin
        low, high = float(ratio.min()), float(ratio.max())
        size, half = max(high, -low), (high - low) / 2 * most
        if not np.isfinite(size):
            raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
        limit = tol or RELATIVE_TOLERANCE * max(1.0, float(np.abs(worth).max()))
        idle = 0 if half < best * 0.999 else idle + 1
        best = min(best, half)
        noise = float((asked.high - asked.low).max() / found.margin.min()) * most
        stalled = idle >= PATIENCE and sweeps == 0 and half <= 4 * noise
        if stalled or half <= min(limit, near):
            # The middle between the bounds that the ratios suggest; `robust_bounds` verifies it.
            end = robust_bounds(game, found, value + (high + low) / 2 * weight)
            if end.error * most <= limit:
                return Status.CONVERGED, end, iteration
            if stalled:
                return Status.PRECISION, end, iteration
            near = half / 2
        if size > trust:  # the sweeps led away from the fixed point: go back, and do fewer
            value, trust, sweeps = kept, np.inf, sweeps // 4
            continue
        if idle >= PATIENCE and sweeps:
            sweeps, idle = 0, 0
        sweeps = min(2 * sweeps, MOST_SWEEPS) if size < trust / 2 else sweeps
        kept = value.copy()
        kept[live] = worth
        value, trust = kept.copy(), size if sweeps else np.inf
        if sweeps:
            chain, earned = game.chain(
                asked.laws, None if game.weights is not None else game.choice(asked.value)
            )
            if len(live) <= DIRECT_STATES:
                value = LinearSystem(chain, rate).approximate(earned)
                continue
            for _ in range(sweeps):
                value = earned + rate * (chain @ value)
    error = robust_bounds(game, found, value).error * most
    raise SolverError(
        Status.ITERATION_LIMIT,
        f"{error:.2g} is the error bound after {max_iterations} iterations",
    )
