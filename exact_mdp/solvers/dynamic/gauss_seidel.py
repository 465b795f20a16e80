"""Gauss-Seidel value iteration: each state is improved with what the states before it have become.

    V(s) ← max over pairs l of s of  [r(l) + γ Σ_{s' ≠ s} P(l, s') V(s')] / (1 - γ P(l, s))

state by state, in place (Puterman, Markov Decision Processes, 1994, section 6.3.3), upward and
downward in number by turns. Before each such sweep an ordinary one, V ← T V, gives the two-sided
bounds of `solvers.bounds.sweeps`; the solver stops when these are as close as asked for, as
`solvers.dynamic.value_iteration` does, and never because a sweep changed little.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.dynamic.stopping import Run, check_settings, of_costs
from exact_mdp.solvers.solution import Solution


@dataclass(frozen=True, kw_only=True)
class GaussSeidel:
    """Improve the values state by state, in place, until their error bound is at most `tol`.

    Parameters
    ----------
    tol : float, optional
        Greatest absolute error in any state; 1e-9 · max(1, |V|) unless given.
    max_iterations : int
        Pairs of sweeps after which to give up, with a SolverError.
    start : (S,) floats or PolicyLike, optional
        Values to begin with, or a policy whose values are meant; 0 unless given.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[1]]], [1], discount="9/10")
    >>> round(GaussSeidel(tol=1e-6).solve(mdp).start_value, 6)
    10.0
    """

    tol: float | None = None
    max_iterations: int = 1_000_000
    start: Any = field(default=None, repr=False, compare=False)

    name: ClassVar[str] = "gauss-seidel"

    def __post_init__(self) -> None:
        check_settings(self)

    @np.errstate(over="ignore", invalid="ignore")
    @of_costs
    def solve(self, model: MDP) -> Solution:
        """Return the optimum within `tol`; see `solvers.solve` for what is raised."""
        run = Run(model, self)
        for found in run:
            run.values.take(found)
            run.values.relax(backward=run.iteration % 2 == 0)
            run.hurry()
        return run.solution
