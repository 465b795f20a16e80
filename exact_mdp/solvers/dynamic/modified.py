"""Modified policy iteration: improve the policy, then evaluate it by a few cheap sweeps.

    π greedy for V,   V ← (T_π)^m V

One sweep for a fixed policy costs the A-th part of a full one (Puterman and Shin, Management
Science 24, 1978). It goes on until the error within the policy is a tenth of what was left; where
`sweeps` sweeps will not bring that about, the chain mixes slowly and the policy is evaluated by
solving its linear equations instead, see `solvers.dynamic.stopping`. The last full sweep
gives sound bounds. Unless a tolerance is asked for, the values of the last policy are polished
until rounding stops them, so that ties show as ties.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.dynamic.stopping import (
    NEARLY_ONE,
    RELATIVE_TOLERANCE,
    Run,
    check_settings,
    of_costs,
)
from exact_mdp.solvers.solution import PrecisionWarning, Solution, SolverError


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
    start : (S,) floats or PolicyLike, optional
        Values to begin with, or a policy whose values are meant; 0 unless given.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[1]]], [1], discount="9/10")
    >>> round(ModifiedPolicyIteration().solve(mdp).start_value, 9)
    10.0
    """

    tol: float | None = None
    sweeps: int = 100
    max_iterations: int = 10_000
    start: Any = field(default=None, repr=False, compare=False)

    name: ClassVar[str] = "modified-policy-iteration"

    def __post_init__(self) -> None:
        check_settings(self)

    @np.errstate(over="ignore", invalid="ignore")
    @of_costs
    def solve(self, model: MDP) -> Solution:
        """Return the optimum within `tol`; see `solvers.solve` for what is raised."""
        run = Run(model, self, polish=self.tol is None, sweeps=self.sweeps)
        for found in run:
            run.round(found)
        return run.solution


def wide(model: MDP, value: Floats, error: float) -> bool:
    """Return whether `value` (S,), known to an `error`, may be told closer, next to discount 1.

    Equations for values as large as there lose what rounds keep, which hold apart what all values
    have in common.
    """
    near = model.discount > NEARLY_ONE and model.discount_exact != 1
    return near and not error <= RELATIVE_TOLERANCE * float(np.abs(value).max(initial=1.0))


def closer(model: MDP, value: Floats | None, error: float) -> Solution | None:
    """Return the optimum by rounds that begin with `value` (S,); None if its error is no less."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PrecisionWarning)
        try:
            found = ModifiedPolicyIteration(start=value).solve(model)
        except SolverError:
            return None
    return found if found.error_bound < error else None
