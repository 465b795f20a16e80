"""When to stop, and what to say at the end; shared by all solvers.

A pass over V = h + c w gives sound bounds h + low w ≤ V^π ≤ V* ≤ h + high w
(`solvers.bounds.sweeps`), so V* is within (high - low) w / 2 of the middle, which is what is
returned once that is small enough. A bound of the size of rounding errors that falls no longer says
that double precision is at its limit; one that stays large for many passes says nothing, as news of
the end travels one step in each.
"""

from __future__ import annotations

import warnings
from collections.abc import Hashable
from time import perf_counter
from typing import Protocol

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.bounds import Bounds, margin_weights
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT
from exact_mdp.solvers.bounds.sweeps import Pass, sweeps_of
from exact_mdp.solvers.dynamic.partial_evaluation import Iterate
from exact_mdp.solvers.solution import PrecisionWarning, Solution, SolverError, Status

RELATIVE_TOLERANCE = 1e-9
PATIENCE = 20


class Solver(Protocol):
    """Settings of an algorithm, and the one verb."""

    @property
    def name(self) -> str:
        """Name of the algorithm, as in `SOLVERS`."""

    def solve(self, mdp: MDP) -> Solution:
        """Return values, a policy and their error bounds."""


class Watch:
    """Decides when the iterates of a model are good enough.

    Attributes
    ----------
    tol : float or None
        Greatest absolute error; 1e-9 · max(1, |V|) where None.
    sweeps : Sweeps
    weight : float
        The greatest weight.
    half : float
        Bound on the error of the middle between the last bounds, its own rounding not counted.
    """

    def __init__(self, mdp: MDP, tol: float | None) -> None:
        self.tol = tol
        self.sweeps = sweeps_of(mdp, margin_weights(mdp), strict=tol is not None)
        self.weight = float(self.sweeps.weights.value.max(initial=0.0))
        self.half = self._best = np.inf
        self._idle, self._stalled, self._doubt = 0, False, 1.0

    @property
    def enough(self) -> float:
        """An error within a policy, in units of w, below which the tolerance asks for no less."""
        return 0.0 if self.tol is None or self.weight == 0 else self.tol / (2 * self.weight)

    @property
    def goal(self) -> float:
        """How close to come to a policy's values, in units of w: a tenth of what is left.

        One state far behind makes that as large as all values; where bounds have not fallen for
        some passes, it is less each time.
        """
        part = 10.0 ** -min(max(self._idle - 4, 0), 12)
        return max(self.half / max(self.weight, TINY) / 10 * part, self.enough)

    def limit(self, value: Floats) -> float:
        """Return the greatest absolute error allowed."""
        if self.tol is not None:
            return self.tol
        return RELATIVE_TOLERANCE * max(1.0, float(np.abs(value).max()))

    def ready(self, found: Pass, iterate: Iterate) -> bool:
        """Take note of a pass around an iterate; return whether it may be the last."""
        self.half = (found.high - found.low) / 2 * self.weight
        self._idle = 0 if self.half < self._best else self._idle + 1
        self._best = min(self._best, self.half)
        quiet = self.half == 0 or self._idle >= PATIENCE
        self._stalled = quiet and self.half <= 4 * found.floor * self.weight
        if self._stalled:
            return True
        # What the tolerance is relative to is worked out only where it has to be.
        middle = self._middle(found, iterate.value) if self.tol is None else iterate.value
        return self._doubt * self.half <= self.limit(middle)

    def verdict(self, found: Pass, iterate: Iterate) -> tuple[Status, Bounds] | None:
        """Return how it ended, or None where more sweeps are needed."""
        end = self.bounds(found, iterate)
        if end.error <= self.limit(end.value):
            return Status.CONVERGED, end
        # What fell short of the proven error is not to be taken for the whole of it again.
        self._doubt = end.error / self.half if self.half > 0 else 1.0
        near = end.error <= 8 * found.floor * self.weight
        return (Status.PRECISION, end) if self._stalled and near else None

    def bounds(self, found: Pass, iterate: Iterate) -> Bounds:
        """Return the proven bounds of a pass, around their middle."""
        judged, value = iterate.judge(found), iterate.value
        weight = self.sweeps.weights.value
        middle = self._middle(judged, value)
        live = weight > 0
        centre = (judged.low + judged.high) / 2
        # The middle is rounded three times, and the lines below a few times more.
        lost = 2 * UNIT * (np.abs(middle) + 2 * abs(centre) * weight)[live] / weight[live]
        rounding = float(lost.max(initial=0.0)) + 8 * UNIT * abs(centre)
        return Bounds(
            value=middle,
            weight=weight,
            pairs=judged.pairs,
            low=(judged.low - centre) * SLACK - rounding,
            high=(judged.high - centre) * SLACK + rounding,
        )

    def _middle(self, found: Pass, value: Floats) -> Floats:
        centre = (found.low + found.high) / 2
        return np.asarray(value + centre * self.sweeps.weights.value)


def conclude(
    mdp: MDP,
    solver: Solver,
    found: Bounds,
    *,
    status: Status,
    iterations: int,
    started: float,
    gaps: Floats | None = None,
    occupancy: Floats | None = None,
) -> Solution:
    """Return the solution; warns where its tolerance is beyond double precision.

    Parameters
    ----------
    started : float
        `perf_counter()` when the solver began.
    """
    solution = Solution(
        mdp=mdp,
        value=np.array(found.value),
        pairs=found.pairs,
        state_error=found.state_error,
        regret_bound=found.regret,
        status=status,
        method=solver.name,
        solver=repr(solver),
        iterations=iterations,
        seconds=perf_counter() - started,
        gaps=gaps,
        occupancy=occupancy,
    )
    if status is Status.PRECISION:
        message = f"the error bound is {solution.error_bound:.2g}: {status}"
        warnings.warn(message, PrecisionWarning, stacklevel=4)
    if status is Status.ITERATION_LIMIT:
        detail = f"{solution.error_bound:.2g} is the error bound after {iterations} iterations"
        raise SolverError(status, detail, solution)
    return solution


def check_settings(solver: Hashable, tol: float | None = None, **counts: int) -> None:
    """Raise ModelError for a tolerance that is not positive or a count below 1."""
    name = type(solver).__name__
    if tol is not None and not 0 < tol < np.inf:
        raise ModelError(f"tol is {tol}", where=name, fix="choose a positive number, or None")
    check_counts(name, **counts)


def check_counts(where: str, **counts: int) -> None:
    """Raise ModelError for what is not a whole number from 1 up; True is none.

    Examples
    --------
    >>> check_counts("ValueIteration", max_iterations=1)
    """
    for key, count in counts.items():
        whole = isinstance(count, int | np.integer) and not isinstance(count, bool)
        if not whole or count < 1:
            raise ModelError(
                f"{key} is {count!r}", where=where, fix="choose a whole number from 1 up"
            )
