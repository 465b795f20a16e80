"""Five textbook algorithms, each as its loop, its step and its stopping rule.

    value iteration              V ← T V,   (T V)(s) = max over pairs l of s of r(l) + γ P_l V
    Gauss-Seidel                 the same, state after state, up and down their numbers in turn
    modified policy iteration    π greedy for V,   V ← (T_π)^m V
    policy iteration             π greedy for V,   V ← (I - γ P_π)⁻¹ r_π
    backward induction           V(s) ← (T V)(s) once, from the end to the start, without cycles

Every loop begins with a pass over all pairs, which gives T V - V, a greedy policy and two-sided
bounds on V*; it stops when these are proven to be within the tolerance (`stopping`), and answers
with the middle between them. Sources: Puterman, Markov Decision Processes, 1994, sections 4.5 and
6.3 to 6.5; Puterman and Shin, Management Science 24, 1978; Howard, Dynamic Programming and Markov
Processes, 1960.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.bounds.bounds import bound_optimal_values, solve_backward
from exact_mdp.solvers.claims import SolverError, Status
from exact_mdp.solvers.dynamic.base import (
    Solver,
    StoppingRule,
    check_counts,
    check_tolerance,
    conclude_solution,
    read_start_values,
)
from exact_mdp.solvers.dynamic.evaluation import PolicyEvaluation
from exact_mdp.solvers.dynamic.values import PATIENCE, Values
from exact_mdp.solvers.solution import Solution


@dataclass(frozen=True, kw_only=True)
class Improving(Solver):
    """A method that improves values step by step until their error bound is at most `tol`.

    Parameters
    ----------
    tol : float, optional
        Greatest absolute error in any state; 1e-9 · max(1, |V|) unless given.
    max_iterations : int
        Steps after which to give up, with a SolverError.
    start : (S,) floats or PolicyLike, optional
        Values to begin with, or a policy, which stands for its values. By default 0; for modified
        policy iteration the greatest rewards, the result of a sweep from 0.
    """

    tol: float | None = None
    max_iterations: int = 1_000_000
    start: Any = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_tolerance(type(self).__name__, self.tol)
        check_counts(type(self).__name__, max_iterations=self.max_iterations)

    def begin(self, model: MDP) -> tuple[Values, StoppingRule]:
        """Return the values to begin with, and the rule that decides when they are near enough."""
        values = Values(model, read_start_values(model, self.start))
        return values, StoppingRule(values, self.tol)


@dataclass(frozen=True, kw_only=True)
class ValueIteration(Improving):
    """Improve the values sweep by sweep; see `Improving` for the settings.

    If a hundred sweeps do not narrow the bounds by a tenth, every second sweep is replaced by a
    solution of the policy's equations: then slowly mixing chains end, too.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[1]]], [1], discount="9/10")
    >>> round(ValueIteration(tol=1e-6).solve(mdp).start_value, 6)
    10.0
    """

    name: ClassVar[str] = "value-iteration"

    def maximise(self, model: MDP) -> Solution:
        """Return the optimum within `tol`."""
        started = perf_counter()
        values, stopping = self.begin(model)
        for _ in range(self.max_iterations):
            values.pass_over_pairs()
            if stopping.is_reached():
                break
            if stopping.needs_equations():
                with suppress(SolverError):  # the next backup helps, too
                    values.solve_policy_equations()
            else:
                values.apply_backup()
        return stopping.conclude(self, started)


@dataclass(frozen=True, kw_only=True)
class GaussSeidel(Improving):
    """Improve the values state by state; an ordinary sweep before each gives the bounds.

    See `ValueIteration` for chains that mix slowly, and `Improving` for the settings.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[1]]], [1], discount="9/10")
    >>> round(GaussSeidel(tol=1e-6).solve(mdp).start_value, 6)
    10.0
    """

    name: ClassVar[str] = "gauss-seidel"

    def maximise(self, model: MDP) -> Solution:
        """Return the optimum within `tol`."""
        started = perf_counter()
        values, stopping = self.begin(model)
        for _ in range(self.max_iterations):
            values.pass_over_pairs()
            if stopping.is_reached():
                break
            if stopping.needs_equations():
                with suppress(SolverError):  # the next sweep helps, too
                    values.solve_policy_equations()
            else:
                values.apply_backup()
                values.sweep_states()
        return stopping.conclude(self, started)


@dataclass(frozen=True, kw_only=True)
class ModifiedPolicyIteration(Improving):
    """Policy iteration with evaluation by sweeps; see `Improving` for the settings.

    A sweep for one policy costs the A-th part of a full one. Sweeps go on until the error within
    the policy is a tenth of the error before; see `PolicyEvaluation` for chains that mix slowly.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[1]]], [1], discount="9/10")
    >>> round(ModifiedPolicyIteration().solve(mdp).start_value, 9)
    10.0
    """

    max_iterations: int = 10_000

    name: ClassVar[str] = "modified-policy-iteration"

    def maximise(self, model: MDP) -> Solution:
        """Return the optimum within `tol`."""
        started = perf_counter()
        start = self.start
        if start is None:
            # The greatest rewards: a backup of 0 that takes no pass.
            start = np.maximum.reduceat(model.reward, model.pair_offsets[:-1])
        values = Values(model, read_start_values(model, start))
        evaluation = PolicyEvaluation(values)
        stopping = StoppingRule(values, self.tol, is_polished=self.tol is None)
        for iteration in range(self.max_iterations):
            values.pass_over_pairs()
            if stopping.is_reached():
                break
            tolerance = stopping.choose_evaluation_tolerance()
            if iteration == 0 and tolerance > 0:
                # The first policy knows only one reward ahead, and is not worth an evaluation.
                values.apply_backup()
            else:
                evaluation.run(tolerance)
        return stopping.conclude(self, started)


@dataclass(frozen=True, kw_only=True)
class PolicyIteration(Solver):
    """Howard's policy iteration; only rounding errors remain.

    A pair is kept unless another is better as computed, and the search stops when a policy repeats.
    The number of iterations does not depend on how fast the chain mixes.

    Parameters
    ----------
    max_iterations : int
        Policies to evaluate before giving up, with a SolverError.
    start : PolicyLike or (S,) floats, optional
        The policy to improve first, or values, which stand for their greedy policy.

    Examples
    --------
    >>> stay, go = [[1, 0], [0, 1]], [[0, 1], [0, 1]]
    >>> mdp = MDP.from_arrays([stay, go], [[1, 0], [2, 2]], discount="1/2")
    >>> solution = PolicyIteration().solve(mdp)
    >>> solution.value.tolist(), solution.policy.rule.tolist()
    ([2.0, 4.0], [0, 0])
    """

    max_iterations: int = 1000
    start: Any = field(default=None, repr=False, compare=False)

    name: ClassVar[str] = "policy-iteration"

    def __post_init__(self) -> None:
        check_counts(type(self).__name__, max_iterations=self.max_iterations)

    def maximise(self, model: MDP) -> Solution:
        """Return the optimum up to rounding."""
        started = perf_counter()
        values = Values(model, read_start_values(model, self.start))
        stopping = StoppingRule(values, None)
        seen = set[bytes]()
        for _ in range(self.max_iterations):
            values.pass_over_pairs()
            stopping.measure()
            policy = values.search.pairs.tobytes()
            if policy in seen and (stopping.is_near or values.idle >= PATIENCE):
                stopping.prove()
                stopping.status = Status.DIRECT
            else:
                stopping.give_up_if_hopeless()
            if stopping.status is not None:
                break
            seen.add(policy)
            values.solve_policy_equations(closely=True)
        return stopping.conclude(self, started)


@dataclass(frozen=True, kw_only=True)
class BackwardInduction(Solver):
    """Solve an acyclic model in one pass, at any discount; exact but for rounding.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]]], [[3], [0]])
    >>> solution = BackwardInduction().solve(mdp)
    >>> solution.value.tolist(), solution.iterations
    ([3.0, 0.0], 1)
    """

    name: ClassVar[str] = "backward-induction"

    def maximise(self, model: MDP) -> Solution:
        """Return the optimum; raise ModelError if the model has a cycle."""
        started = perf_counter()
        if not model.ends.is_acyclic:
            raise ModelError(
                "backward induction needs a model without cycles",
                where=f"model {model.name}".strip(),
                fix="use ModifiedPolicyIteration or PolicyIteration",
            )
        bounds = bound_optimal_values(model, solve_backward(model, model.reward)).centre_bounds()
        return conclude_solution(
            model, self, bounds, status=Status.DIRECT, iterations=1, started=started
        )
