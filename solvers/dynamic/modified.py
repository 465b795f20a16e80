"""Modified policy iteration: improve the policy, then evaluate it by a few cheap sweeps.

    π greedy for V,   V ← (T_π)^m V

One sweep for a fixed policy costs the A-th part of a full one (Puterman and Shin, Management
Science 24, 1978). It goes on until the error within the policy is a tenth of what was left; where
`sweeps` sweeps will not bring that about, the chain mixes slowly and the policy is evaluated by
solving its linear equations instead, see `solvers.dynamic.partial_evaluation`. The last full sweep
gives sound bounds. Unless a tolerance is asked for, the values of the last policy are polished
until rounding stops them, so that ties show as ties.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.dynamic.partial_evaluation import Iterate
from exact_mdp.solvers.dynamic.stopping import Watch, check_settings, conclude
from exact_mdp.solvers.solution import Solution, Status


@dataclass(frozen=True, kw_only=True)
class ModifiedPolicyIteration:
    """Policy iteration with evaluation by sweeps, until the error bound is at most `tol`.

    Parameters
    ----------
    tol : float, optional
        Greatest absolute error in any state; 1e-9 · max(1, |V|) unless given.
    sweeps : int
        Most sweeps for one policy before its linear equations are solved.
    max_iterations : int
        Policies to improve before giving up, with a SolverError.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[1]]], [1], discount="9/10")
    >>> round(ModifiedPolicyIteration().solve(mdp).start_value, 9)
    10.0
    """

    tol: float | None = None
    sweeps: int = 100
    max_iterations: int = 10_000

    def __post_init__(self) -> None:
        check_settings(self, self.tol, sweeps=self.sweeps, max_iterations=self.max_iterations)

    @property
    def name(self) -> str:
        return "modified-policy-iteration"

    @np.errstate(over="ignore", invalid="ignore")
    def solve(self, mdp: MDP) -> Solution:
        """Return the optimum within `tol`.

        Raises
        ------
        ModelError
            At discount 1 where not every policy ends.
        SolverError
            At the iteration limit, or where double precision cannot bound the error.
        """
        started = perf_counter()
        watch = Watch(mdp, self.tol)
        iterate, iteration = Iterate(watch.sweeps, np.zeros(mdp.n_states)), 0
        polished = self.tol is not None
        while True:
            iteration += 1
            found = iterate.improve()
            ready = watch.ready(found, iterate)
            if ready and polished and (end := watch.verdict(found, iterate)):
                status, reached = end
                break
            if iteration == self.max_iterations:
                status, reached = Status.ITERATION_LIMIT, watch.bounds(found, iterate)
                break
            polished = ready or self.tol is not None
            goal = 0.0 if ready else watch.goal
            iterate.take(found)
            if iteration > 1:
                iterate.evaluate(goal, self.sweeps)
        return conclude(mdp, self, reached, status=status, iterations=iteration, started=started)
