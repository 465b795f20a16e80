"""Modified policy iteration: improve the policy, then evaluate it by a few cheap sweeps.

    π greedy for V,   V ← (T_π)^m V

One sweep for a fixed policy costs the A-th part of a full one (Puterman and Shin, Management
Science 24, 1978). It goes on until the policy's own spread has fallen to a tenth; where `sweeps`
sweeps do not bring that about, the chain mixes slowly and the policy is evaluated by solving its
linear equations instead. The bounds are those of value iteration; before they are computed the
values of the last policy are polished until rounding stops them, so that ties show as ties.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers.conclusion import Watch, check_settings, conclude
from solvers.linear import LinearSystem, policy_chain
from solvers.solution import Solution


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
        value, iteration = np.zeros(mdp.n_states), 0
        while iteration < self.max_iterations:
            iteration += 1
            q = mdp.backup(value)
            if ready := watch.ready(value, q):
                q = mdp.backup(watch.middle(value, q))
            value, pairs = _best(mdp, q)
            value = self._evaluated(mdp, pairs, value, watch, polish=ready)
            if ready and (end := watch.verdict(value)):
                status, found = end
                break
        else:
            status, found = watch.given_up(value)
        return conclude(mdp, self, found, status=status, iterations=iteration, started=started)

    def _evaluated(
        self, mdp: MDP, pairs: Integers, value: Floats, watch: Watch, *, polish: bool
    ) -> Floats:
        chain, reward = policy_chain(mdp, pairs)
        goal, best = 0.0 if polish else watch.half / 10, np.inf
        for _ in range(self.sweeps):
            after = reward + mdp.discount * (chain @ value)
            spread = watch.spread(value, after, pairs)
            value = after
            if spread <= goal or (polish and spread >= best):
                return value
            best = min(best, spread)
        return LinearSystem(chain, mdp.discount).approximate(reward)


def _best(mdp: MDP, q: Floats) -> tuple[Floats, Integers]:
    """Return the greatest value of each state's pairs (S,) and the first of those pairs (S,)."""
    first = mdp.pair_offsets[:-1]
    best = np.maximum.reduceat(q, first)
    numbers = np.where(q == best[mdp.pair_state], np.arange(mdp.n_pairs), mdp.n_pairs)
    return best, np.minimum.reduceat(numbers, first)
