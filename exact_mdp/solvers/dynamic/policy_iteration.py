"""Policy iteration: evaluate a policy exactly, improve it in every state, repeat.

    V = r_π + γ P_π V,   π(s) ← a pair l of s with the greatest r(l) + γ P_l V

A pair is kept unless another beats it by more than rounding, so that ties cannot make it go round
in circles (Howard, Dynamic Programming and Markov Processes, 1960; Puterman, Markov Decision
Processes, 1994, section 6.4). The number of iterations does not depend on how fast the chain mixes.
Next to discount 1, rounds of modified policy iteration then bring values as near as floats can be.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.bounds import Bounds, bounds, margin_weights
from exact_mdp.solvers.bounds.gains import gains, greedy
from exact_mdp.solvers.dynamic.known import evaluated, greedy_of
from exact_mdp.solvers.dynamic.modified import closer, wide
from exact_mdp.solvers.dynamic.stopping import check_settings, conclude, of_costs
from exact_mdp.solvers.solution import Solution, Status


@dataclass(frozen=True, kw_only=True)
class PolicyIteration:
    """Howard's policy iteration; the error bound is what rounding leaves.

    Parameters
    ----------
    max_iterations : int
        Policies to evaluate before giving up, with a SolverError.
    start : PolicyLike or (S,) floats, optional
        The policy to improve first, or values whose greedy policy is meant.

    Examples
    --------
    >>> stay, go = [[1, 0], [0, 1]], [[0, 1], [0, 1]]
    >>> mdp = MDP.from_arrays([stay, go], [[1, 0], [2, 2]], discount="1/2")
    >>> solution = PolicyIteration().solve(mdp)
    >>> solution.value.tolist(), solution.policy.tolist()
    ([2.0, 4.0], [0, 0])
    """

    max_iterations: int = 1000
    start: Any = field(default=None, repr=False, compare=False)

    name: ClassVar[str] = "policy-iteration"

    def __post_init__(self) -> None:
        check_settings(self)

    @np.errstate(over="ignore", invalid="ignore")
    @of_costs
    def solve(self, model: MDP) -> Solution:
        """Return the optimum up to rounding; see `solvers.solve` for what is raised."""
        started = perf_counter()
        margin_weights(model)
        pairs = greedy_of(model, self.start)
        found, iterations, stable = improved(model, pairs, self.max_iterations)
        status = Status.DIRECT if stable else Status.ITERATION_LIMIT
        if stable and wide(model, found.value, found.error):
            near = closer(model, found.value, found.error)
            if near is not None:
                return replace(
                    near,
                    method=self.name,
                    solver=repr(self),
                    status=status,
                    iterations=iterations + near.iterations,
                    seconds=perf_counter() - started,
                    stats={},
                )
        return conclude(model, self, found, status=status, iterations=iterations, started=started)


def improved(mdp: MDP, pairs: Integers, limit: int) -> tuple[Bounds, int, bool]:
    """Return bounds around the values reached from `pairs` (S,), the iterations, and if stable."""
    seen: set[bytes] = set()
    for iteration in range(1, limit + 1):
        value = evaluated(mdp, pairs)
        gain = gains(mdp, value)
        seen.add(pairs.tobytes())
        pairs = greedy(mdp, gain, keep=pairs)
        # A policy that comes back differs from the last by rounding errors alone.
        if pairs.tobytes() in seen:
            return bounds(mdp, value), iteration, True
    return bounds(mdp, value), iteration, False
