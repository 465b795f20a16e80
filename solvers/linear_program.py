"""Linear programming: the least V above its own backup, or the best occupancy measure.

    primal   minimise α V     subject to   V(s) ≥ r(l) + γ P_l V     for every pair l of every s
    dual     maximise r y     subject to   Σ_{l of s} y(l) - γ Σ_l P(l, s) y(l) = α(s),   y ≥ 0

over the states that are not terminal; those are worth 0. The weights α are positive and the same
everywhere, so that the primal gives the value of every state and the dual takes a decision in
every state, reached from the start or not (d'Epenoux, Management Science 10, 1963; Puterman,
Markov Decision Processes, 1994, section 6.9). With them the dual's y would count visits from a
uniform start. What is returned as `occupancy` is the dual's solution at α = the model's start: the
visits of the optimal policy.

An optimiser is right to six or eight digits. The policy that it implies is evaluated, and improved
as in policy iteration where that shows it not to be optimal, so that the answer has rounding errors
alone; the optimiser's own objective is checked against it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp

from mdp.errors import ModelError, suggest
from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers.bounds import greedy, levels, margin_weights
from solvers.conclusion import conclude
from solvers.gains import gains
from solvers.linear import LinearSystem, policy_chain
from solvers.policy_iteration import improved
from solvers.solution import Solution, SolverError, Status

OPTIMISERS = ("CLARABEL", "HIGHS")
FORMS = ("primal", "dual")
IMPROVEMENTS = 1000
AGREEMENT = 1e-5


@dataclass(frozen=True, kw_only=True)
class LinearProgram:
    """Solve by a linear program; adds the gap of every pair and the visits of the policy.

    Parameters
    ----------
    solver : "CLARABEL" or "HIGHS"
        Interior points, or a simplex method.
    form : "primal" or "dual"

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[1, 0], [0, 1]], [[0, 1], [0, 1]]], [[1, -1], [2, 1]], "1/2")
    >>> solution = LinearProgram().solve(mdp)
    >>> solution.value.tolist(), solution.gaps.tolist(), solution.occupancy.tolist()
    ([2.0, 4.0], [0.0, 1.0, 0.0, 1.0], [2.0, 0.0, 0.0, 0.0])
    """

    solver: str = "CLARABEL"
    form: Literal["primal", "dual"] = "primal"

    def __post_init__(self) -> None:
        for key, value, known in (
            ("solver", self.solver, OPTIMISERS),
            ("form", self.form, FORMS),
        ):
            if value not in known:
                fix = suggest(str(value), known)
                raise ModelError(f"unknown {key} {value!r}", where="LinearProgram", fix=fix)

    @property
    def name(self) -> str:
        return "linear-program"

    @np.errstate(over="ignore", invalid="ignore")
    def solve(self, mdp: MDP) -> Solution:
        """Return the optimum up to rounding, with `gaps` and `occupancy`.

        Raises
        ------
        ModelError
            At discount 1 where not every policy ends.
        SolverError
            Where the optimiser fails, or double precision cannot bound the error.
        """
        started = perf_counter()
        margin_weights(mdp)
        pairs, objective, steps = self._program(mdp)
        found, improvements, stable = improved(mdp, pairs, IMPROVEMENTS)
        value = found.value
        reached = float(value[~mdp.terminal].mean()) if (~mdp.terminal).any() else 0.0
        if not abs(objective - reached) <= AGREEMENT * (abs(reached) + np.abs(mdp.reward).max()):
            detail = f"{self.solver} found a mean value of {objective:.9g}, it is {reached:.9g}"
            raise SolverError(Status.PROGRAM_FAILED, detail)
        gap = 0.0 - gains(mdp, value).value
        return conclude(
            mdp,
            self,
            found,
            status=Status.DIRECT if stable else Status.ITERATION_LIMIT,
            iterations=steps + improvements,
            started=started,
            gaps=gap,
            occupancy=visits(mdp, found.pairs),
        )

    def _program(self, mdp: MDP) -> tuple[Integers, float, int]:
        """Return pairs (S,), the mean value over open states, and the optimiser's steps."""
        import cvxpy as cp

        live, rate = ~mdp.terminal, mdp.discount
        open_pairs = live[mdp.pair_state]
        scale = float(np.abs(mdp.reward).max())
        if scale == 0.0:
            return mdp.pair_offsets[:-1], 0.0, 0
        reward = mdp.reward[open_pairs] / scale
        own = sp.csr_array(
            (np.ones(mdp.n_pairs), mdp.pair_state, np.arange(mdp.n_pairs + 1)), mdp.transition.shape
        )
        matrix = sp.csc_array((own - rate * mdp.transition)[open_pairs][:, live])
        count = int(live.sum())
        alpha = np.full(count, 1 / count)
        if self.form == "primal":
            value = cp.Variable(count)
            problem = cp.Problem(cp.Minimize(alpha @ value), [matrix @ value >= reward])
        else:
            visits = cp.Variable(int(open_pairs.sum()), nonneg=True)
            problem = cp.Problem(cp.Maximize(reward @ visits), [matrix.T @ visits == alpha])
        self._run(problem)
        steps = int(problem.solver_stats.num_iters or 0)
        if self.form == "primal":
            found = np.zeros(mdp.n_states)
            found[live] = np.asarray(value.value) * scale
            pairs = greedy(mdp, gains(mdp, found))
        else:
            used = np.zeros(mdp.n_pairs)
            used[open_pairs] = visits.value
            best = np.maximum.reduceat(used, mdp.pair_offsets[:-1])[mdp.pair_state]
            numbers = np.where(used == best, np.arange(mdp.n_pairs), mdp.n_pairs)
            pairs = np.minimum.reduceat(numbers, mdp.pair_offsets[:-1])
        return pairs, float(problem.value) * scale, steps

    def _run(self, problem: Any) -> None:
        import cvxpy as cp

        try:
            # What cvxpy would warn of, an inaccurate solution, is an error here.
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                problem.solve(solver=self.solver)
        except cp.SolverError as error:
            raise SolverError(Status.PROGRAM_FAILED, f"{self.solver}: {error}") from error
        if problem.status != cp.OPTIMAL:
            raise SolverError(Status.PROGRAM_FAILED, f"{self.solver} says {problem.status}")


def visits(mdp: MDP, pairs: Integers) -> Floats:
    """Return (L,) how often each pair is used from the start, discounted; 0 in terminal states."""
    chain, _ = policy_chain(mdp, pairs)
    level = levels(mdp)
    order = None if level is None else -level
    system = LinearSystem(sp.csr_array(chain.T), mdp.discount, order=order)
    occupancy = np.zeros(mdp.n_pairs)
    by_state = system.approximate(mdp.start_distribution)
    occupancy[pairs] = np.where(mdp.terminal, 0.0, by_state)
    return occupancy
