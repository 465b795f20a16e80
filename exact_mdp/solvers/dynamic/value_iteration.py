"""Value iteration, stopped by two-sided bounds.

    V ← T V,   (T V)(s) = max over pairs l of s of  r(l) + γ Σ_s' P(l, s') V(s')

until the bounds of `solvers.bounds.bounds` around V are as close as asked for; that the last sweep
changed little is no reason to stop (Haddad and Monmege, Theoretical Computer Science 735, 2018).
The answer is the middle between the bounds (MacQueen 1966; Porteus 1971). Once a hundred sweeps do
not bring these closer by a tenth, or after 10,000, each is followed by the linear equations of its
policy, so that chains that mix slowly end, too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.dynamic.stopping import Run, check_settings, of_costs
from exact_mdp.solvers.solution import Solution


@dataclass(frozen=True, kw_only=True)
class ValueIteration:
    """Improve the values sweep by sweep until their error bound is at most `tol`.

    Parameters
    ----------
    tol : float, optional
        Greatest absolute error in any state; 1e-9 · max(1, |V|) unless given.
    max_iterations : int
        Sweeps after which to give up, with a SolverError.
    start : (S,) floats or PolicyLike, optional
        Values to begin with, or a policy whose values are meant; 0 unless given.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[1]]], [1], discount="9/10")
    >>> round(ValueIteration(tol=1e-6).solve(mdp).start_value, 6)
    10.0
    """

    tol: float | None = None
    max_iterations: int = 1_000_000
    start: Any = field(default=None, repr=False, compare=False)

    name: ClassVar[str] = "value-iteration"

    def __post_init__(self) -> None:
        check_settings(self)

    @np.errstate(over="ignore", invalid="ignore")
    @of_costs
    def solve(self, model: MDP) -> Solution:
        """Return the optimum within `tol`; see `solvers.solve` for what is raised."""
        run = Run(model, self)
        for found in run:
            run.values.take(found)
            run.hurry()
        return run.solution
