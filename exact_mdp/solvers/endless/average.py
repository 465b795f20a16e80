"""The best average reward per step in floats, by three methods, with verified bounds.

    policy iteration           take pairs that are greatest in (d(g), r - g + d(h), d(w) - h), in
                               this order, with g, h, w of the policy (`chain`) and d(x) = P x - x
    relative value iteration   h ← h + (T h - h) / 2, with T h = max over pairs of r + P h, where
                               the gain is the same everywhere; half a step, for periodic chains
    linear program             minimise Σ g   subject to   g ≥ P g,   g + h ≥ r + P h   for each
                               pair; the policy is improved as in policy iteration

(Puterman, Markov Decision Processes, 1994, sections 9.2.1 and 10.3, 8.5.4 and 8.5.5, 9.3). The
policy's own gain is a lower bound on the optimum. The upper bound: in an end component no policy
earns more per step than the greatest r + P h - h of its pairs, for any h. From other states no
policy earns more than the greatest expectation of these numbers, which is the value of a model in
which every policy ends, with bounds by `bounds`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any, Self

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import PairGraph
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.result import DataFrame
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import (
    RELATIVE_TOLERANCE,
    SLACK,
    choose_greedy_pairs,
    compute_advantages,
)
from exact_mdp.solvers.claims import SolverError, Status
from exact_mdp.solvers.dynamic.base import Solver
from exact_mdp.solvers.dynamic.linear_program import LinearProgram, least_above, own_states
from exact_mdp.solvers.dynamic.methods import (
    AveragePolicyIteration,
    Improved,
    PolicyIteration,
    ValueIteration,
)
from exact_mdp.solvers.endless.chain import FloatChain
from exact_mdp.solvers.endless.quotient import stop_in_components
from exact_mdp.solvers.solution import Solution, answer_maximised


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AverageSolution(Solution):
    """The best gain of a model, up to `state_error`, and a policy; `value` is the gain.

    Attributes
    ----------
    bias, bias_error : (S,)
        Bias of this policy and a bound on its error; see `solvers.endless.chain`.

    Examples
    --------
    >>> from exact_mdp.solvers import solve
    >>> mdp = MDP.from_arrays([[[0, 1], [1, 0]], [[1, 0], [0, 1]]], [[2, 0], [3, "1/2"]])
    >>> solution = solve(mdp.with_(discount="1/2"), criterion="average")
    >>> solution.value.tolist(), solution.bias.tolist(), solution.policy.rule.tolist()
    ([2.5, 2.5], [-0.25, 0.25], [0, 0])
    """

    bias: Floats
    bias_error: Floats

    @property
    def q(self) -> Floats:
        """(L,) r - g + P h: the value of taking the pair once, beyond the gain of its state."""
        step = self.mdp.undiscounted
        return np.asarray(step.backup(self.bias) - self.value[step.pair_state])

    def negated(self, mdp: MDP) -> Self:
        """See `Solution.negated`."""
        return replace(super().negated(mdp), bias=0.0 - self.bias)

    def frame(self) -> DataFrame:
        """Return gain, bias, their error bounds, and the action of each state."""
        return super().frame()

    def _tabulate_states(self, n: int) -> DataFrame:
        frame = super()._tabulate_states(n).rename(columns={"value": "gain"})
        frame.insert(3, "bias", self.bias[:n])
        frame.insert(4, "bias error", self.bias_error[:n])
        return frame


def solve_average(mdp: MDP, solver: Solver) -> AverageSolution:
    """Return the best average reward per step."""
    return answer_maximised(mdp, partial(_maximise_average, solver=solver))


def _maximise_average(mdp: MDP, solver: Solver) -> AverageSolution:
    """Return the greatest average reward of a model of maximised rewards."""
    started = perf_counter()
    methods = [run for kind, run in METHODS.items() if isinstance(solver, kind)]
    if not methods:
        raise ModelError(
            f"{solver.name} does not apply to an average reward",
            where="solve",
            fix=f"choose {', '.join(kind.name for kind in METHODS)} or auto",
        )
    if getattr(solver, "start", None) is not None:
        raise ModelError(
            "an average reward has no use for start=", where="solve", fix="leave start out"
        )
    # The method finds a policy; its own gain and the upper bound give the error in any case.
    step = mdp.undiscounted
    pairs, relative, iterations = methods[0](step, solver)
    gain, bias = FloatChain(step, pairs).evaluate_chain()
    above = _bound_gain_above(step, relative) - gain.value
    # Only value iteration stops at a tolerance; the other methods end with an optimal policy.
    if solver.name == ValueIteration.name:
        status = Status.CONVERGED
    else:
        status = Status.DIRECT
    return AverageSolution(
        mdp=mdp,
        value=gain.value,
        pairs=pairs,
        state_error=np.maximum(gain.error, above * SLACK),
        regret_bound=max(0.0, float((above + gain.error).max()) * SLACK),
        status=status,
        method=solver.name,
        solver=repr(solver),
        iterations=iterations,
        seconds=perf_counter() - started,
        bias=bias.value,
        bias_error=bias.error,
    )


def _bound_gain_above(step: MDP, bias: Floats) -> Floats:
    """Return (S,) upper bounds on the gains of all policies, from any relative values (S,)."""
    # The greatest r + P h - h in each end component, rounded up.
    graph, added = PairGraph.of(step), compute_advantages(step, bias)
    component, inside = graph.end_components(np.ones(step.n_pairs, dtype=bool))
    own, most = component[step.pair_state], added.value + added.error * SLACK
    count = int(component.max()) + 1
    top = np.full(count, -np.inf)
    np.maximum.at(top, own[inside], np.nextafter(most[inside], np.inf))
    if count == 1:
        return np.full(step.n_states, top[0])
    # In a model of the pairs outside, each end component is one state, with a stop of that value.
    model = stop_in_components(step, component, ~inside, top)
    solution = PolicyIteration().solve_rewards(model.mdp)
    most = np.nextafter(solution.value + solution.state_error * SLACK, np.inf)
    return np.asarray(most[model.new_state])


# ---- methods ------------------------------------------------------------------------------------


def _improve_policies(step: MDP, solver: PolicyIteration) -> Improved:
    """Return the policy of Howard's policy iteration, its relative values, and iterations."""
    return AveragePolicyIteration(solver.max_iterations).run(step)


def _iterate_relative_values(step: MDP, solver: ValueIteration) -> Improved:
    """Return the greedy policy, the relative values and the number of iterations.

    Relative value iteration, h ← h + (T h - h) / 2, until T h - h is proven to be constant. Half a
    step makes periodic chains converge, too (White, J. Math. Anal. Appl. 6, 1963; Puterman, 1994,
    section 8.5.4).
    """
    _require_one_gain(step)
    first, bias = step.pair_offsets[:-1], np.zeros(step.n_states)
    width = np.inf
    for iteration in range(1, solver.max_iterations + 1):
        added = compute_advantages(step, bias)
        residual = np.maximum.reduceat(added.value, first)
        # The gain lies between the least and the greatest residual, rounding counted.
        low = float(np.maximum.reduceat(added.value - added.error, first).min())
        high = float(np.maximum.reduceat(added.value + added.error, first).max())
        width, middle = high - low, (high + low) / 2
        limit = solver.tol or RELATIVE_TOLERANCE * max(1.0, abs(middle))
        if width <= limit or width <= 4 * float(added.error.max()):
            return choose_greedy_pairs(step, added), bias, iteration
        # Half a step, and h = 0 in the first state: only differences matter.
        bias += (residual - middle) / 2
        bias -= bias[0]
    detail = f"{width:.2g} is the error bound after {solver.max_iterations} iterations"
    raise SolverError(Status.ITERATION_LIMIT, detail)


def _require_one_gain(step: MDP) -> None:
    """Raise ModelError unless all states are certain to have the same optimal gain."""
    label, _ = PairGraph.of(step).end_components(np.ones(step.n_pairs, dtype=bool))
    count = int(label.max()) + 1
    if count > 1:
        raise ModelError(
            "relative value iteration needs one gain for all states: there are "
            f"{count} sets of states that a policy need not leave",
            where="solve",
            fix="use policy-iteration, which takes every model",
        )


def _solve_linear_program(step: MDP, solver: LinearProgram) -> Improved:
    """Return the policy, its relative values, and the steps of program and policy iteration.

    Policy iteration improves the greedy policy of the linear program of gains and biases.
    """
    scale, own = float(np.abs(step.reward).max()) or 1.0, own_states(step)
    # Minimise Σ g subject to (I - P) g ≥ 0 and g + (I - P) h ≥ r.
    stays = own - step.transition
    matrix = sp.block_array([[stays, None], [own, stays]])
    least, cost = np.zeros((2, step.n_pairs)), np.zeros((2, step.n_states))
    least[1], cost[0] = step.reward / scale, 1.0
    solved, steps = least_above(cost.ravel(), matrix, least.ravel(), solver.solver)
    bias = scale * solved[step.n_states :]
    # The program leaves biases open in transient states: policy iteration has the last word.
    first = choose_greedy_pairs(step, compute_advantages(step, bias))
    pairs, bias, iterations = AveragePolicyIteration().run(step, first)
    return pairs, bias, steps + iterations


METHODS: dict[type[Solver], Callable[[MDP, Any], Improved]] = {
    PolicyIteration: _improve_policies,
    ValueIteration: _iterate_relative_values,
    LinearProgram: _solve_linear_program,
}
