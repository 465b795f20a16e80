"""Linear programming: the least V above its own backup, or the best occupancy measure.

    primal   minimise α V     subject to   V(s) ≥ r(l) + γ P_l V     for every pair l of every s
    dual     maximise r y     subject to   Σ_{l of s} y(l) - γ Σ_l P(l, s) y(l) = α(s),   y ≥ 0

over the states that are not terminal; those are worth 0. The weights α are positive and the same
everywhere, so that the primal gives the value of every state and the dual takes a decision in
every state, reached from the start or not (d'Epenoux, Management Science 10, 1963; Puterman,
Markov Decision Processes, 1994, section 6.9). With them the dual's y would count visits from a
uniform start. What is returned as `occupancy` is the dual's solution at α = the model's start: the
visits of the optimal policy.

With a known policy to start from, no optimiser is needed: constraints are generated. One pair for
each state makes the program a system of equations; where its solution violates constraints, those
of the greatest violation take the place of their states' own, until none is violated. This is
policy iteration, read as a simplex method that exchanges many constraints at once (Ye, Mathematics
of Operations Research 36, 2011). From a good policy one or two rounds remain, and what comes out is
the proof: values that satisfy every constraint, and visits that solve the dual, see
`Solution.program`.

An optimiser is right to six or eight digits. The policy that it implies is evaluated, and improved
as in policy iteration where that shows it not to be optimal, so that the answer has rounding errors
alone; the optimiser's own objective is checked against it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.bounds import greedy, margin_weights
from exact_mdp.solvers.bounds.gains import gains
from exact_mdp.solvers.dynamic.policy_iteration import improved
from exact_mdp.solvers.dynamic.program import check_size, sides, visits
from exact_mdp.solvers.dynamic.stopping import conclude
from exact_mdp.solvers.solution import ProgramRun, Solution, SolverError, Status

OPTIMISERS = ("CLARABEL", "HIGHS")
FORMS = ("primal", "dual")
IMPROVEMENTS = 1000
AGREEMENT = 1e-5
GENERATION = "constraint generation"


@dataclass(frozen=True, kw_only=True)
class LinearProgram:
    """Solve by a linear program; adds the gap of every pair and the visits of the policy.

    Parameters
    ----------
    solver : "CLARABEL" or "HIGHS"
        Interior points, or a simplex method.
    form : "primal" or "dual"
    start : Solution, Policy, or (S,) ints, optional
        A known deterministic policy, or its action numbers: generate constraints from it, without
        an optimiser. For models too large for one; those are refused otherwise.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[1, 0], [0, 1]], [[0, 1], [0, 1]]], [[1, -1], [2, 1]], "1/2")
    >>> solution = LinearProgram().solve(mdp)
    >>> solution.value.tolist(), solution.gaps.tolist(), solution.occupancy.tolist()
    ([2.0, 4.0], [0.0, 1.0, 0.0, 1.0], [2.0, 0.0, 0.0, 0.0])
    """

    solver: str = "CLARABEL"
    form: Literal["primal", "dual"] = "primal"
    start: Solution | Policy | Integers | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        for key, value, known in (
            ("solver", self.solver, OPTIMISERS),
            ("form", self.form, FORMS),
        ):
            if value not in known:
                fix = suggest(str(value), known)
                raise ModelError(f"unknown {key} {value!r}", where="LinearProgram", fix=fix)

    def __repr__(self) -> str:
        start = "" if self.start is None else ", start=…"
        return f"LinearProgram(solver={self.solver!r}, form={self.form!r}{start})"

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
        if self.start is None:
            check_size(mdp, self.solver)
        margin_weights(mdp)
        if self.start is None:
            pairs, objective, steps, clock = self._program(mdp)
        else:
            pairs, objective, steps, clock = _pairs_of(mdp, self.start), None, 0, (0.0, 0.0)
        begun = perf_counter()
        used = np.zeros(mdp.n_pairs, dtype=bool)
        found, improvements, stable = improved(mdp, pairs, IMPROVEMENTS, used=used)
        generated = perf_counter() - begun
        value = found.value
        reached = float(value[~mdp.terminal].mean()) if (~mdp.terminal).any() else 0.0
        if objective is not None and not (
            abs(objective - reached) <= AGREEMENT * (abs(reached) + np.abs(mdp.reward).max())
        ):
            detail = f"{self.solver} found a mean value of {objective:.9g}, it is {reached:.9g}"
            raise SolverError(Status.PROGRAM_FAILED, detail)
        met = visits(mdp, found.pairs)
        lower, upper = sides(mdp, found, met)
        occupancy = np.zeros(mdp.n_pairs)
        occupancy[found.pairs] = met.value
        open_pairs = ~mdp.terminal[mdp.pair_state]
        known = self.start is not None
        used[found.pairs] = True
        run = ProgramRun(
            by=GENERATION if known else self.solver,
            variables=int((~mdp.terminal).sum()),
            constraints=int(open_pairs.sum()),
            entries=int(np.diff(mdp.transition.indptr)[open_pairs].sum()),
            used=int((used & open_pairs).sum() if known else open_pairs.sum()),
            rounds=improvements if known else steps,
            compile_seconds=clock[0],
            solve_seconds=generated if known else clock[1],
            verify_seconds=perf_counter() - begun - (generated if known else 0.0),
            lower=lower,
            upper=upper,
        )
        solution = conclude(
            mdp,
            self,
            found,
            status=Status.DIRECT if stable else Status.ITERATION_LIMIT,
            iterations=steps + improvements,
            started=started,
            gaps=0.0 - gains(mdp, value).value,
            occupancy=occupancy,
        )
        return replace(solution, program=run)

    def _program(self, mdp: MDP) -> tuple[Integers, float, int, tuple[float, float]]:
        """Return pairs (S,), the mean value over open states, the optimiser's steps, and seconds.

        The seconds are those of stating the program, sparse throughout, and of solving it.
        """
        import cvxpy as cp

        begun = perf_counter()
        live, rate = ~mdp.terminal, mdp.discount
        open_pairs = live[mdp.pair_state]
        scale = float(np.abs(mdp.reward).max())
        if scale == 0.0:
            return mdp.pair_offsets[:-1], 0.0, 0, (0.0, 0.0)
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
        stated = perf_counter() - begun
        self._run(problem)
        compiled = stated + float(problem.compilation_time or 0.0)
        clock = (compiled, perf_counter() - begun - compiled)
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
        return pairs, float(problem.value) * scale, steps, clock

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


def _actions_of(mdp: MDP, start: Solution | Policy | Integers) -> Integers:
    """Return (S,) the action numbers of a known policy; raises ModelError where it has none."""
    if isinstance(start, Policy):
        if start.deterministic:
            return start.choices(mdp)
        wrong = "a policy that draws its actions"
    else:
        try:
            actions = start.policy if isinstance(start, Solution) else np.asarray(start)
        except ValueError:  # rows of different lengths
            actions = np.empty((), dtype=object)
        if actions.ndim == 0 or actions.dtype.kind not in "iufb":
            wrong = f"{type(start).__name__} is no policy"
        elif actions.dtype.kind not in "iu":
            wrong = f"action numbers of type {actions.dtype}, not integers"
        elif actions.shape != (mdp.n_states,):
            wrong = f"a policy of shape {actions.shape} for {mdp.n_states} states"
        else:
            return actions
    raise ModelError(
        wrong,
        where="LinearProgram(start=…)",
        fix="give a solution of this model, a deterministic policy, or an action number for each "
        "state",
    )


def _pairs_of(mdp: MDP, start: Solution | Policy | Integers) -> Integers:
    """Return (S,) the pairs of a known policy; raises ModelError where it does not fit."""
    actions = _actions_of(mdp, start)
    keys = mdp.pair_state * mdp.n_actions + mdp.pair_action
    wanted = np.arange(mdp.n_states) * mdp.n_actions + actions
    found = np.minimum(np.searchsorted(keys, wanted), mdp.n_pairs - 1)
    wrong = (keys[found] != wanted) | (actions < 0) | (actions >= mdp.n_actions)
    if wrong.any():
        state = int(np.flatnonzero(wrong)[0])
        raise ModelError(
            f"action {actions[state]} is not available",
            where=f"LinearProgram(start=…), state ({mdp.space.label(state)})",
            fix="choose one that the state offers",
        )
    return np.asarray(found)
