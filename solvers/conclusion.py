"""When to stop, and what to say at the end; shared by all solvers.

An iteration V ← T V is watched through c and c', the greatest and the least over the states of
max (q - V) / m, with the weights w and margins m of `solvers.bounds`. V* is estimated to be within
(c - c') w / 2 of the middle, V + (c + c') w / 2. Bounds around the middle, with rounding errors,
are computed once this estimate meets the tolerance, and again each time it has fallen to a half. An
estimate of the size of rounding errors that falls no longer says that double precision is at its
limit; one that stays large for many sweeps says nothing, as news of the end travels one step in
each.
"""

from __future__ import annotations

import warnings
from collections.abc import Hashable
from time import perf_counter
from typing import Protocol

import numpy as np

from mdp.errors import ModelError
from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers.bounds import Bounds, bounds, margin_weights
from solvers.rounding import gamma
from solvers.solution import PrecisionWarning, Solution, SolverError, Status

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
    half : float
        Estimated error of the last iterate, once it is moved to the middle.
    """

    def __init__(self, mdp: MDP, tol: float | None) -> None:
        self.mdp, self.tol = mdp, tol
        self.half = np.inf
        self._weights = margin_weights(mdp)
        self._weight = float(self._weights.value.max(initial=0.0))
        self._live = np.flatnonzero(~mdp.terminal)
        terms = int(np.diff(mdp.transition.indptr).max())
        self._noise = 2 * float(gamma(terms + 8) / self._weights.least.min()) * self._weight
        self._best = self._next = np.inf
        self._idle, self._stalled = 0, False

    def limit(self, value: Floats) -> float:
        """Return the greatest absolute error allowed."""
        if self.tol is not None:
            return self.tol
        return RELATIVE_TOLERANCE * max(1.0, float(np.abs(value).max()))

    def spread(self, value: Floats, q: Floats, pairs: Integers | None = None) -> float:
        """Return the estimated error of `value` (S,), once it is moved to the middle.

        Parameters
        ----------
        q : (L,) or (S,)
            Values of all pairs, or of the policy's `pairs` (S,) alone.
        """
        low, high = self._range(value, q, pairs)
        return (high - low) / 2 * self._weight

    def _range(self, value: Floats, q: Floats, pairs: Integers | None) -> tuple[float, float]:
        chosen = slice(None) if pairs is None else pairs
        gain = q - value[self.mdp.pair_state[chosen]]
        ratio = gain / np.where(gain > 0, self._weights.least[chosen], self._weights.most[chosen])
        if pairs is None:
            ratio = np.maximum.reduceat(ratio, self.mdp.pair_offsets[:-1])
        ratio = ratio[self._live] if len(self._live) else np.zeros(1)
        return float(ratio.min()), float(ratio.max())

    def ready(self, value: Floats, q: Floats) -> bool:
        """Take note of values and those of all pairs; return whether to compute bounds."""
        self.half = self.spread(value, q)
        if not np.isfinite(self.half):
            raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
        self._idle = 0 if self.half < self._best else self._idle + 1
        self._best = min(self._best, self.half)
        quiet = self.half == 0 or self._idle >= PATIENCE
        self._stalled = quiet and self.half <= self._noise * float(np.abs(q).max())
        return self._stalled or self.half <= min(self.limit(value), self._next)

    def middle(self, value: Floats, q: Floats) -> Floats:
        """Return the middle (S,) between the estimated bounds."""
        low, high = self._range(value, q, None)
        return np.asarray(value + (low + high) / 2 * self._weights.value)

    def verdict(self, value: Floats) -> tuple[Status, Bounds] | None:
        """Return how it ended, or None where more sweeps are needed."""
        q = self.mdp.backup(value)
        found = bounds(self.mdp, self.middle(value, q))
        if found.error <= self.limit(found.value):
            return Status.CONVERGED, found
        if self._stalled and self.spread(value, q) <= self._noise * float(np.abs(q).max()):
            return Status.PRECISION, found
        self._next = self.half / 2
        return None

    def given_up(self, value: Floats) -> tuple[Status, Bounds]:
        """Return how it ended where the iteration limit came first."""
        middle = self.middle(value, self.mdp.backup(value))
        return Status.ITERATION_LIMIT, bounds(self.mdp, middle)


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
        warnings.warn(message, PrecisionWarning, stacklevel=3)
    if status is Status.ITERATION_LIMIT:
        detail = f"{solution.error_bound:.2g} is the error bound after {iterations} iterations"
        raise SolverError(status, detail, solution)
    return solution


def check_settings(solver: Hashable, tol: float | None = None, **counts: int) -> None:
    """Raise ModelError for a tolerance that is not positive or a count below 1."""
    name = type(solver).__name__
    if tol is not None and not 0 < tol < np.inf:
        raise ModelError(f"tol is {tol}", where=name, fix="choose a positive number, or None")
    for key, count in counts.items():
        if not isinstance(count, int) or count < 1:
            raise ModelError(f"{key} is {count}", where=name, fix="choose a whole number from 1 up")
