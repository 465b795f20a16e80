"""Six textbook algorithms, each as its loop, its step and its stopping rule.

    value iteration              V ← T V,   (T V)(s) = max over pairs l of s of r(l) + γ P_l V
    Gauss-Seidel                 the same, state after state, up and down their numbers in turn
    modified policy iteration    π greedy for V,   V ← (T_π)^m V
    policy iteration             π greedy for V,   V ← (I - γ P_π)⁻¹ r_π
    backward induction           V(s) ← (T V)(s) once, from the end to the start, without cycles
    policy iteration             π greedy for (d(g), r - g + d(h), d(w) - h), in this order, with
      for averages               d(x) = P x - x and the gain g, bias h, and w of the policy

Every loop for totals begins with a pass over all pairs, which gives T V - V, a greedy policy and
two-sided bounds on V*; it stops when these are proven to be within the tolerance
(`base.StoppingRule`), and answers with the middle between them. Sources: Puterman, Markov Decision
Processes, 1994, sections 4.5, 6.3 to 6.5, 9.2.1 and 10.3; Puterman and Shin, Management Science 24,
1978; Howard, Dynamic Programming and Markov Processes, 1960.
"""

from __future__ import annotations

import warnings
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.bounds.bounds import bound_optimal_values, solve_backward
from exact_mdp.solvers.bounds.gains import (
    POLICIES,
    RELATIVE_TOLERANCE,
    BoundedVector,
    choose_greedy_pairs,
    compute_advantages,
)
from exact_mdp.solvers.claims import PrecisionWarning, SolverError, Status
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
from exact_mdp.solvers.endless.chain import FloatChain, compute_laurent_expansion
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


# ---- average rewards -----------------------------------------------------------------------------

# 1 - γ of the discounted model whose optimal policy is the first one. The smaller, the nearer that
# policy is to the optimum, and the longer it takes to find.
NEARNESS = Fraction(1, 2**12)

Improved = tuple[Integers, Floats, int]
"""The pairs (S,) of a policy, relative values (S,), and iterations."""


@dataclass(frozen=True)
class AveragePolicyIteration:
    """Howard's policy iteration for average rewards, with g, h and w of each policy.

    A policy is improved in the order of (d(g), r - g + d(h), d(w) - h): a better gain first, then
    a better bias (Puterman, 1994, section 9.2.1; Howard, 1960).
    """

    max_iterations: int = POLICIES

    def run(self, step: MDP, pairs: Integers | None = None) -> Improved:
        """Return a policy that is optimal up to rounding, from `pairs` (S,) or a patient policy."""
        if pairs is None:
            pairs = _choose_patient_pairs(step)
        seen: set[bytes] = set()
        before: tuple[Floats, Floats] | None = None
        for iteration in range(1, self.max_iterations + 1):
            seen.add(pairs.tobytes())
            # Evaluate the policy: its gain g with bounds, its bias h, and w.
            chain = FloatChain(step, pairs)
            _, bias, second = compute_laurent_expansion(chain, step.reward[pairs])
            added = compute_advantages(step, bias)
            own = BoundedVector(value=added.value[pairs], error=added.error[pairs])
            gain = chain.bounded_gain(own)
            # Stop once neither the gain nor the bias rises by more than rounding.
            if before is not None and not self._has_risen(before, gain, bias):
                return pairs, bias, iteration
            before = gain.value, bias
            pairs = self._improve_pairs(step, pairs, gain, bias, second)
            if pairs.tobytes() in seen:
                return pairs, bias, iteration
        raise SolverError(Status.ITERATION_LIMIT, f"{self.max_iterations} policies were evaluated")

    @staticmethod
    def _has_risen(before: tuple[Floats, Floats], gain: BoundedVector, bias: Floats) -> bool:
        """Return whether a policy is better than the one before, beyond rounding."""
        least = RELATIVE_TOLERANCE * float(np.abs(bias).max())
        gain_rises = (gain.value - before[0] > gain.error).any()
        return bool(gain_rises or (bias - before[1] > least).any())

    @staticmethod
    def _improve_pairs(
        step: MDP, pairs: Integers, gain: BoundedVector, bias: Floats, second: Floats
    ) -> Integers:
        """Return pairs (S,) that are greatest in all three levels, in their order."""
        # Gains that are equal come out of different equations: their whole error counts, not only
        # the error of their differences.
        means = compute_advantages(step, gain.value, reward=np.zeros(step.n_pairs))
        unsure = step.transition @ gain.error + gain.error[step.pair_state]
        return choose_greedy_pairs(
            step,
            replace(means, noise=means.noise + unsure),
            compute_advantages(step, bias, reward=step.reward - gain.value[step.pair_state]),
            compute_advantages(step, second, reward=-bias[step.pair_state]),
            keep=pairs,
        )


def _choose_patient_pairs(step: MDP) -> Integers:
    """Return the pairs (S,) that are best with a discount near 1, few of which need improving."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PrecisionWarning)
        try:
            return ModifiedPolicyIteration().solve(step.with_(discount=1 - NEARNESS)).pairs
        except SolverError:  # any policy may be the first
            return step.pair_offsets[:-1]
